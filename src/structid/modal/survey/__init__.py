"""Modes of one record file from start to end."""
