"""What an identified model says of motion that was not measured, with bands, and of a structure that is changed."""
