"""A damper acts between a degree of freedom and the ground, or across a spring."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.causes.candidate import (
    MOST_ELEMENTS,
    POSITIVE,
    Candidate,
    chosen_dofs,
    spread,
    spring_ends,
    velocity,
)
from structid.diagnose.effects import Directions, effect_of_addition, stiffness_scale, strengths_about
from structid.diagnose.model_edits import AddPart, AddUnknown, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


@dataclass(frozen=True, eq=False, kw_only=True)
class Dashpot(Candidate):
    """A damper from a degree of freedom to the ground, or between the ends of a spring."""

    kind: ClassVar[str] = "dashpot"
    is_damping: ClassVar[bool] = True
    bounds: tuple[float, float] = POSITIVE
    direction: Directions = field(repr=False)

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate dampers from degrees of freedom to the ground, then across springs of which both ends move.

        Degrees of freedom are those of `chosen_nodes` (up to 60, and those of channels); of more than 150 springs as
        many are tried, evenly chosen. Only the first of `records` (receptances of each) counts. Strengths are viscous
        dampings, 0.005 to 60 times the one as stiff as the structure there. `record_names` are not used.
        """
        first = records[0]
        places = [((dof.place,), direction) for dof, direction in chosen_dofs(first)]
        for where, direction in [*places, *spread(list(spring_ends(first)), MOST_ELEMENTS)]:
            scale = stiffness_scale(first, direction, velocity(first))
            yield cls(where=where, direction=direction, strengths=strengths_about(scale))

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return effect_of_addition(receptances, self.direction, velocity(receptances), strengths)

    def alike_by(self) -> tuple[Directions, tuple[object, ...]] | None:
        return (self.direction, (self.kind, self.strengths.tobytes())) if len(self.where) == 1 else None

    @property
    def handicap(self) -> float:
        return 1.0

    def edits(self, model: TestedModel, strength: float) -> Edits:
        name = model.unique_name(f"dashpot {' '.join(self.where)}")
        ends = dict(zip(("first", "second"), self.where, strict=False))
        return [
            AddPart("dashpot", {"name": name, **ends, "viscous_damping": rounded(strength)}),
            AddUnknown({"property": "viscous_damping", "elements": name}),
        ]

    def sentence(self, value: float | None) -> str:
        return f"a damper acts {'between' if len(self.where) > 1 else 'at'} {' and '.join(self.where)}"
