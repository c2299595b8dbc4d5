"""Springs, dashpots, friction pads, arrows and supports as polylines; a row of NaN lifts the pen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray

_LIFT = np.array([[np.nan, np.nan]])
#: Lines of connectors: along from the start over the body, which goes from 0 to 1, to the end; and across.
_ENDS = (-1.0, 0.0, 1.0, 2.0)
_BODIES: dict[str, list[list[tuple[float, float]]]] = {
    "spring": [[(-1, 0), (0, 0), *((k / 7, 1 if k % 2 else -1) for k in range(1, 7)), (1, 0), (2, 0)]],
    "dashpot": [[(-1, 0), (0.5, 0)], [(0.5, 0.7), (0.5, -0.7)], [(0, 1), (1, 1), (1, -1), (0, -1)], [(1, 0), (2, 0)]],
    "friction": [
        [(-1, 0), (0, 0), (0, 0.3), (1, 0.3)],
        [(0, -0.3), (1, -0.3), (1, 0), (2, 0)],
        [(0.25, 0.3), (0.25, 1), (0.75, 1), (0.75, 0.3)],
    ],
}


def joined(paths: Iterable[FloatArray]) -> FloatArray:
    """Single path (n, 2) of several paths (n_i, 2), with a row of NaN between them to lift the pen; (0, 2) if empty."""
    parts: list[FloatArray] = []
    for path in paths:
        parts += [np.asarray(path, dtype=np.float64), _LIFT]
    return np.concatenate(parts[:-1]) if parts else np.zeros((0, 2))


def sampled(path: FloatArray, step: float) -> FloatArray:
    """Points (m, 2) along the lines of `path` (n, 2): its own, and those that divide each line in equal parts.

    Parts are at most `step` long, or a line has 400 of them. Lines at rows of NaN are left out.
    """
    start, end = path[:-1], path[1:]
    drawn = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    parts = [path[np.isfinite(path).all(axis=1)]]
    for a, b in zip(start[drawn], end[drawn], strict=True):
        count = min(int(np.hypot(*(b - a)) / step) + 1, 400)
        parts.append(a + (b - a) * np.linspace(0.0, 1.0, count + 1)[:, None])
    return np.concatenate(parts)


def unit(vector: FloatArray, default: Sequence[float] = (1.0, 0.0)) -> FloatArray:
    """Unit vector (2,) in the direction of `vector`, or `default` if its length is 0."""
    length = float(np.hypot(*vector))
    return np.asarray(vector) / length if length > 1e-12 else np.array(default)


def across(vector: FloatArray) -> FloatArray:
    """Vector (2,) turned by 90 degrees to the left."""
    return np.array([-vector[1], vector[0]])


def _placed(local: ArrayLike, start: FloatArray, along: FloatArray) -> FloatArray:
    table = np.asarray(local, dtype=np.float64)
    return start + table[:, :1] * along + table[:, 1:] * across(along)


def connector(kind: str, start: FloatArray, end: FloatArray, height: float) -> FloatArray:
    """Path (n, 2) of the symbol of a spring, dashpot or friction contact from `start` to `end`, both (2,).

    `kind` is "spring", "dashpot" or "friction"; `height` is half the height of the symbol across its axis; NaN rows
    lift the pen.
    """
    length = float(np.hypot(*(end - start)))
    size = min((6 if kind == "spring" else 4) * height, 0.6 * length)
    body = 0.5 * (length - size), 0.5 * (length + size)
    lines = [np.array(line) for line in _BODIES[kind]]
    outlines = [
        np.column_stack([np.interp(line[:, 0], _ENDS, (0.0, *body, length)), height * line[:, 1]]) for line in lines
    ]
    return joined(_placed(outline, start, unit(end - start)) for outline in outlines)


def spiral(centre: FloatArray, radius: float) -> FloatArray:
    """Path (49, 2) of a spiral spring about `centre`, the symbol of a rotational spring, with outer `radius`.

    `centre` is (2,).
    """
    angle = np.linspace(0.0, 4.0 * np.pi, 49)
    size = radius * (0.2 + 0.8 * angle / angle[-1])
    return centre + size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def ground(base: FloatArray, along: FloatArray, height: float) -> FloatArray:
    """Path of a wall through `base`, at right angles to the unit vector `along`, with three strokes behind it.

    The wall is 2.8 `height` long; `along` points into it. The path is (n, 2) with NaN between strokes; `base` and
    `along` are (2,).
    """
    wall = [(0.0, -1.4 * height), (0.0, 1.4 * height)]
    strokes = [[(0.0, t * height), (0.8 * height, (t - 0.7) * height)] for t in (-0.5, 0.45, 1.4)]
    return joined(_placed(line, base, along) for line in (wall, *strokes))


def disc(centre: FloatArray, radius: float) -> FloatArray:
    """Closed circle about `centre` (2,) as a path (33, 2), in the units of `radius`."""
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def square(centre: FloatArray, half: float) -> FloatArray:
    """Closed square as a path (5, 2) about `centre` (2,); `half` is half its side, in the same unit."""
    return centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])


def triangle(tip: FloatArray, size: float) -> FloatArray:
    """Closed triangle as a path (4, 2) of height `size`, standing below its upper corner `tip` (2,)."""
    return tip + size * np.array([[0.0, 0.0], [0.6, -1.0], [-0.6, -1.0], [0.0, 0.0]])


def arrow_head(tip: FloatArray, along: FloatArray, size: float) -> FloatArray:
    """Closed triangle as a path (4, 2) with its point at `tip`, in the direction of the unit vector `along`, `size` long."""
    return _placed([(0.0, 0.0), (-size, 0.4 * size), (-size, -0.4 * size), (0.0, 0.0)], tip, along)


def turning_arrow(centre: FloatArray, sense: int, radius: float, head: float) -> tuple[FloatArray, FloatArray]:
    """Shaft (30, 2) and closed head (4, 2) of a curved arrow, counterclockwise for `sense` 1, clockwise for -1.

    `centre` (2,) is the centre of the arc, `radius` its radius and `head` the length of the head, in drawing units.
    """
    angle = sense * np.linspace(-0.25 * np.pi, 1.15 * np.pi, 30)
    shaft = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    along = sense * np.array([-np.sin(angle[-1]), np.cos(angle[-1])])
    return shaft, arrow_head(shaft[-1] + head * along, along, head)
