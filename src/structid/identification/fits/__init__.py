"""The answer seen from one record, and its resonances beside the measured ones."""
