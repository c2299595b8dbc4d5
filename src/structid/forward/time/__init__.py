"""Time histories as least-squares problems."""
