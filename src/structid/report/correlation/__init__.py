"""What a correlation of a measurement and a model shows."""
