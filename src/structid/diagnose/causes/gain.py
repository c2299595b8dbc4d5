"""The calibration or the unit of a sensor or load is off."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import parse_dof
from structid.core.units import MISTAKEN_FORCES, mistaken_motions, mistaken_unit
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.channels import FACTORS, channels, index_of
from structid.diagnose.effects import scaled_channel
from structid.diagnose.model_edits import AddChannelError, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel

#: Difference of a gain's logarithm from that of another unit within which it is taken for it.
_UNIT = 0.05
#: Logarithm of a gain that a linear look may ask for, at most; factor by which a calibration may be off.
_LARGEST_LOG, MOST_GAIN = 20.0, 30.0


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorGain(Candidate):
    """A sensor that reads too much or too little; the strength is the logarithm of its gain."""

    kind: ClassVar[str] = "sensor_gain"
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate gains, as logarithms, of each sensor in records of several: errors of calibration and mistaken units."""
        for _, channel in channels(records, 1):
            if channel.n_alike > 1:
                logs = _log_gains(mistaken_motions(channel.dof.is_rotation))
                yield cls(where=(channel.dof.place,), record=channel.record, strengths=logs)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        index = index_of(receptances, 1, self.where[0])
        return scaled_channel(receptances, 1, index, np.exp(strengths)[:, None].astype(complex))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        start = rounded(float(np.exp(np.clip(strength, -_LARGEST_LOG, _LARGEST_LOG))))
        entry = {"property": "gain", "outputs": list(self.where), "start": start}
        return [AddChannelError(self.record or 0, entry)]

    def mistaken_unit(self, gain: float | None) -> str:
        """The unit, in words, that a sensor with the factor `gain` was read in by mistake; "" where none fits within 5 %."""
        return _unit_of_motion(self.where[0], gain)

    def named_kind(self, value: float | None) -> str:
        return "unit" if self.mistaken_unit(value) else self.kind

    def sentence(self, value: float | None) -> str:
        return gain_sentence(f"sensor {self.where[0]}", self.mistaken_unit(value), value)


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadGain(Candidate):
    """A load, or the motion of a support, that reads too much or too little; the strength is minus the logarithm of its gain.

    `is_motion` of a support that drives the structure, and `is_alone` where nothing else drives it.
    """

    kind: ClassVar[str] = "load_gain"
    begins_at_start: ClassVar[bool] = True
    record: int | None = 0
    is_motion: bool = False
    is_alone: bool = False

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate gains, as logarithms, of each load or driven support: errors of calibration and mistaken units."""
        for receptances, channel in channels(records, 2):
            is_motion = receptances.problem.record.is_per_motion
            table = mistaken_motions(channel.dof.is_rotation) if is_motion else MISTAKEN_FORCES
            yield cls(
                where=(channel.dof.place,),
                record=channel.record,
                strengths=_log_gains(table),
                is_motion=is_motion,
                is_alone=channel.n_alike == 1,
            )

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        index = index_of(receptances, 2, self.where[0])
        return scaled_channel(receptances, 2, index, np.exp(strengths)[:, None].astype(complex))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        start = rounded(float(1 / np.exp(np.clip(strength, -_LARGEST_LOG, _LARGEST_LOG))))
        return [AddChannelError(self.record or 0, {"property": "gain", "inputs": list(self.where), "start": start})]

    def mistaken_unit(self, gain: float | None) -> str:
        """The unit, in words, that a load with the factor `gain` was read in by mistake; "" where none fits within 5 %.

        For a force it is the inverse of `gain` that is compared with factors of units.
        """
        if self.is_motion:
            return _unit_of_motion(self.where[0], gain)
        return "" if gain is None or gain <= 0 else mistaken_unit(-math.log(gain), MISTAKEN_FORCES, _UNIT)

    def named_kind(self, value: float | None) -> str:
        return "unit" if self.mistaken_unit(value) else self.kind

    def sentence(self, value: float | None) -> str:
        """A clause that names the load or support and its gain `value`; without a number if it is None."""
        if not self.is_motion:
            return gain_sentence(f"the force at {self.where[0]}", self.mistaken_unit(value), value)
        sentence = gain_sentence(f"the motion of support {self.where[0]}", self.mistaken_unit(value), value)
        return sentence + (", or all sensors are off the other way round" if self.is_alone else "")


def _log_gains(units: Sequence[tuple[float, str, str]]) -> FloatArray:
    """Logarithms of gains to look at, (n_gains,): errors of calibration and the factors of mistaken `units`, either way."""
    factors = np.log([factor for factor, _, _ in units])
    return np.concatenate([FACTORS, -FACTORS, factors, -factors])


def _unit_of_motion(place: str, gain: float | None) -> str:
    """The unit, in words, that the motion at `place` was read in by mistake; "" where none has the factor `gain`."""
    if gain is None or gain <= 0:
        return ""
    return mistaken_unit(math.log(gain), mistaken_motions(parse_dof(place).is_rotation), _UNIT)


def gain_sentence(channel: str, unit: str, gain: float | None) -> str:
    """A clause that the channel is in another `unit`, or, where that is "", that its calibration is off by the factor `gain`.

    Without a number if `gain` is None.
    """
    if unit:
        return f"{channel} is in another unit than stated: {unit}"
    return f"the calibration of {channel} is off" + ("" if gain is None else f" by a factor of {gain:.4g}")
