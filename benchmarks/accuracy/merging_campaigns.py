"""Campaigns of several set-ups, each of which lacks one or two of ten modes: how many come out, how exactly.

A cantilever-like line of 40 points, 3 references and 6 points of its own in each of 12 set-ups; ten modes whose frequencies
and damping ratios have stated deviations of 0.1 and 10 %, shape entries of 2 % of the largest; with --scatter the
structure changes from set-up to set-up by a relative deviation.

    python benchmarks/accuracy/merging_campaigns.py [--campaigns 20] [--seed 0] [--scatter 0]
"""

from __future__ import annotations

import argparse

import numpy as np

import structid as sid
from structid.modal.merging import merged_setups
from structid.modal.modal_record import unit_largest

N_SETUPS, N_MODES, REFERENCES, OWN = 12, 10, (37, 24, 13), 6
F_STD, D_STD, SHAPE_STD = 1e-3, 0.1, 0.02


def campaign(rng: np.random.Generator, scatter: float) -> tuple[list[sid.ModalRecord], np.ndarray, np.ndarray]:
    """Modes of the set-ups, true frequencies and shapes at 40 points."""
    x = (np.arange(40) + 1) / 40
    shapes = np.sin(np.pi * (np.arange(N_MODES) + 0.5) * x[:, None])
    frequency = np.cumsum(rng.uniform(0.4, 2.0, N_MODES)) + 1
    others = [i for i in range(40) if i not in REFERENCES]
    setups = []
    for number in range(N_SETUPS):
        points = [*REFERENCES, *(others[(number * OWN + k) % len(others)] for k in range(OWN))]
        has = np.sort(rng.choice(N_MODES, N_MODES - int(rng.integers(1, 3)), replace=False))
        f = frequency[has] * (1 + scatter * rng.standard_normal(len(has)))
        f = np.sort(f + F_STD * f * rng.standard_normal(len(has)))
        shape = unit_largest(shapes[np.ix_(points, has)])
        noise = rng.standard_normal(shape.shape) + 1j * rng.standard_normal(shape.shape)
        shape = np.asarray(shape + SHAPE_STD * noise) * np.exp(2j * np.pi * rng.random(len(has)))
        variance = np.concatenate([(F_STD * f) ** 2, np.full(len(has), (D_STD * 0.01) ** 2)])
        ratio = 0.01 * (1 + D_STD * rng.standard_normal(len(has)))
        names = [f"{p + 1}Z" for p in points]
        std = np.full(shape.shape, SHAPE_STD)
        setups.append(sid.ModalRecord(f, ratio, shape, names, np.diag(variance), std))
    return setups, frequency, shapes


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scatter", type=float, default=0.0)
    chosen = parser.parse_args()
    counts, scores, damping, off, stated = [], [], [], [], []
    for seed in range(chosen.seed, chosen.seed + chosen.campaigns):
        setups, frequency, shapes = campaign(np.random.default_rng(seed), chosen.scatter)
        modes = merged_setups(setups).modes
        counts.append(modes.n_modes)
        if modes.n_modes != N_MODES:
            continue
        scores.append((modes.frequency - frequency) / modes.frequency_std)
        damping.append((modes.damping_ratio - 0.01) / modes.std[N_MODES:])
        rows = np.array([int(str(dof)[:-2]) - 1 for dof in modes.channels])
        for seen, true, std in zip(modes.mode_shapes.T, shapes[rows].T, np.asarray(modes.shape_std).T, strict=True):
            known = ~np.isnan(seen)
            x, y = seen[known], true[known]
            fit = (x.conj() @ y) / (x.conj() @ x)
            off.append(np.sqrt(np.mean(np.abs(x * fit - y).real ** 2) / 2) / np.abs(fit))
            stated.append(np.sqrt(np.mean(std[known] ** 2)))
    print(
        f"{chosen.campaigns} campaigns of {N_SETUPS} set-ups; modes found: {sorted(set(counts))}, {counts.count(N_MODES)} times 10"
    )
    print(
        f"z rms: frequency {np.sqrt(np.mean(np.square(scores))):.3f}, damping {np.sqrt(np.mean(np.square(damping))):.3f}"
    )
    print(
        f"shape error {np.sqrt(np.mean(np.square(off))):.4f} a part, noise of one entry {SHAPE_STD}, stated {np.mean(stated):.4f}"
    )


if __name__ == "__main__":
    main()
