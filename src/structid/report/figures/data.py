"""What the figures show, as plain arrays: both renderers draw these and compute nothing themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.dof import Dof
from structid.identification.identified import Identification
from structid.identification.record_fit import RecordFit

#: Half width of a 95 % interval in standard deviations.
NORMAL_95 = 1.959964
_MOTION = {"receptance": ("m", "rad"), "mobility": ("m/s", "rad/s"), "accelerance": ("m/s^2", "rad/s^2")}


@dataclass(frozen=True, eq=False)
class ParameterRatios:
    """Parameters over their initial values.

    Attributes
    ----------
    names : tuple of str
    ratio, std : (n_params,) float arrays
        Identified value and its standard deviation; NaN where the initial value is 0 or nothing is known.
    interval : (n_params, 2) float array
        Ends of the 95 % interval; those of 1.96 standard deviations where it is open or not known.
    prior_mean, prior_std : (n_params,) float arrays
        The prior in the same ratio; NaN where there is none.
    identified : (n_params,) bool array
    limits : (float, float)
        Range of the axis.
    log : bool
        Whether the axis should be logarithmic.
    """

    names: tuple[str, ...]
    ratio: FloatArray
    std: FloatArray
    interval: FloatArray
    prior_mean: FloatArray
    prior_std: FloatArray
    identified: np.ndarray
    limits: tuple[float, float]
    log: bool

    @property
    def shown(self) -> FloatArray:
        """Ratios moved to the ends of the axis where they lie beyond."""
        return np.clip(self.ratio, *self.limits)

    @property
    def is_beyond(self) -> np.ndarray:
        """Parameters whose ratio lies beyond the axis."""
        return (self.ratio < self.limits[0]) | (self.ratio > self.limits[1])

    @property
    def is_wild(self) -> np.ndarray:
        """Parameters whose interval is unknown or much wider than the axis."""
        width = self.limits[1] - self.limits[0]
        return ~np.isfinite(self.std) | (self.std > 3 * width)


def parameter_ratios(identification: Identification) -> ParameterRatios:
    """Parameters and priors of `identification` over the initial values."""
    found = identification.estimate
    scale = np.where(found.initial != 0, found.initial, np.nan)
    size = np.abs(scale)
    ratio, std = found.values / scale, found.std / size
    prior_mean, prior_std = identification.prior_mean / scale, identification.prior_std / size
    interval = ratio[:, None] + NORMAL_95 * std[:, None] * np.array([-1.0, 1.0])
    if identification.intervals is not None:
        ends = np.sort(identification.intervals.ends / scale[:, None], axis=1)
        interval = np.where(np.isfinite(ends), ends, interval)
    low, high, log = _ratio_limits(ratio, interval, prior_mean, prior_std, found.identified)
    notes = ("" if initial else " (initial value 0)" for initial in found.initial)
    names = tuple(name + note for name, note in zip(found.names, notes, strict=True))
    return ParameterRatios(names, ratio, std, interval, prior_mean, prior_std, found.identified, (low, high), log)


def _ratio_limits(
    ratio: FloatArray, interval: FloatArray, prior_mean: FloatArray, prior_std: FloatArray, identified: np.ndarray
) -> tuple[float, float, bool]:
    """Axis limits that hold what is identified, with its interval, and the priors; others where they are near."""
    parts = [[1.0], *((part[identified]) for part in (ratio, *interval.T))]
    ends = np.concatenate([*parts, prior_mean - prior_std, prior_mean + prior_std])
    ends = ends[np.isfinite(ends)]
    centre = np.append(ratio[identified & np.isfinite(ratio)], 1.0)
    others = ratio[~identified & np.isfinite(ratio)]
    if (centre > 0).all() and centre.max() / centre.min() > 4:
        low, high = max(float(ends[ends > 0].min()), float(centre.min()) / 2), float(ends.max())
        near = others[(others > low / 3) & (others < 3 * high)]
        return min(low, *near) / 1.15 if near.size else low / 1.15, float(np.append(near, high).max()) * 1.15, True
    low, high = float(ends.min()), float(ends.max())
    reach = max(high - low, 0.2)
    near = others[(others > low - reach) & (others < high + reach)]
    low, high = float(np.append(near, low).min()), float(np.append(near, high).max())
    margin = max(0.06 * (high - low), 0.005)
    return low - margin, high + margin, False


def ratio_ticks(limits: tuple[float, float]) -> tuple[tuple[float, str], ...]:
    """Values and texts for a logarithmic axis of ratios: three to a decade, more where the axis is short."""
    low, high = limits
    steps = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if high / low < 15 else (1.0, 2.0, 5.0) if high / low < 300 else (1.0,)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    values = [step * 10.0**decade for decade in decades for step in steps]
    return tuple((value, f"{value:g}") for value in values if low <= value <= high)


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor and load: label, unit and how well it is fitted."""

    label: str
    unit: str
    sensor: str
    load: str
    median_error: float
    median_error_initial: float
    high_error: float


