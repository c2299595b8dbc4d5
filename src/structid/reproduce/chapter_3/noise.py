"""Chapter 3 with noise: repeats over many seeds under several readings of what was noisy, solved many at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import cumulative_trapezoid

from structid.core.arrays import FloatArray
from structid.forward.motion.equations import TimeEquations, time_equations
from structid.forward.motion.fit import least_squares_bias
from structid.forward.motion.motion import Motion
from structid.inversion.regression.streaming_qr import folded_triangle, stacked_triangles
from structid.reproduce.chapter_3.data import (
    ACTUAL,
    ESTIMATED,
    N_ELEMENTS,
    NOISE,
    RMS_ERROR,
    STEP,
    beam,
    driven,
    sampling_times,
    unknown_values,
)
from structid.reproduce.item import Curve, Panel, ReproducedItem, Table, Verdict, unprinted

#: Time step of the integration of noisy accelerations, s.
FINE_STEP = 1e-3
_BATCH_ENTRIES = 4_000_000
_PERCENT = (5, 50, 95)
#: Samples, and seeds as a part of all, of the study of what more samples do.
_EXACT_DISPLACEMENT = {4: 0.2, 8: 0.2, 16: 0.12, 64: 0.08, 256: 0.06, 1024: 0.06}
_INTEGRATED = {4: 0.2, 8: 0.2, 16: 0.06, 64: 0.03}

#: Noisy acceleration, displacement (n_times, n_dofs) and force from exact ones.
Reading = Callable[[Motion, np.random.Generator], Motion]


def multiplied(exact: Motion, rng: np.random.Generator) -> Motion:
    """Noisy motion in reading A: each sample of acceleration and force is multiplied by 1 + 0.02 n; displacements are exact.

    Velocities are left out (None). n is standard normal from `rng`; all degrees of freedom share one factor of the force at
    an instant.
    """
    a, f = _acceleration(exact), exact.force
    noisy = a * (1 + NOISE * rng.standard_normal(a.shape))
    return Motion(exact.time, f * (1 + NOISE * rng.standard_normal((len(f), 1))), noisy, None, exact.displacement)


def added(exact: Motion, rng: np.random.Generator) -> Motion:
    """Noisy motion in reading B: noise of 2 % of each channel's RMS on acceleration and force; displacements are exact."""
    a, f = _acceleration(exact), exact.force
    noisy = a + NOISE * _rms(a) * rng.standard_normal(a.shape)
    return Motion(exact.time, f + NOISE * _rms(f) * rng.standard_normal((len(f), 1)), noisy, None, exact.displacement)


def integrated(exact: Motion, rng: np.random.Generator) -> Motion:
    """Noisy motion as the text describes it: displacements are integrated twice from noisy accelerations.

    These are sampled every 1 ms with noise of 2 % of their RMS; the result is sampled every 0.5 s. The force has noise too.
    """
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
    """RMS over the first 15 relative errors (masses) plus RMS over the other 15 (stiffnesses), along the last axis."""
    masses, stiffnesses = relative[..., :N_ELEMENTS], relative[..., N_ELEMENTS:]
    return np.sqrt((masses**2).mean(axis=-1)) + np.sqrt((stiffnesses**2).mean(axis=-1))


