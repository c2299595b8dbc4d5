"""Readings of sensors and samples of forces as they were recorded, with the noise of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.forward.time.input_hold import InputHold


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
