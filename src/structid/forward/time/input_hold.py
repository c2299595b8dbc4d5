"""Forces, or motion of supports, between the samples of a record and before its start: zero-order or first-order hold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray
from structid.forward.time.options import Hold, Oscillation


@dataclass(frozen=True, eq=False)
class InputHold:
    """Input of a structure as the output of a linear system of its own.

    Parameters
    ----------
    force : {"first", "zero"} or Oscillation
    n_loads : int
        Of forces, or of supports whose accelerations take the place of forces.
    moves_supports : bool
        They are at rest at the start, and displacements and velocities count from there.
    step : float
        Time between samples, s.
    gap : float
        Time from the start to the first sample, s.
    start : float
        Time of the start, s.
    """

    force: Hold | Oscillation
    n_loads: int
    moves_supports: bool
    step: float
    gap: float
    start: float

    @cached_property
    def generator(self) -> FloatArray:
        """System matrix (n_states, n_states) of the differential equation whose state gives the inputs between samples, 1/s.

        The state is all forces, then their changes over a step (first-order hold) or their quadratures (oscillation). Under
        driven supports it is accelerations, their changes over a step, velocities over a step and displacements over its
        square.
        """
        eye = np.eye(self.n_loads)
        if self.moves_supports:
            rate = np.zeros((4, 4))
            rate[0, 1] = rate[2, 0] = rate[3, 2] = 1.0
            return np.kron(rate, eye) / self.step
        if isinstance(self.force, Oscillation):
            return self.force.omega * np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), eye)
        if self.force == "zero":
            return np.zeros((self.n_loads, self.n_loads))
        return np.kron(np.array([[0.0, 1.0], [0.0, 0.0]]), eye) / self.step

    @property
    def oscillates(self) -> bool:
        return isinstance(self.force, Oscillation)

    def times(self, n_times: int) -> FloatArray:
        """The start where it precedes the first sample, and the samples, s."""
        samples = self.start + self.gap + self.step * np.arange(n_times)
        return np.concatenate([[self.start], samples]) if self.gap > 0 else samples

    def oscillation(self, n_times: int) -> FloatArray:
        """State of `generator` at all `times` for unit force amplitudes, (n_steps + 1, n_states, n_force_values).

        Amplitudes are all cosines, then all sines if they are free. `n_times` is the number of samples.
        """
        assert isinstance(self.force, Oscillation)
        time, eye = self.times(n_times), np.eye(self.n_loads)
        c, s = np.cos(self.force.omega * time), np.sin(self.force.omega * time)
        cosine = np.kron(np.stack([c, -s], axis=1)[..., None], eye)
        if not self.force.sine:
            return cosine
        return np.concatenate([cosine, np.kron(np.stack([s, c], axis=1)[..., None], eye)], axis=2)

    def waveforms(self, n_times: int) -> FloatArray:
        """Force samples for unit amplitudes of an oscillation, (n_times, n_loads, n_force_values)."""
        return self.oscillation(n_times)[-n_times:, : self.n_loads]

    def known(self, samples: FloatArray) -> FloatArray:
        """Force samples (n_times, n_loads) as they are; for an oscillation, amplitudes (n_force_values,) fitted to them."""
        if not self.oscillates:
            return samples
        waveforms = self.waveforms(len(samples))
        wide = waveforms.reshape(-1, waveforms.shape[2])
        return np.asarray(np.linalg.lstsq(wide, samples.ravel(), rcond=None)[0])

    def inputs(self, force: FloatArray, n_times: int) -> FloatArray:
        """Input state at each of `times`, (n_steps + 1, n_inputs), in the order of `generator`.

        `force` holds samples (n_times, n_loads), or amplitudes (n_force_values,) of an oscillation.
        """
        if self.oscillates:
            return self.oscillation(n_times) @ force
        slope = np.diff(force, axis=0, append=force[-1:]) * (self.force == "first")
        if self.moves_supports:
            velocity = _summed(force + slope / 2)
            return np.concatenate([force, slope, velocity, _summed(velocity + force / 2 + slope / 6)], axis=1)
        return force if self.force == "zero" else np.concatenate([force, slope], axis=1)

    def pushes(self, mass: FloatArray, damping: FloatArray, stiffness: FloatArray) -> FloatArray:
        """Modal forces per unit of each input state, (..., n_inputs), where supports move.

        The arguments are the matrices times unit motions of the supports, (..., n_loads) each.
        """
        return -np.concatenate([mass, 0 * mass, damping * self.step, stiffness * self.step**2], axis=-1)


def _summed(rates: FloatArray) -> FloatArray:
    """Sum of the rates before each sample, (n_times, n)."""
    return np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum(rates[:-1], axis=0)])
