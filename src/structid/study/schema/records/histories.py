"""Time histories in a study file: ``[record.frf]`` makes FRFs of them, ``[record.time]`` says how they are fitted themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.constraints import Limits
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.identification.setups.time import TimeFit
from structid.records import FrfRecord, TimeRecord
from structid.records.record import LOADS
from structid.records.spectra import frf_from_time, require_repeated
from structid.study.schema.section import Section
from structid.study.schema.tables import (
    COUNT,
    NUMBER,
    NUMBERS,
    TEXT,
    TEXTS,
    Given,
    Key,
    Kind,
    as_list,
    choice,
    limit_kind,
    table_of,
)

_MOTIONS = ("displacement", "velocity", "acceleration")
_WINDOW = Kind(
    'a window of scipy.signal.get_window, as in "hann" or ["exponential", 0.0, 200.0]',
    {"anyOf": [TEXT.schema, {"type": "array", "minItems": 1, "items": {"anyOf": [TEXT.schema, NUMBER.schema]}}]},
    lambda value: isinstance(value[0], str),
    lambda value: tuple(value) if isinstance(value, list) else value,
)
FRF = table_of(
    frf_from_time,
    ("records", "inputs", "outputs"),
    overlap=limit_kind(NUMBER, Limits(least=0, below=1)),
    segment_length=COUNT,
    window=_WINDOW,
    quantity=choice(*_MOTIONS),
) | {
    "inputs": Key(TEXTS, "Force channels; all that the record has by default"),
    "outputs": Key(TEXTS, "Motion channels; all by default"),
}
TIME = table_of(TimeFit) | {
    "noise": Key(NUMBERS, "Standard deviation of each channel of the file, or of all, in SI units"),
    "relative_noise": Key(NUMBERS, "The same in parts of the channel's rms; both are added in quadrature"),
}
_OF_SPECTRA, _OF_TIME = ("transient", "tones"), ("initial",)


@dataclass(frozen=True, eq=False)
class FrfSettings:
    """Arguments of `frf_from_time`.

    Attributes
    ----------
    section : Section
        ``[record.frf]``, for the place of errors.
    inputs, outputs : tuple of Dof
        Force and motion channels; all that the record has if empty.
    others : dict
        The other arguments, by name.
    """

    section: Section
    inputs: tuple[Dof, ...]
    outputs: tuple[Dof, ...]
    others: Given


def read_frf(section: Section, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> FrfSettings:
    """The settings in ``[record.frf]`` for averaging spectra.

    `inputs` and `outputs` of ``[record]``, as texts, are the defaults of its channels.
    """
    values = section.values(FRF)
    channels = {}
    for key, outer in (("inputs", inputs), ("outputs", outputs)):
        with section.located(key):
            channels[key] = parse_dofs(as_list(values.pop(key, list(outer))))
    return FrfSettings(section, channels["inputs"], channels["outputs"], values)


def spectral_frf(records: Sequence[TimeRecord], settings: FrfSettings) -> FrfRecord:
    """FRFs from averaged spectra of one time record, or of repeats.

    Without channels in `settings`, the inputs are all force channels and the outputs all motions, or those of the
    stated quantity.

    Raises
    ------
    StudyError
        If channels are missing or the settings do not fit the record.
    """
    require_repeated(records)
    with settings.section.located():
        inputs = settings.inputs or _channels(records[0], LOADS)
        if not inputs:
            raise InputError(
                "the record has no force channel; say which channel is the load with `units` or `quantities`"
            )
        wanted = settings.others.get("quantity")
        motions = (wanted,) if wanted else _MOTIONS
        outputs = settings.outputs or _channels(records[0], motions)
        if wanted and not outputs:
            available = ", ".join(dict.fromkeys(records[0].quantities))
            raise InputError(f"no channel of the record is of {wanted}; they are of {available}", "quantity")
        return frf_from_time(records, inputs, outputs, **settings.others)


def _channels(record: TimeRecord, quantities: tuple[str, ...]) -> tuple[Dof, ...]:
    pairs = zip(record.channels, record.quantities, strict=True)
    return tuple(dict.fromkeys(dof for dof, quantity in pairs if quantity in quantities))


@dataclass(frozen=True, eq=False)
class TimeSource:
    """Options of the fit of a study's time record, and the noise of its channels.

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

        The noise is absolute, relative to the channel's rms, or both, added as squares. `records` must hold one record;
        a variance that it has is kept if no noise is stated.

        Raises
        ------
        StudyError
            If there are repeats, the noise is not known, all samples are 0, or the record does not reach a stated tone.
        """
        if len(records) > 1:
            raise self.section.error("takes one time record; give each of the repeats a [[record]] of its own")
        record = records[0]
        with self.section.located("tones"):
            self.settings.require_heard(record)
        with self.section.located("noise"):
            absolute = _value_of_each_channel("noise", self.noise, record)
        with self.section.located("relative_noise"):
            relative = _value_of_each_channel("relative_noise", self.relative_noise, record)
        variance = absolute**2 + (relative * np.sqrt((record.values**2).mean(axis=0))) ** 2
        if variance.any():
            record = replace(record, variance=variance)
        if record.variance is None and not record.values.any():
            raise self.section.error("the record is 0 at every sample of every channel: check its file and channels")
        if record.variance is None:
            raise self.section.error(
                "needs the noise of the channels: `noise` (standard deviations, SI units) or `relative_noise` (parts of"
                " the rms), one number for all or one a channel"
            )
        return record


def _value_of_each_channel(name: str, numbers: tuple[float, ...], record: TimeRecord) -> FloatArray:
    """Value of each channel, (n_channels,), from `numbers`: one for all, or one each; zeros if it is empty.

    `InputError` names the key `name` if the count is wrong or a number is negative.
    """
    count = len(record.channels)
    if len(numbers) not in (0, 1, count):
        raise InputError(f"`{name}` must be one number or {count}, one for each channel, got {len(numbers)}")
    values = np.broadcast_to(np.asarray(numbers or (0.0,), dtype=np.float64), (count,))
    if (values < 0).any():
        i = int(np.argmax(values < 0))
        raise InputError(f"`{name}` must not be negative, got {values[i]:g} for channel {i + 1} ({record.channels[i]})")
    return values


def read_time(section: Section) -> TimeSource:
    """The settings in ``[record.time]``: noise and relative noise of the channels, and the options of the fit.

    The fit is of spectra unless ``fit`` says otherwise; `StudyError` for a key that the stated ``fit`` does not use.
    """
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
