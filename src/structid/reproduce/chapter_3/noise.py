"""Chapter 3 with noise: repeats over many seeds under several readings of what was noisy, solved many at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import cumulative_trapezoid

from structid.arrays import FloatArray
from structid.observation.motion.equations import TimeEquations, time_equations
from structid.observation.motion.fit import least_squares_bias
from structid.observation.motion.motion import Motion
from structid.regression.streaming_qr import folded_triangle, stacked_triangles
from structid.reproduce.chapter_3.data import (
    ACTUAL,
    N_ELEMENTS,
    NOISE,
    STEP,
    beam,
    driven,
    sampling_times,
    unknown_values,
)

#: Time step of the integration of noisy accelerations, s.
FINE_STEP = 1e-3
_BATCH_ENTRIES = 4_000_000

#: Noisy acceleration, displacement (n_times, n_dofs) and force from exact ones.
Reading = Callable[[Motion, np.random.Generator], Motion]


def multiplied(exact: Motion, rng: np.random.Generator) -> Motion:
    """Reading A: every sample of acceleration and force times (1 + 2 % n); displacements exact."""
    a, f = _acceleration(exact), exact.force
    noisy = a * (1 + NOISE * rng.standard_normal(a.shape))
    return Motion(exact.time, f * (1 + NOISE * rng.standard_normal((len(f), 1))), noisy, None, exact.displacement)


def added(exact: Motion, rng: np.random.Generator) -> Motion:
    """Reading B: noise of 2 % of the RMS of each channel added to acceleration and force; displacements exact."""
    a, f = _acceleration(exact), exact.force
    noisy = a + NOISE * _rms(a) * rng.standard_normal(a.shape)
    return Motion(exact.time, f + NOISE * _rms(f) * rng.standard_normal((len(f), 1)), noisy, None, exact.displacement)


def integrated(exact: Motion, rng: np.random.Generator) -> Motion:
    """As the text has it: accelerations sampled at 1 ms with noise as in B, integrated twice, taken every 0.5 s."""
    fine = _fine_motion(round(exact.n_times * STEP / FINE_STEP))
    a = _acceleration(fine)
    noisy = a + NOISE * _rms(a) * rng.standard_normal(a.shape)
    velocity = cumulative_trapezoid(noisy, fine.time, axis=0, initial=0.0)
    displacement = cumulative_trapezoid(velocity, fine.time, axis=0, initial=0.0)
    every = slice(round(STEP / FINE_STEP), None, round(STEP / FINE_STEP))
    f = exact.force
    force = f + NOISE * _rms(f) * rng.standard_normal((len(f), 1))
    return Motion(exact.time, force, noisy[every], None, displacement[every])


READINGS: dict[str, Reading] = {"A": multiplied, "B": added, "integrated": integrated}


@dataclass(frozen=True, eq=False)
class Errors:
    """Relative errors of the 30 parameters in repeats, seeds 0 to n_seeds - 1.

    Attributes
    ----------
    relative : (n_seeds, 30) float array
    """

    relative: FloatArray

    @property
    def sum_of_two(self) -> FloatArray:
        """RMS of the masses' errors plus RMS of the stiffnesses', (n_seeds,); what the tables print."""
        return sum_of_two_rms(self.relative)

    @property
    def of_all(self) -> FloatArray:
        """RMS over all 30 parameters, (n_seeds,)."""
        return np.sqrt((self.relative**2).mean(axis=-1))

    @property
    def bias(self) -> float:
        """RMS over the parameters of the mean error over seeds, without what chance adds to it."""
        mean, variance = self.relative.mean(axis=0), self.relative.var(axis=0, ddof=1)
        return float(np.sqrt(max((mean**2 - variance / len(self.relative)).mean(), 0.0)))


def sum_of_two_rms(relative: FloatArray) -> FloatArray:
    """RMS over the first 15 relative errors plus RMS over the others, (...,)."""
    masses, stiffnesses = relative[..., :N_ELEMENTS], relative[..., N_ELEMENTS:]
    return np.sqrt((masses**2).mean(axis=-1)) + np.sqrt((stiffnesses**2).mean(axis=-1))


def repeats(reading: str, n_samples: int, n_seeds: int) -> Errors:
    """Least-squares estimates from `n_samples` noisy samples, once for each seed."""
    structure = beam(ACTUAL)
    equations = time_equations(structure, unknown_values(structure))
    exact = driven(structure, sampling_times(n_samples))
    batch = max(1, _BATCH_ENTRIES // (equations.operator.shape[0] * n_samples))
    found = []
    for first in range(0, n_seeds, batch):
        seeds = range(first, min(first + batch, n_seeds))
        noisy = [READINGS[reading](exact, np.random.default_rng(seed)) for seed in seeds]
        fields = np.stack([equations.fields(motion) for motion in noisy])
        found.append(batched_values(equations, fields))
    return Errors(np.concatenate(found) / ACTUAL - 1)


def batched_values(equations: TimeEquations, fields: FloatArray) -> FloatArray:
    """Least-squares parameters of many records at once: fields (n_records, 4 n_dofs, n_times) to (n_records, n_params).

    The equations must have one block a degree of freedom.
    """
    n_records, n_fields, n_times = fields.shape
    wide = np.moveaxis(fields, 0, 1).reshape(n_fields, -1)
    rows = equations.rows(wide).reshape(equations.n_dofs, n_records, n_times, equations.side)
    start = np.zeros((n_records, equations.n_dofs, equations.side, equations.side))
    triangles = stacked_triangles(start, np.moveaxis(rows, 1, 0))
    n_params = equations.unknown.n_params
    whole = folded_triangle(triangles, equations.columns, n_params)
    return np.linalg.solve(whole[:, :n_params, :n_params], whole[:, :n_params, n_params:])[..., 0]


def predicted_bias(reading: str, n_samples: int) -> float:
    """RMS over the parameters of the relative bias that the noise of the motion should give, to first order.

    For ``integrated`` the displacement's error after k fine steps of h has variance s^2 h^4 k^3 / 3.
    """
    structure = beam(ACTUAL)
    exact = driven(structure, sampling_times(n_samples))
    a = _acceleration(exact)
    size = NOISE * (np.abs(a) if reading == "A" else np.broadcast_to(_rms(a), a.shape))
    variance = {"acceleration": size**2}
    if reading == "integrated":
        size = NOISE * _rms(_acceleration(_fine_motion(round(n_samples * STEP / FINE_STEP))))
        steps = exact.time / FINE_STEP
        variance = {"acceleration": size**2, "displacement": FINE_STEP**4 * steps[:, None] ** 3 / 3 * size**2}
    bias = least_squares_bias(structure, unknown_values(structure), exact, variance, exact_motion=True)
    return float(np.sqrt(((bias / ACTUAL) ** 2).mean()))


def rigid_body_share(duration: float) -> tuple[float, float]:
    """Part of the mass-weighted mean square of displacement and acceleration that is rigid-body motion."""
    structure = beam(ACTUAL)
    mass = structure.matrix("inertia").toarray()
    motion = _fine_motion(round(duration / FINE_STEP))
    x = np.repeat(np.arange(N_ELEMENTS + 1.0), 2)
    turn = np.arange(2 * N_ELEMENTS + 2) % 2 == 1
    rigid = np.stack([np.where(turn, 0.0, 1.0), np.where(turn, 1.0, x)], axis=1)
    gram = rigid.T @ mass @ rigid
    shares = []
    for field in (motion.displacement, motion.acceleration):
        assert field is not None
        part = field @ mass @ rigid
        total = float(np.einsum("ti,ij,tj->", field, mass, field))
        shares.append(float(np.einsum("ti,ij,tj->", part, np.linalg.inv(gram), part)) / total)
    return shares[0], shares[1]


@cache
def _fine_motion(n_steps: int) -> Motion:
    """Exact motion every 1 ms from rest at 0 to n_steps ms."""
    return driven(beam(ACTUAL), FINE_STEP * np.arange(n_steps + 1))


def _acceleration(motion: Motion) -> FloatArray:
    assert motion.acceleration is not None
    return motion.acceleration


def _rms(values: FloatArray) -> FloatArray:
    return np.sqrt((values**2).mean(axis=0))
