"""Frequency response functions right of the axis from impacts: records that start at rest, with the force measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import ComplexArray, FloatArray
from structid.dof import Dof, parse_dof, parse_dofs
from structid.errors import InputError
from structid.records.record import FrfKind, FrfRecord, Quantity, TimeRecord

_KINDS: dict[str, FrfKind] = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}
_AT_REST = 1e-3
_BAND = 0.4
_CHUNK_ENTRIES = 4_000_000


def frf_from_rest(
    records: TimeRecord | Sequence[TimeRecord],
    load: str | Dof,
    outputs: Iterable[str | Dof],
    decay: ArrayLike | None = None,
    frequency: ArrayLike | None = None,
    force_until: float | None = None,
    quantity: Quantity = "acceleration",
) -> FrfRecord:
    """FRFs at s = decay + i omega from records that start at rest: H = sum of Y conj(F) / sum of F conj(F).

    F and Y are transforms of force and motion times exp(-decay t). The structure being at rest at the first sample,
    H(decay + i omega) is exact, without leakage: the exponential window of impact tests, undone in the model instead
    of in the damping. Several records of the same channels are averaged.

    Parameters
    ----------
    records : TimeRecord or sequence of TimeRecord
        One an impact. Their `variance`, where given, goes into that of the FRFs.
    load : str or Dof
        The force channel.
    outputs : iterable of str or Dof
    decay : float or (n_lines,) array, optional
        1/s. By default 0 if the motion has died away at the end of the record, to 0.1 % of its largest; else 7 over
        the length of the record, which takes what is left there down to 0.1 %.
    frequency : (n_lines,) array, optional
        Hz; by default multiples of 1 / length up to 0.4 of the sampling rate.
    force_until : float, optional
        Time after the start of the record, s, from which on the force is known to be 0 and its noise is left out.
    quantity : {"displacement", "velocity", "acceleration"}

    Returns
    -------
    FrfRecord
        With `decay`, unless it is 0. `variance` carries the noise of both channels and what the motion after the end
        of the record may hold.

    Raises
    ------
    InputError
        If channels are missing, records do not fit together, or the force is silent at a line.

    Notes
    -----
    Signals must hold nothing above half the sampling rate, as behind an anti-aliasing filter. With a decay, errors of lines
    closer than 2 decay (rad/s) are correlated; standard deviations from such lines are too small, by
    (decay * length)^(1/2) at most. Force noise is common to all outputs of a line; it is counted in each as if it were its own.
    """
    repeats = [records] if isinstance(records, TimeRecord) else list(records)
    sensors = parse_dofs(outputs)
    columns = _columns(repeats, parse_dof(load), sensors, quantity)
    first = repeats[0]
    length = len(first.values) / first.sampling_rate
    depth = _default_decay(repeats, columns[1:], length) if decay is None else np.asarray(decay, dtype=np.float64)
    if (depth < 0).any():
        raise InputError(f"`decay` must be at least 0, got {depth.min():g} 1/s")
    lines = np.arange(1, int(_BAND * len(first.values)) + 1) / length
    at = lines if frequency is None else np.asarray(frequency, dtype=np.float64)
    laplace = np.broadcast_to(depth, at.shape) + 2j * np.pi * at
    cross = np.zeros((len(at), len(sensors)), dtype=np.complex128)
    power, error = np.zeros(len(at)), np.zeros(cross.shape)
    force_error = np.zeros(len(at))
    for record in repeats:
        force, motion, noise = _spectra(
            record, columns, laplace, force_until, fast=frequency is None and depth.ndim == 0
        )
        cross += motion * np.conj(force)[:, None]
        power += np.abs(force) ** 2
        error += np.abs(force)[:, None] ** 2 * (noise[:, 1:] + _tail(record, columns[1:], laplace, length))
        force_error += np.abs(force) ** 2 * noise[:, 0]
    if not (power > 0).all():
        raise InputError(
            f"the force is silent at {at[int(np.argmin(power))]:g} Hz; narrow the band or check the channel"
        )
    values = cross / power[:, None]
    variance = (error + np.abs(values) ** 2 * force_error[:, None]) / power[:, None] ** 2
    return FrfRecord(
        frequency=at,
        values=values[:, :, None],
        outputs=sensors,
        inputs=(parse_dof(load),),
        kind=_KINDS[quantity],
        variance=variance[:, :, None],
        noise_source="declared",
        source=first.source,
        decay=laplace.real if laplace.real.any() else None,
    )


def _columns(records: Sequence[TimeRecord], load: Dof, sensors: tuple[Dof, ...], quantity: Quantity) -> list[int]:
    """Columns of the force and of the motions, the same in all records."""
    if quantity not in _KINDS:
        raise InputError(f"`quantity` must be one of {', '.join(_KINDS)}, got {quantity!r}")
    if not records:
        raise InputError("`records` must hold at least one record, got none")
    first = records[0]
    for record in records[1:]:
        same = record.channels == first.channels and record.quantities == first.quantities
        if not same or record.values.shape != first.values.shape or record.sampling_rate != first.sampling_rate:
            raise InputError("`records` must share channels, length and sampling rate; cut them alike")
    have = {pair: i for i, pair in enumerate(zip(first.channels, first.quantities, strict=True))}
    wanted: list[tuple[Dof, Quantity]] = [(load, "force"), *((dof, quantity) for dof in sensors)]
    missing = [f"{name} at {dof}" for dof, name in wanted if (dof, name) not in have]
    if missing:
        raise InputError(f"the record has no {', '.join(missing)}; name channels that it has")
    return [have[pair] for pair in wanted]


def _default_decay(records: list[TimeRecord], columns: list[int], length: float) -> FloatArray:
    sizes = [(_end_square(r, columns), np.square(r.values[:, columns]).max(axis=0)) for r in records]
    died = all((end <= _AT_REST**2 * largest).all() for end, largest in sizes)
    return np.array(0.0 if died else -np.log(_AT_REST) / length)


def _end_square(record: TimeRecord, columns: list[int]) -> FloatArray:
    """Mean square of the motion in the last twentieth of the record, without its noise."""
    end = record.values[-max(1, len(record.values) // 20) :, columns]
    noise = np.zeros(len(columns)) if record.variance is None else np.asarray(record.variance)[columns]
    return np.maximum(np.mean(end**2, axis=0) - noise * (1 + 4 * np.sqrt(2 / len(end))), 0.0)


def _tail(record: TimeRecord, columns: list[int], laplace: ComplexArray, length: float) -> FloatArray:
    """Square of what the transform may lack from the motion after the end, (n_lines, n_outputs)."""
    reach = np.exp(-laplace.real * length) / np.maximum(laplace.real, 1 / length)
    return np.outer(reach**2, _end_square(record, columns))


def _spectra(
    record: TimeRecord, columns: list[int], laplace: ComplexArray, force_until: float | None, fast: bool
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Transforms of force and motions, and the noise variance of each, (n_lines, 1 + n_outputs)."""
    step = 1 / record.sampling_rate
    time = step * np.arange(len(record.values))
    signals = np.array(record.values[:, columns])
    kept = np.ones(signals.shape)
    if force_until is not None:
        kept[time > force_until, 0] = 0.0
    found = np.empty((len(laplace), len(columns)), dtype=np.complex128)
    noise = np.zeros(found.shape)
    variance = None if record.variance is None else np.asarray(record.variance)[columns]
    if fast:
        window = np.exp(-laplace[0].real * time)[:, None]
        found[:] = step * np.fft.rfft(signals * kept * window, axis=0)[1 : len(laplace) + 1]
        noise[:] = 0.0 if variance is None else step**2 * np.sum(window**2 * kept, axis=0) * variance
        return found[:, 0], found[:, 1:], noise
    rows = max(1, _CHUNK_ENTRIES // len(time))
    for first in range(0, len(laplace), rows):
        part = slice(first, first + rows)
        found[part] = step * np.exp(-laplace[part, None] * time) @ (signals * kept)
        if variance is not None:
            noise[part] = step**2 * np.exp(-2 * laplace.real[part, None] * time) @ (kept * variance)
    return found[:, 0], found[:, 1:], noise
