"""Modes of several set-ups from their records: each identified, merged, and what one of them lost looked for again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.core.arrays import IntArray
from structid.core.display import file_names
from structid.core.errors import NoModesError
from structid.modal.full_field import at_all_channels
from structid.modal.identification import modal_identification
from structid.modal.merging import MergedModes, merged_setups
from structid.modal.method import ModalIdentification
from structid.modal.modal_record import ModalRecord, joined
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.survey import (
    ModesResult,
    modes_provenance,
    rate_for,
    read_and_identify,
    shared_or_whole,
)
from structid.records import FrfRecord, Preparation, ReadOptions, Record, TimeRecord, prepare
from structid.similarity import mac

_NEAR = 0.02  # of a frequency: how far from the other set-ups' a mode is looked for again
_ONE_SHAPE = 0.7  # MAC that it must have with theirs at the sensors that both know


def modes_of_setups(
    paths: Sequence[str | Path],
    options: ModesOptions | None = None,
    read: ReadOptions | None = None,
    geometry: str | Path | None = None,
) -> ModesResult:
    """Modes of one structure from several set-ups with common reference sensors, identified and merged.

    A mode that two set-ups or more have, and one has not, is looked for in that one's record at the others' frequency.
    The record and the spectra of the result are those of the first set-up. `paths` are the files of the set-ups;
    `geometry` is a file of node positions or None; None for `options` and `read` takes their defaults.

    Raises
    ------
    InputError
        If a file or an option cannot be used, or set-ups have no sensor or no mode in common.
    NoModesError
        If a set-up shows no stable mode.
    """
    names = file_names(paths)
    each = [read_and_identify(Path(path), options or ModesOptions(), read, geometry, alone=False) for path in paths]
    first, own = each[0], [result.modes for result in each]
    merging = merged_setups(own, names=names)
    recovered = [recovered_modes(result, merging, number) for number, result in enumerate(each)]
    if any(modes is not None for modes in recovered):
        own = [
            before if more is None else joined([before, more], before.warnings, before.source)
            for before, more in zip(own, recovered, strict=True)
        ]
        merging = merged_setups(own, names=names)
    identification = ModalIdentification(
        merging.modes, first.identification.method, options=first.identification.options
    )
    steps = [
        f"{result.title}: {words}" for result in each for words in (*result.steps, f"{result.modes.n_modes} modes")
    ]
    for result, modes in zip(each, recovered, strict=True):
        if modes is not None:
            listed = ", ".join(f"{f:.4g}" for f in modes.frequency)
            steps.append(f"{result.title}: found again at the frequencies of other set-ups: {listed} Hz")
    return replace(
        first,
        title=", ".join(result.title for result in each),
        identification=identification,
        spectra=replace(first.spectra, name=f"{first.spectra.name}, of {first.title}"),
        geometry=next((result.geometry for result in each if result.geometry is not None), None),
        provenance=modes_provenance((*paths, geometry), first.options, read),
        steps=tuple(steps),
        findings=tuple(replace(f, words=f"{result.title}: {f.words}") for result in each for f in result.findings),
        kurtosis=np.full(merging.modes.n_modes, np.nan),
        tones=tuple(tone for result in each for tone in result.tones),
    )


def recovered_modes(result: ModesResult, merging: MergedModes, number: int) -> ModalRecord | None:
    """Modes that set-up `number` (from 0) lacks in `merging` but its record shows near the merged frequency.

    `result` is that of the set-up. Only modes within its frequency limits are searched for, and only in time records
    and FRFs. None if there are none.
    """
    lost = np.flatnonzero(merging.members[number] < 0)
    limits = result.identification.options.criteria.frequency
    lost = lost[(merging.modes.frequency[lost] > limits[0]) & (merging.modes.frequency[lost] < limits[1])]
    if not len(lost) or not isinstance(result.record, TimeRecord | FrfRecord):
        return None
    wanted = tuple(merging.modes.frequency[lost].tolist())
    record: Record = result.record
    if isinstance(record, TimeRecord):
        rate = rate_for(record, ModesOptions(frequencies=wanted))
        record = prepare(record, Preparation(detrend="none", sampling_rate=rate)).record
    looked_at, motions = shared_or_whole(record)
    settings = replace(result.options.modal, frequencies=wanted, orders=None)
    try:
        again = modal_identification(looked_at, result.options.method, settings)
    except NoModesError:
        return None
    if motions is not None and isinstance(record, TimeRecord):
        again = at_all_channels(again, motions, record.channels)
    kept = _wanted_modes(again.modes, merging.modes, lost, result.modes)
    return again.modes.some_modes(kept) if len(kept) else None


def _wanted_modes(again: ModalRecord, merged: ModalRecord, lost: IntArray, present: ModalRecord) -> IntArray:
    """Indices, increasing, of modes of `again` that match the `lost` modes of `merged` and are not among `present`.

    A match is within 2 % in frequency, has a MAC of 0.7 or more over the known entries, and a standard deviation of
    frequency not above the half-power bandwidth, if it is known; of several the greatest MAC decides. `lost` (n_lost,)
    are indices of modes of `merged`; `present` are modes the set-up already has. `again` are the modes of its record
    near the lost ones.
    """
    places = {dof.unsigned: i for i, dof in enumerate(merged.channels)}
    rows = np.array([places[dof.unsigned] for dof in again.channels])
    sign = np.array([dof.sign for dof in again.channels])[:, None]
    theirs, seen = merged.mode_shapes[rows] * sign, again.mode_shapes
    kept = []
    for mode in lost.tolist():
        near = np.abs(again.frequency / merged.frequency[mode] - 1)
        known = ~np.isnan(theirs[:, mode])
        likeness = mac(seen[known], theirs[known][:, [mode]])[:, 0] if known.any() else np.zeros(again.n_modes)
        width = 2 * np.abs(again.damping_ratio) * again.frequency
        is_sure = ~(again.frequency_std > width)
        is_new = np.ones(again.n_modes, dtype=bool)
        if present.n_modes:
            same = np.abs(again.frequency[:, None] - present.frequency) <= 0.5 * width[:, None]
            is_new &= ~(same & (mac(seen, present.mode_shapes) > _ONE_SHAPE)).any(axis=1)
        good = np.flatnonzero((near <= _NEAR) & (likeness >= _ONE_SHAPE) & is_sure & is_new)
        if len(good):
            kept.append(int(good[likeness[good].argmax()]))
    return np.unique(np.array(kept, dtype=np.int64))
