"""Masses, springs, dashpots and constraints of Abaqus and CalculiX input files as parts of a deck."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.fem.meshes.abaqus_assembly import Assembly, PartData, system_form
from structid.fem.meshes.abaqus_keywords import KeywordBlock, number_of, numbers_of
from structid.fem.meshes.abaqus_surfaces import Footpoint, Surface, Surfaces, footpoint, mean_side, nodal_areas
from structid.fem.meshes.averages import (
    Component,
    global_directions,
    mean_motion,
    mean_rows,
    rigid_constraints,
    solved_constraints,
    solved_for_first,
)
from structid.fem.meshes.coordinate_systems import CoordinateSystem, axes_from_x, axes_of_points
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

#: Element types that are no cells; those that structid has elements for have a section keyword.
_PART_TYPES = re.compile(
    r"(?:MASS|ROTARYI|HEATCAP|SPRING[12A]|DASHPOT[12A]|CONN[23]D2|JOINTC|JOINT2D|JOINT3D|GAP\w*|ITS\w+|DCOUP[23]D|"
    r"DISTRIB\w*|PSI\d\d|FLINK|D|RB[23]D\w*|DRAG[23]D|SPH\w*|PC3D|COH\w*)"
)
_SPRINGS = {"SPRING": ("SPRING1", "SPRING2", "SPRINGA"), "DASHPOT": ("DASHPOT1", "DASHPOT2", "DASHPOTA")}
#: Keywords that are listed, and why nothing stands for them.
_UNREAD = {
    "EMBEDDED ELEMENT": "embedded elements",
    "CONTACT PAIR": "contact",
    "CONTACT": "contact",
    "PRE-TENSION SECTION": "pretension of bolts",
    "CYCLIC SYMMETRY MODEL": "cyclic symmetry",
    "SHELL TO SOLID COUPLING": "shells coupled to solids",
    "DISTRIBUTING COUPLING": "distributing couplings",
    "FASTENER": "fasteners",
    "RELEASE": "released ends of beams",
    "SUBMODEL": "submodels",
    "NONSTRUCTURAL MASS": "non-structural mass; add it to the density",
    "CONNECTOR SECTION": "connectors",
    "GAP": "gaps",
    "BEAM ADDED INERTIA": "mass along beams; add it to the density",
    "BEAM FLUID INERTIA": "mass of the fluid along beams; add it to the density",
    "REBAR": "reinforcement",
    "REBAR LAYER": "reinforcement",
    "SURFACE SECTION": "surfaces that carry mass",
    "FOUNDATION": "elastic foundations",
    "MASS ADJUST": "masses that are scaled to a total",
    "MODEL CHANGE": "elements that a step removes or adds",
    "JOINT": "joints",
    "SUBSTRUCTURE PROPERTY": "substructures",
    "MATRIX ASSEMBLE": "matrices",
}
#: Why a part cannot be taken, "" where it can, and the part.
ObstaclesAndParts = list[tuple[str, DeckPart]]
#: Part of the mean side of faces within which a node is tied where a file does not say it, as in Abaqus.
_NEAR = 0.05
_UNSORTED = "its nodes are paired in the order of a set (UNSORTED)"
_EMPTY = "its sets hold no node that is there"
_TURNED = "it stands in a turned instance"
_LOCAL = "its nodes have directions of their own (*TRANSFORM)"


def is_part(kind: str) -> bool:
    """True if elements of an Abaqus type are masses, springs and the like instead of cells."""
    return _PART_TYPES.fullmatch(kind.upper()) is not None


@dataclass(frozen=True, eq=False)
class _AssemblyContext:
    """An assembly with what its parts refer to.

    Attributes
    ----------
    positions : mapping of label to position in m
    axes : mapping of label to (3, 3) float array
        Directions of motion, as rows, of nodes that have their own.
    """

    path: Path
    assembly: Assembly
    positions: Mapping[int, FloatArray]
    axes: Mapping[int, FloatArray]
    units: DeckUnits
    surfaces: Surfaces

    @cached_property
    def turning(self) -> frozenset[int]:
        """Nodes of shells and beams."""
        return frozenset(
            self.assembly.node(scope, word)
            for scope in self.assembly.all_scopes
            for kind, table in scope.elements.items()
            if re.fullmatch(r"(?:S|STRI|B2|B3)\d.*", kind)
            for words in table.values()
            for word in words
        )

    def blocks(self, *keywords: str) -> Iterator[tuple[PartData, KeywordBlock]]:
        """Yield every block with one of the `keywords`, with the part, instance or assembly that it stands in."""
        for scope in self.assembly.all_scopes:
            for block in scope.blocks:
                if block.keyword in keywords:
                    yield scope, block

    def read(
        self, keyword: str, reader: Callable[[_AssemblyContext, PartData, KeywordBlock], ObstaclesAndParts]
    ) -> list[DeckPart]:
        """Deck parts of a keyword: one of all blocks that can be taken, one for each obstacle, as they first occur.

        `reader` returns pairs (obstacle, part) of a block in its scope; the obstacle is "" if there is none. Blocks
        that cannot be read count as parts with an obstacle that says why. [] if the deck has no such block.
        """
        items: ObstaclesAndParts = []
        for scope, block in self.blocks(keyword):
            try:
                items += reader(self, scope, block)
            except (ValueError, IndexError, KeyError) as error:
                items.append((f"line {block.line} cannot be read: {error}", DeckPart(keyword, 1)))
        return split_by_obstacle(keyword, items)

    def members_of(self, scope: PartData, name: str) -> list[tuple[PartData, set[int]]]:
        """Elements of the set `name` as pairs of the instance (or the assembly) and labels in it.

        The set is looked up in `scope`, a part, an instance or the assembly. Raises `ValueError` if there is none.
        """
        is_assembly = scope is self.assembly.own
        members = dict(self.assembly.cell_sets.get(name.upper(), {})) if is_assembly else {}
        if name.upper() in scope.cell_sets:
            members[scope.name.upper()] = members.get(scope.name.upper(), set()) | scope.cell_sets[name.upper()]
        if not members:
            raise ValueError(f"there is no element set {name!r}")
        return [
            (scope if owner == scope.name.upper() else self.assembly.scope(owner), labels)
            for owner, labels in members.items()
        ]

    def elements_of(self, scope: PartData, name: str, kinds: Sequence[str]) -> list[tuple[str, list[int]]]:
        """Type and node labels in the mesh of each element in the set `name` that is of one of the types `kinds`.

        The set is looked up in `scope`, a part, an instance or the assembly. Raises `ValueError` if there is none.
        """
        elements = []
        for holder, labels in self.members_of(scope, name):
            for kind in kinds:
                table = holder.elements.get(kind, {})
                for label in sorted(labels & set(table)):
                    elements.append((kind, [self.assembly.node(holder, word) for word in table[label]]))
        return elements


def displacement_axes(
    path: Path, assembly: Assembly, positions: Mapping[int, FloatArray], length: float
) -> dict[int, FloatArray]:
    """Directions of motion (3, 3), as rows in global axes, of each node that a *TRANSFORM turns, by label.

    Nodes whose directions are the global ones are left out. `positions` are those of all nodes by label, in m; `length`
    is the file's unit in m. `path` is for errors.

    Raises
    ------
    FileError
        If the points of a *TRANSFORM lie on a line, or its node set is not there.
    """
    deck = _AssemblyContext(path, assembly, positions, {}, DeckUnits(), Surfaces(assembly, lambda name: (name, 0)))
    axes: dict[int, FloatArray] = {}
    for scope, block in deck.blocks("TRANSFORM"):
        try:
            points = np.array(numbers_of([word for row in block.rows for word in row], 6)).reshape(2, 3)
            form = system_form(block.options.get("TYPE", ""))
            if not form:
                raise ValueError(f"there is no TYPE={block.options['TYPE']}; write R, C or S")
            shift = np.zeros(3) if form == "R" else scope.shift
            a, b = length * (points @ scope.turn.T + shift)
            for node in assembly.nodes(scope, block.options.get("NSET", "")):
                directions = _axes_at(form, a, b, positions[node])
                if np.abs(directions - np.eye(3)).max() > 1e-12:
                    axes[node] = directions
        except (ValueError, IndexError, KeyError) as error:
            raise FileError(
                f"{path}, line {block.line}: cannot read the lines of *TRANSFORM ({error}); export it again"
            ) from error
    return axes


def _axes_at(form: str, a: FloatArray, b: FloatArray, position: FloatArray) -> FloatArray:
    """Directions (3, 3), as rows, of a *TRANSFORM at a node in `position`; `ValueError` if its points lie on a line.

    `form` R, rows x, y, z: points `a` on x and `b` in x-y; C, rows radial, around, along the axis: `a` and `b` on it,
    where any radial direction will do; S, rows radial, around, towards the pole: centre `a` and pole `b`, on whose
    line `position` must not lie. All points are (3,), in one unit.
    """
    if form == "R":
        directions = axes_from_x(np.zeros(3), a, b)
    elif form == "C":
        reference = np.eye(3)[int(np.argmin(abs(b - a)))]
        axes = axes_of_points(a, b, a + reference)
        directions = None if axes is None else CoordinateSystem("C", a, axes).directions_at(position)[0]
    else:
        axes = axes_of_points(a, position, b)
        directions = None if axes is None else axes[[2, 1, 0]] * [[1.0], [-1.0], [1.0]]
    if directions is None:
        raise ValueError("the points of the system lie on a line")
    return directions


def read_parts(
    path: Path,
    assembly: Assembly,
    positions: Mapping[int, FloatArray],
    axes: Mapping[int, FloatArray],
    units: DeckUnits,
    surfaces: Surfaces,
) -> list[DeckPart]:
    """The parts of an input file beside its cells: masses, springs, ties and the like, and others with an obstacle.

    An obstacle says why a part cannot be taken. `positions` (m) and `axes` (displacement axes (3, 3), those that differ
    from the global ones) are by node label; `units` are those of the file, `surfaces` its surfaces. Blocks that cannot
    be read become parts with that obstacle.
    """
    deck = _AssemblyContext(path, assembly, positions, axes, units, surfaces)
    parts = [
        *deck.read("MASS", _read_point_masses),
        *deck.read("ROTARY INERTIA", _read_rotary_inertias),
        *deck.read("SPRING", _read_springs),
        *deck.read("DASHPOT", _read_springs),
        *deck.read("EQUATION", _read_equations),
        *deck.read("MPC", _read_multi_point),
        *deck.read("RIGID BODY", _read_rigid_body),
        *deck.read("KINEMATIC COUPLING", _read_kinematic_coupling),
        *deck.read("COUPLING", _read_coupling),
        *deck.read("TIE", _read_surface_tie),
    ]
    for keyword, why in _UNREAD.items():
        count = sum(1 for _ in deck.blocks(keyword))
        parts += [DeckPart(keyword, count, obstacle=why)] if count else []
    parts += _elements_without_values(deck)
    counts: dict[str, int] = {}
    read_kinds = {"MASS", "ROTARYI"} | {kind for kinds in _SPRINGS.values() for kind in kinds}
    for scope in deck.assembly.all_scopes:
        for kind, table in scope.elements.items():
            if is_part(kind) and kind not in read_kinds:
                counts[kind] = counts.get(kind, 0) + len(table)
    return [*parts, *(DeckPart(kind, count, obstacle="no element for it") for kind, count in counts.items())]


def _elements_without_values(deck: _AssemblyContext) -> list[DeckPart]:
    """Masses, springs and dashpots of which no keyword says the value, a part with an obstacle for each keyword."""
    parts = []
    for keyword, kinds in {"MASS": ("MASS",), "ROTARY INERTIA": ("ROTARYI",), **_SPRINGS}.items():
        valued: dict[str, set[int]] = {}
        for scope, block in deck.blocks(keyword):
            with suppress(ValueError):  # a set that is not there is told where the keyword is read
                for holder, labels in deck.members_of(scope, block.options.get("ELSET", "")):
                    valued.setdefault(holder.name, set()).update(labels)
        count = sum(
            len(set(scope.elements.get(kind, {})) - valued.get(scope.name, set()))
            for scope in deck.assembly.all_scopes
            for kind in kinds
        )
        parts += [DeckPart(keyword, count, obstacle=f"no *{keyword} gives its value")] if count else []
    return parts


def _read_point_masses(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of a *MASS block: one point mass in kg for each element of its set.

    The obstacle is "" unless the mass differs by direction. Names are looked up in `scope` of `deck`, where the block
    stands. Raises `ValueError` if there is no such set.
    """
    name = block.options.get("ELSET", "")
    values = numbers_of(block.rows[0], 3 if any(block.rows[0][1:]) else 1)
    mass = deck.units.mass * values[0]
    matrix = mass_matrix(mass, np.zeros(3), np.zeros((3, 3)))
    obstacle = "" if len(set(values)) == 1 else "it is not the same in all directions"
    nodes = [nodes[0] for _, nodes in deck.elements_of(scope, name, ["MASS"])]
    return [(obstacle, DeckPart("MASS", 1, mass, (NodalMass(node, matrix, name),))) for node in nodes]


