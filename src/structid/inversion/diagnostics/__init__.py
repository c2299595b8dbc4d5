"""Diagnostics of an estimate: residual tests, rank and undetermined directions, and measurements that would help."""
