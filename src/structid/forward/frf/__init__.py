"""Frequency response functions as a least-squares problem."""
