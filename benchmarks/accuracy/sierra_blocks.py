"""A real model of another code taken apart: its stiffness against elements of our own, and its two blocks found from modes.

``python benchmarks/accuracy/sierra_blocks.py``: two aluminium blocks of 720 cubes by Sierra/SD, 3390 degrees of freedom, of
which the file has the assembled matrices only (data beside the project, GPL). The first table compares the stored stiffness with
cubes of several formulations, and with the one symmetric 24 x 24 matrix that fits all its entries best. Then the stiffness
factors of both blocks and the mass factor of one, the mass of the other being known, are found from simulated modes at
`--corners` places with noise; every run is counted.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import norm

import structid as sid
from structid.core.dof import parse_dofs
from structid.dynamics.normal_modes import modes
from structid.fem.importers import dofs_of, total_mass

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "fem" / "importers"))
from matrix_cases import FORMULATIONS, SIERRA, block, cube, sierra

TRUTH = {"stiffness[block 1]": 0.9, "stiffness[block 2]": 1.15, "mass[block 2]": 1.05}
PLACES = ((0.55, 0.05, 0.05), (0.06, -0.25, 0.05), (0.06, 0.25, -0.05), (0.3, -0.05, 0.05))


def main() -> None:
    """Print both tables."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--repeats", type=int, default=1)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--corners", type=int, default=2, choices=range(1, 5))
    given = options.parse_args()
    if not SIERRA.exists():
        sys.exit(f"{SIERRA} is not there; put the Sierra/SD matrices beside the project")
    stiffness, mass, table, mesh = sierra()
    compared(stiffness, mass, table, mesh)
    identified(table, mesh, given.repeats, given.seed, given.corners)


def compared(
    stiffness: sparse.csc_array, mass: sparse.csc_array, table: np.ndarray, mesh: dict[str, np.ndarray]
) -> None:
    """The stored matrices against modes of the other solver and elements of our own."""
    reference = mesh["reference_freq_hz"][6:]
    found = modes(mass, stiffness, n_modes=50).frequency[6:]
    print(f"total mass {total_mass(mass, dofs_of(table)):.4f} kg, stated 30.4237 kg")
    print(
        f"44 elastic modes against the solver's own: largest relative difference {abs(found / reference - 1).max():.1e}"
    )
    print(f"\n{'cubes with':30s} {'norm of the difference':>23s} {'largest entry of it':>20s} {'44 frequencies':>15s}")
    for name in FORMULATIONS:
        ours = sum(block(mesh, part, name)[0] for part in ("hex_block1", "hex_block2"))
        difference = sparse.csc_array(ours - stiffness)
        error = abs(modes(mass, ours, n_modes=50).frequency[6:] / reference - 1).max()
        largest = abs(difference).max() / abs(stiffness).max()
        print(f"{name:30s} {norm(difference) / norm(stiffness):23.1e} {largest:20.1e} {error:15.1e}")
    residual, element = common_cube(stiffness, mesh)
    ours = cube(0.025)[0]
    print(f"one matrix fitted to all entries: residual {residual:.1e} of the norm;", end=" ")
    print(
        f"it differs from the cube with incompatible modes by {np.linalg.norm(element - ours) / np.linalg.norm(ours):.1e}"
    )


def common_cube(stiffness: sparse.csc_array, mesh: dict[str, np.ndarray]) -> tuple[float, np.ndarray]:
    """The symmetric (24, 24) matrix whose sum over all cubes is nearest to `stiffness`, and what is left."""
    upper = np.triu_indices(24)
    place = np.zeros((24, 24), dtype=np.int64)
    place[upper] = place.T[upper] = np.arange(len(upper[0]))
    dofs = np.concatenate([block(mesh, part)[3] for part in ("hex_block1", "hex_block2")])
    n = np.int64(stiffness.shape[0])
    keys = (np.repeat(dofs, 24, axis=1) * n + np.tile(dofs, (1, 24))).ravel()
    entries, equation = np.unique(keys, return_inverse=True)
    unknown = np.tile(place.ravel(), len(dofs))
    sums = sparse.coo_array((np.ones(len(keys)), (equation, unknown)), (len(entries), len(upper[0]))).tocsr()
    target = np.asarray(stiffness[entries // n, entries % n]).ravel()
    best = np.linalg.solve((sums.T @ sums).toarray(), sums.T @ target)
    return float(np.linalg.norm(sums @ best - target) / np.linalg.norm(target)), best[place]


def identified(table: np.ndarray, mesh: dict[str, np.ndarray], repeats: int, seed: int, corners: int) -> None:
    """Factors of both blocks from simulated modes, run by run."""
    blocks = [block(mesh, part) for part in ("hex_block1", "hex_block2")]
    groups = {f"block {i}": {"stiffness": b[0], "mass": b[1]} for i, b in enumerate(blocks, 1)}
    structure = sid.from_matrices(groups, dofs_of(table), dict(enumerate(mesh["xyz_m"], 1)))
    unknowns = [sid.Unknown(*name.rstrip("]").split("[")) for name in TRUTH]
    unknown = sid.parameters(structure, [*unknowns, sid.Unknown("mass", "block 1", fixed=True)])
    truth = np.array(list(TRUTH.values()))
    values = unknown.values(truth)
    exact = modes(structure.matrix("mass", values), structure.matrix("stiffness", values), n_modes=14)
    nodes = [int(np.argmin(np.linalg.norm(mesh["xyz_m"] - place, axis=1))) + 1 for place in PLACES[:corners]]
    channels = parse_dofs([f"{node}{axis}" for node in nodes for axis in "XYZ"])
    frequency = exact.frequency[6:]
    shapes = structure.selection(channels).T @ exact.mode_shapes[:, 6:]
    shapes = shapes / np.abs(shapes).max(axis=0)
    rng = np.random.default_rng(seed)
    print(f"\n8 modes at {len(channels)} sensors, 0.1 % noise on frequencies, 1 % on shapes; start 1.0; seed {seed}")
    print(f"{'run':>5s} {'status':>12s} {'s':>6s}  " + "".join(f"{name:>32s}" for name in TRUTH))
    print(f"{'true':>5s} {'':>12s} {'':>6s}  " + "".join(f"{value:32.5f}" for value in truth))
    for run in range(-1, repeats):  # the first without noise
        noise = 0.0 if run < 0 else 1.0
        drawn = (
            frequency * (1 + noise * 1e-3 * rng.standard_normal(8)),
            shapes + noise * 1e-2 * rng.standard_normal(shapes.shape),
        )
        record = sid.ModalRecord(np.sort(drawn[0]), np.full(8, np.nan), drawn[1], channels)
        start = time.perf_counter()
        answer = sid.estimate(
            sid.ModalProblem(structure, unknown, record, sid.ModalSettings(frequency_error=1e-3, shape_error=1e-2))
        )
        row = "".join(f"{v:20.6f} +- {s:8.6f}" for v, s in zip(answer.values, answer.std, strict=True))
        name = "clean" if run < 0 else str(run + 1)
        print(f"{name:>5s} {answer.status.name.lower():>12s} {time.perf_counter() - start:6.1f}  {row}", flush=True)


if __name__ == "__main__":
    main()
