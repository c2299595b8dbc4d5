"""Checks of a model and its records before a fit: mesh, channels, resonances, loose parts."""
