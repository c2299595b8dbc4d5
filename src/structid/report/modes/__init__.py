"""What a modal identification shows."""
