"""A whole set differs from the group that one parameter ties it to, or in all its stiffnesses, such as one of several columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import ClassVar

from structid.diagnose.causes.candidate import MOST_ELEMENTS, Candidate, factored, moved_elements, spread, summed
from structid.diagnose.causes.separate_element import (
    PARTS,
    Differing,
    DifferingProperty,
    differing_properties,
    groups_of_stiffnesses,
    stiff_parts,
)
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.fem import Spring

#: Degrees of freedom of a set, and in how many ways it may move to be tried as a whole.
_MOST_CODES, _MOST_WAYS = 300, 60

_set_of = attrgetter("element")


@dataclass(frozen=True, eq=False, kw_only=True)
class DifferingSet(Differing):
    """A whole set whose property, or whose stiffnesses, are not those of its group."""

    kind: ClassVar[str] = "untied set"
    result_kind: ClassVar[str] = "untied"

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for the stiffness or mass of each set that shares a parameter with others, and for all its stiffnesses.

        Springs are left out of the latter; of many sets 150 of each are tried, evenly chosen. `records` are the
        receptances of each record; the first one counts. Strengths are relative changes, -0.9 to 8. `record_names` are
        not used.
        """
        first = records[0]
        moved = list(moved_elements(first))
        groups: dict[tuple[str, tuple[int, ...]], dict[str, list[ElementMatrix]]] = {}
        for one, moved_by in moved:
            if len(moved_by) == 1:
                groups.setdefault((one.kind, moved_by), {}).setdefault(one.element, []).append(one)
        tied = [summed(items) for sets in groups.values() if len(sets) > 1 for items in sets.values()]
        for one in spread(tied, MOST_ELEMENTS):
            yield from cls._of_matrix(first, one, (DifferingProperty(one.element, one.property),), is_whole=False)
        springs = {element.name for element in first.structure.elements if isinstance(element, Spring)}
        stiff = [pair for pair in stiff_parts(first, moved) if pair[0].element not in springs]
        wholes = [
            group
            for group in groups_of_stiffnesses(stiff, _set_of, _set_of)
            if len({one.number for one, _ in group}) > 1 or not any(moved_by for _, moved_by in group)
        ]
        for group in spread(wholes, MOST_ELEMENTS):
            properties = differing_properties(group, _set_of)
            yield from cls._of_matrix(first, summed([one for one, _ in group]), properties, is_whole=True)

    @classmethod
    def _of_matrix(
        cls,
        receptances: Receptances,
        element_matrix: ElementMatrix,
        properties: tuple[DifferingProperty, ...],
        is_whole: bool,
    ) -> Iterator[Candidate]:
        """Candidate that an element set differs by a factor on its `element_matrix`; none if the matrix is too large.

        The factor is on `properties` of the set; `is_whole` says that these are all of its stiffnesses. Too large are
        more than 300 degrees of freedom, or more than 60 independent directions. `receptances` are those of the first
        record.
        """
        matrix = factored(receptances, element_matrix, _MOST_WAYS) if len(element_matrix.codes) <= _MOST_CODES else None
        if matrix is not None:
            where = (element_matrix.element,)
            yield cls(where=where, strengths=PARTS, properties=properties, matrices=(matrix,), is_whole=is_whole)

    def sentence(self, value: float | None) -> str:
        """A clause that says in which property a whole set differs from its group; `value`, the factor or None, is not used."""
        if self.is_whole and len(self.properties) == 1:  # the study fixes all of them
            return f"the stiffnesses of all of {self.where[0]}, which the study fixes, are off by one factor"
        if self.is_whole:
            return f"all of {self.where[0]} differs from its group in all its stiffnesses"
        return f"the {self.properties[0].property.replace('_', ' ')} of all of {self.where[0]} is not that of its group"
