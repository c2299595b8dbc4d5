"""Checks of a record before anything is computed from it: channels, samples, hammer blows, spectrum, length."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import require_class
from structid.records.quality.findings import Finding, channel_name
from structid.records.quality.sample_faults import clipped_samples, drop_outs, spikes
from structid.records.quality.spectral_checks import spectral_checks
from structid.records.record import TimeRecord

_DEAD = 1e-9  # part of the median level of a quantity below which a channel holds no motion
_LEVEL = 100.0  # ratio to that median from which a level is doubtful
_MUCH = 0.05  # part of samples clipped or lost from which a channel is unusable
#: Force over its peak from which on it is a blow; part of the record beyond which the force is none of a hammer.
_BLOW, _MOST_OF_RECORD = 0.1, 0.1
#: Durations of contact within which a second blow belongs to the first: blows that are meant are farther apart.
_CLOSE = 50.0


def signal_checks(record: TimeRecord, band: tuple[float, float] | None = None) -> tuple[Finding, ...]:
    """Findings on every channel and on the record as a whole; empty for a sound record.

    Looked for are dead and constant channels, double hits, clipping, drop-outs (runs of one value), spikes, levels far from
    those of the other channels, records of a few periods only, power up to the Nyquist frequency (aliasing), and lines of the
    mains.

    Parameters
    ----------
    record : TimeRecord
    band : (float, float), optional
        Frequency range of interest in Hz, whose lower end decides how long the record has to be; by default the spectrum
        does.

    Returns
    -------
    tuple of Finding
        Channels in order, then the record.

    Notes
    -----
    Clipping is seen in samples as the converter gave them, before any filter. Impacts are natural in force channels:
    these are not searched for spikes, and runs at rest are no drop-outs there. A time offset between channels is not
    looked for.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.random.default_rng(1).standard_normal((4000, 2)) * [1.0, 0.0]
    >>> record = TimeRecord(100.0, motion, ("1X", "2X"), ("velocity",) * 2)
    >>> signal_checks(record)[0].words
    'channel 2X+ velocity is 0 at every sample; check sensor and cable, or leave the channel out with `channels`'
    """
    require_class("record", record, TimeRecord, "make it by `read_record` or `TimeRecord`")
    findings = channel_checks(record)
    silent = {finding.channel for finding in findings if finding.kind in ("constant", "dead")}
    sound = [i for i in range(len(record.channels)) if channel_name(record, i) not in silent]
    return (*findings, *spectral_checks(record, sound, band))


def channel_checks(record: TimeRecord) -> tuple[Finding, ...]:
    """Findings on each channel of `record` in turn: constant or dead, else faults of samples and an unusual level.

    Faults are clipping, late starts, drop-outs, double hits of forces and spikes of motions. A level is unusual if it
    is 100 times the median of the channels of its quantity or more, or a hundredth or less. Empty for a record without
    faults; a constant or dead channel has no other finding.
    """
    level = record.values.std(axis=0)
    usual = _usual_level(record, level)
    findings: list[Finding] = []
    for i in range(len(record.channels)):
        silent = _silent(record, i, float(level[i]), float(usual[i]))
        if silent is not None:
            findings.append(silent)
            continue
        findings += _sample_findings(record, i)
        ratio = level[i] / usual[i]
        if not 1 / _LEVEL < ratio < _LEVEL:
            name = channel_name(record, i)
            words = (
                f"channel {name} has {ratio:.3g} times the level that is usual among the {record.quantities[i]} "
                "channels; check its sensitivity, unit and cable"
            )
            findings.append(Finding("level", words, "warning", name))
    return tuple(findings)


def _usual_level(record: TimeRecord, level: FloatArray) -> FloatArray:
    """Median level of the channels alike that move, for each channel, (n_channels,); 0 if none of them moves.

    Alike are channels of the same quantity, both translations or both rotations. `level` (n_channels,) holds the
    standard deviation of each channel.
    """
    kinds = [(q, c.is_rotation) for q, c in zip(record.quantities, record.channels, strict=True)]
    moving = np.ptp(record.values, axis=0) > 0
    alike = [[j for j, k in enumerate(kinds) if k == kind and moving[j]] for kind in kinds]
    return np.array([np.median(level[members]) if members else 0.0 for members in alike])


def _silent(record: TimeRecord, i: int, level: float, usual: float) -> Finding | None:
    """Finding that channel `i` (from 0) is constant (to 1e-12) or dead (below 1e-9 of the `usual` level), or None.

    `level` is its standard deviation, in the unit of the channel as `usual`.
    """
    y, name = record.values[:, i], channel_name(record, i)
    remedy = "check sensor and cable, or leave the channel out with `channels`"
    if np.ptp(y) <= 1e-12 * np.abs(y).max():
        return Finding("constant", f"channel {name} is {y[0]:.6g} at every sample; {remedy}", "unusable", name)
    if level < _DEAD * usual:
        words = f"channel {name} is dead: it moves by {level:.3g}, where {usual:.3g} is usual; {remedy}"
        return Finding("dead", words, "unusable", name)
    return None


def _sample_findings(record: TimeRecord, i: int) -> list[Finding]:
    """Findings on clipping, late start, drop-outs, double hits (forces) and spikes (motions) in channel `i` (from 0)."""
    y, name, n = record.values[:, i], channel_name(record, i), len(record.values)
    unit = record.units[i]
    findings: list[Finding] = []
    clipped = clipped_samples(y)
    if clipped.any():
        fraction = clipped.mean()
        levels = " and ".join(f"{value:.4g}" for value in np.unique(y[clipped]))
        words = (
            f"channel {name} is clipped at {levels} {unit}: {clipped.sum()} of {n} samples ({fraction:.2%}) sit there, the "
            f"first at sample {np.argmax(clipped)}; lower the gain and measure again, or leave this part out by `start` and `stop`"
        )
        findings.append(Finding("clipped", words, "unusable" if fraction > _MUCH else "warning", name))
    findings += _drop_out_findings(record, i)
    twice = double_hit(record, i) if record.quantities[i] == "force" else None
    findings += [] if twice is None else [twice]
    thrown = spikes(y) if record.quantities[i] != "force" else np.zeros(n, dtype=bool)
    if thrown.any():
        words = (
            f"channel {name} has {thrown.sum()} samples thrown off the motion around them (spikes), the first at sample "
            f"{np.argmax(thrown)}; check plugs and grounding, or interpolate them in Python by "
            '`Preparation(outliers="replace")`'
        )
        findings.append(Finding("spikes", words, "warning", name))
    return findings


def _drop_out_findings(record: TimeRecord, i: int) -> list[Finding]:
    """Findings on a late start, a run of one value from the first sample on, and on drop-outs, in channel `i` (from 0).

    A force that rests at first has no late start.
    """
    y, name = record.values[:, i], channel_name(record, i)
    findings: list[Finding] = []
    runs_of_one = drop_outs(y, clipped_samples(y))
    if runs_of_one and runs_of_one[0][0] == 0 and record.quantities[i] != "force":
        stop = runs_of_one[0][1]
        words = (
            f"channel {name} stays at {y[0]:.4g} up to sample {stop} ({record.time[stop]:.4g} s): not yet moving or not "
            "yet switched on; leave that part out by `start` unless the start from rest is wanted"
        )
        findings.append(Finding("late_start", words, "note", name))
    lost = lost_samples(record, i)
    if lost:
        count, (start, stop) = sum(b - a for a, b in lost), max(lost, key=lambda part: part[1] - part[0])
        words = (
            f"channel {name} drops out {len(lost)} times, {count} samples in all: the longest run is {stop - start} samples "
            f"at {y[start]:.4g} from sample {start} ({record.time[start]:.4g} s) on; check the connection, interpolate "
            'short runs in Python by `Preparation(dropouts="replace")`, or leave them out by `start` and `stop`'
        )
        findings.append(Finding("drop_out", words, "unusable" if count > _MUCH * len(y) else "warning", name))
    return findings


def lost_samples(record: TimeRecord, i: int) -> list[tuple[int, int]]:
    """Drop-outs of the channel with index `i` as (first sample, sample after the last) each: runs of a repeated value.

    Runs that clipping or the motion around explains do not count, nor do a run from the first sample on (late start)
    and a force at rest, which is at its median.
    """
    y = record.values[:, i]
    runs = [part for part in drop_outs(y, clipped_samples(y)) if part[0] > 0]
    if record.quantities[i] == "force":
        rest_level = np.median(y)
        runs = [(start, stop) for start, stop in runs if y[start] != rest_level]
    return runs


def double_hit(record: TimeRecord, index: int) -> Finding | None:
    """Finding on the first blow of a force channel that another follows closely; None if there is none.

    Closely means within 50 times the longer contact of the two, from start to start.

    Parameters
    ----------
    record : TimeRecord
    index : int
        Column of the force channel, from 0.
    """
    force = np.abs(record.values[:, index])
    for (first, last), (second, end) in pairwise(_blows(force)):
        contact = max(last - first, end - second) + 1
        peaks = [start + int(np.argmax(force[start : stop + 1])) for start, stop in ((first, last), (second, end))]
        gap, sizes = (peaks[1] - peaks[0]) / record.sampling_rate, force[peaks].tolist()
        if second - first < _CLOSE * contact:
            name = channel_name(record, index)
            words = (
                f"channel {name} hits twice within {gap:.3g} s, at sample {first} and with {100 * sizes[1] / sizes[0]:.0f} % of"
                f" that force after it: its spectrum has gaps every {1 / gap:.3g} Hz, where FRFs are noise; leave this blow out"
            )
            return Finding("double_hit", words, "warning", name)
    return None


def _blows(force: FloatArray) -> list[tuple[int, int]]:
    """First and last sample of each hammer blow in `force` (n_times,), the magnitude of a force channel.

    A blow is above a tenth of the largest force; gaps of up to twice its length so far belong to it. Empty if the force
    is that large for more than a tenth of the record, as that of a shaker.
    """
    loud = np.flatnonzero(force > _BLOW * force.max())
    if not 0 < len(loud) <= _MOST_OF_RECORD * len(force):
        return []
    blows = [[int(loud[0]), int(loud[0])]]
    for sample in loud[1:].tolist():
        length = blows[-1][1] - blows[-1][0] + 1
        if sample - blows[-1][1] <= 2 * length:  # it rings, or dips in between
            blows[-1][1] = sample
        else:
            blows.append([sample, sample])
    return [(first, last) for first, last in blows]
