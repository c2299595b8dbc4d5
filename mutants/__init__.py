"""Edits of central formulas that the tests must catch: `python -m mutants`, or `make mutants`."""
