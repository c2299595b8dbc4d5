"""Test planning: predicted accuracy of a test before it is run, and its most informative sensors, loads and lines."""
