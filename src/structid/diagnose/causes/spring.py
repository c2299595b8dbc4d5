"""Something holds a degree of freedom: a spring to the ground."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.core.dof import parse_dof
from structid.diagnose.causes.candidate import POSITIVE, Candidate, added_spring, chosen_dofs, constant
from structid.diagnose.effects import Directions, direction_of, effect_of_addition, stiffness_scale, strengths_about
from structid.diagnose.model_edits import Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


@dataclass(frozen=True, eq=False, kw_only=True)
class SpringToGround(Candidate):
    """A spring from a degree of freedom to the ground, with a loss factor of its own where one is given; or several alike."""

    kind: ClassVar[str] = "spring"
    bounds: tuple[float, float] = POSITIVE
    loss_factor: float | None = None

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        first = records[0]
        for dof, direction in chosen_dofs(first):
            yield cls(where=(dof.place,), strengths=strengths_about(stiffness_scale(first, direction, constant(first))))

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return effect_of_addition(receptances, self._direction, constant(receptances), strengths)

    @property
    def _direction(self) -> Directions:
        return direction_of((parse_dof(self.where[0]), 1.0))

    def alike_by(self) -> tuple[Directions, tuple[object, ...]]:
        return self._direction, (self.kind, self.strengths.tobytes(), self.where[1:])

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that add a spring of unknown stiffness, which starts at `strength` (N/m or N m/rad), to the ground.

        It acts at each degree of freedom in `self.where`. If `self.loss_factor` is not None, the spring has that loss
        factor, as a further unknown.
        """
        name = model.unique_name(f"spring {self.where[0]}")
        first = list(self.where) if len(self.where) > 1 else self.where[0]
        entry = {"name": name, "first": first, "stiffness": rounded(strength)}
        return added_spring("spring", entry, self.loss_factor)

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"something holds {join_words(self.where)}: springs to the ground"
        return f"something holds {self.where[0]}: a spring to the ground"

    def is_clamp(self, held_nodes: Collection[int]) -> bool:
        """True if its node is in `held_nodes`: supported in some directions, it may be clamped in this as well."""
        return parse_dof(self.where[0]).node in held_nodes
