"""What a fit says of its model and its record: is the answer to be trusted, and which one change would explain a misfit."""
