"""Output error: the readings of a structure's sensors against a time record, whitened by the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from structid.core.arrays import FloatArray, IntArray, require_shape
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem import Base, Structure
from structid.forward.channel_errors import ChannelErrors
from structid.forward.record_problem import RecordFacts, RecordProblem, linearization_with_priors, residual_with_priors
from structid.forward.time.model import InputHold, TimeModel
from structid.forward.time.options import TimeOptions
from structid.inversion.linearization import Linearization
from structid.inversion.problem import DataRows
from structid.records import TimeRecord
from structid.records.record import LOADS, MOTION_DERIVATIVES
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import NamedUnknowns


@dataclass(frozen=True, eq=False)
class Histories:
    """Measured histories beside predicted ones.

    Parameters
    ----------
    drive : InputHold
        Course of the forces between their samples.
    measured : (n_times, n_sensors) float array
    deviation : (n_sensors,) float array
    force : (n_times, n_loads) float array
    force_deviation : (n_loads,) float array
        0 for forces that are known.
    """

    drive: InputHold
    measured: FloatArray
    deviation: FloatArray
    force: FloatArray
    force_deviation: FloatArray

    @property
    def n_times(self) -> int:
        return len(self.measured)

    @cached_property
    def noisy_loads(self) -> IntArray:
        """Whose samples are data, as the readings are."""
        return np.flatnonzero(self.force_deviation > 0)

    @cached_property
    def known_force(self) -> FloatArray:
        """The measured part of the force; see `InputHold.force_values`."""
        return self.drive.force_values(self.force)

    @cached_property
    def waveforms(self) -> FloatArray:
        """Waveforms of an oscillation; see `InputHold.waveforms`."""
        return self.drive.waveforms(self.n_times)

    def errors(self, predicted: FloatArray, force: FloatArray) -> FloatArray:
        """Whitened errors (n_data,) of readings, then of noisy force samples: predicted less measured.

        Parameters
        ----------
        predicted : (n_times, n_sensors) float array
        force : float array
            Samples (n_times, n_loads), or amplitudes of an oscillation.
        """
        samples = self.waveforms @ force if self.drive.oscillates else force
        off = (samples - self.force)[:, self.noisy_loads]
        return self.whitened((predicted - self.measured)[..., None], off[..., None])[:, 0]

    def whitened(self, readings: FloatArray, forces: FloatArray) -> FloatArray:
        """Data rows (n_data, n) of changes of readings, then of force samples of noisy loads, over their deviations.

        `readings` are (n_times, n_sensors, n), `forces` (n_times, n_noisy, n).
        """
        count, noisy = readings.shape[2], self.noisy_loads
        top, bottom = readings / self.deviation[:, None], forces / self.force_deviation[noisy][:, None]
        return np.concatenate([top.reshape(self.measured.size, count), bottom.reshape(forces[..., 0].size, count)])


_MOST_FORCE_SAMPLES = 1000
_SEEN = 1e-10


@dataclass(frozen=True, eq=False)
class Incidental:
    """Incidental unknowns by least squares at given parameters.

    Attributes
    ----------
    force : float array
        Samples (n_times, n_loads), or amplitudes of an oscillation.
    initial : (2 n_free,) float array or None
    basis : (n_data, rank) float array
        Orthonormal basis of what the incidental unknowns can explain of the whitened data.
    """

    force: FloatArray
    initial: FloatArray | None
    basis: FloatArray


@dataclass(frozen=True, eq=False)
class Incidentals:
    """Incidental unknowns besides the parameters, all of them linear: state at the start, noisy forces.

    Attributes
    ----------
    model : TimeModel
    histories : Histories
    free_start : bool
        Whether displacement and velocity at the start are unknown.
    """

    model: TimeModel
    histories: Histories
    free_start: bool

    def at(self, values: FloatArray) -> Incidental:
        """Initial state and noisy forces that fit best at the parameters `values` (n_params,), by linear least squares.

        The result has all forces, the initial state (None at rest) and an orthonormal basis (n_data, rank) of what
        these unknowns explain in the data. Combinations with singular values below 1e-10 of the largest stay 0.
        """
        of, known = self.histories, self.histories.known_force
        if not self.free_start and not len(of.noisy_loads):
            return Incidental(known, None, np.zeros((of.measured.size, 0)))
        columns = self.columns(values)
        scale = np.linalg.norm(columns, axis=0)
        basis, singular, rows = np.linalg.svd(columns / np.where(scale > 0, scale, 1.0), full_matrices=False)
        seen = singular > _SEEN * singular.max(initial=0.0)
        basis, rows = basis[:, seen], rows[seen] / singular[seen, None]
        at_rest = np.zeros(2 * len(self.model.free)) if self.free_start else None
        data = of.errors(self.model.readings(values, known, at_rest, of.n_times), known)
        solution = -(rows.T @ (basis.T @ data)) / np.where(scale > 0, scale, 1.0)
        force, n_initial = np.array(known), 0 if at_rest is None else len(at_rest)
        if of.drive.oscillates:
            force[self.free_amplitudes] += solution[n_initial:]
        else:
            force[:, of.noisy_loads] += solution[n_initial:].reshape(of.n_times, -1)
        return Incidental(force, None if at_rest is None else solution[:n_initial], basis)

    def columns(self, values: FloatArray) -> FloatArray:
        """Derivative (n_data, n_unknowns) of whitened data rows by the initial state, then by forces of noisy loads.

        Forces are amplitudes of an oscillation, or samples, time slowest. Without a free start the first are left out.
        `values` (n_params,) are the parameters.
        """
        of, model, noisy = self.histories, self.model, self.histories.noisy_loads
        readings: list[FloatArray] = []
        forces: list[FloatArray] = []
        if self.free_start:
            readings.append(model.unit_starts(values, of.n_times))
            forces.append(np.zeros((of.n_times, len(noisy), readings[0].shape[2])))
        if of.drive.oscillates and len(noisy):
            readings.append(model.unit_forces(values, of.n_times)[..., self.free_amplitudes])
            forces.append(of.waveforms[:, noisy][..., self.free_amplitudes])
        elif len(noisy):
            count = of.n_times * len(noisy)
            readings.append(model.unit_pulses(values, of.n_times)[..., noisy].reshape(*of.measured.shape, count))
            forces.append(np.eye(count).reshape(of.n_times, len(noisy), count))
        return of.whitened(np.concatenate(readings, axis=2), np.concatenate(forces, axis=2))

    @cached_property
    def free_amplitudes(self) -> IntArray:
        """Indices (n,) of the amplitudes of an oscillation that belong to noisy loads."""
        of = self.histories
        return np.flatnonzero(np.resize(of.force_deviation > 0, len(of.known_force)))


@dataclass(frozen=True)
class MeasuredChannels:
    """Sensors, loads and lines (Hz) of a record; see `channel_errors.ChannelsOfRecord`."""

    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    frequency: FloatArray


@dataclass(frozen=True, eq=False)
class OutputErrorProblem(RecordProblem):
    """Parameters of a structure from what its sensors read over time; maximum likelihood for Gaussian noise.

    The amplitudes of a noisy oscillation, the errors of noisy force samples and an unknown state at the start enter
    linearly. They are solved for inside (variable projection), so that only the parameters are searched for; the
    covariance of these carries them.

    Parameters
    ----------
    model : TimeModel
    measured : (n_times, n_sensors) float array
    deviation : (n_sensors,) float array
        Standard deviation of each sensor's noise, from sample to sample independent; greater than 0.
    force : (n_times, n_loads) float array
        Measured force samples, or accelerations of supports that drive.
    force_deviation : (n_loads,) float array
        0 for forces that are known.
    free_start : bool
        Whether displacement and velocity at the start are unknown; they are 0 otherwise.
    channels : ChannelErrors, optional
        Gains of sensors, as those of the calibration within its tolerance; no other errors.

    References
    ----------
    Golub and Pereyra (2003), Inverse Problems 19, R1-R26: variable projection, with Kaufman's Jacobian.
    """

    model: TimeModel
    measured: FloatArray
    deviation: FloatArray
    force: FloatArray
    force_deviation: FloatArray
    free_start: bool = False
    channels: ChannelErrors | None = None
    structure: Structure = field(init=False)
    parameters: Parameters = field(init=False)

    def __post_init__(self) -> None:
        """Raise `InputError` on wrong shapes, zero deviations of sensors, or more than 1000 noisy force samples.

        An oscillating force has no limit. `structure` and `parameters` are taken from the model.
        """
        object.__setattr__(self, "structure", self.model.structure)
        object.__setattr__(self, "parameters", self.model.unknown)
        n_times, n_loads = self.n_times, len(self.model.loads)
        require_shape("measured", self.measured, (None, len(self.model.sensors)), "one column a sensor")
        require_shape("deviation", self.deviation, (len(self.model.sensors),), "one value a sensor")
        require_shape("force", self.force, (n_times, n_loads), "one row an instant, one column a load")
        require_shape("force_deviation", self.force_deviation, (n_loads,), "one value a load")
        if not (self.deviation > 0).all():
            raise InputError("`deviation` must be greater than 0 for every sensor; leave exact channels out of the fit")
        n_samples = n_times * len(self.histories.noisy_loads)
        if not self.model.drive.oscillates and n_samples > _MOST_FORCE_SAMPLES:
            what, way = "force samples", "give the force as an Oscillation"
            if self.model.bases:
                what, way = "samples of a support's motion", "take spectra"
            raise InputError(
                f"at most {_MOST_FORCE_SAMPLES} noisy {what} can be estimated with the parameters, got {n_samples}; {way},"
                " shorten the record, or declare its variance 0 where its noise matters little (in a study: 0 for"
                " its channel in `noise` or `relative_noise`)"
            )

    @cached_property
    def histories(self) -> Histories:
        """Measured readings and forces with their noise."""
        return Histories(self.model.drive, self.measured, self.deviation, self.force, self.force_deviation)

    @cached_property
    def incidentals(self) -> Incidentals:
        """Linear unknowns in addition to the parameters: initial states and noisy forces."""
        return Incidentals(self.model, self.histories, self.free_start)

    def with_structure(self, structure: Structure, parameters: Parameters) -> None:
        """None: the model of histories is made of the structure, and decides where the fit begins."""

    def with_parts(self, parts: Sequence[NamedUnknowns]) -> OutputErrorProblem:
        channels = cast("ChannelErrors", parts[1]) if len(parts) > 1 else None
        return replace(self, model=replace(self.model, unknown=cast("Parameters", parts[0])), channels=channels)

    @property
    def measured_responses(self) -> MeasuredChannels:
        """Fitted sensors and loads, whose gains may be unknown."""
        return MeasuredChannels(self.model.sensors, self.model.loads, self.frequency)

    @property
    def frequency(self) -> FloatArray:
        """Multiples of one over the record's duration, up to half the sampling rate."""
        return np.fft.rfftfreq(self.n_times, self.model.drive.step)[1:]

    @property
    def facts(self) -> RecordFacts:
        """Facts of the record: line spacing 1 / duration in Hz, number of channels, whether forces are measured."""
        spacing = np.full(len(self.frequency), 1 / (self.n_times * self.model.drive.step))
        measures_force = not self.model.bases
        return replace(
            super().facts, line_spacing=spacing, n_channels=len(self.deviation), measures_force=measures_force
        )

    @property
    def n_times(self) -> int:
        return len(self.measured)

    @cached_property
    def rows(self) -> DataRows:
        """Labels of data rows: readings of each sensor at each sample, then samples of each noisy load.

        In both parts the sample varies slowest; names are those of sensors, then of noisy loads.
        """
        (n_times, n_sensors), noisy = self.measured.shape, self.histories.noisy_loads
        index, forces = np.arange(n_times), n_sensors + np.arange(len(noisy))
        kind = "motion of" if self.model.bases else "force at"
        loads = (f"{kind} {self.model.loads[i]}" for i in noisy)
        return DataRows(
            np.concatenate([np.repeat(index, n_sensors), np.repeat(index, len(forces))]),
            2 * np.concatenate([np.tile(np.arange(n_sensors), n_times), np.tile(forces, n_times)]),
            (*map(str, self.model.sensors), *loads),
        )

    def first(self, n_times: int) -> OutputErrorProblem:
        """The problem of the first samples only."""
        return replace(self, measured=self.measured[:n_times], force=self.force[:n_times])

    def residual(self, theta: FloatArray) -> FloatArray:
        """Whitened errors of readings, then of noisy forces, then prior rows, (n_rows,), at free variables `theta`."""
        if self.channels is not None:
            scaled, values = self._without_gains(theta)
            return residual_with_priors(self.unknowns, theta, scaled._errors(values))
        return residual_with_priors(self.unknowns, theta, self._errors(self.physical(theta)))

    def linearize(self, theta: FloatArray) -> Linearization:
        """Weighted residual at the free variables `theta` (n_params,) and its Jacobian by these, prior rows last.

        Data rows are errors of readings, then of noisy forces. Initial state and noisy forces are eliminated; they take
        degrees of freedom.
        """
        if self.channels is None:
            data, rows, n_eliminated = self._error_slopes(self.physical(theta), np.zeros((0, len(self.deviation))))
        else:
            scaled, values = self._without_gains(theta)
            relative = self.channels.of_outputs / self.physical(theta)[self.parameters.n_params :, None]
            data, rows, n_eliminated = scaled._error_slopes(values, relative)
        return linearization_with_priors(self.unknowns, theta, data, rows * self.slope(theta), n_eliminated)

    def _errors(self, values: FloatArray) -> FloatArray:
        """Whitened errors (n_data,) at the physical parameters `values` (n_params,) of the structure."""
        incidental = self.incidentals.at(values)
        predicted = self.model.readings(values, incidental.force, incidental.initial, self.n_times)
        return self.histories.errors(predicted, incidental.force)

    def _error_slopes(self, values: FloatArray, gain_slopes: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        """Whitened errors (n_data,), derivatives (n_data, n_params + n_gains), and number of eliminated unknowns.

        Initial state and noisy forces are eliminated from the derivatives. These are by the parameters `values`
        (n_params,) of the structure, then by gains, which change every reading by the parts `gain_slopes` (n_gains,
        n_sensors).
        """
        incidental = self.incidentals.at(values)
        predicted, change = self.model.derivatives(values, incidental.force, incidental.initial, self.n_times)
        change = np.concatenate([change, predicted[..., None] * gain_slopes.T], axis=2)
        rows = np.zeros((self.n_data, change.shape[2]))
        rows[: self.measured.size] = (change / self.deviation[:, None]).reshape(-1, change.shape[2])
        rows -= incidental.basis @ (incidental.basis.T @ rows)
        return self.histories.errors(predicted, incidental.force), rows, incidental.basis.shape[1]

    def _without_gains(self, theta: FloatArray) -> tuple[OutputErrorProblem, FloatArray]:
        """Problem without gains, and the parameters (n_params,) of the structure, at the free variables `theta`.

        Readings and deviations of the problem are divided by the gains at `theta`, which has them after the structure's
        variables.
        """
        assert self.channels is not None
        physical, n = self.physical(theta), self.parameters.n_params
        gain = np.exp(np.log(physical[n:]) @ self.channels.of_outputs)
        scaled = replace(self, measured=self.measured / gain, deviation=self.deviation / gain, channels=None)
        return scaled, physical[:n]


_NO_NOISE = (
    "the record has no noise level; declare `variance`, one value a channel (0 for a force that is known), as found from"
    " a stretch of the record without motion"
)


def time_model(structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions) -> TimeModel:
    """Time-domain model of the fitted channels of `record`, with the hold of its forces or support motions.

    Fitted are the channels whose quantity is in `options.quantities`.

    Raises
    ------
    InputError
        If there is nothing to fit or to drive the structure, if both forces and supports drive it, if a channel is not
        part of it, or if the rest ends before the first sample while the force is known by samples only.
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
    """Supports whose measured acceleration drives the structure, one for each load; empty if forces do.

    `loads` are the indices of the input channels. Raises `InputError` if such a channel is no support, or others are
    forces.
    """
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
    """Maximum-likelihood output-error problem of `record`, for the motions named in `options.quantities`.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    record : TimeRecord
        With the noise variance of every channel; a load with variance 0 is known.
    options : TimeOptions, optional

    Raises
    ------
    InputError
        If the record or the structure gives no time-domain model, or the noise of a fitted channel is not greater than
        0.
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
    """Indices of the channels of `record` whose quantity is among `quantities`."""
    return np.array([i for i, q in enumerate(record.quantities) if q in quantities], dtype=np.int64)
