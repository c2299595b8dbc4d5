"""Modes from frequency response functions."""
