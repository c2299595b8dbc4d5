"""Our hexahedra on a mesh of another code against that code's own matrices, and its two groups identified from FRFs.

The data are Sierra/SD matrices of two aluminium blocks (SDynPy documentation, `block_ac`; GPL, so not part of the package):
a folder with Kaa_lower.npz and Maa_lower.npz (scipy.sparse, lower triangles) and mesh_and_reference_modes.npz.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

import structid as sid
from structid.unknowns.tolerances import EXACT

YOUNG, POISSON, DENSITY, LOSS = 70.33e9, 0.33, 2704.327, 0.02
TRUTH = {"block1": 0.9, "block2": 1.1}


def stored(folder: Path, name: str) -> sparse.csc_array:
    """A symmetric matrix from its lower triangle."""
    lower = sparse.csc_array(sparse.load_npz(folder / name))
    return sparse.csc_array(lower + lower.T - sparse.diags_array(lower.diagonal()))


def blocks(mesh, formulation="incompatible", factors=None):
    """The two blocks as element sets, and the rows of the stored matrices that their degrees of freedom have."""
    nodes = dict(enumerate(mesh["xyz_m"], 1))
    sets = [
        sid.Solid(name, mesh[f"hex_{name}"], YOUNG * (factors or {}).get(name, 1.0), DENSITY, POISSON, LOSS,
                  formulation=formulation)
        for name in TRUTH
    ]  # fmt: skip
    structure = sid.Structure(nodes, sets)
    table = mesh["dof_of_node_xyz_zero_based"]
    return structure, np.array([table[dof.node - 1, dof.axis] for dof in structure.dofs])


def frequencies(stiffness, mass, count=14):
    """The lowest natural frequencies, Hz, six rigid ones among them."""
    shifted = eigsh(sparse.csc_matrix(stiffness), count, sparse.csc_matrix(mass), sigma=-1e5, return_eigenvectors=False)
    return np.sqrt(np.abs(np.sort(shifted))) / (2 * np.pi)


def compare(folder: Path) -> None:
    """A row for each formulation: differences of frequencies and of the matrices."""
    mesh = np.load(folder / "mesh_and_reference_modes.npz")
    stiffness, mass = stored(folder, "Kaa_lower.npz"), stored(folder, "Maa_lower.npz")
    wanted = frequencies(stiffness, mass)[6:]
    print("relative difference from the stored matrices (target 1e-3 for one formulation)")
    print("stored Hz          " + " ".join(f"{f:10.3f}" for f in wanted))
    for formulation in ("incompatible", "mean_dilatation", "full"):
        structure, rows = blocks(mesh, formulation)
        place = sparse.csc_array((np.ones(len(rows)), (rows, np.arange(len(rows)))))
        own = [place @ structure.matrix(kind) @ place.T for kind in ("stiffness", "mass")]
        found = frequencies(*own)[6:]
        print(f"{formulation:18s} " + " ".join(f"{d:10.2e}" for d in found / wanted - 1), end="  ")
        print(f"stiffness {abs(own[0] - stiffness).max() / abs(stiffness).max():.1e}", end=", ")
        print(f"mass {abs(own[1] - mass).max() / abs(mass).max():.1e}")


def identify(folder: Path, seed: int) -> None:
    """Both moduli and the loss factor from simulated accelerances at 10 sensors of an exact model."""
    mesh = np.load(folder / "mesh_and_reference_modes.npz")
    truth, _ = blocks(mesh, factors=TRUTH)
    structure, _ = blocks(mesh)
    rng = np.random.default_rng(seed)
    sensors = [
        f"{n}{d}" for n, d in zip(rng.choice(len(mesh["xyz_m"]), 10, replace=False) + 1, "XYZZZZZZXY", strict=True)
    ]
    frequency = np.linspace(450.0, 1900.0, 30)
    like = sid.FrfRecord(frequency, np.ones((30, 10, 1)), sensors, [sensors[3]], "accelerance")
    record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.02, rng)
    unknown = sid.parameters(
        structure,
        [sid.Unknown("youngs_modulus", name) for name in TRUTH] + [sid.Unknown("loss_factor", list(TRUTH), start=0.03)],
    )
    start = time.perf_counter()
    found = sid.identify(structure, unknown, record, sid.IdentifyOptions(tolerances=EXACT)).estimate
    print(f"\n10 sensors, 30 lines, 2 % noise, seed {seed}: {found.status.value}, {time.perf_counter() - start:.0f} s")
    wanted = [YOUNG * factor for factor in TRUTH.values()] + [LOSS]
    for name, value, std, true in zip(found.names, found.values, found.std, wanted, strict=True):
        print(
            f"{name:32s} {value:14.6g} +- {std:9.3g}  truth {true:12.6g}  {(value - true) / std:+.1f} standard deviations"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the three files")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--identify", action="store_true", help="identify the two groups too (some minutes)")
    given = parser.parse_args()
    compare(given.folder)
    if given.identify:
        identify(given.folder, given.seed)
