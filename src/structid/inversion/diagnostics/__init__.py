"""What can be told of an estimate: residual tests, rank and undetermined directions, and which measurements would help."""
