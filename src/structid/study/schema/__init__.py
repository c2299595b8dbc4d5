"""The study file: its sections, checked and read."""
