"""Frequency response functions of a universal file, assembled to one record."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.errors import FileError, InputError
from structid.core.units import parse_frf_unit
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import positions, selected
from structid.records.formats.uff.blocks import Dataset
from structid.records.formats.uff.scales import (
    UNKNOWN,
    Factors,
    Side,
    channel_scale,
    dof_of,
    sides,
    unit_factors,
    whole_unit,
)
from structid.records.record import FrfKind, FrfRecord, TimeRecord
from structid.records.transforms.spectra import KINDS

AVERAGES = re.compile(r"\baverages[ =:]+(?P<count>\d+)\b", re.IGNORECASE)
_TITLES: Final = ("id1", "id2", "id3", "id4", "id5")

Pair = tuple[Dof, Dof]


class _Function(NamedTuple):
    kind: FrfKind
    frequency: FloatArray
    values: ComplexArray


def read_frfs(
    path: Path,
    found: list[Dataset],
    frfs: list[Dataset],
    coherences: list[Dataset],
    options: ReadOptions,
) -> FrfRecord | TimeRecord:
    """One record of the datasets `frfs`, or of the outputs and inputs among them that `options` name.

    Raises
    ------
    FileError
        If pairs are missing or doubled, or kinds or frequencies differ.
    """
    factors = unit_factors(path, found)
    by_pair = _by_pair(path, frfs, "FRF")
    outputs = _chosen(path, "outputs", options.outputs, [pair[0] for pair in by_pair])
    inputs = _chosen(path, "inputs", options.inputs, [pair[1] for pair in by_pair])
    pairs = [(output, load) for output in outputs for load in inputs]
    missing = [f"{output}/{load}" for output, load in pairs if (output, load) not in by_pair]
    if missing:
        raise FileError(
            f"{path}: has no FRF of {', '.join(missing[:12])}{' ...' if len(missing) > 12 else ''} (output/input), "
            f"but of the other pairs; choose a complete set with {option_words(outputs=None, inputs=None)}"
        )
    functions = [_function(path, by_pair[pair], pair, factors, options) for pair in pairs]
    _require_alike(path, pairs, functions)
    shape = (functions[0].frequency.size, len(outputs), len(inputs))
    record = FrfRecord(
        frequency=functions[0].frequency,
        values=np.stack([f.values for f in functions], axis=1).reshape(shape),
        outputs=outputs,
        inputs=inputs,
        kind=functions[0].kind,
        coherence=_coherence(path, coherences, outputs, inputs, functions[0].frequency),
        averages=_averages(frfs),
        source=str(path),
    )
    return selected(path, record, _without_unit(options))


def _without_unit(options: ReadOptions) -> ReadOptions:
    return ReadOptions(kind=options.kind, averages=options.averages, sampling_rate=options.sampling_rate,
                       channels=options.channels)  # fmt: skip


def _chosen(path: Path, name: str, texts: tuple[str, ...], present: list[Dof]) -> tuple[Dof, ...]:
    distinct = tuple(dict.fromkeys(present))
    return tuple(distinct[i] for i in positions(path, name, texts, distinct))


def _pair_of(path: Path, dataset: Dataset) -> Pair:
    output = dof_of(path, int(dataset["rsp_node"]), int(dataset["rsp_dir"]), "response")
    return output, dof_of(path, int(dataset["ref_node"]), int(dataset["ref_dir"]), "reference")


def _by_pair(path: Path, functions: list[Dataset], word: str) -> dict[Pair, Dataset]:
    found: dict[Pair, Dataset] = {}
    for dataset in functions:
        pair = _pair_of(path, dataset)
        if pair in found:
            raise FileError(f"{path}: has the {word} of {pair[0]}/{pair[1]} twice; keep one of them")
        found[pair] = dataset
    return found


def _function(path: Path, dataset: Dataset, pair: Pair, factors: Factors | None, options: ReadOptions) -> _Function:
    kind, factor = _frf_scale(path, dataset, pair, factors, options)
    values = np.asarray(dataset["data"], dtype=np.complex128)
    return _Function(kind, np.asarray(dataset["x"][: values.size], float), values * factor)


def _frf_scale(
    path: Path, dataset: Dataset, pair: Pair, factors: Factors | None, options: ReadOptions
) -> tuple[FrfKind, float]:
    """Kind and factor to SI of one FRF: by the option `unit`, or by types, labels and dataset 164."""
    if options.unit:
        unit = parse_frf_unit(options.unit)
        if unit.output_rotation == pair[0].is_rotation and unit.input_rotation == pair[1].is_rotation:
            return unit.kind, unit.factor
        raise InputError(f"{path}: `unit` {options.unit!r} does not fit the directions of {pair[0]}/{pair[1]}")
    above, below = sides(dataset)
    whole = whole_unit(above)
    if whole is None:
        return _scale_by_sides(path, above, below, pair, factors)
    kind, factor = _scale_by_sides(path, *_split(whole.kind, above, below), pair, factors)
    if factors is None:
        return whole.kind, whole.factor
    if whole.kind != kind or not np.isclose(whole.factor, factor, rtol=1e-4):
        raise FileError(
            f"{path}: the FRF of {pair[0]}/{pair[1]} has unit {above.label!r}, "
            f"which does not fit its data types and dataset 164; tell which is right with {option_words(unit=None)}"
        )
    return kind, factor


def _scale_by_sides(path: Path, above: Side, below: Side, pair: Pair, factors: Factors | None) -> tuple[FrfKind, float]:
    quantity, above_factor = channel_scale(path, above, pair[0], factors)
    load, below_factor = channel_scale(path, below, pair[1], factors)
    if quantity == load != "force":
        return "transmissibility", above_factor / below_factor
    if quantity == "force" or load != "force":
        raise FileError(
            f"{path}: the FRF of {pair[0]}/{pair[1]} is {quantity} per {load}, not a motion per force or per the same motion; "
            "leave it out of the export"
        )
    return KINDS[quantity], above_factor / below_factor


def _split(kind: FrfKind, above: Side, below: Side) -> tuple[Side, Side]:
    """Both sides of a dataset whose numerator's label is of the whole FRF, of this kind: without labels, types by its kind."""
    types = {"receptance": 8, "mobility": 11, "accelerance": 12, "transmissibility": 12}
    load = 12 if kind == "transmissibility" else 13
    return (
        Side(types[kind] if above.number in UNKNOWN else above.number, ""),
        Side(load if below.number in UNKNOWN else below.number, ""),
    )


