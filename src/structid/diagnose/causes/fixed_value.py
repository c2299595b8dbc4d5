"""A fixed property whose true value differs from the model's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from structid.core.display import join_words
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import AddUnknown, Edits
from structid.diagnose.tested_model import TestedModel
from structid.fem import Structure
from structid.forward import RecordProblem
from structid.unknowns import Parameters

#: Difference by which all sets that are off by one factor give way to a simpler cause.
_OF_ALL = 0.25
ELASTIC = ("mass", "stiffness", "rotary_inertia")
DAMPING = ("loss_factor", "viscous_damping", "damping_ratio")


@dataclass(frozen=True, eq=False, kw_only=True)
class FixedValue(Candidate):
    """A mass, stiffness or damping of a set that no parameter changes, or that of several sets by one factor."""

    kind: ClassVar[str] = "held"
    result_kind: ClassVar[str] = "untied"

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """A candidate for each mass, stiffness or damping that no parameter changes, and one for each property.

        The latter is for all sets together, and only where several have the property fixed. The structure is that of
        the first record; `problems` are not used.
        """
        setup = model.setups[0]
        single = [
            *fixed_values(setup.structure, setup.parameters),
            *fixed_values(setup.structure, setup.parameters, DAMPING),
        ]
        yield from single
        for prop in dict.fromkeys(_property(one) for one in single):
            names = tuple(one.where[0] for one in single if _property(one) == prop)
            if len(names) > 1:  # of one material
                yield cls(where=names)

    @property
    def family(self) -> str:
        """Kind and property, so that masses do not compete with stiffnesses for a place."""
        return f"{self.kind} {_property(self)}"

    @property
    def handicap(self) -> float:
        return _OF_ALL if len(self.where) > 1 else 0.0

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edit that makes the fixed property an unknown: its value, or one factor where several sets share it.

        The sets are those in `self.where`. `strength` is not used.
        """
        names = [text.rstrip("]").partition("[")[2] for text in self.where]
        if len(names) == 1:
            return [AddUnknown({"property": _property(self), "elements": names[0]})]
        return [AddUnknown({"property": _property(self), "elements": names, "factor": True})]

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"{join_words(self.where)}, which the study fixes, are off by one factor"
        return f"{self.where[0]}, fixed in the study, differs from its stated value"


def fixed_values(structure: Structure, unknown: Parameters, kinds: Sequence[str] = ELASTIC) -> tuple[FixedValue, ...]:
    """Candidates for the properties of element sets, of the given kinds, that are not zero and that no parameter changes.

    `unknown` are the parameters of `structure`; `kinds` are by default masses, stiffnesses and rotary inertias.
    """
    design = unknown.design.tocsr()
    return tuple(
        FixedValue(where=(f"{item.term.property}[{item.element}]",))
        for item in structure.properties
        if item.term.kind in kinds and item.term.values.any() and not design[item.values.start : item.values.stop].nnz
    )


def _property(value: Candidate) -> str:
    return value.where[0].partition("[")[0]
