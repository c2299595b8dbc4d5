"""Intervals of parameters: by curvature, profile likelihood, bootstrap or posterior samples."""
