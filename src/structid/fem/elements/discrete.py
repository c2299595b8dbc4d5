"""Discrete elements: masses and inertias at nodes; springs, dashpots, joints and dry friction between motions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.constraints import Number
from structid.core.dof import Dof, parse_dof, parse_dofs
from structid.core.errors import InputError
from structid.fem.elements.element import (
    LOSS_FACTOR,
    TRANSLATIONS,
    At,
    Declared,
    Dofs,
    ElementMatrixTerm,
    ElementSet,
    End,
    Ends,
    Matrices,
    NodeCoordinates,
    Nodes,
    OtherEnd,
    OtherEnds,
    Translations,
    Values,
    declarations,
    declared,
    dof_code,
    element,
    node_codes,
    node_table,
)


def _checked_translations(name: str, directions_given: Iterable[str]) -> tuple[str, ...]:
    """`directions_given` as a tuple; raises `InputError`, which names the set `name`, unless all are among X, Y, Z."""
    directions = tuple(directions_given)
    if not set(directions) <= set(TRANSLATIONS):
        raise InputError(f"`directions` of {name!r} must be among X Y Z, got {directions}")
    return directions


@element
class PointMass(ElementSet):
    """Masses at nodes, the same in every translation."""

    follows = True
    symbol = "disc"

    nodes: Nodes = declared("Node labels", stored=node_table(1))
    mass: Values = declared("Mass", "mass", "kg")
    directions: Translations = declared(
        "Translations in which the mass moves; by default those that other elements give to the node, or all that the"
        " node's position has coordinates for where no other element gives any",
        stored=_checked_translations,
        default=None,
    )

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Diagonal 3 x 3 mass matrices for unit mass, with ones in the translations in which the node moves.

        Rows without motion have the code -1. The translations are the `directions` if stated, else those in
        `used_codes`, which other elements use; a node without any has all that `positions` (m) have coordinates for.
        """
        codes = node_codes(self.nodes, TRANSLATIONS)
        moves = np.isin(codes, used_codes)
        if self.directions is not None:
            moves[:] = np.isin(TRANSLATIONS, self.directions)
        without_motion = ~moves.any(axis=1)
        moves[without_motion] = np.arange(3) < len(next(iter(positions.values())))
        return {"mass": (ElementMatrixTerm(np.where(moves, codes, -1), np.eye(3) * moves[:, None, :]),)}


@element
class RotaryInertia(ElementSet):
    """Mass moments of inertia at nodes about one axis."""

    follows = True
    symbol = "ring"

    nodes: Nodes = declared("Node labels", stored=node_table(1))
    rotary_inertia: Values = declared("Mass moment of inertia", "rotary_inertia", "kg m^2")
    direction: Literal["RX", "RY", "RZ"] = declared("Axis of rotation")

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Unit rotary inertia at each node, by property name; the arguments have no influence."""
        codes = node_codes(self.nodes, (self.direction,))
        return {"rotary_inertia": (ElementMatrixTerm(codes, np.ones((len(self.nodes), 1, 1))),)}


def dofs_stored(name: str, dofs: Dofs) -> tuple[Dof, ...]:
    """Every degree of freedom in `dofs`."""
    return parse_dofs([dofs] if isinstance(dofs, str | Dof) else dofs)


@element
class Connector(ElementSet):
    """Elements between pairs of degrees of freedom, or from one to the ground."""

    nodes: Nodes = declared("Node labels of the ends; -1 for the ground", init=False)
    first: Ends = declared("One end of each element, such as ``1X``")
    second: OtherEnds = declared("The other end; the ground where left out", default=None)

    def __post_init__(self) -> None:
        """Store and check the ends, and derive the node table (n_elements, 2).

        The second column is -1 for the ground. Raises `InputError` if the ends differ in number or kind of motion, or
        coincide.
        """
        for key in ("first", "second"):
            named = getattr(self, key)
            object.__setattr__(self, key, named if named is None else dofs_stored(self.name, named))
        _require_ends(self.name, self.first, self.second)
        ends = [-1] * len(self.first) if self.second is None else [d.node for d in self.second]
        object.__setattr__(self, "nodes", locked(np.array([[d.node for d in self.first], ends]).T, np.int64))
        super().__post_init__()

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices d d' for a unit value of each property, with d = +1 at the first end and -1 at the second.

        These are times the signs of the degrees of freedom, the same for all properties by name: (n_elements, 2, 2), or
        (n_elements, 1, 1) to the ground. The arguments have no influence.
        """
        columns = [self.first] if self.second is None else [self.first, self.second]
        codes = np.array([[dof_code(d.node, d.direction) for d in ends] for ends in columns]).T
        jump: FloatArray = np.array([[d.sign for d in ends] for ends in columns], dtype=np.float64).T
        jump[:, 1:] *= -1
        matrix_terms = (ElementMatrixTerm(codes, jump[:, :, None] * jump[:, None, :]),)
        return dict.fromkeys(declarations(self), matrix_terms)

    def unit(self, what: Declared) -> str:
        """The unit of a property that fits all degrees of freedom; "A or B" where translations and rotations mix."""
        units = {what.about_axes or what.unit if dof.is_rotation else what.unit for dof in self.first}
        return units.pop() if len(units) == 1 else f"{what.unit} or {what.about_axes}"


