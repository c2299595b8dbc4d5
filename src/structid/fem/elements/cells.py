"""Element sets of cells: their positions, types by number of nodes, and matrices of mixed types in one set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.constraints import Limits
from structid.core.errors import InputError
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    Kind,
    NodeCoordinates,
    Store,
    element,
    node_codes,
)

Poisson: TypeAlias = Annotated[float, "float", Limits(above=-1, below=0.5)]
#: How strains are interpolated; see `elastic_stiffness`.
Formulation = Literal["incompatible", "full", "mean_dilatation"]
#: Matrices of cells of one type from the name of the set, labels, positions and the cell type.
CellMatrices = Callable[[str, IntArray, FloatArray, str], FloatArray]

YOUNGS_MODULUS: tuple[str, Kind, str] = ("Young's modulus", "stiffness", "Pa")
DENSITY: tuple[str, Kind, str] = ("Density", "mass", "kg/m^3")
POISSON = "Poisson's ratio, known"


def cell_table(cells: Mapping[int, str]) -> Store:
    """A function that checks and stores node labels of cells as (n_cells, most nodes).

    Rows of smaller cells end in -1, as they are given. `cells` maps allowed numbers of nodes to cell types. The
    function takes the name of the set, for errors, and the labels, and raises `InputError` if they are no whole numbers
    or too many or few.
    """

    def stored(name: str, nodes: ArrayLike) -> IntArray:
        """Table of the node labels `nodes` of the set `name`, (n_cells, most nodes); -1 where a row has ended.

        Raises `InputError` unless they are whole numbers and each row has a number of nodes that `cells` allows.
        """
        table = np.atleast_2d(np.asarray(nodes))
        if table.ndim != 2 or table.size == 0 or not np.issubdtype(table.dtype, np.integer):
            raise InputError(f"`nodes` of {name!r} must be a table of whole numbers, got shape {table.shape}")
        counts = (table >= 0).sum(axis=1)
        is_wrong = ~np.isin(counts, list(cells))
        if is_wrong.any():
            e = int(np.argmax(is_wrong))
            allowed = ", ".join(f"{count} ({kind})" for count, kind in cells.items())
            raise InputError(
                f"element {e + 1} of {name!r} has {counts[e]} nodes; it can have {allowed}; mesh with these"
            )
        return locked(table, np.int64)

    return stored


@element
class CellSet(ElementSet):
    """Cells of a mesh, possibly of several types, whose nodes all move alike."""

    def matrix_term(
        self, corners: FloatArray, matrices_of: CellMatrices, power: int = 0, directions: Sequence[str] | None = None
    ) -> ElementMatrixTerm:
        """Element matrices of all cells of the set with their degrees of freedom, made type by type.

        Matrices of cells with fewer nodes than the largest are padded with zeros, to (n_cells, n_local, n_local).

        Parameters
        ----------
        corners : (n_cells, n_nodes, n_dimensions) float array
            Positions of the nodes, m.
        matrices_of : callable
            Takes the name of the set, node labels, positions and type of cells, and returns their matrices.
        power : int
            Power of the thickness that they go with.
        directions : sequence of str, optional
            Directions of each node that the matrices have; by default all in which the nodes move.
        """
        axes = self.moves if directions is None else directions
        counts = (self.nodes >= 0).sum(axis=1)
        size = len(axes) * self.nodes.shape[1]
        total = np.zeros((len(self.nodes), size, size))
        for count in np.unique(counts).tolist():
            rows, n = np.flatnonzero(counts == count), len(axes) * count
            nodes, nodes_at = self.nodes[rows, :count], corners[rows, :count]
            total[rows, :n, :n] = matrices_of(self.name, nodes, nodes_at, self.cells[count])
        return ElementMatrixTerm(node_codes(self.nodes, axes), total, power)


def cell_positions(name: str, nodes: IntArray, positions: NodeCoordinates, dimensions: int) -> FloatArray:
    """Positions in m of the cells' nodes along the first axes, (n_cells, n_nodes, dimensions).

    They are 0 where a row has ended. `nodes` (n_cells, n_nodes) are labels, -1 where a row has ended; `positions` map
    labels to coordinates. Raises `InputError`, which names the set `name`, if nodes have fewer than `dimensions`
    coordinates, or more and a cell is not parallel to the x-y plane.
    """
    size = len(next(iter(positions.values())))
    if size < dimensions:
        raise InputError(f"{name!r} needs {dimensions}-D nodes, got positions with {size} coordinates")
    labels, index = np.unique(nodes, return_inverse=True)
    table = np.array([positions[int(label)] if label >= 0 else np.zeros(size) for label in labels])
    by_cell = table[index.reshape(nodes.shape)]
    if size > dimensions:
        _require_flat(name, nodes, by_cell)
    flat: FloatArray = by_cell[..., :dimensions]
    return flat


def _require_flat(name: str, nodes: IntArray, corners: FloatArray) -> None:
    """Raise `InputError`, which names the set `name`, if z differs within a cell by more than 1e-9 of its size.

    `nodes` (n_cells, n_nodes) are labels, -1 where a row has ended, and `corners` positions (n_cells, n_nodes, 3).
    """
    used = nodes >= 0
    high = np.where(used, corners[..., 2], -np.inf).max(axis=1)
    low = np.where(used, corners[..., 2], np.inf).min(axis=1)
    first = corners[:, :1, :2]
    span = np.where(used, np.linalg.norm(corners[..., :2] - first, axis=2), 0.0).max(axis=1)
    tilted = high - low > 1e-9 * span
    if tilted.any():
        e = int(np.argmax(tilted))
        labels = ", ".join(map(str, nodes[e][used[e]]))
        raise InputError(
            f"element {e + 1} of {name!r} is not parallel to the x-y plane: nodes {labels} have z from {low[e]:g} to"
            f" {high[e]:g}; turn the model so that it lies in x-y, or make it a shell"
        )
