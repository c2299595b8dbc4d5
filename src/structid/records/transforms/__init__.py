"""From time histories to spectra and frequency response functions."""
