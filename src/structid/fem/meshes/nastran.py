"""Nastran bulk data as meshes: grid points in any coordinate system, elements by property, offsets, middle nodes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import as_real
from structid.fem.meshes.bulk_cards import SYSTEM_CARDS, BulkSystems, BulkText, Cards, bulk_text, cards_of
from structid.fem.meshes.coordinate_systems import unit_normals
from structid.fem.meshes.deck_parts import CellOffsets, DeckPart, DeckUnits, split_by_obstacle
from structid.fem.meshes.mesh import CellBlock, Mesh
from structid.fem.meshes.nastran_parts import PART_CARDS, read_parts
from structid.fem.supports import MiddleNode

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
    "CONROD": (2, 2, "line", ""),
    "CTUBE": (2, 2, "line", ""),
    "CBAR": (2, 2, "line", ""),
    "CBEAM": (2, 2, "line", ""),
}
#: Names that begin with a C and are no elements of a structure.
_NO_ELEMENTS = re.compile(
    r"C(?:ORD.*|AERO.*|BARAO|GEN|SET.*|SLOT.*|YJOIN|YSUP|YSYM|HBDY.*|ONV.*|REEP|SSCHD.*|AMPBLL|NTLIST|END|SCALE|METHOD"
    r"|OMPILE|LOAD|IFQUAD|IFHEX|IFPENT|QUAD|AABSF|OUPMASS|ASE|S\d*|PL.*|ONTRLT|OSINE|)$"
)
#: Nastran numbers the sides between bottom and top before those of the top.
_ORDERS = {"wedge15": (*range(9), 12, 13, 14, 9, 10, 11), "hexahedron20": (*range(12), *range(16, 20), *range(12, 16))}
_REFUSED = ("CTRIAX", "CTRIAX6", "CQUADX", "CTRAX3", "CTRAX6", "CQUADX4", "CQUADX8")
_SUPPORTS = ("SPC", "SPC1", "SPCADD", "SUPORT", "SUPORT1")
_NAMED = (
    re.compile(rb"^\$HMNAME\s+PROP\s+(\d+)\s*\"([^\"]+)\"", re.IGNORECASE),
    re.compile(rb"^\$\s*FEMAP Property\s+(\d+)\s*:\s*(\S(?:.*\S)?)\s*$", re.IGNORECASE),
)
_REGION = re.compile(rb"^\$ Elements and Element Properties for region\s*:\s*(\S(?:.*\S)?)\s*$", re.IGNORECASE)
_PROPERTY = re.compile(rb"^P[A-Z0-9]+\*?[\s,]+(\d+)", re.IGNORECASE)
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
_OFFSET_CARDS = (*_BARS.values(), *_LAMINATES, *_NON_STRUCTURAL, "PBEAM", "PBARL", "PBEAML")
#: Corners at the ends of each side of Nastran's elements, in the order of their nodes.
_EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "CTRIA6": ((0, 1), (1, 2), (2, 0)),
    "CQUAD8": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "CTETRA": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "CPYRAM": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
    "CPENTA": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3)),
    "CHEXA": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 5), (2, 6), (3, 7), (4, 5), (5, 6), (6, 7), (7, 4)),
}


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of the Nastran bulk data file at `path` in SI units, with the parts it has beside its cells.

    Groups are property numbers, and the property names that HyperMesh, Femap and Patran leave in comments. `units` are
    those of the file.

    Raises
    ------
    FileError
        If case control has no bulk data behind it, or these hold superelements, axisymmetric elements or no mesh.
    """
    text = bulk_text(path)
    wanted = ("GRID", "GRDSET", *SYSTEM_CARDS, *_CELLS, *_REFUSED, *_OFFSET_CARDS, *PART_CARDS)
    cards = cards_of(text, tuple(dict.fromkeys(wanted)))
    axisymmetric = next((name for name in _REFUSED if name in cards), None)
    if axisymmetric:
        raise FileError(f"{path}: elements {axisymmetric} are not read; model the part in plates or solids")
    if "GRID" not in cards:
        made = [name for name in ("EGRID", "GRIDG", "GRIDB") if text.count_cards()[name]]
        reason = f", only {', '.join(made)}, which a preprocessor makes grid points of" if made else ""
        raise FileError(f"{path}: holds no GRID{reason}; export bulk data with the mesh")
    systems = BulkSystems(path, cards)
    labels, basic = _read_grids(path, systems)
    middles = _MiddleNodes(labels)
    names, blocks, numbers = _read_cells(path, cards, middles)
    axes = systems.displacement_axes(labels, basic)
    labels, positions = middles.with_positions(labels, units.length * basic)
    position_of = dict(zip(labels.tolist(), positions, strict=True))
    parts = read_parts(text, cards, systems, position_of, axes, units)
    offsets = _OffsetReader(cards, units.length, position_of, axes).parts(names, blocks, numbers)
    counts = text.count_cards()
    if not blocks and all(part.obstacle for part in parts):
        beside = (*parts, *_unknown_elements(counts))
        others = ", ".join(part.words + (f" [{part.obstacle}]" if part.obstacle else "") for part in beside)
        raise FileError(
            f"{path}: holds no elements ({', '.join(_CELLS)}){f', only {others}' if others else ''}; export bulk data with"
            " the mesh"
        )
    return Mesh(
        labels,
        positions,
        tuple(blocks),
        _property_groups(text, numbers),
        {},
        path.name,
        (*middles.parts(), *parts, *offsets, *_unread_property_parts(cards), *_unknown_elements(counts)),
        (*text.notes, *_notes(counts, axes, systems)),
        axes,
        cells_are_elements=True,
    )


