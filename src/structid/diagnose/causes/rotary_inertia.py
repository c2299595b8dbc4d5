"""A rotary inertia at a node is missing in the model, or too much in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import parse_dof
from structid.diagnose.causes.candidate import Candidate, chosen_nodes, inertia, unknown_of_either_sign
from structid.diagnose.causes.mass import lack_words
from structid.diagnose.effects import direction_of, effect_of_addition, stiffness_scale, strengths_about
from structid.diagnose.model_edits import AddPart, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem.elements.element import dof_code


@dataclass(frozen=True, eq=False, kw_only=True)
class AddedRotaryInertia(Candidate):
    """A rotary inertia of either sign at a free rotation of a node of the study; it is at most all that the model has there."""

    kind: ClassVar[str] = "inertia"

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate rotary inertias at free rotations of nodes; negative ones take away less than the model has there.

        Nodes are those of `chosen_nodes` (up to 60, and those of channels). Only the first of `records` (receptances of
        each) counts. Strengths are rotary inertias, kg m^2, 0.005 to 60 times, of either sign, the one as stiff as the
        structure there. `record_names` are not used.
        """
        first, nodes = records[0], chosen_nodes(records[0])
        mass, free = first.structure.matrix("mass", first.values), set(first.structure.numbering.free)
        for dof, follow in first.columns.items():
            is_own = dof_code(dof.node, dof.direction) in free and dof.node in first.structure.nodes
            if dof.is_rotation and is_own and dof.node in nodes:
                most = float(follow @ (mass @ follow))
                scale = stiffness_scale(first, direction_of((dof, 1.0)), inertia(first))
                strengths = strengths_about(scale, (1, -1))
                yield cls(where=(dof.place,), strengths=strengths[strengths > -most], bounds=(-most, np.inf))

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        direction = direction_of((parse_dof(self.where[0]), 1.0))
        return effect_of_addition(receptances, direction, inertia(receptances), strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that add a rotary inertia at the node and make it an unknown that starts at `strength`, kg m^2.

        The property holds the magnitude; a negative `strength` starts the unknown below 0.
        """
        dof, name = parse_dof(self.where[0]), model.unique_name(f"inertia {self.where[0]}")
        size = rounded(abs(strength))
        entry = {"name": name, "nodes": [dof.node], "direction": dof.direction, "rotary_inertia": size}
        return [AddPart("rotary_inertia", entry), unknown_of_either_sign("rotary_inertia", name, strength)]

    def sentence(self, value: float | None) -> str:
        return f"a rotary inertia at {self.where[0]} is {lack_words(value)}"
