"""Studies from start to end: checked, run, kept and resumed."""
