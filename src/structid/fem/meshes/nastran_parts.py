"""Masses, springs, dashpots and rigid elements of Nastran bulk data as parts of a deck."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import as_real
from structid.fem.meshes.averages import (
    Component,
    global_directions,
    mean_motion,
    mean_rows,
    rigid_constraints,
    solved_constraints,
    solved_for_first,
)
from structid.fem.meshes.bulk_cards import BulkSystems, BulkText, Cards
from structid.fem.meshes.deck_parts import (
    DeckPart,
    DeckSpring,
    DeckUnits,
    NodalMass,
    mass_matrix,
    split_by_obstacle,
    turned_matrix,
    weights_along,
    weights_between,
)
from structid.fem.supports import Constraint, RigidLink

#: Fields of a property on each card of properties; 0 where a card holds one.
_PROPERTIES = {"PELAS": 4, "PDAMP": 2, "PMASS": 2, "PVISC": 4, "PBUSH": 0, "PBUSH1D": 0}
#: Cards that make the values of properties with the same number depend on frequency or force.
_TABLES = {"PBUSH": "PBUSHT", "PELAS": "PELAST", "PDAMP": "PDAMPT"}
#: Cards that are listed, and why nothing stands for them.
_UNREAD = {
    "CELAS3": "scalar points",
    "CELAS4": "scalar points",
    "CDAMP3": "scalar points",
    "CDAMP4": "scalar points",
    "CDAMP5": "heat",
    "CMASS3": "scalar points",
    "CMASS4": "scalar points",
    "CBUSH2D": "rotor bearings",
    "CBEND": "curved beams",
    "CBEAM3": "beams of three nodes",
    "CGAP": "contact",
    "CFAST": "fasteners",
    "CWELD": "welds",
    "CSEAM": "seam welds",
    "CHACAB": "acoustic absorbers",
    "CHACBR": "acoustic barriers",
    "CRAC2D": "cracks",
    "CRAC3D": "cracks",
    "CCONEAX": "axisymmetric shells",
    "CPLSTN3": "plane strain",
    "CPLSTN4": "plane strain",
    "CPLSTN6": "plane strain",
    "CPLSTN8": "plane strain",
    "CPLSTS3": "plane stress",
    "CPLSTS4": "plane stress",
    "CPLSTS6": "plane stress",
    "CPLSTS8": "plane stress",
    "CQUAD": "hyperelastic quadrilaterals",
    "CSUPER": "superelements",
    "CSUPEXT": "superelements",
    "GENEL": "general elements",
    "RBE1": "rigid elements with several independent nodes",
    "RROD": "rigid rods",
    "RTRPLT": "rigid triangles",
    "RTRPLT1": "rigid triangles",
    "RBAR1": "rigid bars with springs",
    "RJOINT": "rigid joints",
    "RSPLINE": "interpolation elements",
    "RSSCON": "shells joined to solids",
    "NSM": "non-structural mass",
    "NSM1": "non-structural mass",
    "NSML": "non-structural mass",
    "NSML1": "non-structural mass",
    "BCONTACT": "contact",
    "BCTSET": "contact",
    "BGSET": "glue",
    "ACMODL": "fluid",
    "CFLUID2": "fluid",
    "CFLUID3": "fluid",
    "CFLUID4": "fluid",
    "ROTORG": "rotors",
    "DMIG": "matrices",
    "TF": "transfer functions",
}
_READ: tuple[str, ...] = (
    *("CONM1", "CONM2", "CMASS1", "CMASS2", "CELAS1", "CELAS2", "CDAMP1", "CDAMP2", "CVISC", "CBUSH", "CBUSH1D"),
    *("RBE2", "RBE3", "RBAR", "MPC", "MPCADD"),
)
_WTMASS = re.compile(rb"^[ \t]*PARAM[ \t]*[, \t][ \t]*WTMASS[ \t]*[, \t][ \t]*([^,\s$]+)", re.IGNORECASE | re.MULTILINE)
_TABLED = "its values depend on frequency or force (PBUSHT, PDAMPT, PELAST)"
#: Nodes that THRU may stand for.
_MOST_LISTED = 1_000_000
_WHOLE = re.compile(r"[-+]?[0-9]+")
_COMPONENTS = re.compile(r"(?!.*(.).*\1)[1-6]+")
_SCALAR = "it is at a scalar point, or a grid point that is not there"
_NO_PROPERTY = "its property is not in the deck"
_OBLIQUE = "a dependent node's own displacement system is turned against the global axes"
#: Cards that a mesh reader must ask for to make parts of a deck.
PART_CARDS = (*_READ, *_PROPERTIES, *_TABLES.values(), "PARAM", *_UNREAD)


@dataclass(frozen=True, eq=False)
class _DeckContext:
    """A deck with what its parts refer to.

    Attributes
    ----------
    positions : mapping of label to position in m
    axes : mapping of label to (3, 3) float array
        Directions of motion of grid points with a displacement system of their own.
    """

    cards: Mapping[str, Cards]
    systems: BulkSystems
    positions: Mapping[int, FloatArray]
    axes: Mapping[int, FloatArray]
    units: DeckUnits

    def axes_at(self, node: int) -> FloatArray:
        """Own directions of a grid point as rows."""
        return self.axes.get(node, np.eye(3))

    def axes_of(self, system: int, node: int) -> FloatArray:
        """Directions (3, 3) of the coordinate system number `system` at the grid point `node`, as rows."""
        position = self.positions[node] / self.units.length
        return self.systems.system(system).directions_at(position)[0]

    def rows(self, name: str) -> list[list[str]]:
        """The fields of each card of a name, in words."""
        return _words_of_cards(self.cards, name)


def read_parts(
    text: BulkText,
    cards: Mapping[str, Cards],
    systems: BulkSystems,
    positions: Mapping[int, FloatArray],
    axes: Mapping[int, FloatArray],
    units: DeckUnits,
) -> list[DeckPart]:
    """The parts of a deck beside its cells: masses, springs, rigid elements and the like, and others with an obstacle.

    An obstacle says why a part cannot be taken.

    Parameters
    ----------
    text : BulkText
        The bulk data, with case control.
    cards : mapping of name to Cards
    systems : BulkSystems
        Coordinate systems of the deck.
    positions : mapping of label to position in m
    axes : mapping of label to (3, 3) float array
        Directions of motion, as rows, of grid points with a displacement system of their own.
    units : DeckUnits
        Without PARAM,WTMASS, which is read here.

    Raises
    ------
    FileError
        If PARAM,WTMASS has several values, or one that is no number above 0.
    """
    units = DeckUnits(units.length, units.force, _mass_factor(text, cards))
    deck = _DeckContext(cards, systems, positions, axes, units)
    parts = [
        part
        for name, make in _readers(deck).items()
        if name in cards
        for part in _read_cards(name, _unrepeated(deck.rows(name)), make)
    ]
    parts += [part for name in _PROPERTIES for part in _unnumbered_properties(deck, name)]
    parts += _read_mpc_set(deck, text.case_control)
    counts = Counter({name: len(cards[name]) for name in _UNREAD if name in cards})
    parts += [DeckPart(name, count, obstacle=_UNREAD[name]) for name, count in counts.items()]
    return parts


def _mass_factor(text: BulkText, cards: Mapping[str, Cards]) -> float:
    """The value of PARAM,WTMASS in the bulk data or in case control, 1 without it.

    Raises `FileError` if there are several values, or one is no number above 0.
    """
    stated = [words[1] for words in _words_of_cards(cards, "PARAM") if words[0] == "WTMASS"]
    stated += [word.decode("latin-1").upper() for word in _WTMASS.findall(text.case_control)]
    for word in stated:
        if not (_is_number(word) and _real(word) > 0):
            raise FileError(
                f"{text.path}: has PARAM,WTMASS with the value {word!r}, which masses are multiplied by; write a number above 0, or"
                " leave the line out"
            )
    factors = {_real(word) for word in stated}
    if len(factors) > 1:
        raise FileError(
            f"{text.path}: has PARAM,WTMASS with the values {', '.join(stated)}, which masses are multiplied by; keep the one that"
            " holds"
        )
    return factors.pop() if factors else 1.0


#: Why a part cannot be taken, "" where it can, and the part.
ObstacleAndPart = tuple[str, DeckPart]
#: Fields of a property behind its number, and why it cannot be taken, by its number.
Properties = dict[int, tuple[list[str], str]]
#: Stiffness, damping and loss factors of a property, (6,) each, and why it cannot be taken.
BushValues = tuple[FloatArray, FloatArray, FloatArray, str]
Reader = Callable[[Sequence[str]], ObstacleAndPart]


def _readers(deck: _DeckContext) -> dict[str, Reader]:
    """Reader of one card, by the name of the card."""
    tables = {name: _properties(deck, name) for name in ("PELAS", "PDAMP", "PMASS")}
    bushes = {
        card: _read_values(_properties(deck, name), read)
        for card, name, read in (
            ("CBUSH", "PBUSH", _read_pbush),
            ("CBUSH1D", "PBUSH1D", _read_pbush1d),
            ("CVISC", "PVISC", _read_pvisc),
        )
    }
    return {
        "CONM1": partial(_read_body, deck, "CONM1"),
        "CONM2": partial(_read_body, deck, "CONM2"),
        "CMASS1": partial(_read_scalar_mass, deck, tables["PMASS"]),
        "CMASS2": partial(_read_scalar_mass, deck, None),
        "CELAS1": partial(_read_scalar_spring, deck, "CELAS1", tables["PELAS"]),
        "CELAS2": partial(_read_scalar_spring, deck, "CELAS2", None),
        "CDAMP1": partial(_read_scalar_spring, deck, "CDAMP1", tables["PDAMP"]),
        "CDAMP2": partial(_read_scalar_spring, deck, "CDAMP2", None),
        **{name: partial(_read_bush, deck, name, values) for name, values in bushes.items()},
        "RBE2": partial(_make_rigid_element, deck, "RBE2", _read_rbe2),
        "RBAR": partial(_make_rigid_element, deck, "RBAR", _read_rbar),
        "RBE3": partial(_make_rigid_element, deck, "RBE3", _read_rbe3),
    }


def _read_cards(name: str, rows: Sequence[Sequence[str]], reader: Reader) -> list[DeckPart]:
    """The parts that `reader` makes of all cards of a name: one of all that can be taken, one for each obstacle.

    `reader` takes the fields of a card and returns an obstacle ("" if none) and its part; `rows` are the fields of each
    card. Unreadable cards become a part with that obstacle, and so do those whose number stands twice.
    """
    items: list[ObstacleAndPart] = []
    counts = Counter(words[0] for words in rows)
    for words in rows:
        if counts[words[0]] > 1 and name != "MPC":  # there the first field is the number of a set
            items.append((f"{name} {words[0]} stands twice, with other fields", DeckPart(name, 1)))
            continue
        try:
            items.append(reader(words))
        except (ValueError, IndexError, KeyError) as error:
            items.append((f"{name} {words[0]} cannot be read: {error}", DeckPart(name, 1)))
    return split_by_obstacle(name, items)


def _unrepeated(rows: Sequence[list[str]]) -> list[list[str]]:
    """The `rows` of fields without those that repeat another, in order: solvers take whole cards that stand twice once."""
    return list({tuple(words): words for words in rows}.values())


def _words_of_cards(cards: Mapping[str, Cards], name: str) -> list[list[str]]:
    return [cards[name].row_words(row) for row in range(len(cards[name]))] if name in cards else []


def _real(word: str) -> float:
    return as_real(word.encode("latin-1")) if word else 0.0


def _whole(word: str) -> int:
    """The whole number `word`, 0 if it is blank; `ValueError` if it is none."""
    if word and not _WHOLE.fullmatch(word):
        raise ValueError(f"{word!r} is no whole number")
    return int(word or 0)


def _pad_words(words: Sequence[str], count: int) -> list[str]:
    return [*words, *[""] * (count - len(words))]


def _component_indices(word: str) -> list[int]:
    """The digits of `word`, components such as "123", as indices 0, 1, 2; `ValueError` unless all are 1 to 6, once."""
    if not _COMPONENTS.fullmatch(word):
        raise ValueError(f"components must be among 1 to 6, each once, got {word!r}")
    return [int(digit) - 1 for digit in word]


def _component_index(word: str) -> int:
    """The single component `word`, a digit from 1 to 6, as an index from 0; `ValueError` if it is another word."""
    if not re.fullmatch("[1-6]", word):
        raise ValueError(f"a component must be one digit from 1 to 6, got {word!r}")
    return int(word) - 1


def _read_body(deck: _DeckContext, name: str, fields: Sequence[str]) -> ObstacleAndPart:
    """Obstacle ("" if none) and deck part from a CONM1 or CONM2 card: the mass matrix of a grid point, SI units.

    `name` and `fields` are those of the card. A scalar point is an obstacle. Raises `ValueError` for a field that
    cannot be read.
    """
    words = _pad_words(fields, 24)
    node = _whole(words[1])
    if node not in deck.positions:
        return _SCALAR, DeckPart(name, 1, deck.units.mass * _real(words[3]))
    matrix = _conm2_matrix(deck, node, words) if name == "CONM2" else _conm1_matrix(deck, node, words)
    return "", DeckPart(name, 1, float(np.trace(matrix[:3, :3])) / 3, (NodalMass(node, matrix),))


def _read_scalar_mass(deck: _DeckContext, table: Properties | None, fields: Sequence[str]) -> ObstacleAndPart:
    """Obstacle ("" if none) and deck part from a CMASS1 or CMASS2 card: mass of one component of a grid point.

    `table` has the property values by number, None for CMASS2; `fields` are those of the card. Obstacles are a property
    that is not there, a scalar point, or a second node.
    """
    words = _pad_words(fields, 8)
    kind = "CMASS2" if table is None else "CMASS1"
    node, component = _whole(words[2]), words[3]
    values, problem = _values_of(words, table, words[1:2])
    if problem:
        return problem, DeckPart(kind, 1)
    value = _real(values[0])
    if node not in deck.positions or component in ("", "0"):
        return _SCALAR, DeckPart(kind, 1, deck.units.mass * value)
    if _whole(words[4]):
        return "it joins two nodes", DeckPart(kind, 1, deck.units.mass * value)
    axis = _component_index(component)
    matrix = np.zeros((6, 6))
    matrix[axis, axis] = value * (deck.units.inertia if axis > 2 else deck.units.mass)
    mass = NodalMass(node, turned_matrix(matrix, deck.axes_at(node)))
    return "", DeckPart(kind, 1, 0.0 if axis > 2 else deck.units.mass * value, (mass,))


def _conm2_matrix(deck: _DeckContext, node: int, fields: Sequence[str]) -> FloatArray:
    """Mass matrix (6, 6) of a CONM2 card in global directions and SI units, translations before rotations.

    `fields` are those of the card of the grid point `node`: also its coordinate system, -1 for a centre of gravity in
    basic coordinates. `deck` gives positions, coordinate systems and units.
    """
    system, mass = _whole(fields[2]), deck.units.mass * _real(fields[3])
    arm = deck.units.length * np.array([_real(word) for word in fields[4:7]])
    xx, yx, yy, zx, zy, zz = (deck.units.inertia * _real(word) for word in fields[8:14])
    inertia = np.array([[xx, -yx, -zx], [-yx, yy, -zy], [-zx, -zy, zz]])
    if system == -1:  # the centre of gravity itself, in basic coordinates
        return mass_matrix(mass, arm - deck.positions[node], inertia)
    return turned_matrix(mass_matrix(mass, arm, inertia), deck.axes_of(system, node))


def _conm1_matrix(deck: _DeckContext, node: int, fields: Sequence[str]) -> FloatArray:
    """Mass matrix (6, 6) of a CONM1 card in global directions and SI units, translations before rotations.

    `fields` are those of the card of the grid point `node`, with the lower triangle by rows; `deck` gives coordinate
    systems and units.
    """
    matrix = np.zeros((6, 6))
    matrix[np.tril_indices(6)] = [_real(word) for word in fields[3:24]]
    matrix += np.tril(matrix, -1).T
    scale = np.repeat([1.0, deck.units.length], 3)
    return turned_matrix(deck.units.mass * scale[:, None] * matrix * scale, deck.axes_of(_whole(fields[2]), node))


def _property_words(deck: _DeckContext, name: str) -> list[list[str]]:
    """Fields of each property on the cards `name` of `deck`, its number first; [] if there are none."""
    width = _PROPERTIES[name]
    rows = [_pad_words(row, 8) for row in deck.rows(name)]
    groups = [row[k : k + width] for row in rows for k in range(0, 8, width)] if width else rows
    return [words for words in groups if any(words)]


def _unnumbered_properties(deck: _DeckContext, name: str) -> list[DeckPart]:
    """The properties on the cards `name` of `deck` whose number is none, as a part with an obstacle; [] without any."""
    wrong = [words[0] for words in _property_words(deck, name) if not _WHOLE.fullmatch(words[0])]
    return [DeckPart(name, len(wrong), obstacle=f"it has {wrong[0]!r} for its number")] if wrong else []


def _properties(deck: _DeckContext, name: str) -> Properties:
    """Fields behind the number, and an obstacle, of each property on the cards `name` of `deck`, by its number.

    The obstacle is "" unless the property stands twice with other fields, or a table makes it depend on frequency or
    force. Properties whose number is none are left out.
    """
    table: Properties = {}
    for first, *words in _property_words(deck, name):
        if _WHOLE.fullmatch(first):
            number = int(first)
            before, problem = table.get(number, (words, ""))
            table[number] = (words, problem if words == before else f"its {name} stands twice, with other fields")
    for row in deck.rows(_TABLES.get(name, "")):
        number = int(row[0]) if _WHOLE.fullmatch(row[0]) else 0
        if number in table:
            table[number] = (table[number][0], _TABLED)
    return table


def _read_values(properties: Properties, read: Callable[[Sequence[str]], BushValues]) -> dict[int, BushValues]:
    """Values that `read` makes of the fields of each of the `properties`, by number; an obstacle says if it cannot."""
    values: dict[int, BushValues] = {}
    for number, (words, problem) in properties.items():
        try:
            stiffness, damping, losses, why = read(words)
            values[number] = (stiffness, damping, losses, problem or why)
        except ValueError as error:
            values[number] = (np.zeros(6), np.zeros(6), np.zeros(6), f"its property {number} cannot be read: {error}")
    return values


def _values_of(words: Sequence[str], table: Properties | None, own: list[str]) -> tuple[list[str], str]:
    """Values of an element in words, and an obstacle ("" if none): those of its property, or its `own` without a table.

    `words` are the fields of its card; its property is by default that of its own number. The obstacle is "" unless the
    property is not in the `table`, or has one itself.
    """
    if table is None:
        return own, ""
    return table.get(_whole(words[1]) or _whole(words[0]), ([], _NO_PROPERTY))


def _read_scalar_spring(
    deck: _DeckContext, name: str, table: Properties | None, fields: Sequence[str]
) -> ObstacleAndPart:
    """Obstacle ("" if none) and deck part from a CELAS1, CELAS2, CDAMP1 or CDAMP2 card `name`: a spring or dashpot.

    It acts between two components of grid points, or one and the ground. `table` has the property values by number,
    None for CELAS2 and CDAMP2; `fields` are those of the card. Obstacles are a property that is not there or tabled, a
    scalar point, and equal ends.
    """
    words = _pad_words(fields, 8)
    values, problem = _values_of(words, table, [words[1], words[6]])
    if problem:
        return problem, DeckPart(name, 1)
    both = ((-1.0, _whole(words[2]), words[3]), (1.0, _whole(words[4]), words[5]))
    ends = [(sign, node, component) for sign, node, component in both if node]
    if any(node not in deck.positions or component in ("", "0") for _, node, component in ends):
        return _SCALAR, DeckPart(name, 1)
    parts = ((node, _component_index(component), sign) for sign, node, component in ends)
    weights, is_rotation = weights_between(parts, deck.axes_at, deck.units)
    if not any(weights.values()):
        return "it joins a component with itself", DeckPart(name, 1)
    value = _real(values[0]) * deck.units.stiffness(is_rotation)
    is_spring = name.startswith("CELAS")
    loss = _real(values[1]) if is_spring else 0.0
    named = "" if table is None else words[1] or words[0]
    spring = DeckSpring(weights, value * is_spring, value * (not is_spring), loss, named)
    return "", DeckPart(name, 1, springs=(spring,))


def _read_bush(
    deck: _DeckContext, name: str, values: Mapping[int, BushValues], fields: Sequence[str]
) -> ObstacleAndPart:
    """Obstacle ("" if none) and deck part from a CBUSH, CBUSH1D or CVISC card: springs and dashpots along its axes.

    Obstacles are a property that is not there or has one itself, a scalar point, a spring off the line of its nodes,
    and stiffness across an axis that the card does not give. `name` and `fields` are those of the card; `values` has
    the stiffness (6,), damping (6,), loss factors (6,) and obstacle of each property, by number.
    """
    words = _pad_words(fields, 16)
    first, second = _whole(words[2]), _whole(words[3])
    number = _whole(words[1]) or _whole(words[0])
    if first not in deck.positions or (second and second not in deck.positions):
        return _SCALAR, DeckPart(name, 1)
    if first == second:
        return "it joins a node with itself", DeckPart(name, 1)
    if number not in values:
        return _NO_PROPERTY, DeckPart(name, 1)
    stiffness, damping, losses, problem = values[number]
    axes, obstacle = _bush_axes(deck, name, first, second, words)
    if name == "CBUSH" and (words[9] not in ("", "-1") or any(words[10:13])):
        problem = problem or "its spring stands off the line of its nodes"
    works = (stiffness != 0) | (damping != 0)
    if problem or axes is None or (works & ~np.tile(axes.any(axis=1), 2)).any():
        return problem or obstacle or "it has no orientation", DeckPart(name, 1)
    position = _real(words[8]) if words[8] and name == "CBUSH" else 0.5
    if not 0 <= position <= 1:
        return "its spring stands beyond the ends", DeckPart(name, 1)
    springs = []
    for component in np.flatnonzero(works).tolist():
        weights = _bush_weights(deck, first, second, axes[component % 3], component > 2, position)
        factor = deck.units.stiffness(component > 2)
        values_here = (factor * stiffness[component], factor * damping[component], float(losses[component]))
        springs.append(DeckSpring(weights, *values_here, words[1] or words[0]))
    return "", DeckPart(name, 1, springs=tuple(springs))


def _bush_weights(
    deck: _DeckContext, first: int, second: int, axis: FloatArray, is_rotation: bool, fraction: float
) -> dict[tuple[int, str], float]:
    """Weights, by (node, direction), of the displacement of the second end less the first along `axis` at the spring.

    `first` and `second` are labels of nodes, `second` 0 for the ground; `deck` has their positions. `axis` (3,) is a
    unit vector; rotations about it are meant if `is_rotation`. The spring is at `fraction` of the way from the first to
    the second node, and moves with each as a rigid body.
    """
    weights = weights_along(first, axis, is_rotation, -1.0)
    ends = [(first, -1.0, fraction), (second, 1.0, fraction - 1.0)] if second else [(first, -1.0, 0.0)]
    if second:
        weights |= weights_along(second, axis, is_rotation)
    if is_rotation or not second:
        return weights
    along = deck.positions[second] - deck.positions[first]
    for node, sign, part in ends:  # the spring's place moves with the node as a rigid body: u + rotation x arm
        lever = np.cross(part * along, axis)
        if np.abs(lever).max() > 1e-12 * float(np.linalg.norm(along)):
            for direction, weight in zip(DIRECTIONS[3:], sign * lever, strict=True):
                if weight:
                    weights[node, direction] = weights.get((node, direction), 0.0) + float(weight)
    return weights


def _bush_axes(
    deck: _DeckContext, name: str, first: int, second: int, fields: Sequence[str]
) -> tuple[FloatArray | None, str]:
    """Axes of the element as rows (3, 3), zero where the card does not state them, and an obstacle ("" if none).

    They are in global directions; None with an obstacle, or, without one, if a CBUSH has neither a coordinate system
    nor a length. `first` and `second` (0 for the ground) are its nodes, `fields` those of the card `name`; `deck` gives
    positions and systems.
    """
    system = fields[7] if name == "CBUSH" else fields[4] if name == "CBUSH1D" else ""
    if system:
        return deck.axes_of(_whole(system), first), ""
    along = deck.positions[second] - deck.positions[first] if second else np.zeros(3)
    length = float(np.linalg.norm(along))
    if length == 0:
        return (None, "") if name == "CBUSH" else (None, "its nodes are at one place")
    x = along / length
    if name != "CBUSH" or not any(fields[4:7]):
        return np.stack([x, np.zeros(3), np.zeros(3)]), ""
    if fields[4] and not any(fields[5:7]) and "." not in fields[4]:
        other = _whole(fields[4])
        if other not in deck.positions:
            return None, f"its orientation node {other} is not there"
        vector = deck.positions[other] - deck.positions[first]
    else:
        vector = np.array([_real(word) for word in fields[4:7]]) @ deck.axes_at(first)
    z = np.cross(x, vector)
    if not np.linalg.norm(z) > 1e-9 * np.linalg.norm(vector):
        return None, "its orientation is along its axis, or has no length"
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z]), ""


def _read_pbush(words: Sequence[str]) -> BushValues:
    """Stiffness (6,), damping (6,), loss factors (6,) and obstacle of a PBUSH card, in the unit of the file.

    `words` are its fields behind the number. The obstacle is "" unless the stiffness is rigid or has a mass; the first
    GE holds for all directions where the others are 0. Raises `ValueError` for a value whose meaning is not stated.
    """
    numbers = {"K": np.zeros(6), "B": np.zeros(6), "GE": np.zeros(6)}
    problem, flag, index = "", "", 0
    others = ("M", "RCV", "KMAG", "T", "ALPHA", "TREF")
    for word in words:
        if word in numbers or word in others:
            flag, index = word, 0
            problem = "its stiffness is rigid or has a mass" if word in ("KMAG", "M") else problem
        elif word and (not flag or (flag in numbers and index > 5)):
            raise ValueError(f"{word} stands behind no K, B or GE, or is a seventh value")
        elif flag in numbers and index < 6:
            if word == "RIGID":
                problem = "its stiffness is rigid"
            else:
                numbers[flag][index] = _real(word)
            index += 1
    losses = numbers["GE"] if numbers["GE"][1:].any() else np.full(6, numbers["GE"][0])
    return numbers["K"], numbers["B"], losses, problem


def _read_pbush1d(words: Sequence[str]) -> BushValues:
    """Stiffness (6,), damping (6,), loss factors (6,) and obstacle of a PBUSH1D card, in the unit of the file.

    `words` are its fields behind the number. Only the first, axial, entries are not 0, and loss factors are 0; the
    obstacle is "" unless it has a mass or is nonlinear.
    """
    problem = "it has a mass or is nonlinear" if _real(words[2]) or any(words[7:]) else ""
    return _axial(words[0]), _axial(words[1]), np.zeros(6), problem


def _read_pvisc(words: Sequence[str]) -> BushValues:
    """Stiffness (0), damping (6,), loss factors (0) and obstacle ("") of a PVISC property, in the unit of the file.

    `words` are its fields behind the number. Axial and torsional damping are entries 0 and 3.
    """
    damping = _axial(words[0])
    damping[3] = _real(words[1])
    return np.zeros(6), damping, np.zeros(6), ""


def _axial(word: str) -> FloatArray:
    """Six element stiffnesses or dampings with the number `word` along the axis and 0 elsewhere, (6,)."""
    values = np.zeros(6)
    values[0] = _real(word)
    return values


#: Why a rigid element cannot be taken, "" where it can, and its ties.
ObstacleAndTies = tuple[str, list[RigidLink | Constraint]]


def _make_rigid_element(
    deck: _DeckContext, name: str, make: Callable[[_DeckContext, Sequence[str]], ObstacleAndTies], fields: Sequence[str]
) -> ObstacleAndPart:
    """Obstacle ("" if none) and deck part `name` with the rigid links and constraints that `make` makes of a card.

    `fields` are those of the card.
    """
    obstacle, ties = make(deck, fields)
    return obstacle, DeckPart(name, 1, ties=tuple(ties))


def _read_rbe2(deck: _DeckContext, fields: Sequence[str]) -> ObstacleAndTies:
    """Obstacle ("" if none) and ties from an RBE2 card: nodes that follow a main node in some components.

    `fields` are those after the card's name; `deck` has positions and directions of nodes. Obstacles are scalar points
    and oblique directions; there are no ties then. Raises `ValueError` or `IndexError` for a field that cannot be read.
    """
    main = _whole(fields[1])
    listed = [word for word in fields[3:] if word]
    while listed and "." in listed[-1]:  # ALPHA and TREF
        listed.pop()
    dependents = _node_list(listed)
    if main not in deck.positions or not set(dependents) <= set(deck.positions):
        return _SCALAR, []
    return _follow_rigidly(deck, f"rbe2 {fields[0]}", main, dependents, fields[2])


def _follow_rigidly(
    deck: _DeckContext, name: str, main: int, dependents: Sequence[int], components: str
) -> ObstacleAndTies:
    """Obstacle ("" if none) and ties of nodes that follow the node `main` rigidly in some of their components.

    `dependents` are these nodes, whose positions and directions `deck` has; `components` are digits from 1 to 6, such
    as "123"; with all six the tie is a rigid link called `name`, else a constraint each, and oblique directions are an
    obstacle, without ties.
    """
    dependents = list(dict.fromkeys(dependents))
    if not dependents or main in dependents:
        raise ValueError(f"it needs dependent nodes other than its main node {main}")
    if set(_component_indices(components)) == set(range(6)):
        return "", [RigidLink(name, main, dependents)]
    ties: list[RigidLink | Constraint] = []
    for node in dependents:
        arm = deck.positions[node] - deck.positions[main]
        rows = rigid_constraints(name, main, node, arm, deck.axes_at(node), _component_indices(components))
        if rows is None:
            return _OBLIQUE, []
        ties += rows
    return "", ties


def _read_rbar(deck: _DeckContext, fields: Sequence[str]) -> ObstacleAndTies:
    """Obstacle ("" if none) and ties from an RBAR card: one of its two nodes follows the other rigidly.

    Obstacles are independent components at both nodes, and scalar points; there are no ties then. `fields` are those
    after the card's name; `deck` has positions and directions of nodes.
    """
    padded = _pad_words(fields, 8)
    first, second = _whole(padded[1]), _whole(padded[2])
    independent_first, independent_second, dependent_first, dependent_second = (word.strip("0") for word in padded[3:7])
    if first not in deck.positions or second not in deck.positions:
        return _SCALAR, []
    name = f"rbar {padded[0]}"
    if sorted(independent_first) == list("123456") and not independent_second:
        return _follow_rigidly(deck, name, first, [second], dependent_second or "123456")
    if sorted(independent_second) == list("123456") and not independent_first:
        return _follow_rigidly(deck, name, second, [first], dependent_first or "123456")
    return "its independent components are at both nodes", []


def _read_rbe3(deck: _DeckContext, fields: Sequence[str]) -> ObstacleAndTies:
    """Obstacle ("" if none) and ties from an RBE3 card: a reference node moves as the weighted mean of others.

    The mean is the least-squares fit of a rigid motion; the constraints are solved for the components that UM names, by
    default those of the reference node. Obstacles are scalar points, oblique directions, and a motion or dependents
    that are not determined. `fields` are those after the card's name; `deck` has positions and directions of nodes.
    """
    reference, chosen = _whole(fields[2]), _component_indices(fields[3])
    averaged, solved_for = _averaged_groups(fields[4:])
    all_nodes = [reference, *(node for _, _, nodes in averaged for node in nodes), *(node for node, _ in solved_for)]
    if not set(all_nodes) <= set(deck.positions):
        return _SCALAR, []
    components = [
        Component(node, deck.axes_at(node)[component % 3], component > 2, weight)
        for weight, which, nodes in averaged
        for node in nodes
        for component in _component_indices(which)
    ]
    mean = mean_motion(deck.positions[reference], components, deck.positions)
    if mean is None:
        return "its nodes do not determine the motion of the reference node", []
    rows = mean_rows(reference, deck.axes_at(reference), chosen, components, mean)
    dependents: list[tuple[int, str]] = []
    for node, which in solved_for or [(reference, fields[3])]:
        directions = global_directions(deck.axes_at(node), _component_indices(which))
        if directions is None:
            return _OBLIQUE, []
        dependents += [(node, direction) for direction in directions]
    constraints = solved_constraints(f"rbe3 {fields[0]}", rows, dependents)
    if constraints is None:
        return "what it names as dependent (UM) is not determined by it", []
    return "", list(constraints)


def _averaged_groups(fields: Sequence[str]) -> tuple[list[tuple[float, str, list[int]]], list[tuple[int, str]]]:
    """Weight, components (digits) and nodes of each group of an RBE3, and the pairs of node and components behind UM.

    `fields` are those of the card from the first weight on; `ValueError` if that is blank, so that what follows is
    none, or a later field that may be a weight is and components may follow.
    """
    if not fields[:1] or not fields[0]:
        raise ValueError("its first weight is blank")
    groups: list[tuple[float, str, list[int]]] = []
    end = next((k for k, word in enumerate(fields) if word in ("UM", "ALPHA", "TREF")), len(fields))
    for blank, word in pairwise(fields[:end]):
        if not blank and _COMPONENTS.fullmatch(word):
            raise ValueError(
                f"a field before {word} is blank, where a weight may be left out; write the weight, or the nodes without gaps"
            )
    averaged, behind = ([word for word in part if word] for part in (fields[:end], fields[end:]))
    while averaged:
        stop = next((k for k in range(2, len(averaged)) if not _is_listed(averaged[k])), len(averaged))
        if stop == 2:
            raise ValueError(f"the weight {averaged[0]} has no nodes")
        groups.append((_real(averaged[0]), averaged[1], _node_list(averaged[2:stop])))
        averaged = averaged[stop:]
    named = behind[1:] if behind[:1] == ["UM"] else []
    named = named[: next((k for k, word in enumerate(named) if word in ("ALPHA", "TREF")), len(named))]
    return groups, [(_whole(node), which) for node, which in zip(named[::2], named[1::2], strict=True)]


def _is_listed(word: str) -> bool:
    return word.isdigit() or word in ("THRU", "BY")


def _is_number(word: str) -> bool:
    """True if the field `word` is a real number or blank."""
    try:
        _real(word)
    except ValueError:
        return False
    return True


def _node_list(fields: Sequence[str]) -> list[int]:
    """Node labels in the `fields` of a card, in order, with all those from one THRU another, BY steps.

    Raises `ValueError` if a range is too long or a field is no whole number.
    """
    labels: list[int] = []
    rest = [word for word in fields if word]
    while rest:
        if rest[1:2] == ["THRU"]:
            first, last, step = _whole(rest[0]), _whole(rest[2]), _whole(rest[4]) if rest[3:4] == ["BY"] else 1
            if step < 1 or last < first:
                raise ValueError(f"steps of {step} do not lead from {first} to {last}")
            if (last - first) // step > _MOST_LISTED:
                raise ValueError(f"{first} THRU {last} are more than {_MOST_LISTED} nodes")
            labels += range(first, last + 1, step)
            rest = rest[5 if rest[3:4] == ["BY"] else 3 :]
        else:
            labels.append(_whole(rest.pop(0)))
    return labels


def _read_mpc_set(deck: _DeckContext, case_control: bytes) -> list[DeckPart]:
    """Parts of the MPC cards of the set that case control names, itself or as an MPCADD, or of the only set there is.

    One part of all cards that can be taken and one for each obstacle; a single part with an obstacle where case control
    (text with CEND) names no set, the number of one cannot be read, or it is not clear which is meant; [] without MPC
    cards. `case_control` is the text
    above the bulk data, `deck` has the cards.
    """
    if "MPC" not in deck.cards:
        return []
    named = [words[0] for words in deck.rows("MPC")]
    named += [word for words in deck.rows("MPCADD") for word in words if word]
    if wrong := [word for word in named if not _WHOLE.fullmatch(word)]:
        return [DeckPart("MPC", len(deck.cards["MPC"]), obstacle=f"{wrong[0]!r} is no number of a set")]
    sets: dict[int, list[list[str]]] = {}
    for words in deck.rows("MPC"):
        sets.setdefault(int(words[0]), []).append(words)
    set_numbers = re.findall(rb"^\s*MPC\s*=\s*(\d+)", case_control, re.MULTILINE | re.IGNORECASE)
    count = sum(len(rows) for rows in sets.values())
    if not set_numbers and re.search(rb"^\s*CEND\b", case_control, re.MULTILINE | re.IGNORECASE):
        return [DeckPart("MPC", count, obstacle="case control asks for no set of MPC (`MPC = ...`)")]
    chosen = {int(number) for number in set_numbers} or (set(sets) if len(sets) == 1 else set())
    sums = {int(words[0]): {int(word) for word in words[1:] if word} for words in deck.rows("MPCADD")}
    members = sums.get(next(iter(chosen)), chosen) if len(chosen) == 1 else set()
    if not members or not members <= set(sets):
        return [DeckPart("MPC", count, obstacle="it is not clear which set of MPC is meant")]
    rows = [words for number in sorted(members) for words in sets[number]]
    return _read_cards("MPC", rows, partial(_make_rigid_element, deck, "MPC", _read_mpc))


def _read_mpc(deck: _DeckContext, fields: Sequence[str]) -> ObstacleAndTies:
    """Obstacle and tie of one MPC card, whose factors times components add up to 0: ("", [tie]) or (obstacle, []).

    `fields` are those after the card's name, the set's number first. The first component is the dependent one. `deck`
    has directions and units. Terms along a grid point's own directions are put into global ones and added up; obstacles
    are scalar points and an oblique first term.
    """
    terms: list[tuple[int, str, float]] = []
    for start in range(0, len(fields), 8):
        for column in (start + 1, start + 4):
            triple = _pad_words(fields, start + 8)[column : column + 3]
            if triple[0]:
                terms.append((_whole(triple[0]), triple[1], _real(triple[2])))
            elif any(triple):
                raise ValueError(f"a term {', '.join(triple)!r} has no grid point")
    if any(node not in deck.positions or component in ("", "0") for node, component, _ in terms):
        return _SCALAR, []
    sums: list[tuple[Dof, float]] = []
    for node, component, factor in terms:
        axis = _component_index(component)
        for (label, direction), part in weights_along(node, deck.axes_at(node)[axis % 3], axis > 2).items():
            sums.append((Dof(label, direction), factor * part * (deck.units.length if axis > 2 else 1.0)))
    first_axis = deck.axes_at(terms[0][0])[_component_index(terms[0][1]) % 3]
    if np.abs(first_axis).max() < 1 - 1e-12:
        return _OBLIQUE, []
    constraint = solved_for_first(f"mpc {sums[0][0].unsigned}", sums)
    return ("", [constraint]) if constraint is not None else ("the factor of its dependent term is 0", [])
