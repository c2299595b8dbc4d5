"""The verdict of virtual sensing on unseen structures: how often is a right model called wrong, and a wrong one right?

Chains of three to six masses with random springs are pushed at one or two masses by forces that nobody measured: of a correlation
time, of band-limited noise, or a sine. Accelerations at all masses but one are read, with 1 % noise. Right models are known within
1 %, and the truth is drawn within that. Wrong ones have a spring 30 % off, a mass 30 % off, two sensors in each other's place, or a
force where none is named. The truth runs at eight steps a sample through a filter against aliasing.

    python benchmarks/accuracy/sensing_verdict.py [--right 40] [--wrong 20] [--seed 0] [--samples 500]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import butter, sosfilt
from virtual_sensing import STEPS, moved_by, random_force, sampled

import structid as sid
from structid.prediction.identified_model import IdentifiedModel, identified_model
from structid.prediction.sensing.sense import sense
from structid.prediction.sensing.state_equations import UnknownForces

RATE, NOISE, UNCERTAINTY, LOSS = 100.0, 0.01, 0.01, 0.03
SPECTRA = ("correlation time", "band of noise", "sine")
FAULTS = ("spring 30 % off", "mass 30 % off", "two sensors exchanged", "force where none is named")


def chain(masses: np.ndarray, springs: np.ndarray) -> IdentifiedModel:
    """Masses 1 to n, kg, in a row; spring k, N/m, holds mass k to the one before, the first to the ground."""
    n = len(masses)
    parts = [sid.PointMass("m", list(range(1, n + 1)), mass=masses.tolist())]
    for k, stiffness in enumerate(springs, 1):
        ends = (f"{k}X",) if k == 1 else (f"{k}X", f"{k - 1}X")
        parts.append(sid.Spring(f"k{k}", *([end] for end in ends), stiffness=[float(stiffness)], loss_factor=LOSS))
    structure = sid.Structure({k: float(k) for k in range(1, n + 1)}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", f"k{k}") for k in range(1, n + 1)])
    return identified_model(
        structure, parameters, parameters.start, np.diag((UNCERTAINTY * parameters.start) ** 2), words="springs"
    )


def matrices(masses: np.ndarray, springs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness (n, n) of the chain."""
    between = np.eye(len(masses)) - np.eye(len(masses), k=-1)
    return np.diag(masses), between.T @ np.diag(springs) @ between


def force(spectrum: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Samples (n,) of a force of 10 N at eight times the sampling rate."""
    fine = RATE * STEPS
    if spectrum == "sine":
        return 14.0 * np.sin(2 * np.pi * rng.uniform(2.0, 30.0) * np.arange(n) / fine + rng.uniform(0, 6))
    if spectrum == "correlation time":
        return random_force(rng, n, fine, float(np.exp(rng.uniform(np.log(0.01), np.log(0.5)))), 10.0)
    low = rng.uniform(0.5, 8.0)
    noise = sosfilt(
        butter(4, (low, low * rng.uniform(2.0, 5.0)), "bandpass", fs=fine, output="sos"), rng.standard_normal(n)
    )
    return 10.0 * noise / noise.std()


def is_called_right(seed: int, spectrum: str, fault: str, n: int) -> bool:
    """Whether the model of one random structure is said to explain its record."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(3, 7))
    masses, springs = rng.uniform(0.5, 2.0, size), rng.uniform(3e3, 1.5e4, size)
    model = chain(masses, springs)
    true_masses, true_springs = masses.copy(), springs * (1 + UNCERTAINTY * rng.standard_normal(size))
    pushed = rng.permutation(size)[: 1 if size < 5 else 2]
    read = np.delete(np.arange(size), rng.integers(size))
    wrong = int(rng.integers(size))
    if fault.startswith("spring"):
        true_springs[wrong] *= 1.3
    elif fault.startswith("mass"):
        true_masses[wrong] *= 1.3
    acting = (
        np.append(pushed, next(k for k in rng.permutation(size) if k not in pushed))
        if fault.startswith("force")
        else pushed
    )
    forces = np.column_stack([force(spectrum, n * STEPS, rng) for _ in acting])
    _, accelerated = moved_by(*matrices(true_masses, true_springs), LOSS, acting.tolist(), forces, RATE * STEPS)
    clean = sampled(accelerated)[:, read]
    noise = NOISE * clean.std(axis=0)
    values = clean + noise * rng.standard_normal(clean.shape)
    names = [f"{k + 1}X" for k in read]
    if fault.startswith("two"):
        names[0], names[1] = names[1], names[0]
    record = sid.TimeRecord(RATE, values, names, ["acceleration"] * len(names), variance=noise**2)
    unknown = UnknownForces([f"{k + 1}X" for k in pushed])
    return sense(model, record, [f"{size}X"], "acceleration", unknown, seed=seed).is_explained


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--right", type=int, default=40)
    parser.add_argument("--wrong", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=500)
    chosen = parser.parse_args()
    for count, kinds, words in (
        (chosen.right, [""], "right models called wrong"),
        (chosen.wrong, FAULTS, "wrong models called wrong"),
    ):
        cases = [(chosen.seed + i, SPECTRA[i % len(SPECTRA)], kinds[i % len(kinds)]) for i in range(count)]
        called = [not is_called_right(*case, chosen.samples) for case in cases]
        print(f"{words}: {sum(called)} of {count}", flush=True)
        for case, is_called_wrong in zip(cases, called, strict=True):
            if is_called_wrong != (len(kinds) > 1):
                print(f"  seed {case[0]}, force: {case[1]}{f', {case[2]}' if case[2] else ''}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
