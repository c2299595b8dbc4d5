"""The pseudo-Rayleigh quotient of free motion."""
