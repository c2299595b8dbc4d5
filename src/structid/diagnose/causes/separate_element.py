"""An element differs from its group, in one stiffness, in its mass, or in all its stiffnesses; so do all springs of a mount."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.diagnose.causes.candidate import (
    MOST_ELEMENTS,
    Candidate,
    Factored,
    factored,
    moved_elements,
    spread,
    summed,
)
from structid.diagnose.effects import all_directions, effect_of_addition
from structid.diagnose.model_edits import Edits, SeparateElement, rounded
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem import Spring, Structure

#: Parts of what an element has by which it may differ.
PARTS = np.array([-0.9, -0.7, -0.5, -0.3, -0.15, -0.05, 0.05, 0.2, 0.4, 0.8, 1.5, 3.0, 8.0])
#: Difference by which an element that differs in all stiffnesses gives way to one that differs in one.
AS_A_WHOLE = 0.25

#: An element matrix and the positions of the parameters that move it.
MatrixOnNodes: TypeAlias = tuple[ElementMatrix, tuple[int, ...]]


class DifferingProperty(NamedTuple):
    """One property of an element or set that differs, by a factor of its own or, in `follows`, by that of another parameter."""

    element: str
    property: str
    follows: str | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Differing(Candidate):
    """An element, mount or set that is not like its group; the strength is a part of what it has.

    The look takes one factor on all stiffnesses; a fit has a factor for each that is an unknown of its own, since a factor is
    one on the initial value of the study and the others of the group have left theirs. Those that the study fixes have one
    together.

    Attributes
    ----------
    properties : tuple of DifferingProperty
        What differs.
    matrices : tuple of Factored
        The matrix of what differs, or one for each spring of a mount.
    is_whole : bool
        Whether all its stiffnesses differ.
    """

    bounds: tuple[float, float] = (-1.0, np.inf)
    properties: tuple[DifferingProperty, ...]
    matrices: tuple[Factored, ...] = field(default=(), repr=False)
    is_whole: bool = False

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        directions = all_directions([one.directions for one in self.matrices])
        laws = np.stack([one.law(receptances) for one in self.matrices], axis=-1)
        return effect_of_addition(receptances, directions, laws, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [_separation(model, one, rounded(1 + strength)) for one in self.properties]

    @property
    def handicap(self) -> float:
        return AS_A_WHOLE if self.is_whole else 0.0

    @property
    def key(self) -> Hashable:
        return self.place, self.properties

    @property
    def family(self) -> str:
        return f"whole {self.kind}" if self.is_whole else super().family


@dataclass(frozen=True, eq=False, kw_only=True)
class DifferingElement(Differing):
    """An element whose stiffness, mass or stiffnesses are not those of its group.

    The springs between the same two nodes, or one and the ground, are one mount, which differs as one element does.

    Attributes
    ----------
    nodes : tuple of int
        Labels of the nodes of a mount; empty for an element.
    """

    kind: ClassVar[str] = "untied"
    nodes: tuple[int, ...] = ()

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for the stiffness, the mass, and all stiffnesses of each element in a set of several, and for mounts.

        A mount is all springs between the same nodes. Of many, at most 300 for a single property and 150 for all
        stiffnesses are tried, evenly chosen. `records` are the receptances of each record; the first one counts.
        Strengths are relative changes, -0.9 to 8. `record_names` are not used.
        """
        first = records[0]
        moved = list(moved_elements(first))
        items = list(_of_elements(moved))
        counts = Counter((one.element, one.property) for one in items)
        several = [one for one in items if counts[one.element, one.property] > 1]
        for one in spread(several, 2 * MOST_ELEMENTS):
            matrix = factored(first, one)
            if matrix is not None:
                what = DifferingProperty(_label(one), one.property)
                yield cls(where=(what.element,), strengths=PARTS, properties=(what,), matrices=(matrix,))
        mounts = _mounts(first.structure)

        def unit_of(one: ElementMatrix) -> Hashable:
            """Nodes of the mount that a spring belongs to; otherwise the element's (set name, number)."""
            return mounts.get((one.element, one.number), (one.element, one.number))

        stiff = stiff_parts(first, moved)
        units: dict[str, set[Hashable]] = {}
        for one, _ in stiff:
            units.setdefault(one.element, set()).add(unit_of(one))
        whole_groups = [
            group
            for group in groups_of_stiffnesses(stiff, unit_of, _label)
            if any(moved_by for _, moved_by in group) or all(len(units[one.element]) > 1 for one, _ in group)
        ]
        for group in spread(whole_groups, MOST_ELEMENTS):
            parts = [one for one, _ in group]
            nodes = mounts.get((parts[0].element, parts[0].number), ())
            made = [factored(first, one) for one in (parts if nodes else [summed(parts)])]
            matrices = tuple(matrix for matrix in made if matrix is not None)
            if matrices:
                labels = tuple(dict.fromkeys(map(_label, parts)))
                properties = differing_properties(group, _label)
                yield cls(
                    where=labels, strengths=PARTS, properties=properties, matrices=matrices, is_whole=True, nodes=nodes
                )

    @property
    def place(self) -> tuple[str, tuple[str, ...]]:
        return f"{self.kind} {self._kind_of_matrix}", self.where

    @property
    def _kind_of_matrix(self) -> str:
        return self.matrices[0].kind if self.matrices else "stiffness"

    def sentence(self, value: float | None) -> str:
        """A clause that says which element or mount differs from its group; `value`, the factor or None, is not used."""
        if self.nodes:
            ends = " and ".join(map(str, self.nodes))
            ends = f"at node {ends}" if len(self.nodes) == 1 else f"between nodes {ends}"
            return f"all springs {ends} differ from their groups: {join_words(self.where)}"
        if self.is_whole:
            return f"{self.where[0]} differs from its group in all its stiffnesses"
        return f"the {self._kind_of_matrix} of {self.where[0]} is not that of its group"


