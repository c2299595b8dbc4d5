"""Covariances and full-field modes against their floors: BLAS syrk, and one read of the samples; one thread.

Ratios of processor time, both sides in turn, medians of five pairs:

    python benchmarks/modal_scale.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import blas

from structid.modal import ModalOptions, full_field_modes
from structid.modal.full_field import covariance, shared_motions

PAIRS = 5


def ratio(ours: Callable[[], object], floor: Callable[[], object]) -> tuple[float, float]:
    """Median ratio of processor times, and our median time in s; once without a clock before."""
    ours(), floor()
    ratios, taken = [], []
    for _ in range(PAIRS):
        times = []
        for run in (ours, floor):
            start = time.process_time()
            run()
            times.append(time.process_time() - start)
        ratios.append(times[0] / times[1])
        taken.append(times[0])
    return statistics.median(ratios), statistics.median(taken)


def covariances(rows: list[dict[str, object]]) -> None:
    """Mean of y y' against syrk of the same samples."""
    rng = np.random.default_rng(0)
    for n, n_times, bar in ((100, 100_000, 1.5), (500, 50_000, 1.15), (2000, 10_000, 1.15)):
        y = rng.standard_normal((n_times, n))
        turned = y.T  # columns in Fortran order, as BLAS takes them

        def syrk(turned: np.ndarray = turned) -> object:
            return blas.dsyrk(1.0, turned)

        single = y.astype(np.float32)
        found, seconds = ratio(lambda y=y: covariance(y), syrk)
        add(rows, f"covariance, n = {n}, N = {n_times}, against dsyrk", found, seconds, bar)
        found, seconds = ratio(lambda y=single: covariance(y), syrk)
        error = np.abs(covariance(single) - covariance(y)).max() / np.abs(covariance(y)).max()
        add(rows, f"   single precision (error {error:.0e}), against dsyrk of doubles", found, seconds, 0.8)


def full_field(rows: list[dict[str, object]]) -> None:
    """Shared motions of 100 000 channels against one read of the samples."""
    n, n_times, omega = 100_000, 1000, np.linspace(2.0, 40.0, 10)
    time_axis, places = np.arange(n_times)[:, None] * 0.02, np.linspace(0.0, np.pi, n)
    motion = np.exp(-0.01 * omega * time_axis) * np.cos(omega * time_axis + np.arange(10))
    values = motion @ np.sin(np.outer(np.arange(1, 11), places))
    values += 0.01 * np.random.default_rng(0).standard_normal(values.shape, dtype=np.float32)
    found, seconds = ratio(lambda: shared_motions(values, 10), values.sum)
    add(rows, f"shared motions, n = {n}, N = {n_times}, against one numpy.sum", found, seconds, 8.0)
    start = time.process_time()
    modes = full_field_modes(
        values, 50.0, [f"{i}Z" for i in range(n)], rank=20, options=ModalOptions(n_pieces=20)
    ).modes
    truth = omega * np.hypot(1.0, 0.01) / (2 * np.pi)
    error = np.abs(modes.frequency - truth).max() / truth.max() if modes.n_modes == 10 else np.nan
    print(
        f"modes of it: {modes.n_modes} of 10, largest error {error:.1e} of the highest, {time.process_time() - start:.1f} s"
    )


def add(rows: list[dict[str, object]], what: str, found: float, seconds: float, bar: float) -> None:
    """Print and keep one figure."""
    rows.append({"what": what, "ratio": found, "seconds": seconds, "bar": bar})
    print(f"{what:70s} {found:7.2f}   bar {bar:g}   ({seconds:.3f} s)", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    chosen = parser.parse_args()
    rows: list[dict[str, object]] = []
    covariances(rows)
    full_field(rows)
    if chosen.json:
        chosen.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
