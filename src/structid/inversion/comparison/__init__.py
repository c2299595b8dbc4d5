"""Tests of what changed between two states, corrected for their number."""
