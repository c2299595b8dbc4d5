"""Modes as a least-squares problem."""
