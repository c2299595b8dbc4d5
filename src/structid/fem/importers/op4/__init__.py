"""Nastran OUTPUT4 files."""
