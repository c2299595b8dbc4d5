"""Finite Fourier transforms of one stretch of a time record: no window, no averages, and the noise of every line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, locked, require_finite, require_shape
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, NoLinesError
from structid.records.record import LOADS, MOTION_DERIVATIVES, TimeRecord

#: Replicas of the spectrum, to either side, that are summed.
_ALIASES = 50


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
