"""Modes beside the tone of a machine: what `--remove-tones auto` leaves of the tone, and whether modes are then right.

Two modes at 12 and 25 Hz under white forces, accelerations at four sensors with 5 % noise, 80 Hz, 300 s. The machine
shakes the same structure at a frequency beside the second mode: steady, or wandering by 0.2 % of its frequency with a
period of 90 s, with three times the motion of the modes. Every oscillator is integrated exactly for a force that is linear
between samples four times as dense as the record, so that no part of the package makes the truth. One table row a case:
tones taken off in how many records, what is left of the tone (rms over that of the random motion), and of the mode beside
it, by default and after removal: how often it is found, median error of frequency and damping ratio in parts of the true
ones, and how many 95 % intervals hold the truth.

    python benchmarks/accuracy/tones_beside_modes.py [--records 20] [--seed 0] [--seconds 300]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg, signal

import structid as sid
from structid.records import Preparation, TimeRecord, prepare

RATE, DENSER, MODES, BESIDE = 80.0, 4, (12.0, 25.0), 25.0
SHAPES = np.array([[1.0, -0.3, -0.9, 0.6], [1.0, 0.8, 0.5, 0.3]])
#: Distance of the tone from the mode, damping ratio of the mode, and course of the tone.
CASES: tuple[tuple[float, float, str], ...] = (
    (0.01, 0.01, "steady"),
    (0.03, 0.01, "steady"),
    (0.01, 0.01, "wandering"),
    (0.03, 0.01, "wandering"),
    (0.0, 0.01, "steady"),
    (0.01, 0.01, "none"),
    (0.01, 0.002, "none"),
)


def acceleration(frequency: float, ratio: float, force: np.ndarray, rate: float) -> np.ndarray:
    """Of an oscillator of mass 1 under a force that is linear between samples, from rest."""
    omega = 2 * np.pi * frequency
    block = np.zeros((4, 4))
    block[:2, :2] = np.array([[0, 1], [-(omega**2), -2 * ratio * omega]]) / rate
    block[1, 2], block[2, 3] = 1 / rate, 1
    step = linalg.expm(block)
    pushes = np.outer(force[:-1], step[:2, 2] - step[:2, 3]) + np.outer(force[1:], step[:2, 3])
    poles, vectors = np.linalg.eig(step[:2, :2])
    sources = np.linalg.solve(vectors, pushes.T)
    states = np.stack([signal.lfilter([1], [1, -pole], source) for pole, source in zip(poles, sources, strict=True)])
    state = np.concatenate([np.zeros((2, 1)), (vectors @ states).real], axis=1)
    return np.asarray(force - 2 * ratio * omega * state[1] - omega**2 * state[0])


def course(kind: str, frequency: float) -> Callable[[np.ndarray], np.ndarray]:
    """Phase of a tone over time."""
    swing = 0.002 * frequency * 90 if kind == "wandering" else 0.0
    return lambda t: 2 * np.pi * frequency * t + swing * np.sin(2 * np.pi * t / 90)


def motions(
    rng: np.random.Generator, seconds: float, distance: float, ratio: float, kind: str
) -> tuple[np.ndarray, np.ndarray]:
    """Random motion with noise, and the motion by the machine, (n_samples, 4) each."""
    rate = RATE * DENSER
    lead = round(3 / (2 * np.pi * min(MODES) * ratio) * rate / DENSER) * DENSER
    n = lead + round(seconds * RATE) * DENSER
    drive = np.cos(course(kind, BESIDE * (1 + distance))((np.arange(n) - lead) / rate))
    random, tone = np.zeros((n, 4)), np.zeros((n, 4))
    for frequency, shape, part in zip(MODES, SHAPES, (0.5, 1.0), strict=True):
        random += np.outer(acceleration(frequency, ratio, rng.standard_normal(n), rate), shape)
        tone += np.outer(part * acceleration(frequency, ratio, drive, rate), shape)
    random, tone = random[lead::DENSER], tone[lead::DENSER]
    tone *= 0 if kind == "none" else 3 * random.std() / tone.std()
    return random + 0.05 * random.std() * rng.standard_normal(random.shape), tone


def judged(record: TimeRecord, ratio: float) -> list[float]:
    """Relative errors of frequency and damping ratio of the mode beside the tone, and whether their intervals hold it; or []."""
    modes = sid.identify_modes(record)
    likeness = np.abs(SHAPES[1] @ modes.mode_shapes) ** 2 / np.sum(np.abs(modes.mode_shapes) ** 2, axis=0)
    likeness /= SHAPES[1] @ SHAPES[1]
    near = np.flatnonzero((np.abs(modes.frequency / BESIDE - 1) < 2.5 * ratio) & (likeness > 0.8))
    if not len(near):
        return []
    k = int(near[np.nan_to_num(modes.frequency_std[near], nan=np.inf).argmin()])
    truth, value = np.array([BESIDE, ratio]), np.array([modes.frequency[k], modes.damping_ratio[k]])
    std = np.array([modes.std[k], modes.std[modes.n_modes + k]])
    return [*(value / truth - 1), *(np.abs(value - truth) <= 1.96 * std).astype(float)]


def shown(rows: list[list[float]]) -> str:
    found = np.array([row for row in rows if row])
    if not len(found):
        return f"{0:3d} of {len(rows)}"
    errors, held = np.median(np.abs(found[:, :2]), axis=0), 100 * found[:, 2:].mean(axis=0)
    return f"{len(found):3d} of {len(rows)}  {100 * errors[0]:6.2f} % {held[0]:4.0f} %  {100 * errors[1]:5.0f} % {held[1]:4.0f} %"


def main() -> None:
    """Print one row a case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=300.0)
    chosen = parser.parse_args()
    print(
        "tone               damping  taken off  left  | found, error and 95 % of f, of damping, as it is  | without tones"
    )
    for distance, ratio, kind in CASES:
        before, after, left, count = [], [], [], 0
        for k in range(chosen.records):
            rng = np.random.default_rng([chosen.seed, k, round(1e4 * distance), round(1e5 * ratio), len(kind)])
            random, tone = motions(rng, chosen.seconds, distance, ratio, kind)
            record = TimeRecord(RATE, random + tone, ("1X", "2X", "3X", "4X"), ("acceleration",) * 4)
            ready = prepare(record, Preparation(remove_tones="auto"))
            count += len(ready.tones) > 0
            left.append(float(np.std(ready.record.values - random + random.mean(axis=0)) / random.std()))
            before.append(judged(record, ratio))
            after.append(judged(ready.record, ratio))
        name = f"{kind} {100 * distance:.0f} % off" if kind != "none" else kind
        words = f"{name:19s} {100 * ratio:3.1f} %   {count:3d} of {chosen.records}  {np.median(left):5.3f}"
        print(f"{words} | {shown(before):43s} | {shown(after)}", flush=True)


if __name__ == "__main__":
    main()
