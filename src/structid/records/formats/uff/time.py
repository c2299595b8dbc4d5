"""Time responses of a universal file, as one record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError, about
from structid.core.units import parse_unit
from structid.files.uff.datasets import UnitFactors
from structid.files.uff.geometry import UniversalNodes
from structid.records.formats.bare import channel_units
from structid.records.formats.clocks import SURE, even_rate, resample, resampling_remedy
from structid.records.formats.gaps import source_with_note, whole
from structid.records.formats.headers import states_unit
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import positions
from structid.records.formats.uff.channels import SI_UNITS, channel_scale, dof_of, in_global_axes
from structid.records.formats.uff.functions import Dataset58, one_axis_unit
from structid.records.record import Quantity, TimeRecord

#: Difference allowed between a step of six digits, as the format stores it, and the true one.
_SIX_DIGITS = 1e-5


def read_times(
    path: Path,
    times: Sequence[Dataset58],
    factors: UnitFactors | None,
    nodes: UniversalNodes | None,
    options: ReadOptions,
) -> TimeRecord:
    """The time record made of the functions `times`, or of the channels among them that `options` name.

    The format stores an even step with six digits only: `options.sampling_rate` may state it exactly.

    Parameters
    ----------
    path : Path
        File, for messages and for the record's source.
    times : sequence of Dataset58
        Time responses.
    factors : UnitFactors, optional
        Unit factors of dataset 164.
    nodes : UniversalNodes, optional
        Nodes whose local axes name the channels; None if their names are taken as they are.
    options : ReadOptions

    Raises
    ------
    FileError
        If lengths, starts or steps differ, times are uneven and not to be resampled, or nothing states a unit.
    InputError
        If `options` contradict the file.
    """
    times, channels, is_named = _choose_functions(path, times, options)
    for dof, function in zip(channels, times, strict=True):
        if np.iscomplexobj(function.values):
            raise FileError(f"{path}: the time history of {dof} has complex samples; export real ones")
    to_seconds, axis_words = one_axis_unit(path, list(times), "times", options)
    clocks = [function.axis * to_seconds for function in times]
    _require_one_clock(path, channels, clocks)
    quantities, scale = _quantities_and_factors(path, times, channels, factors, options)
    values = np.stack([np.asarray(function.values, float) for function in times], axis=1)
    rate, start, values, clock_words = _even_samples(path, times[0], clocks[0], to_seconds, values, options)
    kept = whole(path, values, channels, rate, start, options, named=False)
    values, turned_words = kept.values * scale, ""
    if nodes is not None and not is_named:
        turned = in_global_axes(path, nodes, channels, quantities)
        channels, turned_words = turned.dofs, turned.words
        values = values if turned.matrix is None else values @ turned.matrix.T
    _require_distinct(path, times, channels, quantities)
    words = (_unit_words(times, options), axis_words, clock_words, turned_words, kept.note)
    return TimeRecord(
        sampling_rate=rate,
        values=values,
        channels=channels,
        quantities=quantities,
        start=kept.start,
        source=source_with_note(path, "; ".join(filter(None, words))),
    )


def _choose_functions(
    path: Path, times: Sequence[Dataset58], options: ReadOptions
) -> tuple[Sequence[Dataset58], tuple[Dof, ...], bool]:
    """Functions to read, their channels, and True if `options.channels` names them instead of choosing them.

    `times` are all time responses of the file, or those that `options.columns` chose: then `channels` names them one by
    one. Without `columns`, `channels` chooses among the file's names, in the order of the option, each with all of its
    quantities; all are read without `channels`. Raises `InputError` if numbers differ or a channel is missing.
    """
    if options.columns and options.channels:
        with about("channels"):
            channels = parse_dofs(options.channels)
        if len(channels) != len(times):
            raise InputError(
                f"{path}: `channels` must have {len(times)} entries, one for each of the functions chosen by `columns`, got"
                f" {len(channels)}",
                "channels",
            )
        return times, channels, True
    if not options.channels:
        return times, tuple(dof_of(path, f.response, "response", f.ordinal) for f in times), False
    whole_dofs = [f for f in times if f.response[1] != 0]
    present = tuple(dof_of(path, f.response, "response", f.ordinal) for f in whole_dofs)
    wanted = [present[i] for i in positions(path, "channels", options.channels, present)]
    pairs = [
        (f, dof) for name in dict.fromkeys(wanted) for f, dof in zip(whole_dofs, present, strict=True) if dof == name
    ]
    return [f for f, _ in pairs], tuple(dof for _, dof in pairs), False


def _require_distinct(
    path: Path, times: Sequence[Dataset58], channels: tuple[Dof, ...], quantities: tuple[Quantity, ...]
) -> None:
    """Raise `FileError` if two of the functions `times` have the same channel and quantity.

    `channels` and `quantities` are those of the functions, in their order.
    """
    seen: dict[tuple[Dof, Quantity], Dataset58] = {}
    for function, dof, quantity in zip(times, channels, quantities, strict=True):
        other = seen.setdefault((dof, quantity), function)
        if other is not function:
            raise FileError(
                f"{path}: functions {other.ordinal} and {function.ordinal} are both the {quantity} at {dof}; choose functions by"
                " their numbers with `columns`, and say by `channels` what they are"
            )


def _unit_words(times: Sequence[Dataset58], options: ReadOptions) -> str:
    """Note on the units of the channels: those of `options.units`, and labels that differ, or else labels not in SI.

    It is "" if the option is not set and all labels are SI. `times` are the functions that were read.
    """
    labels = dict.fromkeys(function.ordinate.label for function in times)
    if options.units:
        several = options.units if len(options.units) == len(times) else options.units[:1] * len(times)
        pairs = dict.fromkeys((function.ordinate.label, unit) for function, unit in zip(times, several, strict=True))
        stated = ", ".join(
            dict.fromkeys(label for label, unit in pairs if label and not states_unit(label, unit, parse_unit))
        )
        beside = f", though the file says {stated}" if stated else ""
        return f"units {', '.join(dict.fromkeys(options.units))} as given{beside}"
    return f"units {', '.join(labels)}" if set(labels) - SI_UNITS else ""


def _require_one_clock(path: Path, channels: tuple[Dof, ...], clocks: Sequence[FloatArray]) -> None:
    """Raise `FileError` if one of `channels` has other sample times than the first; `clocks` are the times (n_times,) in s."""
    first = clocks[0]
    allowed = 0.01 * abs(first[-1] - first[0]) / max(first.size - 1, 1)
    for dof, axis in zip(channels, clocks, strict=True):
        if axis.shape != first.shape or np.abs(axis - first).max() > allowed:
            raise FileError(
                f"{path}: channel {dof} runs on another clock than channel {channels[0]}: {_clock(axis)} against "
                f"{_clock(first)}; export all with one setting, or read those of one clock from a file of their own, bring "
                "them to one rate with `prepare`, and join them"
            )


def _clock(axis: FloatArray) -> str:
    step = (axis[-1] - axis[0]) / (axis.size - 1) if axis.size > 1 else 0.0
    return f"{axis.size} samples every {step:.6g} s from {axis[0]:.6g} s on" if axis.size else "no samples"


def _quantities_and_factors(
    path: Path,
    times: Sequence[Dataset58],
    channels: tuple[Dof, ...],
    factors: UnitFactors | None,
    options: ReadOptions,
) -> tuple[tuple[Quantity, ...], FloatArray]:
    """Quantities of the channels and their factors to SI, (n_channels,), from `options.units`, or from the file.

    `times` are the functions, one for each of `channels`; `factors` are those of dataset 164, None without. Raises
    `FileError` if neither option nor file states a unit, `InputError` if `options.quantities` contradicts the file.
    """
    if options.units:
        return channel_units(path, channels, options)
    pairs = [
        channel_scale(path, function.ordinate, dof, factors, "units")
        for dof, function in zip(channels, times, strict=True)
    ]
    quantities = tuple(cast(Quantity, quantity) for quantity, _ in pairs)
    if options.quantities and options.quantities not in (quantities, tuple(dict.fromkeys(quantities))):
        raise InputError(
            f"{path}: says quantities {', '.join(quantities)}, but `quantities` {', '.join(options.quantities)} was given; leave"
            " the option out",
            "quantities",
        )
    return quantities, np.array([factor for _, factor in pairs])


def _even_samples(
    path: Path, function: Dataset58, time: FloatArray, to_seconds: float, values: FloatArray, options: ReadOptions
) -> tuple[float, float, FloatArray, str]:
    """Sampling rate (Hz), first time (s), even samples (n_times, n_channels), note on the clock ("" if plainly even).

    `time` (n_times,) is in s, `values` (n_times, n_channels) are the samples as read, `to_seconds` is the factor from
    the abscissa of `function` to s. `options.sampling_rate` replaces the rate of even times; `InputError` if it
    contradicts them. `options.resample` lets uneven ones be resampled, else `FileError`, as for a rate that rounding
    leaves too vague.
    """
    step = float(time[-1] - time[0]) / max(time.size - 1, 1)
    if step <= 0:
        raise FileError(f"{path}: the time step is {step:g} s; it must be positive, set it in the export")
    if function.is_even:
        return _checked_rate(path, 1 / step, _SIX_DIGITS, options), float(time[0]), values, ""
    even = even_rate(time, function.digits * to_seconds)
    if even is None:
        if options.resample:
            resampled = resample(path, time, values, options.sampling_rate)
            return resampled.rate, resampled.start, resampled.values, resampled.words
        off = float(np.abs(np.diff(time) - step).max())
        raise FileError(
            f"{path}: sample times are not even: a step differs from the mean of {step:.6g} s by {off:.2g} s; {resampling_remedy()}"
        )
    if even.error > SURE and options.sampling_rate is None:
        raise FileError(
            f"{path}: sample times are rounded to {even.digit:g} s, so that they tell the sampling rate {even.rate:.6g} Hz to"
            f" {100 * even.error:.2g} % only; give {option_words(sampling_rate=None)}"
        )
    words = f"times rounded to {even.digit:g} s" if even.error else ""
    return _checked_rate(path, even.rate, max(even.error, _SIX_DIGITS), options), float(time[0]), values, words


def _checked_rate(path: Path, rate: float, error: float, options: ReadOptions) -> float:
    """The option `sampling_rate` in Hz if set, else `rate`; `InputError` if they differ by more than the relative `error`."""
    if options.sampling_rate is None:
        return rate
    if abs(options.sampling_rate / rate - 1) > error:
        raise InputError(
            f"{path}: is sampled at {rate:g} Hz, but `sampling_rate` {options.sampling_rate:g} was given; leave it out"
        )
    return options.sampling_rate
