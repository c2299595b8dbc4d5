"""Coverage of 95 % intervals of modes merged from several set-ups, and of stiffnesses identified from them.

Eight masses in a row, damping ratio 1 %, independent white forces on all of them; three set-ups of four velocities each
measure one after another, with sensors 3 and 8 in all of them and forces of 1, 3 and 0.3. Repeat k has seed k; all
repeats count, those without all modes as misses.

    python benchmarks/accuracy/merged_setups.py [--repeats 200] [--seed 0] [--duration 1200]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg
from scipy.signal import lfilter

import structid as sid
from structid.forward import ModalProblem
from structid.modal.merging import merged_setups
from structid.modal.method import ModalOptions

N_MASSES, STIFFNESS, DAMPING_RATIO, RATE, NOISE = 8, 400.0, 0.01, 15.0, 0.03
SETUPS = (("3X", "8X", "1X", "2X"), ("3X", "8X", "4X", "5X"), ("3X", "8X", "6X", "7X"))
LEVELS = (1.0, 3.0, 0.3)
Z95 = 1.959964


def chain() -> tuple[np.ndarray, np.ndarray]:
    """Circular frequencies, rad/s, and mass-normalized shapes."""
    matrix = STIFFNESS * (2 * np.eye(N_MASSES) - np.eye(N_MASSES, k=1) - np.eye(N_MASSES, k=-1))
    matrix[-1, -1] = STIFFNESS
    values, shapes = np.linalg.eigh(matrix)
    return np.sqrt(values), shapes


def ambient(rng: np.random.Generator, duration: float) -> np.ndarray:
    """Velocities of all masses, exact at the samples and stationary, (n_times, n_masses)."""
    omega, shapes = chain()
    n_times, settling = round(duration * RATE), round(120 * RATE)
    modal = np.empty((n_times + settling, len(omega)))
    for r, w in enumerate(omega):
        a = np.array([[0.0, 1.0], [-(w**2), -2 * DAMPING_RATIO * w]])
        block = linalg.expm(np.block([[-a, np.diag([0.0, 1.0])], [np.zeros((2, 2)), a.T]]) / RATE)  # Van Loan (1978)
        step = block[2:, 2:].T
        kicks = rng.standard_normal((n_times + settling, 2)) @ np.linalg.cholesky(step @ block[:2, 2:]).T
        values, vectors = np.linalg.eig(step)
        kicks = kicks @ np.linalg.inv(vectors).T
        states = np.stack([lfilter([1.0], [1.0, -v], kicks[:, i]) for i, v in enumerate(values)], axis=1)
        modal[:, r] = (states @ vectors.T).real[:, 1]
    return (modal @ shapes.T)[settling:]


def records(seed: int, duration: float) -> list[sid.TimeRecord]:
    """The three set-ups."""
    made = []
    for number, (names, level) in enumerate(zip(SETUPS, LEVELS, strict=True)):
        rng = np.random.default_rng([seed, number])
        motion = ambient(rng, duration)[:, [int(name[0]) - 1 for name in names]]
        motion = motion + NOISE * motion.std(axis=0) * rng.standard_normal(motion.shape)
        made.append(sid.TimeRecord(RATE, level * motion, names, ("velocity",) * len(names)))
    return made


def structure() -> tuple[sid.Structure, sid.Parameters]:
    """The chain with unknown stiffnesses, 20 % off at the start, and known masses."""
    here, back = [f"{i}X" for i in range(1, N_MASSES + 1)], [f"{i}X" for i in range(N_MASSES)]
    elements = [
        sid.PointMass("m", list(range(1, N_MASSES + 1)), 1.0),
        sid.Spring("k", here, back, stiffness=1.2 * STIFFNESS),
    ]
    made = sid.Structure({i: float(i) for i in range(N_MASSES + 1)}, elements, fixed=["0X"], active=["X"])
    return made, sid.parameters(made, [sid.Unknown("stiffness", "k", each=True)])


def scores(found: sid.ModalRecord) -> dict[str, np.ndarray]:
    """Error over standard deviation of frequencies, damping ratios and shape entries; NaN where modes are missing."""
    omega, shapes = chain()
    if found.n_modes != N_MASSES or found.covariance is None or found.shape_std is None:
        return {name: np.full(N_MASSES, np.nan) for name in ("frequency", "damping", "shape")}
    std = np.sqrt(np.diag(found.covariance))
    truth = shapes[[dof.node - 1 for dof in found.channels]]
    largest = np.abs(found.mode_shapes).argmax(axis=0)
    truth = truth / truth[largest, np.arange(N_MASSES)]
    known = found.shape_std > 1e-9
    shape = (found.mode_shapes.real - truth)[known] / found.shape_std[known]
    return {
        "frequency": (found.frequency - omega / (2 * np.pi)) / std[:N_MASSES],
        "damping": (found.damping_ratio - DAMPING_RATIO) / std[N_MASSES:],
        "shape": shape,
    }


def stiffness_scores(found: sid.ModalRecord) -> np.ndarray:
    """Error over standard deviation of the stiffnesses identified from the merged modes."""
    made, unknown = structure()
    problem = ModalProblem(made, unknown, found)
    answer = sid.estimate(problem, plans=problem.schedules())
    return (answer.values - STIFFNESS) / answer.std


def main() -> None:
    """Print coverage and rms of the scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=1200.0)
    chosen = parser.parse_args()
    options = ModalOptions(orders=[2 * N_MASSES], block_rows=20)
    kept: dict[str, list[np.ndarray]] = {}
    disagreeing = 0
    for seed in range(chosen.seed, chosen.seed + chosen.repeats):
        setups = records(seed, chosen.duration)
        single = [sid.identify_modes(setup, "ssi_cov", options=options) for setup in setups]
        merged = merged_setups(single)
        disagreeing += any("disagree" in words for words in merged.modes.warnings)
        for name, value in scores(merged.modes).items():
            kept.setdefault(name, []).append(value)
        kept.setdefault("stiffness", []).append(stiffness_scores(merged.modes))
    print(
        f"{chosen.repeats} repeats from seed {chosen.seed}, {chosen.duration:g} s a set-up; aim 90 to 98 % (shapes: none set)"
    )
    for name, parts in kept.items():
        values = np.concatenate([np.ravel(part) for part in parts])
        inside = 100 * np.mean(np.abs(values) <= Z95)
        rms = np.sqrt(np.nanmean(values**2))
        missing = int(np.isnan(values).sum())
        print(f"  {name:10s} coverage {inside:5.1f} %   rms error / std {rms:.2f}   missing {missing}")
    print(f"set-ups said to disagree although they do not: {disagreeing} of {chosen.repeats} (aim: 1 %)")


if __name__ == "__main__":
    main()
