"""Frequency response functions of a universal file, assembled to one record."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof, as_dof, parse_dofs
from structid.core.errors import FileError, InputError, about
from structid.core.units import parse_frf_unit
from structid.files.uff.datasets import UnitFactors
from structid.files.uff.geometry import UniversalNodes
from structid.records.formats.gaps import source_with_note
from structid.records.formats.headers import states_unit
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import positions, select_channels
from structid.records.formats.uff.channels import SI_UNITS, UNKNOWN, channel_scale, dof_of, in_global_axes, whole_unit
from structid.records.formats.uff.functions import Characteristics, Dataset58, one_axis_unit
from structid.records.record import FrfKind, FrfRecord, TimeRecord
from structid.records.spectra import KINDS

AVERAGES = re.compile(r"\baverages[ =:]+(?P<count>\d+)\b", re.IGNORECASE)
_TRANSMISSIBILITY = 5
#: Points from which on a response that is real and positive throughout is no chance.
_SEVERAL = 8

Pair = tuple[Dof, Dof]


class _Response(NamedTuple):
    kind: FrfKind
    frequency: FloatArray
    values: ComplexArray


def read_frfs(
    path: Path,
    frfs: Sequence[Dataset58],
    coherences: Sequence[Dataset58],
    factors: UnitFactors | None,
    nodes: UniversalNodes | None,
    options: ReadOptions,
) -> tuple[FrfRecord | TimeRecord, bool]:
    """The FRF record made of the functions `frfs`, or of the outputs and inputs among them that `options` name.

    Parameters
    ----------
    path : Path
        File, for messages and for the record's source.
    frfs, coherences : sequence of Dataset58
        FRFs to be read, and all coherences of the file.
    factors : UnitFactors, optional
        Unit factors of dataset 164.
    nodes : UniversalNodes, optional
        Nodes whose local axes name the sensors and loads; None if their names are taken as they are.
    options : ReadOptions

    Returns
    -------
    record : FrfRecord
    has_coherence : bool
        True if the record contains the coherences: if there is one for every pair, and no values were transformed.

    Raises
    ------
    FileError
        If pairs are missing or doubled, a response is a magnitude alone, or kinds or frequencies differ.
    InputError
        If `options` name a channel that no function has, or do not fit the file.
    """
    by_pair = _functions_by_pair(path, frfs, options)
    named = bool(options.columns) and bool(options.outputs or options.inputs)
    outputs = _choose_dofs(path, "outputs", () if named else options.outputs, [pair[0] for pair in by_pair])
    inputs = _choose_dofs(path, "inputs", () if named else options.inputs, [pair[1] for pair in by_pair])
    pairs = [(output, load) for output in outputs for load in inputs]
    missing = [f"{output}/{load}" for output, load in pairs if (output, load) not in by_pair]
    if missing:
        raise FileError(
            f"{path}: has no FRF of {', '.join(missing[:12])}{' ...' if len(missing) > 12 else ''} (output/input), "
            f"but of the other pairs; choose a complete set with {option_words(outputs=None, inputs=None)}"
        )
    functions = [by_pair[pair] for pair in pairs]
    to_hertz, axis_words = one_axis_unit(path, functions, "frequencies", options)
    responses = [
        _make_response(path, function, pair, to_hertz, factors, options)
        for function, pair in zip(functions, pairs, strict=True)
    ]
    _require_alike(path, pairs, responses)
    frequency = responses[0].frequency
    values = np.stack([response.values for response in responses], axis=1).reshape(-1, len(outputs), len(inputs))
    coherence = _stack_coherence(path, coherences, by_pair, outputs, inputs, frequency, to_hertz)
    turned_words = ""
    if nodes is not None and not named:
        sensors, loads = in_global_axes(path, nodes, outputs), in_global_axes(path, nodes, inputs, is_load=True)
        outputs, inputs = sensors.dofs, loads.dofs
        if sensors.matrix is not None or loads.matrix is not None:
            left = np.eye(len(outputs)) if sensors.matrix is None else sensors.matrix
            right = np.eye(len(inputs)) if loads.matrix is None else loads.matrix
            values, coherence = left @ values @ right.T, None
        turned_words = ", ".join(filter(None, (sensors.words, loads.words and f"of loads {loads.words}")))
    record = FrfRecord(
        frequency=frequency,
        values=values,
        outputs=outputs,
        inputs=inputs,
        kind=responses[0].kind,
        coherence=coherence,
        averages=_averages(functions),
        source=source_with_note(
            path, "; ".join(filter(None, (_unit_words(functions, options), axis_words, turned_words)))
        ),
    )
    rest = ReadOptions(kind=options.kind, averages=options.averages, sampling_rate=options.sampling_rate,
                       channels=options.channels)  # fmt: skip
    return select_channels(path, record, rest), coherence is not None


def _unit_words(functions: Sequence[Dataset58], options: ReadOptions) -> str:
    """Note on the unit of the FRFs: that of `options.unit`, and labels that differ, or else labels that are not SI.

    It is "" if the option is not set and all labels are SI. `functions` are the FRFs that were read.
    """
    labels = {(f.ordinate.label, f.denominator.label) for f in functions}
    if options.unit:
        stated = [
            " per ".join(filter(None, pair))
            for pair in sorted(labels)
            if any(pair) and not states_unit(f"({pair[0]})/({pair[1]})", options.unit, parse_frf_unit)
        ]
        beside = f", though the file says {', '.join(stated)}" if stated else ""
        return f"in {options.unit} as given{beside}"
    other = [pair for pair in sorted(labels) if not set(pair) <= SI_UNITS]
    return f"in {', '.join(' per '.join(filter(None, pair)) for pair in other)}" if other else ""


def _choose_dofs(path: Path, name: str, texts: tuple[str, ...], present: list[Dof]) -> tuple[Dof, ...]:
    distinct = tuple(dict.fromkeys(present))
    return tuple(distinct[i] for i in positions(path, name, texts, distinct))


def _functions_by_pair(path: Path, functions: Sequence[Dataset58], options: ReadOptions) -> dict[Pair, Dataset58]:
    """Functions by (output, input), named by the file, or by `options` for functions that `columns` chooses.

    A single name in `outputs` or `inputs` then holds for all functions. Functions without a direction are left out if
    `options` name others. Raises `FileError` if a pair occurs twice; without `columns`, of a pair that `options` do not
    ask for the first is kept. `InputError` if, with `columns`, `outputs` or `inputs` are neither 1 nor as many as the
    functions.
    """
    named: dict[str, tuple[Dof, ...]] = {}
    for name in ("outputs", "inputs"):
        texts = getattr(options, name)
        if not (options.columns and texts):
            continue
        with about(name):
            dofs = parse_dofs(texts)
        if len(dofs) not in (1, len(functions)):
            raise InputError(
                f"{path}: `{name}` must have 1 or {len(functions)} entries, one for each of the functions chosen by `columns`, got"
                f" {len(dofs)}",
                name,
            )
        named[name] = dofs * len(functions) if len(dofs) == 1 else dofs
    wanted = {name: {as_dof(text) for text in getattr(options, name)} for name in ("outputs", "inputs")}
    by_pair: dict[Pair, Dataset58] = {}
    for i, function in enumerate(functions):
        sides = []
        for name, node_and_direction, role in (
            ("outputs", function.response, "response"),
            ("inputs", function.reference, "reference"),
        ):
            if name in named:
                sides.append(named[name][i])
            elif node_and_direction[1] == 0 and wanted[name]:  # a scalar that is not asked for
                break
            else:
                sides.append(dof_of(path, node_and_direction, role, function.ordinal))
        if len(sides) < 2:
            continue
        pair = (sides[0], sides[1])
        if pair in by_pair and not options.columns and not _is_wanted(pair, wanted):
            continue
        if pair in by_pair:
            raise FileError(
                f"{path}: has the FRF of {pair[0]}/{pair[1]} twice, as functions {by_pair[pair].ordinal} and {function.ordinal};"
                " keep one of them, or choose functions by their numbers with `columns`"
            )
        by_pair[pair] = function
    return by_pair


def _is_wanted(pair: Pair, wanted: dict[str, set[Dof | None]]) -> bool:
    return all(not dofs or dof in dofs for dof, dofs in zip(pair, wanted.values(), strict=True))


def _make_response(
    path: Path,
    function: Dataset58,
    pair: Pair,
    to_hertz: float,
    factors: UnitFactors | None,
    options: ReadOptions,
) -> _Response:
    """Kind, frequencies in Hz and complex values in SI of an FRF, (n_frequencies,) each.

    `pair` is (output, input), `to_hertz` the factor from the abscissa to Hz, `factors` are those of dataset 164, None
    without. Raises `FileError` if the values are real, or kind and function type disagree.
    """
    values = function.values
    if not np.iscomplexobj(values) or _is_padded_magnitude(values):
        raise FileError(
            f"{path}: function {function.ordinal}, the FRF of {pair[0]}/{pair[1]}, holds real numbers only: a magnitude without its"
            " phase, or one part of a response, which tells no motion; export complex values (real and imaginary part)"
        )
    kind, factor = _frf_scale(path, function, pair, factors, options)
    if function.kind == _TRANSMISSIBILITY and kind != "transmissibility":
        raise FileError(
            f"{path}: function {function.ordinal}, of {pair[0]}/{pair[1]}, is a transmissibility by its function type and {kind} by"
            f" its units; correct one of them, or say the unit: {option_words(unit=None)}"
        )
    return _Response(kind, function.axis * to_hertz, np.asarray(values, np.complex128) * factor)


def _is_padded_magnitude(values: FloatArray | ComplexArray) -> bool:
    """True if complex values are a magnitude with imaginary parts of 0, as some programs write it."""
    return values.size >= _SEVERAL and not values.imag.any() and bool((values.real > 0).all())


def _frf_scale(
    path: Path, function: Dataset58, pair: Pair, factors: UnitFactors | None, options: ReadOptions
) -> tuple[FrfKind, float]:
    """Kind and factor to SI of the FRF `function`, from `options.unit`, or from data types, labels and dataset 164.

    `pair` is (output, input), `factors` are those of dataset 164, None without. Raises `InputError` if the option does
    not fit the directions, `FileError` if types, labels, dataset 164 and directions contradict each other.
    """
    if options.unit:
        unit = parse_frf_unit(options.unit)
        if unit.output_rotation == pair[0].is_rotation and unit.input_rotation == pair[1].is_rotation:
            return unit.kind, unit.factor
        raise InputError(f"{path}: `unit` {options.unit!r} does not fit the directions of {pair[0]}/{pair[1]}")
    above, below = function.ordinate, function.denominator
    whole = whole_unit(path, above, below)
    if whole is None:
        return _scale_by_sides(path, above, below, pair, factors)
    if (whole.output_rotation, whole.input_rotation) != (pair[0].is_rotation, pair[1].is_rotation):
        raise FileError(
            f"{path}: the unit {above.label!r} does not fit the directions of {pair[0]}/{pair[1]}; correct one of them"
        )
    kind, factor = _scale_by_sides(
        path, *_unlabelled_kinds(whole.kind, above, below), pair, factors or UnitFactors(1.0, 1.0)
    )
    if whole.kind != kind or (factors is not None and not np.isclose(whole.factor, factor, rtol=1e-4)):
        raise FileError(
            f"{path}: the FRF of {pair[0]}/{pair[1]} has unit {above.label!r}, "
            f"which does not fit its data types and dataset 164; tell which is right with {option_words(unit=None)}"
        )
    return whole.kind, whole.factor


def _scale_by_sides(
    path: Path, above: Characteristics, below: Characteristics, pair: Pair, factors: UnitFactors | None
) -> tuple[FrfKind, float]:
    """Kind and factor to SI of an FRF, from the characteristics of ordinate (`above`) and denominator (`below`).

    `pair` is (output, input), `factors` are those of dataset 164, None without. Raises `FileError` unless it is a
    motion per force, or a motion per the same motion (transmissibility), and its units are stated.
    """
    by_labels = f"({above.label})/({below.label})" if above.label and below.label else ""
    quantity, above_factor = channel_scale(path, above, pair[0], factors, "unit", by_labels)
    load, below_factor = channel_scale(path, below, pair[1], factors, "unit", by_labels)
    if quantity == load != "force":
        return "transmissibility", above_factor / below_factor
    if quantity == "force" or load != "force":
        raise FileError(
            f"{path}: the FRF of {pair[0]}/{pair[1]} is {quantity} per {load}, not a motion per force or per the same motion; "
            "leave it out of the export"
        )
    return KINDS[quantity], above_factor / below_factor


def _unlabelled_kinds(
    kind: FrfKind, above: Characteristics, below: Characteristics
) -> tuple[Characteristics, Characteristics]:
    """Ordinate and denominator of an FRF of this kind without labels, for a label of `above` that covers the whole FRF.

    Unknown data types are replaced by those of the kind.
    """
    types = {"receptance": 8, "mobility": 11, "accelerance": 12, "transmissibility": 12}
    load = 12 if kind == "transmissibility" else 13
    return (
        replace(above, number=types[kind] if above.number in UNKNOWN else above.number, label=""),
        replace(below, number=load if below.number in UNKNOWN else below.number, label=""),
    )


def _require_alike(path: Path, pairs: list[Pair], responses: list[_Response]) -> None:
    """Raise `FileError` unless all `responses`, one for each of `pairs`, have the kind and the frequencies of the first."""
    first = responses[0]
    for (output, load), response in zip(pairs, responses, strict=True):
        if response.kind != first.kind:
            raise FileError(
                f"{path}: the FRF of {output}/{load} is {response.kind}, others are {first.kind}; choose "
                f"outputs of one kind with {option_words(outputs=None)}"
            )
        _require_axis(path, f"the FRF of {output}/{load}", response.frequency, first.frequency)


def _require_axis(path: Path, what: str, axis: FloatArray, first: FloatArray) -> None:
    if axis.shape != first.shape or np.abs(axis - first).max() > 1e-6 * np.abs(first).max():
        raise FileError(f"{path}: {what} has other frequencies than the first; export all with one setting")


def _stack_coherence(
    path: Path,
    coherences: Sequence[Dataset58],
    by_pair: dict[Pair, Dataset58],
    outputs: tuple[Dof, ...],
    inputs: tuple[Dof, ...],
    frequency: FloatArray,
    to_hertz: float,
) -> FloatArray | None:
    """Coherences of all pairs, (n_frequencies, n_outputs, n_inputs); None unless the file has one for every pair.

    `by_pair` are the FRFs that they belong to, `frequency` (n_frequencies,) the lines in Hz that they must share, and
    `to_hertz` the factor from their abscissa to Hz. Raises `FileError` if a pair has two, one is complex, or has other
    lines. `coherences` are all coherences of the file; `outputs` and `inputs` are those of the axes.
    """
    of_pair: dict[Pair, FloatArray] = {}
    for function in coherences:
        for pair in [(output, load) for output in outputs for load in inputs]:
            if not _belongs(function, by_pair[pair]):
                continue
            if pair in of_pair:
                raise FileError(f"{path}: has the coherence of {pair[0]}/{pair[1]} twice; keep one of them")
            axis = function.axis * to_hertz
            _require_axis(path, f"the coherence of {pair[0]}/{pair[1]}", axis, frequency)
            if np.iscomplexobj(function.values) and function.values.imag.any():
                raise FileError(f"{path}: function {function.ordinal}, a coherence, is complex; export it again")
            of_pair[pair] = function.values.real.astype(float)
    if any((output, load) not in of_pair for output in outputs for load in inputs):
        return None
    stacked = [[of_pair[output, load] for load in inputs] for output in outputs]
    return np.moveaxis(np.array(stacked), -1, 0)


def _belongs(coherence: Dataset58, frf: Dataset58) -> bool:
    """True if a coherence belongs to an FRF: same response and reference, or no reference in the coherence."""
    return coherence.response == frf.response and coherence.reference[1] in (0, frf.reference[1]) and (
        coherence.reference[1] == 0 or coherence.reference == frf.reference
    )  # fmt: skip


def _averages(frfs: Sequence[Dataset58]) -> int | None:
    """Number of averages in the title lines of `frfs`, if all state the same; else None."""
    counts = set()
    for function in frfs:
        match = AVERAGES.search(function.titles)
        counts.add(int(match["count"]) if match else None)
    return counts.pop() if len(counts) == 1 else None
