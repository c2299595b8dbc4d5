"""Cells of meshes: interpolation, quadrature and matrices that several element types share."""
