"""A mass at a node is missing in the model, or too much in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.diagnose.causes.candidate import (
    Candidate,
    chosen_dofs,
    has_places,
    inertia,
    record_words,
    unknown_of_either_sign,
)
from structid.diagnose.effects import (
    Directions,
    all_directions,
    direction_of,
    effect_of_addition,
    stiffness_scale,
    strengths_about,
)
from structid.diagnose.model_edits import AddPart, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


def lack_words(value: float | None) -> str:
    """The clause "missing in the model" for a positive or unknown mass, "too much in the model" for a negative one."""
    return "missing in the model" if value is None or value > 0 else "too much in the model"


@dataclass(frozen=True, eq=False, kw_only=True)
class Mass(Candidate):
    """A mass of either sign that moves in all directions of a node, in all records or in one of them."""

    kind: ClassVar[str] = "mass"

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate masses at nodes that translate, common to all records and, if there are several, in each alone.

        Nodes are those of `chosen_nodes` (up to 60, and those of channels) by the first record or by that record;
        records of models of more than 3000 degrees of freedom (1200 with components or driving supports) have none
        alone. Strengths are masses, kg, of either sign. `records` are the receptances of each record, `record_names`
        their names.
        """
        yield from cls._at_nodes(records[0])
        for number, receptances in enumerate(records if len(record_names) > 1 else ()):
            if has_places(receptances.problem):
                yield from cls._at_nodes(receptances, number, record_names[number])

    @classmethod
    def _at_nodes(cls, receptances: Receptances, record: int | None = None, name: str = "") -> Iterator[Candidate]:
        """Candidate masses at nodes that translate, one for each of `chosen_nodes` (up to 60, and those of channels).

        `record` and `name` are the index and name of the only record that has them; by default all have them.
        `receptances` are those of that record, or of the first of all. Strengths are masses, kg, of either sign.
        """
        nodes: dict[int, list[Directions]] = {}
        for dof, direction in chosen_dofs(receptances):
            if not dof.is_rotation:
                nodes.setdefault(dof.node, []).append(direction)
        for node, directions in nodes.items():
            scale = min(stiffness_scale(receptances, one, inertia(receptances)) for one in directions)
            where = (str(node),) if record is None else (str(node), name)
            yield cls(where=where, strengths=strengths_about(scale, (1, -1)), record=record)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        """Changes of a record's FRFs, (n_strengths, n_lines, n_outputs, n_inputs), by masses at node `self.where[0]`.

        `strengths` (n_strengths,) are in kg, `receptances` those of the record; the unit is that of the record.
        """
        node = int(self.where[0])
        moves = [Dof(node, direction) for direction in DIRECTIONS[:3]]
        directions = all_directions([direction_of((dof, 1.0)) for dof in moves if dof in receptances.columns])
        return effect_of_addition(receptances, directions, inertia(receptances), strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        name = model.unique_name(f"mass {' '.join(self.where)}")
        entry = {"name": name, "nodes": [int(self.where[0])], "mass": rounded(abs(strength))}
        return [AddPart("point_mass", entry, self.record), unknown_of_either_sign("mass", name, strength)]

    def sentence(self, value: float | None) -> str:
        of_record = f" in {record_words(self.where[1])}" if len(self.where) > 1 else ""
        return f"a mass at node {self.where[0]} is {lack_words(value)}{of_record}"
