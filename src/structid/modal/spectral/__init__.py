"""Modes from the spectra of ambient motion."""
