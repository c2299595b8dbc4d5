"""Set-ups of records: each makes a problem of its record and shows the fit beside it; one file a kind of record."""
