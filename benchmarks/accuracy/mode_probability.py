"""Weights of the probability that a cluster of poles is a mode, from simulated records whose modes are known.

Random structures: 3 to 10 modes at random frequencies, damping ratios of 0.2 to 4 %, 3 to 8 channels, in turn ambient
motion, free decays and FRFs; noise of 1 to 50 % (FRFs: 0.3 to 10 %) of each channel, of every other ambient record 30 to 500 %
more; 500 to 12,000 samples. Every fourth record is noise alone, of 2 to 8 channels, white or under a first-order filter and
mixed. Every stable cluster of three poles or more is a mode if it is the nearest to a true one, within 3 half-power bandwidths
and with a MAC above 0.8. Logistic regression with a ridge of 1; half of the records are held back, and the calibration on these
is printed, that of the weights in use beside it. First all clusters without deviations; then those of ambient motion and noise
with the deviations of frequency and shape, where the probability without is not below 0.05, and further poles of a mode are
passed over. Last what records of noise and ambient motion show in the end.

    python benchmarks/accuracy/mode_probability.py [--records 120] [--seed 0]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import special
from scipy.signal import lfilter

import structid as sid
from structid.core.errors import NoModesError
from structid.modal import ModalOptions, modal_identification
from structid.modal.correlations import outputs
from structid.modal.poles.poles import HardCriteria
from structid.modal.poles.stabilization import Cluster, clusters, evidence, likely_modes, mode_probability
from structid.modal.subspace.kernel import poles_of_orders
from structid.modal.subspace.methods import pencil
from structid.modal.subspace.pole_uncertainty import piece_deviations
from structid.modal.subspace.subspace_modes import (
    BLOCK_ROWS,
    MAX_ORDER,
    PoleChanges,
    changes_of_poles,
    surest_poles,
    with_deviations,
)

RATE = 50.0
FEWEST = 3  # poles of a cluster that is looked at
POSSIBLE = 0.05  # probability without deviations from which on they are looked at
Labelled = tuple[np.ndarray, np.ndarray, int, int, int, list[Cluster]]
Truth = tuple[np.ndarray, np.ndarray, np.ndarray]


def truth(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (Hz), damping ratios and shapes (n_channels, n_modes), complex for a third of the structures."""
    n, m = int(rng.integers(3, 11)), int(rng.integers(3, 9))
    frequency = np.sort(rng.uniform(1.0, 20.0, n))
    ratio, shapes = 10 ** rng.uniform(np.log10(0.002), np.log10(0.04), n), rng.standard_normal((m, n))
    phase = rng.uniform(0.1, 0.6) * rng.standard_normal((m, n)) if rng.random() < 1 / 3 else np.zeros((m, n))
    return frequency, ratio, shapes * np.exp(1j * phase)


def length(rng: np.random.Generator) -> int:
    """Samples of a record of ambient motion or noise: 500 to 12,000, as often below as above 2450."""
    return int(10 ** rng.uniform(np.log10(500), np.log10(12000)))


def time_record(rng: np.random.Generator, free: bool) -> tuple[sid.TimeRecord, tuple[np.ndarray, ...]]:
    """Velocities of a random structure under white forces, or in free decay."""
    frequency, ratio, shapes = truth(rng)
    n_samples = int(rng.integers(1500, 12000)) if free else length(rng)
    poles = 2 * np.pi * frequency * (-ratio + 1j * np.sqrt(1 - ratio**2)) / RATE
    t = np.arange(n_samples)[:, None]
    if free:
        motion = np.exp(poles * t)
    else:
        force = rng.standard_normal((n_samples + 2000, len(poles)))
        motion = [lfilter([1.0], [1.0, -z], f)[2000:] for z, f in zip(np.exp(poles), force.T, strict=True)]
        motion = np.array(motion).T
    motion = motion / motion.std(axis=0) * rng.uniform(0.2, 2.0, len(poles))
    values = (motion @ shapes.T).real
    noise = 10 ** rng.uniform(-2, np.log10(0.5))
    values = values + noise * values.std(axis=0) * rng.standard_normal(values.shape)
    names = [f"{i + 1}X" for i in range(len(shapes))]
    return sid.TimeRecord(RATE, values, names, ("velocity",) * len(names)), (frequency, ratio, shapes)


