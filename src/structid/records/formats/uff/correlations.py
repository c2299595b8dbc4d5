"""Auto- and cross-correlation functions of a universal file (function types 7 and 8), assembled to one matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import FileError
from structid.records.correlation import CorrelationRecord
from structid.records.formats.gaps import source_with_note
from structid.records.formats.options import ReadOptions
from structid.records.formats.uff.abscissa import one_axis_unit
from structid.records.formats.uff.functions import Dataset58
from structid.records.formats.uff.spectra import (
    along_global_axes,
    complete_references,
    is_per_hertz,
    read_pairs,
    scaled_matrix,
    stated_averages,
)
from structid.records.lags import FORWARD, lag_halves, step_of

#: Function types: auto-correlation, cross-correlation.
CORRELATIONS = (7, 8)


def read_correlations(path: Path, options: ReadOptions) -> CorrelationRecord:
    """The correlation functions in the universal file at `path`, between all channels and the references common to them.

    A cross-correlation is the mean product of its response at t + lag and its reference at t. Negative lags, stored before
    lag 0 or behind the positive ones as a Fourier transform leaves them, serve for the reversed pair. The unit of a label is a
    square (``(m/s^2)^2``) or a product (``g*m/s``).

    Raises
    ------
    FileError
        If there are none, lag 0 is not among them, lags are uneven or differ, an autocorrelation is not symmetric, pairs are
        doubled or missing, or units are not stated or not squares.
    InputError
        If an option does not apply, or names a channel that the file lacks.
    """
    words = "correlation functions of motion (function types 7 and 8)"
    blocks, by_pair, factors, windows = read_pairs(path, options, CORRELATIONS, words)
    functions = list(by_pair.values())
    to_seconds, axis_words = one_axis_unit(path, functions, "times", options)
    density = next((function for function in functions if is_per_hertz(function)), None)
    if density is not None:
        raise FileError(
            f"{path}: function {density.ordinal}, a correlation function, is per Hz by its label {density.ordinate.label!r}; export"
            " it again, as a spectrum or as a correlation function"
        )
    step = _one_step(path, functions, to_seconds)
    halves = lag_halves(
        path,
        functions[0].axis * to_seconds,
        {pair: _real_values(path, function) for pair, function in by_pair.items()},
    )
    mirrored = by_pair if halves.backward else ()
    channels, references = complete_references(path, by_pair, mirrored, "cross-correlations")

    def values_of(path: Path, function: Dataset58, pair: tuple[Dof, Dof], is_reverse: bool) -> FloatArray:
        return halves.backward[pair] if is_reverse else halves.forward[pair]

    quantities, values = scaled_matrix(path, by_pair, channels, references, factors, options, values_of)
    channels, references, values, turned = along_global_axes(
        path, blocks, channels, references, quantities, values, options
    )
    count = f"{len(functions)} correlation functions between {len(channels)} channels and {len(references)} references"
    note = "; ".join(filter(None, (f"{count}, {FORWARD}", halves.words, axis_words, turned, windows)))
    averages = options.averages if options.averages is not None else stated_averages(functions)
    return CorrelationRecord(
        1 / step, np.real(values), channels, references, quantities, averages, source_with_note(path, note)
    )


def _one_step(path: Path, functions: list[Dataset58], to_seconds: float) -> float:
    """Step of the lags in s, which must be the same in all functions; `FileError` if lags differ.

    `to_seconds` is the factor from the functions' abscissa to s.
    """
    first = functions[0].axis * to_seconds
    step = step_of(path, first)
    for function in functions:
        axis = function.axis * to_seconds
        if axis.shape != first.shape or np.abs(axis - first).max() > 0.01 * step:
            raise FileError(
                f"{path}: function {function.ordinal} has other lags than the first; export all with one setting"
            )
    return step


def _real_values(path: Path, function: Dataset58) -> FloatArray:
    if np.iscomplexobj(function.values) and np.any(function.values.imag):
        raise FileError(
            f"{path}: function {function.ordinal}, a correlation function, has complex values; export real ones"
        )
    return np.asarray(np.real(function.values), float)
