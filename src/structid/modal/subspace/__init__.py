"""Modes from time histories by the shift invariance of a block Hankel matrix."""
