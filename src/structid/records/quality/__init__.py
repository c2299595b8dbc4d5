"""What is wrong with a record, and records made ready for identification."""