def frf_record(rng: np.random.Generator) -> tuple[sid.FrfRecord, tuple[np.ndarray, ...]]:
    """Accelerances of a random structure under one load."""
    frequency, ratio, shapes = truth(rng)
    lines = np.linspace(0.5, 22.0, int(rng.integers(100, 1000)))
    s, omega = 2j * np.pi * lines[:, None], 2 * np.pi * frequency
    poles = omega * (-ratio + 1j * np.sqrt(1 - ratio**2))
    residues = rng.uniform(0.2, 1.0, len(omega)) / (2j * poles.imag) * shapes
    values = (s**2 / (s - poles)) @ residues.T + (s**2 / (s - poles.conj())) @ residues.conj().T
    noise = 10 ** rng.uniform(-2.5, -1) * np.sqrt(np.mean(np.abs(values) ** 2, axis=0))
    values = values + noise * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
    names = [f"{i + 1}X" for i in range(len(shapes))]
    return sid.FrfRecord(lines, values[:, :, None], names, names[:1], "accelerance"), (frequency, ratio, shapes)


def noise_record(rng: np.random.Generator) -> sid.TimeRecord:
    """Noise alone: white, or under a first-order filter with its channels mixed."""
    m, n_samples = int(rng.integers(2, 9)), length(rng)
    values = rng.standard_normal((n_samples, m))
    if rng.random() < 0.5:
        values = lfilter([1.0], [1.0, -rng.uniform(-0.5, 0.9)], values, axis=0) @ rng.standard_normal((m, m))
    return sid.TimeRecord(RATE, values, [f"{i + 1}X" for i in range(m)], ("velocity",) * m)


