"""The calibration or the unit of a sensor or load, or of all sensors of a record, is off."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import parse_dof
from structid.core.errors import InputError
from structid.core.units import MISTAKEN_FORCES, mistaken_motions, mistaken_unit
from structid.diagnose.causes.candidate import FACTORS, Candidate, channels, index_of
from structid.diagnose.effects import scaled_channel
from structid.diagnose.model_edits import AddChannelError, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.records import FrfRecord, TimeRecord

#: Difference of a gain's logarithm from that of another unit within which it is taken for it.
_UNIT = 0.05
#: Logarithm of a gain that a linear look may ask for, at most; factor by which a calibration may be off.
_LARGEST_LOG, MOST_GAIN = 20.0, 30.0
_ALL_SENSORS = "all sensors"


@dataclass(frozen=True, eq=False, kw_only=True)
class Gain(Candidate):
    """One gain of channels of a record, which a calibration that is off gives, or a unit that was read by mistake."""

    record: int | None = 0

    @abstractmethod
    def mistaken_unit(self, gain: float | None) -> str:
        """The unit, in words, that channels with the factor `gain` were read in by mistake; "" where none fits within 5 %."""

    def named_kind(self, value: float | None) -> str:
        return "unit" if self.mistaken_unit(value) else self.kind


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorGain(Gain):
    """A sensor that reads too much or too little; the strength is the logarithm of its gain."""

    kind: ClassVar[str] = "sensor_gain"

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """A candidate gain for each sensor of a record with several: an error of calibration or a mistaken unit.

        Strengths are logarithms of gains, among them those of mistaken units of motion. `records` are the receptances
        of each record; `record_names` are not used.
        """
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
        return _unit_of_motion(gain, parse_dof(self.where[0]).is_rotation)

    def sentence(self, value: float | None) -> str:
        return gain_sentence(f"sensor {self.where[0]}", self.mistaken_unit(value), value)


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadGain(Gain):
    """A load, or the motion of a support, that reads too much or too little; the strength is minus the logarithm of its gain.

    `is_motion` of a support that drives the structure, and `is_alone` where nothing else drives it.
    """

    kind: ClassVar[str] = "load_gain"
    begins_at_start: ClassVar[bool] = True
    is_motion: bool = False
    is_alone: bool = False

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """A candidate gain for each load or driven support, also a single one: calibration error or mistaken unit.

        Strengths are logarithms of gains, among them those of mistaken units of force, or of motion for a support.
        `records` are the receptances of each record; `record_names` are not used.
        """
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
            return _unit_of_motion(gain, parse_dof(self.where[0]).is_rotation)
        return "" if gain is None or gain <= 0 else _unit_of_force(1 / gain)

    def sentence(self, value: float | None) -> str:
        """A clause that names the load or support and its gain `value`; without a number if it is None."""
        if not self.is_motion:
            return gain_sentence(f"the force at {self.where[0]}", self.mistaken_unit(value), value)
        sentence = gain_sentence(f"the motion of support {self.where[0]}", self.mistaken_unit(value), value)
        return sentence + (", or all sensors are off the other way round" if self.is_alone else "")


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordGain(Gain):
    """All sensors of a record that read too much or too little by one factor; the strength is the logarithm of this.

    Responses do not distinguish it from the inverse factor on all loads. With one load that is `LoadGain`.

    Attributes
    ----------
    are_rotations : tuple of bool
        True for sensors of rotations, False for those of translations; both where the record has both.
    sensor : str
        The only sensor of the record; "" where there are several.
    record_name : str
        Name of the record where there are several; else "".
    """

    kind: ClassVar[str] = "record_gain"
    begins_at_start: ClassVar[bool] = True
    are_rotations: tuple[bool, ...] = (False,)
    sensor: str = ""
    record_name: str = ""

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate gains, as logarithms, that all sensors of a record share, one for each record of several loads.

        Records per motion of a support have none. `records` are the receptances of each record; its name of
        `record_names` is stated where there are several.
        """
        for number, receptances in enumerate(records):
            record = receptances.problem.record
            if len(record.inputs) < 2 or record.is_per_motion:
                continue
            name = record_names[number] if len(records) > 1 and len(record_names) == len(records) else ""
            are_rotations = tuple(sorted({dof.is_rotation for dof in record.outputs}))
            sensor = record.outputs[0].place if len(record.outputs) == 1 else ""
            yield cls(
                where=(sensor or _ALL_SENSORS, *([name] if name else [])),
                record=number,
                strengths=_log_gains([*chain.from_iterable(map(mistaken_motions, are_rotations)), *MISTAKEN_FORCES]),
                are_rotations=are_rotations,
                sensor=sensor,
                record_name=name,
            )

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        change: ComplexArray = np.expm1(strengths)[:, None, None, None] * receptances.frf
        return change

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edit that makes the gain an unknown of the record, started at exp(`strength`) with `strength` within +-20.

        Raises
        ------
        InputError
            If the record is of modes, whose shapes have no scale.
        """
        if not isinstance(model.setups[self.record or 0].record, FrfRecord | TimeRecord):
            raise InputError("modes do not show a gain that all sensors share")
        start = rounded(float(np.exp(np.clip(strength, -_LARGEST_LOG, _LARGEST_LOG))))
        name = " of ".join(self.where)
        return [AddChannelError(self.record or 0, {"property": "gain", "outputs": "all", "start": start, "name": name})]

    def mistaken_unit(self, gain: float | None) -> str:
        """The units, in words, that all sensors or loads were read in by mistake; "" where none fits `gain` to 5 %.

        Also "" for None and for a gain that is not positive. A factor such as 9.80665 is that of a unit of motion and
        of one of force: both are named.
        """
        if gain is None or gain <= 0:
            return ""
        of_motion = _unit_of_motion(gain, *self.are_rotations) if len(self.are_rotations) == 1 else ""
        of_force = _unit_of_force(gain)
        sensors = f"sensor {self.sensor} is" if self.sensor else f"{_ALL_SENSORS} are"
        if not of_motion:
            return of_force and f"all loads are in another unit than stated: {of_force}"
        return f"{sensors} in another unit than stated: {of_motion}" + (of_force and f", or all loads {of_force}")

    def sentence(self, value: float | None) -> str:
        """A clause that names the mistaken unit of all sensors or loads that the gain `value` fits, or states the gain.

        The record is named where there are several. None for `value` leaves numbers and units out.
        """
        words = self.mistaken_unit(value)
        if not words:
            inverse = "" if value is None or value <= 0 else f" by {1 / value:.4g}"
            sensors = f"sensor {self.sensor}" if self.sensor else _ALL_SENSORS
            words = f"{gain_sentence(sensors, '', value)}, or that of all loads{inverse}"
        return words + (f" in record {self.record_name}" if self.record_name else "")


def _log_gains(units: Sequence[tuple[float, str, str]]) -> FloatArray:
    """Logarithms (n_gains,) of gains to screen: errors of calibration and the factors of mistaken `units`, either way.

    A unit is (factor, true unit, assumed unit), of which the factor counts.
    """
    factors = np.log([factor for factor, _, _ in units])
    return np.concatenate([FACTORS, -FACTORS, factors, -factors])


def _unit_of_motion(gain: float | None, is_rotation: bool) -> str:
    """The unit, in words, that a motion was read in by mistake; "" where none has the factor `gain`."""
    if gain is None or gain <= 0:
        return ""
    return mistaken_unit(math.log(gain), mistaken_motions(is_rotation), _UNIT)


def _unit_of_force(size: float) -> str:
    """The unit, in words, that a force `size` times what its record says was read in by mistake; "" where none fits."""
    return "" if size <= 0 else mistaken_unit(math.log(size), MISTAKEN_FORCES, _UNIT)


def gain_sentence(channel: str, unit: str, gain: float | None) -> str:
    """A clause that the channel is in another `unit`, or, where that is "", that its calibration is off by the factor `gain`.

    Without a number if `gain` is None.
    """
    if unit:
        return f"{channel} is in another unit than stated: {unit}"
    return f"the calibration of {channel} is off" + ("" if gain is None else f" by a factor of {gain:.4g}")
