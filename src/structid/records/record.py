"""Records: frequency response functions and time histories in SI units, their noise, and repeats joined to one."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import AnyArray, ComplexArray, FloatArray, locked, require_finite, require_shape
from structid.core.display import Overview, Shown, data_array, format_number, join_words, plural
from structid.core.dof import Dof, parse_dofs, renamed
from structid.core.errors import InputError, NoLinesError, require_class
from structid.core.units import FrfKind, Quantity

if TYPE_CHECKING:
    import xarray as xr

#: Number of time derivatives between displacement and the response of an FRF kind.
DERIVATIVES: dict[str, int] = {"receptance": 0, "mobility": 1, "accelerance": 2, "transmissibility": 0}
#: Number of time derivatives between displacement and a motion.
MOTION_DERIVATIVES: dict[str, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
#: What has an entry for every value of an FRF.
_BESIDE_VALUES = ("variance", "coherence", "relative", "sizes")
#: Real values from which on, all positive, they are taken for magnitudes.
_SEVERAL = 8
#: Largest coherence that is let pass: what rounding adds to 1.
COHERENCE_MOST = 1 + 1e-9
_FRF_MADE_BY = "make it by `read_record`, `FrfRecord` or `frf_from_time`"
#: SI unit of an FRF with translations and forces only.
FRF_UNITS: dict[str, str] = {
    "receptance": "m/N",
    "mobility": "(m/s)/N",
    "accelerance": "(m/s^2)/N",
    "transmissibility": "1",
}
#: SI unit of a time history at a translation, and at a rotation.
QUANTITY_UNITS: dict[str, tuple[str, str]] = {
    "displacement": ("m", "rad"),
    "velocity": ("m/s", "rad/s"),
    "acceleration": ("m/s^2", "rad/s^2"),
    "force": ("N", "N m"),
    "support_acceleration": ("m/s^2", "rad/s^2"),
}
#: What acts on a structure; the other quantities are its motions.
LOADS: tuple[Quantity, ...] = ("force", "support_acceleration")
R = TypeVar("R", bound="FrfRecord | TimeRecord")
#: Largest difference of line spacings that rounding explains, as a part of their mean.
_EVEN = 0.02


def _require_distinct(name: str, dofs: tuple[Dof, ...]) -> None:
    """Raise `InputError` if a degree of freedom occurs twice in `dofs`; `name` is the argument that the message names."""
    seen: set[Dof] = set()
    for dof in dofs:
        if dof in seen:
            raise InputError(
                f"`{name}` names {dof} twice; average repeated channels or give each its own node before use"
            )
        seen.add(dof)


def _require_increasing(name: str, axis: FloatArray) -> None:
    """Raise `InputError` unless `axis` (n,) increases; `name` is the argument in the message."""
    steps = np.diff(axis)
    if (steps <= 0).any():
        i = int(np.argmax(steps <= 0))
        raise InputError(
            f"`{name}` must increase, got {axis[i]:.9g} followed by {axis[i + 1]:.9g} at index {i + 1};"
            " sort the lines and remove repeated ones"
        )


@dataclass(frozen=True, eq=False, repr=False)
class FrfRecord(Shown):
    """Frequency response functions between loads and sensors, in SI units.

    Parameters
    ----------
    frequency : (n_frequencies,) float array
        Frequency axis in Hz, increasing.
    values : (n_frequencies, n_outputs, n_inputs) complex array
        Response per unit force (or moment); SI units, the sense of each `Dof` included in the value.
    outputs, inputs : tuple of Dof
        Where each response was measured and each load acted.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
        Displacement, velocity or acceleration per unit force; or motion per the same motion of a support, see `Base`.
    variance : (n_frequencies, n_outputs, n_inputs) float array, optional
        E|error|^2 of each complex value; half of it belongs to the real and half to the imaginary part.
    coherence : same shape, optional
        Ordinary or multiple coherence, 0 to 1.
    averages : int, optional
        Number of independent averages behind each value.
    noise_source : str
        Where `variance` comes from: ``"coherence"``, ``"repeats"``, ``"declared"``, ``"scatter"`` of neighbouring lines or
        ``"unknown"``.
    source : str
        File or procedure that the record comes from.
    decay : (n_frequencies,) float array, optional
        Real part of the Laplace variable of each line, 1/s, at least 0: the values are taken at decay + i omega
        (see `structid.records.half_plane`). None on the imaginary axis, where FRFs are measured.
    segment : float, optional
        Duration, s, of the segments of random motion under a Hann window that were averaged: each line reads what leaks
        from its neighbours, see `structid.forward.frf.observed`. None where nothing leaks.
    relative : same shape as `values`, optional
        The part of the noise that goes with each value's size: its standard deviation as a part of that size. `variance`
        holds it with the sizes that were measured.
    sizes : same shape, optional
        Magnitudes without noise, as a model has them, of which `relative` is a part; those of `values` by default.

    Raises
    ------
    InputError
        If shapes disagree, the axis does not increase, a channel is doubled, or an entry is NaN or infinite.
    """

    frequency: FloatArray
    values: ComplexArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    kind: FrfKind
    variance: FloatArray | None = None
    coherence: FloatArray | None = None
    averages: int | None = None
    noise_source: str = "unknown"
    source: str = ""
    decay: FloatArray | None = None
    segment: float | None = None
    relative: FloatArray | None = None
    sizes: FloatArray | None = None

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(
            self,
            frequency: ArrayLike,
            values: ArrayLike,
            outputs: Iterable[str | Dof],
            inputs: Iterable[str | Dof],
            kind: FrfKind,
            variance: ArrayLike | None = None,
            coherence: ArrayLike | None = None,
            averages: int | None = None,
            noise_source: str = "unknown",
            source: str = "",
            decay: ArrayLike | None = None,
            segment: float | None = None,
            relative: ArrayLike | None = None,
            sizes: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Make arrays read-only and channels `Dof`, and raise `InputError` on what makes no FRF record.

        Frequencies must increase from 0 or more, values be finite, and complex unless real ones are negative somewhere
        (magnitudes are refused), channels be named once, `coherence` be from 0 to 1, variances, sizes and `decay` at
        least 0, and `segment` above 0.
        """
        object.__setattr__(self, "frequency", locked(self.frequency, np.float64))
        if _is_magnitude(np.asarray(self.values)):
            raise InputError(
                "`values` must be complex, got real numbers none of which is negative: magnitudes without their phase; give real"
                " and imaginary parts, with a complex type where all imaginary parts are 0"
            )
        object.__setattr__(self, "values", locked(self.values, np.complex128))
        object.__setattr__(self, "outputs", parse_dofs(self.outputs, "outputs"))
        object.__setattr__(self, "inputs", parse_dofs(self.inputs, "inputs"))
        if self.kind not in DERIVATIVES:
            raise InputError(f"`kind` must be one of {', '.join(DERIVATIVES)}, got {self.kind!r}")
        require_shape("frequency", self.frequency, (None,))
        if self.frequency.size == 0:
            raise InputError("`frequency` must hold at least one line, got none; the record is empty")
        require_finite("frequency", self.frequency)
        if self.frequency[0] < 0:
            raise InputError(f"`frequency` must not be negative, got {self.frequency[0]:g} Hz first")
        _require_increasing("frequency", self.frequency)
        _require_distinct("outputs", self.outputs)
        _require_distinct("inputs", self.inputs)
        shape = (self.frequency.size, len(self.outputs), len(self.inputs))
        require_shape("values", self.values, shape, "one value per frequency, output and input")
        require_finite("values", self.values, "remove these lines or channels, or repair the file")
        for name in _BESIDE_VALUES:
            if getattr(self, name) is None:
                continue
            array = locked(getattr(self, name), np.float64)
            object.__setattr__(self, name, array)
            require_shape(name, array, shape)
            require_finite(name, array)
            _require_within(self, name, array)
        if self.decay is not None:
            object.__setattr__(self, "decay", locked(self.decay, np.float64))
            require_shape("decay", self.decay, self.frequency.shape, "one value a line")
            require_finite("decay", self.decay)
            if (self.decay < 0).any():
                raise InputError(f"`decay` must be at least 0, got {self.decay.min():g} 1/s")
        if self.segment is not None and not 0 < self.segment < np.inf:
            raise InputError(f"`segment` must be a duration above 0 s, got {self.segment:g}")

    def overview(self) -> Overview:
        """Overview: kind, lines, channels and noise in words, and one row for each sensor, its rms under each load."""
        first, last = self.frequency[[0, -1]].tolist()
        words = (
            f"{self.kind}, {plural(len(self.frequency), 'line')} from {format_number(first)} to {format_number(last)} Hz,"
            f" {plural(len(self.outputs), 'sensor')}, {plural(len(self.inputs), 'load')} at {join_words(self.inputs)};"
            f" noise: {self.noise_source}"
        )
        rms = np.sqrt(np.mean(np.abs(self.values) ** 2, axis=0))
        rows = [
            (str(dof), *(format_number(size, 4) for size in row))
            for dof, row in zip(self.outputs, rms.tolist(), strict=True)
        ]
        return Overview(words, ("sensor", *(f"rms under {dof}" for dof in self.inputs)), rows)

    def to_xarray(self) -> xr.DataArray:
        """The values as an xarray array with axes frequency (Hz), output and input."""
        axes: dict[str, Iterable[object]] = {
            "frequency": self.frequency,
            "output": list(map(str, self.outputs)),
            "input": list(map(str, self.inputs)),
        }
        return data_array(self.values, axes, "frf", {"kind": self.kind, "units": FRF_UNITS[self.kind]})

    @property
    def omega(self) -> FloatArray:
        """Circular frequency in rad/s."""
        return 2 * np.pi * self.frequency

    @property
    def laplace(self) -> ComplexArray:
        """Laplace variable of each line, decay + i omega, in 1/s."""
        return (0.0 if self.decay is None else self.decay) + 1j * self.omega

    @property
    def is_per_motion(self) -> bool:
        """True if the values are per motion of a support that drives the structure, not per force."""
        return self.kind == "transmissibility"

    @property
    def unit(self) -> str:
        """SI unit of the values, for translations and forces."""
        return FRF_UNITS[self.kind]

    def band(self, low: float, high: float) -> FrfRecord:
        """The lines from `low` to `high` Hz, both included."""
        return self.lines(np.flatnonzero((self.frequency >= low) & (self.frequency <= high)))

    def lines(self, keep: np.ndarray) -> FrfRecord:
        """The record reduced to the frequency lines `keep`: line numbers, a slice or a mask (n_frequencies,).

        Raises
        ------
        NoLinesError
            If no line is left.
        """
        keep = np.asarray(keep)
        if not np.size(self.frequency[keep]):
            raise NoLinesError(
                f"no frequency line is left of {self.frequency[0]:g}-{self.frequency[-1]:g} Hz; widen the band"
            )
        decay = None if self.decay is None else self.decay[keep]
        return _select_lines(self, (keep,), self.frequency[keep], decay, self.outputs, self.inputs)

    def channels(self, outputs: tuple[Dof, ...]) -> FrfRecord:
        """The record reduced to `outputs`, in the order of the argument; all inputs stay.

        Raises
        ------
        InputError
            If the record lacks one of these outputs.
        """
        missing = [str(dof) for dof in outputs if dof not in self.outputs]
        if missing:
            raise InputError(
                f"the record has no output {', '.join(missing)}; it has {', '.join(map(str, self.outputs))}"
            )
        return self.grid([self.outputs.index(dof) for dof in outputs], range(len(self.inputs)))

    def grid(self, outputs: Sequence[int], inputs: Sequence[int]) -> FrfRecord:
        """The record reduced to the outputs and inputs with these indices, in this order."""
        index = np.ix_(range(self.frequency.size), outputs, inputs)
        named = tuple(self.outputs[i] for i in outputs), tuple(self.inputs[i] for i in inputs)
        return _select_lines(self, index, self.frequency, self.decay, *named)

    def as_kind(self, kind: FrfKind) -> FrfRecord:
        """The record converted between receptance, mobility and accelerance, by a power of the Laplace variable.

        Variance and sizes are scaled with the values. The record itself is returned if it is of this kind already.

        Raises
        ------
        InputError
            If `kind` is unknown, one of both is transmissibility, or a line at 0 Hz would be divided by zero.
        """
        if kind not in DERIVATIVES:
            raise InputError(f"`kind` must be one of {', '.join(DERIVATIVES)}, got {kind!r}")
        if "transmissibility" in (kind, self.kind) and kind != self.kind:
            raise InputError(f"{self.kind} cannot become {kind}: one is per force, the other per motion of a support")
        power = DERIVATIVES[kind] - DERIVATIVES[self.kind]
        if power == 0:
            return self
        if power < 0 and self.laplace[0] == 0:
            raise InputError(f"{self.kind} at 0 Hz cannot become {kind}; drop that line first with `band`")
        factor = self.laplace**power
        variance = None if self.variance is None else self.variance * (np.abs(factor) ** 2)[:, None, None]
        sizes = None if self.sizes is None else self.sizes * np.abs(factor)[:, None, None]
        return replace(self, kind=kind, values=self.values * factor[:, None, None], variance=variance, sizes=sizes)


