"""Where a roller holds a beam, from its first two frequencies: exact without noise, and is the interval right?

A cantilever of 2 m over a roller 1.37 m from the clamp; the search begins at 1 m. Both frequencies have errors of 0.1 %.

    python benchmarks/accuracy/roller_place.py [--repeats 400]
"""

from __future__ import annotations

import argparse
import os
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from structid import Beam, ModalProblem, ModalRecord, ModalSettings, Structure, Unknown, estimate, parameters
from structid.core.arrays import FloatArray
from structid.dynamics.normal_modes import modes

TRUTH, START, ERROR = 1.37, 1.0, 1e-3


def beam(place: float) -> Structure:
    strip = Beam("strip", [[1, 2], [2, 3]], 1.2, 150.0)
    return Structure({1: 0.0, 2: place, 3: 2.0}, [strip], ["1Y", "1RZ", "2Y"], subdivide=8, sliding=[2])


def problem(frequency: FloatArray) -> ModalProblem:
    structure = beam(START)
    record = ModalRecord(frequency, np.zeros(2), np.ones((1, 2)), ["3Y"])
    unknown = parameters(structure, [Unknown("position", "node 2")])
    return ModalProblem(
        structure, unknown, record, ModalSettings(frequency_error=ERROR, shape_error=1e3)
    )  # shapes have no say


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=400)
    repeats, begun = parser.parse_args().repeats, time.perf_counter()
    drawn = beam(TRUTH)
    clean = modes(drawn.matrix("mass"), drawn.matrix("stiffness"), n_modes=2).frequency
    exact = abs(float(estimate(problem(clean)).values[0]) - TRUTH)
    print(f"without noise off by {exact:.1e} m")
    errors = []
    for seed in range(repeats):
        noise = np.random.default_rng(seed).standard_normal(2)
        found = estimate(problem(clean * (1 + ERROR * noise)))
        errors.append((found.values[0] - TRUTH) / found.std[0])
    held, rms = 100 * np.mean(np.abs(errors) < 1.959964), np.sqrt(np.mean(np.square(errors)))
    print(
        f"std {1e3 * found.std[0]:.3g} mm, rms error {rms:.3f} of it, 95 % interval holds {held:.1f} %; {repeats} repeats,"
        f" {time.perf_counter() - begun:.0f} s"
    )
    return 0 if exact < 1e-6 and 93 <= held <= 97 else 1


if __name__ == "__main__":
    sys.exit(main())
