"""The search for a minimum: from a start, by ways and restarts, with its iterations kept."""
