"""Nastran bulk data as meshes: grid points in any coordinate system, elements by property."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.errors import FileError
from structid.structure.meshes.bulk_cards import Cards, bulk_text, cards_of
from structid.structure.meshes.bulk_systems import SYSTEM_CARDS, basic_positions
from structid.structure.meshes.mesh import CellBlock, Mesh

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
    re.compile(rb"^\$\s*FEMAP Property\s+(\d+)\s*:\s*(.+?)\s*$", re.IGNORECASE),
)
_REGION = re.compile(rb"^\$ Elements and Element Properties for region\s*:\s*(.+?)\s*$", re.IGNORECASE)
_PROPERTY = re.compile(rb"^P[A-Z0-9]+\*?[\s,]+(\d+)", re.IGNORECASE)


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
