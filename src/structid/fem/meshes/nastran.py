"""Nastran bulk data as meshes: grid points in any coordinate system, elements by property."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.meshes.bulk_cards import BulkText, Cards, bulk_text, cards_of
from structid.fem.meshes.deck_parts import DeckPart, DeckUnits
from structid.fem.meshes.mesh import CellBlock, Mesh
from structid.fem.meshes.middle_nodes import EDGES, MiddleNodes
from structid.fem.meshes.nastran_offsets import OFFSET_CARDS, OffsetReader, unread_property_parts
from structid.fem.meshes.nastran_parts import PART_CARDS, read_parts
from structid.fem.meshes.nastran_systems import SYSTEM_CARDS, BulkSystems

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


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of the Nastran bulk data file at `path` in SI units, with the parts it has beside its cells.

    Groups are property numbers, and the property names that HyperMesh, Femap and Patran leave in comments.

    Raises
    ------
    FileError
        If case control has no bulk data behind it, or these hold superelements, axisymmetric elements or no mesh.
    """
    text = bulk_text(path)
    wanted = ("GRID", "GRDSET", *SYSTEM_CARDS, *_CELLS, *_REFUSED, *OFFSET_CARDS, *PART_CARDS)
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
    middles = MiddleNodes(labels)
    names, blocks, numbers = _read_cells(path, cards, middles)
    axes = systems.displacement_axes(labels, basic)
    labels, positions = middles.with_positions(labels, units.length * basic)
    position_of = dict(zip(labels.tolist(), positions, strict=True))
    parts = read_parts(text, cards, systems, position_of, axes, units)
    offsets = OffsetReader(cards, units.length, position_of, axes).parts(names, blocks, numbers)
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
        (*middles.parts(), *parts, *offsets, *unread_property_parts(cards), *_unknown_elements(counts)),
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
    """Labels (n,) and basic positions (n, 3) of grid points, in the unit of the file.

    A grid point that is repeated at its position counts once, as in Nastran; `FileError` if it is repeated elsewhere.
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
    path: Path, cards: dict[str, Cards], middles: MiddleNodes
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
                rows = middles.completed(table[chosen], corners, EDGES[name]) if width > corners else table[chosen]
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

    Without such a card it is the element's own number. `name` is the card of the elements, `cards` are those of the deck.
    """
    default = {"CBAR": "BAROR", "CBEAM": "BEAMOR"}.get(name, "")
    if default not in cards or cards[default].is_blank(1).all():
        return labels
    return np.full_like(labels, cards[default].integers(1)[0])


def _unknown_elements(counts: Counter[str]) -> list[DeckPart]:
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

    A name in Patran's form precedes the property's card.
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
