"""The free-free beam of Norris (1986), chapter 3, by consistent estimators: errors, convergence and coverage.

Noise is 2 % of the RMS of each channel, added to every sample; the 30 masses and stiffnesses are unknown, each first
set to 4 whatever it is. Samples are 0.5 s apart, 1 ms where displacements are integrated or the weak form is used. The
force is 0.1 cos t N, its amplitude known to output error unless said, its samples noisy to the others. Every seed
counts, whatever became of it: 0, 1, 2, ... Converged are those whose chi-square has a probability above 1e-4, too.

The error is the root of the mean over seeds and parameters of the squared relative error; CRB is the Cramer-Rao bound of
the same mean.

    python benchmarks/accuracy/free_beam_time.py [--repeats 100] [--seed 0] [--parts output instrumental ...]
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.integrate import cumulative_trapezoid

import structid as sid
from structid.forward import Motion, Oscillation, TimeOptions, identify_motion, output_error_problem
from structid.forward.time.identify_time import identify_time
from structid.reproduce.chapter_3 import ACTUAL, beam, driven

LOAD = "7Y"
NOISE = 0.02
FINE = 1e-3
WAVEFORM = Oscillation(1.0, sine=False)


@dataclass(frozen=True)
class Fit:
    """One fit: relative errors, inside their 95 % interval or not, status (or missed noise), chi-square per dof."""

    relative: np.ndarray
    inside: np.ndarray
    status: str
    chi_square_per_dof: float


@cache
def structure() -> sid.Structure:
    return beam(ACTUAL)


@cache
def unknown() -> sid.Parameters:
    return sid.parameters(
        structure(), [sid.Unknown(name, "beam", each=True, start=4.0) for name in ("mass", "bending_stiffness")]
    )


@cache
def exact(n_samples: int, step: float, first: int) -> Motion:
    """Exact motion at step (first, first + 1, ...) s."""
    return driven(structure(), step * np.arange(first, first + n_samples))


def recorded(
    motion: Motion, step: float, rng: np.random.Generator, displacement: str, noisy_force: bool
) -> sid.TimeRecord:
    """Noisy accelerations, the force, and displacements that are ``exact``, ``integrated`` at 1 ms, or ``none``."""
    dofs, load = structure().dofs, structure().dofs.index(sid.parse_dof(LOAD))
    noise = NOISE * np.sqrt((motion.acceleration**2).mean(axis=0))
    force = motion.force[:, [load]]
    size = NOISE * float(np.sqrt((force**2).mean())) if noisy_force else 0.0
    acceleration = motion.acceleration + noise * rng.standard_normal(motion.acceleration.shape)
    columns, channels, kinds = [acceleration], [*dofs], ["acceleration"] * len(dofs)
    if displacement != "none":
        columns.append(motion.displacement)
        if displacement == "integrated":
            columns, noise = integrated(round(motion.time[-1] / FINE), rng, round(step / FINE))
        channels, kinds = [*channels, *dofs], kinds + ["displacement"] * len(dofs)
    columns.append(force + size * rng.standard_normal(force.shape))
    spare = len(kinds) - len(dofs)
    variance = np.concatenate([noise**2, np.zeros(spare), [size**2]])
    values = np.concatenate(columns, axis=1)
    names = (*channels, sid.parse_dof(LOAD))
    return sid.TimeRecord(1 / step, values, names, (*kinds, "force"), variance, start=float(motion.time[0]))


def integrated(n_steps: int, rng: np.random.Generator, every: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Noisy accelerations at 1 ms and displacements from their double integral, every so many samples; the noise."""
    fine = exact(n_steps + 1, FINE, 0)
    noise = NOISE * np.sqrt((fine.acceleration**2).mean(axis=0))
    noisy = fine.acceleration + noise * rng.standard_normal(fine.acceleration.shape)
    velocity = cumulative_trapezoid(noisy, dx=FINE, axis=0, initial=0.0)
    displacement = cumulative_trapezoid(velocity, dx=FINE, axis=0, initial=0.0)
    return [noisy[every::every], displacement[every::every]], noise


def options(method: str) -> TimeOptions:
    if method == "weak":
        return TimeOptions(method="weak")
    if method == "instrumental":
        return TimeOptions(method="instrumental", force=WAVEFORM, rest_time=0.0)
    return TimeOptions(force=WAVEFORM, rest_time=0.0, quantities=("acceleration",))


