"""A plate with the modulus of every element unknown, held by smoothness alone: is a soft spot found, and at what cost?

``python benchmarks/plate_damage.py --out FOLDER`` makes mesh, record and study, runs ``structid identify`` on it and
compares the answer with the truth. 200 x 100 elements by default; ``--shape 40 20`` takes seconds.
``--rough 300 --repeats 20 --shape 16 8``: moduli drawn from the smoothness itself, with which intervals must be right.
"""

from __future__ import annotations

import argparse
import csv
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

import structid as sid
from structid.unknowns import Smoothness, penalty

SIZE, YOUNG, THICKNESS, LOSS_FACTOR = (1.0, 0.5), 70e9, 3e-3, 0.02
#: Middle (m), radius (m) and depth of the soft spot.
SPOT, RADIUS, DEPTH = np.array([0.65, 0.3]), 0.06, 0.3
STUDY = """title = "Plate with every element's modulus unknown"

[structure]
mesh = "plate.msh"
[structure.points]
{points}
[[structure.support]]
group = "rim"
directions = ["Z", "RX", "RY"]

[[structure.plate]]
name = "skin"
group = "skin"
youngs_modulus = 70e9
density = 2700.0
thickness = 3e-3
poisson = 0.33
loss_factor = 0.02

[[unknown]]
property = "youngs_modulus"
elements = "skin"
each = true

[[regularization]]
kind = "smoothness"
property = "youngs_modulus"
elements = "skin"

[record]
path = "frf.npz"

[method]
search = "matrix_free"
n_modes = 6
"""


