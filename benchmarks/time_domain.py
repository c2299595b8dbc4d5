"""The streaming pass over measured motion against its floors and against the textbook, both sides in one run.

``python benchmarks/time_domain.py`` prints the ratios beside their bars; ``--json FILE`` keeps them. One-thread figures
are processor time of the thread, medians of ``--repeats`` pairs taken side by side; the two-thread figure is wall time.
Meshes: bilinear quadrilaterals and trilinear bricks, mass, damping (of the stiffness's pattern) and stiffness of every
element unknown.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import sparse

from structid.inversion.regression import no_rows
from structid.inversion.regression.block_least_squares import block_solution
from structid.inversion.regression.local_reduction import FoldingKernels, row_maker
from time_domain_cases import PASS_IN_A_PROCESS, chain_rows, dense_rows, mesh_rows

ONE, TWO, NUMPY = FoldingKernels("numba"), FoldingKernels("numba", 2), FoldingKernels("numpy")
Rows = tuple[np.ndarray, sparse.csr_array, int]


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--repeats", type=int, default=5)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--quick", action="store_true", help="smaller and fewer; the bars still hold")
    options.add_argument("--json", type=Path)
    options.add_argument("--only", default="", help="parts of names of the measurements wanted, with commas")
    chosen = options.parse_args()
    print(f"{'what':64s} {'reached':>10s} {'bar':>8s}", flush=True)
    results = []
    for row in measured(chosen.quick, chosen.repeats, chosen.seed, chosen.only):
        met = "met" if row["met"] else "MISSED"
        print(f"{row['what']:64s} {row['figure']:10.3g} {row['bar']:>8s}   {met}, {row['detail']}", flush=True)
        results.append(row)
    if chosen.json:
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        chosen.json.write_text(json.dumps({"results": results, "load": load, "cores": os.cpu_count()}, indent=1))


def rows(quick: bool) -> list[dict]:
    """Every measurement as what, bar, figure, met and detail: medians of five, of three of fewer cases if `quick`."""
    return list(measured(quick, 3 if quick else 5))


def measured(quick: bool, repeats: int = 5, seed: int = 0, only: str = "") -> Iterator[dict]:
    """The rows of the table, one after another."""
    for name, measure, bar, least, short in MEASUREMENTS:
        if (quick and not short) or not any(part in name for part in only.split(",")):
            continue
        figures = [float(figure) for figure in measure(repeats, np.random.default_rng(seed))]
        value = statistics.median(figures)
        yield {
            "what": name,
            "bar": f"{'>=' if least else '<='} {bar:g}",
            "figure": value,
            "met": bool(value >= bar if least else value <= bar),
            "detail": f"median of {len(figures)}, {min(figures):.3g} to {max(figures):.3g}",
        }


def ratios(
    top: Callable[[], object], bottom: Callable[[], object], repeats: int, clock: Callable[[], float] = time.thread_time
) -> list[float]:
    """Time of `top` over that of `bottom`, one after the other, after one run of each that does not count."""
    top(), bottom()
    found = []
    for _ in range(repeats):
        begun = clock()
        top()
        between = clock()
        bottom()
        found.append((between - begun) / (clock() - between))
    return found


#: Runs of what takes a fraction of a millisecond, so that the clock and the caches of the other side do not count.
TIMES = 20


def read_once(columns: np.ndarray, operator: sparse.csr_array, fields: np.ndarray) -> Callable[[], object]:
    """numpy.sum of the same four arrays."""
    arrays = np.split(fields, 4)
    return lambda: [a.sum() for a in arrays]


def multiplied(
    columns: np.ndarray, operator: sparse.csr_array, fields: np.ndarray, side: int = 512
) -> Callable[[], object]:
    """numpy.matmul of square matrices with as many multiplications as making the rows and their products takes."""
    widths, square = (columns >= 0).sum(axis=1) + 1, np.random.default_rng(0).standard_normal((side, side))
    multiplications = fields.shape[1] * (operator.nnz + (widths * (widths + 1) / 2).sum())
    return lambda: [square @ square for _ in range(round(multiplications / side**3))]


def streaming(
    rows: Callable[[], Rows],
    n_times: int,
    work: FoldingKernels,
    clock: Callable[[], float] = time.thread_time,
    floor: Callable[..., Callable[[], object]] = read_once,
):
    """The pass against a floor of the same fields."""

    def measure(repeats: int, rng: np.random.Generator) -> list[float]:
        columns, operator, n_params = rows()
        fields = rng.standard_normal((operator.shape[1], n_times))
        empty, maker = no_rows(columns, n_params), row_maker(operator, columns)
        below = floor(columns, operator, fields)
        return ratios(lambda: empty.reduced(maker, fields, work), below, repeats, clock)

    return measure


def against_dense(n: int, n_times: int):
    """numpy.linalg.lstsq of the dense regression, already made, against pass and solution together."""

    def measure(repeats: int, rng: np.random.Generator) -> list[float]:
        columns, operator, n_params = chain_rows(n)
        fields = rng.standard_normal((operator.shape[1], n_times))
        dense, right = dense_rows(columns, operator, n_params, fields)
        maker = row_maker(operator, columns)

        def ours() -> np.ndarray:
            for _ in range(TIMES):
                found = block_solution(no_rows(columns, n_params).reduced(maker, fields, ONE)).values
            return found

        expected = np.linalg.lstsq(dense, right, rcond=None)[0]
        if not np.allclose(ours(), expected, rtol=1e-8):
            raise SystemExit("ours is not the solution of numpy.linalg.lstsq")
        pairs = ratios(lambda: np.linalg.lstsq(dense, right, rcond=None), ours, repeats)
        return [TIMES * ratio for ratio in pairs]

    return measure


def merged_parts(repeats: int, rng: np.random.Generator) -> list[float]:
    """Largest relative difference of two merged halves from one pass."""
    columns, operator, n_params = chain_rows(200)
    found = []
    for _ in range(repeats):
        fields = rng.standard_normal((operator.shape[1], 1000))
        start, cut = no_rows(columns, n_params), int(rng.integers(100, 900))
        whole = block_solution(start.reduced(operator, fields, ONE)).values
        parts = [start.reduced(operator, part, ONE) for part in (fields[:, cut:], fields[:, :cut])]
        found.append(float(np.abs(block_solution(parts[0].merged(parts[1])).values / whole - 1).max()))
    return found


def memory(n: int, n_times: int):
    """Largest growth of resident memory in a pass over a record on disk, in parts of the record."""

    def measure(repeats: int, rng: np.random.Generator) -> list[float]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "record.npy"
            values = np.lib.format.open_memmap(path, "w+", np.float64, (n_times, 8 * n))
            for first in range(0, n_times, 200):
                values[first : first + 200] = rng.standard_normal((min(200, n_times - first), 8 * n))
            values.flush()
            del values
            command = [sys.executable, "-c", PASS_IN_A_PROCESS, str(n), str(path)]
            size = path.stat().st_size
            runs = [subprocess.run(command, capture_output=True, text=True, check=True) for _ in range(repeats)]
            return [int(done.stdout) / size for done in runs]

    return measure


def compiled_against_numpy(repeats: int, rng: np.random.Generator) -> list[float]:
    """NumPy's time over that of the compiled kernels, for the same pass."""
    columns, operator, n_params = chain_rows(1000)
    fields = rng.standard_normal((operator.shape[1], 1000))
    empty, maker = no_rows(columns, n_params), row_maker(operator, columns)
    return ratios(lambda: empty.reduced(maker, fields, NUMPY), lambda: empty.reduced(maker, fields, ONE), repeats)


