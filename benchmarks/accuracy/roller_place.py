"""Where a roller holds a beam, from its first two frequencies: exact without noise, and is the interval right?

A cantilever of 2 m over a roller 1.37 m from the clamp; the search begins at 1 m. Both frequencies have errors of 0.1 %. With
--moves the roller is moved in six steps of 10 mm from 1.35 m on and measured at each position: are the positions distinct?

    python benchmarks/accuracy/roller_place.py [--repeats 400] [--moves 40]
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


def frequencies(place: float) -> FloatArray:
    """The first two frequencies with the roller at `place` (m), without errors, Hz."""
    drawn = beam(place)
    return modes(drawn.matrix("mass"), drawn.matrix("stiffness"), n_modes=2).frequency


def print_moves(repeats: int) -> None:
    """Print the positions of a roller that is moved in steps of 10 mm, and how the steps come out over repeats."""
    positions = 1.35 + 0.01 * np.arange(6)
    clean, steps, z = [frequencies(position) for position in positions], [], []
    for seed in range(repeats):
        rng = np.random.default_rng([7, seed])
        estimates = [estimate(problem(pair * (1 + ERROR * rng.standard_normal(2)))) for pair in clean]
        values, std = (np.array([getattr(e, name)[0] for e in estimates]) for name in ("values", "std"))
        if seed == 0:
            for position, value, error in zip(positions, values, std, strict=True):
                print(f"true {position:.3f} m: {value:.4f} \u00b1 {error:.4f} m")
        steps.append(np.diff(values))
        z += ((values - positions) / std).tolist()
    print(
        f"steps of 10 mm: {1e3 * np.mean(steps):.2f} mm, scatter {1e3 * np.std(steps):.2f} mm, in order"
        f" {100 * np.mean(np.array(steps) > 0):.1f} %; z rms {np.sqrt(np.mean(np.square(z))):.2f},"
        f" 95 % interval holds {100 * np.mean(np.abs(z) <= 1.96):.1f} % of {len(z)}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=400)
    parser.add_argument("--moves", type=int, default=0, help="repeats of six positions instead")
    chosen, begun = parser.parse_args(), time.perf_counter()
    repeats = chosen.repeats
    if chosen.moves:
        print_moves(chosen.moves)
        return 0
    clean = frequencies(TRUTH)
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
