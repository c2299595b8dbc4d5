"""Modes in noise: the beam of ten sensors in free decay, and the coverage of 95 % intervals in ambient motion.

Free decay: rms relative frequency error of modes 1-5 and 6-10 and median damping error over the seeds, order 24 of 20
states, 20 block rows, poles matched to the nearest true frequency; T = 100 s, step 0.05 s, noise in percent of each
channel's rms. Coverage of the pencil in free decays of a chain of four masses, 60 s at
10 Hz, 1 % noise. Ambient: a chain of four masses, 600 s at 10 Hz, 2 % noise, damping ratios of 1 %. Every seed counts.

    python benchmarks/accuracy/modal_noise.py [--repeats 10] [--decays 200] [--ambient 200] [--seed 0]
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from structid.modal import identify_modes
from structid.reproduce.chapter_5 import beam_omega

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "modal"))
from modal_cases import ambient_chain, beam_decay, chain_modes, decay, nearest

METHODS = ("pencil", "ssi_data", "ssi_cov")
CASES = ((0.01, 0.0), (0.05, 0.0), (0.01, 0.005), (0.05, 0.005))
BARS = {0.01: (1e-4, 0.02), 0.05: (5e-4, 0.05)}


def decay_errors(method: str, kinds: tuple[int, ...], noise: float, ratio: float, seeds: range) -> tuple[float, ...]:
    """Rms frequency error of modes 1-5 and of 6-10, and median damping error."""
    omega = beam_omega(10)
    errors, damping = [], []
    for seed in seeds:
        found = identify_modes(beam_decay(noise, ratio, seed, kinds), method, orders=[24], block_rows=20, n_pieces=0)
        near = nearest(found.omega, omega)
        errors.append(found.omega[near] / omega - 1)
        damping.append(found.damping_ratio[near] - ratio)
    rms = [float(np.sqrt(np.mean(np.square(part)))) for part in (np.array(errors)[:, :5], np.array(errors)[:, 5:])]
    return *rms, float(np.median(np.abs(damping)))


def free_decays(seeds: range) -> None:
    """One row a method."""
    print(
        f"free decay, seeds {seeds.start} to {seeds.stop - 1}: rms frequency error modes 1-5, 6-10; median damping error"
    )
    print("bars for the pencil (u, v): 1 % noise 1e-4 in frequency and 2 % of zeta; 5 % noise 5e-4 and 5 %")
    heads = [f"{100 * n:g} % noise, zeta {100 * z:g} %" for n, z in CASES]
    print(f"{'':16s}" + "".join(f"{head:>28s}" for head in heads))
    for kinds, words in (((0, 1), "(u,v)"), ((0,), "(u)")):
        for method in METHODS:
            cells = [decay_errors(method, kinds, noise, ratio, seeds) for noise, ratio in CASES]
            print(f"{method:9s} {words:6s}" + "".join(f"{a:10.1e}{b:9.1e}{d:9.1e}" for a, b, d in cells))
            if method == "pencil" and kinds == (0, 1):
                for case, cell in zip(CASES, cells, strict=True):
                    print(verdict(*case, *cell))


def verdict(noise: float, ratio: float, low: float, high: float, damping: float) -> str:
    """The figures of one case beside its bars."""
    frequency_bar, damping_bar = BARS[noise]
    met, words = max(low, high) <= frequency_bar, ""
    if ratio:
        met &= damping / ratio <= damping_bar
        words = f", damping {100 * damping / ratio:.2f} % (bar {100 * damping_bar:g} %)"
    return (
        f"    {100 * noise:g} % noise, zeta {100 * ratio:g} %: frequency {max(low, high):.1e} (bar {frequency_bar:.0e})"
        f"{words}: {'met' if met else 'MISSED'}"
    )


def decay_coverage(seeds: range) -> None:
    """Part of 95 % intervals that hold the truth in free decays, and errors over their median standard deviation."""
    omega, shapes = chain_modes()
    print(f"free decays, seeds {seeds.start} to {seeds.stop - 1}: coverage of 95 % intervals, aim 90 to 98 %")
    for order in (8, 10):
        errors, stds = [], []
        for seed in seeds:
            record = decay(omega, shapes, 60.0, 0.1, noise=0.01, seed=seed, velocity=np.ones(4), damping_ratio=0.01)
            found = identify_modes(record, "pencil", orders=[order], block_rows=12)
            assert found.covariance is not None
            near, std = nearest(found.omega, omega), np.sqrt(np.diag(found.covariance))
            near = np.concatenate([near, found.n_modes + near])
            values = np.concatenate([found.frequency, found.damping_ratio])[near]
            errors.append(values - np.concatenate([omega / (2 * np.pi), np.full(4, 0.01)]))
            stds.append(std[near])
        f, d = (100 * np.mean(np.abs(errors)[:, k] <= 1.96 * np.array(stds)[:, k]) for k in (range(4), range(4, 8)))
        size = np.sqrt(np.mean(np.square(errors), axis=0)) / np.median(stds, axis=0)
        print(
            f"pencil order {order:2d}   frequency {f:5.1f} %  damping {d:5.1f} %   rms error over median standard "
            f"deviation {size.min():.2f} to {size.max():.2f}"
        )


def coverage(seeds: range) -> None:
    """Part of 95 % intervals that hold the truth, at fixed order and with modes found automatically."""
    omega, shapes = chain_modes()
    print(f"ambient motion, seeds {seeds.start} to {seeds.stop - 1}: coverage of 95 % intervals, aim 90 to 98 %")
    for method in ("pencil", "ssi_cov", "ssi_data"):
        for orders, words in (([8], "order 8"), (None, "automatic")):
            inside: list[list[np.ndarray]] = [[], [], []]
            counts = []
            for seed in seeds:
                found = identify_modes(ambient_chain(seed), method, orders=orders, block_rows=20, n_pieces=20)
                near, n = nearest(found.omega, omega), found.n_modes
                assert found.covariance is not None
                assert found.shape_std is not None
                std = np.sqrt(np.diag(found.covariance))
                largest = np.abs(found.mode_shapes[:, near]).argmax(axis=0)
                truth, spread = shapes / shapes[largest, range(4)], found.shape_std[:, near]
                free = spread > 1e-12
                inside[0].append(np.abs(found.frequency[near] - omega / (2 * np.pi)) <= 1.96 * std[:n][near])
                inside[1].append(np.abs(found.damping_ratio[near] - 0.01) <= 1.96 * std[n:][near])
                inside[2].append((np.abs(found.mode_shapes[:, near].real - truth) <= 1.96 * spread)[free])
                counts.append(n)
            f, d, s = (100 * np.mean(np.concatenate(part)) for part in inside)
            spurious = sum(n > 4 for n in counts)
            print(
                f"{method:9s} {words:10s} frequency {f:5.1f} %  damping {d:5.1f} %  shapes {s:5.1f} %   "
                f"records with fewer than 4 modes {sum(n < 4 for n in counts)}, with more {spurious}"
            )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--decays", type=int, default=200)
    parser.add_argument("--ambient", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    free_decays(range(chosen.seed, chosen.seed + chosen.repeats))
    if chosen.decays:
        decay_coverage(range(chosen.seed, chosen.seed + chosen.decays))
    if chosen.ambient:
        coverage(range(chosen.seed, chosen.seed + chosen.ambient))


if __name__ == "__main__":
    main()
