"""A whole set differs from the group that one parameter ties it to, such as one of several mounts."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.places import MOST_ELEMENTS, Factored, factored, moved_elements, spread, summed
from structid.diagnose.causes.separate_element import PARTS, separation
from structid.diagnose.effects import effect_of_addition
from structid.diagnose.model_edits import Edits
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.diagnose.tested_model import TestedModel

#: Degrees of freedom of a set, and in how many ways it may move to be tried as a whole.
_MOST_CODES, _MOST_WAYS = 300, 60


@dataclass(frozen=True, eq=False, kw_only=True)
class DifferingSet(Candidate):
    """A whole set whose property is not that of its group; the strength is a part of what it has."""

    kind: ClassVar[str] = "untied set"
    result_kind: ClassVar[str] = "untied"
    bounds: tuple[float, float] = (-1.0, np.inf)
    property_name: str
    matrix: Factored | None = field(default=None, repr=False)

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for the stiffness or mass of each set that one parameter ties to other sets."""
        first = records[0]
        groups: dict[tuple[str, tuple[int, ...]], dict[str, list[ElementMatrix]]] = {}
        for one, moved_by in moved_elements(first):
            if len(moved_by) == 1:
                groups.setdefault((one.kind, moved_by), {}).setdefault(one.element, []).append(one)
        tied = [summed(items) for sets in groups.values() if len(sets) > 1 for items in sets.values()]
        for one in spread(tied, MOST_ELEMENTS):
            matrix = factored(first, one, _MOST_WAYS) if len(one.codes) <= _MOST_CODES else None
            if matrix is not None:
                yield cls(where=(one.element,), strengths=PARTS, property_name=one.property, matrix=matrix)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        assert self.matrix is not None
        return effect_of_addition(receptances, self.matrix.directions, self.matrix.law(receptances), strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [separation(model, self.where[0], self.property_name, strength)]

    @property
    def key(self) -> Hashable:
        return self.place, self.property_name

    def sentence(self, value: float | None) -> str:
        return f"the {self.property_name.replace('_', ' ')} of all of {self.where[0]} is not that of its group"
