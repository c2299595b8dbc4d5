"""What a plan shows."""
