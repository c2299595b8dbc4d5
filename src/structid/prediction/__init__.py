"""Predictions of an identified model with bands: motion that was not measured, and structures that are changed."""
