"""Covariances and full-field modes against their floors: BLAS syrk, and one read of the samples; one thread.

Ratios of processor time, both sides in turn on the same arrays in the same precision unless a row says otherwise,
medians of five pairs:

    python benchmarks/modal_scale.py [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import blas

from structid.modal import ModalOptions, full_field_modes
from structid.modal.full_field import covariance, shared_motions

PAIRS = 5
CHANNELS, SAMPLES, MODES, NOISE = 100_000, 1000, 10, 0.01
#: Channels and samples of a covariance, and the bar of its ratio.
SIZES = ((100, 100_000, 1.5), (500, 50_000, 1.15), (2000, 10_000, 1.15))
OMEGA = np.linspace(2.0, 40.0, MODES)
RATE = 50.0
Row = dict[str, object]


def use_tiny_records() -> None:
    """Put records of some hundred channels in the place of all others."""
    global CHANNELS, SIZES
    CHANNELS, SIZES = 500, tuple((n, 2000, bar) for n, _, bar in SIZES)


def rows(quick: bool) -> list[Row]:
    """All figures beside their bars; `quick` leaves the largest covariance and the modes out."""
    return [*covariances(quick), *full_field(quick)]


def ratio(ours: Callable[[], object], floor: Callable[[], object]) -> tuple[float, str]:
    """Median ratio of processor times, and both sides' median times; once without a clock before."""
    ours(), floor()
    taken: tuple[list[float], list[float]] = ([], [])
    for _ in range(PAIRS):
        for own, run in zip(taken, (ours, floor), strict=True):
            start = time.process_time()
            run()
            own.append(time.process_time() - start)
    ratios = [a / b for a, b in zip(*taken, strict=True)]
    ours_ms, floor_ms = (1e3 * statistics.median(own) for own in taken)
    words = f"{ours_ms:.0f} ms against {floor_ms:.0f} ms, {min(ratios):.2f} to {max(ratios):.2f}"
    return statistics.median(ratios), words


def row(what: str, bar: float, figure: float, detail: str) -> Row:
    """One figure that must not exceed `bar`."""
    return {"what": what, "bar": f"<= {bar:g}", "figure": figure, "met": bool(figure <= bar), "detail": detail}


def covariances(quick: bool) -> Iterator[Row]:
    """Mean of y y' against syrk of the same samples."""
    rng = np.random.default_rng(0)
    for n, n_times, bar in SIZES[: 2 if quick else 3]:
        y = rng.standard_normal((n_times, n))
        turned = y.T  # columns in Fortran order, as BLAS takes them

        def syrk(turned: np.ndarray = turned) -> object:
            return blas.dsyrk(1.0, turned)

        figure, words = ratio(lambda y=y: covariance(y), syrk)
        yield row(f"covariance / dsyrk, {n} channels x {n_times} samples", bar, figure, words)
        single = y.astype(np.float32)
        figure, words = ratio(lambda y=single: covariance(y), syrk)
        error = np.abs(covariance(single) - covariance(y)).max() / np.abs(covariance(y)).max()
        what = f"covariance in single precision / dsyrk of doubles, {n} channels"
        yield row(what, 0.8, figure, f"{words}; error {error:.0e}")


def field() -> np.ndarray:
    """Ten decaying modes of a line of channels and white noise, in double precision."""
    time_axis, places = np.arange(SAMPLES)[:, None] / RATE, np.linspace(0.0, np.pi, CHANNELS)
    motion = np.exp(-0.01 * OMEGA * time_axis) * np.cos(OMEGA * time_axis + np.arange(MODES))
    values = motion @ np.sin(np.outer(np.arange(1, MODES + 1), places))
    values += NOISE * np.random.default_rng(0).standard_normal(values.shape, dtype=np.float32)
    return values


def full_field(quick: bool) -> Iterator[Row]:
    """Shared motions of 100 000 channels against numpy.sum of the same array."""
    values = field()
    for name, table in (("single", values.astype(np.float32)), ("double", values)):
        figure, words = ratio(lambda table=table: shared_motions(table, MODES), table.sum)
        left_out = shared_motions(table, MODES).left_out
        what = f"full field {CHANNELS} channels x {SAMPLES} samples / numpy.sum, {name} precision"
        yield row(what, 8.0, figure, f"{words}; leaves {left_out:.1e} of the power out")
    if not quick:
        yield from modes(values)


def modes(values: np.ndarray) -> Iterator[Row]:
    """Frequencies of the full field against the truth."""
    start = time.process_time()
    names = [f"{i}Z" for i in range(CHANNELS)]
    found = full_field_modes(values, RATE, names, rank=20, options=ModalOptions(n_pieces=20)).modes
    truth = OMEGA * np.hypot(1.0, 0.01) / (2 * np.pi)
    error = float(np.abs(found.frequency / truth - 1).max()) if found.n_modes == MODES else np.nan
    words = f"{found.n_modes} of {MODES} modes, {time.process_time() - start:.1f} s"
    yield row("full field: largest relative error of a frequency", 1e-3, error, words)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave the largest covariance and the modes out")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--tiny", action="store_true", help="few channels and samples, to see that all of it runs")
    chosen = parser.parse_args()
    if chosen.tiny:
        use_tiny_records()
    made = []
    for part in (covariances, full_field):
        for one in part(chosen.quick):
            made.append(one)
            met = "met   " if one["met"] else "MISSED"
            print(f"{one['what']:72s} {one['figure']:9.3g} {one['bar']:>8s} {met} {one['detail']}", flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps(made, indent=1) + "\n")


if __name__ == "__main__":
    main()
