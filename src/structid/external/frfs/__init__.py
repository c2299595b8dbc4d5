"""FRFs that a solver computes itself: read from the folder of a run, and the model that they give."""
