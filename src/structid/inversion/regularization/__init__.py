"""Strengths of regularization of what the data do not determine."""
