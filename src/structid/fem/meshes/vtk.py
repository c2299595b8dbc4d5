"""VTK unstructured grids, read by meshio."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from structid.core.arrays import AnyArray, IntArray, locked
from structid.core.errors import FileError
from structid.fem.meshes.deck_parts import DeckUnits
from structid.fem.meshes.mesh import CellBlock, Mesh

SUFFIXES: tuple[str, ...] = (".vtu", ".vtk")
_LABEL_ARRAYS = ("node_id", "node_ids", "GlobalNodeId", "NodeID", "label", "labels")
#: Nodes of wedges whose triangles run the other way about.
_OTHER_WAY = {
    "wedge": (0, 2, 1, 3, 5, 4),
    "wedge15": (0, 2, 1, 3, 5, 4, 8, 7, 6, 11, 10, 9, 12, 14, 13),
}
_REMEDY = "write it again, as an unstructured grid"


class _Cells(Protocol):
    """Cells of one type."""

    type: str
    data: AnyArray


class _Grid(Protocol):
    """What is used of a mesh of meshio."""

    points: AnyArray
    cells: Sequence[_Cells]
    point_data: Mapping[str, AnyArray]
    point_sets: Mapping[str, AnyArray]
    cell_data: Mapping[str, Sequence[AnyArray]]
    cell_sets: Mapping[str, Sequence[AnyArray | None]]


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of a VTK file in m.

    Groups are whole-number cell arrays: ``array=value``.

    Raises
    ------
    FileError
        If the file is damaged, or meshio is not installed.
    """
    given = _read(path, path.suffix.lower()[1:])
    points = np.asarray(given.points, dtype=np.float64)
    if points.ndim != 2 or not len(points):
        raise FileError(f"{path}: holds no whole table of nodes; {_REMEDY}")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    labels = _labels(given)
    blocks = []
    for block in given.cells:
        rows: IntArray = np.asarray(block.data, dtype=np.int64)
        if rows.size and (rows.min() < 0 or rows.max() >= len(labels)):
            raise FileError(f"{path}: cells of type {block.type} name nodes that are not there; {_REMEDY}")
        rows = _upright(block.type, rows, points)
        blocks.append(CellBlock(block.type, locked(labels[rows])))
    groups = _groups(given)
    nodes = {str(name): locked(labels[np.asarray(rows, np.int64)]) for name, rows in given.point_sets.items()}
    return Mesh(locked(labels), locked(units.length * points), tuple(blocks), groups, nodes, path.name)


def _upright(kind: str, rows: IntArray, points: AnyArray) -> IntArray:
    """Wedges whose first triangle has its normal towards the second, as VTK documents it for 15 nodes, not for 6.

    Writers differ in both, so that the positions tell.
    """
    order = _OTHER_WAY.get(kind)
    if order is None or not len(rows):
        return rows
    corners = points[rows[:, :6]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across = (corners[:, 3:] - corners[:, :3]).mean(axis=1)
    is_down = np.einsum("ij,ij->i", normal, across) < 0
    return np.where(is_down[:, None], rows[:, list(order)], rows)


def _read(path: Path, kind: str) -> _Grid:
    """What meshio's own reader of the format gives."""
    _require_meshio(path, kind)
    try:
        importlib.import_module("meshio._mesh").topological_dimension.setdefault("wedge15", 3)  # it lacks that one
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


def _labels(given: _Grid) -> IntArray:
    for name in _LABEL_ARRAYS:
        if name in given.point_data and np.issubdtype(given.point_data[name].dtype, np.integer):
            return np.asarray(given.point_data[name], dtype=np.int64)
    return np.arange(1, len(given.points) + 1)


def _groups(given: _Grid) -> dict[str, tuple[IntArray, ...]]:
    """Rows of each block by the name of the group."""
    found: dict[str, tuple[IntArray, ...]] = {}
    for name, rows in given.cell_sets.items():
        found[str(name)] = tuple(np.asarray([] if r is None else r, dtype=np.int64) for r in rows)
    for array, parts in given.cell_data.items():
        if all(np.issubdtype(p.dtype, np.integer) and p.ndim == 1 for p in parts):
            _add_numbers(found, given, array)
    return found


def _add_numbers(found: dict[str, tuple[IntArray, ...]], given: _Grid, array: str) -> None:
    """Groups from one number a cell; names that are known already stay as they are."""
    parts = [np.asarray(part) for part in given.cell_data[array]]
    for tag in np.unique(np.concatenate(parts)).tolist():
        found.setdefault(f"{array}={tag}", tuple(np.flatnonzero(numbers == tag) for numbers in parts))
