"""Parts of a deck beside its cells: masses, springs, dashpots, rigid elements; taken as element sets and ties."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import format_number
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import InputError
from structid.fem.elements import Dashpot, ElementSet, MatrixGroup, PointMass, RotaryInertia, Spring
from structid.fem.supports import Constraint, MiddleNode, RigidLink

#: Part of the largest entry of a matrix, and of the length of a direction, that is rounding.
_ROUNDING = 1e-12
DeckTie = RigidLink | Constraint | MiddleNode
#: Takes every part that structid has elements for.
ALL_PARTS = "all"


@dataclass(frozen=True)
class DeckUnits:
    """Units of a deck, time in s.

    Attributes
    ----------
    length, force : float
        m and N.
    mass_factor : float
        Further factor on the masses of the file (PARAM,WTMASS).
    """

    length: float = 1.0
    force: float = 1.0
    mass_factor: float = 1.0

    @property
    def mass(self) -> float:
        """kg."""
        return self.mass_factor * self.force / self.length

    @property
    def inertia(self) -> float:
        """kg m^2."""
        return self.mass_factor * self.force * self.length

    def stiffness(self, is_rotation: bool) -> float:
        """N/m or N m/rad; of dashpots with s."""
        return self.force * self.length if is_rotation else self.force / self.length

    def displacement(self, is_rotation: bool, beside_rotation: bool) -> float:
        """Factor on the motion of an end of a spring, m or rad: 1, but 1 / length for a translation beside a rotation.

        `is_rotation` holds for this end, `beside_rotation` for any end. A mixed spring has the stiffness of one between
        rotations, which multiplies translations in the length of the file.
        """
        return 1.0 / self.length if beside_rotation and not is_rotation else 1.0


@dataclass(frozen=True, eq=False)
class NodalMass:
    """A mass matrix of one node.

    Attributes
    ----------
    node : int
    matrix : (6, 6) float array
        Mass matrix of translations and rotations along global axes, SI units.
    set_name : str
        Element set or property that it belongs to; "" for none.
    """

    node: int
    matrix: FloatArray
    set_name: str = ""


@dataclass(frozen=True, eq=False)
class DeckSpring:
    """A spring and dashpot that work on a weighted sum of displacements.

    Attributes
    ----------
    weights : mapping of (node, direction) to float
        Weights of displacements along global axes; -1 at one end and 1 at the other.
    stiffness, damping : float
        SI units.
    loss_factor : float
    set_name : str
        Property that it belongs to; "" for none.
    """

    weights: Mapping[tuple[int, str], float]
    stiffness: float = 0.0
    damping: float = 0.0
    loss_factor: float = 0.0
    set_name: str = ""


@dataclass(frozen=True, eq=False)
class CellOffsets:
    """Cells of a block that stand off their nodes, to which rigid arms join them.

    Attributes
    ----------
    block : int
        Index of the block among those of the mesh.
    rows : (n_cells,) int array
        Cells in the block.
    arms : (n_cells, n_nodes, 3) float array
        From each node to the end of the cell there, m, along global axes.
    """

    block: int
    rows: IntArray
    arms: FloatArray


@dataclass(frozen=True, eq=False)
class DeckPart:
    """The cards of one kind that a deck has beside its cells, as read.

    Attributes
    ----------
    kind : str
        Card or keyword, such as ``CONM2`` or ``EQUATION``.
    count : int
        Elements, or cards where it has none.
    mass : float
        kg, in the units that the reader was given.
    masses : tuple of NodalMass
    springs : tuple of DeckSpring
    ties : tuple of RigidLink, Constraint or MiddleNode
    obstacle : str
        Reason why it cannot be taken, such as a missing element type; "" if it can.
    is_needed : bool
        Whether the mesh is wrong without it, so that it is always taken.
    offsets : tuple of CellOffsets
        Cells that `offset_cells` puts where they are, with a tie for each of their ends.
    """

    kind: str
    count: int
    mass: float = 0.0
    masses: tuple[NodalMass, ...] = ()
    springs: tuple[DeckSpring, ...] = ()
    ties: tuple[DeckTie, ...] = ()
    obstacle: str = ""
    is_needed: bool = False
    offsets: tuple[CellOffsets, ...] = ()

    @property
    def words(self) -> str:
        """Count, kind and mass of the part, such as ``3 CONM2 (12 kg)``."""
        heavy = f" ({format_number(self.mass)} kg)" if self.mass else ""
        return f"{self.count} {self.kind}{heavy}"

    @property
    def nodes(self) -> frozenset[int]:
        """Labels of the nodes on which the masses, springs and ties of the part act.

        Nodes of cells to which the part gives an offset do not count.
        """
        nodes = {mass.node for mass in self.masses}
        nodes |= {node for spring in self.springs for node, _ in spring.weights}
        for tie in self.ties:
            if isinstance(tie, RigidLink):
                nodes |= {tie.main, *tie.dependents}
            elif isinstance(tie, MiddleNode):
                nodes |= {tie.label, *tie.ends}
            else:
                nodes |= {tie.dependent.node, *(dof.node for dof, _ in tie.depends_on)}
        return frozenset(nodes)

    @property
    def joined_pairs(self) -> frozenset[tuple[int, int]]:
        """Pairs of node labels, the lower first, that a spring between two nodes or a tie of the part joins.

        A rigid link joins its main node to each dependent, a constraint its dependent node to each other; mid-side
        nodes join none.
        """
        groups = [{node for node, _ in spring.weights} for spring in self.springs]
        for tie in self.ties:
            if isinstance(tie, RigidLink):
                groups += [{tie.main, node} for node in tie.dependents]
            elif isinstance(tie, Constraint):
                groups += [{tie.dependent.node, dof.node} for dof, _ in tie.depends_on]
        return frozenset((min(group), max(group)) for group in groups if len(group) == 2)

    def elements(self) -> list[ElementSet]:
        """Element sets of the part's masses, springs and dashpots, named by kind in lower case and property.

        Empty if it has none, as a part of ties.
        """
        sets: list[ElementSet] = []
        for name in dict.fromkeys(mass.set_name for mass in self.masses):
            sets += _mass_sets(self._named(name), [mass for mass in self.masses if mass.set_name == name])
        for name in dict.fromkeys(spring.set_name for spring in self.springs):
            sets += _spring_sets(self._named(name), [spring for spring in self.springs if spring.set_name == name])
        return sets

    def renumbered(self, stands_for: Mapping[int, int]) -> DeckPart:
        """The part with node labels replaced by `stands_for` (old label: new label), after nodes were merged.

        Labels that are not in it stay. Ties of a node with itself, and springs that no longer act, are dropped.
        """
        masses = tuple(replace(mass, node=stands_for.get(mass.node, mass.node)) for mass in self.masses)
        springs = []
        for spring in self.springs:
            weights: dict[tuple[int, str], float] = {}
            for (node, direction), weight in spring.weights.items():
                key = (stands_for.get(node, node), direction)
                weights[key] = weights.get(key, 0.0) + weight
            if any(weights.values()):
                springs.append(replace(spring, weights=weights))
        ties = [tie for tie in (_renumbered_tie(tie, stands_for) for tie in self.ties) if tie is not None]
        return replace(self, masses=masses, springs=tuple(springs), ties=tuple(ties))

    def _named(self, set_name: str) -> str:
        return f"{self.kind.lower()} {set_name}".strip()


def choose_parts(parts: Sequence[DeckPart], take: str | Sequence[str], source: str) -> tuple[DeckPart, ...]:
    """The parts that can be taken and whose kinds `take` names, and those that the mesh needs; in the order of `parts`.

    Parameters
    ----------
    parts : sequence of DeckPart
    take : "all" or kinds
        "all" takes every part that can be. Kinds in capitals or not, Abaqus keywords with or without their star.
    source : str
        The deck, for messages.

    Raises
    ------
    InputError
        If the deck has no part of a kind, or structid no element for it.
    """
    wanted = [take] if isinstance(take, str) else list(take)
    keys = [word.strip().lstrip("*").upper() for word in wanted]
    possible = [part for part in parts if not part.obstacle]
    if [key.lower() for key in keys] == [ALL_PARTS]:
        return tuple(possible)
    for word, key in zip(wanted, keys, strict=True):
        same = [part for part in parts if part.kind.upper() == key]
        if not same:
            near = difflib.get_close_matches(key, [part.kind for part in possible], 1, 0.0)
            remedy = f"the nearest is {near[0]!r}" if near else "it has none that could be taken; take the key out"
            raise InputError(f"{source} has no {word!r} beside its cells; {remedy}")
        if all(part.obstacle for part in same):
            raise InputError(f"{same[0].words} of {source} cannot be taken: {same[0].obstacle}")
    return tuple(part for part in possible if part.kind.upper() in keys or part.is_needed)


def describe_left_aside(parts: Iterable[DeckPart], taken: Sequence[DeckPart], source: str) -> str:
    """A sentence on the parts of a deck that were not taken, with the remedy; "" if there are none.

    `source` names the deck.
    """
    not_taken = [part for part in parts if not any(part is other for other in taken)]
    if not not_taken:
        return ""
    words = ", ".join(part.words + (f" [{part.obstacle}]" if part.obstacle else "") for part in not_taken)
    masses = [part.mass for part in not_taken if part.mass]
    total = f" ({format_number(sum(masses))} kg together)" if len(masses) > 1 else ""
    kinds = ", ".join(f'"{kind}"' for kind in dict.fromkeys(part.kind for part in not_taken if not part.obstacle))
    by_hand = any(part.obstacle for part in not_taken)
    remedies = [f"take them by `take = [{kinds}]` in [structure.mesh]"] if kinds else []
    remedies += ["model by hand what matters" + (" of the others" if kinds else "")] if by_hand else []
    return f"the model leaves aside what {source} has beside its cells: {words}{total}; {', '.join(remedies)}"


def split_by_obstacle(kind: str, items: Sequence[tuple[str, DeckPart]]) -> list[DeckPart]:
    """One part called `kind` of all `items` (obstacle, part) without an obstacle, and one for each obstacle.

    They are in the order of first appearance. Parts with an obstacle keep only their count and mass.
    """
    by_obstacle: dict[str, list[DeckPart]] = {}
    for obstacle, part in items:
        by_obstacle.setdefault(obstacle, []).append(part)
    parts = []
    for obstacle, parts_here in by_obstacle.items():
        count, mass = sum(part.count for part in parts_here), float(sum(part.mass for part in parts_here))
        if obstacle:
            parts.append(DeckPart(kind, count, mass, obstacle=obstacle))
            continue
        parts.append(
            DeckPart(
                kind,
                count,
                mass,
                tuple(mass for part in parts_here for mass in part.masses),
                tuple(spring for part in parts_here for spring in part.springs),
                tuple(tie for part in parts_here for tie in part.ties),
                is_needed=any(part.is_needed for part in parts_here),
                offsets=tuple(offset for part in parts_here for offset in part.offsets),
            )
        )
    return parts


def mass_matrix(mass: float, arm: FloatArray, inertia: FloatArray) -> FloatArray:
    """Mass matrix (6, 6) of a rigid body of this `mass` about a node, translations before rotations.

    `arm` (3,) leads from the node to its centre of gravity, about which `inertia` (3, 3) is, products with their minus
    sign.
    """
    x, y, z = arm
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = mass * np.eye(3)
    matrix[:3, 3:] = -mass * cross
    matrix[3:, :3] = mass * cross
    matrix[3:, 3:] = inertia - mass * cross @ cross
    return matrix


def turned_matrix(matrix: FloatArray, axes: FloatArray) -> FloatArray:
    """A matrix (6, 6) of translations and rotations along `axes` (rows) in global directions."""
    turn = np.kron(np.eye(2), axes)
    turned: FloatArray = turn.T @ matrix @ turn
    return turned


def weights_along(
    node: int, vector: FloatArray, rotation: bool = False, factor: float = 1.0
) -> dict[tuple[int, str], float]:
    """Weights {(node, direction): weight} of a node's displacement along a unit vector (3,), times `factor`.

    With `rotation` they are those of its rotation about that vector. Parts that are rounding are left out.
    """
    directions = DIRECTIONS[3:] if rotation else DIRECTIONS[:3]
    return {
        (node, direction): factor * float(part)
        for direction, part in zip(directions, vector, strict=True)
        if abs(part) > _ROUNDING
    }


def weights_between(
    ends: Iterable[tuple[int, int, float]], axes_at: Callable[[int], FloatArray], units: DeckUnits
) -> tuple[dict[tuple[int, str], float], bool]:
    """Weights {(node, direction): weight} of the displacements that a spring acts on, and True if it is rotational.

    The same for a dashpot. `ends` are (node, component from 0, sign); components from 3 on are rotations, and one of
    them makes the spring rotational, so that translations beside it are divided by a length in m, by `units` of the
    file. `axes_at` gives a node's directions of motion as rows (3, 3). Weights of one direction add up.
    """
    ends = tuple(ends)
    is_rotation = any(component > 2 for _, component, _ in ends)
    weights: dict[tuple[int, str], float] = {}
    for node, component, sign in ends:
        factor = sign * units.displacement(component > 2, is_rotation)
        for key, weight in weights_along(node, axes_at(node)[component % 3], component > 2, factor).items():
            weights[key] = weights.get(key, 0.0) + weight
    return weights, is_rotation


def _mass_sets(name: str, masses: Sequence[NodalMass]) -> list[ElementSet]:
    """Element sets of `masses`: point masses, rotary inertias for each axis, and a matrix group of all others.

    The others have eccentricity, products of inertia or masses that differ by direction. `name` begins the names of all
    sets. Sets without members are left out.
    """
    simple = [mass for mass in masses if _is_simple(mass.matrix)]
    sets: list[ElementSet] = []
    with_mass = [mass for mass in simple if mass.matrix[0, 0]]
    if with_mass:
        nodes, values = [mass.node for mass in with_mass], [mass.matrix[0, 0] for mass in with_mass]
        sets.append(PointMass(name, np.array(nodes)[:, None], np.array(values)))
    rotations: tuple[Literal["RX", "RY", "RZ"], ...] = ("RX", "RY", "RZ")
    for axis, direction in enumerate(rotations, 3):
        turning = [mass for mass in simple if mass.matrix[axis, axis]]
        if turning:
            nodes, values = [mass.node for mass in turning], [mass.matrix[axis, axis] for mass in turning]
            sets.append(RotaryInertia(f"{name} {direction}", np.array(nodes)[:, None], np.array(values), direction))
    others = [mass for mass in masses if not _is_simple(mass.matrix)]
    if others:
        triples = [
            (mass.node, DIRECTIONS[i], mass.node, DIRECTIONS[j], mass.matrix[i, j])
            for mass in others
            for i in range(6)
            for j in range(6)
            if mass.matrix[i, j]
        ]
        dofs, matrix = _matrix_of(triples)
        sets.append(MatrixGroup(f"{name} bodies", dofs, mass=matrix))
    return sets


def _is_simple(matrix: FloatArray) -> bool:
    """True if the mass `matrix` (6, 6) is one mass in all translations and inertias about global axes, uncoupled."""
    size = _ROUNDING * abs(matrix).max()
    diagonal = np.diag(matrix)
    return bool((abs(matrix - np.diag(diagonal)) <= size).all() and np.ptp(diagonal[:3]) <= size)


def _spring_sets(name: str, springs: Sequence[DeckSpring]) -> list[ElementSet]:
    """Element sets of `springs`: springs and dashpots between degrees of freedom or to the ground, and oblique ones.

    Those in oblique directions become a matrix group for each loss factor. `name` begins the names of all sets. Springs
    without stiffness and damping make none.
    """
    sets: list[ElementSet] = []
    ends = [_spring_dofs(spring.weights) for spring in springs]
    for grounded in (False, True):
        rows = [
            (spring, pair)
            for spring, pair in zip(springs, ends, strict=True)
            if pair is not None and (pair[1] is None) == grounded
        ]
        where = (
            f"{name} to ground"
            if grounded and len({pair[1] is None for pair in ends if pair is not None}) == 2
            else name
        )
        stiff = [(spring, pair) for spring, pair in rows if spring.stiffness]
        if stiff:
            sets.append(
                Spring(
                    where,
                    [pair[0] for _, pair in stiff],
                    None if grounded else [pair[1] for _, pair in stiff if pair[1] is not None],
                    stiffness=np.array([spring.stiffness for spring, _ in stiff]),
                    loss_factor=np.array([spring.loss_factor for spring, _ in stiff]),
                )
            )
        damped = [(spring, pair) for spring, pair in rows if spring.damping]
        if damped:
            sets.append(
                Dashpot(
                    f"{where} damping" if stiff else where,
                    [pair[0] for _, pair in damped],
                    None if grounded else [pair[1] for _, pair in damped if pair[1] is not None],
                    viscous_damping=np.array([spring.damping for spring, _ in damped]),
                )
            )
    skew = [spring for spring, pair in zip(springs, ends, strict=True) if pair is None]
    for loss_factor in sorted({spring.loss_factor for spring in skew}):
        of_loss_factor = [spring for spring in skew if spring.loss_factor == loss_factor]
        matrices = {}
        codes = sorted({key for spring in of_loss_factor for key in spring.weights})
        for key in ("stiffness", "damping"):
            triples = [
                (*row, *column, getattr(spring, key) * weight * other)
                for spring in of_loss_factor
                for row, weight in spring.weights.items()
                for column, other in spring.weights.items()
            ]
            if any(value for *_, value in triples):
                dofs, matrices[key] = _matrix_of(triples, codes)
        if matrices:
            suffix = "oblique" if loss_factor == 0 else f"oblique, loss factor {loss_factor:g}"
            sets.append(MatrixGroup(f"{name} {suffix}", dofs, loss_factor=loss_factor, **matrices))
    return sets


def _spring_dofs(weights: Mapping[tuple[int, str], float]) -> tuple[Dof, Dof | None] | None:
    """First and second degree of freedom of a spring along global axes, second None for the ground; None if oblique.

    `weights` maps (node, direction) to the weight; weights of 0 do not count. If both have the same sign, the second
    points the other way. Oblique is a weight other than 1 or -1, more than two of them, or a translation with a
    rotation.
    """
    pairs = [(Dof(node, direction), weight) for (node, direction), weight in weights.items() if weight]
    if any(abs(abs(weight) - 1) > _ROUNDING for _, weight in pairs) or len(pairs) not in (1, 2):
        return None
    if len(pairs) == 1:
        return pairs[0][0], None
    (first, first_weight), (second, second_weight) = pairs
    if first.is_rotation != second.is_rotation:
        return None
    return first, second if first_weight * second_weight < 0 else Dof(second.node, second.direction, -1)


def _matrix_of(
    triples: Sequence[tuple[int, str, int, str, float]], codes: Sequence[tuple[int, str]] | None = None
) -> tuple[list[Dof], sparse.csc_array]:
    """Degrees of freedom, and the sparse matrix (n, n) on them that sums `triples`.

    Triples are (node, direction) of the row, (node, direction) of the column and value, in one tuple. The degrees of
    freedom are those of `codes` (node, direction), by default all in the entries, sorted.
    """
    if codes is None:
        codes = sorted({(node, direction) for node, direction, *_ in triples})
    index = {code: row for row, code in enumerate(codes)}
    rows = [index[node, direction] for node, direction, *_ in triples]
    columns = [index[node, direction] for _, _, node, direction, _ in triples]
    values = [value for *_, value in triples]
    size = (len(codes), len(codes))
    return [Dof(*code) for code in codes], sparse.csc_array(sparse.coo_array((values, (rows, columns)), size))


def _renumbered_tie(tie: DeckTie, stands_for: Mapping[int, int]) -> DeckTie | None:
    """The tie with node labels replaced by `stands_for` (old label: new label), other labels unchanged.

    None if it then joins a node with itself only. A constraint whose dependent then follows itself is solved anew.
    """
    if isinstance(tie, MiddleNode):
        label = stands_for.get(tie.label, tie.label)
        start, end = (stands_for.get(node, node) for node in tie.ends)
        return None if label in (start, end) else replace(tie, label=label, ends=(start, end))
    if isinstance(tie, RigidLink):
        main = stands_for.get(tie.main, tie.main)
        dependents = [stands_for.get(node, node) for node in tie.dependents]
        kept = [node for node in dict.fromkeys(dependents) if node != main]
        return RigidLink(tie.name, main, kept, tie.directions) if kept else None
    dependent = _renumbered_dof(tie.dependent, stands_for)
    factors: dict[Dof, float] = {}
    for dof, factor in tie.depends_on:
        other = _renumbered_dof(dof, stands_for)
        factors[other] = factors.get(other, 0.0) + factor
    left = 1.0 - factors.pop(dependent, 0.0)  # of the dependent, where it follows itself
    factors = {dof: factor for dof, factor in factors.items() if factor}
    if abs(left) > _ROUNDING:
        return Constraint(tie.name, dependent, [(dof, factor / left) for dof, factor in factors.items()])
    if not factors:
        return None
    dependent, first = factors.popitem()
    return Constraint(tie.name, dependent, [(dof, -factor / first) for dof, factor in factors.items()])


def _renumbered_dof(dof: Dof, stands_for: Mapping[int, int]) -> Dof:
    return Dof(stands_for.get(dof.node, dof.node), dof.direction, dof.sign)
