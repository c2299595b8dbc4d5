"""Modes of one structure followed over its records: which mode of one record is which of the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.modal.merging import common_sensors, pair_worth, rows_and_signs
from structid.modal.modal_record import ModalRecord
from structid.modal.shape_uncertainty import mac_with_std
from structid.similarity import assign_pairs

_LEAST_WORTH = 0.5  # of a mode beside the last one of its track
_LEAST_RECORDS = 2  # in which a mode must be seen, to be a track


@dataclass(frozen=True, eq=False)
class ModeTracks:
    """Modes that are seen in several records.

    Attributes
    ----------
    names : tuple of str
        What the records are called.
    members : (n_records, n_tracks) int array
        Number (from 0) of the mode in every record; -1 where it was not seen.
    frequency, frequency_std, damping_ratio, damping_std : (n_records, n_tracks) float arrays
        Hz and 1; NaN where the mode was not seen.
    likeness, likeness_std : (n_records, n_tracks) float arrays
        MAC with the last record that shows the mode, at the sensors that all records have, and its standard deviation by the
        errors of both shapes; NaN for the first.
    alone : tuple of (int, float)
        Record, and frequency in Hz, of modes that no other record shows.
    """

    names: tuple[str, ...]
    members: IntArray
    frequency: FloatArray
    frequency_std: FloatArray
    damping_ratio: FloatArray
    damping_std: FloatArray
    likeness: FloatArray
    likeness_std: FloatArray
    alone: tuple[tuple[int, float], ...]

    @property
    def n_tracks(self) -> int:
        return self.members.shape[1]

    @property
    def change(self) -> FloatArray:
        """Relative change of frequency from the first record that shows the mode, (n_records, n_tracks); NaN where not seen."""
        first = np.array([column[np.isfinite(column)][0] for column in self.frequency.T])
        return np.asarray(self.frequency / first - 1)


def track_modes(
    records: Sequence[ModalRecord], names: Sequence[str] | None = None, frequency_guard: float = 0.1
) -> ModeTracks:
    """Modes tracked over several modal records, by frequency and MAC.

    Each record is paired with the tracks so far so that the sum of the worth of its pairs is as large as possible. A
    mode and the last mode of a track are worth MAC times 1 / (1 + (log(f / f_last) / guard)^2); below one half the mode
    begins a new track. A track may pause, and drift without limit; modes seen in one record only are listed in `alone`.

    Parameters
    ----------
    records : sequence of ModalRecord
        Two or more, in the order in which modes are followed, with a sensor in common.
    names : sequence of str, optional
        Names of the records; by default "record 1" and so on.
    frequency_guard : float
        A pair is worth half as much at this logarithmic distance in frequency.

    Returns
    -------
    ModeTracks
        Tables (n_records, n_tracks) of mode indices (from 0, -1 where missing), frequencies, damping ratios, standard
        deviations (NaN where missing) and MAC with the last record of the track, tracks by mean frequency.

    Raises
    ------
    InputError
        If there are fewer than two records, they have no sensor in common, or no mode is seen twice.
    """
    called = tuple(names) if names is not None else tuple(f"record {i}" for i in range(1, len(records) + 1))
    if len(records) < 2:
        raise InputError(f"`records` must be two or more for modes to be followed, got {len(records)}")
    shared = common_sensors([record.channels for record in records], None, called)
    tracks: list[dict[int, int]] = []
    alike: list[dict[int, float]] = []
    for number, record in enumerate(records):
        unpaired = set(range(record.n_modes))
        if tracks and record.n_modes:
            last = [max(members) for members in tracks]
            likeness, worth = np.zeros((2, record.n_modes, len(tracks)))
            for before in set(last):
                mac, value = pair_worth(record, records[before], shared, frequency_guard)
                for track in (track for track, seen in enumerate(last) if seen == before):
                    likeness[:, track], worth[:, track] = (part[:, tracks[track][before]] for part in (mac, value))
            for mode, track in zip(*assign_pairs(worth), strict=True):
                if worth[mode, track] >= _LEAST_WORTH:
                    tracks[track][number] = int(mode)
                    alike[track][number] = float(likeness[mode, track])
                    unpaired.discard(int(mode))
        tracks += [{number: mode} for mode in sorted(unpaired)]
        alike += [{} for _ in unpaired]
    kept = [i for i, track in enumerate(tracks) if len(track) >= _LEAST_RECORDS]
    if not kept:
        raise InputError(
            f"{', '.join(called)} have no mode in common: no MAC at the shared sensors with a frequency nearby; check the"
            " senses of the sensors, or widen `frequency_guard`"
        )
    kept.sort(key=lambda i: np.mean([records[n].frequency[m] for n, m in tracks[i].items()]))
    members = np.array([[tracks[i].get(n, -1) for i in kept] for n in range(len(records))], dtype=int)
    alone = [(n, float(records[n].frequency[m])) for t in tracks if len(t) < _LEAST_RECORDS for n, m in t.items()]
    frequency, frequency_std, damping, damping_std = (
        np.array([np.append(values, np.nan)[row] for values, row in zip(every, members, strict=True)])
        for every in (
            [record.frequency for record in records],
            [record.frequency_std for record in records],
            [record.damping_ratio for record in records],
            [record.std[record.n_modes :] for record in records],
        )
    )
    likeness = np.array([[alike[i].get(n, np.nan) for i in kept] for n in range(len(records))])
    return ModeTracks(
        called, members, frequency, frequency_std, damping, damping_std, likeness,
        _likeness_std([_at_sensors(record, shared) for record in records], members), tuple(sorted(alone)),
    )  # fmt: skip


def _at_sensors(record: ModalRecord, sensors: Sequence[Dof]) -> ModalRecord:
    """The modes of `record` at `sensors` (positive directions) alone, in this order, with signs of shapes turned."""
    rows, signs = rows_and_signs(record, sensors)
    few = record.some_channels(rows)
    changes = few.changes and replace(few.changes, mode_shapes=signs * few.changes.mode_shapes)
    return replace(few, channels=tuple(sensors), mode_shapes=signs * few.mode_shapes, changes=changes)


def _likeness_std(records: Sequence[ModalRecord], members: IntArray) -> FloatArray:
    """Standard deviation of the MAC of each mode with the last record that shows it, (n_records, n_tracks).

    `records` have the same channels. `members` (n_records, n_tracks) are the mode indices (from 0) of each track, -1
    where it is missing; there, and in the first record of a track, the result is NaN.
    """
    std, pairs = np.full(members.shape, np.nan), dict[tuple[int, int], FloatArray]()
    for k, track in enumerate(members.T):
        seen = np.flatnonzero(track >= 0).tolist()
        for before, after in pairwise(seen):
            if (before, after) not in pairs:
                pairs[before, after] = mac_with_std(records[before], records[after]).std
            std[after, k] = pairs[before, after][track[before], track[after]]
    return std