def repeats(reading: str, n_samples: int, n_seeds: int) -> Errors:
    """Relative errors of least-squares estimates of the 30 parameters from `n_samples` noisy samples, one row for each seed.

    `reading` is "A", "B" or "integrated", a key of `READINGS`; seeds are 0 to n_seeds - 1.
    """
    structure = beam(ACTUAL)
    equations = time_equations(structure, unknown_values(structure))
    exact = driven(structure, sampling_times(n_samples))
    batch = max(1, _BATCH_ENTRIES // (equations.operator.shape[0] * n_samples))
    values = []
    for first in range(0, n_seeds, batch):
        seeds = range(first, min(first + batch, n_seeds))
        noisy = [READINGS[reading](exact, np.random.default_rng(seed)) for seed in seeds]
        fields = np.stack([equations.fields(motion) for motion in noisy])
        values.append(batched_values(equations, fields))
    return Errors(np.concatenate(values) / ACTUAL - 1)


def batched_values(equations: TimeEquations, fields: FloatArray) -> FloatArray:
    """Least-squares parameters (n_records, n_params) of many records at once.

    `fields` is (n_records, 4 n_dofs, n_times), see `TimeEquations.fields`; `equations` must have one block for each degree of
    freedom.
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
    """First-order prediction of the relative bias of the estimates due to noise in the motion, as RMS over the 30 parameters.

    `reading` is a key of `READINGS`, `n_samples` the number of samples, `STEP` (0.5 s) apart. For "integrated", the error
    of the displacement after k steps of h = `FINE_STEP` (1 ms) has the variance s^2 h^4 k^3 / 3, where s is the noise of
    the acceleration.
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


def rigid_body_fractions(duration: float) -> tuple[float, float]:
    """Fractions of the mass-weighted mean squares of displacement and acceleration (in this order) that are rigid-body motion.

    The means are over the first `duration` (s) of the exact motion.
    """
    structure = beam(ACTUAL)
    mass = structure.matrix("mass").toarray()
    motion = _fine_motion(round(duration / FINE_STEP))
    x = np.repeat(np.arange(N_ELEMENTS + 1.0), 2)
    is_rotation = np.arange(2 * N_ELEMENTS + 2) % 2 == 1
    rigid = np.stack([np.where(is_rotation, 0.0, 1.0), np.where(is_rotation, 1.0, x)], axis=1)
    gram = rigid.T @ mass @ rigid
    fractions = []
    for field in (motion.displacement, motion.acceleration):
        assert field is not None
        part = field @ mass @ rigid
        total = float(np.einsum("ti,ij,tj->", field, mass, field))
        fractions.append(float(np.einsum("ti,ij,tj->", part, np.linalg.inv(gram), part)) / total)
    return fractions[0], fractions[1]


@cache
def _fine_motion(n_steps: int) -> Motion:
    """Exact motion of the beam every 1 ms, from rest at 0 to `n_steps` ms."""
    return driven(beam(ACTUAL), FINE_STEP * np.arange(n_steps + 1))


def _acceleration(motion: Motion) -> FloatArray:
    assert motion.acceleration is not None
    return motion.acceleration


def _rms(values: FloatArray) -> FloatArray:
    return np.sqrt((values**2).mean(axis=0))


def noisy_table(name: str, n_samples: int, n_seeds: int) -> ReproducedItem:
    """Table 3.2 or 3.3 beside medians and 5-95 % bands of repeats under readings A and B of the noise.

    `name` is the table's, `n_samples` is 4 or 8, and `n_seeds` is the number of repeats.
    """
    printed, rms = ESTIMATED[n_samples], RMS_ERROR[n_samples]
    studies = {reading: repeats(reading, n_samples, n_seeds) for reading in ("A", "B")}
    values = ACTUAL * (1 + studies["A"].relative)
    low, median, high = np.percentile(values, _PERCENT, axis=0)
    inside = int(((printed >= low) & (printed <= high)).sum())
    relative = printed / ACTUAL - 1
    both, all_30 = float(sum_of_two_rms(relative)), float(np.sqrt((relative**2).mean()))
    plausible = all(
        np.percentile(study.sum_of_two, 5) <= rms <= np.percentile(study.sum_of_two, 95) for study in studies.values()
    )
    columns = ("mass m (kg/m)", "stiffness k (N/m)")
    bands = ("m, 5 %", "m, 95 %", "k, 5 %", "k, 95 %")
    band = np.column_stack([part.reshape(2, -1)[i] for i in (0, 1) for part in (low, high)])
    rows = tuple(f"element {i}" for i in range(1, N_ELEMENTS + 1))
    return ReproducedItem(
        name,
        f"Estimated parameters for m = {n_samples} sampling times",
        Verdict.READING if abs(both - rms) < 5e-4 and plausible else Verdict.REFUTED,
        f"The table is one draw of noise whose seed is not known. Beside it stand medians over {n_seeds} draws (seeds 0"
        f" to {n_seeds - 1}) under reading A, in which accelerations and force have 2 % noise and displacements are"
        f" exact; {inside} of its 30 numbers lie in the 5-95 % band. Reading A multiplies every sample by 1 + 2 % n,"
        " reading B adds 2 % of the RMS of each channel; the table does not distinguish them."
        f"\nThe printed RMS error {rms} is the sum of the RMS over the masses and the RMS over the stiffnesses,"
        f" {both:.4f}; the RMS over all 30 is {all_30:.4f}. That definition is an inference, from both tables."
        "\nThe text says that displacements are integrated from the noisy accelerations; see Claims on noise.",
        tables=(
            Table(rows, columns, printed.reshape(2, -1).T, median.reshape(2, -1).T),
            _rms_table(rms, both, all_30, studies),
            unprinted(rows, bands, band),
        ),
    )


def _rms_table(rms: float, both: float, all_30: float, studies: dict[str, Errors]) -> Table:
    """Table of the printed RMS error `rms` beside the RMS errors of the printed parameters and of the repeats in `studies`.

    For the printed parameters, `both` is the RMS over masses plus the RMS over stiffnesses, `all_30` the RMS over all
    parameters.
    """
    rows = ["of the printed table"]
    computed = [[both, all_30, np.nan, np.nan, np.nan]]
    for reading, study in studies.items():
        low, median, high = np.percentile(study.sum_of_two, _PERCENT)
        rank = 100 * float((study.sum_of_two < rms).mean())
        rows.append(f"reading {reading}, median over the seeds")
        computed.append([median, float(np.median(study.of_all)), low, high, rank])
    printed = np.full((len(rows), 5), np.nan)
    printed[0, 0] = rms
    headings = ("sum of two RMS", "RMS of all 30", "sum, 5 %", "sum, 95 %", "percentile of the printed")
    return Table(tuple(rows), headings, printed, np.array(computed))


def claims(n_seeds: int, report: Callable[[float], None]) -> ReproducedItem:
    """Claims of the text on noise: the effect of more samples, with exact and with integrated displacements.

    Parameters
    ----------
    n_seeds : int
        Number of seeds for the tables; the studies here take 3 to 20 % of them, at least 5.
    report : callable
        Called with the fraction done, 0 to 1.
    """
    work = [("B", m, part) for m, part in _EXACT_DISPLACEMENT.items()]
    work += [("integrated", m, part) for m, part in _INTEGRATED.items()]
    rows, results = [], []
    for done, (reading, n_samples, part) in enumerate(work):
        report(done / len(work))
        seeds = max(5, round(part * n_seeds))
        errors = repeats(reading, n_samples, seeds)
        rows.append(f"{'exact' if reading == 'B' else 'integrated'} displacements, m = {n_samples}")
        low, median, high = np.percentile(errors.of_all, _PERCENT)
        results.append([low, median, high, errors.bias, predicted_bias(reading, n_samples), seeds])
    computed = np.array(results)
    split = len(_EXACT_DISPLACEMENT)
    exact, honest = computed[:split], computed[split:]
    grows = bool((np.diff(honest[:, 1]) > 0).all())
    floor = bool(abs(exact[-1, 4] / exact[-1, 3] - 1) < 0.1 and exact[-1, 1] < 1.2 * exact[-1, 3])
    displacement, acceleration = rigid_body_fractions(4.0)
    headings = ("5 %", "median", "95 %", "bias", "predicted bias", "seeds")
    return ReproducedItem(
        "Claims on noise",
        "More samples reduce the effect of noise; displacements integrated from accelerations; rigid-body motion",
        Verdict.REFUTED if grows and floor else Verdict.AGREES,
        "The errors are RMS over all 30 parameters. With exact displacements the error falls with m only down to a"
        f" bias floor of {100 * exact[-1, 3]:.2f} %: least squares takes the noisy accelerations of its regressors as"
        f" exact, and -(B'B + N)^-1 N p predicts {100 * exact[-1, 4]:.2f} %. Beyond about 64 samples more of them do not"
        " help."
        "\nWith displacements really integrated twice from accelerations that carry 2 % noise every 1 ms, as the text"
        f" has it, the error grows with m: {honest[0, 1]:.2g} at m = 4, {honest[1, 1]:.2g} at m = 8 and"
        f" {honest[-1, 1]:.2g} at m = {list(_INTEGRATED)[-1]}, where nearly nothing is left of the stiffnesses. Tables"
        " 3.2 and 3.3 cannot come from such displacements."
        f"\nSeeds are 0 to the number in the last column less 1. Rigid-body motion holds {100 * displacement:.0f} % of"
        f" the mass-weighted mean square of the displacement over 0-4 s, and {100 * acceleration:.0f} % of that of the"
        " acceleration; 'not significantly excited' is so for the latter only.",
        tables=(unprinted(tuple(rows), headings, computed),),
        panels=(_error_panel(exact, honest),),
    )


def _error_panel(exact: FloatArray, integrated: FloatArray) -> Panel:
    """Panel of the RMS error against the number of samples, for exact and for integrated displacements.

    Each row of `exact` and `integrated`, (n_numbers, 5), is 5 %, median, 95 %, bias and predicted bias for one number
    of samples.
    """
    curves = []
    for label, samples, part in (
        ("exact displacements", _EXACT_DISPLACEMENT, exact),
        ("integrated displacements", _INTEGRATED, integrated),
    ):
        m = np.array(list(samples), dtype=np.float64)
        curves.append(Curve(f"{label}, median", m, part[:, 1], part[:, 0], part[:, 2]))
        curves.append(Curve(f"{label}, predicted bias", m, part[:, 4]))
    title, x_label = "Error of least squares against the number of samples", "samples m"
    return Panel(title, x_label, "RMS relative error of 30 parameters", tuple(curves), log_y=True)
