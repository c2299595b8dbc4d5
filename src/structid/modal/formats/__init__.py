"""Modes written to files and read back."""
