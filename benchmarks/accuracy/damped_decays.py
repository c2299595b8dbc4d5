"""Free decays of high damping: modes found, and coverage of 95 % intervals.

Five modes of 8 to 15 % damping at six points and 50 Hz, in white noise; a long record is noise from a fifth of it on.
Every seed counts; a mode is found where one lies within 4 % of its frequency.

    python benchmarks/accuracy/damped_decays.py [--repeats 25] [--seed 0]
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

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "modal"))
from modal_cases import HEAVY_DAMPING, HEAVY_FREQUENCY, damped_decay

#: Words, settings of `damped_decay`.
CASES = (
    ("20 s, 5 % noise", {}),
    ("60 s, 5 % noise", {"duration": 60.0}),
    ("3 s, 5 % noise", {"duration": 3.0}),
    ("20 s, 1 % noise", {"noise": 0.01}),
    ("20 s, 15 % noise", {"noise": 0.15}),
    ("60 s, 1 % damping", {"duration": 60.0, "damping": np.full(5, 0.01)}),
    ("60 s, 0.5 to 15 % damping", {"duration": 60.0, "damping": np.array([0.005, 0.12, 0.15, 0.1, 0.08])}),
)


def main() -> None:
    """One row a case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    for words, settings in CASES:
        damping = settings.get("damping", HEAVY_DAMPING)
        inside, missing, more, told, start = [], 0, 0, 0, time.perf_counter()
        for seed in range(chosen.seed, chosen.seed + chosen.repeats):
            modes = identify_modes(damped_decay(seed, **settings)[0])
            near = np.abs(modes.frequency[:, None] - HEAVY_FREQUENCY).argmin(axis=0)
            found = np.abs(modes.frequency[near] / HEAVY_FREQUENCY - 1) < 0.04
            missing, more = missing + int((~found).sum()), more + modes.n_modes - int(found.sum())
            told += not found.all() and any("modes may be missing" in note for note in modes.warnings)
            errors = modes.frequency[near] - HEAVY_FREQUENCY, modes.damping_ratio[near] - damping
            std = modes.frequency_std[near], modes.std[modes.n_modes :][near]
            inside.append([(np.abs(e) <= 1.96 * d)[found].tolist() for e, d in zip(errors, std, strict=True)])
        parts = [100 * np.mean([one for row in inside for one in row[k]]) for k in (0, 1)]
        each = (time.perf_counter() - start) / chosen.repeats
        print(
            f"{words:26s} frequency {parts[0]:5.1f} %  damping {parts[1]:5.1f} %  modes missing {missing} of "
            f"{5 * chosen.repeats}, too many {more}; records with missing modes that say so {told}, {each:.2f} s each",
            flush=True,
        )


if __name__ == "__main__":
    main()
