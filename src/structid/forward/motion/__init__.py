"""The motion of every degree of freedom, whole or from disk, as linear least squares."""