def _property_groups(text: BulkText, numbers: list[IntArray]) -> dict[str, tuple[IntArray, ...]]:
    """Rows of the cells of each property, one array for each block, by its number as text and by its name in comments.

    `numbers` are the property numbers of the cells of each block, (n_cells,) each.
    """
    groups: dict[str, tuple[IntArray, ...]] = {
        str(number): tuple(np.flatnonzero(of_block == number) for of_block in numbers)
        for number in np.unique(np.concatenate([np.zeros(0, np.int64), *numbers])).tolist()
    }
    for number, name in _property_names(text.content).items():
        if number in groups and name not in groups:
            groups[name] = groups[number]
    return groups


def _read_grids(path: Path, systems: BulkSystems) -> tuple[IntArray, FloatArray]:
    """Labels (n,) and basic positions (n, 3) of grid points, in the unit of the file, in their order.

    A grid point that is repeated at its position, to 1e-6 of the size of the mesh, counts once, as in Nastran;
    `FileError`, which names `path`, if it is repeated elsewhere.
    """
    labels, positions = systems.labels, systems.basic_positions()
    order = np.argsort(labels, kind="stable")
    is_repeated = labels[order][1:] == labels[order][:-1]
    size = float(np.ptp(positions, axis=0).max())
    apart = np.linalg.norm(np.diff(positions[order], axis=0), axis=1) > 1e-6 * size
    if (is_repeated & apart).any():
        label = labels[order][1:][is_repeated & apart][0]
        raise FileError(f"{path}: GRID {label} stands twice, at two places; number the grid points anew")
    keep = np.sort(order[np.concatenate([[True], ~is_repeated])])
    return labels[keep], positions[keep]


