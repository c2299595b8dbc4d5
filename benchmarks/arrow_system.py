"""One step of chapter 4 with two sensors: the dense arrow system of Eq. (4.24) against the form that eliminates it.

Six-element cantilever, 12 parameters, deflections of nodes 3 and 6, m frequencies of 0.01 to 6 Hz, one thread:
``python benchmarks/arrow_system.py``.
The arrow system is the one of the tests; every figure is the least of a few runs, in processor time.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.forward.frf.response import response

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "published"))
from arrow_system import ArrowSystem

COUNTS = (12, 24, 48, 96, 192)
LONG_COUNTS = (192, 768, 3072, 12288)
MASS, STIFFNESS = [0.86, 1.01, 1.13, 0.44, 0.98, 0.90], [1.00, 0.71, 1.17, 0.54, 1.08, 0.90]


def main() -> None:
    """Print the times and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", type=int, help="the first so many numbers of frequencies of each table only")
    chosen = parser.parse_args()
    print("      m   arrow system   eliminated form    ratio   largest difference of the steps")
    for m in COUNTS[: chosen.counts]:
        case = measured(m)
        arrow_time, arrow = least(partial(whole, *case), 2)
        short_time, short = least(partial(eliminated, *case), 5)
        difference = np.abs(arrow - short).max() / np.abs(arrow).max()
        print(f"{m:7d}   {arrow_time:10.4f} s   {short_time:13.4f} s {arrow_time / short_time:8.1f}   {difference:.1e}")
    print("\n      m   eliminated form   per frequency")
    for m in LONG_COUNTS[: chosen.counts]:
        taken, _ = least(partial(eliminated, *measured(m)), 3)
        print(f"{m:7d}   {taken:13.4f} s   {1e3 * taken / m:10.3f} ms")


def measured(m: int) -> tuple[sid.Structure, sid.Parameters, sid.FrfRecord]:
    """The postulated cantilever, its unknowns, and what the tip of the actual one does at m frequencies."""
    unknowns = [sid.Unknown(p, "beam", each=True, positive=False) for p in ("mass", "bending_stiffness")]
    postulated, actual = cantilever(1.0), cantilever(1.05)
    frequency = np.linspace(0.01, 6.0, m)
    record = sid.FrfRecord(frequency, np.ones((m, 2, 1)), ("3Y+", "6Y+"), ("6Y+",), "receptance")
    known = sid.parameters(actual, unknowns)
    values = response(actual, known, record).values_at(known.start)
    return postulated, sid.parameters(postulated, unknowns), replace(record, values=values)


def cantilever(factor: float) -> sid.Structure:
    """Case 2 of Table 4.1, postulated, with its stiffnesses times `factor` along the beam."""
    stiffness = np.array(STIFFNESS) * np.linspace(1.0, factor, 6)
    beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], MASS, stiffness)
    return sid.Structure({i: float(i) for i in range(7)}, [beam], ["0Y", "0RZ"])


def whole(structure: sid.Structure, unknown: sid.Parameters, record: sid.FrfRecord) -> np.ndarray:
    """The step of the arrow system."""
    return ArrowSystem(structure, unknown, record).step()


def eliminated(structure: sid.Structure, unknown: sid.Parameters, record: sid.FrfRecord) -> np.ndarray:
    """The step of the eliminated form."""
    problem = sid.FrfProblem(structure, unknown, record, "equation")
    at = problem.linearize(problem.theta_start)
    return -np.linalg.lstsq(at.jacobian, at.residual, rcond=None)[0]


def least(run: Callable[[], np.ndarray], times: int) -> tuple[float, np.ndarray]:
    """Least processor time of `times` runs, and the result."""
    taken = []
    for _ in range(times):
        start = time.process_time()
        result = run()
        taken.append(time.process_time() - start)
    return min(taken), result


if __name__ == "__main__":
    main()
