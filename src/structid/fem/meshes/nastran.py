"""Nastran bulk data as meshes: grid points in any coordinate system, elements by property."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.meshes.bulk_cards import Cards, bulk_text, cards_of
from structid.fem.meshes.mesh import CellBlock, Mesh

SUFFIXES: tuple[str, ...] = (".bdf", ".nas", ".fem", ".dat")

#: Corners and all nodes of each element card, and the cell types with them.
_CELLS = {
    "CTRIA3": (3, 3, "triangle", ""),
    "CTRIAR": (3, 3, "triangle", ""),
    "CQUAD4": (4, 4, "quad", ""),
    "CQUADR": (4, 4, "quad", ""),
    "CSHEAR": (4, 4, "quad", ""),
    "CTRIA6": (3, 6, "triangle", "triangle6"),
    "CQUAD8": (4, 8, "quad", "quad8"),
    "CTETRA": (4, 10, "tetra", "tetra10"),
    "CPYRAM": (5, 13, "pyramid", "pyramid13"),
    "CPENTA": (6, 15, "wedge", "wedge15"),
    "CHEXA": (8, 20, "hexahedron", "hexahedron20"),
    "CROD": (2, 2, "line", ""),
    "CTUBE": (2, 2, "line", ""),
    "CBAR": (2, 2, "line", ""),
    "CBEAM": (2, 2, "line", ""),
}
#: Where the offset from the grid points stands among the fields of plates.
_OFFSETS = {"CTRIA3": 6, "CTRIAR": 6, "CQUAD4": 7, "CQUADR": 7}
#: Nastran numbers the sides between bottom and top before those of the top.
_ORDERS = {"wedge15": (*range(9), 12, 13, 14, 9, 10, 11), "hexahedron20": (*range(12), *range(16, 20), *range(12, 16))}
_REFUSED = ("CTRIAX", "CTRIAX6", "CQUADX", "CTRAX3", "CTRAX6", "CQUADX4", "CQUADX8", "CQUAD")
_NAMED = (
    re.compile(rb"^\$HMNAME\s+PROP\s+(\d+)\s*\"([^\"]+)\"", re.IGNORECASE),
    re.compile(rb"^\$\s*FEMAP Property\s+(\d+)\s*:\s*(\S(?:.*\S)?)\s*$", re.IGNORECASE),
)
_REGION = re.compile(rb"^\$ Elements and Element Properties for region\s*:\s*(\S(?:.*\S)?)\s*$", re.IGNORECASE)
_PROPERTY = re.compile(rb"^P[A-Z0-9]+\*?[\s,]+(\d+)", re.IGNORECASE)
SYSTEM_CARDS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")


def read(path: Path, factor: float) -> Mesh:
    """The mesh of a bulk data file; coordinates times `factor` are in m.

    Groups are property numbers, and the property names that HyperMesh, Femap and Patran leave in comments.

    Raises
    ------
    FileError
        If bulk data do not begin or end, or hold axisymmetric elements, offsets or quadratic elements that lack nodes.
    """
    content = bulk_text(path)
    cards = cards_of(path, content, ("GRID", "GRDSET", *SYSTEM_CARDS, *_CELLS, *_REFUSED))
    axisymmetric = next((name for name in _REFUSED if name in cards), None)
    if axisymmetric:
        raise FileError(f"{path}: elements {axisymmetric} are not read; model the part in plates or solids")
    if "GRID" not in cards:
        raise FileError(f"{path}: holds no GRID; export bulk data with the mesh")
    labels, positions = _grids(path, cards, factor)
    blocks, numbers = _blocks(path, cards)
    if not blocks:
        raise FileError(f"{path}: holds no elements ({', '.join(_CELLS)}); export bulk data with the mesh")
    groups = {
        str(number): tuple(np.flatnonzero(own == number) for own in numbers)
        for number in np.unique(np.concatenate(numbers)).tolist()
    }
    for number, name in _names(content).items():
        if number in groups and name not in groups:
            groups[name] = groups[number]
    return Mesh(labels, positions, tuple(blocks), groups, {}, path.name)


def _grids(path: Path, cards: dict[str, Cards], factor: float) -> tuple[IntArray, FloatArray]:
    """Labels and positions; a grid point that is repeated at its own place counts once, as in Nastran."""
    grids = cards["GRID"]
    labels = grids.integers(0)
    positions = factor * basic_positions(path, cards, labels)
    order = np.argsort(labels, kind="stable")
    same = labels[order][1:] == labels[order][:-1]
    size = float(np.ptp(positions, axis=0).max())
    apart = np.linalg.norm(np.diff(positions[order], axis=0), axis=1) > 1e-6 * size
    if (same & apart).any():
        label = labels[order][1:][same & apart][0]
        raise FileError(f"{path}: GRID {label} stands twice, at two places; number the grid points anew")
    keep = np.sort(order[np.concatenate([[True], ~same])])
    return labels[keep], positions[keep]


def _blocks(path: Path, cards: dict[str, Cards]) -> tuple[list[CellBlock], list[IntArray]]:
    """Cells of each card, and their property numbers."""
    blocks, numbers = [], []
    for name in sorted(set(_CELLS) & set(cards), key=lambda name: int(cards[name].first[0])):
        own, (corners, most, linear, quadratic) = cards[name], _CELLS[name]
        _require_no_offset(path, name, own)
        table = np.stack([own.integers(2 + k) for k in range(most)], axis=1)
        labels, properties = own.integers(0), own.integers(1)
        properties = np.where(own.is_blank(1), labels, properties)
        extra = (table[:, corners:] > 0).sum(axis=1)
        partly = (table[:, :corners] <= 0).any(axis=1) | ((extra > 0) & (extra < most - corners))
        if partly.any():
            raise FileError(
                f"{path}: {name} {labels[np.argmax(partly)]} lacks some of its nodes; give all of them, or corners only"
            )
        for kind, chosen, width in ((linear, extra == 0, corners), (quadratic, extra > 0, most)):
            if chosen.any():
                rows = table[chosen][:, _ORDERS.get(kind, range(width))]
                blocks.append(CellBlock(kind, rows))
                numbers.append(properties[chosen])
    return blocks, numbers


def _require_no_offset(path: Path, name: str, cards: Cards) -> None:
    place = _OFFSETS.get(name)
    if place is None or cards.is_blank(place).all():
        return
    moved = cards.reals(place) != 0
    if moved.any():
        label = cards.integers(0)[np.argmax(moved)]
        raise FileError(
            f"{path}: {name} {label} is offset from its grid points (ZOFFS), which is not read; move the grid points to"
            " the middle surface"
        )


def _names(content: bytes) -> dict[str, str]:
    """Property names in comments, by number; those of Patran stand before the property's card."""
    found: dict[str, str] = {}
    pending = ""
    for line in content.split(b"\n"):
        if line.startswith(b"$"):
            for pattern in _NAMED:
                match = pattern.match(line.rstrip())
                if match:
                    found[str(int(match[1]))] = match[2].decode("latin-1").strip()
            region = _REGION.match(line)
            pending = region[1].decode("latin-1") if region else pending
        elif pending and line.strip():
            card = _PROPERTY.match(line)
            if card:
                found[str(int(card[1]))] = pending
            pending = ""
    return found


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
