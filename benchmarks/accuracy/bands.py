"""Modes of simulated bridges by default and in bands chosen by hand: is the default's deviation the best?

Six modes of 2 to 25 Hz with damping ratios of 0.5 to 2 %, eight accelerometers at 200 Hz for 300 s, 10 % noise and random
forces. Ratio: the standard deviation of a frequency by default over the least of three bands. z: the error of a frequency by
default over its standard deviation.

    python benchmarks/accuracy/bands.py [--bridges 50] [--seed 0]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lfilter

import structid as sid

RATE, SECONDS = 200.0, 300.0
BANDS = ((0.5, 45.0), (0.5, 30.0), (1.0, 15.0))


def bridge(seed: int) -> tuple[sid.TimeRecord, np.ndarray]:
    """Accelerations, and the true frequencies (Hz)."""
    rng = np.random.default_rng(seed)
    frequency = np.sort(2.0 + np.array([0, 3, 7, 11, 16, 22]) + rng.uniform(0, 1.5, 6))
    ratio, n = rng.uniform(0.005, 0.02, 6), round(RATE * SECONDS)
    poles = np.exp(2 * np.pi * frequency / RATE * (-ratio + 1j * np.sqrt(1 - ratio**2)))
    force = rng.standard_normal((6, n + 10_000))
    motion = [lfilter([1, -2, 1], [1, -2 * p.real, abs(p) ** 2], f)[10_000:] for p, f in zip(poles, force, strict=True)]
    shapes = np.sin(np.pi * np.outer((np.arange(8) + 0.7) / 8.5, np.arange(1, 7)))
    values = (np.array(motion).T / np.std(motion, axis=1) * rng.uniform(0.3, 1.0, 6)) @ shapes.T
    values = values + 0.1 * values.std(axis=0) * rng.standard_normal(values.shape)
    return sid.TimeRecord(RATE, values, [f"{i}Z" for i in range(1, 9)], ("acceleration",) * 8), frequency


def deviations(path: Path, frequency: np.ndarray, band: tuple[float, float] | None) -> tuple[np.ndarray, np.ndarray]:
    """Error and standard deviation of each frequency, Hz; infinite where no mode is within 2 %."""
    modes = sid.modes_of_file(path, sid.ModesOptions(band=band)).modes
    error, std = np.full((2, len(frequency)), np.inf)
    for k, f in enumerate(frequency):
        near = int(np.abs(modes.frequency - f).argmin())
        if abs(modes.frequency[near] / f - 1) < 0.02:
            error[k], std[k] = modes.frequency[near] - f, modes.frequency_std[near]
    return error, std


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bridges", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    ratios, z = [], []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.seed, chosen.seed + chosen.bridges):
            record, frequency = bridge(seed)
            path = Path(folder) / "bridge.npz"
            sid.write_record(path, record)
            error, default = deviations(path, frequency, None)
            z += (error / default)[np.isfinite(default)].tolist()
            best = np.min([deviations(path, frequency, band)[1] for band in BANDS], axis=0)
            ratios.append(np.where(np.isfinite(best), default / best, np.nan))
            print(f"bridge {seed}: {np.array2string(ratios[-1], precision=2)}", flush=True)
    print(
        f"greatest ratio {np.nanmax(ratios):.2f}, median {np.nanmedian(ratios):.2f}; missed by all: {np.isnan(ratios).sum()};"
        f" z rms {np.sqrt(np.mean(np.square(z))):.2f}, within 1.96 {100 * np.mean(np.abs(z) <= 1.96):.1f} % of {len(z)}"
    )


if __name__ == "__main__":
    main()