def _require_alike(path: Path, pairs: list[Pair], functions: list[_Function]) -> None:
    first = functions[0]
    for (output, load), function in zip(pairs, functions, strict=True):
        if function.kind != first.kind:
            raise FileError(
                f"{path}: the FRF of {output}/{load} is {function.kind}, others are {first.kind}; choose "
                f"outputs of one kind with {option_words(outputs=None)}"
            )
        _require_axis(path, f"the FRF of {output}/{load}", function.frequency, first.frequency)


def _require_axis(path: Path, what: str, axis: FloatArray, first: FloatArray) -> None:
    if axis.shape != first.shape or np.abs(axis - first).max() > 1e-6 * np.abs(first).max():
        raise FileError(f"{path}: {what} has other frequencies than the first; export all with one setting")


def _coherence(
    path: Path, functions: list[Dataset], outputs: tuple[Dof, ...], inputs: tuple[Dof, ...], axis: FloatArray
) -> FloatArray | None:
    """Coherence of every pair, or None unless the file has it for every pair."""
    found: dict[Pair, FloatArray] = {}
    for dataset in functions:
        if int(dataset["ref_dir"]) == 0:
            output = dof_of(path, int(dataset["rsp_node"]), int(dataset["rsp_dir"]), "response")
            pairs = [(output, load) for load in inputs]
        else:
            pairs = [_pair_of(path, dataset)]
        values = np.asarray(dataset["data"]).real.astype(float)
        for pair in pairs:
            if pair in found:
                raise FileError(f"{path}: has the coherence of {pair[0]}/{pair[1]} twice; keep one of them")
            found[pair] = values
        _require_axis(path, f"the coherence of {pairs[0][0]}", np.asarray(dataset["x"][: values.size], float), axis)
    if not found or any((output, load) not in found for output in outputs for load in inputs):
        return None
    stacked = [[found[output, load] for load in inputs] for output in outputs]
    return np.moveaxis(np.array(stacked), -1, 0)


def _averages(frfs: list[Dataset]) -> int | None:
    """Number of averages that the title lines of all FRFs agree on, or None."""
    counts = set()
    for dataset in frfs:
        text = " ".join(str(dataset.get(key, "")) for key in _TITLES)
        match = AVERAGES.search(text)
        counts.add(int(match["count"]) if match else None)
    return counts.pop() if len(counts) == 1 else None
