"""Figures as data, and the two ways to draw them."""
