"""Modes of stored correlation functions with their deviations: frequencies, damping ratios and shapes over repeats.

Three masses under white forces, modes at 16.3, 23.8 and 36.3 Hz with damping ratios of 1.4 to 2.5 %, displacements at 250 Hz
simulated with the exact covariance of the continuous state, 5 % noise. Functions of 320 lags come from records 60 times as
long; nothing else of the record is used.

    python benchmarks/accuracy/stored_correlations.py [--repeats 60] [--seed 0] [--lags 320] [--averages 60]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg

import structid as sid
from structid.records import CorrelationRecord

RATE, NAMES = 250.0, ["1X", "2X", "3X"]
MASS = np.diag([2.0, 1.0, 1.5])
STIFFNESS = np.array([[5e4, -2e4, 0], [-2e4, 4e4, -1.5e4], [0, -1.5e4, 3e4]])
DAMPING = 2e-4 * STIFFNESS + 0.8 * MASS
INVERSE = np.linalg.inv(MASS)
STATE = np.block([[np.zeros((3, 3)), np.eye(3)], [-INVERSE @ STIFFNESS, -INVERSE @ DAMPING]])


def truth() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (Hz), damping ratios, and shapes."""
    values, shapes = np.linalg.eig(STATE)
    up = np.flatnonzero(values.imag > 0)
    up = up[np.argsort(np.abs(values[up]))]
    return np.abs(values[up]) / (2 * np.pi), -values[up].real / np.abs(values[up]), shapes[:3, up]


def motion(n_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Displacements with noise, (n_samples, 3)."""
    force = np.vstack([np.zeros((3, 3)), INVERSE]) @ np.diag([3.0, 1.0, 2.0])
    covariance, step = linalg.solve_continuous_lyapunov(STATE, -force @ force.T), linalg.expm(STATE / RATE)
    small = 1e-16 * np.trace(covariance) * np.eye(6)
    shock = np.linalg.cholesky(covariance - step @ covariance @ step.T + small)
    state, shocks = np.linalg.cholesky(covariance + small) @ rng.standard_normal(6), rng.standard_normal((n_samples, 6))
    values = np.empty((n_samples, 3))
    for k, kick in enumerate(shocks @ shock.T):
        values[k], state = state[:3], step @ state + kick
    return values + 0.05 * values.std(axis=0) * rng.standard_normal(values.shape)


def main() -> None:
    """Print the size of errors over their standard deviations, and how many 95 % intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lags", type=int, default=320)
    parser.add_argument("--averages", type=int, default=60)
    chosen = parser.parse_args()
    errors: dict[str, list[float]] = {"frequency": [], "damping": [], "shapes": []}
    for seed in range(chosen.seed, chosen.seed + chosen.repeats):
        y = motion(chosen.averages * chosen.lags, np.random.default_rng(seed))
        functions = np.array([y[k:].T @ y[: len(y) - k] / (len(y) - k) for k in range(chosen.lags)])
        record = CorrelationRecord(RATE, functions, NAMES, NAMES, ("displacement",) * 3, chosen.averages)
        modes = sid.identify_modes(record)
        for frequency, ratio, shape in zip(*truth()[:2], truth()[2].T, strict=True):
            k = int(np.abs(modes.frequency - frequency).argmin())
            if abs(modes.frequency[k] / frequency - 1) > 0.03:
                print(f"seed {seed}: no mode at {frequency:.1f} Hz")
                continue
            top = int(np.abs(modes.mode_shapes[:, k]).argmax())
            away = (modes.mode_shapes[:, k] - shape / shape[top]).real
            errors["frequency"].append((modes.frequency[k] - frequency) / modes.std[k])
            errors["damping"].append((modes.damping_ratio[k] - ratio) / modes.std[modes.n_modes + k])
            errors["shapes"] += [away[i] / modes.shape_std[i, k] for i in range(3) if i != top]
    for name, z in errors.items():
        print(
            f"{name:9s} z rms {np.sqrt(np.mean(np.square(z))):.2f}, within {100 * np.mean(np.abs(z) <= 1.96):.1f} % of {len(z)}"
        )


if __name__ == "__main__":
    main()