def _require_ends(name: str, first: tuple[Dof, ...], second: tuple[Dof, ...] | None) -> None:
    """Raise `InputError` unless `first` and `second` pair different degrees of freedom of the same kind of motion.

    They must be equally many. `name` is that of the set; `second` is None for the ground.
    """
    if not first:
        raise InputError(f"`first` of {name!r} must name at least one degree of freedom")
    if second is None:
        return
    if len(second) != len(first):
        raise InputError(f"`second` of {name!r} must have as many entries as `first` ({len(first)}), got {len(second)}")
    for a, b in zip(first, second, strict=True):
        if a.is_rotation != b.is_rotation:
            raise InputError(f"{name!r} connects a translation with a rotation: {a} and {b}")
        if a.unsigned == b.unsigned:
            raise InputError(f"{name!r} connects {a} with itself; leave `second` out for the ground")


@element
class Spring(Connector):
    """Springs between pairs of degrees of freedom, or to the ground."""

    symbol = "spring"

    stiffness: Values = declared("Stiffness", "stiffness", "N/m", about_axes="N m/rad", kw_only=True)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0, kw_only=True)


@element
class Dashpot(Connector):
    """Viscous dashpots between pairs of degrees of freedom, or to the ground."""

    symbol = "dashpot"

    viscous_damping: Values = declared("Damping", "viscous_damping", "N s/m", about_axes="N m s/rad", kw_only=True)


@element
class Friction(Connector):
    """Dry (Coulomb) friction between one degree of freedom and another or the ground, by harmonic linearization.

    A friction force of constant amplitude, in phase with the sliding velocity, has the dynamic stiffness
    i r / \\|x\\|, where r is the amplitude of its first harmonic per unit of drive amplitude and \\|x\\| the sliding
    amplitude per unit drive: the model's own, by harmonic balance. It holds while the drive amplitude is the same at
    all frequencies and one load acts at a time. Where r exceeds the force that reaches the contact, it sticks.

    References
    ----------
    Den Hartog (1931), Trans. ASME 53, APM-53-9; Magnus, Popp, Sextro (2016), Schwingungen, section 3.2.
    """

    symbol = "friction"

    first: End = declared("Where the friction acts")
    second: OtherEnd = declared("The other end; the ground where left out", default=None)
    friction_force: Values = declared(
        "First harmonic of the force per unit of drive: 4/pi times the sliding force over the amplitude of the load",
        "friction",
        "N/N",
        kw_only=True,
    )
    measured_by: Ends = declared(
        "Sensors whose mean along their axes is the sliding motion. Searches from poor starts take the amplitude from them,"
        " which keeps the model linear; the last stage takes the model's own",
        stored=dofs_stored,
        default=(),
        kw_only=True,
    )
    smoothing: Number = declared(
        "Neighbouring lines over which a measured amplitude is averaged (geometric mean); 1 for none",
        stored=lambda name, given: max(1, int(given)),
        default=1,
        kw_only=True,
    )

    def sliding(self, receptance: np.ndarray) -> FloatArray:
        """Smoothed sliding amplitude per unit of load, (n_frequencies,), from measured receptances of several sensors.

        It is the size of their mean, averaged geometrically over `smoothing` lines, fewer at the ends.

        Parameters
        ----------
        receptance : (n_frequencies, n_sensors) complex array
            Of the sensors `measured_by`, signs already removed.
        """
        size = np.log(np.maximum(np.abs(receptance.mean(axis=1)), np.finfo(float).tiny))
        window = np.ones(min(self.smoothing, len(size)))
        total = np.convolve(size, window, mode="same")
        return np.exp(total / np.convolve(np.ones(len(size)), window, mode="same"))


@element
class Joint(ElementSet):
    """A flexible joint: the end of one bar or beam gives way against its node in one direction, held by a spring.

    In all other directions the end stays with the node. An end may have several joints, each in another direction.
    Where supports hold the node, the joint is that of a yielding support.
    """

    follows = True
    symbol = "ring"

    nodes: Nodes = declared("The node", init=False)
    element: str = declared("The element, counted from 1, such as ``girder:1``")
    at: At = declared("Which of its nodes, and the global direction that gives way, such as ``4RZ``")
    stiffness: Values = declared("Stiffness", "stiffness", "N/m", about_axes="N m/rad")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", parse_dof(self.at).unsigned)
        object.__setattr__(self, "nodes", locked(np.array([[self.at.node]]), np.int64))
        super().__post_init__()

    @property
    def loosened(self) -> tuple[str, Dof]:
        """The element and the degree of freedom."""
        return self.element, self.at

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """The spring between the node and the end, which the structure numbers; see `ElementSet.loosened`."""
        codes = np.array([[dof_code(self.at.node, self.at.direction), -1]])
        return {"stiffness": (ElementMatrixTerm(codes, np.array([[[1.0, -1.0], [-1.0, 1.0]]])),)}

    def unit(self, what: Declared) -> str:
        """The unit that fits the direction."""
        return what.about_axes or what.unit if self.at.is_rotation else what.unit
