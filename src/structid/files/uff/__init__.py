"""Universal files: their datasets as text, units (164), and nodes with their coordinate systems (15, 18, 781, 2411, 2420)."""
