"""Gaps in time histories as files hold them (NaN, infinite or empty entries): named, cut away or filled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import sample_range
from structid.records.quality import fill_missing, flagged_runs


class GaplessSamples(NamedTuple):
    """Samples without a gap, (n_times, n_channels), the time of the first in s, and a note on filled samples, "" for none."""

    values: FloatArray
    start: float
    note: str


class Lines(NamedTuple):
    """Line of a file that holds the first sample, and the number of each channel's column there, from 1."""

    first: int
    columns: Sequence[int]


def whole(
    path: Path,
    values: FloatArray,
    channels: Sequence[Dof],
    rate: float,
    start: float,
    options: ReadOptions,
    named: bool = True,
    lines: Lines | None = None,
) -> GaplessSamples:
    """Samples from `options.start` to `options.stop`, gaps up to `options.longest_gap` samples filled by cubics.

    Returns the samples (n_kept, n_channels), the time of the first of them in s, and a note on filled samples ("" for
    none).

    Parameters
    ----------
    path : Path
        For messages.
    values : (n_times, n_channels) float array
        Samples; NaN and infinite values are missing.
    channels : sequence of Dof
        Degree of freedom of each column.
    rate, start : float
        Sampling rate in Hz, and time of the first sample in s.
    options : ReadOptions
        Without `longest_gap` no gap is filled.
    named : bool
        True if the file names its channels, so that `options.channels` chooses among them; the other columns stay, with
        0 for missing samples.
    lines : Lines, optional
        Line and column numbers, for a file that has lines.

    Raises
    ------
    FileError
        If a gap is longer than allowed or lies at an end; the message names channel, sample, time and remedy.
    InputError
        If no sample lies between `options.start` and `options.stop`.
    """
    time = start + np.arange(len(values)) / rate
    first, last = sample_range(path, time, options)
    kept, begins = np.array(values[first:last], dtype=float), float(time[first])
    missing = ~np.isfinite(kept)
    if named and options.channels:
        chosen = parse_dofs(options.channels)
        others = [j for j, channel in enumerate(channels) if channel not in chosen]
        kept[:, others], missing[:, others] = np.where(missing[:, others], 0.0, kept[:, others]), False
    if not missing.any():
        return GaplessSamples(kept, begins, "")
    longest = options.longest_gap or 0
    gaps = {j: flagged_runs(missing[:, j]) for j in np.flatnonzero(missing.any(axis=0)).tolist()}
    if any(b - a > longest or a == 0 or b == len(kept) for runs in gaps.values() for a, b in runs):
        here = None if lines is None else Lines(lines.first + first, lines.columns)
        raise FileError(f"{path}: {_describe_gaps(gaps, missing, channels, rate, begins, here, named)}")
    for j in gaps:
        kept[:, j] = fill_missing(kept[:, j], missing[:, j])
    counts = ", ".join(f"{channels[j]} {missing[:, j].sum()}" for j in gaps)
    return GaplessSamples(kept, begins, f"samples invented to fill gaps, of {len(kept)}: {counts}")


def source_with_note(path: Path, note: str) -> str:
    """The source of a record from `path`, with the words `note` if there are any."""
    return f"{path}; {note}" if note else str(path)


def _describe_gaps(
    gaps: dict[int, list[tuple[int, int]]],
    missing: np.ndarray,
    channels: Sequence[Dof],
    rate: float,
    start: float,
    lines: Lines | None,
    named: bool,
) -> str:
    """Text of an error on missing samples: the first gap, totals and remedies.

    `gaps` maps column indices to (first sample, one after the last); `missing` is the mask (n_times, n_channels), `rate` is in
    Hz and `start` in s. `lines` are line numbers, None without; `named` says that the file names its channels.
    """
    j, (a, b) = min(((j, runs[0]) for j, runs in gaps.items()), key=lambda entry: entry[1])
    longest = max(b - a for runs in gaps.values() for a, b in runs)
    number = sum(len(runs) for runs in gaps.values())
    sound = flagged_runs(np.asarray(~missing.any(axis=1)))
    is_inner = all(a > 0 and b < len(missing) for runs in gaps.values() for a, b in runs)
    name = f"channel {channels[j]}"
    if lines is not None:
        name = f"line {lines.first + a}, column {lines.columns[j]} ({name})"
    text = (
        f"{name} is NaN or infinite for {b - a} samples from sample {a} ({start + a / rate:.6g} s) on; "
        f"in {len(gaps)} of {len(channels)} channels there are {number} gaps of {int(missing.sum())} samples in all. "
    )
    remedies = []
    p, q = max(sound, key=lambda part: part[1] - part[0], default=(0, 0))
    if q - p > 1:
        remedies.append(
            "cut to the longest whole part with "
            + option_words(start=float(f"{start + p / rate:.9g}"), stop=float(f"{start + (q - 1) / rate:.9g}"))
        )
    if is_inner:
        remedies.append(f"interpolate with {option_words(longest_gap=longest)}")
    if named and len(gaps) < len(channels):
        remedies.append("leave the channel out with `channels`")
    remedies.append("repair the file")
    remedy = ", or ".join(remedies)
    return text + remedy[0].upper() + remedy[1:]