def labelled_noise(seed: int) -> Labelled:
    """`labelled` for a record of noise, none of whose clusters is a mode."""
    data = outputs(noise_record(np.random.default_rng(seed)))
    rows = max(BLOCK_ROWS, -(-2 * MAX_ORDER // data.n_channels))
    subspace = pencil(data, rows, MAX_ORDER)
    sweep = poles_of_orders(subspace, range(2, min(MAX_ORDER, subspace.max_order) + 1, 2))
    every = [c for c in clusters(sweep, data.scale, HardCriteria().damped, keep_all=True) if c.size >= FEWEST]
    rows_of_evidence = np.array([evidence(c) for c in every]).reshape(len(every), 5)
    return rows_of_evidence, np.zeros(len(every), dtype=bool), 0, 0, len(likely_modes(every)), every


def labelled(seed: int) -> Labelled:
    """Evidence of all clusters of a record, which are modes; modes in all, right ones picked, others picked; the clusters."""
    if seed % 4 == 3:
        return labelled_noise(seed)
    rng = np.random.default_rng(seed)
    if seed % 4 == 0:
        record, true = ambient_record(rng, seed)
    else:
        record, true = frf_record(rng) if seed % 4 == 2 else time_record(rng, True)
    frequency, _, shapes = true
    try:
        found = modal_identification(record, options=ModalOptions(n_pieces=0, refine=False, deviation=None))
    except NoModesError:
        return np.zeros((0, 5)), np.zeros(0, dtype=bool), len(frequency), 0, 0, []
    scale = np.ones(len(shapes)) if seed % 4 == 2 else outputs(record).scale
    every = [c for c in clusters(found.sweep, scale, found.options.criteria, keep_all=True) if c.size >= FEWEST]
    f = np.array([c.frequency[c.chosen] for c in every])
    seen = np.stack([found.sweep[c.number[c.chosen]].shapes[:, c.index[c.chosen]] for c in every], axis=1)

    picked = near_and_alike(found.modes.frequency, np.asarray(found.modes.mode_shapes), true)[0]
    rows = np.array([evidence(c) for c in every])
    return rows, near_and_alike(f, seen, true)[0], len(frequency), int(picked.sum()), int((~picked).sum()), every


def near_and_alike(f: np.ndarray, shapes: np.ndarray, true: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Which poles (n_poles,) are the nearest to a true mode, and which are near one and alike (others of the same mode, too)."""
    frequency, ratio, true_shapes = true
    width, likeness = 6 * np.maximum(ratio * frequency, 0.002 * frequency), sid.mac(shapes, true_shapes)
    gap = np.abs(f[:, None] - frequency)
    near = (gap < width) & (likeness > 0.8)
    away = np.where(near, gap / width + 1 - likeness, np.inf)
    nearest = np.zeros(len(f), dtype=bool)
    for column in away.T:
        if np.isfinite(column).any():
            nearest[column.argmin()] = True
    return nearest, near.any(axis=1)


def known_deviations(seed: int) -> tuple[list[Cluster], np.ndarray]:
    """Clusters of an ambient record or of noise with their deviations, and which are modes."""
    rng, true = np.random.default_rng(seed), None
    if seed % 4 == 3:
        record = noise_record(rng)
    else:
        record, true = ambient_record(rng, seed)
    data = outputs(record)
    rows = max(BLOCK_ROWS, -(-2 * MAX_ORDER // data.n_channels))
    subspace = pencil(data, rows, MAX_ORDER, n_pieces=40)
    sweep = poles_of_orders(subspace, range(2, min(MAX_ORDER, subspace.max_order) + 1, 2))
    every = clusters(sweep, data.scale, HardCriteria().damped, keep_all=True)
    every = tuple(c for c in every if c.probability >= POSSIBLE)
    if not every:
        return [], np.zeros(0, dtype=bool)
    places = [c.place for c in every]
    spread = piece_deviations(subspace, subspace.max_order)
    changes = PoleChanges(spread, *changes_of_poles(subspace, spread, sweep, places))
    every, changes = surest_poles(subspace, sweep, every, changes, data.seconds, data.seconds / 40, POSSIBLE)
    places = [c.place for c in every]
    judged, is_mode = with_deviations(subspace, sweep, every, changes), np.zeros(len(every), dtype=bool)
    if true is not None:
        f = np.array([c.frequency[c.chosen] for c in every])
        is_mode, alike = near_and_alike(f, np.stack([sweep[k].shapes[:, i] for k, i in places], axis=1), true)
        judged = [c for c, further in zip(judged, alike & ~is_mode, strict=True) if not further]
        is_mode = is_mode[~(alike & ~is_mode)]
    is_known = np.array([np.isfinite(c.excess + c.shape_error) for c in judged], dtype=bool)
    return [c for c, known in zip(judged, is_known, strict=True) if known], is_mode[is_known]


def ambient_record(rng: np.random.Generator, seed: int) -> tuple[sid.TimeRecord, Truth]:
    """`time_record` under white forces; with more noise where `seed` is a multiple of 8."""
    record, true = time_record(rng, False)
    if seed % 8 == 0:
        size = 10 ** rng.uniform(np.log10(0.3), np.log10(5.0)) * record.values.std(axis=0)
        values = record.values + size * rng.standard_normal(record.values.shape)
        record = sid.TimeRecord(RATE, values, record.channels, record.quantities)
    return record, true


def in_the_end(seeds: range) -> str:
    """Words on what records of noise and of ambient motion show, by default."""
    false_of_noise, showing, found, others, n_true, n_noise = [], 0, 0, 0, 0, 0
    for seed in seeds:
        if seed % 4 not in (0, 3):
            continue
        rng, true = np.random.default_rng(seed), None
        if seed % 4 == 3:
            record, n_noise = noise_record(rng), n_noise + 1
        else:
            record, true = ambient_record(rng, seed)
            n_true += len(true[0])
        try:
            result = modal_identification(record)
        except NoModesError:
            continue
        if true is None:
            showing += 1
            false_of_noise += result.probability.tolist()
        else:
            right, _ = near_and_alike(result.modes.frequency, np.asarray(result.modes.mode_shapes), true)
            found, others = found + int(right.sum()), others + int((~right).sum())
    listed = ", ".join(f"{p:.2f}" for p in sorted(false_of_noise)) or "none"
    return (
        f"in the end: {showing} of {n_noise} records of noise show a mode (probabilities: {listed});"
        f" of {n_true} ambient modes {found}, and {others} others"
    )


def weights(rows: np.ndarray, is_mode: np.ndarray) -> np.ndarray:
    """Logistic regression by Newton's method with a ridge of 1 on all but the first weight."""
    w, ridge = np.zeros(rows.shape[1]), np.diag([0.0, *np.ones(rows.shape[1] - 1)])
    for _ in range(30):
        p = special.expit(rows @ w)
        hessian = rows.T @ (rows * (p * (1 - p))[:, None]) + ridge
        w = w + np.linalg.solve(hessian, rows.T @ (is_mode - p) - ridge @ w)
    return w


def main() -> None:
    """Print the weights, and how they do on the records held back."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    parts = [labelled(seed) for seed in range(chosen.seed, chosen.seed + chosen.records)]
    half = len(parts) // 2
    train = np.concatenate([p[0] for p in parts[:half]]), np.concatenate([p[1] for p in parts[:half]])
    test = np.concatenate([p[0] for p in parts[half:]]), np.concatenate([p[1] for p in parts[half:]])
    w = weights(*train)
    print("weights:", ", ".join(f"{value:.2f}" for value in w), f"({len(train[1])} clusters, {train[1].sum()} modes)")
    in_use = np.array([mode_probability(cluster) for part in parts[half:] for cluster in part[5]])
    p = special.expit(test[0] @ w)
    print("held back: probability, clusters, modes among them; the same by the weights in use")
    print_calibration(p, in_use, test[1])
    n, right, others = (sum(int(part[i]) for part in parts[half:]) for i in (2, 3, 4))
    of_noise = sum(part[4] for part in parts[half:] if not part[2])
    print(
        f"of {n} modes: {right} picked now, and {others} others, {of_noise} of these in noise alone; in clusters"
        f" {int(test[1].sum())}"
    )
    for limit in (0.2, 0.5, 0.8):
        print(f"  by probability above {limit}: {test[1][p > limit].sum()}, and {(~test[1][p > limit]).sum()} others")

    known = [known_deviations(s) for s in range(chosen.seed, chosen.seed + chosen.records) if s % 4 in (0, 3)]
    halves = known[: len(known) // 2], known[len(known) // 2 :]
    rows = [np.array([evidence(c) for clusters, _ in part for c in clusters]).reshape(-1, 3) for part in halves]
    is_mode = [np.concatenate([modes for _, modes in part]) for part in halves]
    w = weights(rows[0], is_mode[0])
    print(
        "with deviations, weights:",
        ", ".join(f"{v:.2f}" for v in w),
        f"({len(rows[0])} clusters, {is_mode[0].sum()} modes)",
    )
    in_use = np.array([mode_probability(c) for clusters, _ in halves[1] for c in clusters])
    print_calibration(special.expit(rows[1] @ w), in_use, is_mode[1])
    print(in_the_end(range(chosen.seed + chosen.records // 2, chosen.seed + chosen.records)))


def print_calibration(p: np.ndarray, in_use: np.ndarray, is_mode: np.ndarray) -> None:
    """Print clusters and the part of modes among them by probability: by new weights, then by those in use."""
    for low, high in ((0, 0.05), (0.05, 0.3), (0.3, 0.7), (0.7, 0.95), (0.95, 1.01)):
        counts = ((p >= low) & (p < high), (in_use >= low) & (in_use < high))
        columns = (f"{inside.sum():5d}  {is_mode[inside].mean() if inside.any() else 0:.3f}" for inside in counts)
        print(f"  {low:.2f}-{min(high, 1):.2f}  {'    '.join(columns)}")


if __name__ == "__main__":
    main()
