"""Studies whose model or record is wrong in a known way, simulated without structid; see README.md."""
