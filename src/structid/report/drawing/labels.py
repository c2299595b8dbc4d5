"""Labels of a drawing, placed so that none covers another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Label:
    """A text wanted near `anchor`, away from it in the direction `away`."""

    text: str
    anchor: FloatArray
    away: FloatArray
    colour: str


def place(
    wanted: Iterable[Label], character: tuple[float, float], gap: float, obstacles: FloatArray
) -> tuple[list[tuple[Label, FloatArray]], int]:
    """Labels placed without overlap, each with the centre of its text, and the number of labels left out.

    Of the free positions, the one that covers the fewest obstacles is taken.

    Parameters
    ----------
    wanted : sequence of Label
        In order of importance.
    character : (float, float)
        Width and height of a character, in the units of the drawing.
    gap : float
        Distance between anchor and text.
    obstacles : (n, 2) float array
        Points of the drawing that texts should not cover.
    """
    boxes = np.zeros((0, 4))
    placed, lost = [], 0
    for label in wanted:
        half = 0.5 * np.array([len(label.text) * character[0], 1.25 * character[1]])
        best, fewest = None, np.inf
        for centre in _candidates(label, half, gap):
            box = np.concatenate([centre - half, centre + half])
            clear = (boxes[:, 2:] <= box[:2]) | (boxes[:, :2] >= box[2:])
            if not clear.any(axis=1).all():
                continue
            covered = int(((obstacles > box[:2]) & (obstacles < box[2:])).all(axis=1).sum())
            if covered < fewest:
                best, fewest = centre, covered
            if covered == 0:
                break
        if best is None:
            lost += 1
            continue
        boxes = np.vstack([boxes, np.concatenate([best - half, best + half])])
        placed.append((label, best))
    return placed, lost


def _candidates(label: Label, half: FloatArray, gap: float) -> list[FloatArray]:
    """Centres (2,) to try for a label, best first: the wanted direction, then turned by up to 135 degrees, then farther out.

    `half` (2,) is half the width and height of the text, `gap` the smallest distance from the anchor.
    """
    found = []
    for distance in (1.0, 2.5, 4.5):
        for turn in (0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75):
            c, s = np.cos(np.pi * turn), np.sin(np.pi * turn)
            way = np.array([c * label.away[0] - s * label.away[1], s * label.away[0] + c * label.away[1]])
            found.append(label.anchor + distance * gap * way + half * way / max(float(np.abs(way).max()), 1e-12))
    return found
