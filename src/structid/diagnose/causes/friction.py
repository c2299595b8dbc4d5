"""Something rubs at a degree of freedom: dry friction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import parse_dof
from structid.diagnose.causes.candidate import POSITIVE, Candidate, chosen_dofs
from structid.diagnose.effects import Directions, direction_of, effect_of_friction
from structid.diagnose.model_edits import AddPart, AddUnknown, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel

#: Friction forces per unit of drive.
FORCES = np.array([0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 2.0, 4.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class DryFriction(Candidate):
    """Dry friction to the ground, by harmonic balance, under one load."""

    kind: ClassVar[str] = "friction"
    is_damping: ClassVar[bool] = True
    has_reserved_place: ClassVar[bool] = True  # smoothed data do not show it
    other_strengths: ClassVar[tuple[float, ...]] = (3.0, 2.0)
    bounds: tuple[float, float] = POSITIVE

    @classmethod
    def can_act(cls, receptances: Receptances) -> bool:
        """True where the record has one load, a measured force: friction is computed for that alone."""
        problem = receptances.problem
        return len(problem.record.inputs) == 1 and problem.facts.measures_force

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for dof, _ in chosen_dofs(records[0]) if cls.can_act(records[0]) else ():
            yield cls(where=(dof.place,), strengths=FORCES)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return effect_of_friction(receptances, self._direction, strengths)

    @property
    def _direction(self) -> Directions:
        return direction_of((parse_dof(self.where[0]), 1.0))

    def alike_by(self) -> tuple[Directions, tuple[object, ...]]:
        return self._direction, (self.kind, self.strengths.tobytes())

    @property
    def handicap(self) -> float:
        return 1.5

    def edits(self, model: TestedModel, strength: float) -> Edits:
        name = model.unique_name(f"friction {self.where[0]}")
        return [
            AddPart("friction", {"name": name, "first": self.where[0], "friction_force": rounded(strength)}),
            AddUnknown({"property": "friction_force", "elements": name}),
        ]

    def sentence(self, value: float | None) -> str:
        return f"something rubs at {self.where[0]}"
