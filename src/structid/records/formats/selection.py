"""A part of a record that describes itself, chosen and checked by the user's options."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, about
from structid.records.formats.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord

_OF_HISTORIES = (
    "sampling_rate", "channels", "quantities", "units", "start", "stop", "longest_gap", "resample", "columns",
    "time_column",
)  # fmt: skip


def select_channels(path: Path, record: FrfRecord | TimeRecord, options: ReadOptions) -> FrfRecord | TimeRecord:
    """`record` with the outputs, inputs or channels that `options` name, after a check of the others.

    Raises
    ------
    InputError
        If a chosen channel is not there, or an option contradicts what the file says.
    """
    if options.axis_unit:
        raise InputError(f"{path}: says the unit of its axis; leave out `axis_unit`", "axis_unit")
    return _select_frf(path, record, options) if isinstance(record, FrfRecord) else _select_time(path, record, options)


def _contradiction(path: Path, name: str, option: object, in_file: object) -> InputError:
    return InputError(f"{path}: says {name} {in_file}, but `{name}` {option} was given; leave the option out", name)


def positions(path: Path, name: str, texts: tuple[str, ...], present: tuple[Dof, ...]) -> list[int]:
    """Indices in `present` of the channels `texts`, in their order; all indices if `texts` is empty.

    `name` is the option that errors name. Raises `InputError` if a channel is not present.
    """
    if not texts:
        return list(range(len(present)))
    with about(name):
        dofs = parse_dofs(texts)
    missing = [str(dof) for dof in dofs if dof not in present]
    if missing:
        raise InputError(
            f"{path}: `{name}` asks for {', '.join(missing)}, which the file does not have; "
            f"it has {', '.join(map(str, present))}",
            name,
        )
    return [present.index(dof) for dof in dofs]


def _select_frf(path: Path, record: FrfRecord, options: ReadOptions) -> FrfRecord:
    """The FRF record reduced to the outputs and inputs in `options`, in their order; all of them if not set.

    `options.averages` replaces the number of averages if set. Raises `InputError` for a channel that is missing, for
    options of time histories, and for a `kind` that contradicts the record.
    """
    refuse_options(path, "frequency response functions", options, _OF_HISTORIES)
    if options.kind and options.kind != record.kind:
        raise _contradiction(path, "kind", options.kind, record.kind)
    rows = positions(path, "outputs", options.outputs, record.outputs)
    columns = positions(path, "inputs", options.inputs, record.inputs)
    averages = record.averages if options.averages is None else options.averages
    return replace(record.grid(rows, columns), averages=averages)


def _select_time(path: Path, record: TimeRecord, options: ReadOptions) -> TimeRecord:
    """Time record reduced to the channels in `options`, in their order, and to samples from `start` to `stop`, in s.

    All are kept where an option is not set. Raises `InputError` for options of FRFs, for rates or quantities that
    contradict the record, for a channel that is missing, and if no sample is left.
    """
    frf_options = ("frequency_array", "outputs", "inputs", "kind", "coherence_array", "averages")
    refuse_options(path, "time histories", options, frf_options)
    rate = options.sampling_rate
    if rate is not None and abs(rate - record.sampling_rate) > 1e-9 * rate:
        raise _contradiction(path, "sampling_rate", rate, record.sampling_rate)
    first, last = sample_range(path, record.time, options)
    keep = _time_positions(path, record, options)
    quantities = tuple(record.quantities[i] for i in keep)
    if options.quantities and options.quantities not in (quantities, tuple(dict.fromkeys(quantities))):
        raise _contradiction(path, "quantities", options.quantities, quantities)
    return replace(
        record,
        values=record.values[first:last, keep],
        start=float(record.time[first]),
        channels=tuple(record.channels[i] for i in keep),
        quantities=quantities,
        variance=None if record.variance is None else record.variance[keep],
    )


def sample_range(path: Path, time: FloatArray, options: ReadOptions) -> tuple[int, int]:
    """Index of the first sample from `options.start` on, and that after the last up to `options.stop`.

    `time` (n_times,) holds evenly spaced times in s.

    Raises
    ------
    InputError
        If no sample lies between them.
    """
    slack = 1e-6 * (time[-1] - time[0]) / max(len(time) - 1, 1)
    first = 0 if options.start is None else int(np.searchsorted(time, options.start - slack))
    last = len(time) if options.stop is None else int(np.searchsorted(time, options.stop + slack, side="right"))
    if last <= first:
        raise InputError(
            f"{path}: no sample is left of {time[0]:g}-{time[-1]:g} s between `start` and `stop`; widen them"
        )
    return first, last


def _time_positions(path: Path, record: TimeRecord, options: ReadOptions) -> list[int]:
    """Column indices of the channels in `options.channels`, in their order; all indices if the option is not set.

    A channel with several quantities adds a column for each.
    """
    first = positions(path, "channels", options.channels, record.channels)
    if not options.channels:
        return first
    chosen = [record.channels[i] for i in first]
    return [i for dof in dict.fromkeys(chosen) for i, channel in enumerate(record.channels) if channel == dof]


def refuse_options(path: Path, content: str, options: ReadOptions, names: tuple[str, ...]) -> None:
    """Raise `InputError` if an option among `names` is set, since it does not apply to `content`, which the file holds."""
    wrong = [name for name in options.given() if name in names]
    if wrong:
        raise InputError(f"{path}: holds {content} and says what they are; leave out `{wrong[0]}`", wrong[0])
