"""What can be wrong with a mesh as a whole, told by node and with the remedy."""

from __future__ import annotations

import numpy as np

from structid.arrays import IntArray
from structid.errors import InputError
from structid.structure.meshes.mesh import CELL_DIMENSIONS, CellBlock, Mesh

#: Distance over the mesh's size below which two nodes are one place.
_SAME = 1e-9


def duplicate_nodes(mesh: Mesh) -> IntArray:
    """Pairs of labels of nodes of cells that lie at one place, (n_pairs, 2)."""
    from scipy.spatial import cKDTree

    used = np.isin(mesh.labels, _used(mesh))
    labels, positions = mesh.labels[used], mesh.positions[used]
    if len(labels) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    size = float(np.ptp(positions, axis=0).max())
    pairs = cKDTree(positions).query_pairs(_SAME * size, output_type="ndarray")
    found: IntArray = np.sort(labels[pairs], axis=1)
    return found[np.lexsort(found.T[::-1])]


def orphan_nodes(mesh: Mesh) -> IntArray:
    """Labels of nodes that belong to no cell."""
    return np.setdiff1d(mesh.labels, _used(mesh))


def require_sound(mesh: Mesh, drop_orphans: bool = False, duplicates: str = "refuse") -> Mesh:
    """`mesh`, after the checks; with what was asked to be repaired.

    Parameters
    ----------
    mesh : Mesh
    drop_orphans : bool
        Whether nodes without a cell are left out instead of refused.
    duplicates : {"refuse", "merge", "keep"}
        Of nodes at one place: ``keep`` is for cracks and joints, where the parts are meant to move apart.

    Raises
    ------
    InputError
        If nodes repeat, lie at one place or belong to no cell, or cells name a node that is not there.
    """
    values, counts = np.unique(mesh.labels, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"node {values[counts > 1][0]} stands twice in {mesh.source}; number the nodes anew")
    missing = np.setdiff1d(_used(mesh), mesh.labels)
    if len(missing):
        raise InputError(
            f"cells of {mesh.source} name {_listed(missing)}, which it does not have; export all nodes of the cells"
        )
    if duplicates != "keep":
        pairs = duplicate_nodes(mesh)
        if len(pairs) and duplicates == "refuse":
            named = ", ".join(f"{a} and {b}" for a, b in pairs[:5])
            raise InputError(
                f"nodes {named} of {mesh.source} lie at one place ({len(pairs)} pairs in all), so that the parts are not"
                ' joined there; merge them in the mesher, or set `duplicate_nodes` to "merge", or to "keep" if the'
                " parts are meant to be apart"
            )
        mesh = _merged(mesh, pairs)
    orphans = orphan_nodes(mesh)
    if len(orphans):
        if not drop_orphans:
            raise InputError(
                f"{_listed(orphans)} of {mesh.source} {'belongs' if len(orphans) == 1 else 'belong'} to no cell; delete"
                ' them in the mesher, or set `orphan_nodes` to "drop"'
            )
        mesh = _without(mesh, orphans)
    return mesh


def _used(mesh: Mesh) -> IntArray:
    return np.unique(np.concatenate([np.zeros(0, np.int64), *(block.nodes.ravel() for block in mesh.blocks)]))


def _merged(mesh: Mesh, pairs: IntArray) -> Mesh:
    """Nodes at one place as the one with the lowest label."""
    stands = {label: label for label in mesh.labels.tolist()}
    for low, high in pairs.tolist():
        stands[high] = min(stands[high], stands[low])
    for label in sorted(stands):
        stands[label] = stands[stands[label]]
    if not len(pairs):
        return mesh
    blocks = tuple(
        CellBlock(b.kind, np.array([[stands[n] for n in row] for row in b.nodes.tolist()])) for b in mesh.blocks
    )
    groups = {name: np.unique([stands[n] for n in nodes.tolist()]) for name, nodes in mesh.node_groups.items()}
    gone = np.array([label for label, other in stands.items() if label != other])
    merged = Mesh(mesh.labels, mesh.positions, blocks, mesh.groups, groups, mesh.source)
    return _without(merged, gone)


def _without(mesh: Mesh, labels: IntArray) -> Mesh:
    keep = ~np.isin(mesh.labels, labels)
    groups = {name: np.setdiff1d(nodes, labels) for name, nodes in mesh.node_groups.items()}
    return Mesh(mesh.labels[keep], mesh.positions[keep], mesh.blocks, mesh.groups, groups, mesh.source)


def unassigned(mesh: Mesh, tables: list[IntArray]) -> str | None:
    """What cells of the mesh's dimension are in none of the node tables of element sets: in words, or None."""
    used = {tuple(sorted(n for n in row if n >= 0)) for table in tables for row in table.tolist()}
    rows_of = {}
    for place, block in enumerate(mesh.blocks):
        if CELL_DIMENSIONS.get(block.kind, 3) == mesh.dimension:
            free = [i for i, row in enumerate(block.nodes.tolist()) if tuple(sorted(row)) not in used]
            if free:
                rows_of[place] = free
    if not rows_of:
        return None
    count = sum(len(rows) for rows in rows_of.values())
    names = [n for n, g in mesh.groups.items() if any(np.isin(g[place], rows).any() for place, rows in rows_of.items())]
    kinds = dict.fromkeys(mesh.blocks[place].kind for place in rows_of)
    where = f", in {'groups' if len(names) > 1 else 'group'} {', '.join(names)}" if names else ""
    return f"{count} cells ({', '.join(kinds)}){where}"


def _listed(labels: IntArray) -> str:
    few = ", ".join(map(str, labels[:5]))
    return f"node{'s' if len(labels) > 1 else ''} {few}" + (f" and {len(labels) - 5} more" if len(labels) > 5 else "")