def main() -> None:
    """Make the case, run it, judge it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for mesh, record, study and results")
    parser.add_argument("--shape", type=int, nargs=2, default=(200, 100), help="elements along each edge")
    parser.add_argument("--lines", type=int, default=30)
    parser.add_argument("--sensors", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.01, help="part of each channel's rms")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rough", type=float, help="strength of the smoothness that the true moduli are drawn from")
    parser.add_argument("--repeats", type=int, default=1, help="so many seeds, from --seed on")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    inside = []
    for seed in range(given.seed, given.seed + given.repeats):
        print(f"seed {seed}")
        inside.append(once(argparse.Namespace(**{**vars(given), "seed": seed})))
    if given.repeats > 1:
        print(f"95 % intervals that hold the truth, {given.repeats} seeds: {np.mean(inside):.1%}")


def once(given: argparse.Namespace) -> np.ndarray:
    """One case; which intervals hold the truth."""
    truth, middle = made(given)
    begun = time.perf_counter()
    code = subprocess.run(
        [sys.executable, "-m", "structid", "identify", "study.toml", "--out", "results"], cwd=given.out, check=False
    ).returncode
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    print(f"structid identify: exit code {code}, {time.perf_counter() - begun:.0f} s wall, {peak:.2f} GB peak")
    return judged(given.out / "results", truth, middle)


def made(given: argparse.Namespace) -> tuple[np.ndarray, np.ndarray]:
    """Write the case; true moduli over nominal and middles of the elements."""
    columns, rows = given.shape
    x, y = (np.linspace(0, length, count + 1) for length, count in zip(SIZE, given.shape, strict=True))
    number = np.arange(1, (columns + 1) * (rows + 1) + 1).reshape(columns + 1, rows + 1)
    cells = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    place = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    middle = place[cells - 1].mean(axis=1)
    truth = 1 - DEPTH * np.exp(-((middle - SPOT) ** 2).sum(axis=1) / (2 * RADIUS**2))
    (given.out / "plate.msh").write_text(mesh_text(place, cells, number[0]), encoding="utf-8")
    mesh = sid.read_mesh(given.out / "plate.msh")
    generator = np.random.default_rng(given.seed)
    first = 9000 if len(place) < 9000 else 900_000
    wanted = {first + k: tuple(at) for k, at in enumerate(generator.uniform(0.1, 0.95, (given.sensors, 2)) * SIZE)}
    points = "\n".join(f"{label} = [{at[0]:.4f}, {at[1]:.4f}]" for label, at in wanted.items())
    (given.out / "study.toml").write_text(STUDY.format(points=points + "\n"), encoding="utf-8")
    plate = sid.Plate(
        "skin", mesh.cells("skin"), youngs_modulus=YOUNG * truth, density=2700.0, poisson=0.33,
        thickness=THICKNESS, loss_factor=LOSS_FACTOR,
    )  # fmt: skip
    tied = sid.mesh_points(mesh, [plate], {label: (*np.round(at, 4), 0.0) for label, at in wanted.items()})
    nodes = mesh.nodes | {point.label: mesh.nodes[point.node] for point in tied}
    held = [f"{node}{d}" for node in mesh.group_nodes("rim") for d in ("Z", "RX", "RY")]
    structure = sid.Structure(nodes, [plate], held, tied)
    if given.rough is not None:
        truth = drawn(structure, given.rough, generator)
        structure = replace(structure, elements=(replace(plate, youngs_modulus=YOUNG * truth),))
    frequency = np.linspace(10.0, 600.0, given.lines)
    outputs, inputs = [f"{label}Z" for label in wanted], [f"{next(iter(wanted))}Z"]
    empty = sid.FrfRecord(frequency, np.ones((len(frequency), len(outputs), 1)), outputs, inputs, "accelerance")
    record = sid.simulated_record(
        structure, sid.parameters(structure, []), empty, relative_noise=given.noise, rng=generator
    )
    sid.write_record(given.out / "frf.npz", record)
    print(f"{structure.n_dofs} degrees of freedom, {len(cells)} elements, {given.lines} lines, {given.sensors} sensors")
    return truth, middle


def drawn(structure: sid.Structure, strength: float, generator: np.random.Generator) -> np.ndarray:
    """Factors whose logarithms have Gaussian differences between neighbours, and mean 0."""
    unknown = sid.parameters(structure, [sid.Unknown("youngs_modulus", "skin", each=True)])
    rows = sparse.csr_array(penalty(structure, unknown, Smoothness("youngs_modulus", "skin")).matrix)
    held = sparse.csc_matrix(rows.T @ rows + 1e-9 * sparse.eye_array(rows.shape[1]))
    field = spsolve(held, rows.T @ generator.standard_normal(rows.shape[0])) / np.sqrt(strength)
    return np.exp(field - field.mean())


def mesh_text(place: np.ndarray, cells: np.ndarray, rim: np.ndarray) -> str:
    """The mesh in Gmsh's version 2.2: quadrilaterals, and the clamped rim as lines."""
    nodes = [f"{k} {a:.6f} {b:.6f} 0" for k, (a, b) in enumerate(place, 1)]
    lines = [f"1 2 2 1 {a} {b}" for a, b in pairwise(rim)]
    quads = [f"3 2 1 1 {' '.join(map(str, cell))}" for cell in cells]
    numbered = [f"{k} {cell}" for k, cell in enumerate(quads + lines, 1)]
    parts = {"MeshFormat": ["2.2 0 8"], "PhysicalNames": ["2", '2 1 "skin"', '1 2 "rim"']}
    parts |= {"Nodes": [str(len(nodes)), *nodes], "Elements": [str(len(numbered)), *numbered]}
    return "".join(f"${name}\n{chr(10).join(rows)}\n$End{name}\n" for name, rows in parts.items())


def judged(folder: Path, truth: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Print how the answer compares with the truth; which intervals hold it."""
    with (folder / "parameters.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    value, std = (np.array([float(row[key] or "nan") for row in rows]) for key in ("value", "std"))
    ratio, std = value / YOUNG, std / YOUNG
    lowest = int(ratio.argmin())
    answer = json.loads((folder / "estimate.json").read_text(encoding="utf-8"))
    for item in answer["regularization"]:
        print(f"{item['text']}; the data determine {item['n_determined'] or float('nan'):.1f} combinations")
    print(f"status {answer['status']}, chi-square per degree of freedom {answer['chi_square_per_dof']:.3f}")
    print(
        f"lowest modulus {ratio[lowest]:.3f} +- {std[lowest]:.3f} at {middle[lowest].round(3)} m;"
        f" true {truth[lowest]:.3f} there, lowest {truth.min():.3f} at {middle[truth.argmin()].round(3)} m"
    )
    print(f"rms error {np.sqrt(((ratio - truth) ** 2).mean()):.4f}; median standard deviation {np.nanmedian(std):.4f}")
    inside: np.ndarray = np.abs(ratio - truth) <= 1.96 * std
    print(f"95 % intervals that hold the truth: {inside.mean():.1%} of {len(truth)}")
    return inside


if __name__ == "__main__":
    main()