def _is_magnitude(values: AnyArray) -> bool:
    """True if values look like magnitudes: real, none negative, and not all equal; False for a few values, which prove little."""
    if values.dtype.kind not in "fiu" or values.size < _SEVERAL:
        return False
    return bool((values >= 0).all() and (values != values.flat[0]).any())


def _require_within(record: FrfRecord, name: str, array: FloatArray) -> None:
    """Raise `InputError` for a coherence outside of 0 to 1, or another array with values below 0.

    `array` (n_frequencies, n_outputs, n_inputs) is the field `name` of the record; the message names the first wrong entry.
    """
    most, words = (COHERENCE_MOST, "from 0 to 1") if name == "coherence" else (np.inf, "at least 0")
    wrong = np.argwhere((array < 0) | (array > most))
    if len(wrong):
        line, output, load = wrong[0].tolist()
        raise InputError(
            f"`{name}` must be {words}, got {array[line, output, load]:.9g} of {record.outputs[output]}/{record.inputs[load]} at"
            f" {record.frequency[line]:g} Hz ({plural(len(wrong), 'such value')}); repair or remove these lines"
        )


def _select_lines(
    record: FrfRecord,
    index: tuple[np.ndarray, ...],
    frequency: FloatArray,
    decay: FloatArray | None,
    outputs: tuple[Dof, ...],
    inputs: tuple[Dof, ...],
) -> FrfRecord:
    """The record with values, variance, coherence, relative noise and sizes reduced by `index`, and these axes.

    `index` selects along (frequency, output, input); `frequency`, `decay`, `outputs` and `inputs` must match the result.
    """
    beside = (record.variance, record.coherence, record.relative, record.sizes)
    variance, coherence, relative, sizes = (None if array is None else array[index] for array in beside)
    return replace(
        record, frequency=frequency, values=record.values[index], outputs=outputs, inputs=inputs, variance=variance,
        coherence=coherence, decay=decay, relative=relative, sizes=sizes,
    )  # fmt: skip