#: Bars of the quadrilateral, of the products of hexahedra and of the dense regression are those of the kernels in plain
#: numba, which take 1.05 to 1.2 times the hand-written LLVM that they replaced; the dense one depends on LAPACK besides.
#: Name, measurement, bar, whether the bar is a least value, whether it is for the quick table too.
MEASUREMENTS = [
    (
        "chain pass / numpy.sum, N = 15, m = 100000, 96 MB",
        streaming(lambda: chain_rows(15), 100_000, ONE),
        5,
        False,
        True,
    ),
    (
        "chain pass / numpy.sum, N = 1000, m = 2000, 128 MB",
        streaming(lambda: chain_rows(1000), 2000, ONE),
        5,
        False,
        True,
    ),
    (
        "chain pass / numpy.sum, N = 10000, m = 400, 256 MB",
        streaming(lambda: chain_rows(10_000), 400, ONE),
        5,
        False,
        False,
    ),
    (
        "chain pass, two threads, wall / numpy.sum, N = 1000, m = 2000",
        streaming(lambda: chain_rows(1000), 2000, TWO, time.perf_counter),
        3.2,
        False,
        True,
    ),
    (
        "quad mesh pass / numpy.sum, 2178 DOFs, m = 1000",
        streaming(lambda: mesh_rows((32, 32)), 1000, ONE),
        14,
        False,
        True,
    ),
    (
        "hex mesh pass / numpy.sum, 3528 DOFs, m = 600",
        streaming(lambda: mesh_rows((6, 11, 13)), 600, ONE),
        35,
        False,
        True,
    ),
    (
        "hex mesh pass / numpy.matmul of as many products",
        streaming(lambda: mesh_rows((6, 11, 13)), 600, ONE, floor=multiplied),
        2.5,
        False,
        True,
    ),
    ("dense lstsq / ours, N = 15, m = 1000", against_dense(15, 1000), 20, True, True),
    ("dense lstsq / ours, N = 100, m = 500", against_dense(100, 500), 1000, True, False),
    ("memory beyond the record / record, N = 1000, m = 2000", memory(1000, 2000), 0.1, False, True),
    ("memory beyond the record / record, N = 5000, m = 1000", memory(5000, 1000), 0.1, False, False),
    ("two merged parts / one pass - 1", merged_parts, 1e-12, False, True),
    ("NumPy / compiled, same pass, N = 1000, m = 1000", compiled_against_numpy, 1, True, False),
]


if __name__ == "__main__":
    main()
