"""The figures of an identification."""
