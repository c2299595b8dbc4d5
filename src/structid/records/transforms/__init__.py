"""Transforms of time histories to spectra and frequency response functions."""
