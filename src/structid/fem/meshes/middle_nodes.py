"""Nodes in the middle of sides that a deck leaves out of quadratic elements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.meshes.deck_parts import DeckPart
from structid.fem.supports import MiddleNode

#: Corners at the ends of each side of Nastran's elements, in the order of their nodes.
EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "CTRIA6": ((0, 1), (1, 2), (2, 0)),
    "CQUAD8": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "CTETRA": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "CPYRAM": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
    "CPENTA": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3)),
    "CHEXA": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 5), (2, 6), (3, 7), (4, 5), (5, 6), (6, 7), (7, 4)),
}


class MiddleNodes:
    """New nodes for sides without one; elements that share such a side share the node."""

    def __init__(self, labels: IntArray) -> None:
        self._next = int(labels.max(initial=0)) + 1
        self._nodes: dict[tuple[int, int], int] = {}
        self._cells = 0

    def completed(self, table: IntArray, corners: int, edges: Sequence[tuple[int, int]]) -> IntArray:
        """Copy of the node table (n_elements, n_nodes) with new mid-side nodes where it has none (0 or less).

        The first `corners` columns are corners; `edges` are the pairs of corner columns of the columns behind them.
        """
        completed = table.copy()
        lacking = np.flatnonzero((table <= 0).any(axis=1))
        self._cells += len(lacking)
        for row in lacking.tolist():
            for side, (start, end) in enumerate(edges, corners):
                if table[row, side] <= 0:
                    completed[row, side] = self._node(int(table[row, start]), int(table[row, end]))
        return completed

    def _node(self, start: int, end: int) -> int:
        """Label of the mid-side node between the corners `start` and `end`, in either order; made when first asked for."""
        key = (min(start, end), max(start, end))
        if key not in self._nodes:
            self._nodes[key] = self._next
            self._next += 1
        return self._nodes[key]

    def with_positions(self, labels: IntArray, positions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Labels (n,) and positions (n, 3) with those of the new nodes appended, each at the middle of its side.

        New nodes of sides whose corners are not in `labels` are left out.
        """
        if not self._nodes:
            return labels, positions
        row_of = {label: row for row, label in enumerate(labels.tolist())}
        ends_of = {label: ends for ends, label in self._nodes.items() if set(ends) <= set(row_of)}
        middles = [positions[[row_of[end] for end in ends]].mean(axis=0) for ends in ends_of.values()]
        return np.concatenate([labels, np.array(list(ends_of), dtype=np.int64)]), np.concatenate([positions, middles])

    def parts(self) -> list[DeckPart]:
        """Ties that keep sides with new nodes straight, as a part that the mesh always needs; empty without new nodes."""
        if not self._nodes:
            return []
        ties = tuple(MiddleNode(f"middle {label}", label, ends) for ends, label in self._nodes.items())
        return [DeckPart("mid-side node", len(ties), ties=ties, is_needed=True)]
