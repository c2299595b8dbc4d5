"""The streaming pass of this source tree beside that of another one, in turn and on the same numbers.

``python benchmarks/time_domain_beside.py ../other/src`` prints for every case the time of both a sample and degree of
freedom, their ratio in each of ``--repeats`` pairs, how far each is from NumPy's QR, and the memory that each needs
beyond the fields. Each side is a process of its own; while one works the other waits. One thread is processor time, two
are wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

#: Name, rows of `time_domain_cases` with their argument, samples, and how smooth the motion is.
CASES = [
    ("chain, N = 15", ("chain_rows", 15), 100_000, "random"),
    ("chain, N = 1000", ("chain_rows", 1000), 2000, "random"),
    ("chain, N = 10000", ("chain_rows", 10_000), 400, "random"),
    ("chain, N = 1000, exact force", ("chain_rows", 1000), 2000, "exact"),
    ("chain, N = 1000, smooth motion", ("chain_rows", 1000), 2000, "smooth"),
    ("quadrilaterals", ("mesh_rows", (32, 32)), 1000, "random"),
    ("quadrilaterals, smooth motion", ("mesh_rows", (32, 32)), 1000, "smooth"),
    ("hexahedra", ("mesh_rows", (6, 11, 13)), 600, "random"),
    ("hexahedra, smooth motion", ("mesh_rows", (6, 11, 13)), 600, "smooth"),
]

SIDE = """
import json, resource, sys, time
import numpy as np
import time_domain_cases as cases
from structid.inversion.regression import no_rows
from structid.inversion.regression.local_reduction import FoldingKernels, row_maker
(name, size), n_times, motion, threads = json.loads(sys.argv[1])
columns, operator, n_params = getattr(cases, name)(tuple(size) if isinstance(size, list) else size)
rng = np.random.default_rng(0)
if motion == "smooth":
    shapes = np.cumsum(np.cumsum(rng.standard_normal((operator.shape[1], 12)), axis=0), axis=0)
    fields = shapes / np.abs(shapes).max(axis=0) @ rng.standard_normal((12, n_times))
    fields += 1e-6 * rng.standard_normal(fields.shape)
else:
    fields = rng.standard_normal((operator.shape[1], n_times))
if motion == "exact":
    rows = (operator[:, : -len(columns)] @ fields[: -len(columns)]).reshape(len(columns), -1, n_times)
    fields[-len(columns) :] = rows.sum(axis=1)
work, start, maker = FoldingKernels("numba", threads), no_rows(columns, n_params), row_maker(operator, columns)
clock = time.thread_time if threads == 1 else time.perf_counter
few = np.ascontiguousarray(fields[:, : min(n_times, 300)])
ours, plain = (start.reduced(maker, few, FoldingKernels(kind)).triangles for kind in ("numba", "numpy"))
norms = np.linalg.norm(plain, axis=1, keepdims=True)
error = float(np.abs((np.abs(ours) - np.abs(plain)) / np.where(norms > 0, norms, 1.0)).max())
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start.reduced(maker, fields, work)
memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 / fields.nbytes
print(json.dumps([error, memory, len(columns) * n_times]), flush=True)
for _ in sys.stdin:
    begun = clock()
    start.reduced(maker, fields, work)
    print(clock() - begun, flush=True)
"""


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("other", type=Path, help="the other tree's src")
    options.add_argument("--repeats", type=int, default=5)
    options.add_argument("--only", default="", help="part of the names of the cases wanted")
    chosen = options.parse_args()
    print(f"{'ns a sample and degree of freedom, medians':48s} {'this':>7s} {'other':>7s}   ratios of pairs")
    for name, rows, n_times, motion in CASES:
        for threads in (1, 2):
            if chosen.only in name:
                compare(f"{name}, {threads} thread{'s' * (threads > 1)}", (rows, n_times, motion, threads), chosen)


def compare(name: str, case: tuple, chosen: argparse.Namespace) -> None:
    """One row of the table."""
    sides = [started(path, case) for path in (Path(__file__).parents[1] / "src", chosen.other)]
    told = [json.loads(side.stdout.readline()) for side in sides]
    times = [[answer(side) for side in sides] for _ in range(chosen.repeats + 1)][1:]
    for side in sides:
        side.communicate()
    ratios = sorted(ours / other for ours, other in times)
    ours, other = (statistics.median(t) / told[0][2] * 1e9 for t in zip(*times, strict=True))
    print(
        f"{name:48s} {ours:7.2f} {other:7.2f}   {statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f});"
        f" from QR {told[0][0]:.0e}, {told[1][0]:.0e}; memory {told[0][1]:.3f}, {told[1][1]:.3f} of the fields",
        flush=True,
    )


def started(source: Path, case: tuple) -> subprocess.Popen:
    """A side, ready to be asked."""
    paths = os.pathsep.join([str(source.resolve()), str(Path(__file__).parent.resolve())])
    environment = {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", SIDE, json.dumps(case)]
    return subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def answer(side: subprocess.Popen) -> float:
    """Time of one pass."""
    side.stdin.write("\n")
    side.stdin.flush()
    return float(side.stdout.readline())


if __name__ == "__main__":
    main()