def _separation(model: TestedModel, differing: DifferingProperty, start_factor: float) -> SeparateElement:
    """Edit that gives the property of an element or set a separate parameter; `differing` names set and property.

    It is a factor on nominal values that starts at `start_factor`, or follows the one that `differing` names. The edit
    has the nominal values of every set with the property, and for an element the size of its set (1 for a whole set).
    """
    where, prop, follows = differing
    nominal: dict[str, tuple[float, ...]] = {}
    count = 1
    for setup in model.setups:
        for item in setup.structure.properties:
            if item.term.property == prop:
                nominal[item.element] = tuple(item.term.values.tolist())
            if item.element == where.rpartition(":")[0]:
                count = max(count, len(item.term.values))
    return SeparateElement(where, prop, start_factor, count, nominal, follows)


def _label(one: ElementMatrix) -> str:
    return f"{one.element}:{one.number + 1}"


def _of_elements(moved: Sequence[MatrixOnNodes]) -> Iterator[ElementMatrix]:
    """Element matrices, each summed over those of an element that are of one kind and that the same parameters change.

    `moved` are pairs of an element matrix and the indices of the parameters that change it. Matrices that no parameter
    changes are summed with others of the same property alone. The order is that of first appearance.
    """
    parts: dict[tuple[object, ...], list[ElementMatrix]] = {}
    for element_matrix, moved_by in moved:
        parts.setdefault(
            (element_matrix.element, element_matrix.number, element_matrix.kind, moved_by or element_matrix.property),
            [],
        ).append(element_matrix)
    for items in parts.values():
        yield summed(items)


def _mounts(structure: Structure) -> dict[tuple[str, int], tuple[int, ...]]:
    """Node labels that each spring joins, by (set name, number from 0); one label for a spring to the ground."""
    return {
        (element.name, number): tuple(sorted({node for node in ends if node >= 0}))
        for element in structure.elements
        if isinstance(element, Spring)
        for number, ends in enumerate(element.nodes.tolist())
    }


def stiff_parts(receptances: Receptances, moved: Sequence[MatrixOnNodes]) -> list[MatrixOnNodes]:
    """Element matrices among `moved` that are stiffnesses, are not zero, and act on something that moves."""
    return [
        (one, moved_by)
        for one, moved_by in moved
        if one.kind == "stiffness" and one.matrix.any() and receptances.moves(one.codes)
    ]


def groups_of_stiffnesses(
    stiff: Sequence[MatrixOnNodes],
    unit_of: Callable[[ElementMatrix], Hashable],
    label: Callable[[ElementMatrix], str],
) -> Iterator[list[MatrixOnNodes]]:
    """Groups of stiffness matrices, one group for each element, set or mount with two or more independent stiffnesses.

    Matrices that the same parameters change are one stiffness, and so are fixed ones of one property. Groups of which a
    parameter is separate already are left out. In a group of one label, one fixed stiffness does not count (a beam's
    axial one hardly matters in bending); springs of a mount have a label each.

    Parameters
    ----------
    stiff : sequence of (ElementMatrix, indices of the parameters that change it)
    unit_of : callable
        Returns the key of the element, set or mount that a matrix belongs to.
    label : callable
        Returns the name of a matrix's element or set.
    """
    groups: dict[Hashable, list[MatrixOnNodes]] = {}
    moving: dict[int, set[Hashable]] = {}
    for one, moved_by in stiff:
        groups.setdefault(unit_of(one), []).append((one, moved_by))
        for number in moved_by:
            moving.setdefault(number, set()).add(unit_of(one))
    for group in groups.values():
        labels = {label(one) for one, _ in group}
        ways = {(label(one), moved_by or one.property) for one, moved_by in group}
        has_fixed = len(labels) == 1 and not all(moved_by for _, moved_by in group)
        movers = {number for _, moved_by in group for number in moved_by}
        if len(ways) - has_fixed > 1 and all(len(moving[number]) > 1 for number in movers):
            yield group


def differing_properties(
    group: Sequence[MatrixOnNodes], label: Callable[[ElementMatrix], str]
) -> tuple[DifferingProperty, ...]:
    """Properties of one group of stiffness matrices, each with the parameter whose factor it shares, if any.

    Properties that the same parameters change share one factor, and all fixed properties share another. If all are
    fixed and of one element or set, they are together its ``stiffness``.

    Parameters
    ----------
    group : sequence of (ElementMatrix, indices of the parameters that change it)
    label : callable
        Returns the name of a matrix's element or set.
    """
    if not any(moved_by for _, moved_by in group) and len({label(element_matrix) for element_matrix, _ in group}) == 1:
        return (DifferingProperty(label(group[0][0]), "stiffness"),)
    properties = dict[tuple[str, str], DifferingProperty]()
    leaders = dict[tuple[int, ...], str]()
    for element_matrix, moved_by in sorted(group, key=lambda pair: not pair[1]):
        if (label(element_matrix), element_matrix.property) in properties:
            continue
        follows = leaders.get(moved_by)
        properties[label(element_matrix), element_matrix.property] = DifferingProperty(
            label(element_matrix), element_matrix.property, follows
        )
        if follows is None:
            leaders[moved_by] = f"{element_matrix.property}[{label(element_matrix)}]"
    return tuple(properties.values())
