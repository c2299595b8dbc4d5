"""Diagnosis: checks before a fit, the verdict on an answer, and the causes of a misfit."""
