"""Checks of records, and preparation of records for identification."""