#: By how much a coherence may lie below 1 that a file of six digits holds as 1.
_ROUNDED = 5e-6

#: Degrees of freedom from where on a variance from repeats is taken as known.
_FREEDOM = 20


def coherence_variance(values: ComplexArray, coherence: FloatArray, averages: int) -> FloatArray:
    """E|error|^2 of an FRF estimated from averages: |H|^2 (1 - g2) / (n g2).

    The normalized random error of magnitude is sqrt((1 - g2) / (2 n g2)), and the phase has the same in rad.

    Parameters
    ----------
    values : complex array
        FRF estimate.
    coherence : float array of the same shape
        Coherence g2. Values below 1e-6 count as 1e-6; values of 1 beside others below 1 count as rounded from slightly less.
    averages : int
        Number n of independent averages, at least 2.

    Raises
    ------
    InputError
        If `averages` is below 2.

    References
    ----------
    Bendat and Piersol (2010), Random Data, 4th ed., Eqs. (9.90) and (9.91).
    """
    if averages < 2:
        raise InputError(
            f"coherence tells noise from 2 averages on, got `averages` = {averages}: of one it is 1 whatever the noise; declare"
            " the noise instead"
        )
    is_rounded = (coherence >= 1) & (coherence < 1).any()
    bounded = np.maximum(np.where(is_rounded, 1 - _ROUNDED, coherence), 1e-6)
    return np.abs(values) ** 2 * (1 - bounded) / (averages * bounded)


