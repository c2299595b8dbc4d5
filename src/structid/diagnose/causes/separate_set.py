"""A whole set differs from the group that one parameter ties it to, or in all its stiffnesses, such as one of several columns."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.places import MOST_ELEMENTS, Factored, factored, moved_elements, spread, summed
from structid.diagnose.causes.separate_element import (
    AS_A_WHOLE,
    PARTS,
    Share,
    separations,
    several_stiffnesses,
    shares_of,
    stiff_parts,
)
from structid.diagnose.effects import effect_of_addition
from structid.diagnose.model_edits import Edits
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem import Spring

#: Degrees of freedom of a set, and in how many ways it may move to be tried as a whole.
_MOST_CODES, _MOST_WAYS = 300, 60


@dataclass(frozen=True, eq=False, kw_only=True)
class DifferingSet(Candidate):
    """A whole set whose property, or whose stiffnesses, are not those of its group; the strength is a part of what it has."""

    kind: ClassVar[str] = "untied set"
    result_kind: ClassVar[str] = "untied"
    bounds: tuple[float, float] = (-1.0, np.inf)
    shares: tuple[Share, ...]
    matrix: Factored | None = field(default=None, repr=False)
    is_whole: bool = False

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for the stiffness or mass of each set that one parameter ties to others, and for all its stiffnesses."""
        first = records[0]
        moved = list(moved_elements(first))
        groups: dict[tuple[str, tuple[int, ...]], dict[str, list[ElementMatrix]]] = {}
        for one, moved_by in moved:
            if len(moved_by) == 1:
                groups.setdefault((one.kind, moved_by), {}).setdefault(one.element, []).append(one)
        tied = [summed(items) for sets in groups.values() if len(sets) > 1 for items in sets.values()]
        for one in spread(tied, MOST_ELEMENTS):
            yield from cls._of_matrix(first, one, (Share(one.element, one.property),), is_whole=False)
        springs = {element.name for element in first.structure.elements if isinstance(element, Spring)}
        stiff = [pair for pair in stiff_parts(first, moved) if pair[0].element not in springs]
        wholes = [
            group
            for group in several_stiffnesses(stiff, lambda one: one.element, lambda one: False)
            if len({one.number for one, _ in group}) > 1 or not any(moved_by for _, moved_by in group)
        ]
        for group in spread(wholes, MOST_ELEMENTS):
            shares = shares_of(group, lambda one: one.element)
            yield from cls._of_matrix(first, summed([one for one, _ in group]), shares, is_whole=True)

    @classmethod
    def _of_matrix(
        cls, first: Receptances, one: ElementMatrix, shares: tuple[Share, ...], is_whole: bool
    ) -> Iterator[Candidate]:
        """A candidate for what a matrix of a set changes, where that is not too large."""
        matrix = factored(first, one, _MOST_WAYS) if len(one.codes) <= _MOST_CODES else None
        if matrix is not None:
            yield cls(where=(one.element,), strengths=PARTS, shares=shares, matrix=matrix, is_whole=is_whole)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        assert self.matrix is not None
        return effect_of_addition(receptances, self.matrix.directions, self.matrix.law(receptances), strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return separations(model, self.shares, strength)

    @property
    def handicap(self) -> float:
        return AS_A_WHOLE if self.is_whole else 0.0

    @property
    def key(self) -> Hashable:
        return self.place, self.shares

    def sentence(self, value: float | None) -> str:
        if self.is_whole and len(self.shares) == 1:  # all of them are held
            return f"the stiffnesses of all of {self.where[0]}, which the study fixes, are off by one factor"
        if self.is_whole:
            return f"all of {self.where[0]} differs from its group in all its stiffnesses"
        return f"the {self.shares[0].property.replace('_', ' ')} of all of {self.where[0]} is not that of its group"
