"""Cause: sensors have a mass that the model lacks, as accelerometers that weigh something."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.core.dof import Dof
from structid.diagnose.causes.candidate import Candidate, inertia, unknown_of_either_sign
from structid.diagnose.causes.mass import lack_words
from structid.diagnose.effects import (
    all_directions,
    direction_of,
    effect_of_addition,
    stiffness_scale,
    strengths_about,
)
from structid.diagnose.model_edits import AddPart, Edit, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel

#: Ways in which all sensors together may move, and places that are named.
_MOST_WAYS, _SHOWN = 60, 3


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorMass(Candidate):
    """Equal mass at the node of every sensor, in each record at its own sensors.

    Attributes
    ----------
    nodes : tuple of str
        The nodes of the sensors of each record.
    """

    kind: ClassVar[str] = "sensor_mass"
    nodes: tuple[str, ...]

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """One candidate, a mass common to all sensors, where these are at several nodes; else none.

        It is left out too where the sensor nodes of a record have more than 60 translations. `records` are the
        receptances of each record. Strengths are masses, kg, of either sign. `record_names` are not used.
        """
        nodes = list(dict.fromkeys(node for one in records for node in _sensed(one)))
        most = max(len(_translations(one, _sensed(one))) for one in records)
        if len(nodes) > 1 and most <= _MOST_WAYS:
            first = next(one for one in records if _sensed(one))
            moves = _translations(first, _sensed(first))
            scale = min(stiffness_scale(first, direction_of((dof, 1.0)), inertia(first)) for dof in moves)
            of_record = tuple(" ".join(map(str, _sensed(one))) for one in records)
            yield cls(where=tuple(map(str, nodes)), strengths=strengths_about(scale, (1, -1)), nodes=of_record)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        """Changes of a record's FRFs, (n_strengths, n_lines, n_outputs, n_inputs), by one mass at each sensor node.

        `strengths` (n_strengths,) are masses, kg, `receptances` those of the record. Zero where it has no sensor that
        translates.
        """
        directions = [direction_of((dof, 1.0)) for dof in _translations(receptances, _sensed(receptances))]
        if not directions:
            return np.zeros((len(strengths), *receptances.frf.shape), complex)
        return effect_of_addition(receptances, all_directions(directions), inertia(receptances), strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """The edits that add one unknown mass, common to all sensors, at the sensor nodes of each record.

        One element set is added where all records have the same sensor nodes, otherwise one for each record. `strength`
        is the mass in kg at which the unknown starts.
        """
        name = model.unique_name("mass of each sensor")
        is_same = len(set(self.nodes)) == 1
        edits: list[Edit] = []
        for number, nodes in enumerate(self.nodes[:1] if is_same else self.nodes):
            if nodes:
                entry = {"name": name, "nodes": [int(node) for node in nodes.split()], "mass": rounded(abs(strength))}
                edits.append(AddPart("point_mass", entry, None if is_same else number))
        return [*edits, unknown_of_either_sign("mass", name, strength)]

    def sentence(self, value: float | None) -> str:
        return f"each sensor has a mass that is {lack_words(value)}: at nodes {join_words(self.where, _SHOWN)}"


def _sensed(receptances: Receptances) -> tuple[int, ...]:
    """Labels of the nodes of a record's translation sensors that are free to move, each once; () if none is."""
    nodes = dict.fromkeys(dof.node for dof in receptances.problem.record.outputs if not dof.is_rotation)
    return tuple(node for node in nodes if _translations(receptances, (node,)))


def _translations(receptances: Receptances, nodes: Collection[int]) -> list[Dof]:
    """The translations in which the nodes with labels `nodes` are free to move, in the order of `receptances`."""
    return [dof for dof in receptances.columns if dof.node in nodes and not dof.is_rotation]
