"""Sections that say what the structure is: in words, as a mesh, as matrices, by a solver."""
