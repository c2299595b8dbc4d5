"""A measurement and a model side by side: modes paired and expanded, responses compared, from a study or a fit."""
