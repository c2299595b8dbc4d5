"""Coordinate systems of Nastran bulk data: CORD1 and CORD2 cards, of definition and of displacement."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.meshes.bulk_cards import Cards
from structid.fem.meshes.coordinate_systems import CoordinateSystem, axes_of_points

SYSTEM_CARDS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_CP, _CD, _PS = 1, 5, 6


@dataclass(frozen=True, eq=False)
class _SystemCard:
    """A coordinate system as its card has it.

    Attributes
    ----------
    form : str
        R, C or S.
    reference : int
        System of `points`; -1 where they are grid points.
    points : (3, 3) float array or (3,) int array
        Origin, a point on the z axis, a point in the x-z plane.
    """

    form: str
    reference: int
    points: np.ndarray


class BulkSystems:
    """The grid points and coordinate systems of a deck, resolved when asked for.

    Attributes
    ----------
    labels : (n_grids,) int array
        Labels of the grid points in the order of the cards, repeated ones too.
    """

    def __init__(self, path: Path, cards: dict[str, Cards]) -> None:
        """Read the grid points and coordinate system cards of the deck at `path`.

        Systems are resolved when asked for.
        """
        grids = cards["GRID"]
        self._path = path
        self.labels: IntArray = grids.integers(0)
        self._coordinates = np.stack([grids.reals(field) for field in (2, 3, 4)], axis=1)
        self._definition = _grid_numbers(cards, _CP)
        self.displacement: IntArray = _grid_numbers(cards, _CD)
        #: Whether grid points are held by fields of their own (PS).
        self.has_supports: bool = bool((_grid_numbers(cards, _PS) != 0).any())
        self._cards = _read_system_cards(cards)
        self._resolved = {0: CoordinateSystem("R", np.zeros(3), np.eye(3))}

    def basic_positions(self) -> FloatArray:
        """Positions of all grid points in the basic coordinate system, (n_grids, 3), in the unit of the file.

        Raises
        ------
        FileError
            If a coordinate system is not there, has no axes, or is defined by itself.
        """
        positions = self._coordinates.copy()
        for number in np.unique(self._definition[self._definition != 0]).tolist():
            rows = self._definition == number
            positions[rows] = self.system(number).to_basic(positions[rows])
        return positions

    def system(self, number: int, within: tuple[int, ...] = ()) -> CoordinateSystem:
        """Coordinate system `number` in basic coordinates and the unit of the file; resolved once, then remembered.

        `within` are the numbers of those being resolved. Raises `FileError` if it is not there, has no axes, or is
        defined by itself.
        """
        if number in self._resolved:
            return self._resolved[number]
        if number not in self._cards or number in within:
            problem = "is defined by itself" if number in within else "is not in the file"
            raise FileError(
                f"{self._path}: coordinate system {number} {problem}; export its CORD card, or basic coordinates"
            )
        card, within = self._cards[number], (*within, number)
        if card.reference < 0:
            points = np.stack([self._grid_point(number, label, within) for label in card.points.tolist()])
        else:
            points = self.system(card.reference, within).to_basic(card.points)
        axes = axes_of_points(*points)
        if axes is None:
            raise FileError(
                f"{self._path}: the points of coordinate system {number} lie on a line; correct its CORD card"
            )
        self._resolved[number] = CoordinateSystem(card.form, points[0], axes)
        return self._resolved[number]

    def _grid_point(self, number: int, label: int, within: tuple[int, ...]) -> FloatArray:
        """Basic position (3,) of the grid point `label` that a coordinate system refers to.

        `number` is that of the coordinate system; `within` are those being resolved. Raises `FileError` if the grid
        point is not there, or its own system is not or is being resolved.
        """
        rows = np.flatnonzero(self.labels == label)
        if not len(rows):
            raise FileError(f"{self._path}: coordinate system {number} names GRID {label}, which is not there; add it")
        system = self.system(int(self._definition[rows[0]]), within)
        return system.to_basic(self._coordinates[rows[:1]])[0]

    def displacement_axes(self, labels: IntArray, positions: FloatArray) -> dict[int, FloatArray]:
        """Directions of motion (3, 3), as rows, of each grid point whose displacement system is turned, by label.

        Parameters
        ----------
        labels : (n,) int array
        positions : (n, 3) float array
            Of these grid points, basic, in the unit of the file.

        Raises
        ------
        FileError
            If a coordinate system is not there, has no axes, or is defined by itself.
        """
        number_of = dict(zip(self.labels.tolist(), self.displacement.tolist(), strict=True))
        numbers = np.array([number_of[label] for label in labels.tolist()], dtype=np.int64)
        axes: dict[int, FloatArray] = {}
        for number in np.unique(numbers[numbers > 0]).tolist():  # -1 is the pressure of a fluid
            rows = np.flatnonzero(numbers == number)
            directions = self.system(number).directions_at(positions[rows])
            turned = np.abs(directions - np.eye(3)).max(axis=(1, 2)) > 1e-12
            axes |= zip(labels[rows[turned]].tolist(), directions[turned], strict=True)
        return axes


def _grid_numbers(cards: dict[str, Cards], field: int) -> IntArray:
    """Whole number in a field of each grid point, (n_grids,), such as its coordinate system.

    A blank field takes that of GRDSET. `field` counts from 0, behind the name of the card.
    """
    numbers = cards["GRID"].integers(field)
    if "GRDSET" in cards:
        numbers = np.where(cards["GRID"].is_blank(field), cards["GRDSET"].integers(field)[0], numbers)
    return numbers


def _read_system_cards(cards: dict[str, Cards]) -> dict[int, _SystemCard]:
    """Coordinate systems as their cards define them, by number: form (R, C or S), reference system and three points.

    CORD2 cards have points (3, 3) in the reference system; CORD1 cards have labels (3,) of grid points and the
    reference -1. Raises `FileError` for a field that is no number.
    """
    systems: dict[int, _SystemCard] = {}
    for name in SYSTEM_CARDS:
        card = cards.get(name)
        if card is None:
            continue
        if name[4] == "2":
            numbers, references = card.integers(0), card.integers(1)
            points = np.stack([card.reals(2 + k) for k in range(9)], axis=1).reshape(-1, 3, 3)
            for number, reference, three in zip(numbers.tolist(), references.tolist(), points, strict=True):
                systems[number] = _SystemCard(name[5], reference, three)
            continue
        for start in (0, 4):  # two systems a card
            table = np.stack([card.integers(start + k) for k in range(4)], axis=1)
            for number, *three in table[table[:, 0] > 0].tolist():
                systems[number] = _SystemCard(name[5], -1, np.array(three))
    return systems