@dataclass(frozen=True, eq=False)
class Responses:
    """Frequency response functions on the axis of the whole record.

    Attributes
    ----------
    frequency : (n_lines,) float array
    used : (n_lines,) bool array
        Lines that had a part in the fit.
    channels : tuple of Channel
    measured, fitted, initial : (n_lines, n_channels) complex arrays
        The models are NaN where a line was neither used nor judged.
    coherence : (n_lines, n_channels) float array or None
    kind : str
    whitened : (n_lines, n_channels) float array
        Magnitude of the residual over its expected size; NaN where a line was not used.
    """

    frequency: FloatArray
    used: np.ndarray
    channels: tuple[Channel, ...]
    measured: ComplexArray
    fitted: ComplexArray
    initial: ComplexArray
    coherence: FloatArray | None
    kind: str
    whitened: FloatArray

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest line used, Hz."""
        used = self.frequency[self.used]
        return float(used[0]), float(used[-1])

    @property
    def sparse(self) -> bool:
        """Whether the lines used are too few to be joined."""
        return int(self.used.sum()) < 12


def channel_unit(kind: str, sensor: Dof, load: Dof) -> str:
    """SI unit of an FRF between a sensor and a load, rotations and moments included."""
    motion = _MOTION[kind][sensor.is_rotation]
    top = f"({motion})" if "/" in motion else motion
    return f"{top}/{'(N m)' if load.is_rotation else 'N'}"


def responses(fit: RecordFit) -> Responses:
    """Measured, initial and fitted FRFs of `fit`, channel by channel."""
    whole, used, judged = fit.measured, fit.problem.record, fit.evaluation
    n_lines = len(whole.frequency)
    rows, judged_rows = (np.searchsorted(whole.frequency, part.frequency) for part in (used, judged))
    mask = np.zeros(n_lines, dtype=bool)
    mask[rows] = True
    fitted, initial = (np.full(whole.values.shape, np.nan, dtype=np.complex128) for _ in range(2))
    fitted[judged_rows], initial[judged_rows] = fit.evaluation_predicted, fit.evaluation_initial
    fitted[rows], initial[rows] = fit.predicted, fit.predicted_initial
    n_data = fit.problem.n_data
    real, imaginary = fit.problem.residual(fit.theta)[:n_data].reshape(2, len(rows), -1)
    whitened = np.full((n_lines, real.shape[1]), np.nan)
    whitened[rows] = np.sqrt((real**2 + imaginary**2) / 2)
    return Responses(
        frequency=whole.frequency,
        used=mask,
        channels=_channels(fit),
        measured=whole.values.reshape(n_lines, -1),
        fitted=fitted.reshape(n_lines, -1),
        initial=initial.reshape(n_lines, -1),
        coherence=None if whole.coherence is None else whole.coherence.reshape(n_lines, -1),
        kind=whole.kind,
        whitened=whitened,
    )


def _channels(fit: RecordFit) -> tuple[Channel, ...]:
    record, errors = fit.evaluation, fit.relative_error
    before = np.median(fit.initial_relative_error, axis=0)
    median, high = np.median(errors, axis=0), np.quantile(errors, 0.9, axis=0)
    found = []
    for o, sensor in enumerate(record.outputs):
        for i, load in enumerate(record.inputs):
            unit = channel_unit(record.kind, sensor, load)
            numbers = (float(median[o, i]), float(before[o, i]), float(high[o, i]))
            found.append(Channel(f"{sensor}/{load}", unit, str(sensor), str(load), *numbers))
    return tuple(found)


def magnitude(values: np.ndarray) -> FloatArray:
    """abs of `values`, NaN where it is 0 and a logarithmic axis has no place for it."""
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def magnitude_limits(data: Responses, channel: int) -> tuple[float, float]:
    """Limits of a logarithmic axis that holds every curve of a channel and is at least a decade long."""
    curves = (data.measured, data.fitted, data.initial)
    sizes = np.concatenate([magnitude(curve[:, channel]) for curve in curves])
    sizes = sizes[np.isfinite(sizes)]
    if not sizes.size:
        return 0.1, 10.0
    low, high = float(np.log10(sizes.min())), float(np.log10(sizes.max()))
    half = max(0.54 * (high - low), 0.6)
    middle = 0.5 * (low + high)
    return float(10.0 ** (middle - half)), float(10.0 ** (middle + half))


def frequency_limits(data: Responses) -> tuple[float, float]:
    """Limits of the frequency axis."""
    low, high = float(data.frequency[0]), float(data.frequency[-1])
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def phase_degrees(values: np.ndarray) -> FloatArray:
    """Phase from -180 to 180 degrees."""
    return np.degrees(np.angle(values))


def worst_channels(data: Responses, count: int) -> list[int]:
    """Indices of the `count` channels with the largest median relative error, in the order of the record."""
    errors = np.array([channel.median_error for channel in data.channels])
    return sorted(np.argsort(-errors, kind="stable")[:count].tolist())


def line_edges(frequency: FloatArray) -> FloatArray:
    """Edges of cells centred on lines, (n_lines + 1,), for maps over frequency."""
    if len(frequency) == 1:
        return np.array([frequency[0] - 0.5, frequency[0] + 0.5])
    middle = 0.5 * (frequency[1:] + frequency[:-1])
    return np.concatenate([[2 * frequency[0] - middle[0]], middle, [2 * frequency[-1] - middle[-1]]])


def correlation(identification: Identification) -> FloatArray:
    """Correlation matrix of the parameters; NaN where a standard deviation is not determined."""
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.array(identification.estimate.correlation)
    return np.where(np.isfinite(found), np.clip(found, -1.0, 1.0), np.nan)


@dataclass(frozen=True, eq=False)
class ModeRows:
    """Modes of the initial and of the identified model, by number.

    Attributes
    ----------
    initial_frequency, frequency, initial_damping, damping : (n_modes,) float arrays
    mac : (n_modes,) float array
        Modal assurance criterion between the initial and the identified shape of the same number.
    """

    initial_frequency: FloatArray
    frequency: FloatArray
    initial_damping: FloatArray
    damping: FloatArray
    mac: FloatArray


def band_used(identification: Identification, data: Responses | None) -> tuple[float, float]:
    """Lowest and highest line used, or measured mode, Hz."""
    ends = [] if data is None else [*data.band]
    for fit in identification.modal_fits:
        ends += fit.problem.data.frequency.tolist()
    return min(ends), max(ends)


def mode_rows(found: Identification | RecordFit) -> ModeRows:
    """Modes before and after, as many as both models have."""
    before, after = found.modes_initial, found.modes
    n = min(len(before.frequency), len(after.frequency))
    x, y = before.mode_shapes[:, :n], after.mode_shapes[:, :n]
    size = (x**2).sum(axis=0) * (y**2).sum(axis=0)
    mac = np.divide((x * y).sum(axis=0) ** 2, size, out=np.full(n, np.nan), where=size > 0)
    return ModeRows(before.frequency[:n], after.frequency[:n], before.damping_ratio[:n], after.damping_ratio[:n], mac)


@dataclass(frozen=True, eq=False)
class History:
    """Parameters over their initial values along the last stage, and which of them deserve a colour of their own."""

    names: tuple[str, ...]
    ratio: FloatArray
    highlighted: tuple[int, ...]
    log: bool

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the axis, at most a factor of 1000 to either side of 1 where it is logarithmic."""
        values = self.ratio[np.isfinite(self.ratio)]
        low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 1.0)
        if self.log:
            return max(low, 1e-3) / 1.3, min(high, 1e3) * 1.3
        margin = max(0.06 * (high - low), 0.01)
        return low - margin, high + margin


