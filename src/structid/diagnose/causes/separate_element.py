"""An element differs from its group, in one stiffness, in its mass, or in all its stiffnesses; so do all springs of a mount."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.places import MOST_ELEMENTS, Factored, factored, moved_elements, spread, summed
from structid.diagnose.effects import all_directions, effect_of_addition, effect_of_coupling
from structid.diagnose.model_edits import Edits, SeparateElement, rounded
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem import Spring

#: Parts of what an element has by which it may differ.
PARTS = np.array([-0.9, -0.7, -0.5, -0.3, -0.15, -0.05, 0.05, 0.2, 0.4, 0.8, 1.5, 3.0, 8.0])
#: Difference by which an element that differs in all stiffnesses gives way to one that differs in one.
_AS_A_WHOLE = 0.25

#: An element matrix and the positions of the parameters that move it.
_Moved: TypeAlias = tuple[ElementMatrix, tuple[int, ...]]


class Share(NamedTuple):
    """One property of one element that differs, by a factor of its own or, in `follows`, by that of another parameter."""

    element: str
    property: str
    follows: str | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class DifferingElement(Candidate):
    """An element whose stiffness, mass or stiffnesses are not those of its group; the strength is a part of what it has.

    The springs between the same two nodes, or one and the ground, are one mount, which differs as one element does. The
    look takes one factor on all stiffnesses; a fit has a factor for each that is an unknown of its own, since a factor is one
    on the initial value of the study and other elements have left theirs. Held ones have one together.

    Attributes
    ----------
    shares : tuple of Share
        What differs.
    matrices : tuple of Factored
        That of the element, or one for each spring of a mount.
    is_whole : bool
        Whether all its stiffnesses differ.
    nodes : tuple of int
        Those of a mount.
    """

    kind: ClassVar[str] = "untied"
    bounds: tuple[float, float] = (-1.0, np.inf)
    shares: tuple[Share, ...]
    matrices: tuple[Factored, ...] = field(default=(), repr=False)
    is_whole: bool = False
    nodes: tuple[int, ...] = ()

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for the stiffness, the mass and all stiffnesses of each element in a set of several, and for mounts."""
        first = records[0]
        moved = list(moved_elements(first))
        items = list(_of_elements(moved))
        counts = Counter((one.element, one.property) for one in items)
        several = [one for one in items if counts[one.element, one.property] > 1]
        for one in spread(several, 2 * MOST_ELEMENTS):
            matrix = factored(first, one)
            if matrix is not None:
                where = _label(one)
                share = Share(where, one.property)
                yield cls(where=(where,), strengths=PARTS, shares=(share,), matrices=(matrix,))
        for nodes, group in spread(list(_wholes(first, moved)), MOST_ELEMENTS):
            whole = [one for one, _ in group]
            made = [factored(first, one) for one in (whole if nodes else [summed(whole)])]
            matrices = tuple(matrix for matrix in made if matrix is not None)
            if matrices:
                where_all = tuple(dict.fromkeys(map(_label, whole)))
                shares = _shares(group)
                yield cls(
                    where=where_all, strengths=PARTS, shares=shares, matrices=matrices, is_whole=True, nodes=nodes
                )

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        directions = all_directions([one.directions for one in self.matrices])
        laws = [one.law(receptances) for one in self.matrices]
        if len(laws) == 1:
            return effect_of_addition(receptances, directions, laws[0], strengths)
        law = np.stack(laws, axis=-1)[:, :, None] * np.eye(len(laws))
        return effect_of_coupling(receptances, directions, strengths[:, None, None, None] * law)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [
            replace(separation(model, share.element, share.property, strength), follows=share.follows)
            for share in self.shares
        ]

    @property
    def handicap(self) -> float:
        return _AS_A_WHOLE if self.is_whole else 0.0

    @property
    def place(self) -> tuple[str, tuple[str, ...]]:
        return f"{self.kind} {self._what}", self.where

    @property
    def key(self) -> Hashable:
        return self.place, self.shares

    @property
    def _what(self) -> str:
        return self.matrices[0].kind if self.matrices else "stiffness"

    def sentence(self, value: float | None) -> str:
        if self.nodes:
            ends = " and ".join(map(str, self.nodes))
            ends = f"at node {ends}" if len(self.nodes) == 1 else f"between nodes {ends}"
            return f"all springs {ends} differ from their groups: {join_words(self.where)}"
        if self.is_whole:
            return f"{self.where[0]} differs from its group in all its stiffnesses"
        return f"the {self._what} of {self.where[0]} is not that of its group"


