"""Spectra of time histories: frequency response functions by averaged segments, with coherence and the variance that random error
leaves, and finite Fourier transforms of one stretch, without window or averages, with the noise of every line.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, locked, require_finite, require_shape
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, NoLinesError, require_class
from structid.records.record import (
    DERIVATIVES,
    LOADS,
    MOTION_DERIVATIVES,
    FrfKind,
    FrfRecord,
    Quantity,
    TimeRecord,
    require_shared,
)

Estimator = Literal["H1", "H2", "Hv"]
Detrend = Literal["constant", "linear", "none"]
#: As `scipy.signal.get_window` takes it: a name, or a name and its numbers.
Window = str | tuple[str | float | None, ...]
_MADE_BY = "make it by `read_record` or `TimeRecord`"
#: Kind of the FRFs of motions, by quantity.
KINDS: dict[str, FrfKind] = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}
#: Largest condition number of the input spectra (each input scaled to 1) that counts as separable.
_SEPARABLE = 1e8
#: Replicas of the spectrum, to either side, that are summed.
_ALIASES = 50


class Spectra(NamedTuple):
    """Averaged spectra: inputs (F, I, I), outputs by inputs (F, O, I), outputs (F, O)."""

    inputs: ComplexArray
    cross: ComplexArray
    outputs: FloatArray


def frf_from_time(
    records: TimeRecord | Sequence[TimeRecord],
    inputs: Iterable[str | Dof] = (),
    outputs: Iterable[str | Dof] = (),
    estimator: Estimator = "H1",
    segment_length: int | None = None,
    overlap: float = 0.5,
    window: Window = "hann",
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
        Force channels, or accelerations of supports, which give transmissibility. All forces by default,
        or where there is none all supports that move.
    outputs : iterable of str or Dof
        Motion channels. Displacements, velocities and accelerations side by side become one kind, by powers of i omega.
        All channels of motion by default, those where a force acts too; no accelerations of supports that drive.
    estimator : {"H1", "H2", "Hv"}
        H1 and Hv take any number of inputs, H2 one.
    segment_length : int, optional
        Samples in a segment. May be left out for repeats, which then are a segment each.
    overlap : float
        Part of a segment shared with the next, 0 to less than 1.
    window : str or tuple
        As `scipy.signal.get_window` takes it; ``"boxcar"`` or ``("exponential", 0.0, samples)`` for impacts.
    detrend : {"constant", "linear", "none"}
        What is taken off each segment before the window. The line at 0 Hz is left out, unless it is ``"none"`` and
        outputs are of one quantity.
    quantity : str, optional
        Which to use where a degree of freedom has several; the kind of the FRFs. By default that of most outputs.

    Returns
    -------
    FrfRecord
        SI units; its kind by the quantity of the outputs. `coherence` is ordinary for one input, multiple for
        several. `variance` is E|error|^2 of random error, None with too few averages.

    Raises
    ------
    InputError
        If channels are missing, records do not fit together or are too short, an input is silent, or several inputs
        cannot be separated (their spectra are coherent, or there are fewer averages than inputs).

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
    if not isinstance(records, Iterable):
        require_class("records", records, TimeRecord, _MADE_BY)
    repeats = [records] if isinstance(records, TimeRecord) else list(records)
    for number, record in enumerate(repeats):
        require_class(f"records[{number}]", record, TimeRecord, _MADE_BY)
    require_alike(repeats, segment_length)
    loads, sensors = _loads_and_sensors(repeats[0], parse_dofs(inputs, "inputs"), parse_dofs(outputs, "outputs"))
    length = segment_length if segment_length is not None else repeats[0].values.shape[0]
    step = segment_step(length, overlap)
    measured = _quantities(repeats[0], sensors, quantity)
    most: Quantity = max(dict.fromkeys(measured), key=measured.count) if quantity is None else quantity
    driven = _are_supports(repeats[0], loads)
    others = [one for one in measured if one != "acceleration"]
    if driven and others:
        raise InputError(f"transmissibility is of accelerations, but outputs measure {others[0]}; leave them out")
    role: Quantity = "support_acceleration" if driven else "force"
    columns = _columns(repeats[0], loads, [role] * len(loads)), _columns(repeats[0], sensors, measured)
    weights = window_weights(window, length)
    spectra, count = _average_spectra(repeats, columns, weights, step, detrend)
    averages = effective_averages(weights, step, [segment_count(r, length, step) for r in repeats])
    frequency = np.fft.rfftfreq(length, 1 / repeats[0].sampling_rate)
    if detrend != "none" or len(set(measured)) > 1:
        frequency = frequency[1:]
        spectra = Spectra(spectra.inputs[1:], spectra.cross[1:], spectra.outputs[1:])
    _require_separable(spectra, count, loads, frequency)
    if estimator != "H1":
        _require_moving(spectra, sensors, frequency)
    values, coherence, variance = estimate_frf(spectra, estimator, averages)
    orders = [DERIVATIVES[KINDS[most]] - DERIVATIVES[KINDS[one]] for one in measured]
    if any(orders):
        factor = (2j * np.pi * frequency[:, None, None]) ** np.array(orders)[:, None]
        values, variance = values * factor, None if variance is None else variance * np.abs(factor) ** 2
    return FrfRecord(
        frequency=frequency,
        values=values,
        outputs=sensors,
        inputs=loads,
        kind="transmissibility" if driven else KINDS[most],
        variance=variance,
        coherence=coherence,
        averages=max(round(averages), 1),
        noise_source="unknown" if variance is None else "coherence",
        source=repeats[0].source,
    )


def _are_supports(record: TimeRecord, inputs: tuple[Dof, ...]) -> bool:
    """True if `inputs` are support accelerations of the record, False if none is; `InputError` if only some are."""
    pairs = set(zip(record.channels, (str(q) for q in record.quantities), strict=True))
    driven = [(dof, "support_acceleration") in pairs for dof in inputs]
    if any(driven) and not all(driven):
        raise InputError("inputs are forces and accelerations of supports together; name those of one kind in `inputs`")
    return any(driven)


def _loads_and_sensors(
    record: TimeRecord, inputs: tuple[Dof, ...], outputs: tuple[Dof, ...]
) -> tuple[tuple[Dof, ...], tuple[Dof, ...]]:
    """`inputs` and `outputs` of FRFs as named, or where empty by the quantities of the record's channels.

    Loads are then all forces, or all support accelerations if there are no forces; sensors are all other channels than
    forces and loads, also where a force acts.
    """
    pairs = list(zip(record.channels, record.quantities, strict=True))
    forces, supports = (
        [dof for dof, quantity_of in pairs if quantity_of == name] for name in ("force", "support_acceleration")
    )
    loads = inputs or tuple(forces or supports)
    driving = {("support_acceleration", dof) for dof in loads}
    moving = (dof for dof, quantity in pairs if quantity != "force" and (quantity, dof) not in driving)
    return loads, outputs or tuple(dict.fromkeys(moving))


def _quantities(record: TimeRecord, outputs: tuple[Dof, ...], wanted: Quantity | None) -> list[Quantity]:
    """Quantity of motion to use for each of `outputs` of `record`; `wanted` for an output with several.

    Raises `InputError` if there are no outputs, one is no motion channel or has several quantities and `wanted` is None
    or not among them, or `wanted` is no quantity of motion.
    """
    if not outputs:
        raise InputError("`outputs` must name at least one channel, got none")
    if wanted is not None and wanted not in KINDS:
        raise InputError(f"`quantity` must be one of {', '.join(KINDS)}, got {wanted!r}")
    quantities: list[Quantity] = []
    for output in outputs:
        pairs = zip(record.channels, record.quantities, strict=True)
        available = [quantity for dof, quantity in pairs if dof == output and quantity in KINDS]
        if not available:
            has = ", ".join(f"{dof} {q}" for dof, q in zip(record.channels, record.quantities, strict=True))
            raise InputError(f"`outputs` must be motion channels, and {output} is none; the record has {has}")
        if len(available) > 1 and wanted not in available:
            raise InputError(f"`outputs` have {' and '.join(available)} at {output}; choose one with `quantity`")
        quantities.append(wanted if wanted is not None and wanted in available else available[0])
    return quantities


def _columns(record: TimeRecord, dofs: tuple[Dof, ...], quantities: Sequence[Quantity]) -> list[int]:
    """Column index in `record.values` of the channel, load or motion, with each of `dofs` and its quantity.

    `quantities` has an entry for each. `InputError` if one is missing, or `dofs`, taken for the inputs, is empty.
    """
    if not dofs:
        raise InputError(
            "no channel is a force, so `inputs` names none: name the channel of the load (`quantities`), or of the support that"
            " drives the structure; of ambient motion `structid modes` gives modes, which a study takes in [record.modes]"
        )
    present = list(zip(record.channels, record.quantities, strict=True))
    pairs = list(zip(dofs, quantities, strict=True))
    missing = [str(dof) for dof, quantity in pairs if (dof, quantity) not in present]
    if missing:
        has = ", ".join(str(dof) for dof, q in present if q == quantities[0]) or "none"
        raise InputError(f"the record has no {quantities[0]} channel {', '.join(missing)}; it has {has}")
    return [present.index(pair) for pair in pairs]


def _average_spectra(
    records: list[TimeRecord],
    columns: tuple[list[int], list[int]],
    weights: FloatArray,
    step: int,
    detrend: Detrend,
) -> tuple[Spectra, int]:
    """Spectra averaged over all segments, in the order inputs, outputs by inputs, outputs, and the number of segments.

    They are (n_lines, n_inputs, n_inputs), (n_lines, n_outputs, n_inputs) and, autospectra alone, (n_lines, n_outputs),
    not scaled. `columns` are the indices of inputs and of outputs in each of `records`, `weights` (segment_length,)
    those of the window; segments begin `step` samples apart, and `detrend` is taken off each. Raises `InputError` if it
    is unknown or no record is as long as a segment.
    """
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
    """Raise `InputError` if an input has no power at a line, inputs are coherent, or segments are fewer than inputs.

    Inputs are coherent if their spectral matrix, scaled to a unit diagonal, has a condition number above 1e8. `count`
    is the number of segments, `frequency` (n_lines,) in Hz.
    """
    power = np.einsum("fii->fi", spectra.inputs).real
    silent = np.argwhere(power <= 0)
    if silent.size:
        line, i = silent[0]
        if (power[:, i] <= 0).all():
            raise InputError(
                f"input {inputs[i]} has no power at any line, as a dead channel or a constant load has none:"
                " check the channel, or excite the structure by a force that varies"
            )
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
        frequency_at = frequency[int(np.argmax(condition))]
        raise InputError(
            f"the inputs cannot be separated at {frequency_at:g} Hz, where they are coherent; drive them independently, or"
            " fit the histories themselves ([record.time]), where forces may act together"
        )


def _require_moving(spectra: Spectra, outputs: tuple[Dof, ...], frequency: FloatArray) -> None:
    """Raise `InputError` if one of `outputs` has no power at a line; `frequency` (n_lines,) is in Hz."""
    still = np.argwhere(spectra.outputs <= 0)
    if still.size:
        line, o = still[0]
        raise InputError(
            f"output {outputs[o]} has no power at {frequency[line]:g} Hz, as a dead channel has none: check it, or leave it out"
        )


def effective_averages(weights: FloatArray, step: int, segments: Sequence[int]) -> float:
    """Number of independent segments that give a spectrum the same variance as the overlapping segments do.

    It is summed over the records. A record of K segments under the window w has
    K / (1 + 2 sum_j (1 - j / K) r_j), r_j = (sum_k w_k w_(k + j step))^2 / (sum_k w_k^2)^2.

    Parameters
    ----------
    weights : (segment_length,) float array
        Window.
    step : int
        Samples between the starts of segments.
    segments : sequence of int
        Number of segments in each record; records are independent.

    References
    ----------
    Welch (1967), IEEE Trans. Audio Electroacoust. 15, 70-73.
    """
    lags = range(step, weights.size, step)
    shared = np.array([np.dot(weights[lag:], weights[:-lag]) for lag in lags]) / np.dot(weights, weights)
    total = 0.0
    for count in segments:
        j = np.arange(1, min(count, shared.size + 1))
        total += count / (1 + 2 * float(np.sum((1 - j / count) * shared[: j.size] ** 2)))
    return total


def require_repeated(records: Sequence[TimeRecord]) -> None:
    """Raise `InputError` if repeats differ in channels, quantities or sampling rate."""
    sources = [record.source for record in records]
    channels = [
        [f"{dof} {quantity}" for dof, quantity in zip(record.channels, record.quantities, strict=True)]
        for record in records
    ]
    require_shared("channels", channels, sources)
    require_shared("their sampling rate, Hz", [(record.sampling_rate,) for record in records], sources)


def require_alike(records: list[TimeRecord], segment_length: int | None) -> None:
    """Raise `InputError` if repeats are none, differ in channels or rate, or need a `segment_length` and have None.

    One record needs it (in samples), and so do records of different lengths. Whether it fits them is not checked.
    """
    if not records:
        raise InputError("`records` must hold at least one time record, got none")
    require_repeated(records)
    if segment_length is not None:
        return
    if len(records) == 1:
        raise InputError(
            "`segment_length` must be given for one record; choose it several times the decay of the response"
        )
    if any(record.values.shape != records[0].values.shape for record in records):
        raise InputError("`segment_length` must be given for records of different lengths")


def segment_step(length: int, overlap: float) -> int:
    """Samples from the start of a segment to the start of the next, at least 1; `overlap` is a fraction of `length`.

    Raises
    ------
    InputError
        If `length` is below 2, or `overlap` is not from 0 to less than 1.
    """
    if length < 2:
        raise InputError(f"`segment_length` must be at least 2 samples, got {length}")
    if not 0 <= overlap < 1:
        raise InputError(f"`overlap` must be from 0 to less than 1, got {overlap}")
    return max(length - int(overlap * length), 1)


def window_weights(window: Window, length: int) -> FloatArray:
    """Weights, (length,), of a window that `scipy.signal.get_window` knows by `window`; `InputError` for another."""
    from scipy.signal import get_window

    try:
        weights = np.asarray(get_window(window, length), dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"`window` must be one of scipy.signal.get_window, got {window!r} ({error})") from error
    return weights


def segment_count(record: TimeRecord, length: int, step: int) -> int:
    """Number of whole segments of `length` samples in `record` that begin `step` samples apart."""
    return max((record.values.shape[0] - length) // step + 1, 0)


def segment_transforms(
    records: list[TimeRecord], weights: FloatArray, step: int, detrend: Detrend
) -> Iterator[ComplexArray]:
    """Fourier transform (n_lines, n_channels) of each detrended and windowed segment of each record, not scaled.

    Lines are those of `numpy.fft.rfft`, from 0 Hz to half the sampling rate. `weights` (segment_length,) are those of the
    window; segments begin `step` samples apart, and `detrend` is taken off each.
    """
    from scipy.signal import detrend as without_trend

    length = weights.size
    for record in records:
        for i in range(segment_count(record, length, step)):
            part = record.values[i * step : i * step + length]
            if detrend != "none":
                part = without_trend(part, axis=0, type=detrend)
            yield np.fft.rfft(part * weights[:, None], axis=0)


def estimate_frf(
    spectra: Spectra, estimator: Estimator, averages: float
) -> tuple[ComplexArray, FloatArray, FloatArray | None]:
    """FRF values, coherence and variance of the values, (n_lines, n_outputs, n_inputs) each.

    The coherence g2 is the same for all inputs. The variance of H1 is (1 - g2) S_yy [S_xx^-1]_ii / (n - q) for n =
    `averages` and q inputs; that of H2 and Hv has the same ratio to |H|^2. It is None unless n is above q.

    Raises
    ------
    InputError
        If the estimator is not known or cannot be formed from these spectra.
    """
    xx, yx, yy = spectra
    count = xx.shape[1]
    inverse = np.linalg.inv(xx)
    h1 = yx @ inverse
    explained = np.einsum("foi,foi->fo", h1, yx.conj()).real
    ratio = np.divide(explained, yy, out=np.zeros_like(yy), where=yy > 0)
    coherence = np.repeat(np.clip(ratio, 0.0, 1.0)[:, :, None], count, axis=2)
    values = _estimate_frfs(h1, spectra, estimator)
    variance = None
    if averages > count:
        gain = np.einsum("fii->fi", inverse).real[:, None, :]
        variance = (1 - coherence) * yy[:, :, None] * gain / (averages - count)
        if estimator != "H1":
            h1_power = np.abs(h1) ** 2
            relative = np.divide(variance, h1_power, out=np.zeros_like(variance), where=h1_power > 0)
            variance = np.where(h1_power > 0, relative * np.abs(values) ** 2, variance)
    return values, coherence, variance


def _estimate_frfs(h1: ComplexArray, spectra: Spectra, estimator: Estimator) -> ComplexArray:
    """FRFs by the estimator H1, H2 or Hv from averaged spectra, (n_lines, n_outputs, n_inputs).

    `h1` (n_lines, n_outputs, n_inputs) are the FRFs of H1. Raises `InputError` for H2 with several inputs, or if an
    estimate divides by 0.
    """
    if estimator == "H1":
        return h1
    if estimator == "Hv":
        return _total_least_squares(spectra)
    if estimator != "H2":
        raise InputError(f"`estimator` must be H1, H2 or Hv, got {estimator!r}")
    if h1.shape[2] != 1:
        raise InputError(f"H2 takes one input, got {h1.shape[2]}; use H1 or Hv for several")
    xy = spectra.cross.conj()
    if (np.abs(xy) == 0).any():
        raise InputError("H2 divides by the cross spectrum, which is 0 at a line; use H1 or check that output")
    return spectra.outputs[:, :, None] / xy


def _total_least_squares(spectra: Spectra) -> ComplexArray:
    """Hv estimate of the FRFs by total least squares, (n_lines, n_outputs, n_inputs).

    It is the smallest eigenvector of the spectra of all inputs and one output, each scaled to unit power. Raises `InputError` if
    that has no part of the output at a line.
    """
    xx, yx, yy = spectra
    lines, outputs, inputs = yx.shape
    values = np.zeros_like(yx)
    for o in range(outputs):
        joint = np.empty((lines, inputs + 1, inputs + 1), dtype=np.complex128)
        joint[:, :inputs, :inputs] = xx
        joint[:, inputs, :inputs] = yx[:, o]
        joint[:, :inputs, inputs] = yx[:, o].conj()
        joint[:, inputs, inputs] = yy[:, o]
        scale = np.sqrt(np.einsum("fii->fi", joint).real)
        vector = np.linalg.eigh(joint / (scale[:, :, None] * scale[:, None, :]))[1][:, :, 0]
        weight = vector.conj() / scale
        if (weight[:, inputs] == 0).any():
            raise InputError("Hv cannot be formed at a line where the output is not in the balance; use H1")
        values[:, o] = -weight[:, :inputs] / weight[:, inputs, None]
    return values


@dataclass(frozen=True, eq=False)
class FiniteSpectra:
    """Laplace integrals of forces and motions over one finite stretch, on a line parallel to the imaginary axis.

    Parameters
    ----------
    frequency : (n_frequencies,) float array
        Hz, each a multiple of 1 / `duration`.
    duration : float
        s.
    force : (n_frequencies, n_inputs) complex array
        Integral of f(t) exp(-s t) dt from the start to the end of the record, s = decay + i omega; N s. Of a support that
        drives the structure, that of its acceleration.
    motion : (n_frequencies, n_outputs) complex array
        The same of every motion channel, in its SI unit times s.
    inputs, outputs : tuple of Dof
    orders : (n_outputs,) int array
        0 for displacement, 1 for velocity, 2 for acceleration.
    force_variance : (n_frequencies, n_inputs) float array
        E|error|^2 of each complex value; zeros where the force is known.
    motion_variance : (n_frequencies, n_outputs) float array
        The same of the motions; positive.
    decay : float
        Real part of s, 1/s; 0 for Fourier integrals.
    source : str
    driven : (n_inputs,) bool array
        Which inputs are accelerations of supports; none by default.
    straight : float
        s; the sampling interval where inputs run straight between samples, see `hold_factor`. 0: nothing is above half
        the sampling rate.
    """

    frequency: FloatArray
    duration: float
    force: ComplexArray
    motion: ComplexArray
    inputs: tuple[Dof, ...]
    outputs: tuple[Dof, ...]
    orders: np.ndarray
    force_variance: FloatArray
    motion_variance: FloatArray
    decay: float = 0.0
    source: str = ""
    driven: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    straight: float = 0.0

    def __post_init__(self) -> None:
        """Make arrays read-only, spread variances over all lines, and raise `InputError` on wrong shapes or values.

        Values must be finite, variances of forces at least 0 and of motions above 0; an empty `driven` becomes all
        False.
        """
        for name, kind in (("frequency", float), ("force", complex), ("motion", complex)):
            object.__setattr__(self, name, locked(getattr(self, name), kind))
            require_finite(name, getattr(self, name))
        object.__setattr__(self, "orders", locked(self.orders, int))
        driven = self.driven if np.size(self.driven) else np.zeros(len(self.inputs), dtype=bool)
        object.__setattr__(self, "driven", locked(driven, bool))
        require_shape("driven", self.driven, (len(self.inputs),))
        require_shape("force", self.force, (len(self.frequency), len(self.inputs)))
        require_shape("motion", self.motion, (len(self.frequency), len(self.outputs)))
        pairs = (("force_variance", self.force, self.inputs), ("motion_variance", self.motion, self.outputs))
        for name, array, channels in pairs:
            variance = locked(np.broadcast_to(getattr(self, name), array.shape), float)
            require_finite(name, variance)
            object.__setattr__(self, name, variance)
            least = variance.min(axis=0)
            wrong = least < 0 if name == "force_variance" else least <= 0
            if wrong.any():
                i = int(np.argmax(wrong))
                raise InputError(
                    f"`{name}` must be {'at least' if name == 'force_variance' else 'above'} 0, got {least[i]:g} of"
                    f" {channels[i]}; declare the noise of every sensor"
                )

    @property
    def laplace(self) -> ComplexArray:
        """s = decay + i omega of each line, 1/s."""
        return self.decay + 2j * np.pi * self.frequency

    @cached_property
    def output_powers(self) -> ComplexArray:
        """Power s^d of the Laplace variable that turns displacement into each output, (n_frequencies, n_outputs)."""
        return self.laplace[:, None] ** self.orders[None, :]

    @cached_property
    def input_powers(self) -> ComplexArray:
        """Ratio of recorded to acting inputs, (n_frequencies, n_inputs): 1 for forces, s^2 for support accelerations."""
        return self.laplace[:, None] ** (2 * self.driven)[None, :]

    @cached_property
    def hold_factor(self) -> ComplexArray:
        """Transform of a first-order hold input over that of its samples, (n_frequencies,).

        It is (sinh(s dt/2) / (s dt/2))^2 with the sampling interval dt = `straight` in s, and 1 where `straight` is 0.
        """
        if not self.straight:
            return np.ones(len(self.frequency), dtype=np.complex128)
        half = 0.5 * self.straight * self.laplace
        return (np.sinh(half) / half) ** 2

    @cached_property
    def hold_aliases(self) -> ComplexArray:
        """Alias terms of a first-order hold input in sampled motions, (n_frequencies, n_outputs); 0 unless `straight`.

        An input that is linear between samples has parts at all s_k = s + 2 pi i k / dt, whose responses add up in sampled
        motions. At these a structure responds by its mass alone, as D s_k^(order - 2); the result is the factor of D, per unit
        of the transform of the input's samples.
        """
        if not self.straight:
            return np.zeros((len(self.frequency), len(self.orders)), dtype=np.complex128)
        step, s = self.straight, self.laplace
        others = np.r_[-_ALIASES:0, 1 : _ALIASES + 1]
        replicas = s[:, None] + 2j * np.pi * others / step
        height = (2 * np.sinh(0.5 * step * s) / step) ** 2
        of_order = [height * (replicas ** (order - 4.0)).sum(axis=1) for order in (0, 1)]
        of_order.append(1 - self.hold_factor)  # all of them together are 1
        return np.stack(of_order, axis=1)[:, self.orders]

    def lines(self, keep: np.ndarray) -> FiniteSpectra:
        """The spectra at the lines where the mask `keep` (n_frequencies,) is True.

        Raises
        ------
        NoLinesError
            If no line is left.
        """
        if not keep.any():
            raise NoLinesError(f"no line is left of {self.frequency[0]:g}-{self.frequency[-1]:g} Hz; widen the band")
        names = ("frequency", "force", "motion", "force_variance", "motion_variance")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


def finite_spectra(
    record: TimeRecord,
    inputs: Iterable[str | Dof] | None = None,
    outputs: Iterable[str | Dof] | None = None,
    band: tuple[float, float] | None = None,
    decay: float = 0.0,
    straight: bool = False,
) -> FiniteSpectra:
    """Finite Fourier (Laplace) transforms of a whole time record, with the noise of every line.

    Parameters
    ----------
    record : TimeRecord
        Record with the noise variance of its channels; that of a force may be 0.
    inputs, outputs : iterable of str or Dof, optional
        Force (or support acceleration) and motion channels; all by default. A degree of freedom measured in several
        quantities gives an output for each.
    band : (float, float), optional
        Lowest and highest line in Hz; every line above 0 Hz and below half the sampling rate by default.
    decay : float
        Decay in 1/s: signals are multiplied by exp(-decay t) first. It blurs lines over decay / pi Hz, and only lines
        that far apart are kept, whose noise is nearly independent.
    straight : bool
        True if forces are linear between samples, as in simulations; False if they hold nothing above half the sampling
        rate, as after an anti-alias filter.

    Returns
    -------
    FiniteSpectra
        Integrals of force (n_frequencies, n_inputs), N s, and of motion (n_frequencies, n_outputs), SI unit times s,
        with E|error|^2 of each.

    Raises
    ------
    InputError
        If channels are missing, or the noise is not declared.
    NoLinesError
        If no line lies in the band.

    Notes
    -----
    The integrals are sums of samples times the sampling interval, so signals must hold nothing above half the
    sampling rate, except forces that are `straight`. White noise of variance v gives
    E|error|^2 = v dt^2 sum exp(-2 decay t) at every line.
    """
    if record.variance is None:
        raise InputError("the record has no noise level; declare the noise variance of its channels")
    step = 1 / record.sampling_rate
    n_times = len(record.values)
    forces = _choose_columns(record, inputs, LOADS, "input")
    motions = _choose_columns(record, outputs, tuple(MOTION_DERIVATIVES), "output")
    frequency = np.fft.rfftfreq(n_times, step)
    low, high = band or (0.5 * frequency[1], 0.5 * record.sampling_rate * (1 - 1e-9))
    keep = np.flatnonzero((frequency >= low) & (frequency <= high) & (frequency > 0))
    keep = keep[:: max(1, round(decay * n_times * step / np.pi))]
    if not keep.size:
        raise NoLinesError(f"no line lies between {low:g} and {high:g} Hz; lines are {frequency[1]:g} Hz apart")
    fading = np.exp(-decay * step * np.arange(n_times))
    spectra = np.fft.rfft(record.values * fading[:, None], axis=0)[keep] * step
    noise = record.variance * (fading @ fading) * step**2
    return FiniteSpectra(
        frequency=frequency[keep],
        duration=n_times * step,
        force=spectra[:, forces],
        motion=spectra[:, motions],
        inputs=tuple(record.channels[i] for i in forces),
        outputs=tuple(record.channels[i] for i in motions),
        orders=np.array([MOTION_DERIVATIVES[record.quantities[i]] for i in motions]),
        force_variance=np.broadcast_to(noise[forces], (len(keep), len(forces))),
        motion_variance=np.broadcast_to(noise[motions], (len(keep), len(motions))),
        decay=decay,
        source=record.source,
        driven=np.array([record.quantities[i] == "support_acceleration" for i in forces]),
        straight=step if straight else 0.0,
    )


def _choose_columns(
    record: TimeRecord, wanted: Iterable[str | Dof] | None, quantities: tuple[str, ...], role: str
) -> list[int]:
    """Column indices of the channels with one of `quantities`, in the record's order, or in that of `wanted` if not None.

    `role` is "input" or "output", for messages. Raises `InputError` if a wanted channel is missing or none is left.
    """
    columns = [i for i, quantity in enumerate(record.quantities) if quantity in quantities]
    if wanted is not None:
        dofs = parse_dofs(wanted)
        for dof in dofs:
            if not any(record.channels[i] == dof for i in columns):
                have = ", ".join(str(record.channels[i]) for i in columns)
                raise InputError(f"the record has no {role} channel {dof}; it has {have or 'none'}")
        columns = [i for dof in dofs for i in columns if record.channels[i] == dof]
    if not columns:
        raise InputError(
            f"the record has no {role} channel; it needs motions, and forces or the acceleration of supports that are named in"
            " a [[structure.base]]"
        )
    return columns
