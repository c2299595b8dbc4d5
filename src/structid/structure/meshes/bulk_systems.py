"""Coordinate systems of Nastran bulk data: where grid points are in the basic one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.errors import FileError
from structid.structure.meshes.bulk_cards import Cards

SYSTEM_CARDS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")


@dataclass(frozen=True, eq=False)
class _System:
    """A system as the card gives it.

    Attributes
    ----------
    form : str
        R (rectangular), C (cylindrical) or S (spherical).
    reference : int
        System of `points`; -1 where they are grid points.
    points : (3, 3) float array or (3,) int array
        Origin, a point on the z axis, a point in the x-z plane.
    """

    form: str
    reference: int
    points: np.ndarray


def basic_positions(path: Path, cards: dict[str, Cards], labels: IntArray) -> FloatArray:
    """Positions of all grid points in the basic system, (n_nodes, 3), in the unit of the file.

    Raises
    ------
    FileError
        If a coordinate system is not there, has no axes, or is defined by itself.
    """
    grids = cards["GRID"]
    given = np.stack([grids.reals(k) for k in (2, 3, 4)], axis=1)
    system = grids.integers(1)
    if "GRDSET" in cards:
        system = np.where(grids.is_blank(1), cards["GRDSET"].integers(1)[0], system)
    if not system.any():
        return given
    places = _Places(path, _systems(cards), labels, given, system)
    found = given.copy()
    for number in np.unique(system[system != 0]).tolist():
        rows = system == number
        found[rows] = places.moved(number, given[rows], ())
    return found


def _systems(cards: dict[str, Cards]) -> dict[int, _System]:
    found: dict[int, _System] = {}
    for name in SYSTEM_CARDS:
        own = cards.get(name)
        if own is None:
            continue
        if name[4] == "2":
            numbers, references = own.integers(0), own.integers(1)
            points = np.stack([own.reals(2 + k) for k in range(9)], axis=1).reshape(-1, 3, 3)
            for number, reference, three in zip(numbers.tolist(), references.tolist(), points, strict=True):
                found[number] = _System(name[5], reference, three)
            continue
        for start in (0, 4):  # two systems a card
            table = np.stack([own.integers(start + k) for k in range(4)], axis=1)
            for number, *three in table[table[:, 0] > 0].tolist():
                found[number] = _System(name[5], -1, np.array(three))
    return found


@dataclass(frozen=True, eq=False)
class _Places:
    """What is needed to turn positions into the basic system."""

    path: Path
    systems: dict[int, _System]
    labels: IntArray
    given: FloatArray
    system: IntArray

    def moved(self, number: int, local: FloatArray, within: tuple[int, ...]) -> FloatArray:
        """Coordinates (n, 3) of a system in the basic one; `within` are the systems that are being made."""
        if number == 0:
            return local
        if number not in self.systems or number in within:
            problem = "is defined by itself" if number in within else "is not in the file"
            raise FileError(
                f"{self.path}: coordinate system {number} {problem}; export its CORD card, or basic coordinates"
            )
        own, within = self.systems[number], (*within, number)
        points = (
            self._grid_points(number, own, within)
            if own.reference < 0
            else self.moved(own.reference, own.points, within)
        )
        origin = points[0]
        z = points[1] - origin
        y = np.cross(z, points[2] - origin)
        x = np.cross(y, z)
        axes = np.stack([x, y, z])
        sizes = np.linalg.norm(axes, axis=1)
        if not (sizes > 0).all():
            raise FileError(
                f"{self.path}: the points of coordinate system {number} lie on a line; correct its CORD card"
            )
        return origin + _rectangular(own.form, local) @ (axes / sizes[:, None])

    def _grid_points(self, number: int, own: _System, within: tuple[int, ...]) -> FloatArray:
        found = []
        for label in own.points.tolist():
            row = np.flatnonzero(self.labels == label)
            if not len(row):
                raise FileError(
                    f"{self.path}: coordinate system {number} names GRID {label}, which is not there; add it"
                )
            found.append(self.moved(int(self.system[row[0]]), self.given[row[:1]], within)[0])
        return np.array(found)


def _rectangular(form: str, local: FloatArray) -> FloatArray:
    """Rectangular coordinates of the same axes; angles are in degrees."""
    if form == "R":
        return local
    first, second = local[:, 0], np.radians(local[:, 1])
    if form == "C":
        return np.stack([first * np.cos(second), first * np.sin(second), local[:, 2]], axis=1)
    around = np.radians(local[:, 2])
    across = first * np.sin(second)
    return np.stack([across * np.cos(around), across * np.sin(around), first * np.cos(second)], axis=1)
