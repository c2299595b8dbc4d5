"""A finite element mesh as a value: labelled nodes, cells by type, and named groups of cells and of nodes."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray, locked
from structid.errors import InputError
from structid.structure.elements.cells.isoparametric import CELLS

#: Dimension of each cell type that elements can be made of.
CELL_DIMENSIONS = {"vertex": 0, "line": 1, "line3": 1, **{name: made.corners.shape[1] for name, made in CELLS.items()}}
#: Number of corners of each, where there are nodes besides.
_CORNERS = {"line3": 2, **{name: CELLS[name.rstrip("0123456789")].n_nodes for name in CELLS}}


@dataclass(frozen=True, eq=False)
class CellBlock:
    """Cells of one type.

    Attributes
    ----------
    kind : str
        Such as ``triangle`` or ``hexahedron20``; see `CELL_DIMENSIONS`.
    nodes : (n_cells, n_nodes) int array
        Node labels, numbered as in VTK.
    """

    kind: str
    nodes: IntArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """Nodes, cells and groups, as read from a file.

    Attributes
    ----------
    labels : (n_nodes,) int array
        Node numbers of the file.
    positions : (n_nodes, 3) float array
        m.
    blocks : tuple of CellBlock
    groups : mapping of name to tuple of int arrays
        Cells of each group: one array of rows for each block.
    node_groups : mapping of name to int array
        Labels of the nodes of each node set.
    source : str
        Where it comes from, for messages.
    """

    labels: IntArray
    positions: FloatArray
    blocks: tuple[CellBlock, ...]
    groups: Mapping[str, tuple[IntArray, ...]]
    node_groups: Mapping[str, IntArray]
    source: str = "the mesh"

    @cached_property
    def nodes(self) -> dict[int, FloatArray]:
        """Position of each node by its label."""
        return dict(zip(self.labels.tolist(), self.positions, strict=True))

    @cached_property
    def dimension(self) -> int:
        """Largest dimension of its cells."""
        return max((CELL_DIMENSIONS.get(block.kind, 0) for block in self.blocks), default=0)

    def chosen(self, group: str | None = None) -> list[tuple[CellBlock, IntArray]]:
        """Blocks with the rows of `group`; all cells of the largest dimension without one."""
        if group is None:
            every = [(block, np.arange(len(block.nodes))) for block in self.blocks]
            return [pair for pair in every if CELL_DIMENSIONS.get(pair[0].kind, 3) == self.dimension]
        if group not in self.groups:
            self._raise_missing(group, self.groups, "group of cells")
        return [(b, rows) for b, rows in zip(self.blocks, self.groups[group], strict=True) if len(rows)]

    def cells(self, group: str | None = None) -> IntArray:
        """Node table of the cells of `group`, rows padded with -1 where it mixes cell types.

        Raises
        ------
        InputError
            If there is no such group, or its cells are of a type that no element takes.
        """
        tables = []
        for block, rows in self.chosen(group):
            if block.kind not in CELL_DIMENSIONS:
                raise InputError(
                    f"cells of type {block.kind!r} in {self.source} cannot be used; mesh with one of"
                    f" {', '.join(CELL_DIMENSIONS)}"
                )
            tables.append(block.nodes[rows])
        if not tables:
            raise InputError(f"{self.source} holds no cells" + (f" in group {group!r}" if group else ""))
        width = max(table.shape[1] for table in tables)
        padded = [np.pad(t, ((0, 0), (0, width - t.shape[1])), constant_values=-1) for t in tables]
        return locked(np.concatenate(padded), np.int64)

    def group_nodes(self, group: str) -> IntArray:
        """Labels of the nodes of a node set, or of the cells of a group."""
        if group in self.node_groups:
            return self.node_groups[group]
        if group not in self.groups:
            self._raise_missing(group, {**self.groups, **self.node_groups}, "group")
        nodes = [b.nodes[rows].ravel() for b, rows in self.chosen(group)]
        if not nodes:
            raise InputError(f"group {group!r} of {self.source} is empty; put cells into it in the mesher")
        return np.unique(np.concatenate(nodes))

    def nodes_at(self, ranges: Mapping[str, tuple[float, float]]) -> IntArray:
        """Labels of the nodes whose coordinates lie in `ranges`, such as {"x": (0.0, 0.0)}, m.

        Ends count within a millionth of the mesh's size.
        """
        inside = np.ones(len(self.labels), dtype=bool)
        slack = 1e-6 * float(np.ptp(self.positions, axis=0).max())
        for axis, (low, high) in ranges.items():
            values = self.positions[:, "xyz".index(axis)]
            inside &= (values >= low - slack) & (values <= high + slack)
        return self.labels[inside]

    def nearest(self, position: ArrayLike, among: Iterable[int] | None = None) -> tuple[int, float, float]:
        """The node nearest to `position` (3,), m: its label, the distance, and the size of the cells there.

        Parameters
        ----------
        position : (3,) float array
        among : iterable of int, optional
            Labels to choose from; all by default.
        """
        place = np.arange(len(self.labels))
        if among is not None:
            place = np.flatnonzero(np.isin(self.labels, list(among)))
        distance = np.linalg.norm(self.positions[place] - np.asarray(position, dtype=np.float64), axis=1)
        best = int(np.argmin(distance))
        label = int(self.labels[place[best]])
        return label, float(distance[best]), self.size_at(label)

    def size_at(self, label: int) -> float:
        """The longest side of the cells of the mesh's dimension at a node, m; 0 where there is none."""
        longest = 0.0
        for block, _ in self.chosen():
            own = block.nodes[(block.nodes == label).any(axis=1)][:, : _CORNERS.get(block.kind)]
            for row in own:
                corners = np.array([self.nodes[int(n)] for n in row])
                longest = max(longest, float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()))
        return longest

    def _raise_missing(self, group: str, known: Iterable[str], word: str) -> None:
        names = list(known)
        near = difflib.get_close_matches(group, names, 1, 0.0)
        have = (
            f"the nearest is {near[0]!r}; it has {', '.join(names)}" if near else "it has none; name them in the mesher"
        )
        raise InputError(f"there is no {word} {group!r} in {self.source}; {have}")
