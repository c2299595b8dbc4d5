"""Frequency response functions from time histories, with coherence and the variance that random error leaves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof, parse_dofs
from structid.errors import InputError
from structid.records.record import FrfKind, FrfRecord, Quantity, TimeRecord
from structid.records.transforms.frf_estimators import Estimator, Spectra, estimated
from structid.records.transforms.segments import (
    Detrend,
    effective_averages,
    require_alike,
    segment_count,
    segment_step,
    segment_transforms,
    window_weights,
)

_KINDS: dict[str, FrfKind] = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}
#: Largest condition number of the input spectra (each input scaled to 1) that counts as separable.
_SEPARABLE = 1e8


def frf_from_time(
    records: TimeRecord | Sequence[TimeRecord],
    inputs: Iterable[str | Dof],
    outputs: Iterable[str | Dof],
    estimator: Estimator = "H1",
    segment_length: int | None = None,
    overlap: float = 0.5,
    window: str | tuple[Any, ...] = "hann",
    detrend: Detrend = "constant",
    quantity: Quantity | None = None,
) -> FrfRecord:
    """Frequency response functions by averaged spectra of windowed segments.

    With S_xx = E[x x^H], S_yx = E[y x^H] and S_yy of the segments' Fourier transforms,
    H1 = S_yx S_xx^-1 (noise on the outputs only), H2 = S_yy / S_xy (noise on the input only), and Hv is the total
    least squares estimate with every channel scaled to unit power, which is (H1 H2)^(1/2) for one input.

    Parameters
    ----------
    records : TimeRecord or sequence of TimeRecord
        One long record, or repeats (such as hammer impacts) that are averaged.
    inputs : iterable of str or Dof
        Force channels.
    outputs : iterable of str or Dof
        Motion channels, all of one quantity.
    estimator : {"H1", "H2", "Hv"}
        H1 and Hv take any number of inputs, H2 one.
    segment_length : int, optional
        Samples in a segment. May be left out for repeats, which then are a segment each.
    overlap : float
        Part of a segment shared with the next, 0 to less than 1.
    window : str or tuple
        As `scipy.signal.get_window` takes it; ``"boxcar"`` or ``("exponential", 0.0, samples)`` for impacts.
    detrend : {"constant", "linear", "none"}
        What is taken off each segment before the window. Without ``"none"`` the line at 0 Hz is left out.
    quantity : str, optional
        Which quantity to use where a channel has several at an output.

    Returns
    -------
    FrfRecord
        SI units; its kind by the quantity of the outputs. `coherence` is ordinary for one input, multiple for
        several. `variance` is E|error|^2 of random error, None with too few averages.

    Raises
    ------
    InputError
        If channels are missing, records do not fit together or are too short, an input is silent, or several inputs
        cannot be told apart (their spectra are coherent, or there are fewer averages than inputs).

    Notes
    -----
    Variance: (1 - g2) S_yy [S_xx^-1]_ii / (n - q), with multiple coherence g2, q inputs and n the effective number of
    independent segments by Welch's formula for overlap. It covers random error of noise on the outputs; leakage,
    noise on the inputs and, for H2 and Hv, the difference to H1's scatter are not in it.
    An exponential window of time constant `samples` adds damping: every pole moves by -sampling_rate / samples (1/s).

    References
    ----------
    Bendat and Piersol (2010), Random Data, 4th ed., chapters 7 and 9. Welch (1967), IEEE Trans. Audio Electroacoust.
    15, 70-73. Rocklin, Crowley and Vold (1985), IMAC 3 (Hv).
    """
    repeats = [records] if isinstance(records, TimeRecord) else list(records)
    loads, sensors = parse_dofs(inputs), parse_dofs(outputs)
    require_alike(repeats, segment_length)
    length = segment_length if segment_length is not None else repeats[0].values.shape[0]
    step = segment_step(length, overlap)
    measured = _quantity(repeats[0], sensors, quantity)
    columns = _columns(repeats[0], loads, "force"), _columns(repeats[0], sensors, measured)
    weights = window_weights(window, length)
    spectra, count = _averaged(repeats, columns, weights, step, detrend)
    averages = effective_averages(weights, step, [segment_count(r, length, step) for r in repeats])
    frequency = np.fft.rfftfreq(length, 1 / repeats[0].sampling_rate)
    if detrend != "none":
        frequency = frequency[1:]
        spectra = Spectra(spectra.inputs[1:], spectra.cross[1:], spectra.outputs[1:])
    _require_separable(spectra, count, loads, frequency)
    values, coherence, variance = estimated(spectra, estimator, averages)
    return FrfRecord(
        frequency=frequency,
        values=values,
        outputs=sensors,
        inputs=loads,
        kind=_KINDS[measured],
        variance=variance,
        coherence=coherence,
        averages=max(round(averages), 1),
        noise_source="unknown" if variance is None else "coherence",
        source=repeats[0].source,
    )


def _quantity(record: TimeRecord, outputs: tuple[Dof, ...], wanted: Quantity | None) -> Quantity:
    """The one quantity that every output has, other than force."""
    if not outputs:
        raise InputError("`outputs` must name at least one channel, got none")
    present = set(zip(record.channels, (str(q) for q in record.quantities), strict=True))
    shared = [q for q in _KINDS if all((dof, q) in present for dof in outputs)]
    if wanted is not None and wanted in shared:
        return wanted
    if len(shared) == 1 and wanted is None:
        return shared[0]  # type: ignore[return-value]  # a key of _KINDS
    has = ", ".join(f"{dof} {q}" for dof, q in zip(record.channels, record.quantities, strict=True))
    if len(shared) > 1:
        raise InputError(f"`outputs` have {' and '.join(shared)}; choose one with `quantity`")
    raise InputError(f"`outputs` must be motion channels of one quantity; the record has {has}")


def _columns(record: TimeRecord, dofs: tuple[Dof, ...], quantity: str) -> list[int]:
    if not dofs:
        raise InputError("`inputs` must name at least one force channel, got none")
    present = list(zip(record.channels, record.quantities, strict=True))
    missing = [str(dof) for dof in dofs if (dof, quantity) not in present]
    if missing:
        has = ", ".join(str(dof) for dof, q in present if q == quantity) or "none"
        raise InputError(f"the record has no {quantity} channel {', '.join(missing)}; it has {has}")
    return [present.index((dof, quantity)) for dof in dofs]  # type: ignore[arg-type]  # a Quantity


def _averaged(
    records: list[TimeRecord],
    columns: tuple[list[int], list[int]],
    weights: FloatArray,
    step: int,
    detrend: Detrend,
) -> tuple[Spectra, int]:
    if detrend not in ("constant", "linear", "none"):
        raise InputError(f"`detrend` must be constant, linear or none, got {detrend!r}")
    lines, (loads, sensors) = weights.size // 2 + 1, columns
    xx = np.zeros((lines, len(loads), len(loads)), dtype=np.complex128)
    yx = np.zeros((lines, len(sensors), len(loads)), dtype=np.complex128)
    yy = np.zeros((lines, len(sensors)))
    count = 0
    for transform in segment_transforms(records, weights, step, detrend):
        x, y = transform[:, loads], transform[:, sensors]
        xx += x[:, :, None] * x[:, None, :].conj()
        yx += y[:, :, None] * x[:, None, :].conj()
        yy += np.abs(y) ** 2
        count += 1
    if count == 0:
        longest = max(record.values.shape[0] for record in records)
        raise InputError(
            f"`segment_length` {weights.size} is longer than the longest record ({longest} samples); shorten it"
        )
    return Spectra(xx / count, yx / count, yy / count), count


def _require_separable(spectra: Spectra, count: int, inputs: tuple[Dof, ...], frequency: FloatArray) -> None:
    power = np.einsum("fii->fi", spectra.inputs).real
    silent = np.argwhere(power <= 0)
    if silent.size:
        line, i = silent[0]
        raise InputError(
            f"input {inputs[i]} has no power at {frequency[line]:g} Hz; excite it there or check the channel"
        )
    if len(inputs) == 1:
        return
    if count < len(inputs):
        raise InputError(f"{len(inputs)} inputs need at least as many segments, got {count}; shorten `segment_length`")
    scale = np.sqrt(power)
    condition = np.linalg.cond(spectra.inputs / (scale[:, :, None] * scale[:, None, :]))
    if condition.max() > _SEPARABLE:
        at = frequency[int(np.argmax(condition))]
        raise InputError(f"the inputs cannot be told apart at {at:g} Hz, they are coherent; drive them independently")
