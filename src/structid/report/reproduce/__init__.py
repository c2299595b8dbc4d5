"""What the reproduction shows."""