def with_coherence_noise(record: FrfRecord, averages: int | None = None) -> FrfRecord:
    """`record` with the variance |H|^2 (1 - g2) / (n g2) by its coherence g2 and the number n of averages.

    `averages` replaces the number in the record; None takes that. Noise known before (`relative`, `sizes`) is dropped.

    Raises
    ------
    InputError
        If `record` is of another class, coherence or number of averages is missing, or the number is below 2.
    """
    require_class("record", record, FrfRecord, _FRF_MADE_BY)
    count = averages if averages is not None else record.averages
    if record.coherence is None or count is None:
        raise InputError(
            "noise from coherence needs `coherence` and `averages` in the record; declare the noise instead"
        )
    variance = coherence_variance(record.values, record.coherence, count)
    return replace(record, variance=variance, averages=count, noise_source="coherence", relative=None, sizes=None)


def with_declared_noise(record: FrfRecord, relative: float = 0.0, absolute: float = 0.0) -> FrfRecord:
    """`record` with the standard deviation sqrt((relative |H|)^2 + absolute^2) of each complex value.

    Parameters
    ----------
    record : FrfRecord
    relative : float
        Noise as a fraction of each value's magnitude, at most 1: 0.01 is 1 %.
    absolute : float
        Noise in the unit of the record.

    Raises
    ------
    InputError
        If `record` is of another class, a size is no number or negative, neither is greater than 0, or `relative` is above 1.
    """
    require_class("record", record, FrfRecord, _FRF_MADE_BY)
    for name, size in (("relative", relative), ("absolute", absolute)):
        if not isinstance(size, Real) or not np.isfinite(float(size)):
            raise InputError(f"`{name}` must be a finite number, got {size!r}; 0.01 is 1 %")
    if relative > 1:
        percent = f"{100 * relative:g} %"
        raise InputError(
            f"`relative` must be at most 1, which is 100 % of each value, got {relative:g}, which is {percent}; write"
            f" {relative / 100:g} for {relative:g} %, and state noise above 100 % as `absolute`, in the unit of the record"
        )
    if relative < 0 or absolute < 0 or relative + absolute == 0:
        raise InputError("declared noise needs `relative` or `absolute` greater than 0, and none negative")
    variance = (relative * np.abs(record.values)) ** 2 + absolute**2
    part = np.full(variance.shape, relative) if relative > 0 else None
    return replace(record, variance=variance, noise_source="declared", relative=part, sizes=None)


