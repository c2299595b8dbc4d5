"""Mesh files: Gmsh, Nastran bulk data and Abaqus input files by readers of our own, VTK through meshio."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from structid.arrays import IntArray, locked
from structid.errors import FileError, InputError
from structid.files import damage_told, require_readable
from structid.structure.meshes import abaqus, gmsh, nastran
from structid.structure.meshes.mesh import CellBlock, Mesh

#: File suffixes, and what reads them.
SUFFIXES = {
    ".msh": "gmsh",
    ".bdf": "nastran",
    ".nas": "nastran",
    ".fem": "nastran",
    ".dat": "nastran",
    ".inp": "abaqus",
    ".vtu": "vtu",
    ".vtk": "vtk",
}
#: What the numbers of a file are multiplied by to give m.
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_LABEL_ARRAYS = ("node_id", "node_ids", "GlobalNodeId", "NodeID", "label", "labels")
_OWN = {"abaqus": abaqus.read, "gmsh": gmsh.read, "nastran": nastran.read}
_REMEDY = "write it again, as an unstructured grid"
_FARTHEST = 1e100  # its square is still finite


def read_mesh(path: str | Path, length_unit: str = "m") -> Mesh:
    """The mesh of a file, with its own node numbers and named groups.

    Parameters
    ----------
    path : str or Path
        Gmsh ``.msh``, Nastran ``.bdf .nas .fem .dat``, Abaqus ``.inp``, VTK ``.vtu .vtk``.
    length_unit : {"m", "cm", "mm", "um", "in", "ft"}
        Unit of the coordinates in the file; those of the mesh are in m.

    Returns
    -------
    Mesh
        Groups are physical groups (Gmsh: by name, or by number where they have none), properties (Nastran),
        element and node sets (Abaqus), and whole-number cell arrays (VTK: ``array=value``).

    Raises
    ------
    FileError
        If the file is not of these kinds, is damaged, or is VTK and meshio is not installed.
    """
    place = require_readable(path)
    kind = SUFFIXES.get(place.suffix.lower())
    if kind is None:
        raise FileError(f"{place}: the suffix of a mesh must be one of {' '.join(SUFFIXES)}; export it as one of these")
    if length_unit not in LENGTH_UNITS:
        raise InputError(f"`length_unit` must be one of {' '.join(LENGTH_UNITS)}, got {length_unit!r}")
    factor = LENGTH_UNITS[length_unit]
    with damage_told(place, "a whole mesh", "export it again"):
        mesh = _OWN[kind](place, factor) if kind in _OWN else _through_meshio(place, kind, factor)
    if not (np.abs(mesh.positions) < _FARTHEST).all():
        raise FileError(f"{place}: coordinates must be finite, and below {_FARTHEST:g} m; {_REMEDY}")
    return mesh


def _through_meshio(place: Path, kind: str, factor: float) -> Mesh:
    given = _read(place, kind)
    points = np.asarray(given.points, dtype=np.float64)
    if points.ndim != 2 or not len(points):
        raise FileError(f"{place}: holds no whole table of nodes; {_REMEDY}")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    labels = _labels(given)
    blocks = []
    for block in given.cells:
        rows = np.asarray(block.data, dtype=np.int64)
        if rows.size and (rows.min() < 0 or rows.max() >= len(labels)):
            raise FileError(f"{place}: cells of type {block.type} name nodes that are not there; {_REMEDY}")
        blocks.append(CellBlock(block.type, locked(labels[rows])))
    groups = _groups(given)
    nodes = {str(name): locked(labels[np.asarray(rows, np.int64)]) for name, rows in given.point_sets.items()}
    return Mesh(locked(labels), locked(factor * points), tuple(blocks), groups, nodes, place.name)


def _read(path: Path, kind: str) -> Any:
    """What meshio's own reader of the format gives."""
    _require_meshio(path, kind)
    try:
        return importlib.import_module(f"meshio.{kind}").read(path)
    except MemoryError:
        raise
    except Exception as error:  # meshio has exceptions without a base of their own
        why = f" ({error})" if str(error) else ""
        raise FileError(f"{path}: cannot be read as {kind}{why}; {_REMEDY}") from error


def _require_meshio(path: Path, kind: str) -> None:
    try:
        importlib.import_module("meshio")
    except ImportError as error:
        raise FileError(
            f"{path}: {kind} files need the package meshio; install it by `pip install structid[mesh]`, or export the mesh"
            " as an Abaqus input file (.inp), which needs nothing"
        ) from error


def _labels(given: Any) -> IntArray:
    for name in _LABEL_ARRAYS:
        if name in given.point_data and np.issubdtype(given.point_data[name].dtype, np.integer):
            return np.asarray(given.point_data[name], dtype=np.int64)
    return np.arange(1, len(given.points) + 1)


def _groups(given: Any) -> dict[str, tuple[IntArray, ...]]:
    """Rows of each block by the name of the group."""
    found: dict[str, tuple[IntArray, ...]] = {}
    for name, rows in given.cell_sets.items():
        found[str(name)] = tuple(np.asarray([] if r is None else r, dtype=np.int64) for r in rows)
    for array, parts in given.cell_data.items():
        if all(np.issubdtype(p.dtype, np.integer) and p.ndim == 1 for p in parts):
            _add_numbers(found, given, array)
    return found


def _add_numbers(found: dict[str, tuple[IntArray, ...]], given: Any, array: str) -> None:
    """Groups from one number a cell; names that are known already stay as they are."""
    parts = [np.asarray(part) for part in given.cell_data[array]]
    for tag in np.unique(np.concatenate(parts)).tolist():
        found.setdefault(f"{array}={tag}", tuple(np.flatnonzero(numbers == tag) for numbers in parts))
