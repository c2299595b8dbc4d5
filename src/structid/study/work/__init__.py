"""Where searches and repeated tasks run."""
