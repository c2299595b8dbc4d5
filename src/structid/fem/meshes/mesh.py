"""Meshes: nodes, blocks of cells and named groups, and what is wrong with one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.fem.elements.cells import CELLS
from structid.fem.meshes.deck_parts import DeckPart, choose_parts
from structid.fem.supports import RigidLink

#: Dimension of each cell type that elements can be made of.
CELL_DIMENSIONS = {"vertex": 0, "line": 1, "line3": 1, **{name: made.corners.shape[1] for name, made in CELLS.items()}}
#: Number of corners of each, where there are nodes besides.
_CORNERS = {"line3": 2, **{name: CELLS[name.rstrip("0123456789")].n_nodes for name in CELLS}}
#: Distance over the mesh's size below which two nodes are one place.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class CellBlock:
    """Cells of one type.

    Attributes
    ----------
    kind : str
        Such as ``triangle`` or ``hexahedron20``; see `CELL_DIMENSIONS`.
    nodes : (n_cells, n_nodes) int array
        Node labels, numbered as in VTK.
    is_beside : bool
        Whether they are masses, springs and the like, which the mesh has as parts too.
    """

    kind: str
    nodes: IntArray
    is_beside: bool = False


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
    parts : tuple of DeckPart
        Masses, springs, rigid elements and the like that the file has beside its cells.
    notes : tuple of str
        Sentences on contents of the file that the mesh lacks.
    displacement_axes : mapping of int to (3, 3) float array
        Directions of motion as rows of the nodes that have their own in the file; those of the mesh are global.
    cells_are_elements : bool
        Whether cells of lower dimension are elements too (bars of a deck), not edges to choose nodes by.
    points : mapping of int to (3,) float array
        Positions of nodes that only parts use: reference points of an assembly.
    carriers : mapping of int to int
        Node of the file to which each node at the end of an offset is joined; see `offset_cells`.
    """

    labels: IntArray
    positions: FloatArray
    blocks: tuple[CellBlock, ...]
    groups: Mapping[str, tuple[IntArray, ...]]
    node_groups: Mapping[str, IntArray]
    source: str = "the mesh"
    parts: tuple[DeckPart, ...] = ()
    notes: tuple[str, ...] = ()
    displacement_axes: Mapping[int, FloatArray] = field(default_factory=dict)
    cells_are_elements: bool = False
    points: Mapping[int, FloatArray] = field(default_factory=dict)
    carriers: Mapping[int, int] = field(default_factory=dict)

    @cached_property
    def nodes(self) -> dict[int, FloatArray]:
        """Position of each node by its label."""
        return dict(zip(self.labels.tolist(), self.positions, strict=True))

    @cached_property
    def dimension(self) -> int:
        """Largest dimension of its cells."""
        return max((CELL_DIMENSIONS.get(block.kind, 0) for block in self.blocks if not block.is_beside), default=0)

    def chosen(self, group: str | None = None) -> list[tuple[CellBlock, IntArray]]:
        """Blocks of cells that have some in `group`, each with the row indices (n_chosen,) of these.

        If `group` is None, all cells of the largest dimension. Raises `InputError` if there is no such group.
        """
        if group is None:
            all_cells = [(block, np.arange(len(block.nodes))) for block in self.blocks]
            return [pair for pair in all_cells if _dimension_of(pair[0]) == self.dimension]
        if group not in self.groups:
            self._raise_missing(group, self.groups, "group of cells")
        return [(b, rows) for b, rows in zip(self.blocks, self.groups[group], strict=True) if len(rows)]

    def cells(self, group: str | None = None) -> IntArray:
        """Node labels of the cells of `group`, (n_cells, width), padded with -1 where it mixes cell types.

        If None, of all cells of the largest dimension.

        Raises
        ------
        InputError
            If there is no such group or cell, or its cells are of a type that no element takes.
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
        """Sorted labels (n_nodes,) of the nodes of a node set, or else of the cells of a group.

        If cells are offset, these are the nodes that carry them.

        Raises
        ------
        InputError
            If there is no such group, or it is empty.
        """
        if group in self.node_groups:
            return self.node_groups[group]
        if group not in self.groups:
            self._raise_missing(group, {**self.groups, **self.node_groups}, "group")
        nodes = [b.nodes[rows].ravel() for b, rows in self.chosen(group)]
        if not nodes:
            raise InputError(f"group {group!r} of {self.source} is empty; put cells into it in the mesher")
        return self.carried_by(np.concatenate(nodes))

    def carried_by(self, labels: IntArray) -> IntArray:
        """`labels` (n_labels,) with nodes at the ends of offsets replaced by those that carry them.

        The result is sorted, with each label once.
        """
        unique: IntArray = np.unique(labels)
        if self.carriers:
            unique = np.unique([self.carriers.get(label, label) for label in unique.tolist()]).astype(np.int64)
        return unique

    def nodes_at(self, ranges: Mapping[str, tuple[float, float]]) -> IntArray:
        """Labels of the nodes with coordinates (m) in all of `ranges`, such as {"x": (0.0, 0.0)}, in the mesh's order.

        Keys are "x", "y" and "z"; both ends count, widened by a millionth of the mesh's size. Nodes at the ends of
        offsets are left out. Empty if there is none.
        """
        is_inside = ~np.isin(self.labels, list(self.carriers))
        slack = 1e-6 * float(np.ptp(self.positions, axis=0).max())
        for axis, (low, high) in ranges.items():
            values = self.positions[:, "xyz".index(axis)]
            is_inside &= (values >= low - slack) & (values <= high + slack)
        return self.labels[is_inside]

    def nearest(self, position: ArrayLike, among: Iterable[int] | None = None) -> tuple[int, float, float]:
        """Label of the node nearest to `position`, its distance, m, and the longest side of the cells there, m.

        The side is 0 without cells. Nodes at the ends of offsets are left out; in `among` they stand for the nodes that
        carry them.

        Parameters
        ----------
        position : (3,) float array
            m.
        among : iterable of int, optional
            Labels to choose from; all by default.

        Raises
        ------
        InputError
            If there is no node to choose from.
        """
        chosen = ~np.isin(self.labels, list(self.carriers))
        if among is not None:
            chosen &= np.isin(self.labels, self.carried_by(np.array(list(among), dtype=np.int64)))
        rows = np.flatnonzero(chosen)
        if not len(rows):
            raise InputError(
                f"there is no node of {self.source} to choose the nearest from; give other labels in `among`"
            )
        distance = np.linalg.norm(self.positions[rows] - np.asarray(position, dtype=np.float64), axis=1)
        best = int(np.argmin(distance))
        label = int(self.labels[rows[best]])
        return label, float(distance[best]), self.size_at(label)

    def size_at(self, label: int) -> float:
        """The longest side in m of the cells of the mesh's dimension around the node `label`; 0 if there are none.

        Cells at offsets that the node carries count too.
        """
        longest = 0.0
        here = [label, *(made for made, carrier in self.carriers.items() if carrier == label)]
        for block, _ in self.chosen():
            rows = block.nodes[np.isin(block.nodes, here).any(axis=1)][:, : _CORNERS.get(block.kind)]
            for row in rows:
                corners = np.array([self.nodes[int(n)] for n in row])
                longest = max(longest, float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()))
        return longest

    def _raise_missing(self, group: str, existing: Iterable[str], word: str) -> None:
        """Raise `InputError` for a group that is not among `existing`, and name the nearest.

        `word` is the kind of group.
        """
        names = list(existing)
        close = difflib.get_close_matches(group, names, 1, 0.0)
        have = (
            f"the nearest is {close[0]!r}; it has {', '.join(names)}"
            if close
            else "it has none; name them in the mesher"
        )
        raise InputError(f"there is no {word} {group!r} in {self.source}; {have}")


def _dimension_of(block: CellBlock) -> int:
    """Dimension of cells; -1 of masses and springs, and 3 of unknown types, so that they are not overlooked."""
    return -1 if block.is_beside else CELL_DIMENSIONS.get(block.kind, 3)


def duplicate_nodes(mesh: Mesh, parts: Sequence[DeckPart] = ()) -> IntArray:
    """Pairs of labels of nodes with the same position, (n_pairs, 2), the lower first, sorted.

    Only nodes of cells and of `parts` count, and pairs that one of `parts` joins are left out. The same position is to
    1e-9 of the size of the mesh.
    """
    from scipy.spatial import cKDTree

    used = np.isin(mesh.labels, _used_labels(mesh, parts))
    labels, positions = mesh.labels[used], mesh.positions[used]
    if len(labels) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    size = float(np.ptp(positions, axis=0).max())
    pairs = cKDTree(positions).query_pairs(_SAME * size, output_type="ndarray")
    label_pairs: IntArray = np.sort(labels[pairs], axis=1)
    joined = {pair for part in parts for pair in part.joined_pairs}
    apart = np.array([pair not in joined for pair in map(tuple, label_pairs.tolist())], dtype=bool)
    label_pairs = label_pairs[apart]
    return label_pairs[np.lexsort(label_pairs.T[::-1])]


def orphan_nodes(mesh: Mesh, parts: Sequence[DeckPart] = ()) -> IntArray:
    """Labels of nodes that belong to no cell and none of `parts`."""
    return np.setdiff1d(mesh.labels, _used_labels(mesh, parts))


def require_sound(
    mesh: Mesh, drop_orphans: bool = False, duplicates: str = "refuse", take: str | Sequence[str] = ()
) -> Mesh:
    """The mesh after checks, with orphan nodes dropped and duplicate ones merged on demand, and cells at their offsets.

    Parameters
    ----------
    mesh : Mesh
    drop_orphans : bool
        True if nodes without a cell are left out instead of refused.
    duplicates : {"refuse", "merge", "keep"}
        Treatment of nodes with one position: an error, the lower label for both, or as they are, for cracks and joints,
        where the parts are meant to move apart.
    take : "all" or kinds
        Kinds of parts beside the cells that are taken: their nodes belong to them, and nodes at one place that one of
        them joins stay apart. Only offsets of these kinds move cells.

    Raises
    ------
    InputError
        If a label stands twice, nodes lie at one place (``refuse``) or belong to no cell (unless `drop_orphans`), cells
        name a node that is not there, a kind in `take` is not in the deck or has no element, or a cell has two offsets.
    """
    parts = choose_parts(mesh.parts, take, mesh.source)
    mesh = _add_reference_points(mesh, parts)
    values, counts = np.unique(mesh.labels, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"node {values[counts > 1][0]} stands twice in {mesh.source}; number the nodes anew")
    missing = np.setdiff1d(_used_labels(mesh), mesh.labels)
    if len(missing):
        raise InputError(
            f"cells of {mesh.source} name {_list_labels(missing)}, which it does not have; export all nodes of the cells"
        )
    if duplicates != "keep":
        pairs = duplicate_nodes(mesh, parts)
        if len(pairs) and duplicates == "refuse":
            named = ", ".join(f"{a} and {b}" for a, b in pairs[:5])
            raise InputError(
                f"nodes {named} of {mesh.source} lie at one place ({len(pairs)} pairs in all), so that the parts are not"
                ' joined there; merge them in the mesher, or set `duplicate_nodes` to "merge", or to "keep" if the'
                " parts are meant to be apart"
            )
        mesh = _merge_nodes(mesh, pairs)
        parts = choose_parts(mesh.parts, take, mesh.source)
    orphans = orphan_nodes(mesh, parts)
    if len(orphans):
        if not drop_orphans:
            lone = set(orphans.tolist())
            kinds = dict.fromkeys(part.kind for part in mesh.parts if part.nodes & lone)
            words = f", only to {', '.join(kinds)}, which `take` would take" if kinds else ""
            raise InputError(
                f"{_list_labels(orphans)} of {mesh.source} {'belongs' if len(orphans) == 1 else 'belong'} to no cell{words};"
                ' delete them in the mesher, or set `orphan_nodes` to "drop"'
            )
        mesh = _without_nodes(mesh, orphans)
    return offset_cells(mesh, [part for part in parts if part.offsets])


def offset_cells(mesh: Mesh, parts: Sequence[DeckPart]) -> Mesh:
    """The mesh with the cells of `parts` where their offsets put them; itself without parts.

    Each end that stands off its node gets a new node, which a rigid link joins to that of the file; the links are ties
    of the part, in place of its offsets. Ends at one place that one node carries share their node. Raises `InputError`
    if a cell has two offsets.
    """
    if not parts:
        return mesh
    tables = [block.nodes.copy() for block in mesh.blocks]
    first = max(int(mesh.labels.max(initial=0)), *mesh.points, 0) + 1
    carriers, positions, made_at = dict(mesh.carriers), list[FloatArray](), dict[tuple[int, ...], int]()
    size = float(np.ptp(mesh.positions, axis=0).max()) or 1.0
    replaced: dict[int, DeckPart] = {}
    moved: set[tuple[int, int]] = set()
    for part in parts:
        ties = list(part.ties)
        for offset in part.offsets:
            for row, arms in zip(offset.rows.tolist(), offset.arms, strict=True):
                if (offset.block, row) in moved:
                    cell = ", ".join(map(str, mesh.blocks[offset.block].nodes[row].tolist()))
                    raise InputError(
                        f"the cell of nodes {cell} of {mesh.source} has two offsets, as of two sections ({part.kind}); give it one"
                    )
                moved.add((offset.block, row))
                for corner, arm in enumerate(arms):
                    node = int(tables[offset.block][row, corner])
                    if not arm.any():
                        continue
                    key = (node, *np.round(arm / (_SAME * size)).astype(np.int64).tolist())
                    if key not in made_at:
                        made_at[key] = label = first + len(positions)
                        positions.append(mesh.nodes[node] + arm)
                        carriers[label] = node
                        ties.append(RigidLink(f"offset {node}", node, [label]))
                    tables[offset.block][row, corner] = made_at[key]
        replaced[id(part)] = replace(part, ties=tuple(ties), offsets=())
    labels = np.arange(first, first + len(positions), dtype=np.int64)
    return replace(
        mesh,
        labels=np.concatenate([mesh.labels, labels]),
        positions=np.concatenate([mesh.positions, np.array(positions).reshape(-1, 3)]),
        blocks=tuple(replace(block, nodes=table) for block, table in zip(mesh.blocks, tables, strict=True)),
        parts=tuple(replaced.get(id(part), part) for part in mesh.parts),
        carriers=carriers,
    )


def _used_labels(mesh: Mesh, parts: Sequence[DeckPart] = ()) -> IntArray:
    """Labels (n,) of the nodes of cells and of `parts`."""
    beside = np.array(sorted(node for part in parts for node in part.nodes), dtype=np.int64)
    return np.unique(np.concatenate([beside, *(block.nodes.ravel() for block in mesh.blocks)]))


def _add_reference_points(mesh: Mesh, parts: Sequence[DeckPart]) -> Mesh:
    """The mesh with those of its reference points that `parts` use added as nodes; itself if they use none."""
    labels = set(mesh.labels.tolist())
    new = sorted(node for node in set().union(*(part.nodes for part in parts)) - labels if node in mesh.points)
    if not new:
        return mesh
    positions = np.concatenate([mesh.positions, [mesh.points[node] for node in new]])
    return replace(mesh, labels=np.concatenate([mesh.labels, np.array(new)]), positions=positions)


def _merge_nodes(mesh: Mesh, pairs: IntArray) -> Mesh:
    """The mesh with both nodes of each of `pairs` merged into the one with the lower label.

    `pairs` (n_pairs, 2) are labels with the lower first; cells, node groups and parts are renumbered, and the other
    nodes dropped. Without pairs it is the mesh itself.
    """
    label_of = {label: label for label in mesh.labels.tolist()}
    for low, high in pairs.tolist():
        label_of[high] = min(label_of[high], label_of[low])
    for label in sorted(label_of):
        label_of[label] = label_of[label_of[label]]
    if not len(pairs):
        return mesh
    blocks = tuple(
        replace(b, nodes=np.array([[label_of[n] for n in row] for row in b.nodes.tolist()])) for b in mesh.blocks
    )
    groups = {name: np.unique([label_of[n] for n in nodes.tolist()]) for name, nodes in mesh.node_groups.items()}
    gone = np.array([label for label, other in label_of.items() if label != other])
    parts = tuple(part.renumbered({label: label_of[label] for label in gone.tolist()}) for part in mesh.parts)
    return _without_nodes(replace(mesh, blocks=blocks, node_groups=groups, parts=parts), gone)


def _without_nodes(mesh: Mesh, labels: IntArray) -> Mesh:
    """The mesh without the nodes `labels` (n,), which its groups lose too; cells are not changed."""
    keep = ~np.isin(mesh.labels, labels)
    groups = {name: np.setdiff1d(nodes, labels) for name, nodes in mesh.node_groups.items()}
    return replace(mesh, labels=mesh.labels[keep], positions=mesh.positions[keep], node_groups=groups)


def describe_unassigned_cells(mesh: Mesh, tables: list[IntArray], lower: bool = False) -> str | None:
    """A phrase on the number, types and groups of the cells that no element set uses; None if there are none.

    Parameters
    ----------
    mesh : Mesh
    tables : list of int arrays
        Node labels of the elements of each set, (n_elements, n_nodes), -1 where a row has ended.
    lower : bool
        True if cells of lower dimension than the mesh are checked, instead of those of its own dimension.
    """
    used = {tuple(sorted(n for n in row if n >= 0)) for table in tables for row in table.tolist()}
    rows_of = {}
    for number, block in enumerate(mesh.blocks):
        if 0 <= _dimension_of(block) < mesh.dimension if lower else _dimension_of(block) >= mesh.dimension:
            free = [i for i, row in enumerate(block.nodes.tolist()) if tuple(sorted(row)) not in used]
            if free:
                rows_of[number] = free
    if not rows_of:
        return None
    count = sum(len(rows) for rows in rows_of.values())
    names = [
        n for n, g in mesh.groups.items() if any(np.isin(g[number], rows).any() for number, rows in rows_of.items())
    ]
    kinds = dict.fromkeys(mesh.blocks[number].kind for number in rows_of)
    where = f", in {'groups' if len(names) > 1 else 'group'} {', '.join(names)}" if names else ""
    return f"{count} cells ({', '.join(kinds)}){where}"


def _list_labels(labels: IntArray) -> str:
    few = ", ".join(map(str, labels[:5]))
    return f"node{'s' if len(labels) > 1 else ''} {few}" + (f" and {len(labels) - 5} more" if len(labels) > 5 else "")
