"""Stored spectra and correlation functions of motion read from files: universal files, and arrays of NPZ, MAT and HDF5."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import NumberArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError, about
from structid.core.units import Quantity, parse_frequency_unit
from structid.files import damage_told, require_readable
from structid.files.contained import hdf5_datasets, hdf5_fields, matlab_variables
from structid.files.npy import npz_arrays
from structid.records.formats import HDF5, MAT, NPZ, UFF
from structid.records.formats.bare import channel_units, require_option
from structid.records.formats.gaps import source_with_note
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.uff.spectra import read_correlations, read_spectra
from structid.records.stored_averages import FORWARD, CorrelationRecord, SpectrumRecord, lag_halves

#: `kind` of arrays and universal files that hold spectra or correlation functions.
SPECTRUM, CORRELATION = "spectrum", "correlation"
_COMMON = ("array", "kind", "channels", "inputs", "units", "quantities", "averages")
_OPTIONS = (*_COMMON, "frequency_array", "axis_unit")
_OF_CORRELATIONS = (*_COMMON, "sampling_rate")


def read_spectrum(path: str | Path, options: ReadOptions | None = None) -> SpectrumRecord:
    """The auto- and cross-spectra in the file at `path`, in SI units.

    Parameters
    ----------
    path : str or Path
        Universal file with spectra (function types 2, 3 and 9), or NPZ, MAT or HDF5 with an array of shape
        (n_frequencies, n_channels, n_references) and one of frequencies.
    options : ReadOptions, optional
        What the file does not say: ``units`` of each channel (of the motion, such as ``g``, not of its square), ``averages``.
        Of arrays also ``frequency_array``, ``channels``, and ``inputs`` for the references where these are not all channels.

    Raises
    ------
    FileError
        If the file is missing, damaged, or holds no spectra; if magnitudes stand without phase, or pairs are missing.
    InputError
        If an option is missing or contradicts the file.
    """
    path, options = require_readable(path), options or ReadOptions()
    with damage_told(path, "spectra that can be read"):
        if path.suffix.lower() in UFF.SUFFIXES:
            return read_spectra(path, options)
        return _bare_spectrum(path, options)


def _arrays(path: Path) -> tuple[list[str], Callable[[str], np.ndarray]]:
    """Names of the arrays of an NPZ, MAT or HDF5 file, and a function that returns the array of a name, of any shape.

    Raises `FileError` for a file with another suffix.
    """
    suffix = path.suffix.lower()
    if suffix in NPZ.SUFFIXES:
        arrays = npz_arrays(path)
        return list(arrays), arrays.__getitem__
    if suffix in MAT.SUFFIXES:
        variables = {name: value for name, value in matlab_variables(path).items() if isinstance(value, np.ndarray)}
        return list(variables), variables.__getitem__
    if suffix in HDF5.SUFFIXES:
        return list(hdf5_datasets(path)), lambda name: np.asarray(hdf5_fields(path, [name])[name])
    raise FileError(f"{path}: spectra are read from universal files and from arrays of .npz, .mat and .h5; convert it")


def read_correlation(path: str | Path, options: ReadOptions | None = None) -> CorrelationRecord:
    """The auto- and cross-correlation functions in the file at `path`, in SI units.

    Parameters
    ----------
    path : str or Path
        Universal file with correlation functions (function types 7 and 8), or NPZ, MAT or HDF5 with an array of shape
        (n_lags, n_channels, n_references) from lag 0 on.
    options : ReadOptions, optional
        What the file does not say: ``units`` of each channel (of the motion, such as ``g``, not of its square),
        ``averages``. Of arrays also ``sampling_rate``, ``channels``, and ``inputs`` for the references where these are
        not all channels.

    Raises
    ------
    FileError
        If the file is missing, damaged, or holds no correlation functions; if lags are uneven or begin after 0, or
        pairs are missing.
    InputError
        If an option is missing or contradicts the file, or the functions are normalized to 1.
    """
    path, options = require_readable(path), options or ReadOptions()
    with damage_told(path, "correlation functions that can be read"):
        if path.suffix.lower() in UFF.SUFFIXES:
            return read_correlations(path, options)
        return _bare_correlation(path, options)


def _bare_correlation(path: Path, options: ReadOptions) -> CorrelationRecord:
    """The correlation functions in an unlabelled array of a file, as the options describe it, in SI units.

    The array is (n_lags, n_channels, n_references). Lags run from 0 s on at `options.sampling_rate`; if all
    autocorrelations are symmetric about the middle, the second half holds negative lags and is dropped. Raises
    `InputError` if an option is missing or does not fit the array, `FileError` if the array is missing or holds no
    numbers.
    """
    _refuse_others(path, options, _OF_CORRELATIONS, "correlation functions")
    names, load = _arrays(path)
    require_option(path, options, "sampling_rate", "how many lags a second it has")
    array = _matrix_of_array(path, names, load, options, None, "lags")
    pairs = {
        (channel, reference): np.real(array.values[:, row, column])
        for row, channel in enumerate(array.channels)
        for column, reference in enumerate(array.references)
    }
    rate = float(options.sampling_rate or 0.0)
    with about("array"):
        halves = lag_halves(path, np.arange(len(array.values)) / rate, pairs)
    columns = [[halves.forward[c, r] for r in array.references] for c in array.channels]
    values = np.moveaxis(np.array(columns), -1, 0)
    note = f"{array.name} as correlation functions, {FORWARD}; {halves.words}"
    channels, references, quantities = array.channels, array.references, array.quantities
    return CorrelationRecord(
        rate, values, channels, references, quantities, options.averages, source_with_note(path, note)
    )


class _MatrixOfArray(NamedTuple):
    """An array of functions between channels and references, in SI units."""

    name: str
    values: NumberArray
    channels: tuple[Dof, ...]
    references: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]


def _refuse_others(path: Path, options: ReadOptions, allowed: Sequence[str], words: str) -> None:
    """Raise `InputError` if an option is set that is not in `allowed`; `words` name the content of the file."""
    other = next((name for name in options.given() if name not in allowed), None)
    if other is not None:
        raise InputError(f"{path}: `{other}` is not about {words}; leave it out", other)


def _matrix_of_array(
    path: Path,
    names: Sequence[str],
    load: Callable[[str], np.ndarray],
    options: ReadOptions,
    n_points: int | None,
    points: str,
) -> _MatrixOfArray:
    """The array that the options choose, with name, values in SI, channels, references and quantities.

    The values are (n_points, n_channels, n_references), scaled by the units of both channels. `names` are those of the
    file's arrays, `load` returns an array by its name, `n_points` is required (None for any), and `points` is "lines"
    or "lags". Raises `FileError` if the array is missing or holds no numbers, `InputError` if an option is missing or
    does not fit.
    """
    require_option(path, options, "channels", "where its channels were measured")
    if not options.quantities and not options.units:
        require_option(path, options, "units", "what its channels hold (of the motion, such as g; or quantities=...)")
    rest = [name for name in names if name != options.frequency_array]
    if not options.array and len(rest) != 1:
        raise InputError(f"{path}: holds the arrays {', '.join(names)}; say which: {option_words(array=None)}")
    chosen = options.array or rest[0]
    if chosen not in names:
        raise FileError(f"{path}: has no array {chosen!r}; its arrays are {', '.join(names)}")
    values = load(chosen)
    if values.dtype.kind not in ("fciu" if points == "lines" else "fiu"):
        raise FileError(f"{path}: the array of {points} must hold numbers, got {values.dtype}")
    with about("channels"):
        channels = parse_dofs(options.channels)
    with about("inputs"):
        references = parse_dofs(options.inputs) if options.inputs else channels
    shape = (n_points or len(values) if values.ndim else 0, len(channels), len(references))
    if values.shape != shape:
        raise InputError(
            f"{path}: array {chosen!r} has shape {values.shape}, and {points}, channels and references are {shape}; order the"
            " axes so, and name references that are not all channels by `inputs`"
        )
    quantities, factors = channel_units(path, channels, options)
    of_reference = np.array([factors[channels.index(dof)] for dof in references if dof in channels])
    if len(of_reference) < len(references):
        raise InputError(f"{path}: `inputs` must be among the channels", "inputs")
    scaled = values * factors[:, None] * of_reference
    return _MatrixOfArray(chosen, scaled, channels, references, quantities)


def _bare_spectrum(path: Path, options: ReadOptions) -> SpectrumRecord:
    """The spectral matrix in unlabelled arrays of a file, (n_frequencies, n_channels, n_references), in SI units.

    `options` name the arrays of values and of frequencies (`axis_unit`, or Hz), channels and units. Raises `InputError`
    or `FileError` if options are missing or do not fit, or cross-spectra are real.
    """
    _refuse_others(path, options, _OPTIONS, "spectra")
    names, load = _arrays(path)
    require_option(path, options, "frequency_array", "at which frequencies its lines are")
    if options.frequency_array not in names:
        raise FileError(f"{path}: has no array {options.frequency_array!r}; its arrays are {', '.join(names)}")
    frequency = np.ravel(load(options.frequency_array))
    if frequency.dtype.kind not in "fiu":
        raise FileError(f"{path}: the array of frequencies must hold numbers, got {frequency.dtype}")
    array = _matrix_of_array(path, names, load, options, len(frequency), "lines")
    if not np.iscomplexobj(array.values) and len(array.channels) > 1:
        raise FileError(f"{path}: array {array.name!r} is real: cross-spectra without their phase tell no mode shape")
    factor = parse_frequency_unit(options.axis_unit) if options.axis_unit else 1.0
    note = f"{array.name} as spectra, per Hz or per line, one-sided or two-sided, which changes no mode"
    return SpectrumRecord(
        frequency * factor,
        array.values,
        array.channels,
        array.references,
        array.quantities,
        options.averages,
        source_with_note(path, note),
    )
