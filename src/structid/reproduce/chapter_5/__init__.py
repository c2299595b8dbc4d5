"""Chapter 5: modal identification by the pseudo-Rayleigh quotient."""
