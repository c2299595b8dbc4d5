"""How strongly what the data do not determine is held."""
