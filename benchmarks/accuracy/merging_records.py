"""Campaigns of ambient records, merged: close modes, high damping, unequal lengths, a dead sensor and another gain.

A frame of 20 points with six modes, two of them 1 % apart with shapes of their own, damping ratios of 2 to 5 %, white forces
on the modes, sampled at 40 Hz. Five set-ups of 150 to 900 s have three references and four or five points of their own, with
noise of 5 %. One sensor of the second set-up shows nothing but noise, and all channels of the third have 1.7 times the gain.
Modes count where one is found within 3 % and with the shape (MAC above 0.8). `--bound` prints what the records can decide
of the two close modes at best: the Cramer-Rao bound of each set-up, from the Fisher information of Gaussian spectra
(Whittle 1953) by frequencies, damping ratios, shapes and powers of both modes and the coherence of their forces.

    python benchmarks/accuracy/merging_records.py [--campaigns 10] [--seed 0] [--bound]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lfilter

import structid as sid
from structid.core.errors import NoModesError
from structid.modal.merging import merged_setups

RATE, N_POINTS, REFERENCES = 40.0, 20, (3, 10, 17)
FREQUENCY = np.array([1.6, 3.1, 3.131, 5.4, 7.9, 11.0])


def shapes() -> np.ndarray:
    """Mode shapes at all points, (20, 6): bending along, and torsion of two girders of ten points."""
    x, side = (np.arange(10) + 0.6) / 10.2, np.repeat([1.0, -1.0], 10)
    along = np.tile(np.sin(np.pi * np.outer(x, [1, 2, 1, 3, 2, 4])), (2, 1))
    return np.asarray(along * np.where([False, False, True, False, True, False], side[:, None], 1.0))


def setups(seed: int) -> tuple[list[sid.TimeRecord], np.ndarray]:
    """Accelerations of five set-ups, and the damping ratios."""
    rng = np.random.default_rng(seed)
    ratio, own = rng.uniform(0.02, 0.05, 6), [i for i in range(N_POINTS) if i not in REFERENCES]
    poles = np.exp(2 * np.pi * FREQUENCY / RATE * (-ratio + 1j * np.sqrt(1 - ratio**2)))
    records = []
    for number, seconds in enumerate((150.0, 300.0, 450.0, 600.0, 900.0)):
        points = [*REFERENCES, *own[number::5]]
        n = round(seconds * RATE)
        force = rng.standard_normal((6, n + 2000))
        motion = [lfilter([1], [1, -2 * p.real, abs(p) ** 2], f)[2000:] for p, f in zip(poles, force, strict=True)]
        values = (np.array(motion).T / np.std(motion, axis=1)) @ shapes()[points].T
        values = values + 0.05 * values.std(axis=0) * rng.standard_normal(values.shape)
        if number == 1:
            values[:, 4] = 0.05 * rng.standard_normal(n)
        records.append(
            sid.TimeRecord(
                RATE, values * (1.7 if number == 2 else 1.0), [f"{p}Z" for p in points], ("acceleration",) * len(points)
            )
        )
    return records, ratio


def spectra(values: np.ndarray, lines: np.ndarray, n_points: int, noise: np.ndarray) -> np.ndarray:
    """Spectral matrices (n_lines, n_points, n_points) of two modes: frequencies, damping ratios, coherence, shapes with power."""
    frequency, ratio, coherence = values[:2], values[2:4], values[4] + 1j * values[5]
    columns = values[6:].reshape(2, n_points).T
    answer = 1 / (frequency**2 - lines[:, None] ** 2 + 2j * ratio * frequency * lines[:, None])
    forces = np.array([[1.0, coherence], [np.conj(coherence), 1.0]])
    motion = columns * (answer * np.sqrt(2 * ratio * frequency**3 / np.pi))[:, None, :]  # variance 1 / 2 for shape 1
    return motion @ forces @ motion.conj().transpose(0, 2, 1) + np.diag(noise)


def bound(points: list[int], seconds: float, ratio: float) -> tuple[float, float, float]:
    """Least deviations of the spacing over the spacing, of a frequency and of a damping ratio, relative."""
    shape = shapes()[points][:, 1:3]
    noise = 0.05**2 * (shapes()[points] ** 2).sum(axis=1) / (RATE / 2)
    lines = np.linspace(1.8, 4.8, 1501)
    truth = np.concatenate([FREQUENCY[1:3], [ratio, ratio], [0.0, 0.0], shape.T.ravel()])
    inverse = np.linalg.inv(spectra(truth, lines, len(points), noise))
    slopes = []
    for k in range(len(truth)):
        step = 1e-5 * np.eye(len(truth))[k]
        change = [spectra(truth + sign * step, lines, len(points), noise) for sign in (1, -1)]
        slopes.append(inverse @ (change[0] - change[1]) / 2e-5)
    information = np.array([[np.einsum("lij,lji->", a, b).real for b in slopes] for a in slopes])
    covariance = np.linalg.inv(information * seconds * (lines[1] - lines[0]))
    spacing = FREQUENCY[2] - FREQUENCY[1]
    apart = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
    return np.sqrt(apart) / spacing, np.sqrt(covariance[0, 0]) / truth[0], np.sqrt(covariance[2, 2]) / ratio


def print_bounds() -> None:
    """Print a row for each set-up and damping ratio."""
    own = [i for i in range(N_POINTS) if i not in REFERENCES]
    print("seconds  damping  deviation of the spacing over it   of a frequency   of a damping ratio, at best")
    for number, seconds in enumerate((150.0, 300.0, 450.0, 600.0, 900.0)):
        for ratio in (0.02, 0.05):
            apart, frequency, damping = bound([*REFERENCES, *own[number::5]], seconds, ratio)
            print(
                f"{seconds:7.0f}  {100 * ratio:5.0f} %  {apart:33.2f}   {100 * frequency:12.2f} %   {100 * damping:10.0f} %"
            )


def main() -> None:
    """Print how many modes come out, and the size of errors over their standard deviations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bound", action="store_true")
    chosen = parser.parse_args()
    if chosen.bound:
        print_bounds()
        return
    z: dict[str, list[float]] = {"frequency": [], "damping": [], "shapes": []}
    counts, others, bad = np.zeros(6, dtype=int), 0, f"{[i for i in range(N_POINTS) if i not in REFERENCES][1::5][1]}Z+"
    for seed in range(chosen.seed, chosen.seed + chosen.campaigns):
        records, ratio = setups(seed)
        parts = []
        for record in records:
            try:
                parts.append(sid.identify_modes(record))
            except NoModesError:
                continue
        modes = merged_setups(parts).modes
        rows = [int(str(dof)[:-2]) for dof in modes.channels]
        good = np.array([str(dof) != bad for dof in modes.channels])
        used = set()
        for k, truth in enumerate(shapes()[rows].T):
            alike = sid.mac(truth[good], modes.mode_shapes[good])[0]
            near = np.where(np.abs(modes.frequency / FREQUENCY[k] - 1) < 0.03, alike, 0.0)
            i = int(near.argmax())
            if near[i] < 0.8:
                continue
            counts[k] += 1
            used.add(i)
            z["frequency"].append((modes.frequency[i] - FREQUENCY[k]) / modes.std[i])
            z["damping"].append((modes.damping_ratio[i] - ratio[k]) / modes.std[modes.n_modes + i])
            top = int(np.nanargmax(np.where(good, np.abs(modes.mode_shapes[:, i]), np.nan)))
            std = np.asarray(modes.shape_std)[:, i]
            away = (modes.mode_shapes[:, i] / modes.mode_shapes[top, i] - truth / truth[top]).real
            keep = good & np.isfinite(away) & (std > 1e-9) & (np.arange(len(rows)) != top)
            z["shapes"] += (away[keep] / std[keep]).tolist()
        others += modes.n_modes - len(used)
    print(f"{chosen.campaigns} campaigns: each mode found {counts.tolist()} times, {others} others")
    for name, part in z.items():
        rms, inside = np.sqrt(np.mean(np.square(part))), 100 * np.mean(np.abs(part) <= 1.96)
        print(f"{name:9s} z rms {rms:.2f}, median {np.median(np.abs(part)):.2f}, within {inside:.1f} % of {len(part)}")


if __name__ == "__main__":
    main()
