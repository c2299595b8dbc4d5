"""Modes from frequency response functions: poles over orders, clusters, refinement, and shapes scaled to mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError, NoModesError
from structid.modal.frf.lscf import FrfBand, PoleSweep, frf_band, pole_sweep
from structid.modal.frf.refinement import (
    DrivingPoint,
    FrfData,
    FrfModes,
    PolesAndParticipation,
    correlation_excess,
    frequency_damping_covariance,
    frf_modes,
    misfit,
    refined,
    residuals,
    scaled_shapes,
)
from structid.modal.method import LeftOut, ModalIdentification, ModalOptions, by_rising_frequency
from structid.modal.modal_record import ModalRecord, by_frequency, joined
from structid.modal.poles.poles import Poles
from structid.modal.poles.stabilization import Cluster
from structid.modal.subspace.subspace_modes import left_out_clusters, picked_poles
from structid.records.record import FrfRecord

_MOST_OUTSIDE = 6  # steps of `_outside` below the band, and above
_PAYS = 2.0  # fall of the misfit that each unknown of theirs must bring, in mean squares of the residual (Akaike 1974)
_NO_MODE_REMEDY = "look at the FRFs, choose another band, or raise the greatest order"
_DOUBTFUL_SCALE = 0.5  # relative standard deviation of a shape's factor above which the driving point shows no mass


@dataclass(frozen=True, eq=False)
class _BandModes:
    """Poles and modes identified in one band."""

    modes: FrfModes
    converged: bool
    sweep: tuple[Poles, ...]
    clusters: tuple[Cluster, ...]
    notes: tuple[str, ...]
    left_out: tuple[LeftOut, ...]


def lscf(record: FrfRecord, options: ModalOptions) -> ModalIdentification:
    """Modes of FRFs by the poly-reference least-squares complex frequency method, refined by least squares.

    Parameters
    ----------
    record : FrfRecord
        Receptance, mobility or accelerance, any number of outputs and inputs. Weighted by its variance if it has one.
    options : ModalOptions
        `bands`, or else the frequency range of `criteria`, give the lines used; by default all but 0 Hz. `orders`
        count states: the number of inputs times the order of the polynomials.

    Returns
    -------
    ModalIdentification
        Complex shapes as displacement: of modal mass 1 where an output and an input share a degree of freedom
        (`scaled_shapes` states the formula), of largest entry 1 otherwise.

    Raises
    ------
    InputError
        If a band has too few lines, bands overlap, or a channel is zero.
    NoModesError
        If no stable mode is found.

    Notes
    -----
    The covariance is of first order, for errors independent from line to line. It comes from the record's variance;
    without one, or where the misfit is more than that variance allows, from the squares of the residual, which is
    then taken as noise. Where the residual is correlated from line to line, as when the model leaves something out, the
    variances of an output's errors are multiplied by the most that this correlation can do (`correlation_excess`), and a
    warning says so. Modes outside the band stand as powers of s, as many as pay by Akaike's criterion.
    """
    outcomes = [_of_band(record, low, high, options) for low, high in _bands(record, options)]
    modes = _modal_record(record, outcomes)
    sweep = tuple(poles for outcome in outcomes for poles in outcome.sweep)
    clusters, before = [], 0
    for outcome in outcomes:
        clusters += [replace(cluster, number=cluster.number + before) for cluster in outcome.clusters]
        before += len(outcome.sweep)
    left_out = by_rising_frequency(part for outcome in outcomes for part in outcome.left_out)
    return ModalIdentification(modes, "lscf", sweep, tuple(clusters), options, left_out)


def _bands(record: FrfRecord, options: ModalOptions) -> list[tuple[float, float]]:
    """Frequency bands (low, high), Hz, rising, in which modes are identified: `options.bands`, or by the criteria.

    Without `bands` it is the frequency range of `options.criteria`, cut to the lines of the record. `InputError` unless
    the record is one of FRFs, or if two bands overlap.
    """
    if not isinstance(record, FrfRecord):
        raise InputError("`record` must be an FrfRecord; compute FRFs with frf_from_time, which needs a force channel")
    if not options.bands:
        low, high = options.criteria.frequency
        return [(max(low, float(record.frequency[0])), min(high, float(record.frequency[-1])))]
    return sorted(options.separate_bands)


def _of_band(record: FrfRecord, low: float, high: float, options: ModalOptions) -> _BandModes:
    """Modes of the FRFs of `record` between `low` and `high` (Hz), with their poles, clusters and notes.

    Poles that are stable over the model orders, or nearest to `options.frequencies`, are refined by least squares.
    `NoModesError` if there is none.
    """
    band = frf_band(record, low, high)
    poles = pole_sweep(band, options.orders, options.criteria)
    selection = picked_poles(poles.sweep, band.output_scale, options)
    picked, clusters, notes = selection.places, selection.clusters, selection.notes
    if not picked:
        raise NoModesError(
            f"`record` shows no mode from {low:g} to {high:g} Hz that is stable over `orders` and meets `criteria`; "
            + _NO_MODE_REMEDY
        )
    start = _start(poles, picked, band)
    modes, kept, converged, words = _refine_band(band, start, options)
    clusters = tuple(clusters[i] for i in kept) if clusters else ()
    s, others = modes.at.poles, selection.others if options.frequencies is None else ()
    left_out = left_out_clusters(others, np.abs(s) / (2 * np.pi), -s.real / np.abs(s))
    return _BandModes(modes, converged, poles.sweep, clusters, (*notes, *words), tuple(left_out))


def _start(poles: PoleSweep, picked: Sequence[tuple[int, int]], band: FrfBand) -> PolesAndParticipation:
    s = np.array([poles.sweep[k].poles[i] for k, i in picked])
    participation = np.stack([poles.participation[k][:, i] for k, i in picked], axis=1) * band.input_scale[:, None]
    return PolesAndParticipation(s, participation, np.zeros(len(s), dtype=bool))


def _refine_band(
    band: FrfBand, start: PolesAndParticipation, options: ModalOptions
) -> tuple[FrfModes, IntArray, bool, list[str]]:
    """Least-squares modes of one band refined from `start`, indices (n_kept,) of poles kept, convergence, and notes.

    Indices refer to `start` and are sorted by frequency. Poles that leave the band or `options.criteria` are fixed
    where they started; those that fit noise only are left out, unless `options.frequencies` are set. `NoModesError` if
    none is left. Convergence is True if the last search converged; notes are sentences on poles left out or fixed,
    convergence and standard deviations.
    """
    notes: list[str] = []
    kept: IntArray = np.arange(len(start.poles))
    while True:
        parameters, data, converged = _fit_with_residual_modes(band, start)
        excess = _excess(data, parameters) if band.variance is not None else 1.0
        lost = _is_lost(parameters, band, options) & ~parameters.fixed
        if lost.any():
            start = replace(start, fixed=start.fixed | lost)
            continue
        widening = correlation_excess(residuals(data, parameters))
        from_residual = band.variance is None or excess > 1
        modes = frf_modes(data, parameters, from_residual, widening)
        weak = _weakest(modes) if options.frequencies is None else np.zeros(len(parameters.poles), dtype=bool)
        if not weak.any():
            break
        if len(weak) == 1 and parameters.fixed.all():
            raise NoModesError(
                f"the only mode that `record` shows from {band.edges[0]:g} to {band.edges[1]:g} Hz, at"
                f" {abs(parameters.poles[0]) / (2 * np.pi):.4g} Hz, leaves this band when it is refined; put the ends of the"
                " band between resonances, away from them"
            )
        if len(weak) == 1:
            raise NoModesError(
                f"`record` shows noise only from {band.edges[0]:g} to {band.edges[1]:g} Hz; {_NO_MODE_REMEDY}"
            )
        notes.append(
            f"a pole at {abs(parameters.poles[weak][0]) / (2 * np.pi):.4g} Hz was left out: it explains noise only"
        )
        start, kept = start.select(np.flatnonzero(~weak)), kept[~weak]
    order = np.argsort(np.abs(parameters.poles), kind="stable")
    parameters, kept = parameters.select(order), kept[order]
    if parameters.fixed.any():
        listed = ", ".join(f"{f:.4g}" for f in np.abs(parameters.poles[parameters.fixed]) / (2 * np.pi))
        notes.append(
            f"refinement carries the pole at {listed} Hz out of the band or `criteria`: it stays as found from the "
            "sweep, without standard deviation; narrow the band around it by `bands`"
        )
    if not converged:
        notes.append(
            "the refinement of the poles did not settle: no covariance; narrow the band, or name `frequencies`"
        )
    if excess > 1:
        notes.append(
            f"the misfit is {np.sqrt(excess):.2g} times what the record's variance explains (modes outside of the model, "
            "leakage, nonlinearity, or a variance that is too small); standard deviations are from the residual"
        )
    if widening.max() > 1:
        notes.append(
            "the residual of the FRFs is correlated from line to line (modes just outside the band, or missing in it, leakage, "
            f"nonlinearity): standard deviations are widened, up to {np.sqrt(widening.max()):.2g} times; put the ends of the "
            "band between resonances, away from both"
        )
    return frf_modes(data, parameters, from_residual, widening), kept, converged, notes


def _fit_with_residual_modes(
    band: FrfBand, start: PolesAndParticipation
) -> tuple[PolesAndParticipation, FrfData, bool]:
    """Least-squares fit of the modes in one band from `start`: poles, data with their weights, whether converged.

    Powers of s that stand for modes outside the band are added, up to six steps on either side, as long as each new
    unknown lowers the misfit by more than twice the mean square of the residual.
    """
    data, parameters = _data(band, band.variance), start
    for gain in (1e-3, 1e-5):
        data = _reweight(band, data, parameters)
        parameters, _ = refined(data, parameters, gain)
    below = above = 1
    while True:
        data = _reweight(band, data, parameters)
        widened = _wider(
            data, parameters, [w for w in ((below + 1, above), (below, above + 1)) if max(w) <= _MOST_OUTSIDE]
        )
        if widened is None:
            break
        (below, above), data, parameters = widened
    parameters, converged = refined(data, parameters)
    return parameters, data, converged


def _wider(
    data: FrfData, parameters: PolesAndParticipation, widths: Sequence[tuple[int, int]]
) -> tuple[tuple[int, int], FrfData, PolesAndParticipation] | None:
    """More powers of s for modes outside the band: numbers (below, above), data and refitted poles; None if none pays.

    `widths` are candidate numbers (below, above) of powers on either side; the one with the least misfit at the present
    poles `parameters` is tried first. No more than half of the real values may be taken up by unknowns, and each new unknown
    must lower the misfit by twice the mean square of the residual.
    """
    cost, freedom = misfit(data, parameters), _freedom(data, parameters)
    trials = [(width, replace(data, outside=_outside(*width))) for width in widths]
    trials = [(width, wider) for width, wider in trials if _freedom(wider, parameters) >= data.values.size]
    for width, wider in sorted(trials, key=lambda trial: misfit(trial[1], parameters)):
        moved, _ = refined(wider, parameters, 1e-4)
        if cost - misfit(wider, moved) > _PAYS * (freedom - _freedom(wider, parameters)) * cost / freedom:
            return width, wider, moved
    return None


def _outside(below: int, above: int) -> tuple[int, ...]:
    """Powers of s of a receptance for modes outside the band: all from -2 `below` to -2, and all from 0 to 2 `above` - 2.

    For `below` 0 there are no negative powers, for `above` 0 no others.
    """
    return (*range(-2 * below, -1), *range(2 * above - 1))


def _reweight(band: FrfBand, data: FrfData, parameters: PolesAndParticipation) -> FrfData:
    """`data` with new weights from the residual around each line; unchanged if the record has a variance."""
    if band.variance is not None:
        return data
    return replace(data, weights=_data(band, _residual_variance(data, parameters, band)).weights)


def _weakest(modes: FrfModes) -> np.ndarray:
    """Mask (n_modes,) of the mode least certain to exist, where noise alone could explain its shape; else all false.

    The sum over outputs of phi' cov^-1 phi counts as a gain in likelihood, which must exceed Schwarz's (1978) price of
    log(number of values) for each unknown of the mode.
    """
    n_outputs, n = modes.shapes.shape
    price = 2 * (n_outputs + len(modes.at.participation)) * np.log(2 * modes.residuals.size)
    gain = np.zeros(n)
    for m in range(n):
        for o, value in enumerate(modes.shapes[:, m]):
            parts = np.array([value.real, value.imag])
            covariance = modes.joint(m, (o, o))[-2:, -2:]
            if np.isfinite(covariance).all():
                gain[m] += parts @ np.linalg.lstsq(covariance, parts, rcond=None)[0]
    weakest = int(np.argmin(gain))
    return np.asarray((np.arange(n) == weakest) & (gain[weakest] < price))


def _data(band: FrfBand, variance: FloatArray | None) -> FrfData:
    scale = band.output_scale[:, None] * band.input_scale
    weights = np.ones(band.values.shape) if variance is None else np.sqrt(2 / variance)
    return FrfData(band.laplace, band.values * scale, weights / scale, band.power)


def _residual_variance(data: FrfData, parameters: PolesAndParticipation, band: FrfBand) -> FloatArray:
    """Mean square residual of the lines around each line, itself left out, (n_lines, n_outputs, n_inputs).

    The residual is that of `data` at the poles and participation `parameters`, without the weights, in the scale of
    `band`. The lines around are 15 on either side, or n_lines / 80 if that is more. The mean is not below rounding of
    the largest FRF. A weight that included the error of its own line would make that error look small.
    """
    scale = band.output_scale[:, None] * band.input_scale
    power = np.abs(residuals(data, parameters) / data.weights / scale) ** 2
    n = len(power)
    half = max(15, n // 80)
    total = np.concatenate([np.zeros((1, *power.shape[1:])), np.cumsum(power, axis=0)])
    first, last = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
    mean = (total[last] - total[first] - power) / (last - first - 1)[:, None, None]
    return np.maximum(mean, (np.finfo(float).eps * np.abs(band.values).max()) ** 2)


def _is_lost(parameters: PolesAndParticipation, band: FrfBand, options: ModalOptions) -> np.ndarray:
    """Mask (n_modes,) of poles that the fit moved out of the band, the damping range or the upper half plane.

    A damping ratio must be within `options.criteria`; its frequency range has no part. `parameters` has the poles after the
    fit.
    """
    size = np.abs(parameters.poles)
    frequency, (low, high) = size / (2 * np.pi), band.edges
    inside = replace(options.criteria, frequency=(0.0, np.inf)).meets(frequency, -parameters.poles.real / size)
    return np.asarray(~(inside & (frequency > low) & (frequency < high)) | (parameters.poles.imag <= 0))


def _freedom(data: FrfData, parameters: PolesAndParticipation) -> int:
    """Degrees of freedom of the fit: number of real values less unknowns, at least 1."""
    _, n_outputs, n_inputs = data.values.shape
    n_linear = 2 * len(parameters.poles) + len(data.outside) * n_inputs
    return max(2 * data.values.size - len(parameters.free) - n_outputs * n_linear, 1)


def _excess(data: FrfData, parameters: PolesAndParticipation) -> float:
    """Weighted sum of squares over its degrees of freedom if that exceeds 1 significantly (by 4 deviations), else 1."""
    freedom = _freedom(data, parameters)
    ratio = misfit(data, parameters) / freedom
    return ratio if ratio > 1 + 4 * np.sqrt(2 / freedom) else 1.0


def _modal_record(record: FrfRecord, outcomes: Sequence[_BandModes]) -> ModalRecord:
    """Modal record of all bands in `outcomes`; errors of different bands are independent, since their lines are.

    Shapes have modal mass 1 if a driving point shows the mass of every mode, else largest entry 1 (and a warning if
    there is a driving point). Covariance and standard deviations are NaN for a band whose refinement did not converge.
    """
    driving = [
        DrivingPoint(o, i, out.sign * load.sign)
        for o, out in enumerate(record.outputs)
        for i, load in enumerate(record.inputs)
        if out.unsigned == load.unsigned
    ]
    notes = [note for outcome in outcomes for note in outcome.notes]
    if driving and (words := _scaling_warning(outcomes, driving)):
        notes.append(words)
        driving = []
    parts = []
    for outcome in outcomes:
        s = outcome.modes.at.poles
        shapes, std, _ = scaled_shapes(outcome.modes, driving or None)
        covariance = frequency_damping_covariance(outcome.modes)
        if not outcome.converged:
            covariance, std = np.full_like(covariance, np.nan), np.full_like(std, np.nan)
        parts.append(
            by_frequency(
                np.abs(s) / (2 * np.pi), -s.real / np.abs(s), shapes, record.outputs, covariance, std,
                scaling="mass" if driving else "unit_largest",
            )
        )  # fmt: skip
    lines = record.frequency
    source = f"poly-reference LSCF with refinement, {record.kind}, {len(lines)} lines to {lines[-1]:g} Hz"
    return joined(parts, notes, source)


def _scaling_warning(outcomes: Sequence[_BandModes], driving: list[DrivingPoint]) -> str:
    """Warning that the driving point cannot scale shapes to mass, with the modes concerned; "" if it can.

    A mode is concerned if the relative standard deviation of its factor exceeds 0.5. `outcomes` are the modes of each
    band, `driving` the driving points.
    """
    doubt = np.concatenate([scaled_shapes(outcome.modes, driving)[2] for outcome in outcomes])
    still = np.flatnonzero(~(doubt <= _DOUBTFUL_SCALE))
    if not len(still):
        return ""
    s = np.concatenate([outcome.modes.at.poles for outcome in outcomes])
    listed = ", ".join(f"{abs(s[m]) / (2 * np.pi):.4g}" for m in still)
    return (
        f"the driving point shows no mass for the mode at {listed} Hz, which hardly moves it: shapes have largest entry 1. "
        "Leave that mode out by `frequencies`, or excite elsewhere"
    )
