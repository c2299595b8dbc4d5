"""A sensor or load is late or early, or several sensors of one card are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.diagnose.causes.candidate import FACTORS, Candidate, channels, index_of
from structid.diagnose.effects import scaled_channel
from structid.diagnose.model_edits import AddChannelError, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


def _delays(receptances: Receptances) -> FloatArray:
    """Delays that are tried, s, (16,): those that turn the highest line by 0.01 to 2 rad, late and early."""
    return np.concatenate([sign * FACTORS / (np.pi * receptances.problem.record.frequency[-1]) for sign in (1, -1)])


def _effect(
    receptances: Receptances, axis: Literal[1, 2], channel_names: Sequence[str], delays: FloatArray
) -> ComplexArray:
    """Changes (n_delays, n_lines, n_outputs, n_inputs) of FRFs by phases as of each of `delays`, s, at some channels.

    `channel_names` are degrees of freedom such as ``3X``: outputs for `axis` 1, which are late by it, or inputs for 2,
    whose measurement is early by it.
    """
    factors = np.exp(-receptances.laplace * delays[:, None])
    indices = [index_of(receptances, axis, place) for place in channel_names]
    return np.sum([scaled_channel(receptances, axis, index, factors) for index in indices], axis=0)


def _late_or_early(delay: float | None) -> str:
    """``late``, or ``early`` for a negative delay; both where it is not known."""
    if delay is None:
        return "late or early"
    return "early" if delay < 0 else "late"


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorDelay(Candidate):
    """A sensor, or several by one time, that is late, or early if the strength, the time in s, is negative."""

    kind: ClassVar[str] = "delay"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for receptances, channel in channels(records, 1):
            yield cls(where=(channel.dof.place,), record=channel.record, strengths=_delays(receptances))

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 1, self.where, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        entry = {"property": "delay", "outputs": list(self.where), "start": rounded(strength)}
        return [AddChannelError(self.record or 0, entry)]

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"sensors {join_words(self.where)} are {_late_or_early(value)} by one time, as of one card"
        return f"sensor {self.where[0]} is {_late_or_early(value)}"


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadDelay(Candidate):
    """A load whose measurement is early, or late if the strength, the time in s, is negative."""

    kind: ClassVar[str] = "load_delay"
    result_kind: ClassVar[str] = "delay"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for receptances, channel in channels(records, 2):
            yield cls(where=(channel.dof.place,), record=channel.record, strengths=_delays(receptances))

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 2, self.where, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        entry = {"property": "delay", "inputs": list(self.where), "start": rounded(-strength)}
        return [AddChannelError(self.record or 0, entry)]

    def sentence(self, value: float | None) -> str:
        return f"the force at {self.where[0]} is {_late_or_early(value)}"
