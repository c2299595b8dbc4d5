"""Meshes from files: nodes, cells and named groups, checked; one format a module, chosen by the suffix of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.errors import FileError, InputError
from structid.core.units import FORCES, LENGTHS
from structid.fem.meshes.deck_parts import DeckPart, DeckUnits, choose_parts, describe_left_aside
from structid.fem.meshes.mesh import (
    CELL_DIMENSIONS,
    CellBlock,
    Mesh,
    describe_unassigned_cells,
    duplicate_nodes,
    orphan_nodes,
    require_sound,
)
from structid.files import damage_told, require_readable
from structid.lazy import FormatModule

GMSH = FormatModule("structid.fem.meshes.gmsh", (".msh",))
NASTRAN = FormatModule("structid.fem.meshes.nastran", (".bdf", ".nas", ".fem", ".dat"))
ABAQUS = FormatModule("structid.fem.meshes.abaqus", (".inp",))
VTK = FormatModule("structid.fem.meshes.vtk", (".vtu", ".vtk"))
UNIVERSAL = FormatModule("structid.fem.meshes.universal", (".unv", ".uff", ".uf"))
#: Each module has read(path, units), the mesh in SI units.
FORMATS: tuple[FormatModule, ...] = (GMSH, NASTRAN, ABAQUS, VTK, UNIVERSAL)
_FARTHEST = 1e100  # its square is still finite

__all__ = [
    "CELL_DIMENSIONS",
    "FORMATS",
    "CellBlock",
    "DeckPart",
    "Mesh",
    "choose_parts",
    "describe_left_aside",
    "describe_unassigned_cells",
    "duplicate_nodes",
    "orphan_nodes",
    "read_mesh",
    "require_sound",
]


def read_mesh(path: str | Path, length_unit: str = "m", force_unit: str = "N") -> Mesh:
    """The mesh of the file at `path` in m, with its node numbers, named groups, and the parts beside its cells.

    Parameters
    ----------
    path : str or Path
        Gmsh ``.msh``, Nastran ``.bdf .nas .fem .dat``, Abaqus ``.inp``, VTK ``.vtu .vtk``, universal ``.unv .uff``.
    length_unit : str
        A unit of `structid.core.units.LENGTHS`, such as ``mm``: that of the coordinates in the file; those of the mesh
        are in m.
    force_unit : str
        A unit of `structid.core.units.FORCES`, such as ``N``. It gives, with the length and s, the units of masses and
        springs in the file: with mm and N, masses are in tonnes.

    Returns
    -------
    Mesh
        Groups are physical groups (Gmsh: by name, or by number where they have none), properties (Nastran),
        element and node sets (Abaqus), whole-number cell arrays (VTK: ``array=value``), and groups of a universal file.

    Raises
    ------
    InputError
        If a unit is not known.
    FileError
        If the file is not of these kinds, is damaged, has coordinates that are not finite or 1e100 m and more, or is
        VTK and meshio is not installed.
    """
    readable = require_readable(path)
    reader = next((module for module in FORMATS if readable.suffix.lower() in module.SUFFIXES), None)
    if reader is None:
        known = " ".join(suffix for module in FORMATS for suffix in module.SUFFIXES)
        raise FileError(f"{readable}: the suffix of a mesh must be one of {known}; export it as one of these")
    if length_unit not in LENGTHS:
        raise InputError(f"`length_unit` must be one of {' '.join(LENGTHS)}, got {length_unit!r}")
    if force_unit not in FORCES:
        raise InputError(f"`force_unit` must be one of {' '.join(FORCES)}, got {force_unit!r}")
    with damage_told(readable, "a whole mesh", "export it again"):
        mesh: Mesh = reader.read(readable, DeckUnits(LENGTHS[length_unit], FORCES[force_unit]))
    if not (np.abs(mesh.positions) < _FARTHEST).all():
        raise FileError(f"{readable}: coordinates must be finite, and below {_FARTHEST:g} m; export it again")
    return mesh
