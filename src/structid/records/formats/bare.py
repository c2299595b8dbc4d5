"""Arrays that do not describe themselves, made records by the user's options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import require_finite
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError, UnnamedChannelsError, about
from structid.core.units import parse_frequency_unit, parse_frf_unit, parse_unit
from structid.records.formats.gaps import source_with_note, whole
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.stated import Statements, frequency_unit, require_agreement
from structid.records.record import DERIVATIVES, QUANTITY_UNITS, FrfKind, FrfRecord, Quantity, TimeRecord

_FRF_OPTIONS = ("frequency_array", "outputs", "inputs", "kind", "unit", "coherence_array")
_TIME_OPTIONS = ("sampling_rate", "channels", "quantities", "units", "start", "stop", "longest_gap")

#: Shape and type of each array in a file, without its values.
Shapes = Mapping[str, tuple[tuple[int, ...], np.dtype]]


#: Samples from which a column that rises in even steps, to this part of a step (times may be rounded), is no vibration.
_FEWEST, _EVEN = 8, 0.1


def require_option(path: Path, options: ReadOptions, name: str, purpose: str) -> None:
    """Raise `InputError` unless the option `name` is set; `purpose` says in the message what it would tell."""
    if name in options.given():
        return
    raise InputError(f"{path}: the array does not say {purpose}; give {option_words(**{name: None})}")


def read_bare(
    path: Path,
    shapes: Shapes,
    load: Callable[[str], np.ndarray],
    options: ReadOptions,
    statements: Statements | None = None,
) -> FrfRecord | TimeRecord:
    """The record made of unlabelled arrays in a file: FRFs if `options.frequency_array` is set, else time histories.

    Parameters
    ----------
    path : Path
        File, for messages and for the record's source.
    shapes : mapping of str to (shape, dtype)
        Shape and type of each array in the file, by name.
    load : callable
        Returns the values of an array by its name.
    options : ReadOptions
        Names, degrees of freedom, units.
    statements : mapping, optional
        Texts, small arrays and attributes stored beside the array, which the options must not contradict.

    Raises
    ------
    FileError
        If the file has no numeric array, or lacks the array named in `options`.
    InputError
        If an option is missing or contradicts the array or what is stored beside it.
    """
    if "frequency_array" in options.given():
        name = _choose_array(path, shapes, options.array, {options.frequency_array, options.coherence_array})
        _require_present(path, shapes, options.frequency_array)
        note = require_agreement(path, name, *shapes[name], statements or {}, options)
        frequency = load(options.frequency_array)
        unit = frequency_unit(path, options.frequency_array, options)
        words = (
            f"frequencies in {unit} by the name {options.frequency_array!r}" if unit and not options.axis_unit else ""
        )
        coherence = None
        if options.coherence_array:
            _require_present(path, shapes, options.coherence_array)
            coherence = load(options.coherence_array)
        frfs = frf_from_array(path, load(name), frequency, coherence, replace(options, axis_unit=unit))
        note = "; ".join(filter(None, (note, words)))
        return replace(frfs, source=source_with_note(path, note)) if note else frfs
    name = _choose_array(path, shapes, options.array, set())
    record = time_from_array(path, load(name), options)
    note = require_agreement(path, name, *shapes[name], statements or {}, options)
    if shapes[name][1].kind in "iu":
        note = "; ".join(
            filter(None, (note, f"whole numbers ({shapes[name][1]}), taken as they are in the unit given"))
        )
    return replace(record, source=f"{record.source}; {note}") if note else record


def _listing(shapes: Shapes) -> str:
    return ", ".join(f"{name} {shape}" for name, (shape, _) in sorted(shapes.items())[:20]) or "none"


def _require_present(path: Path, shapes: Shapes, name: str) -> None:
    if name not in shapes:
        raise FileError(f"{path}: has no array {name!r}; its arrays are {_listing(shapes)}")


def _choose_array(path: Path, shapes: Shapes, wanted: str, taken: set[str]) -> str:
    """Name of the array to read: `wanted`, or if that is "" the only numeric array whose name is not in `taken`.

    Raises `FileError` if there is none, `InputError` if there are several. `shapes` has the shape and type of each
    array of the file by name.
    """
    if wanted:
        _require_present(path, shapes, wanted)
        return wanted
    free = [name for name, (_, dtype) in shapes.items() if name not in taken and dtype.kind in "fciu"]
    if len(free) == 1:
        return free[0]
    if not free:
        raise FileError(f"{path}: holds no array of numbers; its arrays are {_listing(shapes)}")
    raise InputError(
        f"{path}: holds several arrays and does not say which to read; give {option_words(array=None)}, one of"
        f" {_listing(shapes)}"
    )


def _require_numbers(path: Path, array: np.ndarray, allowed: str, what: str) -> None:
    if array.dtype.kind not in allowed:
        raise FileError(f"{path}: the array of {what} must hold numbers, got type {array.dtype}")


def _per_channel(path: Path, name: str, entries: tuple[str, ...], count: int) -> tuple[str, ...]:
    """The option `name` as a tuple of `count` entries, one per channel; a single entry holds for all channels.

    `entries` are the option's values. Raises `InputError` if their number is neither 1 nor `count`.
    """
    if len(entries) == 1:
        return entries * count
    if len(entries) != count:
        raise InputError(f"{path}: `{name}` must have 1 or {count} entries, one a channel, got {len(entries)}", name)
    return entries


def channel_units(
    path: Path, channels: tuple[Dof, ...], options: ReadOptions
) -> tuple[tuple[Quantity, ...], NDArray[np.float64]]:
    """Quantities of `channels` and their factors to SI, (n_channels,), from the options `quantities` and `units`.

    Without `units` values are in SI, and all factors are 1. `path` is named in errors.

    Raises
    ------
    InputError
        If units or quantities are unknown, contradict each other or a channel's direction, or are not 1 or one per channel.
    """
    if not options.units:
        quantities = _per_channel(path, "quantities", options.quantities, len(channels))
        for quantity in quantities:
            if quantity not in QUANTITY_UNITS:
                known = ", ".join(QUANTITY_UNITS)
                raise InputError(f"{path}: `quantities` must be among {known}, got {quantity!r}", "quantities")
        return cast(tuple[Quantity, ...], quantities), np.ones(len(channels))
    with about("units"):
        units = [parse_unit(text) for text in _per_channel(path, "units", options.units, len(channels))]
        for dof, unit in zip(channels, units, strict=True):
            require_same_rotation(path, str(dof), dof.is_rotation, unit.rotation)
    if options.quantities:
        declared = _per_channel(path, "quantities", options.quantities, len(channels))
        for dof, unit, quantity in zip(channels, units, declared, strict=True):
            if unit.quantity != quantity:
                raise InputError(
                    f"{path}: channel {dof} has a unit of {unit.quantity}, but `quantities` says {quantity}",
                    "quantities",
                )
    return tuple(unit.quantity for unit in units), np.array([unit.factor for unit in units])


def require_same_rotation(path: Path, name: str, dof_rotates: bool, unit_rotates: bool) -> None:
    """Raise `InputError` if a channel and its unit are not both translations or both rotations.

    `name` is the channel in the message; the flags are True for rotations.
    """
    if dof_rotates != unit_rotates:
        words = ("translation", "rotation")
        raise InputError(
            f"{path}: {name} is a {words[dof_rotates]} but its unit belongs to a {words[unit_rotates]}; "
            "correct one of them"
        )


def time_from_array(path: Path, values: np.ndarray, options: ReadOptions) -> TimeRecord:
    """A time record from `values` (n_times, n_channels) or (n_times,), with channels, rate and units from `options`.

    The record runs from `options.start` to `options.stop`, with gaps filled as `options.longest_gap` allows.

    Raises
    ------
    UnnamedChannelsError
        If the channels are missing.
    InputError
        If sampling rate, or quantities and units are missing, or do not fit the array, or a column holds times.
    FileError
        If samples are missing in a gap that may not be filled.
    """
    frf_options = [name for name in options.given() if name in _FRF_OPTIONS]
    if frf_options or values.dtype.kind == "c":
        reason = f"`{frf_options[0]}` was given" if frf_options else "the array is complex"
        _refuse_frf(path, reason)
    if options.axis_unit:
        raise InputError(f"{path}: an array of samples has no axis; give `sampling_rate` (Hz) alone", "axis_unit")
    _require_numbers(path, values, "fiu", "samples")
    require_option(path, options, "sampling_rate", "how fast it was sampled")
    try:
        require_option(path, options, "channels", "where its channels were measured")
    except InputError as error:
        raise UnnamedChannelsError(str(error), 1 if values.ndim == 1 else values.shape[-1]) from None
    if not options.quantities and not options.units:
        require_option(path, options, "units", "what its channels hold (or quantities=...)")
    with about("channels"):
        channels = parse_dofs(options.channels)
    if values.ndim == 1:
        values = values[:, None]
    if values.ndim != 2 or values.shape[1] != len(channels):
        is_transposed = values.ndim == 2 and values.shape[0] == len(channels)
        hint = "the array is turned: store samples along rows" if is_transposed else "name every column in `channels`"
        raise InputError(
            f"{path}: {len(channels)} channels were given for an array of shape {values.shape}; {hint}", "channels"
        )
    _require_no_times(path, values)
    quantities, factors = channel_units(path, channels, options)
    rate = float(options.sampling_rate or 0.0)
    samples = whole(path, np.asarray(values, dtype=np.float64), channels, rate, 0.0, options, named=False)
    return TimeRecord(
        rate,
        samples.values * factors,
        channels,
        quantities,
        start=samples.start,
        source=source_with_note(path, samples.note),
    )


def _require_no_times(path: Path, values: np.ndarray) -> None:
    """Raise `InputError` if some, but not all, columns of `values` (n_times, n_channels) rise in even steps, as times do."""
    ramp = even_ramp(values)
    if ramp is not None:
        j, step = ramp
        raise InputError(
            f"{path}: column {j + 1} of the array rises in even steps of {step:.4g}, as times and counts do; store the channels"
            " without it"
        )


def even_ramp(values: np.ndarray) -> tuple[int, float] | None:
    """Index (from 0) of the first column that rises in even steps, as times do, and its first step in its unit.

    Steps are even if each of `values` (n_times, n_channels) is within a tenth of a step of the straight line from first
    to last. None if no column rises so, all do, there are fewer than 8 samples or two columns, or values are not real
    numbers.
    """
    if values.ndim != 2 or min(values.shape) < 2 or len(values) < _FEWEST or values.dtype.kind not in "fiu":
        return None
    ramps = []
    for j, column in enumerate(values.T):
        step = (float(column[-1]) - float(column[0])) / (len(column) - 1)
        if not step > 0 or abs(float(column[1]) - float(column[0]) - step) > 2 * _EVEN * step:
            continue  # most columns end here, before all of their samples are read
        if np.abs(column - (float(column[0]) + step * np.arange(len(column)))).max() <= _EVEN * step:
            ramps.append((j, float(column[1]) - float(column[0])))
    return ramps[0] if 0 < len(ramps) < values.shape[1] else None


def _refuse_frf(path: Path, reason: str) -> NoReturn:
    raise InputError(
        f"{path}: {reason}, so this is read as frequency response functions, which need their frequencies; "
        f"give {option_words(frequency_array=None)}, the name of the array of frequencies in Hz"
    )


def frf_kind(path: Path, options: ReadOptions) -> tuple[FrfKind, float]:
    """Kind of the FRFs and factor to SI of their values, from the options `kind` and `unit`.

    Without `unit` the values are in SI, and the factor is 1.

    Raises
    ------
    InputError
        If both options are missing, one of them is unknown, or they contradict each other.
    """
    if options.kind and options.kind not in DERIVATIVES:
        raise InputError(f"{path}: `kind` must be one of {', '.join(DERIVATIVES)}, got {options.kind!r}", "kind")
    if not options.unit:
        require_option(path, options, "kind", "whether it holds receptance, mobility, accelerance or transmissibility")
        return cast(FrfKind, options.kind), 1.0
    with about("unit"):
        unit = parse_frf_unit(options.unit)
    if options.kind and options.kind != unit.kind:
        raise InputError(f"{path}: `unit` {options.unit!r} is of {unit.kind}, but `kind` says {options.kind}", "kind")
    return unit.kind, unit.factor


def frf_from_array(
    path: Path,
    values: np.ndarray,
    frequency: np.ndarray,
    coherence: np.ndarray | None,
    options: ReadOptions,
) -> FrfRecord:
    """An FRF record from an array, with channels and units from `options`; trailing axes of length 1 may be missing.

    Parameters
    ----------
    path : Path
        File, for messages and for the record's source.
    values : (n_frequencies, n_outputs, n_inputs) complex array
    frequency : (n_frequencies,) array
        In Hz, or in `options.axis_unit`.
    coherence : array of the shape of `values`, or None
        None if it was not measured.
    options : ReadOptions

    Raises
    ------
    InputError
        If outputs, inputs or kind are missing, or do not fit the array, the array is real or not finite, or `options` are
        those of time histories.
    """
    time_options = [name for name in options.given() if name in _TIME_OPTIONS]
    if time_options:
        raise InputError(
            f"{path}: `{time_options[0]}` belongs to time histories, but `frequency_array` was given; leave out one"
        )
    if values.dtype.kind in "fiu":
        raise InputError(
            f"{path}: the FRF array is real; frequency response functions are complex, so give real + 1j * imaginary"
        )
    _require_numbers(path, values, "c", "FRF values")
    _require_numbers(path, frequency, "fiu", "frequencies")
    require_option(path, options, "outputs", "where the responses were measured")
    require_option(path, options, "inputs", "where the loads acted")
    kind, factor = frf_kind(path, options)
    with about("outputs"):
        outputs = parse_dofs(options.outputs)
    with about("inputs"):
        inputs = parse_dofs(options.inputs)
    if options.unit:
        unit = parse_frf_unit(options.unit)
        with about("unit"):
            for dof in outputs:
                require_same_rotation(path, f"output {dof}", dof.is_rotation, unit.output_rotation)
            for dof in inputs:
                require_same_rotation(path, f"input {dof}", dof.is_rotation, unit.input_rotation)
    require_finite("values", values, "remove these lines or channels, or repair the file")
    shape = (frequency.size, len(outputs), len(inputs))
    with about("axis_unit"):
        to_hertz = parse_frequency_unit(options.axis_unit) if options.axis_unit else 1.0
    return FrfRecord(
        frequency=frequency.ravel().astype(np.float64) * to_hertz,
        values=_with_shape(path, "array", values, shape).astype(np.complex128) * factor,
        outputs=outputs,
        inputs=inputs,
        kind=kind,
        coherence=None if coherence is None else _with_shape(path, "coherence_array", coherence, shape).real,
        averages=options.averages,
        source=str(path),
    )


def _with_shape(path: Path, name: str, values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """`values`, of one to three axes, with axes of length 1 appended up to three; `InputError` unless the result has `shape`.

    `shape` is (n_frequencies, n_outputs, n_inputs); `name` is the argument that the message names.
    """
    full = values
    while full.ndim < 3:
        full = full[..., None]
    if full.shape != shape:
        raise InputError(
            f"{path}: `{name}` has shape {values.shape}, but frequencies, outputs and inputs ask for {shape}; "
            "give every output and input, in the order of the columns"
        )
    return full
