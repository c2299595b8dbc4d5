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
    """The attributes of a mesh of meshio that are used here."""

    points: AnyArray
    cells: Sequence[_Cells]
    point_data: Mapping[str, AnyArray]
    point_sets: Mapping[str, AnyArray]
    cell_data: Mapping[str, Sequence[AnyArray]]
    cell_sets: Mapping[str, Sequence[AnyArray | None]]


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of the VTK file at `path` in m; `units` gives the unit of its coordinates.

    Groups are whole-number cell arrays: ``array=value``.

    Raises
    ------
    FileError
        If the file is damaged, or meshio is not installed.
    """
    grid = _read_grid(path, path.suffix.lower()[1:])
    points = np.asarray(grid.points, dtype=np.float64)
    if points.ndim != 2 or not len(points):
        raise FileError(f"{path}: holds no whole table of nodes; {_REMEDY}")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    labels = _node_labels(grid)
    blocks = []
    for block in grid.cells:
        rows: IntArray = np.asarray(block.data, dtype=np.int64)
        if rows.size and (rows.min() < 0 or rows.max() >= len(labels)):
            raise FileError(f"{path}: cells of type {block.type} name nodes that are not there; {_REMEDY}")
        rows = _orient_wedges(block.type, rows, points)
        blocks.append(CellBlock(block.type, locked(labels[rows])))
    groups = _cell_groups(grid)
    nodes = {str(name): locked(labels[np.asarray(rows, np.int64)]) for name, rows in grid.point_sets.items()}
    return Mesh(locked(labels), locked(units.length * points), tuple(blocks), groups, nodes, path.name)


def _orient_wedges(kind: str, rows: IntArray, points: AnyArray) -> IntArray:
    """Nodes of wedges, reordered where needed so that the normal of the first triangle points to the second.

    Writers of VTK files differ in this, so that the positions decide. `kind` is the cell type, `rows` (n_cells,
    n_nodes) are row indices in `points` (n_points, 3). Other cell types are returned as they are.
    """
    order = _OTHER_WAY.get(kind)
    if order is None or not len(rows):
        return rows
    corners = points[rows[:, :6]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across = (corners[:, 3:] - corners[:, :3]).mean(axis=1)
    is_down = np.einsum("ij,ij->i", normal, across) < 0
    return np.where(is_down[:, None], rows[:, list(order)], rows)


def _read_grid(path: Path, kind: str) -> _Grid:
    """The grid that meshio's own reader of the format `kind` returns; `FileError`, which names `path`, if it fails.

    It fails too if meshio is not installed.
    """
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
    """Raise `FileError`, with the remedy, if meshio is not installed; `kind` names the format of the file at `path`."""
    try:
        importlib.import_module("meshio")
    except ImportError as error:
        raise FileError(
            f"{path}: {kind} files need the package meshio; install it by `pip install structid[mesh]`, or export the mesh"
            " as an Abaqus input file (.inp), which needs nothing"
        ) from error


def _node_labels(grid: _Grid) -> IntArray:
    """Labels of the nodes, (n,): a point array of whole numbers with a known name, else 1, 2, ..."""
    for name in _LABEL_ARRAYS:
        if name in grid.point_data and np.issubdtype(grid.point_data[name].dtype, np.integer):
            return np.asarray(grid.point_data[name], dtype=np.int64)
    return np.arange(1, len(grid.points) + 1)


def _cell_groups(grid: _Grid) -> dict[str, tuple[IntArray, ...]]:
    """Row indices of the cells of each group, one array for each block of cells, by name.

    Groups are cell sets, and ``array=value`` for each value of a cell array of whole numbers.
    """
    groups: dict[str, tuple[IntArray, ...]] = {}
    for name, rows in grid.cell_sets.items():
        groups[str(name)] = tuple(np.asarray([] if r is None else r, dtype=np.int64) for r in rows)
    for array, parts in grid.cell_data.items():
        if all(np.issubdtype(p.dtype, np.integer) and p.ndim == 1 for p in parts):
            _add_numbers(groups, grid, array)
    return groups


def _add_numbers(groups: dict[str, tuple[IntArray, ...]], grid: _Grid, array: str) -> None:
    """Add groups ``array=number`` to `groups` from the cell data `array`, one number a cell; known names stay."""
    parts = [np.asarray(part) for part in grid.cell_data[array]]
    for tag in np.unique(np.concatenate(parts)).tolist():
        groups.setdefault(f"{array}={tag}", tuple(np.flatnonzero(numbers == tag) for numbers in parts))