def _read_cells(
    path: Path, cards: dict[str, Cards], middles: _MiddleNodes
) -> tuple[list[str], list[CellBlock], list[IntArray]]:
    """Card name, cells and property numbers (n_cells,) of each block: three lists of one length.

    `middles` supplies mid-side nodes that are left out; repeated cards are removed from `cards`. Raises `FileError` if
    corners are missing.
    """
    names, blocks, numbers = [], [], []
    for name in sorted(set(_CELLS) & set(cards), key=lambda name: int(cards[name].first[0])):
        card, (corners, most, linear, quadratic) = _without_repeats(path, name, cards[name]), _CELLS[name]
        cards[name] = card
        first = 1 if name == "CONROD" else 2
        table = np.stack([card.integers(first + k) for k in range(most)], axis=1)
        labels = card.integers(0)
        properties = (
            labels
            if name == "CONROD"
            else np.where(card.is_blank(1), _default_property(name, cards, labels), card.integers(1))
        )
        extra = (table[:, corners:] > 0).sum(axis=1)
        partly = (table[:, :corners] <= 0).any(axis=1)
        if partly.any():
            raise FileError(f"{path}: {name} {labels[np.argmax(partly)]} lacks some of its corners; give all of them")
        for kind, chosen, width in ((linear, extra == 0, corners), (quadratic, extra > 0, most)):
            if chosen.any():
                rows = middles.completed(table[chosen], corners, _EDGES[name]) if width > corners else table[chosen]
                blocks.append(CellBlock(kind, rows[:, _ORDERS.get(kind, range(width))]))
                names.append(name)
                numbers.append(properties[chosen])
    return names, blocks, numbers


def _without_repeats(path: Path, name: str, cards: Cards) -> Cards:
    """Element cards `name` without those that repeat another whole card, which solvers accept too.

    Raises `FileError` if two cards with the same number differ.
    """
    labels = cards.integers(0)
    order = np.argsort(labels, kind="stable")
    repeats = order[1:][labels[order][1:] == labels[order][:-1]]
    if not len(repeats):
        return cards
    first_of = {label: row for row, label in reversed(list(enumerate(labels.tolist())))}
    for row in repeats.tolist():
        if cards.row_words(row) != cards.row_words(first_of[int(labels[row])]):
            raise FileError(f"{path}: {name} {labels[row]} stands twice, with other fields; number the elements anew")
    return cards.without(repeats)


def _default_property(name: str, cards: dict[str, Cards], labels: IntArray) -> IntArray:
    """Property number of each element `labels` (n,) if its field is blank: that of BAROR or BEAMOR for bars and beams.

    Without such a card it is the element's own number. `name` is the card of the elements, `cards` are those of the
    deck.
    """
    default = _BARS.get(name, "")
    if default not in cards or cards[default].is_blank(1).all():
        return labels
    return np.full_like(labels, cards[default].integers(1)[0])


def _unknown_elements(counts: Counter[str]) -> list[DeckPart]:
    """Parts with an obstacle for unknown element cards (names with C), by name; `counts` are those of all cards."""
    known = {"GRID", *SYSTEM_CARDS, *_CELLS, *_REFUSED, *PART_CARDS}
    names = [name for name in counts if name.startswith("C") and name not in known and not _NO_ELEMENTS.match(name)]
    return [DeckPart(name, counts[name], obstacle="not known") for name in sorted(names)]


def _notes(counts: Counter[str], axes: dict[int, FloatArray], systems: BulkSystems) -> tuple[str, ...]:
    """Sentences on what was not read: supports, scalar points, displacement systems. Empty if there is nothing to say.

    `counts` has the number of cards by name, `axes` the directions of motion of nodes that have their own.
    """
    notes = []
    supports = [name for name in _SUPPORTS if counts[name]] + ["PS of grid points"] * systems.has_supports
    if supports:
        notes.append(f"its {', '.join(supports)} are not read: supports are those of the study")
    if counts["SPOINT"]:
        notes.append("its scalar points (SPOINT) are not read")
    if axes:
        few = ", ".join(map(str, sorted(axes)[:5]))
        more = f" and {len(axes) - 5} more" if len(axes) > 5 else ""
        notes.append(f"grid points {few}{more} have displacement systems of their own (CD); directions here are global")
    return tuple(notes)