def from_repeats(records: list[FrfRecord]) -> FrfRecord:
    """The mean of repeated FRF measurements, with the variance of that mean from their scatter.

    With few repeats, the variance of a single line is uncertain: it is averaged over enough neighbouring lines for 20
    degrees of freedom, either relative to |H|^2 or in absolute terms, whichever varies less over the lines.

    Raises
    ------
    InputError
        If there are fewer than two records, or their axes, channels, kinds or windows differ.
    """
    if len(records) < 2:
        raise InputError(f"noise from repeats needs at least 2 records, got {len(records)}")
    first = records[0]
    sources = [record.source for record in records]
    require_shared("their kind", [(record.kind,) for record in records], sources)
    require_shared("outputs", [record.outputs for record in records], sources)
    require_shared("inputs", [record.inputs for record in records], sources)
    require_shared("frequencies, Hz", [record.frequency.tolist() for record in records], sources)
    require_shared("decays of windows, 1/s", [record.laplace.real.tolist() for record in records], sources)
    require_shared("durations of segments, s", [(record.segment,) for record in records], sources)
    values = np.array([record.values for record in records])
    mean, variance = values.mean(axis=0), values.var(axis=0, ddof=1) / len(records)
    pooled, relative = _pool_variance(variance, np.abs(mean) ** 2, 2 * (len(records) - 1))
    return replace(
        first, values=mean, variance=pooled, noise_source="repeats", coherence=None, relative=relative, sizes=None
    )


