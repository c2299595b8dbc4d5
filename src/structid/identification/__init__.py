"""Set-ups and records to parameters with their uncertainty, and everything that a report shows of them."""
