"""A structure and a time record become a time-domain problem: which channels are fitted, which forces drive."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.fem import Base, Structure
from structid.forward.time.input_hold import InputHold
from structid.forward.time.model import TimeModel
from structid.forward.time.options import TimeOptions
from structid.forward.time.output_error import OutputErrorProblem
from structid.records import TimeRecord
from structid.records.record import LOADS, MOTION_DERIVATIVES
from structid.unknowns import Parameters

_NO_NOISE = (
    "the record has no noise level; declare `variance`, one value a channel (0 for a force that is known), as found from"
    " a stretch of the record without motion"
)


def time_model(structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions) -> TimeModel:
    """Time-domain model of the fitted channels of `record`.

    Raises
    ------
    InputError
        If nothing is there to fit or to drive the structure, or both forces and supports do, a channel is not part of it, or the
        rest does not last until the first sample where only samples of the force are known.
    """
    fitted, loads = _chosen(record, options.quantities), _chosen(record, LOADS)
    if not len(fitted):
        kinds = ", ".join(options.quantities)
        raise InputError(f"the record must hold channels of {kinds}, got {', '.join(record.quantities) or 'none'}")
    if not len(loads) and options.initial == "rest":
        raise InputError(
            "the record must hold force channels, or accelerations of supports that drive, where motion begins at rest; add them,"
            " or take initial 'unknown' for free motion (which gives ratios of parameters unless one is known)"
        )
    begin = record.start if options.rest_time is None else options.rest_time
    if begin > record.start:
        raise InputError(f"`rest_time` must not come after the first sample at {record.start:g} s, got {begin:g} s")
    bases = _bases(structure, record, loads)
    drive = InputHold(options.force, len(loads), bool(bases), 1 / record.sampling_rate, record.start - begin, begin)
    driven, sensors = (tuple(record.channels[i] for i in chosen) for chosen in (loads, fitted))
    orders = np.array([MOTION_DERIVATIVES[record.quantities[i]] for i in fitted])
    return TimeModel(structure, unknown, drive, driven, sensors, orders, bases)


def _bases(structure: Structure, record: TimeRecord, loads: IntArray) -> tuple[Base, ...]:
    """Supports whose measured motion drives the structure; () if forces do."""
    moved = [i for i in loads if record.quantities[i] == "support_acceleration"]
    bases = structure.driven(record.channels[i] for i in loads) if moved else ()
    if moved and not bases:
        raise InputError(
            f"{record.channels[moved[0]]} is no support that drives the structure; make it one of a [[structure.base]], or its"
            " motion that of a sensor"
        )
    return bases


def output_error_problem(
    structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions | None = None
) -> OutputErrorProblem:
    """Maximum-likelihood output-error problem of `record`; see `identify_time` for the arguments.

    Raises
    ------
    InputError
        As `time_model`, and if the noise of a fitted channel is not declared.
    """
    chosen = options or TimeOptions()
    model = time_model(structure, unknown, record, chosen)
    fitted, loads = _chosen(record, chosen.quantities), _chosen(record, LOADS)
    variance = declared_variance(record)
    for i in fitted:
        if not variance[i] > 0:
            raise InputError(
                f"noise variance of {record.quantities[i]} at {record.channels[i]} must be greater than 0, got"
                f" {variance[i]:g}; declare it, or leave the kind out of `quantities`"
            )
    return OutputErrorProblem(
        model,
        record.values[:, fitted],
        np.sqrt(variance[fitted]),
        record.values[:, loads],
        np.sqrt(variance[loads]),
        chosen.initial == "unknown",
    )


def declared_variance(record: TimeRecord) -> FloatArray:
    """Noise variance of every channel, (n_channels,).

    Raises
    ------
    InputError
        If it is not declared, negative or not finite.
    """
    if record.variance is None:
        raise InputError(_NO_NOISE)
    wrong = ~(np.isfinite(record.variance) & (record.variance >= 0))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(
            f"`variance` must be finite and not negative, got {record.variance[i]:g} for {record.quantities[i]} at"
            f" {record.channels[i]}; declare the noise of every channel"
        )
    return record.variance


def _chosen(record: TimeRecord, quantities: tuple[str, ...]) -> IntArray:
    return np.array([i for i, q in enumerate(record.quantities) if q in quantities], dtype=np.int64)
