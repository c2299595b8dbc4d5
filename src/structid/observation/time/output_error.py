"""Output error: the readings of a structure's sensors against a time record, whitened by the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from structid.arrays import FloatArray, IntArray, require_shape
from structid.errors import InputError
from structid.estimation.linearization import Linearization
from structid.observation.record_problem import DataRows, RecordFacts, RecordProblem
from structid.observation.time.model import TimeModel
from structid.observation.time.options import Oscillation
from structid.structure import Structure
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import NamedUnknowns

_MOST_FORCE_SAMPLES = 1000
_SEEN = 1e-10


@dataclass(frozen=True, eq=False)
class Incidental:
    """What is unknown besides the parameters, as the data have it for given parameters.

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
        object.__setattr__(self, "structure", self.model.structure)
        object.__setattr__(self, "parameters", self.model.unknown)
        n_times, n_loads = len(self.measured), len(self.model.loads)
        require_shape("measured", self.measured, (None, len(self.model.sensors)), "one column a sensor")
        require_shape("deviation", self.deviation, (len(self.model.sensors),), "one value a sensor")
        require_shape("force", self.force, (n_times, n_loads), "one row an instant, one column a load")
        require_shape("force_deviation", self.force_deviation, (n_loads,), "one value a load")
        if not (self.deviation > 0).all():
            raise InputError("`deviation` must be greater than 0 for every sensor; leave exact channels out of the fit")
        if not self.oscillates and n_times * len(self.noisy_loads) > _MOST_FORCE_SAMPLES:
            what, way = (
                ("samples of a support's motion", "take spectra")
                if self.model.bases
                else (
                    "force samples",
                    "give the force as an Oscillation",
                )
            )
            raise InputError(
                f"at most {_MOST_FORCE_SAMPLES} noisy {what} can be estimated with the parameters, got"
                f" {n_times * len(self.noisy_loads)}; {way}, shorten the record, or declare its"
                " variance 0 where its noise matters little"
            )

    def with_parts(self, parts: Sequence[NamedUnknowns]) -> OutputErrorProblem:
        return replace(self, model=replace(self.model, unknown=cast(Parameters, parts[0])))

    @property
    def frequency(self) -> FloatArray:
        """Multiples of one over the record's duration, up to half the sampling rate."""
        return np.fft.rfftfreq(self.n_times, self.model.step)[1:]

    @property
    def facts(self) -> RecordFacts:
        spacing = np.full(len(self.frequency), 1 / (self.n_times * self.model.step))
        measures_force = not self.model.bases
        return replace(
            super().facts, line_spacing=spacing, n_channels=len(self.deviation), measures_force=measures_force
        )

    @property
    def n_times(self) -> int:
        return len(self.measured)

    @cached_property
    def rows(self) -> DataRows:
        """Readings of each sensor at each sample, then samples of each noisy load."""
        n_times, n_sensors = self.measured.shape
        index, forces = np.arange(n_times), n_sensors + np.arange(len(self.noisy_loads))
        kind = "motion of" if self.model.bases else "force at"
        loads = (f"{kind} {self.model.loads[i]}" for i in self.noisy_loads)
        return DataRows(
            np.concatenate([np.repeat(index, n_sensors), np.repeat(index, len(forces))]),
            2 * np.concatenate([np.tile(np.arange(n_sensors), n_times), np.tile(forces, n_times)]),
            (*map(str, self.model.sensors), *loads),
        )

    def first(self, n_times: int) -> OutputErrorProblem:
        """The problem of the first samples only."""
        return replace(self, measured=self.measured[:n_times], force=self.force[:n_times])

    @property
    def oscillates(self) -> bool:
        return isinstance(self.model.force, Oscillation)

    @cached_property
    def noisy_loads(self) -> IntArray:
        return np.flatnonzero(self.force_deviation > 0)

    @cached_property
    def waveforms(self) -> FloatArray:
        """Force samples for unit amplitudes of an oscillation, (n_times, n_loads, n_force_values)."""
        times = self.model.times(self.n_times)[-self.n_times :]
        return self.model.oscillation(times)[:, : len(self.model.loads)]

    @cached_property
    def known_force(self) -> FloatArray:
        """The force as far as it is known: samples, or amplitudes by least squares from them."""
        if not self.oscillates:
            return self.force
        wide = self.waveforms.reshape(-1, self.waveforms.shape[2])
        return np.asarray(np.linalg.lstsq(wide, self.force.ravel(), rcond=None)[0])

    @cached_property
    def _free_amplitudes(self) -> IntArray:
        if not self.oscillates:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(np.resize(self.force_deviation > 0, len(self.known_force)))

    @property
    def has_incidental(self) -> bool:
        """Whether anything but the parameters is unknown."""
        return self.free_start or len(self.noisy_loads) > 0

    def incidental(self, values: FloatArray) -> Incidental:
        """What else is unknown, by least squares for physical parameters `values`."""
        if not self.has_incidental:
            return Incidental(self.known_force, None, np.zeros((self.n_data, 0)))
        columns = self._incidental_columns(values)
        scale = np.linalg.norm(columns, axis=0)
        basis, singular, rows = np.linalg.svd(columns / np.where(scale > 0, scale, 1.0), full_matrices=False)
        seen = singular > _SEEN * singular.max(initial=0.0)
        basis, rows = basis[:, seen], rows[seen] / singular[seen, None]
        at_rest = np.zeros(2 * len(self.model.free)) if self.free_start else None
        data = self._data(self.model.readings(values, self.known_force, at_rest, self.n_times), self.known_force)
        found = -(rows.T @ (basis.T @ data)) / np.where(scale > 0, scale, 1.0)
        force, n_initial = np.array(self.known_force), 0 if at_rest is None else len(at_rest)
        if self.oscillates:
            force[self._free_amplitudes] += found[n_initial:]
        else:
            force[:, self.noisy_loads] += found[n_initial:].reshape(self.n_times, -1)
        return Incidental(force, None if at_rest is None else found[:n_initial], basis)

    def residual(self, theta: FloatArray) -> FloatArray:
        values = self.physical(theta)
        at = self.incidental(values)
        data = self._data(self.model.readings(values, at.force, at.initial, self.n_times), at.force)
        return self._residual(theta, data)

    def linearize(self, theta: FloatArray) -> Linearization:
        values = self.physical(theta)
        at = self.incidental(values)
        predicted, change = self.model.derivatives(values, at.force, at.initial, self.n_times)
        rows = np.zeros((self.n_data, len(values)))
        rows[: self.measured.size] = (change / self.deviation[:, None]).reshape(-1, len(values))
        rows -= at.basis @ (at.basis.T @ rows)
        return self._linearized(theta, self._data(predicted, at.force), rows * self.slope(theta), at.basis.shape[1])

    def _data(self, predicted: FloatArray, force: FloatArray) -> FloatArray:
        """Whitened errors of readings, and of noisy force samples, (n_data,)."""
        readings = ((predicted - self.measured) / self.deviation).ravel()
        noisy = self.noisy_loads
        samples = self.waveforms @ force if self.oscillates else force
        return np.concatenate([readings, ((samples - self.force)[:, noisy] / self.force_deviation[noisy]).ravel()])

    def _incidental_columns(self, values: FloatArray) -> FloatArray:
        """Derivative of `_data` with respect to state at the start and free force values."""
        n_times, noisy = self.n_times, self.noisy_loads
        readings: list[FloatArray] = []
        forces: list[FloatArray] = []
        if self.free_start:
            readings.append(self.model.unit_starts(values, n_times))
            forces.append(np.zeros((n_times, len(noisy), readings[0].shape[2])))
        if self.oscillates and len(noisy):
            readings.append(self.model.unit_forces(values, n_times)[..., self._free_amplitudes])
            forces.append(self.waveforms[:, noisy][..., self._free_amplitudes])
        elif len(noisy):
            count = n_times * len(noisy)
            readings.append(self.model.unit_pulses(values, n_times)[..., noisy].reshape(*self.measured.shape, count))
            forces.append(np.eye(count).reshape(n_times, len(noisy), count))
        top = np.concatenate(readings, axis=2) / self.deviation[:, None]
        bottom = np.concatenate(forces, axis=2) / self.force_deviation[noisy][:, None]
        count = top.shape[2]
        return np.concatenate([top.reshape(self.measured.size, count), bottom.reshape(n_times * len(noisy), count)])
