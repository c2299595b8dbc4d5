"""Modes of several set-ups as one."""
