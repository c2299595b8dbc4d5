"""What a test would tell before it is run, and the sensors, loads and lines that tell most."""