def case(part: str, n_samples: int, seed: int) -> Fit:
    """The fit of one seed."""
    rng = np.random.default_rng(seed)
    method = {"amplitude": "output", "integrated": "output", "cold": "output"}.get(part, part)
    if part == "weak":
        record = recorded(exact(500 * n_samples + 1, FINE, 0), FINE, rng, "none", noisy_force=True)
    else:
        kind = {"integrated": "integrated", "cold": "none"}.get(part, "exact")
        noisy_force = part in ("amplitude", "instrumental", "plain")
        record = recorded(exact(n_samples, 0.5, 1), 0.5, rng, kind, noisy_force)
    if part == "plain":
        found = identify_motion(structure(), unknown(), record)
    elif part == "cold":
        rng = np.random.default_rng([seed, 1])
        begin = unknown().started_at(ACTUAL * np.exp(0.3 * rng.standard_normal(len(ACTUAL))))
        found = identify_time(structure(), begin, record, options(method))
    else:
        found = identify_time(structure(), unknown(), record, options(method))
    relative = found.values / ACTUAL - 1
    inside = np.abs(relative * ACTUAL) <= 1.959964 * found.std
    status = "missed the noise" if found.goodness.chi_square_probability < 1e-4 else found.status.value
    return Fit(relative, inside, status, found.chi_square_per_dof)


@cache
def bound(n_samples: int, amplitude: bool) -> float:
    """Cramer-Rao bound of output error: root of the mean relative variance."""
    record = recorded(exact(n_samples, 0.5, 1), 0.5, np.random.default_rng(0), "none", noisy_force=amplitude)
    problem = output_error_problem(structure(), unknown().started_at(ACTUAL), record, options("output"))
    jacobian = problem.linearize(problem.theta_start).jacobian  # of logarithms
    return float(np.sqrt(np.trace(np.linalg.inv(jacobian.T @ jacobian)) / len(ACTUAL)))


PARTS = {
    "output": ("output error, accelerations only, known force", (4, 16, 64, 256), 1.0),
    "amplitude": ("output error, amplitude from noisy force samples", (4, 64), 1.0),
    "cold": ("output error, accelerations only, starts 30 % off", (4, 64), 0.3),
    "integrated": ("output error, displacements integrated (start only)", (4, 8), 1.0),
    "weak": ("weak form, 1 ms accelerations only, noisy force", (4, 8), 1.0),
    "instrumental": ("instrumental variables, noisy force", (4, 64, 1024), 1.0),
    "plain": ("plain least squares, for comparison", (4, 64, 1024), 1.0),
}
AIMS = {("integrated", 4): 1.3e-2, ("integrated", 8): 9e-3, ("weak", 4): 1.3e-2, ("weak", 8): 9e-3}
AIMS[("instrumental", 1024)] = 8e-4


def aim(part: str, n_samples: int) -> str:
    if part in ("output", "amplitude", "cold"):
        limit = bound(n_samples, part == "amplitude")
        return f"CRB {limit:.2e}, aim {1.1 * limit:.2e}"
    return f"aim {AIMS[part, n_samples]:.1e}" if (part, n_samples) in AIMS else "no aim"


def line(part: str, n_samples: int, fits: list[Fit]) -> str:
    relative = np.array([fit.relative for fit in fits])
    total = float(np.sqrt(np.mean(relative**2)))
    converged = 100 * np.mean([fit.status == "converged" for fit in fits])
    chi = np.mean([fit.chi_square_per_dof for fit in fits])
    inside = 100 * np.mean([fit.inside for fit in fits])
    return (
        f"  m = {n_samples:5d}  {len(fits):4d} seeds  error {total:.2e} ({aim(part, n_samples)})"
        f"  converged {converged:5.1f} %  chi-square/dof {chi:.3f}  coverage {inside:.1f} %"
    )


def main() -> None:
    """Print one block a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--samples", nargs="*", type=int, help="only these numbers of samples")
    chosen = parser.parse_args()
    print(
        "aims: error within 10 % of the CRB, converged at least 99 %, chi-square/dof 0.95 to 1.05, coverage 93 to 97 %"
    )
    with ProcessPoolExecutor(chosen.workers) as pool:
        for part in chosen.parts:
            title, sizes, share = PARTS[part]
            print(title, flush=True)
            for n_samples in sizes:
                if chosen.samples and n_samples not in chosen.samples:
                    continue
                repeats = max(1, round(share * chosen.repeats))
                seeds = range(chosen.seed, chosen.seed + repeats)
                print(line(part, n_samples, list(pool.map(partial(case, part, n_samples), seeds))), flush=True)


if __name__ == "__main__":
    main()
