"""The ``[record.time]`` of a study file: time histories that are fitted themselves, not through averaged FRFs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.identification.setups.time import TimeFit
from structid.records import TimeRecord
from structid.study.schema.kinds import NUMBERS, as_list
from structid.study.schema.section import Section
from structid.study.schema.tables import Key, table_of

TIME = table_of(TimeFit) | {
    "noise": Key(NUMBERS, "Standard deviation of each channel of the file, or of all, in SI units"),
    "relative_noise": Key(NUMBERS, "The same in parts of the channel's rms; both are added in quadrature"),
}
_OF_SPECTRA, _OF_TIME = ("transient", "tones"), ("initial",)


@dataclass(frozen=True, eq=False)
class TimeSource:
    """How the time record of a study is fitted, and how noisy its channels are.

    Attributes
    ----------
    section : Section
        ``[record.time]``, for the place of errors.
    noise, relative_noise : tuple of float
        Standard deviation of each channel (or of all) in SI units, and in parts of the channel's rms.
    settings : TimeFit
    """

    section: Section
    noise: tuple[float, ...]
    relative_noise: tuple[float, ...]
    settings: TimeFit

    def with_noise(self, records: Sequence[TimeRecord]) -> TimeRecord:
        """The time record with the variance of each channel from the stated noise.

        Raises
        ------
        StudyError
            If there are repeats, or the noise is not known.
        """
        if len(records) > 1:
            raise self.section.error("takes one time record; give each of the repeats a [[record]] of its own")
        record = records[0]
        with self.section.located("tones"):
            self.settings.require_heard(record)
        with self.section.located("noise"):
            absolute = _each("noise", self.noise, record)
        with self.section.located("relative_noise"):
            relative = _each("relative_noise", self.relative_noise, record)
        variance = absolute**2 + (relative * np.sqrt((record.values**2).mean(axis=0))) ** 2
        if variance.any():
            record = replace(record, variance=variance)
        if record.variance is None:
            raise self.section.error(
                "needs the noise of the channels: `noise` (standard deviations, SI units) or `relative_noise` (parts of"
                " the rms), one number for all or one a channel"
            )
        return record


def _each(name: str, given: tuple[float, ...], record: TimeRecord) -> FloatArray:
    """One value for each channel from the list `given`: one for all, or one each; 0 if it is empty."""
    count = len(record.channels)
    if len(given) not in (0, 1, count):
        raise InputError(f"`{name}` must be one number or {count}, one for each channel, got {len(given)}")
    values = np.broadcast_to(np.asarray(given or (0.0,), dtype=np.float64), (count,))
    if (values < 0).any():
        i = int(np.argmax(values < 0))
        raise InputError(f"`{name}` must not be negative, got {values[i]:g} for channel {i + 1} ({record.channels[i]})")
    return values


def read_time(section: Section) -> TimeSource:
    """The settings in ``[record.time]``."""
    values = section.values(TIME)
    fit = values.get("fit", "spectra")
    for key in _OF_TIME if fit == "spectra" else _OF_SPECTRA:
        if key in values:
            raise section.error(f"fit = {fit!r} does not use it; leave it out", key)
    lists = ("noise", "relative_noise", "tones")
    noise, relative, tones = (tuple(map(float, as_list(values.pop(key, [])))) for key in lists)
    with section.located("hold"):
        settings = TimeFit(**values, tones=tones)
    return TimeSource(section, noise, relative, settings)
