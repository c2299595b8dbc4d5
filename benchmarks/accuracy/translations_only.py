"""Free-free beams of 15 and of 9 elements, every mass and stiffness unknown, from accelerations of the translations alone.

64 samples 0.5 s apart, from rest under 0.1 cos t N at node 7 (node 5 of nine elements), noise of 2 % of the RMS of each channel,
starts off by 30 % (standard deviation of the logarithm). Values are those of Norris (1986), Table 3.1, the first nine of them for
nine elements; with `--truths` each seed has a truth of its own, between 1 and 8. The motion is the sum of modes, by SciPy, with
nothing of structid. Every seed is told that does not end at the bound within its deviations.

    python benchmarks/accuracy/translations_only.py [--elements 15 9] [--repeats 100] [--seed 0] [--truths] [--workers 1]
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg

import structid as sid
from structid.forward import Oscillation, TimeOptions, output_error_problem
from structid.forward.time.identify_time import identify_time

MASS = [8.4, 1.6, 2.3, 4.8, 6.3, 5.2, 7.1, 4.2, 6.3, 1.6, 1.1, 2.4, 3.5, 4.6, 7.3]
STIFFNESS = [3.3, 2.3, 1.2, 1.3, 3.3, 4.2, 1.8, 1.4, 4.1, 3.6, 5.2, 3.4, 6.6, 2.5, 5.3]
MASS_SHAPE = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
STIFFNESS_SHAPE = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
NOISE, STEP, SAMPLES, FORCE, OFF = 0.02, 0.5, 64, 0.1, 0.3
#: Probability of chi-square below which a fit misses the noise.
MISSED = 1e-4
OPTIONS = TimeOptions(force=Oscillation(1.0, sine=False), rest_time=0.0, quantities=("acceleration",))


class Fit(NamedTuple):
    """One fit: errors in bounds of their own, inside their interval or not, whether it explains the noise."""

    seed: int
    relative: np.ndarray
    bound: np.ndarray
    inside: np.ndarray
    status: str
    explains: bool

    @property
    def is_found(self) -> bool:
        """Whether no value is more than six deviations of the bound off; a minimum close beside the right one passes."""
        return bool(np.abs(self.relative / self.bound).max() < 6)


def accelerations(mass: np.ndarray, stiffness: np.ndarray, load: int) -> np.ndarray:
    """Of all translations under FORCE cos t at node `load` (from 0), from rest, by modes; (SAMPLES, n_nodes)."""
    n = 2 * len(mass) + 2
    matrices = np.zeros((2, n, n))
    for e, (m, k) in enumerate(zip(mass, stiffness, strict=True)):
        matrices[:, 2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += m * MASS_SHAPE, k * STIFFNESS_SHAPE
    squares, shapes = linalg.eigh(matrices[1], matrices[0])
    time = STEP * np.arange(1, SAMPLES + 1)
    rigid = squares < 1e-9 * squares[-1]
    w = np.sqrt(np.where(rigid, 0.5, squares))
    moving = (w**2 * np.cos(w * time[:, None]) - np.cos(time)[:, None]) / (w**2 - 1)
    modal = FORCE * np.where(rigid, np.cos(time)[:, None], moving)
    return modal * shapes[2 * load] @ shapes[::2].T


def case(n_elements: int, truths: bool, seed: int) -> Fit:
    """The fit of one seed."""
    rng = np.random.default_rng([seed, n_elements])
    truth = np.array(MASS[:n_elements] + STIFFNESS[:n_elements])
    if truths:
        truth = rng.uniform(1, 8, 2 * n_elements)
    mass, stiffness = np.split(truth, 2)
    load = 6 if n_elements == 15 else 4
    motion = accelerations(mass, stiffness, load)
    noise = NOISE * np.sqrt((motion**2).mean(axis=0))
    force = FORCE * np.cos(STEP * np.arange(1, SAMPLES + 1))[:, None]
    values = np.hstack([motion + noise * rng.standard_normal(motion.shape), force])
    nodes = {i + 1: float(i) for i in range(n_elements + 1)}
    pairs = [[i, i + 1] for i in range(1, n_elements + 1)]
    names = (*(sid.parse_dof(f"{i}Y") for i in nodes), sid.parse_dof(f"{load + 1}Y"))
    kinds = (*["acceleration"] * len(nodes), "force")
    record = sid.TimeRecord(1 / STEP, values, names, kinds, np.append(noise**2, 0.0), start=STEP)
    structure = sid.Structure(nodes, [sid.Beam("beam", pairs, mass, stiffness)])
    unknown = sid.parameters(
        structure, [sid.Unknown(name, "beam", each=True) for name in ("mass", "bending_stiffness")]
    )
    at_truth = output_error_problem(structure, unknown.started_at(truth), record, OPTIONS)
    slope = at_truth.linearize(at_truth.theta_start).jacobian
    bound = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    begin = unknown.started_at(truth * np.exp(OFF * rng.standard_normal(len(truth))))
    found = identify_time(structure, begin, record, OPTIONS)
    relative = found.values / truth - 1
    inside = np.abs(relative * truth) <= 1.959964 * found.std
    return Fit(seed, relative, bound, inside, found.status.value, found.goodness.chi_square_probability >= MISSED)


def told(n_elements: int, fits: list[Fit]) -> None:
    """Print what became of all seeds, and of those that failed one by one."""
    right = [fit for fit in fits if fit.is_found]
    flagged = [fit for fit in fits if not fit.is_found and not (fit.status == "converged" and fit.explains)]
    wrong = len(fits) - len(right) - len(flagged)
    ratio = float(np.sqrt(np.mean([(fit.relative / fit.bound) ** 2 for fit in right]))) if right else np.nan
    inside = 100 * np.mean([fit.inside for fit in right]) if right else np.nan
    print(
        f"{n_elements} elements: {len(fits)} seeds, {len(right)} at the bound (error over it {ratio:.3f}, coverage"
        f" {inside:.1f} %), {len(flagged)} elsewhere and flagged, {wrong} elsewhere and called converged within the noise",
        flush=True,
    )
    for fit in fits:
        if not fit.is_found:
            print(
                f"  seed {fit.seed}: {fit.status}, {'explains' if fit.explains else 'misses'} the noise,"
                f" farthest value {100 * np.abs(fit.relative).max():.0f} % off"
            )


def main() -> None:
    """Print a line for each number of elements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", nargs="*", type=int, default=[15, 9], choices=(15, 9))
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--truths", action="store_true", help="another truth for each seed")
    parser.add_argument("--workers", type=int, default=1)
    chosen = parser.parse_args()
    seeds = range(chosen.seed, chosen.seed + chosen.repeats)
    with ProcessPoolExecutor(chosen.workers) as pool:
        for n_elements in chosen.elements:
            told(n_elements, list(pool.map(partial(case, n_elements, chosen.truths), seeds)))


if __name__ == "__main__":
    main()
