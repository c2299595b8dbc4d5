"""Offsets of Nastran bars, plates and shells from their grid points, and what else of their cards and properties no cell says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.importers.fixed_fields import as_real
from structid.fem.meshes.bulk_cards import Cards
from structid.fem.meshes.coordinate_systems import unit_normals
from structid.fem.meshes.deck_parts import CellOffsets, DeckPart, split_by_obstacle
from structid.fem.meshes.mesh import CellBlock

#: Field of ZOFFS in the cards of plates, from the first behind the name.
_ZOFFS = {"CTRIA3": 6, "CTRIAR": 6, "CTRIA6": 9, "CQUAD4": 7, "CQUADR": 7, "CQUAD8": 15}
_BARS = {"CBAR": "BAROR", "CBEAM": "BEAMOR"}
_LAMINATES = {"PCOMP": (8, 4, 1), "PCOMPG": (8, 8, 2)}  #: fields before the plies, of a ply, and where its thickness is
_NON_STRUCTURAL = {"PSHELL": 7, "PCOMP": 2, "PCOMPG": 2, "PBAR": 6, "PROD": 5, "PTUBE": 4, "PSHEAR": 3, "CONROD": 7}
#: Numbers of dimensions of the sections of PBARL and PBEAML.
_DIMENSIONS = {
    "ROD": 1, "TUBE": 2, "TUBE2": 2, "BAR": 2, "HEXA": 3, "BOX": 4, "CHAN": 4, "CHAN1": 4, "CHAN2": 4, "CROSS": 4, "H": 4,
    "HAT": 4, "I1": 4, "L": 4, "T": 4, "T1": 4, "T2": 4, "Z": 4, "HAT1": 5, "I": 6, "BOX1": 6, "DBOX": 10,
}  # fmt: skip
#: Cards that a mesh reader must ask for to read offsets.
OFFSET_CARDS = (*_BARS.values(), *_LAMINATES, *_NON_STRUCTURAL, "PBEAM", "PBARL", "PBEAML")


class OffsetReader:
    """Offsets of the cells of a deck.

    Parameters
    ----------
    cards : mapping of name to Cards
    length : float
        Unit of the deck, m.
    positions : mapping of label to position in m
    axes : mapping of label to (3, 3) float array
        Of grid points with a displacement system of their own.
    """

    def __init__(
        self,
        cards: Mapping[str, Cards],
        length: float,
        positions: Mapping[int, FloatArray],
        axes: Mapping[int, FloatArray],
    ) -> None:
        self._cards, self._length, self._positions, self._axes = cards, length, positions, axes
        self._middles = _laminate_middles(cards)

    def parts(self, names: Sequence[str], blocks: Sequence[CellBlock], numbers: Sequence[IntArray]) -> list[DeckPart]:
        """A part of each card whose cells have offsets, and one for released ends of bars.

        Parameters
        ----------
        names : sequence of str
            Card of each block.
        blocks : sequence of CellBlock
        numbers : sequence of (n_cells,) int array
            Property of each cell.
        """
        parts = []
        for index, (name, block, properties) in enumerate(zip(names, blocks, numbers, strict=True)):
            if name in _ZOFFS:
                parts += self._plates(name, index, block, properties)
            elif name in _BARS:
                parts += self._bars(name, index, block)
        return parts

    def _plates(self, name: str, index: int, block: CellBlock, properties: IntArray) -> list[DeckPart]:
        """Parts with the offsets of plates along their normals, by ZOFFS and by Z0 of their laminate, and with obstacles.

        `name` is the card, `index` the place of the `block` among all, `properties` (n_cells,) are the property numbers.
        """
        cards = self._cards[name]
        middles = [self._middles.get(number, (0.0, "")) for number in properties.tolist()]
        obstacles = np.array([why for _, why in middles])
        if name in ("CTRIA6", "CQUAD8"):
            rows = _rows_of_block(cards, block)
            lengths = cards.reals(_ZOFFS[name])[rows] + [middle for middle, _ in middles]
            count = int(((lengths != 0) | (obstacles != "")).sum())
            return [DeckPart(f"{name} offset", count, obstacle="no element for its cells")] if count else []
        lengths = self._length * (cards.reals(_ZOFFS[name]) + [middle for middle, _ in middles])
        items = [(why, DeckPart(f"{name} offset", 1)) for why in obstacles.tolist() if why]
        rows = np.flatnonzero((lengths != 0) & (obstacles == ""))
        rows = self._with_grids(block, rows)
        if len(rows):
            corners = np.array([[self._positions[node] for node in cell] for cell in block.nodes[rows].tolist()])
            arms = np.repeat((lengths[rows, None] * unit_normals(corners))[:, None], corners.shape[1], axis=1)
            items.append(("", DeckPart(f"{name} offset", len(rows), offsets=(CellOffsets(index, rows, arms),))))
        return split_by_obstacle(f"{name} offset", items)

    def _bars(self, name: str, index: int, block: CellBlock) -> list[DeckPart]:
        """Parts with the end offsets of the bars in `block` (card `name`), with obstacles, and a part for released ends.

        `index` is the place of the block among all.
        """
        cards = self._cards[name]
        vectors = np.stack([cards.reals(10 + k) for k in range(6)], axis=1).reshape(-1, 2, 3) * self._length
        rows = self._with_grids(block, np.flatnonzero(vectors.any(axis=(1, 2))))
        items, kept, arms = [], [], []
        defaults = self._cards[_BARS[name]].row_words(0) if _BARS[name] in self._cards else []
        for row in rows.tolist():
            words = [*cards.row_words(row), *[""] * 16]
            flags = words[7] or (defaults[7] if len(defaults) > 7 else "")
            flags = flags.upper() if flags.isalpha() else "GGG"
            try:
                arms.append([self._bar_arm(block, row, end, vectors[row, end], words, flags) for end in (0, 1)])
                kept.append(row)
            except ValueError as error:
                items.append((str(error), DeckPart(f"{name} offset", 1)))
        if kept:
            offsets = CellOffsets(index, np.array(kept, dtype=np.int64), np.array(arms))
            items.append(("", DeckPart(f"{name} offset", len(kept), offsets=(offsets,))))
        parts = split_by_obstacle(f"{name} offset", items)
        released = int(
            (~cards.is_blank(8) & (cards.integers(8) != 0) | ~cards.is_blank(9) & (cards.integers(9) != 0)).sum()
        )
        why = "loosen its ends by [[structure.joint]]"
        return [*parts, *([DeckPart(f"{name} released end", released, obstacle=why)] if released else [])]

    def _bar_arm(
        self, block: CellBlock, row: int, end: int, vector: FloatArray, words: Sequence[str], flags: str
    ) -> FloatArray:
        """The arm (3,) in m of an end (0 or 1) of the bar `row` of a block in global directions.

        `vector` (3,) is the offset in m along the directions of motion of the grid point (G in OFFT) or the axes of the element
        (O); `words` are the fields of the bar's card and `flags` its OFFT. Raises `ValueError` for others.
        """
        flag = flags[1 + end] if len(flags) == 3 else ""
        node = int(block.nodes[row, end])
        if flag == "G":
            return vector @ self._axes.get(node, np.eye(3))
        if flag != "O":
            raise ValueError(f"its OFFT {flags!r} is not known")
        first, second = (self._positions[int(label)] for label in block.nodes[row])
        x = second - first
        if words[4] and not any(words[5:7]) and "." not in words[4]:
            guide = self._positions.get(int(words[4]), first) - first
        else:
            axes = self._axes.get(int(block.nodes[row, 0]), np.eye(3)) if flags[0] == "G" else np.eye(3)
            guide = np.array([as_real(word.encode("latin-1")) if word else 0.0 for word in words[4:7]]) @ axes
        z = np.cross(x, guide)
        if not np.linalg.norm(z) > 1e-9 * np.linalg.norm(x) * np.linalg.norm(guide):
            raise ValueError("it is along axes of the element, which has no orientation vector of its own")
        x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
        return vector @ np.array([x, np.cross(z, x), z])

    def _with_grids(self, block: CellBlock, rows: IntArray) -> IntArray:
        """The `rows` whose nodes all exist; others are refused with the mesh."""
        known = np.isin(block.nodes[rows], list(self._positions)).all(axis=1) if len(rows) else np.zeros(0, bool)
        return rows[known]


def _rows_of_block(cards: Cards, block: CellBlock) -> IntArray:
    """Row indices of the cards of a quadratic plate whose cells are in `block`: those with mid-side nodes, or those without."""
    corners = 3 if "triangle" in block.kind else 4
    first = 2 + corners
    middles = np.stack([cards.integers(first + k) for k in range(corners)], axis=1)
    quadratic = (middles > 0).any(axis=1)
    chosen: IntArray = np.flatnonzero(quadratic if block.nodes.shape[1] > corners else ~quadratic)
    return chosen


def _laminate_middles(cards: Mapping[str, Cards]) -> dict[int, tuple[float, str]]:
    """Height of the middle of each laminate with Z0 over its reference plane, in the deck's unit, and an obstacle; by number.

    The obstacle is "" if the height is known; otherwise it says why not, and the height is 0. Laminates are PCOMP and
    PCOMPG. `cards` are those of the deck by name.
    """
    middles: dict[int, tuple[float, str]] = {}
    for name, (head, width, thickness) in _LAMINATES.items():
        for row in range(len(cards[name]) if name in cards else 0):
            words = cards[name].row_words(row)
            if not words[1]:
                continue
            try:
                total, last = 0.0, 0.0
                for start in range(head, len(words), width):
                    ply = [*words[start : start + width], *[""] * width]
                    if not any(ply):
                        continue
                    last = _real(ply[thickness]) if ply[thickness] else last
                    total += last
                total *= 2 if name == "PCOMP" and words[7:8] == ["SYM"] else 1
                middle = _real(words[1]) + total / 2
                middles[int(words[0])] = (0.0 if abs(middle) <= 1e-9 * total else middle, "")
            except ValueError as error:
                middles[int(words[0])] = (0.0, f"its {name} cannot be read: {error}")
    return middles


def unread_property_parts(cards: Mapping[str, Cards]) -> list[DeckPart]:
    """Parts that count non-structural masses of properties, by card, and beams whose neutral axis is off their shear centre.

    All of them have obstacles. `cards` are those of the deck by name.
    """
    counts: dict[str, int] = {}
    for name, field in _NON_STRUCTURAL.items():
        if name in cards and not cards[name].is_blank(field).all():
            counts[name] = int((cards[name].reals(field) != 0).sum())
    shifted = 0
    for name, mass_of in _BEAM_MASSES.items():
        for row in range(len(cards[name]) if name in cards else 0):
            words = cards[name].row_words(row)
            counts[name] = counts.get(name, 0) + int(any(_is_nonzero(word) for word in mass_of(words)))
            tail = _beam_tail(words) if name == "PBEAM" else []
            shifted += any(_is_nonzero(word) for word in [*tail[12:16]])
    parts = [
        DeckPart(f"{name} NSM", count, obstacle="add it to the density") for name, count in counts.items() if count
    ]
    why = "its neutral axis is not its shear centre"
    return [*parts, *([DeckPart("PBEAM neutral axis", shifted, obstacle=why)] if shifted else [])]


def _bar_masses(words: Sequence[str]) -> list[str]:
    """Non-structural mass of a PBARL behind its dimensions."""
    last = 8 + _DIMENSIONS.get(words[3] if len(words) > 3 else "", len(words))
    return list(words[last : last + 1])


def _library_beam_masses(words: Sequence[str]) -> list[str]:
    """Non-structural masses of a PBEAML at its stations.

    `words` are the fields of the card.
    """
    count = _DIMENSIONS.get(words[3] if len(words) > 3 else "", len(words))
    masses, at = list(words[8 + count : 9 + count]), 9 + count
    while at + 2 + count < len(words):
        masses.append(words[at + 2 + count])
        at += 3 + count
    return masses


def _beam_masses(words: Sequence[str]) -> list[str]:
    """Non-structural masses of a PBEAM at end A and its stations."""
    return [words[start] for start in _beam_stations(words)[0] if start < len(words)]


def _beam_stations(words: Sequence[str]) -> tuple[list[int], int]:
    """Indices of the fields of non-structural mass at end A and each station of a PBEAM, and of the first field behind.

    `words` are the fields of the card.
    """
    fields, at = [7], 16
    while at < len(words) and words[at] in ("YES", "YESA", "NO"):
        fields.append(at + 7)
        at += 16 if words[at] == "YES" else 8
    return fields, at


def _beam_tail(words: Sequence[str]) -> list[str]:
    """Fields of a PBEAM behind its stations: shear stiffness, inertia and warping, then offsets of mass and neutral axis."""
    return list(words[_beam_stations(words)[1] :])


_BEAM_MASSES: dict[str, Callable[[Sequence[str]], list[str]]] = {
    "PBEAM": _beam_masses,
    "PBARL": _bar_masses,
    "PBEAML": _library_beam_masses,
}


def _real(word: str) -> float:
    return as_real(word.encode("latin-1"))


def _is_nonzero(word: str) -> bool:
    """True if the field `word` holds a number other than 0."""
    return bool(word) and _real(word) != 0
