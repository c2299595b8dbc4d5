"""A local resonance that the model lacks: an appendage, a cable, a loose part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import parse_dof
from structid.diagnose.causes.candidate import POSITIVE, Candidate, chosen_nodes, inertia, spread
from structid.diagnose.data_rows import misfit_of_lines
from structid.diagnose.effects import Directions, direction_of, effect_of_addition, stiffness_scale
from structid.diagnose.model_edits import AddNode, AddPart, AddUnknown, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel

_LOSS = 0.03
_MOST_FREQUENCIES, _MOST_NODES = 10, 24
_MASSES = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Appendage(Candidate):
    """A mass on a spring with loss at a degree of freedom; the strength is the mass.

    Attributes
    ----------
    frequency : float
        At which it resonates alone, Hz.
    """

    kind: ClassVar[str] = "appendage"
    bounds: tuple[float, float] = POSITIVE
    frequency: float

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate appendages at up to 24 nodes, one for each direction of a node and each frequency of resonance, Hz.

        `records` are the receptances of each record; the first gives nodes (24 evenly chosen of `chosen_nodes`) and
        frequencies. Strengths are masses, or rotary inertias at rotations, 0.01 to 3 times the one as stiff as the
        structure there. Rotations count only at nodes that do not translate, as in drive trains. `record_names` are not
        used.
        """
        first = records[0]
        nodes = set(spread(sorted(chosen_nodes(first)), _MOST_NODES))
        moving = {dof.node for dof in first.columns if not dof.is_rotation}
        frequencies = _frequencies(first)
        for dof in first.columns:
            if dof.node not in nodes or (dof.is_rotation and dof.node in moving):  # of drive trains what twists alone
                continue
            scale = stiffness_scale(first, direction_of((dof, 1.0)), inertia(first))
            for frequency in frequencies:
                yield cls(where=(dof.place,), strengths=scale * _MASSES, frequency=frequency)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        """Changes of the FRF, (n_strengths, n_lines, n_outputs, n_inputs), by masses (kg) on a spring.

        A unit mass on a spring k = (2 pi f)^2 (1 + i eta) adds s^2 k / (s^2 + k) to Z. `strengths` (n_strengths,) are
        the masses.
        """
        k = (2 * np.pi * self.frequency) ** 2 * (1 + 1j * _LOSS)
        law = receptances.laplace**2 * k / (receptances.laplace**2 + k)
        return effect_of_addition(receptances, self._direction, law, strengths)

    @property
    def _direction(self) -> Directions:
        return direction_of((parse_dof(self.where[0]), 1.0))

    def alike_by(self) -> tuple[Directions, tuple[object, ...]]:
        return self._direction, (self.kind, self.frequency, self.strengths.tobytes())

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that add the appendage to `model`: a new node, a mass there, and a spring to it, with three unknowns.

        These are the mass (kg; at a rotation the rotary inertia, kg m^2), which starts at `strength`, the stiffness of
        the spring, which starts where the appendage resonates at `self.frequency`, and its loss factor, which starts at
        0.03.
        """
        dof, label = parse_dof(self.where[0]), model.new_node()
        mass, spring = (model.unique_name(f"{words} {dof.place}") for words in ("appendage", "appendage spring"))
        if dof.is_rotation:
            size = "rotary_inertia"
            part = AddPart(size, {"name": mass, "nodes": [label], size: rounded(strength), "direction": dof.direction})
        else:
            size = "mass"
            along = {"directions": [dof.direction]}
            part = AddPart("point_mass", {"name": mass, "nodes": [label], size: rounded(strength), **along})
        stiffness = rounded(strength * (2 * np.pi * self.frequency) ** 2)
        ends = {"first": dof.place, "second": f"{label}{dof.direction}"}
        return [
            AddNode(label, dof.node),
            part,
            AddPart("spring", {"name": spring, **ends, "stiffness": stiffness, "loss_factor": _LOSS}),
            AddUnknown({"property": size, "elements": mass}),
            AddUnknown({"property": "stiffness", "elements": spring}),
            AddUnknown({"property": "loss_factor", "elements": spring}),
        ]

    def sentence(self, value: float | None) -> str:
        return f"a loose part or a cable resonates at {self.where[0]}"


def _frequencies(receptances: Receptances) -> list[float]:
    """Frequencies, Hz, ascending, at which an appendage may resonate: peaks of the misfit, and some over the band.

    These are the ten highest peaks of the misfit of the record over its lines, first and last line excluded, and ten
    frequencies in equal ratios from the lowest line above 0 Hz to the highest. `receptances` are those of the record.
    """
    problem = receptances.problem
    frequency = problem.frequency
    misfit = misfit_of_lines(problem, problem.data_rows(receptances.frf))
    inner = misfit[1:-1]
    peaks = 1 + np.flatnonzero((inner >= misfit[:-2]) & (inner >= misfit[2:]))
    best = peaks[np.argsort(-misfit[peaks])][:_MOST_FREQUENCIES]
    evenly = np.geomspace(frequency[frequency > 0][0], frequency[-1], _MOST_FREQUENCIES)
    every = np.unique(np.concatenate([frequency[best], evenly]))
    return every[every > 0].tolist()
