"""Coverage of 95 % intervals of the methods in the frequency domain, in ambient motion.

The chain of four masses (600 s at 10 Hz, 2 % noise, damping ratios of 1 %) and a pair of close modes (1.000 and
1.010 Hz, 60 degrees between their shapes, 4 channels, 1800 s), modes found automatically and matched to the nearest
true frequency. The mean standard deviation is compared with the rms error and, for the Bayesian FFT, with the
uncertainty law for long data (Au 2014) at the bands used. Every seed counts: records that fail, modes that are missing
or without an interval count as not covered.

    python benchmarks/accuracy/spectral_modes.py [--repeats 20] [--seed 0]
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from structid import InputError
from structid.modal import identify_modes

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "modal"))
from modal_cases import ambient_chain, chain_modes
from spectral_cases import CLOSE, close_pair

TARGET = (90.0, 98.0)


def chain_case(seed: int):
    """Record of the chain, its frequencies (Hz) and damping ratios."""
    return ambient_chain(seed), chain_modes()[0] / (2 * np.pi), np.full(4, 0.01)


def close_case(seed: int):
    """Record of the pair, its frequencies (Hz) and damping ratios."""
    return close_pair(seed), np.array(CLOSE), np.full(2, 0.01)


def one(record, method: str, truth: np.ndarray):
    """Errors over truth and standard deviations (n_modes, 2 each), NaN for modes that are missing; extra modes."""
    values, stds = np.full((len(truth), 2), np.nan), np.full((len(truth), 2), np.nan)
    try:
        found = identify_modes(record, method)
    except InputError:
        return values, stds, 0
    std = np.full(2 * found.n_modes, np.nan)
    if found.covariance is not None:
        std = np.sqrt(np.diag(found.covariance))
    taken: set[int] = set()
    for k, f in enumerate(truth):
        free = [i for i in range(found.n_modes) if i not in taken]
        if not free:
            break
        i = min(free, key=lambda i: abs(found.frequency[i] - f))
        if abs(found.frequency[i] / f - 1) > 0.05:
            continue
        taken.add(i)
        values[k] = found.frequency[i], found.damping_ratio[i]
        stds[k] = std[i], std[found.n_modes + i]
    return values, stds, found.n_modes - len(taken)


def table(words: str, case, method: str, seeds: range) -> None:
    """One block: coverage, rms error and mean standard deviation of every mode."""
    values, stds, extra = [], [], 0
    for seed in seeds:
        record, frequency, ratio = case(seed)
        value, std, more = one(record, method, frequency)
        values.append(value)
        stds.append(std)
        extra += more
    truth = np.stack([frequency, ratio], axis=1)
    error, spread = np.array(values) - truth, np.array(stds)
    inside = np.abs(error) <= 1.96 * spread  # NaN counts as outside
    missing = int(np.isnan(error[..., 0]).sum())
    blind = int(np.isnan(spread[..., 0]).sum()) - missing
    total = 100 * inside.mean(axis=(0, 1))
    verdict = ["met" if TARGET[0] <= x <= TARGET[1] else "MISSED" for x in total]
    print(f"{words}, {method}: {len(seeds)} records, {missing} modes missing, {blind} without interval, {extra} more")
    for name, k in (("frequency", 0), ("damping", 1)):
        print(f"  {name:9s} coverage {total[k]:5.1f} %, aim 90 to 98 %: {verdict[k]}")
    for m, f in enumerate(frequency):
        cells = []
        for k in (0, 1):
            rms = np.sqrt(np.nanmean(error[:, m, k] ** 2)) / truth[m, k]
            bias = np.nanmean(error[:, m, k]) / truth[m, k]
            typical = np.nanmedian(spread[:, m, k]) / truth[m, k]
            cells.append(f"{100 * inside[:, m, k].mean():5.1f} %  rms {rms:7.4f}  mean {bias:8.4f}  std {typical:7.4f}")
        print(f"    {f:6.3f} Hz  f: {cells[0]}   zeta: {cells[1]}")
    if method == "bayesian_fft" and len(truth) > 2:
        periods = frequency * len(record.values) / record.sampling_rate
        law = 1 / np.sqrt(2 * np.pi * 0.01 * periods)
        print(f"    long data, wide band: std of zeta over zeta {np.array2string(law, precision=4)}")


def main() -> None:
    """Print all blocks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    seeds = range(chosen.seed, chosen.seed + chosen.repeats)
    print(f"seeds {seeds.start} to {seeds.stop - 1}; errors and standard deviations over the true value")
    table("chain", chain_case, "bayesian_fft", seeds)
    table("close pair", close_case, "bayesian_fft", seeds)


if __name__ == "__main__":
    main()
