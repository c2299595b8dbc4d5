"""Small distorted meshes of every cell type, as node positions and node tables."""

import numpy as np

from structid.structure.elements.isoparametric import cell_shape

_SPLITS = {"triangle": [[0, 1, 2], [0, 2, 3]], "quad": [[0, 1, 2, 3]]}
#: Six tetrahedra around the diagonal 0-6 of a cube, and two wedges.
_TETRAHEDRA = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
_SPLITS |= {"hexahedron": [list(range(8))], "tetra": _TETRAHEDRA, "wedge": [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]]}
_LINEAR = {"triangle6": "triangle", "quad8": "quad", "tetra10": "tetra", "hexahedron20": "hexahedron"}


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
    table = np.concatenate([blocks[:, split] for split in _SPLITS[_LINEAR.get(kind, kind)]])
    return with_middles(points, table, kind) if kind in _LINEAR else (points, table)


def with_middles(points, table, kind):
    """The same cells with nodes in the middle of their sides."""
    shape = cell_shape(kind)
    corners = shape.corners[: table.shape[1]]
    rows, known, points = [table], {}, list(points)
    for middle in shape.corners[table.shape[1] :]:
        distance = np.linalg.norm((corners[:, None] + corners[None]) / 2 - middle, axis=2)
        a, b = next((a, b) for a, b in np.argwhere(distance < 1e-12) if a < b and _is_edge(corners, a, b))
        column = []
        for pair in np.sort(table[:, [a, b]], axis=1).tolist():
            if tuple(pair) not in known:
                known[tuple(pair)] = len(points)
                points.append((points[pair[0]] + points[pair[1]]) / 2)
            column.append(known[tuple(pair)])
        rows.append(np.array(column)[:, None])
    return np.array(points), np.concatenate(rows, axis=1)


def _is_edge(corners, a, b):
    """In a cube or square the corners of an edge differ in one coordinate; any two of a simplex make an edge."""
    return len(corners) in (3, len(corners[0]) + 1) or (corners[a] != corners[b]).sum() == 1
