"""Two states of a structure, and a test beside a model."""