def _property_names(content: bytes) -> dict[str, str]:
    """Property names in the comments of HyperMesh, Femap and Patran in `content`, by property number as text.

    A name in Patran's form precedes the property's card and belongs to the next one.
    """
    names: dict[str, str] = {}
    pending = ""
    for line in content.split(b"\n"):
        if line.startswith(b"$"):
            for pattern in _NAMED:
                match = pattern.match(line.rstrip())
                if match:
                    names[str(int(match[1]))] = match[2].decode("latin-1").strip()
            region = _REGION.match(line)
            pending = region[1].decode("latin-1") if region else pending
        elif pending and line.strip():
            card = _PROPERTY.match(line)
            if card:
                names[str(int(card[1]))] = pending
            pending = ""
    return names


class _OffsetReader:
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
        """Parts of each block whose cells have offsets: one that can be taken, and one for each obstacle.

        Bars with released ends are a further part. Blocks without any of these have none.

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
        """Parts with the offsets of plates along their normals, by ZOFFS and Z0 of their laminate, and with obstacles.

        An obstacle says why an offset cannot be taken. `name` is the card, `index` that of the `block` of cells among
        all, `properties` (n_cells,) are the property numbers. Quadratic plates with an offset are one part with an
        obstacle. Empty if no plate has an offset.
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
        """Parts with the end offsets of the bars in `block` (card `name`), with obstacles, and one for released ends.

        An obstacle says why an offset cannot be taken; released ends always have one. `index` is that of the block
        among all.
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
        self, block: CellBlock, row: int, end: int, vector: FloatArray, fields: Sequence[str], flags: str
    ) -> FloatArray:
        """The arm (3,) in m of an end (0 or 1) of the bar `row` of a block in global directions.

        `vector` (3,) is the offset in m along the directions of motion of the grid point (G in OFFT) or the axes of the
        element (O); `fields` are those of the bar's card and `flags` its OFFT. Raises `ValueError` for other letters,
        and if the orientation vector gives the element no axes.
        """
        flag = flags[1 + end] if len(flags) == 3 else ""
        node = int(block.nodes[row, end])
        if flag == "G":
            return vector @ self._axes.get(node, np.eye(3))
        if flag != "O":
            raise ValueError(f"its OFFT {flags!r} is not known")
        first, second = (self._positions[int(label)] for label in block.nodes[row])
        x = second - first
        if fields[4] and not any(fields[5:7]) and "." not in fields[4]:
            guide = self._positions.get(int(fields[4]), first) - first
        else:
            axes = self._axes.get(int(block.nodes[row, 0]), np.eye(3)) if flags[0] == "G" else np.eye(3)
            guide = np.array([as_real(word.encode("latin-1")) if word else 0.0 for word in fields[4:7]]) @ axes
        z = np.cross(x, guide)
        if not np.linalg.norm(z) > 1e-9 * np.linalg.norm(x) * np.linalg.norm(guide):
            raise ValueError("it is along axes of the element, which has no orientation vector of its own")
        x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
        return vector @ np.array([x, np.cross(z, x), z])

    def _with_grids(self, block: CellBlock, rows: IntArray) -> IntArray:
        """The indices `rows` (n,) of cards whose nodes all exist; the others are refused with the mesh."""
        known = np.isin(block.nodes[rows], list(self._positions)).all(axis=1) if len(rows) else np.zeros(0, bool)
        return rows[known]


def _rows_of_block(cards: Cards, block: CellBlock) -> IntArray:
    """Row indices (n_cells,), rising, of the `cards` of a quadratic plate whose cells are in `block`.

    A block has the cells with mid-side nodes, or those without.
    """
    corners = 3 if "triangle" in block.kind else 4
    first = 2 + corners
    middles = np.stack([cards.integers(first + k) for k in range(corners)], axis=1)
    quadratic = (middles > 0).any(axis=1)
    chosen: IntArray = np.flatnonzero(quadratic if block.nodes.shape[1] > corners else ~quadratic)
    return chosen


def _laminate_middles(cards: Mapping[str, Cards]) -> dict[int, tuple[float, str]]:
    """Height of the middle of each laminate over its reference plane, and an obstacle, by property number.

    Heights are in the deck's unit, for laminates (PCOMP and PCOMPG) with Z0. The obstacle is "" if the height is known;
    otherwise it says why not, and the height is 0. `cards` are those of the deck by name.
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


