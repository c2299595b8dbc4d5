"""Tasks of the worker processes of the workbench: all that reads models and records, or computes."""
