"""What a record needs to become a problem, and what its answer is shown by: one file a kind of record."""
