"""Time to write and read a big matrix in every format of the importers, beside the time that NPZ needs.

``python benchmarks/matrix_files.py --entries 1000000``: the stiffness of a cube of springs, three degrees of freedom a node,
with about that many entries in both triangles. Every figure is the least of `--repeats` runs, in processor time; `digits` is
how many decimal digits of the entries came back at least (17: all).
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import sparse

from structid.fem.importers import (
    ElementEntries,
    ImportedMatrix,
    Op4Options,
    on_dofs,
    read_matrix,
    write_abaqus,
    write_dmig,
    write_matrix,
    write_op4,
)


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--entries", type=int, default=1_000_000)
    options.add_argument("--repeats", type=int, default=1)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    item = lattice(given.entries, given.seed)
    n, nnz = item.matrix.shape[0], item.matrix.nnz
    print(f"{n} degrees of freedom, {nnz} entries, {len(item.elements.element)} of elements; seed {given.seed}")
    print(f"{'file':28s} {'MB':>7s} {'write s':>8s} {'read s':>8s} {'x NPZ':>7s} {'s per 1e6':>10s} {'digits':>7s}")
    with tempfile.TemporaryDirectory() as folder:
        base = None
        for name, suffix, write in writers(item):
            path = Path(folder) / f"a{suffix}"
            written, _ = least(lambda p=path, w=write: w(p), given.repeats)
            taken, back = least(lambda p=path: read_matrix(p), given.repeats)
            base = taken if base is None else base
            size, per = path.stat().st_size / 1e6, taken / nnz * 1e6
            print(
                f"{name:28s} {size:7.1f} {written:8.2f} {taken:8.2f} {taken / base:7.1f} {per:10.2f}"
                f" {digits(back, item):7d}"
            )


def lattice(entries: int, seed: int) -> ImportedMatrix:
    """Springs along the edges and diagonals of a cubic lattice, of random stiffness, as an element-by-element matrix."""
    side = max(2, round((entries / 9 / 25) ** (1 / 3)))
    rng = np.random.default_rng(seed)
    place = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    rows, columns, values, labels, count = [], [], [], [], 0
    for step in np.argwhere(np.ones((3, 3, 3))) - 1:
        if tuple(step) <= (0, 0, 0) or abs(step).sum() > 2 + (step[0] > 0):
            continue
        ends = place + step
        inside = ((ends >= 0) & (ends < side)).all(axis=1)
        first = np.flatnonzero(inside)
        second = ends[inside] @ np.array([side**2, side, 1])
        axis = step / np.linalg.norm(step)
        block = np.kron([[1, -1], [-1, 1]], np.outer(axis, axis) + 0.1)
        local = rng.uniform(0.5, 2.0, len(first))[:, None, None] * block * 1e7
        dofs = np.concatenate([3 * first[:, None] + np.arange(3), 3 * second[:, None] + np.arange(3)], axis=1)
        rows.append(np.repeat(dofs, 6, axis=1).ravel())
        columns.append(np.tile(dofs, (1, 6)).ravel())
        values.append(local.ravel())
        labels.append(np.repeat(count + 1 + np.arange(len(first)), 36))
        count += len(first)
    parts = ElementEntries(*(np.concatenate(part) for part in (labels, rows, columns, values)))
    n = 3 * side**3
    total = sparse.coo_array((parts.value, (parts.row, parts.column)), (n, n)).tocsc()
    total = sparse.tril(total) + sparse.tril(total, -1).T  # sums of round-off are made equal on both sides
    table = np.stack([1 + np.arange(n) // 3, 1 + np.arange(n) % 3], axis=1)
    return ImportedMatrix("KAA", total.tocsc(), table, elements=parts)


def writers(item: ImportedMatrix) -> list[tuple[str, str, Callable[[Path], None]]]:
    """Name, suffix and writer of every format; NPZ first, to compare with."""
    made: list[tuple[str, str, Callable[[Path], None]]] = [
        ("NPZ", ".npz", lambda p: write_matrix(p, item)),
        ("MatrixMarket", ".mtx", lambda p: write_matrix(p, item)),
    ]
    for binary in (True, False):
        for layout in ("bigmat", "sparse") if item.matrix.shape[0] <= 65535 else ("bigmat",):
            options = Op4Options(binary, layout)
            name = f"OP4 {'binary' if binary else 'ASCII'} {layout}"
            made.append((name, ".op4", lambda p, o=options: write_op4(p, [item], o)))
    for field in ("large", "small", "free"):
        made.append((f"DMIG {field} field", ".pch", lambda p, f=field: write_dmig(p, [item], f)))
    for form in ("labels", "coordinate", "elements"):
        made.append((f"Abaqus {form}", ".mtx", lambda p, f=form: write_abaqus(p, item, f)))
    return made


def least(task: Callable[[], object], repeats: int) -> tuple[float, object]:
    """The least processor time of some runs, and what the last gave."""
    best, answer = np.inf, None
    for _ in range(repeats):
        start = time.process_time()
        answer = task()
        best = min(best, time.process_time() - start)
    return best, answer


def digits(back: ImportedMatrix, item: ImportedMatrix) -> int:
    """Decimal digits that all entries have kept; 17 where they are equal. Sums over elements are rounded again."""
    assert item.dofs is not None
    got = back.matrix if back.dofs is None else on_dofs(back, item.dofs)
    difference = sparse.coo_array(got - item.matrix)
    difference.eliminate_zeros()
    if not difference.nnz:
        return 17
    true = np.abs(np.asarray(item.matrix.tocsr()[difference.row, difference.col])).ravel()
    return int(-np.log10((np.abs(difference.data) / np.maximum(true, np.finfo(float).tiny)).max()))


if __name__ == "__main__":
    main()
