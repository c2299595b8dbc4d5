"""structid: mass, damping and stiffness of a structure from vibration measurements."""