def history(identification: Identification, n_highlighted: int = 7) -> History:
    """Convergence of the parameters; those that changed most are highlighted."""
    found = identification.estimate
    scale = np.where(found.initial != 0, found.initial, np.nan)
    ratio = found.history / scale
    positive = np.where(ratio > 0, ratio, np.nan)
    change = np.nan_to_num(np.abs(np.log(positive[-1])))
    chosen = np.argsort(-change, kind="stable")[:n_highlighted].tolist()
    shown = ratio[np.isfinite(ratio)]
    log = bool(shown.size and (shown > 0).all() and shown.max() / shown.min() > 8)
    return History(found.names, ratio, tuple(chosen), log)


def bar_floor(data: Responses) -> float:
    """Foot of the bars of relative errors on their logarithmic axis: the decade below the smallest, in per cent."""
    errors = [100 * e for c in data.channels for e in (c.median_error, c.median_error_initial) if e > 0]
    return float(10.0 ** np.floor(np.log10(max(min(errors, default=1.0), 1e-13))))


def residual_range(data: Responses) -> tuple[float, float]:
    """Ends of the colour scale of whitened residuals: at least from 0.1 to 10, farther where the fit is worse."""
    values = data.whitened[np.isfinite(data.whitened)]
    top = float(np.quantile(values, 0.999)) if values.size else 1.0
    return 0.1, max(10.0, top)
