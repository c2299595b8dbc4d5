"""Small distorted meshes of every cell type, as node positions and node tables."""

import numpy as np

from structid.fem.elements.cells import CELLS

_SPLITS = {"triangle": [[0, 1, 2], [0, 2, 3]], "quad": [[0, 1, 2, 3]]}
#: Six tetrahedra around the diagonal 0-6 of a cube, and two wedges.
_TETRAHEDRA = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
_SPLITS |= {"hexahedron": [list(range(8))], "tetra": _TETRAHEDRA, "wedge": [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]]}
_SPLITS["pyramid"] = [
    [0, 1, 2, 3, 8],
    [7, 6, 5, 4, 8],
    [0, 4, 5, 1, 8],
    [3, 2, 6, 7, 8],
    [0, 3, 7, 4, 8],
    [1, 5, 6, 2, 8],
]
_LINEAR = {"triangle6": "triangle", "quad8": "quad", "quad9": "quad", "tetra10": "tetra", "wedge15": "wedge"}
_LINEAR |= {"hexahedron20": "hexahedron", "hexahedron27": "hexahedron"}


def box(kind, shape, size, jitter=0.0, seed=0):
    """Positions (n_nodes, d) and node table of a box in cells of `kind`; inner nodes are moved by `jitter` cells."""
    axes = [np.linspace(0, length, n + 1) for n, length in zip(shape, size, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    cells = np.array(size) / shape
    inner = np.all((grid > 1e-9) & (grid < np.array(size) - 1e-9), axis=-1)
    moves = np.random.default_rng(seed).uniform(-jitter, jitter, grid.shape) * cells
    points = (grid + moves * inner[..., None]).reshape(-1, len(shape))
    number = np.arange(len(points)).reshape([n + 1 for n in shape])
    low, high = slice(None, -1), slice(1, None)
    square = [(low, low), (high, low), (high, high), (low, high)]
    corners = square if len(shape) == 2 else [(*s, z) for z in (low, high) for s in square]
    blocks = np.stack([number[c] for c in corners], axis=-1).reshape(-1, len(corners))
    if kind == "pyramid":  # six around the middle of each box
        middles = len(points) + np.arange(len(blocks))
        points, blocks = np.concatenate([points, points[blocks].mean(axis=1)]), np.column_stack([blocks, middles])
    table = np.concatenate([blocks[:, split] for split in _SPLITS[_LINEAR.get(kind, kind)]])
    return with_middles(points, table, kind) if kind in _LINEAR else (points, table)


def with_middles(points, table, kind):
    """The same cells with nodes in the middle of their sides, faces and volumes, as `kind` has them."""
    shape, linear = CELLS[kind], CELLS[_LINEAR[kind]]
    rows, known, points = [table], {}, list(points)
    for share in linear.values(shape.corners[table.shape[1] :]):
        own = np.flatnonzero(share > 1e-9)
        column = []
        for nodes in np.sort(table[:, own], axis=1).tolist():
            if tuple(nodes) not in known:
                known[tuple(nodes)] = len(points)
                points.append(np.mean([points[n] for n in nodes], axis=0))
            column.append(known[tuple(nodes)])
        rows.append(np.array(column)[:, None])
    return np.array(points), np.concatenate(rows, axis=1)
