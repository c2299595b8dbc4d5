"""Modes of FRFs by `lscf`: exactness without noise, coverage of 95 % intervals with 1 % noise, close modes, real FRFs.

A chain of four masses, 0 to 400 Hz in steps of 0.5 Hz, damping ratios of 1 %; four outputs, one or two inputs. Noise is
1 % of each FRF's rms on all its lines, or 1 % of each value; the record states its variance, or does not. Default
options throughout. Every seed counts: a record that does not show exactly the true number of modes is counted, and its
intervals are those of the modes nearest to the true ones.

Then six points, 8 to 50 Hz, five modes in the band and others outside: what they leave in the band must not spoil intervals.

    python benchmarks/accuracy/frf_modes.py [--repeats 200] [--beyond 40] [--seed 0]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from structid.modal import identify_modes
from structid.records import FrfRecord

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "modal"))
from frf_cases import (
    APART,
    CLOSE,
    DAMPED,
    HEAVY,
    KINDS,
    LIGHT,
    MEDIUM,
    aligned,
    banded,
    chain,
    close_pair,
    deviations,
    frf,
)
from modal_cases import nearest

FRAME = Path(__file__).parents[3] / "shared" / "data" / "three_storey_building_frf" / "frf.npz"
PEAKS = np.array([21.62, 50.06, 68.4])


def exactness(kinds: int | None) -> None:
    """One row a case without noise."""
    print(
        "no noise: largest relative error of frequency, damping ratio, and of shapes scaled to mass; bars 1e-9, 1e-9, 1e-8"
    )
    for words, (frequency, shapes) in (("chain", chain()), ("close pair", close_pair())):
        for kind in KINDS[:kinds]:
            for inputs in ((0,), (0, 3)) if words == "chain" else ((0, 3),):
                found = identify_modes(frf(frequency, shapes, inputs, kind))
                if found.n_modes != len(frequency):
                    print(f"{words:10s} {kind:11s} {len(inputs)} inputs   {found.n_modes} modes: MISSED")
                    continue
                errors = [
                    np.abs(found.frequency / frequency - 1).max(),
                    np.abs(found.damping_ratio / 0.01 - 1).max(),
                    np.abs(aligned(found.mode_shapes, shapes) - shapes).max() / np.abs(shapes).max(),
                ]
                met = "met" if errors[0] <= 1e-9 and errors[1] <= 1e-9 and errors[2] <= 1e-8 else "MISSED"
                print(
                    f"{words:10s} {kind:11s} {len(inputs)} inputs  {errors[0]:9.1e}{errors[1]:9.1e}{errors[2]:9.1e}  {met}"
                )


def coverage(seeds: range) -> None:
    """Part of 95 % intervals that hold the truth."""
    print(f"1 % noise, seeds {seeds.start} to {seeds.stop - 1}: coverage of 95 % intervals, aim 90 to 98 %")
    for words, (frequency, shapes) in (("chain", chain()), ("close pair", close_pair())):
        for inputs in ((0,), (0, 3)) if words == "chain" else ((0, 3),):
            for relative in (False, True):
                for known in (True, False):
                    kind = "value" if relative else "FRF"
                    head = f"{words:10s} {len(inputs)} inputs, noise of {kind:5s} {'known' if known else 'unknown':7s}"
                    print(head, coverage_row(frequency, shapes, inputs, relative, known, seeds), flush=True)


def coverage_row(
    frequency: np.ndarray, shapes: np.ndarray, inputs: tuple[int, ...], relative: bool, known: bool, seeds: range
) -> str:
    """One case over all seeds."""
    inside: list[list[np.ndarray]] = [[], [], []]
    errors, counts = [], []
    for seed in seeds:
        record = frf(frequency, shapes, inputs, noise=0.01, seed=seed, relative=relative, known=known)
        found = identify_modes(record)
        near, n = nearest(found.frequency, frequency), found.n_modes
        assert found.covariance is not None
        assert found.shape_std is not None
        std = np.sqrt(np.diag(found.covariance))
        inside[0].append(np.abs(found.frequency[near] - frequency) <= 1.96 * std[:n][near])
        inside[1].append(np.abs(found.damping_ratio[near] - 0.01) <= 1.96 * std[n:][near])
        real = aligned(found.mode_shapes[:, near], shapes).real
        if found.scaling == "mass":
            inside[2].append((np.abs(real - shapes) <= 1.96 * found.shape_std[:, near]).ravel())
        else:
            inside[2].append(np.zeros(shapes.size, dtype=bool))
        errors.append(found.damping_ratio[near] / 0.01 - 1)
        counts.append(n)
    parts = [100 * np.mean(np.concatenate(part)) for part in inside]
    verdict = "met" if min(parts) >= 90 and max(parts) <= 98 else "MISSED"
    fewer, more = sum(n < len(frequency) for n in counts), sum(n > len(frequency) for n in counts)
    return (
        f"frequency {parts[0]:5.1f} %  damping {parts[1]:5.1f} %  shapes {parts[2]:5.1f} %  {verdict:6s}  mean damping error "
        f"{100 * np.mean(errors):6.3f} %  records with fewer modes {fewer}, with more {more}"
    )


#: Words, settings of `banded`.
BEYOND = (
    ("no mode outside", {"beyond": ()}),
    ("the same, a close pair", {"beyond": (), "frequency": CLOSE, "damping": MEDIUM}),
    ("the same, 120 lines", {"beyond": (), "lines": 120}),
    ("0.5, 90, 160 Hz", {}),
    ("the same, a close pair", {"frequency": CLOSE, "damping": MEDIUM}),
    ("the same, damping 5-12 %", {"frequency": DAMPED, "damping": HEAVY}),
    ("the same, 3 % noise", {"noise": 0.03}),
    ("the same, one load", {"inputs": (5,)}),
    ("the same, noise constant", {"noise": 0.0, "floor": 0.01}),
    ("the same, variance known", {"known": True, "floor": 0.001}),
    ("the same, 120 lines", {"lines": 120}),
    ("eight, 3 to 300 Hz", {"beyond": (3.0, 4.0, 70.0, 77.0, 90.0, 120.0, 160.0, 300.0)}),
    ("6, 55, 62 Hz", {"beyond": (6.0, 55.0, 62.0)}),
    ("7.3, 52.5, 70 Hz", {"beyond": (7.3, 52.5, 70.0)}),
)


def beyond(seeds: range, rows: int | None) -> None:
    """Intervals with modes outside of the band."""
    print(f"modes outside 8 to 50 Hz, seeds {seeds.start} to {seeds.stop - 1}: coverage of 95 % intervals")
    for words, settings in BEYOND[:rows]:
        frequency, damping = settings.get("frequency", APART), settings.get("damping", LIGHT)
        found, counts, widened, start = [], [], 0, time.perf_counter()
        for seed in seeds:
            record, shapes = banded(seed, **settings)
            modes = identify_modes(record)
            found.append(deviations(modes, frequency, damping, shapes))
            counts.append(modes.n_modes)
            widened += any("correlated from line to line" in note for note in modes.warnings)
        parts = [100 * np.mean(np.abs(np.concatenate(part)) <= 1.96) for part in zip(*found, strict=True)]
        print(
            f"{words:26s} frequency {parts[0]:5.1f} %  damping {parts[1]:5.1f} %  shapes {parts[2]:5.1f} %  records warned "
            f"of {widened}, with other than 5 modes {sum(n != 5 for n in counts)}, "
            f"{(time.perf_counter() - start) / len(seeds):.2f} s each",
            flush=True,
        )


def frame() -> None:
    """The measured frame beside its peaks."""
    if not FRAME.exists():
        print("the record of the three-storey frame is not beside the project (shared/data): left out")
        return
    data = np.load(FRAME)
    names = ["1X-", "4X", "3X", "2X", "5X", "9X", "8X", "7X", "6X"]
    found = identify_modes(FrfRecord(data["freq_hz"], data["accelerance"][:, :, None], names, ["1X"], "accelerance"))
    print(f"three-storey frame: {found.n_modes} modes (3 expected), shapes scaled by {found.scaling}")
    near = nearest(found.frequency, PEAKS)
    assert found.covariance is not None
    std = np.sqrt(np.diag(found.covariance))
    for peak, m in zip(PEAKS, near, strict=True):
        apart = 100 * (found.frequency[m] / peak - 1)
        print(
            f"    {found.frequency[m]:7.3f} +- {1.96 * std[m]:.3f} Hz, {apart:.2f} % from the peak at {peak:g} Hz, "
            f"damping {100 * found.damping_ratio[m]:.2f} %"
        )


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--beyond", type=int, default=40)
    parser.add_argument("--rows", type=int, help="the first so many rows of modes outside of the band only")
    parser.add_argument("--kinds", type=int, help="the first so many kinds of FRFs without noise only")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    exactness(chosen.kinds)
    frame()
    if chosen.repeats:
        coverage(range(chosen.seed, chosen.seed + chosen.repeats))
    if chosen.beyond:
        beyond(range(chosen.seed, chosen.seed + chosen.beyond), chosen.rows)


if __name__ == "__main__":
    main()
