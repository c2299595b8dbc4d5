"""The command `structid`: its commands parse, call, print and exit; beside them what they share."""