def _unread_property_parts(cards: Mapping[str, Cards]) -> list[DeckPart]:
    """Parts with obstacles: properties with non-structural mass, beams with their neutral axis off the shear centre.

    They count properties, those with mass by card. All of them have obstacles; there are none for a count of 0. `cards`
    are those of the deck by name.
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


def _library_beam_masses(fields: Sequence[str]) -> list[str]:
    """Non-structural masses, as texts, of a PBEAML at its stations, end A first; `fields` are those of the card.

    Empty for a type of section that has no known dimensions.
    """
    count = _DIMENSIONS.get(fields[3] if len(fields) > 3 else "", len(fields))
    masses, station = list(fields[8 + count : 9 + count]), 9 + count
    while station + 2 + count < len(fields):
        masses.append(fields[station + 2 + count])
        station += 3 + count
    return masses


def _beam_masses(words: Sequence[str]) -> list[str]:
    """Non-structural masses of a PBEAM at end A and its stations."""
    return [words[start] for start in _beam_stations(words)[0] if start < len(words)]


def _beam_stations(words: Sequence[str]) -> tuple[list[int], int]:
    """Indices of the fields of non-structural mass at end A and each station of a PBEAM, and of the first field behind.

    `words` are the fields of the card.
    """
    fields, station = [7], 16
    while station < len(words) and words[station] in ("YES", "YESA", "NO"):
        fields.append(station + 7)
        station += 16 if words[station] == "YES" else 8
    return fields, station


def _beam_tail(words: Sequence[str]) -> list[str]:
    """Fields of a PBEAM behind its stations: shear stiffness, inertia, warping, offsets of mass and neutral axis."""
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


class _MiddleNodes:
    """New nodes for sides without one; elements that share such a side share the node."""

    def __init__(self, labels: IntArray) -> None:
        self._next = int(labels.max(initial=0)) + 1
        self._nodes: dict[tuple[int, int], int] = {}
        self._cells = 0

    def completed(self, table: IntArray, corners: int, edges: Sequence[tuple[int, int]]) -> IntArray:
        """Copy of the node table (n_elements, n_nodes) with new mid-side nodes where it has none (0 or less).

        The first `corners` columns are corners; `edges` are the pairs of corner columns of the columns behind them.
        """
        completed = table.copy()
        lacking = np.flatnonzero((table <= 0).any(axis=1))
        self._cells += len(lacking)
        for row in lacking.tolist():
            for side, (start, end) in enumerate(edges, corners):
                if table[row, side] <= 0:
                    completed[row, side] = self._node(int(table[row, start]), int(table[row, end]))
        return completed

    def _node(self, start: int, end: int) -> int:
        """Label of the mid-side node between the corners `start` and `end`, in either order.

        It is made when first asked for.
        """
        key = (min(start, end), max(start, end))
        if key not in self._nodes:
            self._nodes[key] = self._next
            self._next += 1
        return self._nodes[key]

    def with_positions(self, labels: IntArray, positions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Labels (n,) and positions (n, 3) with those of the new nodes appended, each at the middle of its side.

        New nodes of sides whose corners are not in `labels` are left out.
        """
        if not self._nodes:
            return labels, positions
        row_of = {label: row for row, label in enumerate(labels.tolist())}
        ends_of = {label: ends for ends, label in self._nodes.items() if set(ends) <= set(row_of)}
        middles = [positions[[row_of[end] for end in ends]].mean(axis=0) for ends in ends_of.values()]
        return np.concatenate([labels, np.array(list(ends_of), dtype=np.int64)]), np.concatenate([positions, middles])

    def parts(self) -> list[DeckPart]:
        """Ties that keep sides with new nodes straight, as a part that the mesh always needs.

        Empty without new nodes.
        """
        if not self._nodes:
            return []
        ties = tuple(MiddleNode(f"middle {label}", label, ends) for ends, label in self._nodes.items())
        return [DeckPart("mid-side node", len(ties), ties=ties, is_needed=True)]
