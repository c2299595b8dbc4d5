"""Coverage of the 95 % intervals on a synthetic twin of the measured frame; every repeat counts.

The truth is the model identified from the measured record; the twin has the example's sensors and lines, 1 % noise, and
every search starts from another random point, 20 % off (log-normal). All that the model holds is exact. Repeat k has
seed k.

    python benchmarks/accuracy/frame_twin.py [--repeats 400] [--stride 1] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.study.schema.records.record import load_record
from structid.study.schema.study import load_study
from structid.unknowns.tolerances import EXACT

STUDY = Path(__file__).parents[2] / "examples" / "three_storey_frame" / "study.toml"


@cache
def twin(stride: int) -> tuple[sid.Structure, sid.Parameters, sid.FrfRecord]:
    """Structure, true parameters and noise-free record."""
    study = load_study(STUDY)
    record = load_record(study.record)
    found = sid.identify(study.structure, study.parameters, record, study.options)
    truth = study.parameters.started_at(found.estimate.values)
    lines = found.problem.record.lines(np.arange(0, len(found.problem.record.frequency), stride))
    return study.structure, truth, sid.simulated_record(study.structure, truth, lines)


def repeat(arguments: tuple[int, int], spread: float = 0.2) -> tuple[np.ndarray, np.ndarray, float, str]:
    """Error over standard deviation of every parameter, relative standard deviation, chi-square per dof, status."""
    seed, stride = arguments
    structure, truth, clean = twin(stride)
    rng = np.random.default_rng(seed)
    record = sid.simulated_record(structure, truth, clean, 0.01, rng)
    start = truth.started_at(truth.start * np.exp(spread * rng.standard_normal(truth.n_params)))
    found = sid.identify(structure, start, record, sid.IdentifyOptions(tolerances=EXACT)).estimate
    return (
        (found.values - truth.start) / found.std,
        found.std / truth.start,
        found.chi_square_per_dof,
        found.status.value,
    )


def main() -> None:
    """Print coverage by parameter and over all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=400)
    parser.add_argument("--stride", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    tasks = [(seed, chosen.stride) for seed in range(chosen.repeats)]
    if chosen.workers == 1:
        results = [repeat(task) for task in tasks]
    else:
        with ProcessPoolExecutor(chosen.workers) as pool:
            results = list(pool.map(repeat, tasks))
    errors = np.array([r[0] for r in results])
    inside = np.abs(errors) <= 1.959964
    print(
        f"{chosen.repeats} repeats, seeds 0 to {chosen.repeats - 1}, every {chosen.stride}. line, 1 % noise, starts 20 % off"
    )
    for j, name in enumerate(twin(chosen.stride)[1].names):
        std = np.median([r[1][j] for r in results])
        print(f"  {name:34s} coverage {100 * inside[:, j].mean():5.1f} %   std {100 * std:7.3f} % of the value")
    chi = np.array([r[2] for r in results])
    print(f"all parameters: coverage {100 * inside.mean():.2f} %, aim 93 to 97")
    print(f"chi-square per degree of freedom: {chi.mean():.4f} on average, {chi.min():.4f} to {chi.max():.4f}")
    statuses = [r[3] for r in results]
    print("ended: " + ", ".join(f"{s} {statuses.count(s)}" for s in sorted(set(statuses))))
    missed = np.flatnonzero(chi > 1.5)
    print(f"worse minima (chi-square per degree of freedom above 1.5): {len(missed)}, seeds {missed.tolist()}")
    reached = inside[chi <= 1.5]
    print(f"coverage where the minimum was reached: {100 * reached.mean():.2f} %")


if __name__ == "__main__":
    main()
