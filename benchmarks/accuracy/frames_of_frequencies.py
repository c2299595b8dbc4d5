"""Random shear frames from their frequencies alone: whether every other frame of the same frequencies is listed.

Masses of three or four storeys are known, all stiffnesses unknown, the frequencies exact; seeds 0 on. All frames that have the
frequencies are found beside it by Newton's method on the characteristic polynomial, from 500 starts.

    python benchmarks/accuracy/frames_of_frequencies.py [--repeats 28] [--seed 0] [--error 1e-5]

`--error` is the standard deviation of the frequencies. An exact frame counts as "one with a listed" where the straight way to a
listed frame, in logarithms of the stiffnesses, changes the frequencies by less than one standard deviation in all: no data of this
error tell them apart.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "identification"))

from frame_solutions import all_frames, frame_frequencies, frame_setup

from structid.identification.identify import identify_together


def nearest(sets: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """The set that is nearest to `values`, and its largest relative difference from them."""
    distance = np.abs(np.log(sets / values)).max(axis=1)
    return sets[distance.argmin()], float(distance.min())


def misfit_between(masses: np.ndarray, first: np.ndarray, second: np.ndarray, error: float) -> float:
    """Largest change of the frequencies, in standard deviations, on the way between two frames of the same frequencies."""
    frequency = frame_frequencies(masses, first)
    way = [frame_frequencies(masses, first * (second / first) ** part) for part in np.linspace(0.0, 1.0, 41)]
    return max(float(np.linalg.norm(np.log(found / frequency))) for found in way) / error


def main() -> int:
    """Print a line for each number of storeys; 1 where a frame was missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=28)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--error", type=float, default=1e-5)
    given = parser.parse_args()
    print("storeys  frames  exact  listed  one with a listed  not listed  searches  processor s (median, most)")
    missed = 0
    for storeys in (3, 4):
        exact, listed, same, lost, searches, seconds = 0, 0, 0, 0, 0, []
        count = (given.repeats + 1) // 2
        for seed in range(given.seed, given.seed + count):
            rng = np.random.default_rng([seed, storeys])
            masses = rng.uniform(200.0, 800.0, storeys)
            frequency = frame_frequencies(masses, 2.5e5 * np.exp(rng.uniform(-0.7, 0.7, storeys)))
            begun = time.process_time()
            found = identify_together([frame_setup(masses, frequency, error=given.error)])
            seconds.append(time.process_time() - begun)
            sets = found.estimate.values[None] if found.alternatives is None else found.alternatives.values
            truths = all_frames(masses, frequency, 500)
            exact, listed, searches = exact + len(truths), listed + len(sets), searches + found.estimate.search.n_starts
            for truth in truths:
                closest, distance = nearest(sets, truth)
                is_same = misfit_between(masses, truth, closest, given.error) < 1
                same += distance > 1e-4 and is_same
                lost += distance > 1e-4 and not is_same
        print(
            f"{storeys:7d} {count:7d} {exact:6d} {listed:7d} {same:18d} {lost:11d} {searches:9d}"
            f"  {np.median(seconds):.2f}, {max(seconds):.2f}"
        )
        missed += lost
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
