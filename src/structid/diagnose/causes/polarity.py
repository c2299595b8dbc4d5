"""A sensor or load has the opposite sense."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.causes.candidate import Candidate, channels, index_of
from structid.diagnose.effects import scaled_channel
from structid.diagnose.model_edits import Edits, renamed_channels
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorPolarity(Candidate):
    """A sensor that reads with the opposite sense; strength 1 reverses it."""

    kind: ClassVar[str] = "polarity"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for _, channel in channels(records, 1):
            yield cls(where=(channel.dof.place,), record=channel.record)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        factors = (1 - 2 * strengths)[:, None].astype(complex)
        return scaled_channel(receptances, 1, index_of(receptances, 1, self.where[0]), factors)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [renamed_channels(model, self.record or 0, {self.where[0]: f"{self.where[0]}-"})]

    def sentence(self, value: float | None) -> str:
        return f"sensor {self.where[0]} reads with the opposite sense"


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadPolarity(Candidate):
    """A load, one of several of its record, that acts with the opposite sense; strength 1 reverses it."""

    kind: ClassVar[str] = "load_polarity"
    result_kind: ClassVar[str] = "polarity"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for _, channel in channels(records, 2):
            if channel.n_alike > 1:
                yield cls(where=(channel.dof.place,), record=channel.record)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        factors = (1 - 2 * strengths)[:, None].astype(complex)
        return scaled_channel(receptances, 2, index_of(receptances, 2, self.where[0]), factors)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [renamed_channels(model, self.record or 0, {f"load {self.where[0]}": f"{self.where[0]}-"})]

    def sentence(self, value: float | None) -> str:
        return f"the force at {self.where[0]} acts with the opposite sense"
