"""Two sensors or two loads are exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.causes.candidate import Candidate, index_of
from structid.diagnose.model_edits import Edits, renamed_channels
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


def _effect(receptances: Receptances, axis: int, channel_names: Sequence[str], strengths: FloatArray) -> ComplexArray:
    """Changes of the FRF, (n_strengths, n_lines, n_outputs, n_inputs), by `strengths` times an exchange of two channels.

    The channels are the sensors (`axis` 1) or loads (`axis` 2) with the two `channel_names`.
    """
    i, k = (index_of(receptances, axis, place) for place in channel_names)
    order = np.arange(receptances.frf.shape[axis])
    order[[i, k]] = k, i
    change: ComplexArray = strengths[:, None, None, None] * (np.take(receptances.frf, order, axis) - receptances.frf)
    return change


@dataclass(frozen=True, eq=False, kw_only=True)
class SwappedSensors(Candidate):
    """Two sensors whose cables are exchanged; strength 1 is the exchange."""

    kind: ClassVar[str] = "swap"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for number, receptances in enumerate(records):
            for first, second in combinations(receptances.problem.record.outputs, 2):
                yield cls(where=(first.place, second.place), record=number)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 1, self.where, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        first, second = self.where
        return [renamed_channels(model, self.record or 0, {first: second, second: first})]

    def sentence(self, value: float | None) -> str:
        return f"the cables of {' and '.join(self.where)} are exchanged"


@dataclass(frozen=True, eq=False, kw_only=True)
class SwappedLoads(Candidate):
    """Two loads that are exchanged; strength 1 is the exchange."""

    kind: ClassVar[str] = "load_swap"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for number, receptances in enumerate(records):
            for first, second in combinations(receptances.problem.record.inputs, 2):
                yield cls(where=(first.place, second.place), record=number)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 2, self.where, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        first, second = self.where
        return [renamed_channels(model, self.record or 0, {f"load {first}": second, f"load {second}": first})]

    def sentence(self, value: float | None) -> str:
        return f"the forces at {' and '.join(self.where)} are exchanged"
