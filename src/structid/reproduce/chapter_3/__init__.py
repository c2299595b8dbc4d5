"""Chapter 3: identification in the time domain."""
