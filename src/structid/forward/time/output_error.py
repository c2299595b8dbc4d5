"""Output error: the readings of a structure's sensors against a time record, whitened by the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from structid.core.arrays import FloatArray, IntArray, require_shape
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward.prior_rows import linearization_with_priors, residual_with_priors
from structid.forward.record_problem import RecordFacts, RecordProblem
from structid.forward.time.input_hold import InputHold
from structid.forward.time.model import TimeModel
from structid.inversion.linearization import Linearization
from structid.inversion.problem import DataRows
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import NamedUnknowns


@dataclass(frozen=True, eq=False)
class Histories:
    """Measured histories beside predicted ones.

    Parameters
    ----------
    drive : InputHold
        What the forces are between their samples.
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
        """The force as far as it is known; see `InputHold.known`."""
        return self.drive.known(self.force)

    @cached_property
    def waveforms(self) -> FloatArray:
        """Waveforms of an oscillation; see `InputHold.waveforms`."""
        return self.drive.waveforms(self.n_times)

    def errors(self, predicted: FloatArray, force: FloatArray) -> FloatArray:
        """Whitened errors of readings, and of noisy force samples, (n_data,).

        Parameters
        ----------
        predicted : (n_times, n_sensors) float array
        force : float array
            As `TimeModel.readings` takes it.
        """
        samples = self.waveforms @ force if self.drive.oscillates else force
        off = (samples - self.force)[:, self.noisy_loads]
        return self.whitened((predicted - self.measured)[..., None], off[..., None])[:, 0]

    def whitened(self, readings: FloatArray, forces: FloatArray) -> FloatArray:
        """Changes of readings (n_times, n_sensors, n) and of samples of noisy loads (n_times, n_noisy, n) as data rows."""
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
        As `TimeModel.readings` takes it.
    initial : (2 n_free,) float array or None
    basis : (n_data, rank) float array
        Orthonormal; what the incidental unknowns can explain of the whitened data.
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
        """Initial state and noisy forces that fit best at physical parameters `values`, by linear least squares."""
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
        found = -(rows.T @ (basis.T @ data)) / np.where(scale > 0, scale, 1.0)
        force, n_initial = np.array(known), 0 if at_rest is None else len(at_rest)
        if of.drive.oscillates:
            force[self.free_amplitudes] += found[n_initial:]
        else:
            force[:, of.noisy_loads] += found[n_initial:].reshape(of.n_times, -1)
        return Incidental(force, None if at_rest is None else found[:n_initial], basis)

    def columns(self, values: FloatArray) -> FloatArray:
        """Derivative (n_data, n_free_values) of the data rows by initial state and noisy force values."""
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
        """Which amplitudes of an oscillation are of noisy loads."""
        of = self.histories
        return np.flatnonzero(np.resize(of.force_deviation > 0, len(of.known_force)))


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
    structure: Structure = field(init=False)
    parameters: Parameters = field(init=False)

    def __post_init__(self) -> None:
        """Raise `InputError` on wrong shapes, zero deviations or too many noisy force samples."""
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
                " shorten the record, or declare its variance 0 where its noise matters little"
            )

    @cached_property
    def histories(self) -> Histories:
        """Measured readings and forces with their noise."""
        return Histories(self.model.drive, self.measured, self.deviation, self.force, self.force_deviation)

    @cached_property
    def incidentals(self) -> Incidentals:
        """Unknowns besides the parameters."""
        return Incidentals(self.model, self.histories, self.free_start)

    def with_parts(self, parts: Sequence[NamedUnknowns]) -> OutputErrorProblem:
        return replace(self, model=replace(self.model, unknown=cast("Parameters", parts[0])))

    @property
    def frequency(self) -> FloatArray:
        """Multiples of one over the record's duration, up to half the sampling rate."""
        return np.fft.rfftfreq(self.n_times, self.model.drive.step)[1:]

    @property
    def facts(self) -> RecordFacts:
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
        """Labels of data rows: readings of each sensor at each sample, then samples of each noisy load."""
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
        """Weighted errors of readings and forces at the free variables `theta` (n_params,), with prior rows."""
        values = self.physical(theta)
        at = self.incidentals.at(values)
        predicted = self.model.readings(values, at.force, at.initial, self.n_times)
        return residual_with_priors(self.unknowns, theta, self.histories.errors(predicted, at.force))

    def linearize(self, theta: FloatArray) -> Linearization:
        """Weighted residual at the free variables `theta` (n_params,) with its Jacobian, prior rows included."""
        values = self.physical(theta)
        at = self.incidentals.at(values)
        predicted, change = self.model.derivatives(values, at.force, at.initial, self.n_times)
        rows = np.zeros((self.n_data, len(values)))
        rows[: self.measured.size] = (change / self.deviation[:, None]).reshape(-1, len(values))
        rows -= at.basis @ (at.basis.T @ rows)
        data = self.histories.errors(predicted, at.force)
        return linearization_with_priors(self.unknowns, theta, data, rows * self.slope(theta), at.basis.shape[1])
