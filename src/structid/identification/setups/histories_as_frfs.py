"""FRFs of time histories, which show a fit, and which causes of a misfit are looked for on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import Dof
from structid.records import FrfRecord, TimeRecord, frf_from_time
from structid.records.record import LOADS, Quantity
from structid.records.transforms.spectra import KINDS

#: A record is cut into so many segments.
_SEGMENTS = 4
#: Power of a force over that of its noise from which it drives a line; noise alone in four segments never has it.
_ABOVE_NOISE = 8.0
_FEWEST = 16
#: A hit: force beyond this part of its peak, and so many deviations of its noise, for less than this part of the record; the
#: structure is at rest before it where it has less than this part of the motion's power.
_PEAK, _DEVIATIONS, _SHORT, _AT_REST = 0.02, 5.0, 0.1, 1e-3
#: Motion at the end of a record of a hit, in parts of its largest: an exponential window takes it off.
_GONE = 0.003
#: Power of a hit, in parts of its largest, below which it drives no line.
_DRIVES = 1e-4


class _Hit(NamedTuple):
    """One blow on a structure at rest: the number of its channel, and its first and last samples."""

    column: int
    first: int
    last: int


def frfs_of(record: TimeRecord) -> FrfRecord:
    """FRFs of all motions over all forces (or support motions) of time histories, in the kind of most motion channels.

    The record of a single hit is transformed whole, with an exponential window if the motion has not died out. Others are
    averaged by the estimator Hv from segments; they go from the first to the last line at which a force rises above its noise,
    and over all lines where none does.
    """
    pairs = list(zip(record.channels, record.quantities, strict=True))
    loads = [dof for kind in LOADS for dof, quantity in pairs if quantity == kind]
    motions = [(dof, quantity) for dof, quantity in pairs if quantity not in LOADS]
    if "support_acceleration" in record.quantities:  # per motion of a support
        motions = [one for one in motions if one[1] == "acceleration"]
    kinds = [quantity for _, quantity in motions]
    most: Quantity = max(dict.fromkeys(kinds), key=kinds.count, default="acceleration")
    places = [dof for dof, _ in motions]
    sensors = [dof for dof in dict.fromkeys(places) if (dof, most) in motions or places.count(dof) == 1]
    hit = _hit(record)
    if hit is not None and set(kinds) == {most} and len(sensors) == len(motions):
        of_hit = _frfs_of_hit(record, hit, sensors)
        if of_hit is not None:
            return of_hit
    length = max(len(record.values) // _SEGMENTS, 1)
    made = frf_from_time(record, loads, sensors, estimator="Hv", segment_length=length, quantity=most)
    driven = _driven(record, length)
    return made.lines((made.frequency >= driven[0]) & (made.frequency <= driven[-1])) if driven.size else made


def _hit(record: TimeRecord) -> _Hit | None:
    """Single hit of the record; None if there are several loads, a longer force, or motion before it."""
    columns = [k for k, quantity in enumerate(record.quantities) if quantity in LOADS]
    if len(columns) != 1 or record.quantities[columns[0]] != "force":
        return None
    [column], force = columns, np.abs(record.values[:, columns[0]])
    noise = 0.0 if record.variance is None else float(np.sqrt(record.variance[column]))
    beyond = np.flatnonzero(force > max(_PEAK * force.max(), _DEVIATIONS * noise))
    if not len(beyond):
        return None
    first, last = max(int(beyond[0]) - 2, 0), int(beyond[-1]) + 2
    motion = np.delete(record.values, column, axis=1)
    before = float(np.sum(motion[:first] ** 2))
    is_short = last - first < _SHORT * (len(force) - first)
    return _Hit(column, first, last) if is_short and before <= _AT_REST * float(np.sum(motion**2)) else None


def _frfs_of_hit(record: TimeRecord, hit: _Hit, sensors: list[Dof]) -> FrfRecord | None:
    """FRFs from a single hit: spectra of the motions at `sensors` over that of the force, with variances from declared noise.

    Where the motion has not died out at the end, all channels are weighted by exp(-decay t) first, and the FRFs are those at
    s = decay + i omega. They go from the lowest line that the hit excites to its first wide gap. The variances are None without
    declared noise. The result is None if the hit excites no line above its noise.
    """
    values = np.array(record.values[hit.first :])
    count, rate = len(values), record.sampling_rate
    values[hit.last - hit.first :, hit.column] = 0.0
    others = np.delete(np.arange(values.shape[1]), hit.column)
    mean = np.sqrt(np.square(values[:, others]).mean(axis=0))
    end = np.sqrt(np.square(values[-max(count // 20, 1) :, others]).mean(axis=0))
    left = float(np.max(end / np.maximum(mean, np.finfo(float).tiny)))
    decay = np.log(max(left / _GONE, 1.0)) * rate / count
    window = np.exp(-decay * np.arange(count) / rate)
    spectra = np.fft.rfft(values * window[:, None], axis=0)
    of_force = (
        0.0 if record.variance is None else record.variance[hit.column] * np.sum(window[: hit.last - hit.first] ** 2)
    )
    power = np.abs(spectra[:, hit.column]) ** 2
    driven = 1 + np.flatnonzero(power[1:] > max(_DRIVES * power.max(), _ABOVE_NOISE * of_force))
    if not len(driven):
        return None
    lines = _first_run(driven)
    force = spectra[lines, hit.column, None]
    h, variance = spectra[np.ix_(lines, others)] / force, None
    if record.variance is not None:
        noise = record.variance[others] * np.sum(window**2) + np.abs(h) ** 2 * of_force
        variance = (noise / np.abs(force) ** 2)[:, :, None]
    return FrfRecord(
        np.fft.rfftfreq(count, 1 / rate)[lines], h[:, :, None], sensors, [record.channels[hit.column]],
        KINDS[record.quantities[others[0]]], variance=variance,
        noise_source="unknown" if variance is None else "declared", source=record.source,
        decay=np.full(len(lines), decay) if decay else None,
    )  # fmt: skip


def _first_run(lines: IntArray) -> IntArray:
    """All line indices (n,) from the first of the sorted `lines` to the last one before a gap of more than `_FEWEST` lines."""
    gaps = np.flatnonzero(np.diff(lines) > _FEWEST)
    last = lines[gaps[0]] if len(gaps) else lines[-1]
    return np.arange(lines[0], last + 1)


def _driven(record: TimeRecord, length: int) -> FloatArray:
    """Frequencies (Hz) of segments of `length` samples at which a force has eight times the power of its noise.

    All frequencies if the noise is unknown or the segments are shorter than `_FEWEST` samples.
    """
    frequency = np.fft.rfftfreq(length, 1 / record.sampling_rate)
    is_force = [quantity in LOADS for quantity in record.quantities]
    if record.variance is None or length < _FEWEST:
        return frequency
    window = np.hanning(length + 1)[:-1, None]
    count = len(record.values) // length
    parts = record.values[: count * length, is_force].reshape(count, length, -1)
    power = (np.abs(np.fft.rfft(parts * window, axis=1)) ** 2).mean(axis=0)
    return frequency[(power > _ABOVE_NOISE * record.variance[is_force] * (window**2).sum()).any(axis=1)]
