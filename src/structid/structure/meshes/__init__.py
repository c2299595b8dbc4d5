"""Meshes from files: nodes, cells and named groups, checked."""

from structid.structure.meshes.checks import duplicate_nodes, orphan_nodes, require_sound, unassigned
from structid.structure.meshes.mesh import CELL_DIMENSIONS, CellBlock, Mesh
from structid.structure.meshes.reading import FORMATS, LENGTH_UNITS, read_mesh

__all__ = [
    "CELL_DIMENSIONS",
    "FORMATS",
    "LENGTH_UNITS",
    "CellBlock",
    "Mesh",
    "duplicate_nodes",
    "orphan_nodes",
    "read_mesh",
    "require_sound",
    "unassigned",
]
