"""The command `structid`: one file a command; they parse, call, print and exit."""
