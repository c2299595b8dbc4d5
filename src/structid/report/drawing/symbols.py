"""Springs, dashpots, friction pads, arrows and supports as polylines; a row of NaN lifts the pen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from structid.arrays import FloatArray

_LIFT = np.array([[np.nan, np.nan]])


def joined(paths: Iterable[FloatArray]) -> FloatArray:
    """`paths` as one, with the pen lifted in between, (n, 2)."""
    parts: list[FloatArray] = []
    for path in paths:
        parts += [np.asarray(path, dtype=np.float64), _LIFT]
    return np.concatenate(parts[:-1]) if parts else np.zeros((0, 2))


def sampled(path: FloatArray, step: float) -> FloatArray:
    """Points along `path`, no farther apart than `step`, without the lifts of the pen."""
    start, end = path[:-1], path[1:]
    drawn = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    parts = [path[np.isfinite(path).all(axis=1)]]
    for a, b in zip(start[drawn], end[drawn], strict=True):
        count = min(int(np.hypot(*(b - a)) / step) + 1, 400)
        parts.append(a + (b - a) * np.linspace(0.0, 1.0, count + 1)[:, None])
    return np.concatenate(parts)


def unit(vector: FloatArray, default: Sequence[float] = (1.0, 0.0)) -> FloatArray:
    """`vector` at length 1, or `default` where it has none."""
    length = float(np.hypot(*vector))
    return np.asarray(vector) / length if length > 1e-12 else np.array(default)


def across(vector: FloatArray) -> FloatArray:
    """`vector` turned by 90 degrees to the left."""
    return np.array([-vector[1], vector[0]])


def _placed(local: Sequence[tuple[float, float]], start: FloatArray, along: FloatArray) -> FloatArray:
    table = np.array(local)
    return start + table[:, :1] * along + table[:, 1:] * across(along)


def spring(start: FloatArray, end: FloatArray, height: float) -> FloatArray:
    """A zigzag of half height `height` between straight leads."""
    along, length, first, last = _body(start, end, 6 * height)
    steps = np.linspace(first, last, 8)
    teeth = height * np.array([0, 1, -1, 1, -1, 1, -1, 0])
    return _placed([(0.0, 0.0), *zip(steps.tolist(), teeth.tolist(), strict=True), (length, 0.0)], start, along)


def dashpot(start: FloatArray, end: FloatArray, height: float) -> FloatArray:
    """A cup open towards the start, with a piston in it."""
    along, length, first, last = _body(start, end, 4 * height)
    middle = 0.5 * (first + last)
    cup = [(first, height), (last, height), (last, -height), (first, -height)]
    piston = [(middle, 0.7 * height), (middle, -0.7 * height)]
    lines = [[(0.0, 0.0), (middle, 0.0)], piston, cup, [(last, 0.0), (length, 0.0)]]
    return joined(_placed(line, start, along) for line in lines)


def friction(start: FloatArray, end: FloatArray, height: float) -> FloatArray:
    """Two pads that slide on each other."""
    along, length, first, last = _body(start, end, 4 * height)
    gap = 0.3 * height
    upper = [(0.0, 0.0), (first, 0.0), (first, gap), (last, gap)]
    lower = [(first, -gap), (last, -gap), (last, 0.0), (length, 0.0)]
    middle = 0.5 * (first + last)
    block = [(middle - height, gap), (middle - height, height), (middle + height, height), (middle + height, gap)]
    return joined(_placed(line, start, along) for line in (upper, lower, block))


def spiral(centre: FloatArray, radius: float) -> FloatArray:
    """A spiral spring of a rotation."""
    angle = np.linspace(0.0, 4.0 * np.pi, 49)
    size = radius * (0.2 + 0.8 * angle / angle[-1])
    return centre + size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def ground(base: FloatArray, along: FloatArray, height: float) -> FloatArray:
    """A wall at `base` with three strokes behind it; `along` points into the wall."""
    wall = [(0.0, -1.4 * height), (0.0, 1.4 * height)]
    strokes = [[(0.0, t * height), (0.8 * height, (t - 0.7) * height)] for t in (-0.5, 0.45, 1.4)]
    return joined(_placed(line, base, along) for line in (wall, *strokes))


def disc(centre: FloatArray, radius: float) -> FloatArray:
    """A closed circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def square(centre: FloatArray, half: float) -> FloatArray:
    """A closed square."""
    return centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])


def triangle(tip: FloatArray, size: float) -> FloatArray:
    """A closed triangle below `tip`."""
    return tip + size * np.array([[0.0, 0.0], [0.6, -1.0], [-0.6, -1.0], [0.0, 0.0]])


def arrow_head(tip: FloatArray, along: FloatArray, size: float) -> FloatArray:
    """A closed triangle whose point is `tip`."""
    return _placed([(0.0, 0.0), (-size, 0.4 * size), (-size, -0.4 * size), (0.0, 0.0)], tip, along)


def turning_arrow(centre: FloatArray, sense: int, radius: float, head: float) -> tuple[FloatArray, FloatArray]:
    """Shaft and head of an arrow that turns about `centre`, against the clock for `sense` +1."""
    angle = sense * np.linspace(-0.25 * np.pi, 1.15 * np.pi, 30)
    shaft = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    along = sense * np.array([-np.sin(angle[-1]), np.cos(angle[-1])])
    return shaft, arrow_head(shaft[-1] + head * along, along, head)


def _body(start: FloatArray, end: FloatArray, wanted: float) -> tuple[FloatArray, float, float, float]:
    """Direction and length from `start` to `end`, and where a symbol of length `wanted` begins and ends."""
    length = float(np.hypot(*(end - start)))
    size = min(wanted, 0.6 * length)
    return unit(end - start), length, 0.5 * (length - size), 0.5 * (length + size)
