"""An element differs from its group, in stiffness or mass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.places import MOST_ELEMENTS, Factored, factored, moved_elements, spread, summed
from structid.diagnose.effects import effect_of_addition
from structid.diagnose.model_edits import Edits, SeparateElement, rounded
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.diagnose.tested_model import TestedModel

#: Parts of what an element has by which it may differ.
PARTS = np.array([-0.9, -0.7, -0.5, -0.3, -0.15, -0.05, 0.05, 0.2, 0.4, 0.8, 1.5, 3.0, 8.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class DifferingElement(Candidate):
    """An element whose stiffness or mass is not that of its group; the strength is a part of what it has.

    Attributes
    ----------
    property_name : str
    """

    kind: ClassVar[str] = "untied"
    bounds: tuple[float, float] = (-1.0, np.inf)
    property_name: str
    matrix: Factored | None = field(default=None, repr=False)

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for the stiffness and the mass of each element in a set of several."""
        first = records[0]
        items = list(_of_elements(first))
        counts = Counter((one.element, one.property) for one in items)
        several = [one for one in items if counts[one.element, one.property] > 1]
        for one in spread(several, 2 * MOST_ELEMENTS):
            matrix = factored(first, one)
            if matrix is not None:
                where = (f"{one.element}:{one.number + 1}",)
                yield cls(where=where, strengths=PARTS, property_name=one.property, matrix=matrix)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        assert self.matrix is not None
        return effect_of_addition(receptances, self.matrix.directions, self.matrix.law(receptances), strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [separation(model, self.where[0], self.property_name, strength)]

    @property
    def place(self) -> tuple[str, tuple[str, ...]]:
        return f"{self.kind} {self._what}", self.where

    @property
    def key(self) -> Hashable:
        return self.place, self.property_name

    @property
    def _what(self) -> str:
        return "stiffness" if self.matrix is None else self.matrix.kind

    def sentence(self, value: float | None) -> str:
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


def _of_elements(receptances: Receptances) -> Iterator[ElementMatrix]:
    """Stiffness and mass matrices of elements, summed over properties that the same parameters change."""
    parts: dict[tuple[object, ...], list[ElementMatrix]] = {}
    for one, moved_by in moved_elements(receptances):
        parts.setdefault((one.element, one.number, one.kind, moved_by or one.property), []).append(one)
    for items in parts.values():
        yield summed(items)
