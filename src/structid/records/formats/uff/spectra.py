"""Spectra and correlation functions of a universal file, assembled to one matrix.

Function types 2, 3 and 9 are auto- and cross-spectra, 7 and 8 auto- and cross-correlations.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, NumberArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError, about
from structid.core.units import Quantity, parse_unit
from structid.files.uff.datasets import UffDataset, UnitFactors, read_blocks, read_unit_factors
from structid.files.uff.geometry import read_nodes
from structid.records.formats.bare import channel_units
from structid.records.formats.gaps import source_with_note
from structid.records.formats.headers import is_read_by
from structid.records.formats.named_channels import choose_columns
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.uff.channels import QUANTITIES, UNKNOWN, channel_scale, dof_of, in_global_axes
from structid.records.formats.uff.frf import AVERAGES
from structid.records.formats.uff.functions import (
    Dataset58,
    one_axis_unit,
    qualifier_words,
    read_function,
    require_one_component,
)
from structid.records.stored_averages import FORWARD, CorrelationRecord, SpectrumRecord, lag_halves, step_of

#: Function types: auto spectrum, cross spectrum, power spectral density.
SPECTRA = (2, 3, 9)
#: Cross-spectrum and cross-correlation: function types that need a reference.
_CROSS = (3, 8)
_FREQUENCY_TYPE = 18
_PER_HERTZ = re.compile(r" ?(?:/|per) ?\(?(?:hz|hertz)\)?$", re.IGNORECASE)
_ROOT = re.compile(r"(?:/|per) ?(?:\u221a|sqrt|rt|root)|rms|pk|peak", re.IGNORECASE)
_SQUARE = re.compile(
    r"(?:\((?P<bracketed>.+)\)|(?P<bare>[^/()*^]+?)) ?(?:(?:\^|\*\*)?2|\u00b2)$|(?P<said>.+?)[ -]?(?:sq\.?|squared)$",
    re.IGNORECASE,
)
_SPLIT_SQUARE = re.compile(r"([a-z]+)(?:\^|\*\*)?2/(s|sec)(?:\^|\*\*)?4$", re.IGNORECASE)
#: Relative size of imaginary parts and negative values of autospectra that are rounding.
_ROUNDED = 1e-4
_USED = ("kind", "channels", "columns", "units", "axis_unit", "axes", "averages")
#: Function types: auto-correlation, cross-correlation.
_CORRELATIONS = (7, 8)


def read_spectra(path: Path, options: ReadOptions) -> SpectrumRecord:
    """The auto- and cross-spectra in the universal file at `path`, between all channels and the references common to them.

    A cross-spectrum is its response's transform times the conjugate of its reference's; the reversed pair has the conjugate.
    The unit of a label is a square (``g^2/Hz``, ``(m/s^2)^2``) or a product (``g*m/s``).

    Raises
    ------
    FileError
        If there are none, a cross-spectrum has no phase, pairs are doubled or missing, or units are not stated or not squares.
    InputError
        If an option does not apply, or names a channel that the file lacks.
    """
    words = "spectra of motion (function types 2, 3 and 9)"
    blocks, by_pair, factors, windows = _read_pairs(path, options, SPECTRA, words, "spectrum")
    functions = list(by_pair.values())
    to_hertz, axis_words = one_axis_unit(path, functions, "frequencies", options)
    channels, references = _complete_references(path, by_pair, by_pair, "cross-spectra")
    frequency = functions[0].axis * to_hertz
    for function in functions:
        if (
            function.axis.shape != frequency.shape
            or np.abs(function.axis * to_hertz - frequency).max() > 1e-6 * frequency[-1]
        ):
            raise FileError(
                f"{path}: function {function.ordinal} has other frequencies than the first; export all with one setting"
            )
    is_density = _densities(path, functions)
    quantities, values = _scaled_matrix(path, by_pair, channels, references, factors, options, _spectrum_values)
    channels, references, values, turned = _along_global_axes(
        path, blocks, channels, references, quantities, values, options
    )
    scale = "power spectral densities" if is_density else "squares of amplitudes a line"
    words = (
        f"{len(functions)} spectra between {len(channels)} channels and {len(references)} references, {scale} by their labels,"
        " one-sided or two-sided, which the file does not say and which changes no mode"
    )
    note = "; ".join(filter(None, (words, axis_words, turned, windows)))
    averages = options.averages if options.averages is not None else _stated_averages(functions)
    return SpectrumRecord(frequency, values, channels, references, quantities, averages, source_with_note(path, note))


class _Pairs(NamedTuple):
    """Datasets of a file, its functions by response and reference, its units where the options say none, words on windows."""

    blocks: list[UffDataset]
    by_pair: dict[tuple[Dof, Dof], Dataset58]
    factors: UnitFactors | None
    windows: str


def _read_pairs(path: Path, options: ReadOptions, kinds: Sequence[int], words: str, noun: str) -> _Pairs:
    """Functions of types `kinds` in the universal file at `path` by (response, reference), between the channels of `options`.

    Returns the file's blocks, the functions, the factors of dataset 164 (None if `options.units` is set or the file has none) and
    a note on windows.

    Raises
    ------
    FileError
        If there are none, a pair occurs twice, or a node belongs to several components; `words` describe the functions in
        messages, `noun` a single one.
    InputError
        If an option does not apply to them, names a channel that the file lacks, or channels without a function between
        them.
    """
    other = next((name for name in options.given() if name not in _USED), None)
    if other is not None:
        raise InputError(f"{path}: `{other}` is not about {words.split(' (')[0]}; leave it out", other)
    blocks = read_blocks(path)
    tables = [block for block in blocks if block.number == 58]
    every = [read_function(path, block, ordinal) for ordinal, block in enumerate(tables, 1)]
    functions = [function for function in every if function.kind in kinds]
    if options.columns:
        numbers = [function.ordinal for function in functions]
        names = [f"function {number}" for number in numbers]
        functions = [functions[row] for row in choose_columns(path, options.columns, names, numbers)]
    if not functions:
        raise FileError(f"{path}: holds no {words}; export them, or histories")
    require_one_component(path, functions)
    by_pair: dict[tuple[Dof, Dof], Dataset58] = {}
    with about("channels"):
        wanted = set(parse_dofs(options.channels))
    pairs = [_response_and_reference(path, function) for function in functions]
    present = {dof for pair in pairs for dof in pair}
    if wanted - present:
        raise InputError(
            f"{path}: has no {noun} of {min(map(str, wanted - present))}; it has {', '.join(sorted(map(str, present)))}",
            "channels",
        )
    for pair, function in zip(pairs, functions, strict=True):
        if wanted and not set(pair) <= wanted:
            continue
        if pair in by_pair:
            raise FileError(
                f"{path}: has the {noun} of {pair[0]} and {pair[1]} twice, as functions {by_pair[pair].ordinal} and"
                f" {function.ordinal}; keep one of them"
            )
        by_pair[pair] = function
    if not by_pair:
        shown = ", ".join(f"{response}/{reference}" for response, reference in dict.fromkeys(pairs))
        raise InputError(
            f"{path}: has no {noun} between {' and '.join(sorted(map(str, wanted)))} alone; name the channels of its"
            f" functions: {shown}",
            "channels",
        )
    windows = qualifier_words(path, blocks, {function.ordinal for function in by_pair.values()})
    return _Pairs(blocks, by_pair, None if options.units else read_unit_factors(path, blocks), windows)


def _along_global_axes(
    path: Path,
    blocks: list[UffDataset],
    channels: tuple[Dof, ...],
    references: tuple[Dof, ...],
    quantities: tuple[Quantity, ...],
    values: NumberArray,
    options: ReadOptions,
) -> tuple[tuple[Dof, ...], tuple[Dof, ...], NumberArray, str]:
    """Channels, references and values (n_points, n_channels, n_references) in global axes, and words on the transformation.

    They stay as they are if `options.axes` is "named". `blocks` are those of the file, with nodes and coordinate systems;
    `quantities` are those of the channels.
    """
    if options.axes == "named":
        return channels, references, values, ""
    nodes = read_nodes(path, blocks)
    sides = in_global_axes(path, nodes, channels, quantities), in_global_axes(path, nodes, references)
    left, right = (np.eye(len(side.dofs)) if side.matrix is None else side.matrix for side in sides)
    return sides[0].dofs, sides[1].dofs, left @ values @ right.T, sides[0].words


def _response_and_reference(path: Path, function: Dataset58) -> tuple[Dof, Dof]:
    """Response and reference of a function; both are the response for an autospectrum without a reference.

    `FileError`, which names `path`, if a node or direction of the function is no degree of freedom.
    """
    response = dof_of(path, function.response, "response", function.ordinal)
    if function.reference[1] == 0 and function.kind not in _CROSS:
        return response, response
    return response, dof_of(path, function.reference, "reference", function.ordinal)


def _complete_references(
    path: Path, by_pair: Iterable[tuple[Dof, Dof]], mirrored: Container[tuple[Dof, Dof]], nouns: str
) -> tuple[tuple[Dof, ...], tuple[Dof, ...]]:
    """All channels, and those that have a function with every channel, itself included, by first occurrence.

    `by_pair` are the (response, reference) pairs of the file; those in `mirrored` serve for the reversed pair too.

    Raises
    ------
    FileError
        If no channel has functions (`nouns` in the message) with all others, or a channel is named in both senses.
    """
    by_pair = tuple(by_pair)
    channels = tuple(dict.fromkeys(dof for pair in by_pair for dof in pair))
    if len({dof.unsigned for dof in channels}) < len(channels):
        raise FileError(
            f"{path}: names a channel in both senses ({', '.join(map(str, channels))}); give each its own name"
        )

    def lacking(reference: Dof) -> list[Dof]:
        return [dof for dof in channels if (dof, reference) not in by_pair and (reference, dof) not in mirrored]

    references = tuple(dof for dof in channels if not lacking(dof))
    if not references:
        best = min(channels, key=lambda dof: len(lacking(dof)))
        missing = ", ".join(map(str, lacking(best)[:6]))
        raise FileError(
            f"{path}: no channel has {nouns} to all others; {best} lacks {missing}: {nouns.replace('cross-', 'auto')} alone tell"
            f" no mode shape, export {nouns} to a reference too, or the histories"
        )
    return channels, references


def _densities(path: Path, functions: Sequence[Dataset58]) -> bool:
    """True if all functions are densities (per Hz) by type or label, False if none is; `FileError` if only some are."""
    answers = {function.kind == 9 or _is_per_hertz(function) for function in functions}
    if len(answers) > 1:
        raise FileError(f"{path}: some spectra are densities and some are not; export all with one setting")
    return answers.pop()


def _is_per_hertz(function: Dataset58) -> bool:
    """True if the label or the denominator of a function says that its values are densities."""
    below = function.denominator
    return (
        bool(_PER_HERTZ.search(function.ordinate.label))
        or below.number == _FREQUENCY_TYPE
        or below.label.strip().lower() == "hz"
    )


def _scaled_matrix(
    path: Path,
    by_pair: dict[tuple[Dof, Dof], Dataset58],
    channels: tuple[Dof, ...],
    references: tuple[Dof, ...],
    factors: UnitFactors | None,
    options: ReadOptions,
    values_of: Callable[[Path, Dataset58, tuple[Dof, Dof], bool], NumberArray],
) -> tuple[tuple[Quantity, ...], NumberArray]:
    """Quantities of the channels, and the matrix of functions in SI units, (n_points, n_channels, n_references).

    `values_of(path, function, (response, reference), is_reverse)` returns the values of a function, for the reversed
    pair if `is_reverse`. Units come from `options.units`, or from labels and `factors` (dataset 164). `by_pair` has the
    functions by response and reference. Raises `FileError` if a channel is not of motion, or of two quantities.
    `references` are the channels along the last axis.
    """
    stated: dict[Dof, float] = {}
    quantity_of: dict[Dof, str] = {}
    if options.units:
        quantities, scales = channel_units(path, channels, options)
        stated = dict(zip(channels, scales.tolist(), strict=True))
        quantity_of = dict(zip(channels, quantities, strict=True))
    columns = []
    for reference in references:
        column = []
        for channel in channels:
            function = by_pair.get((channel, reference)) or by_pair[reference, channel]
            response, other = _response_and_reference(path, function)
            values = values_of(path, function, (response, other), (channel, reference) != (response, other))
            if stated:
                factor = stated[response] * stated[other]
            else:
                factor = 1.0
                for dof, label in zip((response, other), _sides(path, function), strict=True):
                    side = replace(function.ordinate, label=label)
                    quantity, part = channel_scale(path, side, dof, factors, "units")
                    if quantity_of.setdefault(dof, quantity) != quantity:
                        raise FileError(
                            f"{path}: {dof} is {quantity_of[dof]} in one function and {quantity} in another"
                        )
                    factor *= part
            column.append(factor * values)
        columns.append(np.stack(column, axis=1))
    for dof, quantity in quantity_of.items():
        if quantity not in ("displacement", "velocity", "acceleration"):
            raise FileError(
                f"{path}: the functions of {dof} are of {quantity}, not of motion; choose others with `columns`"
            )
    return tuple(cast(Quantity, quantity_of[dof]) for dof in channels), np.stack(columns, axis=2)


def _spectrum_values(path: Path, function: Dataset58, pair: tuple[Dof, Dof], is_reverse: bool) -> ComplexArray:
    """Complex values of the spectrum `function`, (n_lines,), conjugated if `is_reverse`.

    `pair` is (response, reference). Raises `FileError` if an autospectrum is not real and positive, or a cross-spectrum
    is real.
    """
    response, reference = pair
    values = np.asarray(function.values, np.complex128)
    if response == reference:
        size = float(np.abs(values).max())
        if size == 0 or (values.real < -_ROUNDED * size).any() or np.abs(values.imag).max() > _ROUNDED * size:
            raise FileError(
                f"{path}: function {function.ordinal}, the autospectrum of {response}, is not positive throughout; export it again"
            )
        return values.real.astype(np.complex128)
    if not np.iscomplexobj(function.values) or not values.imag.any():
        raise FileError(
            f"{path}: function {function.ordinal}, the cross-spectrum of {response} and {reference}, holds real numbers only,"
            " without the phase that tells a mode shape; export complex values"
        )
    return values.conj() if is_reverse else values


def _sides(path: Path, function: Dataset58) -> tuple[str, str]:
    """Unit texts of response and reference, from a label that is their product or square; "" twice without a label.

    Raises `FileError` if the label is neither, or the function has a denominator.
    """
    below = function.denominator
    if below.number in QUANTITIES and below.number not in UNKNOWN:
        raise FileError(
            f"{path}: function {function.ordinal} is one with a motion or force below it: a ratio, perhaps; say the unit"
            f" of the motion: {option_words(units='g')}"
        )
    label = " ".join(function.ordinate.label.split())
    if not label:
        return "", ""
    body = _PER_HERTZ.sub("", label)
    square, split = _SQUARE.fullmatch(body), _SPLIT_SQUARE.fullmatch(body)
    candidates = [(f"{split[1]}/s^2",) * 2] if split else []
    candidates += [(next(part for part in square.groups() if part),) * 2] if square else []
    candidates += [(body[:k], body[k + 1 :]) for k, letter in enumerate(body) if letter in "*.\u00b7 "]
    for left, right in candidates if not _ROOT.search(label) else []:
        if is_read_by(left, parse_unit) and is_read_by(right, parse_unit):
            return left, right
    raise FileError(
        f"{path}: function {function.ordinal} has unit {label!r}, no square or product of motions as g^2/Hz or"
        f" (m/s^2)^2 is; say the unit of the motion where the values are squares of it: {option_words(units='g')}"
    )


def _stated_averages(functions: Sequence[Dataset58]) -> int | None:
    """Number of averages that the titles of all spectra agree on, or None."""
    counts = {int(match["count"]) if (match := AVERAGES.search(f.titles)) else None for f in functions}
    return counts.pop() if len(counts) == 1 else None


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
    blocks, by_pair, factors, windows = _read_pairs(path, options, _CORRELATIONS, words, "correlation function")
    functions = list(by_pair.values())
    to_seconds, axis_words = one_axis_unit(path, functions, "times", options)
    density = next((function for function in functions if _is_per_hertz(function)), None)
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
    channels, references = _complete_references(path, by_pair, mirrored, "cross-correlations")

    def values_of(path: Path, function: Dataset58, pair: tuple[Dof, Dof], is_reverse: bool) -> FloatArray:
        return halves.backward[pair] if is_reverse else halves.forward[pair]

    quantities, values = _scaled_matrix(path, by_pair, channels, references, factors, options, values_of)
    channels, references, values, turned = _along_global_axes(
        path, blocks, channels, references, quantities, values, options
    )
    count = f"{len(functions)} correlation functions between {len(channels)} channels and {len(references)} references"
    note = "; ".join(filter(None, (f"{count}, {FORWARD}", halves.words, axis_words, turned, windows)))
    averages = options.averages if options.averages is not None else _stated_averages(functions)
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
    """Values of a correlation function, (n_lags,); `FileError` if an imaginary part is not 0."""
    if np.iscomplexobj(function.values) and np.any(function.values.imag):
        raise FileError(
            f"{path}: function {function.ordinal}, a correlation function, has complex values; export real ones"
        )
    return np.asarray(np.real(function.values), float)
