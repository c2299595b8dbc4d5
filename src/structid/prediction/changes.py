"""Changes of a structure that are asked about before they are made: masses, dampers, supports, stiffer or missing parts."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse

from structid.core.arrays import locked
from structid.core.display import join_words
from structid.core.dof import Dof, parse_dof
from structid.core.errors import InputError
from structid.fem import Dashpot, PointMass, Spring, Structure
from structid.unknowns import Parameters

#: Added mass at most, in masses of the structure, and damping ratio of a damper at most: beyond them a place is held.
_MOST_ADDED, _MOST_DAMPED = 1e3, 10.0
_LABEL = re.compile(r"^(?P<property>\w+)\[(?P<set>[^:\]]+)(?::(?P<number>\d+))?\]$")


class Change(Protocol):
    """A change of a structure."""

    def apply(self, structure: Structure, parameters: Parameters) -> tuple[Structure, Parameters]:
        """Changed structure, and its parameters: those given, matched to the new structure by the labels of properties."""
        ...

    @property
    def words(self) -> str:
        """Such as ``5 kg added at node 12``."""
        ...


@dataclass(frozen=True)
class AddMass:
    """A point mass, kg, at a node."""

    node: int
    mass: float

    def apply(self, structure: Structure, parameters: Parameters) -> tuple[Structure, Parameters]:
        """Structure with a point mass (kg) added at the node, and parameters with the same unknowns as before.

        Raises
        ------
        InputError
            If the node does not exist, or the mass is not positive or more than 1000 times that of the structure.
        """
        _require_node(structure, self.node)
        _require_positive("mass", self.mass)
        _require_mass_at_most("mass", self.mass, _MOST_ADDED, structure, parameters, "to hold the node, add supports")
        name = _free_name(structure, f"added mass {self.node}")
        added = PointMass(name, [self.node], mass=self.mass)
        return _carried_over(parameters, structure, replace(structure, elements=(*structure.elements, added)))

    @property
    def words(self) -> str:
        """See `Change.words`."""
        return f"{self.mass:g} kg added at node {self.node}"


@dataclass(frozen=True)
class Scale:
    """A property times a factor, of a set, ``bending_stiffness[deck]``, or of one element, ``bending_stiffness[deck:3]``."""

    label: str
    factor: float

    def apply(self, structure: Structure, parameters: Parameters) -> tuple[Structure, Parameters]:
        """Unchanged `structure`, and `parameters` whose values of the property `label` are multiplied by the factor.

        `label` names a property of an element set, as ``bending_stiffness[deck]``, or of one of its elements, as
        ``bending_stiffness[deck:3]`` (from 1).

        Raises
        ------
        InputError
            If the factor is negative or not finite, or the structure lacks the property or element.
        """
        if not (np.isfinite(self.factor) and self.factor >= 0):
            raise InputError(f"`factor` of {self.label} must be at least 0, got {self.factor:g}")
        found = _LABEL.match(self.label)
        whole = f"{found['property']}[{found['set']}]" if found else self.label
        item = next((item for item in structure.properties if item.label == whole), None)
        if item is None or not found:
            labels = [item.label for item in structure.properties]
            near = difflib.get_close_matches(self.label, labels, 1, 0.0)
            raise InputError(f"the structure has no property {self.label!r}; the nearest is {near[0]!r}")
        factors, count = np.ones(len(structure.values)), item.values.stop - item.values.start
        if found["number"] is None:
            factors[item.values] = self.factor
        else:
            number = int(found["number"])
            if not 1 <= number <= count:
                raise InputError(f"{whole} has elements 1 to {count}, got {number}")
            factors[item.values.start + number - 1] = self.factor
        design = sparse.csc_array(sparse.diags_array(factors) @ parameters.design)
        return structure, replace(parameters, offset=locked(factors * parameters.offset), design=design)

    @property
    def words(self) -> str:
        """See `Change.words`."""
        return f"{self.label} times {self.factor:g}"


@dataclass(frozen=True)
class Remove:
    """An element set taken out."""

    name: str

    def apply(self, structure: Structure, parameters: Parameters) -> tuple[Structure, Parameters]:
        """Structure without the element set of that name, and parameters with the same unknowns as before.

        `InputError` if the structure has no such set.
        """
        kept = tuple(element for element in structure.elements if element.name != self.name)
        if len(kept) == len(structure.elements):
            near = difflib.get_close_matches(self.name, [element.name for element in structure.elements], 1, 0.0)
            raise InputError(f"the structure has no element set {self.name!r}; the nearest is {near[0]!r}")
        return _carried_over(parameters, structure, replace(structure, elements=kept))

    @property
    def words(self) -> str:
        """See `Change.words`."""
        return f"{self.name} removed"


@dataclass(frozen=True)
class AddSupport:
    """A degree of freedom held at zero, such as ``12Y``."""

    dof: str | Dof

    def apply(self, structure: Structure, parameters: Parameters) -> tuple[Structure, Parameters]:
        """The structure with the degree of freedom held, and its parameters."""
        held = parse_dof(self.dof).unsigned
        structure.selection([held])
        return _carried_over(parameters, structure, replace(structure, fixed=(*structure.fixed, held)))

    @property
    def words(self) -> str:
        """See `Change.words`."""
        return f"support at {parse_dof(self.dof).place}"


@dataclass(frozen=True)
class AddTunedMassDamper:
    """A mass, kg, on a spring and a dashpot at a translation, with its own frequency, Hz, and damping ratio."""

    dof: str | Dof
    mass: float
    frequency: float
    damping_ratio: float

    def apply(self, structure: Structure, parameters: Parameters) -> tuple[Structure, Parameters]:
        """Structure with a mass on a new node, joined to a translation by a spring and a dashpot, and its parameters.

        The new node has the next free label and lies at the damper's foot. The parameters have the same unknowns as
        before.

        Raises
        ------
        InputError
            If the degree of freedom is a rotation or not in the structure, or a value is not positive or too large
            (mass above that of the structure, damping ratio above 10).
        """
        at = parse_dof(self.dof).unsigned
        if at.is_rotation:
            raise InputError(f"a tuned mass damper moves along X, Y or Z, got {at}")
        structure.selection([at])
        for name in ("mass", "frequency", "damping_ratio"):
            _require_positive(name, getattr(self, name))
        if self.damping_ratio > _MOST_DAMPED:
            raise InputError(
                f"`damping_ratio` must be at most {_MOST_DAMPED:g}, above which a damper does not move against its place, got"
                f" {self.damping_ratio:g}; add its mass alone"
            )
        _require_mass_at_most("mass", self.mass, 1.0, structure, parameters, "a tuned mass damper is lighter than that")
        node = max(structure.nodes) + 1
        rate = 2 * np.pi * self.frequency
        moving = Dof(node, at.direction)
        title = _free_name(structure, f"damper {at.place}")
        parts = (
            PointMass(f"{title} mass", [node], mass=self.mass, directions=[at.direction]),
            Spring(f"{title} spring", at, moving, stiffness=self.mass * rate**2),
            Dashpot(f"{title} dashpot", at, moving, viscous_damping=2 * self.damping_ratio * self.mass * rate),
        )
        nodes = {**structure.nodes, node: structure.nodes[at.node]}
        changed = replace(structure, nodes=nodes, elements=(*structure.elements, *parts))
        return _carried_over(parameters, structure, changed)

    @property
    def words(self) -> str:
        """See `Change.words`."""
        return (
            f"tuned mass damper of {self.mass:g} kg, {self.frequency:g} Hz, damping ratio {self.damping_ratio:g} at"
            f" {parse_dof(self.dof).place}"
        )


def changed_model(
    structure: Structure, parameters: Parameters, changes: Sequence[Change]
) -> tuple[Structure, Parameters]:
    """Structure after changes, and its parameters, which are the same unknowns as before.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
        Of that structure.
    changes : sequence of Change
        In the order in which they are made.

    Returns
    -------
    Structure
    Parameters

    Raises
    ------
    InputError
        If a change names what the structure does not have, or leaves nothing that moves or nothing that has mass; or if
        `changes` is no sequence of changes.
    """
    is_sequence = isinstance(changes, Iterable)
    each = tuple(changes) if is_sequence else ()
    wrong = [change for change in each if isinstance(change, type) or not hasattr(change, "apply")]
    if wrong or not is_sequence:
        raise InputError(
            "`changes` must be a sequence of changes with their values, such as [AddMass(node=12, mass=5.0)], got"
            f" {wrong[0] if wrong else changes!r}"
        )
    for change in each:
        structure, parameters = change.apply(structure, parameters)
    told = join_words([change.words for change in each])
    if not structure.n_dofs:
        raise InputError(
            f"nothing of the changed structure can move ({told}), so that it has no modes; hold or take out less of it"
        )
    if structure.has_modes and not structure.matrix("mass", parameters.values(parameters.start)).count_nonzero():
        raise InputError(f"the changed structure has no mass ({told}), so that it has no modes; take out less of it")
    return structure, parameters


def _carried_over(parameters: Parameters, before: Structure, after: Structure) -> tuple[Structure, Parameters]:
    """Structure `after`, and the parameters of `before` mapped to its property values by the labels of properties.

    Properties that `before` lacks keep their values in `after` and no parameter acts on them.
    """
    places = {item.label: item.values for item in before.properties}
    offset = np.array(after.values)
    rows: list[int] = []
    columns: list[int] = []
    for item in after.properties:
        old = places.get(item.label)
        if old is not None:
            offset[item.values] = parameters.offset[old]
            rows += range(item.values.start, item.values.stop)
            columns += range(old.start, old.stop)
    taken = sparse.coo_array((np.ones(len(rows)), (rows, columns)), (len(offset), len(parameters.offset)))
    design = sparse.csc_array(taken @ parameters.design)
    return after, replace(parameters, offset=locked(offset), design=design)


def _require_node(structure: Structure, node: int) -> None:
    if node not in structure.nodes:
        raise InputError(f"the structure has no node {node}")


def _require_mass_at_most(
    name: str, mass: float, most: float, structure: Structure, parameters: Parameters, remedy: str
) -> None:
    """Raise `InputError` if `mass`, kg, is more than `most` times that of the structure; `name` is the argument.

    The structure's mass is that at the start values of `parameters`; where it is 0 any mass passes. `remedy` ends the
    message.
    """
    whole = structure.mass_of(parameters.values(parameters.start))
    if mass > most * whole > 0:
        times = "" if most == 1 else f"{most:g} times "
        raise InputError(
            f"`{name}` must be at most {times}the mass of the structure, {whole:.4g} kg, got {mass:g} kg; {remedy}"
        )


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"`{name}` must be greater than 0, got {value:g}")


def _free_name(structure: Structure, name: str) -> str:
    """Name for a new element set that begins no existing name: `name`, or that with (2), (3), ... behind it."""
    taken, number = {element.name for element in structure.elements}, 2
    free = name
    while any(other.startswith(free) for other in taken):
        free, number = f"{name} ({number})", number + 1
    return free
