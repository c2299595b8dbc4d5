"""Stored spectra of motion read from files: universal files, and arrays of NPZ, MAT and HDF5 files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from structid.core.dof import parse_dofs
from structid.core.errors import FileError, InputError, about
from structid.core.units import parse_frequency_unit
from structid.files import damage_told, require_readable
from structid.files.hdf5 import hdf5_datasets, hdf5_fields
from structid.files.matlab import matlab_variables
from structid.files.npy import npz_arrays
from structid.records.formats import hdf5, mat, npz
from structid.records.formats.bare import channel_units, require_option
from structid.records.formats.gaps import sourced
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.uff import uff
from structid.records.formats.uff.spectra import read_spectra
from structid.records.spectrum import SpectrumRecord

#: `kind` of arrays that hold spectra.
SPECTRUM = "spectrum"
_OPTIONS = ("array", "frequency_array", "kind", "channels", "inputs", "units", "quantities", "axis_unit", "averages")


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
        if path.suffix.lower() in uff.SUFFIXES:
            return read_spectra(path, options)
        return _bare_spectrum(path, options)


def _arrays(path: Path) -> tuple[list[str], Callable[[str], np.ndarray]]:
    """Names of the arrays of a file, and what loads one."""
    suffix = path.suffix.lower()
    if suffix in npz.SUFFIXES:
        arrays = npz_arrays(path)
        return list(arrays), arrays.__getitem__
    if suffix in mat.SUFFIXES:
        variables = {name: value for name, value in matlab_variables(path).items() if isinstance(value, np.ndarray)}
        return list(variables), variables.__getitem__
    if suffix in hdf5.SUFFIXES:
        return list(hdf5_datasets(path)), lambda name: np.asarray(hdf5_fields(path, [name])[name])
    raise FileError(f"{path}: spectra are read from universal files and from arrays of .npz, .mat and .h5; convert it")


def _bare_spectrum(path: Path, options: ReadOptions) -> SpectrumRecord:
    """The spectral matrix in bare arrays of a file, as the options describe them, in SI units."""
    other = next((name for name in options.given() if name not in _OPTIONS), None)
    if other is not None:
        raise InputError(f"{path}: `{other}` is not about spectra; leave it out", other)
    names, load = _arrays(path)
    require_option(path, options, "frequency_array", "at which frequencies its lines are")
    require_option(path, options, "channels", "where its channels were measured")
    if not options.quantities and not options.units:
        require_option(path, options, "units", "what its channels hold (of the motion, such as g; or quantities=...)")
    chosen = options.array or next((name for name in names if name != options.frequency_array), "")
    if not options.array and len(names) != 2:
        raise InputError(f"{path}: holds the arrays {', '.join(names)}; say which: {option_words(array=None)}")
    for name in (chosen, options.frequency_array):
        if name not in names:
            raise FileError(f"{path}: has no array {name!r}; its arrays are {', '.join(names)}")
    values, frequency = load(chosen), np.ravel(load(options.frequency_array))
    if values.dtype.kind not in "fciu" or frequency.dtype.kind not in "fiu":
        raise FileError(f"{path}: the arrays of spectra and frequencies must hold numbers, got {values.dtype}")
    with about("channels"):
        channels = parse_dofs(options.channels)
    with about("inputs"):
        references = parse_dofs(options.inputs) if options.inputs else channels
    shape = (len(frequency), len(channels), len(references))
    if values.shape != shape:
        raise InputError(
            f"{path}: array {chosen!r} has shape {values.shape}, and lines, channels and references are {shape}; order the axes"
            " so, and name references that are not all channels by `inputs`"
        )
    quantities, factors = channel_units(path, channels, options)
    of_reference = np.array([factors[channels.index(dof)] for dof in references if dof in channels])
    if len(of_reference) < len(references):
        raise InputError(f"{path}: `inputs` must be among the channels", "inputs")
    if not np.iscomplexobj(values) and len(channels) > 1:
        raise FileError(f"{path}: array {chosen!r} is real: cross-spectra without their phase tell no mode shape")
    factor = parse_frequency_unit(options.axis_unit) if options.axis_unit else 1.0
    note = f"{chosen} as spectra, per Hz or per line, one-sided or two-sided, which changes no mode"
    return SpectrumRecord(
        frequency * factor,
        values * factors[:, None] * of_reference,
        channels,
        references,
        quantities,
        options.averages,
        sourced(path, note),
    )
