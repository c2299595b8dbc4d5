"""A study from file to results folder."""