def separation(model: TestedModel, where: str, prop: str, strength: float) -> SeparateElement:
    """The edit that gives an element (``girder:2``) or a set a factor on a property, started at 1 + strength."""
    nominal: dict[str, tuple[float, ...]] = {}
    count = 1
    for setup in model.setups:
        for item in setup.structure.properties:
            if item.term.property == prop:
                nominal[item.element] = tuple(item.term.values.tolist())
            if item.element == where.rpartition(":")[0]:
                count = max(count, len(item.term.values))
    return SeparateElement(where, prop, rounded(1 + strength), count, nominal)


def _label(one: ElementMatrix) -> str:
    return f"{one.element}:{one.number + 1}"


def _of_elements(moved: Sequence[_Moved]) -> Iterator[ElementMatrix]:
    """Stiffness and mass matrices of elements, summed over properties that the same parameters change."""
    parts: dict[tuple[object, ...], list[ElementMatrix]] = {}
    for one, moved_by in moved:
        parts.setdefault((one.element, one.number, one.kind, moved_by or one.property), []).append(one)
    for items in parts.values():
        yield summed(items)


def _wholes(receptances: Receptances, moved: Sequence[_Moved]) -> Iterator[tuple[tuple[int, ...], list[_Moved]]]:
    """Nodes of each mount, none of another element, and its stiffness matrices, where several of a group differ by themselves.

    Of elements with one unknown stiffness a single held one is no second: that of a bent beam along its axis hardly matters.
    """
    mounts = {
        (element.name, number): tuple(sorted({node for node in ends if node >= 0}))
        for element in receptances.structure.elements
        if isinstance(element, Spring)
        for number, ends in enumerate(element.nodes.tolist())
    }
    wholes: dict[tuple[object, ...], list[_Moved]] = {}
    moving: dict[int, set[tuple[object, ...]]] = {}
    in_set: dict[str, set[tuple[object, ...]]] = {}
    for one, moved_by in moved:
        if one.kind != "stiffness" or not receptances.reached(one.codes).any() or not one.matrix.any():
            continue
        whole = mounts.get((one.element, one.number), (one.element, one.number))
        wholes.setdefault(whole, []).append((one, moved_by))
        in_set.setdefault(one.element, set()).add(whole)
        for number in moved_by:
            moving.setdefault(number, set()).add(whole)
    for group in wholes.values():
        nodes = mounts.get((group[0][0].element, group[0][0].number), ())
        ways = {(one.element, one.number, moved_by or one.property) for one, moved_by in group}
        n_held = len({(one.element, one.number, one.property) for one, moved_by in group if not moved_by})
        n_ways = len(ways) - (n_held == 1 and not nodes)
        movers = {number for _, moved_by in group for number in moved_by}
        others = [moving[number] for number in movers] or [in_set[one.element] for one, _ in group]
        if n_ways > 1 and all(len(sharing) > 1 for sharing in others):
            yield nodes, group


def _shares(group: Sequence[_Moved]) -> tuple[Share, ...]:
    """Properties of an element or mount, with one factor for those that the same parameters move, and one for all held ones."""
    if not any(moved_by for _, moved_by in group) and len({_label(one) for one, _ in group}) == 1:
        return (Share(_label(group[0][0]), "stiffness"),)
    shares = dict[tuple[str, str], Share]()
    leaders = dict[tuple[int, ...], str]()
    for one, moved_by in sorted(group, key=lambda pair: not pair[1]):
        if (_label(one), one.property) in shares:
            continue
        follows = leaders.get(moved_by)
        shares[_label(one), one.property] = Share(_label(one), one.property, follows)
        if follows is None:
            leaders[moved_by] = f"{one.property}[{_label(one)}]"
    return tuple(shares.values())
