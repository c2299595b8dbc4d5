"""What worker processes do for the workbench: all that reads models and records, or computes."""