def _pool_variance(variance: FloatArray, square: FloatArray, freedom: int) -> tuple[FloatArray, FloatArray | None]:
    """Variances averaged over neighbouring lines, and relative standard deviations, (n_lines, n_outputs, n_inputs) each.

    `freedom` is the number of degrees of freedom of each variance, `square` the squared modulus of the values. Relative
    deviations are 0 for pairs whose variance was averaged without reference to the values, and None if nothing was averaged.
    """
    reach = -(-(_FREEDOM // freedom) // 2)
    if not reach or len(variance) <= 2 * reach:
        return variance, None
    pooled, relative = np.empty_like(variance), np.zeros_like(variance)
    for pair in np.ndindex(variance.shape[1:]):
        raw, size = variance[:, *pair], square[:, *pair]
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = [np.nanstd(np.log(part[part > 0])) for part in (raw, raw / size)]
        is_relative = bool((size > 0).all() and spread[1] < spread[0])
        scale = size if is_relative else np.ones(len(size))
        window = np.ones(2 * reach + 1)
        counts = np.convolve(np.ones(len(raw)), window, "same")
        beside = scale.copy()  # a value's own size would tie its weight to its own error
        beside[1:-1] = np.sqrt(scale[:-2] * scale[2:])
        mean = (np.convolve(raw / scale, window, "same") - raw / scale + raw / beside) / counts
        pooled[:, *pair] = mean * scale
        relative[:, *pair] = np.sqrt(mean) if is_relative else 0.0
    return pooled, relative


@dataclass(frozen=True, eq=False, repr=False)
class TimeRecord(Shown):
    """Time histories of motion and force, in SI units, sampled evenly.

    Parameters
    ----------
    sampling_rate : float
        Samples per second.
    values : (n_times, n_channels) float array
        SI units, the sense of each channel's `Dof` included in the value.
    channels : tuple of Dof
        Where each channel was measured or acted.
    quantities : tuple of {"displacement", "velocity", "acceleration", "force", "support_acceleration"}
        What each channel holds; the last is of supports that drive the structure, see `Base`.
    variance : (n_channels,) float array, optional
        Noise variance of each channel.
    start : float
        Time of the first sample in s.
    source : str
        File or procedure that the record comes from.
    """

    sampling_rate: float
    values: FloatArray
    channels: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]
    variance: FloatArray | None = None
    start: float = 0.0
    source: str = field(default="")

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(
            self,
            sampling_rate: float,
            values: ArrayLike,
            channels: Iterable[str | Dof],
            quantities: Iterable[Quantity],
            variance: ArrayLike | None = None,
            start: float = 0.0,
            source: str = "",
        ) -> None: ...

    def __post_init__(self) -> None:
        """Make arrays read-only and channels `Dof`, and raise `InputError` on what makes no time record.

        The rate must be positive, samples be finite, quantities be known, and each channel be named once for a
        quantity.
        """
        object.__setattr__(self, "values", locked(self.values, np.float64))
        object.__setattr__(self, "channels", parse_dofs(self.channels, "channels"))
        object.__setattr__(self, "quantities", tuple(self.quantities))
        if np.ndim(self.sampling_rate) != 0:
            raise InputError("`sampling_rate` must be one positive number, got an array; the samples come second")
        if not np.isfinite(self.sampling_rate) or self.sampling_rate <= 0:
            raise InputError(f"`sampling_rate` must be one positive number, got {self.sampling_rate!r} Hz")
        require_shape("values", self.values, (None, len(self.channels)), "one column a channel")
        if self.values.shape[0] == 0:
            raise InputError("`values` must hold at least one sample, got none; the record is empty")
        require_finite("values", self.values, "remove or repair these samples")
        if len(self.quantities) != len(self.channels):
            raise InputError(f"`quantities` must have {len(self.channels)} entries, got {len(self.quantities)}")
        for quantity in self.quantities:
            if quantity not in QUANTITY_UNITS:
                raise InputError(f"`quantities` must be among {', '.join(QUANTITY_UNITS)}, got {quantity!r}")
        for name in QUANTITY_UNITS:
            same = tuple(c for c, q in zip(self.channels, self.quantities, strict=True) if q == name)
            _require_distinct(f"{name} channels", same)
        if self.variance is not None:
            object.__setattr__(self, "variance", locked(self.variance, np.float64))
            require_shape("variance", np.asarray(self.variance), (len(self.channels),))

    def overview(self) -> Overview:
        """Overview: number of channels, length and rate in words, and one row with rms and unit for each channel."""
        n_times = len(self.values)
        words = (
            f"{plural(len(self.channels), 'channel')}, {n_times} samples at {format_number(self.sampling_rate)} Hz,"
            f" {format_number(n_times / self.sampling_rate)} s"
        )
        rms = np.sqrt(np.mean(self.values**2, axis=0)).tolist()
        cells = zip(self.channels, self.quantities, self.units, rms, strict=True)
        rows = [(str(dof), quantity, format_number(size, 4), unit) for dof, quantity, unit, size in cells]
        return Overview(words, ("channel", "quantity", "rms", "unit"), rows)

    def to_xarray(self) -> xr.DataArray:
        """The values as an xarray array with axes time (s) and channel."""
        names = [f"{dof} {quantity}" for dof, quantity in zip(self.channels, self.quantities, strict=True)]
        return data_array(self.values, {"time": self.time, "channel": names}, "history", {"units": self.units})

    @property
    def time(self) -> FloatArray:
        """Time axis in s."""
        return self.start + np.arange(self.values.shape[0]) / self.sampling_rate

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each channel."""
        pairs = zip(self.channels, self.quantities, strict=True)
        return tuple(QUANTITY_UNITS[quantity][channel.is_rotation] for channel, quantity in pairs)


Record = FrfRecord | TimeRecord


def as_recorded(wanted: Sequence[Dof], record: FrfRecord) -> tuple[Dof, ...]:
    """The record's outputs at the places and directions of `wanted`, in their order and with the record's sense.

    A degree of freedom that the record lacks stays as it is.
    """
    outputs = {dof.unsigned: dof for dof in record.outputs}
    return tuple(outputs.get(dof.unsigned, dof) for dof in wanted)


def require_shared(name: str, values: Sequence[Sequence[Hashable]], sources: Sequence[str]) -> None:
    """Raise `InputError` if a repeat differs from the first in `values`, also in their order.

    Parameters
    ----------
    name : str
        Description of the values, for the message.
    values : sequence of sequences
        Values of each repeat.
    sources : sequence of str
        Name of each repeat, for the message; "" if not known.

    Raises
    ------
    InputError
        If a repeat differs; the message says which values only one of both has.
    """
    for i, entries in enumerate(values):
        if list(entries) == list(values[0]):
            continue
        both = set(values[0]) & set(entries)
        more, other = ([entry for entry in side if entry not in both] for side in (values[0], entries))
        pair = [f"repeat {j + 1}" + (f" ({sources[j]})" if sources[j] else "") for j in (0, i)]
        if other and not more:
            pair, more, other = pair[::-1], other, more
        words = f"{_listed(more)}, where {pair[1]} has {_listed(other) or 'none'}" if more else "another order"
        raise InputError(
            f"repeated records must share {name}: {pair[0]} has {words}; leave out what differs, or give each as a record of"
            " its own"
        )


def _listed(items: Sequence[Hashable]) -> str:
    return join_words([f"{item:.12g}" if isinstance(item, float) else item for item in items])


def rename_channels(record: R, names: Mapping[str, str]) -> R:
    """The record with its channels renamed by `names`, from names in the record to true ones; values and order stay.

    A name stands for the sensors so called whatever their sign, or for loads where no sensor has it; ``load 3Z`` is the
    load in any case. A new name such as ``3Z-`` reverses the sign. Outputs and inputs of FRFs, and motions and loads of
    time histories, are renamed separately. An empty mapping returns `record` itself. `InputError` if there is no such
    channel, or two would have one name.
    """
    if not names:
        return record
    if isinstance(record, FrfRecord):
        outputs, inputs = renamed(record.outputs, record.inputs, names)
        return replace(record, outputs=outputs, inputs=inputs)
    is_load = [quantity in LOADS for quantity in record.quantities]
    pairs = list(zip(record.channels, is_load, strict=True))
    sensors, loads = renamed([dof for dof, load in pairs if not load], [dof for dof, load in pairs if load], names)
    left, right = iter(sensors), iter(loads)
    return replace(record, channels=tuple(next(right if load else left) for load in is_load))


def segment_duration(record: FrfRecord) -> float:
    """Duration in s of the averaged segments behind an FRF record: 1 over the spacing of its lines.

    Raises
    ------
    InputError
        If the lines are not evenly spaced, or there is only one.
    """
    gaps = np.diff(record.frequency)
    if not len(gaps) or np.ptp(gaps) > _EVEN * gaps.mean():
        raise InputError("the lines are not evenly spaced, so that they do not tell how long the segments were")
    return float(1 / gaps.mean())
