"""Time responses of a universal file, as one record."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import FileError, InputError
from structid.records.formats.bare import channel_units
from structid.records.formats.gaps import sourced, whole
from structid.records.formats.options import ReadOptions
from structid.records.formats.uff.blocks import Dataset
from structid.records.formats.uff.scales import channel_scale, dof_of, sides, unit_factors
from structid.records.record import Quantity, TimeRecord

#: Difference allowed between a step of six digits, as the format stores it, and the true one.
_SIX_DIGITS = 1e-5


def read_times(path: Path, found: list[Dataset], times: list[Dataset], options: ReadOptions) -> TimeRecord:
    """One record of the time responses `times`.

    The format stores an even step with six digits only: `options.sampling_rate` may state it exactly.

    Raises
    ------
    FileError
        If lengths, start or steps differ, or a step is not even.
    """
    channels = tuple(dof_of(path, int(d["rsp_node"]), int(d["rsp_dir"]), "response") for d in times)
    for dof, dataset in zip(channels, times, strict=True):
        if np.iscomplexobj(dataset["data"]):
            raise FileError(f"{path}: the time history of {dof} has complex samples; export real ones")
    _require_one_clock(path, channels, times)
    quantities, factors = _scales(path, found, times, channels, options)
    rate, start = _rate(path, times[0], options), float(np.asarray(times[0]["x"], float)[0])
    values = np.stack([np.asarray(d["data"], float) for d in times], axis=1)
    kept = whole(path, values, channels, rate, start, options)
    return TimeRecord(
        sampling_rate=rate,
        values=kept.values * factors,
        channels=channels,
        quantities=quantities,
        start=kept.start,
        source=sourced(path, kept.note),
    )


def _require_one_clock(path: Path, channels: tuple[Dof, ...], times: list[Dataset]) -> None:
    """Refuse channels with sample times other than those of the first."""
    first = np.asarray(times[0]["x"], float)
    allowed = 0.01 * abs(first[-1] - first[0]) / max(first.size - 1, 1)
    for dof, dataset in zip(channels, times, strict=True):
        axis = np.asarray(dataset["x"], float)
        if axis.shape != first.shape or np.abs(axis - first).max() > allowed:
            raise FileError(
                f"{path}: channel {dof} runs on another clock than channel {channels[0]}: {_clock(axis)} against "
                f"{_clock(first)}; export all with one setting, or read those of one clock from a file of their own, bring "
                "them to one rate with `prepare`, and join them"
            )


def _clock(axis: FloatArray) -> str:
    step = (axis[-1] - axis[0]) / (axis.size - 1) if axis.size > 1 else 0.0
    return f"{axis.size} samples every {step:.6g} s from {axis[0]:.6g} s on" if axis.size else "no samples"


def _scales(
    path: Path,
    found: list[Dataset],
    times: list[Dataset],
    channels: tuple[Dof, ...],
    options: ReadOptions,
) -> tuple[tuple[Quantity, ...], FloatArray]:
    if options.units:
        return channel_units(path, channels, options)
    factors = unit_factors(path, found)
    pairs = [channel_scale(path, sides(d)[0], dof, factors) for dof, d in zip(channels, times, strict=True)]
    return tuple(cast(Quantity, quantity) for quantity, _ in pairs), np.array([factor for _, factor in pairs])


def _rate(path: Path, dataset: Dataset, options: ReadOptions) -> float:
    axis = np.asarray(dataset["x"], float)
    if dataset["abscissa_spacing"]:
        step = float(dataset["abscissa_inc"])
    elif axis.size > 1:
        step = float(axis[-1] - axis[0]) / (axis.size - 1)
        if np.abs(np.diff(axis) - step).max() > 1e-6 * abs(step) + 4e-16 * np.abs(axis).max():
            raise FileError(f"{path}: sample times are not even; resample them before the export")
    else:
        step = 0.0
    if step <= 0:
        raise FileError(f"{path}: the time step is {step:g} s; it must be positive, set it in the export")
    if options.sampling_rate is None:
        return 1 / step
    if abs(options.sampling_rate * step - 1) > _SIX_DIGITS:
        raise InputError(
            f"{path}: is sampled at {1 / step:g} Hz, but `sampling_rate` {options.sampling_rate:g} was "
            "given; leave it out"
        )
    return options.sampling_rate