def _read_rotary_inertias(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of a *ROTARY INERTIA block: one for each element of its set, turned with the instance.

    The obstacle is "" unless an orientation is given. Values are xx, yy, zz, xy, xz, yz, those left out 0. Names are
    looked up in `scope` of `deck`, where the block stands. Raises `ValueError` if there is no such set.
    """
    name = block.options.get("ELSET", "")
    xx, yy, zz, xy, xz, yz = (deck.units.inertia * value for value in numbers_of(block.rows[0], 6))
    matrix = np.zeros((6, 6))
    matrix[3:, 3:] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    turned = turned_matrix(matrix, scope.turn.T)
    obstacle = "its axes have an orientation" if block.options.get("ORIENTATION") else ""
    nodes = [nodes[0] for _, nodes in deck.elements_of(scope, name, ["ROTARYI"])]
    return [(obstacle, DeckPart("ROTARY INERTIA", 1, masses=(NodalMass(node, turned, name),))) for node in nodes]


def _read_springs(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle or "", part in any case) of a *SPRING or *DASHPOT block: one for each element of its set.

    Obstacles: values nonlinear, complex or tabled; orientation; turned instance; nodes at one place; a component
    joined to itself. Types end in 1 (ground), 2 (two freedoms), A (along a line). `ValueError` if there is no set.
    """
    name = block.options.get("ELSET", "")
    rows = [row for row in block.rows if any(row)]
    obstacle = "it is nonlinear" if "NONLINEAR" in block.options else ""
    obstacle = "its directions have an orientation" if block.options.get("ORIENTATION") else obstacle
    obstacle = "its stiffness has a loss" if "COMPLEX STIFFNESS" in block.options else obstacle
    items: ObstaclesAndParts = []
    for kind, nodes in deck.elements_of(scope, name, _SPRINGS[block.keyword]):
        table = rows if kind.endswith("A") else rows[1:]
        tabled = "its values depend on frequency, temperature or fields" if len(table) > 1 else ""
        value = number_of(table[0][0])
        weights, why, is_rotation = _spring_weights(deck, scope, kind, nodes, rows[0])
        value *= deck.units.stiffness(is_rotation)
        is_spring = block.keyword == "SPRING"
        spring = DeckSpring(weights, value * is_spring, value * (not is_spring), 0.0, name)
        items.append((obstacle or tabled or why, DeckPart(block.keyword, 1, springs=(spring,))))
    return items


def _spring_weights(
    deck: _AssemblyContext, scope: PartData, kind: str, nodes: Sequence[int], row: Sequence[str]
) -> tuple[dict[tuple[int, str], float], str, bool]:
    """Weights by (node, direction) of the displacements that a spring acts on, an obstacle, and True if rotational.

    The obstacle is "" if there is none, else weights mean nothing. `deck` has positions and axes of nodes, `kind` is
    the element type of the spring, `nodes` are its nodes, `row` is the data line with its degrees of freedom (from 1),
    and `scope` the instance, which may be turned. Raises `ValueError` if degrees of freedom are missing, or not from 1
    to 6.
    """
    if kind.endswith("A"):
        along = deck.positions[nodes[1]] - deck.positions[nodes[0]]
        length = float(np.linalg.norm(along))
        if not length:
            return {}, "its nodes are at one place", False
        axis = along / length
        return weights_along(nodes[0], axis, False, -1.0) | weights_along(nodes[1], axis), "", False
    if np.abs(scope.turn - np.eye(3)).max() > 1e-12:
        return {}, _TURNED, False
    words = [word for word in row[: len(nodes)] if word]
    if len(words) < len(nodes):
        raise ValueError(f"{kind} needs {len(nodes)} degrees of freedom")
    components = [_component_of(word) for word in words]
    ends = zip(nodes, components, (1.0, -1.0), strict=False)
    weights, is_rotation = weights_between(ends, lambda node: deck.axes.get(node, np.eye(3)), deck.units)
    return weights, "" if any(weights.values()) else "it joins a component with itself", is_rotation


Ties = list[RigidLink | Constraint]


def _read_equations(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of an *EQUATION block: a constraint for each equation and node.

    The obstacle is "" if there is none. The first term of an equation is the dependent one. Names are looked up in
    `scope` of `deck`, where the block stands. Raises `ValueError` if terms are missing.
    """
    items: ObstaclesAndParts = []
    rows = [[word for word in row if word] for row in block.rows if any(row)]
    while rows:
        said = number_of(rows.pop(0)[0])
        count, words = int(said), list[str]()
        if count < 1 or count != said:
            raise ValueError(f"an equation has {said:g} terms")
        while len(words) < 3 * count and rows:
            words += rows.pop(0)
        if len(words) != 3 * count:
            raise ValueError(f"an equation of {count} terms has {len(words)} words instead of {3 * count}")
        items += _make_equation(deck, scope, [words[3 * k : 3 * k + 3] for k in range(count)])
    return items


def _make_equation(deck: _AssemblyContext, scope: PartData, terms: Sequence[Sequence[str]]) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of an equation: a constraint for each node where terms name node sets.

    A turned instance, a node with directions of its own and a term that is no displacement are obstacles: a single pair
    then; else they are "". Sets are looked up in `scope` of `deck`. `terms` are (node or set, component from 1, factor)
    in words, the dependent one first. Raises `ValueError` if the sets differ in size.
    """
    if np.abs(scope.turn - np.eye(3)).max() > 1e-12:
        return [(_TURNED, DeckPart("EQUATION", 1))]
    nodes = [deck.assembly.nodes(scope, term[0]) for term in terms]
    count = max(map(len, nodes))
    if not all(nodes):
        return [(_EMPTY, DeckPart("EQUATION", max(count, 1)))]
    if any(_is_unsorted(deck, scope, term[0]) for term in terms):
        return [(_UNSORTED, DeckPart("EQUATION", count))]
    if any(len(labels) not in (1, count) for labels in nodes):
        raise ValueError("the sets of an equation differ in size")
    items: list[tuple[str, DeckPart]] = []
    for index in range(count):
        pairs = []
        for labels, (_, component, factor) in zip(nodes, terms, strict=True):
            label, axis = labels[min(index, len(labels) - 1)], int(component) - 1
            if label not in deck.positions or not 0 <= axis <= 5:
                return [("it works on no displacement", DeckPart("EQUATION", count))]
            if label in deck.axes:
                return [(_LOCAL, DeckPart("EQUATION", count))]
            pairs.append((Dof(label, DIRECTIONS[axis]), number_of(factor) * (deck.units.length if axis > 2 else 1.0)))
        tie = solved_for_first(f"equation {pairs[0][0].unsigned}", pairs)
        if tie is None:
            return [("the factor of its dependent term is 0", DeckPart("EQUATION", count))]
        items.append(("", DeckPart("EQUATION", 1, ties=(tie,))))
    return items


def _is_unsorted(deck: _AssemblyContext, scope: PartData, word: str) -> bool:
    """True if `word` names a node set of more than one node whose order counts (UNSORTED), looked up in `scope`."""
    owner, _, name = word.replace('"', "").upper().rpartition(".")
    holder = next((other for other in deck.assembly.scopes if other.name.upper() == owner), scope)
    return name in holder.unsorted and len(deck.assembly.nodes(scope, word)) > 1


def _read_multi_point(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of an *MPC block, with the ties of each dependent node; the obstacle is "" if none.

    Types BEAM, TIE and PIN are taken; another one is an obstacle. The first node or set of a line is the dependent one;
    the second has one node, or as many. Names are looked up in `scope` of `deck`, where the block stands. Raises
    `ValueError` if nodes are not there or sets differ in size.
    """
    items: ObstaclesAndParts = []
    for row in block.rows:
        words = [word for word in row if word]
        if not words:
            continue
        kind = words[0].upper()
        if kind not in ("BEAM", "TIE", "PIN"):
            items.append((f"type {kind}", DeckPart("MPC", 1)))
            continue
        if any(_is_unsorted(deck, scope, word) for word in words[1:3]):
            items.append((_UNSORTED, DeckPart("MPC", 1)))
            continue
        if len(words) != 3:
            raise ValueError(f"type {kind} needs two nodes or sets, got {len(words) - 1}")
        dependents, mains = deck.assembly.nodes(scope, words[1]), deck.assembly.nodes(scope, words[2])
        if not (dependents and mains):
            items.append((_EMPTY, DeckPart("MPC", 1)))
            continue
        mains = mains * len(dependents) if len(mains) == 1 else mains
        for dependent, main in zip(dependents, mains, strict=True):
            items.append(("", DeckPart("MPC", 1, ties=tuple(_make_ties(kind, main, dependent)))))
    return items


def _make_ties(kind: str, main: int, dependent: int) -> Ties:
    """Ties of a dependent node to a main node: rigid (BEAM), all directions (TIE) or translations (PIN).

    `kind` is the word in brackets; other words count as PIN. A rigid tie is one `RigidLink`, others a `Constraint` for
    each direction. Raises `ValueError` if the two nodes are one.
    """
    name = f"mpc {kind.lower()} {dependent}"
    if main == dependent:
        raise ValueError(f"it ties node {main} to itself")
    if kind == "BEAM":
        return [RigidLink(name, main, [dependent])]
    directions = DIRECTIONS if kind == "TIE" else DIRECTIONS[:3]
    return [Constraint(name, Dof(dependent, d), [(Dof(main, d), 1.0)]) for d in directions]


def _read_rigid_body(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pair (obstacle, part), as a list of one, of a *RIGID BODY block: nodes of its sets move with the reference node.

    Obstacles ("" if none) are a rotation node of its own, an analytical surface, and no reference node. Nodes of the
    pinned set follow in translations only. Names are looked up in `scope` of `deck`, where the block stands. Raises
    `ValueError` if a node or set is not there.
    """
    options = block.options
    if options.get("ROT NODE") or "ANALYTICAL SURFACE" in options:
        return [("it turns with a node of its own (ROT NODE) or is a surface", DeckPart("RIGID BODY", 1))]
    if not options.get("REF NODE"):
        return [("it has no reference node", DeckPart("RIGID BODY", 1))]
    if options.get("POSITION", "INPUT").upper() != "INPUT":
        return [("its reference node is moved to the centre of mass", DeckPart("RIGID BODY", 1))]
    [main] = deck.assembly.nodes(scope, options["REF NODE"])
    tied = [node for key in ("NSET", "TIE NSET") for node in _named_nodes(deck, scope, options.get(key, ""))]
    tied += _nodes_of_elements(deck, scope, options.get("ELSET", ""))
    pinned = _named_nodes(deck, scope, options.get("PIN NSET", ""))
    ties: Ties = []
    for directions, labels in ((None, tied), (DIRECTIONS[:3], pinned)):
        dependents = [node for node in dict.fromkeys(labels) if node != main]
        ties += [RigidLink(f"rigid body {main}", main, dependents, directions)] if dependents else []
    return [("" if ties else "it has no nodes but its reference node", DeckPart("RIGID BODY", 1, ties=tuple(ties)))]


def _named_nodes(deck: _AssemblyContext, scope: PartData, name: str) -> list[int]:
    return deck.assembly.nodes(scope, name) if name else []


def _nodes_of_elements(deck: _AssemblyContext, scope: PartData, name: str) -> list[int]:
    """Labels in the mesh of the nodes of all elements in the set `name`, sorted.

    The set is looked up in `scope` of `deck`, a part, an instance or the assembly. Empty if `name` is ""; raises
    `ValueError` if there is no such set.
    """
    if not name:
        return []
    kinds = sorted({kind for holder in deck.assembly.all_scopes for kind in holder.elements})
    return sorted({node for _, nodes in deck.elements_of(scope, name, kinds) for node in nodes})


def _read_kinematic_coupling(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of a *KINEMATIC COUPLING block, one a data line; the obstacle is "" if there is none.

    The nodes of a line follow the reference node rigidly in the components that the line names. An orientation is an
    obstacle, and oblique directions of a node or a turned instance unless all six components follow. Names are looked
    up in `scope` of `deck`, where the block stands. Raises `KeyError` without a reference node.
    """
    [main] = deck.assembly.nodes(scope, block.options["REF NODE"])
    items: ObstaclesAndParts = []
    for row in block.rows:
        nodes = deck.assembly.nodes(scope, row[0])
        items.append(_follow_rigidly(deck, block, scope, main, nodes, _component_range(row[1:])))
    return items


def _read_coupling(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pair (obstacle, part), as a list of one, of a *COUPLING block and the *KINEMATIC or *DISTRIBUTING behind it.

    Kinematic: nodes of the surface follow the reference node; distributing: it moves as their mean, weighted by area.
    Other kinds, a radius of influence, an orientation and weights that are not uniform are obstacles ("" if none).
    Names are looked up in `scope` of `deck`, where the block stands. Raises `ValueError` if the surface or the node
    cannot be read.
    """
    next_blocks = scope.blocks[scope.blocks.index(block) + 1 :][:1]
    law = next_blocks[0].keyword if next_blocks else ""
    if law not in ("KINEMATIC", "DISTRIBUTING"):
        return [("it is neither kinematic nor distributing", DeckPart("COUPLING", 1))]
    if block.options.keys() & {"INFLUENCE RADIUS", "ORIENTATION"}:
        return [("it has a radius of influence or an orientation", DeckPart("COUPLING", 1))]
    surface = deck.surfaces.read(scope, block.options.get("SURFACE", ""))
    [main] = deck.assembly.nodes(scope, block.options["REF NODE"])
    rows = [row for row in next_blocks[0].rows if any(row)]
    components = sorted({component for row in rows for component in _component_range(row)}) or list(range(6))
    if law == "KINEMATIC":
        return [_follow_rigidly(deck, block, scope, main, surface.nodes, components)]
    method = next_blocks[0].options.get("WEIGHTING METHOD", "UNIFORM").upper()
    if method != "UNIFORM" or next_blocks[0].options.get("COUPLING", "CONTINUUM").upper() != "CONTINUUM":
        return [("its weights are not uniform, or it couples rotations", DeckPart("COUPLING", 1))]
    areas = nodal_areas(surface, deck.positions.__getitem__) if surface.faces else surface.weights
    areas = {node: area for node, area in areas.items() if area}
    if not areas:
        return [("no node of its surface has a weight", DeckPart("COUPLING", 1))]
    return [_mean_constraints(deck, main, areas, sorted({0, 1, 2, *components}))]


def _mean_constraints(
    deck: _AssemblyContext, main: int, weights: Mapping[int, float], chosen: Sequence[int]
) -> tuple[str, DeckPart]:
    """Pair (obstacle, part) of a reference node that moves as the weighted mean of other nodes; "" for no obstacle.

    The mean is the rigid motion that fits their translations best. `deck` has positions and axes of nodes, `main` is
    the reference node, `weights` maps the others to their weights, `chosen` are its components that follow (0 to 5:
    translations, rotations).
    """
    if main in weights:
        return "its reference node is one of its surface", DeckPart("COUPLING", 1)
    components = [Component(node, axis, False, weight) for node, weight in weights.items() for axis in np.eye(3)]
    mean = mean_motion(deck.positions[main], components, deck.positions)
    directions = global_directions(deck.axes.get(main, np.eye(3)), chosen)
    if mean is None or directions is None:
        return (
            _LOCAL if directions is None else "its nodes do not determine the motion of the reference node"
        ), DeckPart("COUPLING", 1)
    rows = mean_rows(main, deck.axes.get(main, np.eye(3)), chosen, components, mean)
    ties = solved_constraints(f"coupling {main}", rows, [(main, direction) for direction in directions])
    if ties is None:
        return "it does not determine its reference node", DeckPart("COUPLING", 1)
    return "", DeckPart("COUPLING", 1, ties=tuple(ties))


def _read_surface_tie(deck: _AssemblyContext, scope: PartData, block: KeywordBlock) -> ObstaclesAndParts:
    """Pairs (obstacle, part) of a *TIE block, for each pair of surfaces; the obstacle is "" if there is none.

    Nodes of the first surface that are near the faces of the second move with these; others are counted as a part that
    the solver leaves free, which is an obstacle. Surfaces are looked up in `scope` of `deck`, where the block stands.
    Raises `ValueError` if surfaces cannot be read.
    """
    if block.options.keys() & {"CYCLIC SYMMETRY", "MULTIPHYSICS", "FLUID-STRUCTURE", "TIED NSET"}:
        return [("it ties something other than two surfaces", DeckPart("TIE", 1))]
    items: ObstaclesAndParts = []
    for row in block.rows:
        words = [word for word in row if word]
        if len(words) < 2:
            raise ValueError("it needs two surfaces a line")
        followers, carriers = (deck.surfaces.read(scope, word) for word in words[:2])
        if not carriers.faces:
            items.append(("its second surface is of nodes", DeckPart("TIE", 1)))
            continue
        ties, free, near = _tie_near_nodes(deck, block, followers.nodes, carriers)
        if ties or not free:
            items.append(("", DeckPart("TIE", 1, ties=tuple(ties))))
        if free:
            why = f"nodes that lie farther than {near:.3g} m from the other surface, which the solver leaves free"
            items.append((why, DeckPart("TIE", free)))
    return items


def _tie_near_nodes(
    deck: _AssemblyContext, block: KeywordBlock, followers: Sequence[int], carriers: Surface
) -> tuple[list[RigidLink | Constraint], int, float]:
    """Constraints of the nodes that lie near a surface, the number of those that do not, and the limit, m.

    `deck` has positions and axes of nodes, `followers` are those to tie; nodes of the surface `carriers` itself are
    passed over. Near is the POSITION TOLERANCE of the `block`, or 5 % of the mean side of the faces. Rotations of nodes
    that have some are tied too, unless it says NO ROTATION. Raises `ValueError` if a tied node, or one of its face, has
    directions of its own.
    """
    from scipy.spatial import cKDTree

    faces = [np.array([deck.positions[node] for node in face]) for face, _ in carriers.faces]
    stated = block.options.get("POSITION TOLERANCE", "")
    near = deck.units.length * number_of(stated) if stated else _NEAR * mean_side(faces)
    centres = cKDTree([face.mean(axis=0) for face in faces])
    reach = max(float(np.linalg.norm(face - face.mean(axis=0), axis=1).max()) for face in faces)
    turning = () if "NO ROTATION" in block.options else deck.turning
    ties: list[RigidLink | Constraint] = []
    free = 0
    carrying = set(carriers.nodes)
    for node in followers:
        if node in carrying:
            continue
        candidates = centres.query_ball_point(deck.positions[node], near + reach)
        points = [(footpoint(deck.positions[node], faces[k]), k) for k in sorted(candidates)]
        point, index = min(points, key=lambda pair: pair[0].distance, default=(None, 0))
        if point is None or point.distance > near:
            free += 1
            continue
        if node in deck.axes or any(label in deck.axes for label in carriers.faces[index][0]):
            raise ValueError(_LOCAL)
        ties += _tie_to_face(node, carriers.faces[index], point, node in turning)
    return ties, free, near


def _tie_to_face(node: int, face: tuple[tuple[int, ...], bool], point: Footpoint, is_turning: bool) -> list[Constraint]:
    """Constraints by which `node` moves with a face at `point`: three translations, rotations for a shell.

    Rotations are tied only if `is_turning`. `point` has the weights of the face's nodes. `face` is the labels of its
    nodes, and True if it is a shell.
    """
    labels, is_shell = face
    ties = []
    for i, direction in enumerate(DIRECTIONS[:3]):
        pairs = [
            (Dof(label, d), float(point.motion[k, i, j])) for k, label in enumerate(labels) for j, d in enumerate("XYZ")
        ]
        ties.append(Constraint(f"tie {node}", Dof(node, direction), [pair for pair in pairs if pair[1]]))
    if is_shell and is_turning:
        for direction in DIRECTIONS[3:]:
            turns = [
                (Dof(label, direction), float(w))
                for label, w in zip(labels, point.weights, strict=True)
                if abs(w) > 1e-9
            ]
            ties.append(Constraint(f"tie {node}", Dof(node, direction), turns))
    return ties


def _component_of(word: str) -> int:
    """Component (0 to 5) of the degree of freedom `word`, which counts from 1; `ValueError` unless it is 1 to 6."""
    if not re.fullmatch("[1-6]", word):
        raise ValueError(f"a degree of freedom must be one from 1 to 6, got {word!r}")
    return int(word) - 1


def _component_range(words: Sequence[str]) -> list[int]:
    """Components (0 to 5) from the first to the second of `words`, which count from 1.

    All if the words are blank; a single one if only the first is there. Raises `ValueError` if one is not 1 to 6, or
    they run downwards.
    """
    if not any(words):
        return list(range(6))
    first = _component_of(words[0])
    last = _component_of(words[1]) if any(words[1:]) else first
    if last < first:
        raise ValueError(f"degrees of freedom from {words[0]} to {words[1]} are none")
    return list(range(first, last + 1))


def _follow_rigidly(
    deck: _AssemblyContext,
    block: KeywordBlock,
    scope: PartData,
    main: int,
    nodes: Sequence[int],
    components: Sequence[int],
) -> tuple[str, DeckPart]:
    """Obstacle ("" if none) and deck part of `nodes` that follow the node `main` rigidly in some components (0 to 5).

    `block` gives the kind of the part and whether its directions are turned, which is an obstacle. All six components
    make one rigid link, others a constraint each, which must not lie in a turned `scope`.
    """
    kind = block.keyword
    if block.options.get("ORIENTATION"):
        return "its directions have an orientation", DeckPart(kind, 1)
    dependents = [node for node in dict.fromkeys(nodes) if node != main]
    if not dependents:
        return "it has no nodes but its reference node", DeckPart(kind, 1)
    name = f"{kind.lower()} {main}"
    if set(components) == set(range(6)):
        return "", DeckPart(kind, 1, ties=(RigidLink(name, main, dependents),))
    if np.abs(scope.turn - np.eye(3)).max() > 1e-12:
        return _TURNED, DeckPart(kind, 1)
    ties: Ties = []
    for node in dependents:
        arm = deck.positions[node] - deck.positions[main]
        rows = rigid_constraints(name, main, node, arm, deck.axes.get(node, np.eye(3)), components)
        if rows is None:
            return _LOCAL, DeckPart(kind, 1)
        ties += rows
    return "", DeckPart(kind, 1, ties=tuple(ties))
