"""A block of hexahedra identified from the command line: its files, the run and what came out."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import structid as sid
from structid.dynamics.receptance import DynamicStiffness, reduced_sweep, single_blas
from structid.forward.frf.response import response
from structid.forward.frf.solvers import Pattern

YOUNG, DENSITY, POISSON, LOSS = 70e9, 2700.0, 0.3, 0.02
SIZE, BAND, GROUPS, SENSORS = (1.8, 1.0, 1.08), (100.0, 1000.0), (5, 2, 3), 20
#: Spread of the true moduli, and largest error of the simulated values in parts of the largest of their line.
SPREAD, EXACT = 0.1, 1e-9


def mesh_text(shape: tuple[int, ...]) -> str:
    """A block of `shape` hexahedra in Gmsh's format, cut into boxes that are its physical groups."""
    axes = [np.linspace(0.0, size, count + 1) for size, count in zip(SIZE, shape, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(1, len(grid) + 1).reshape([count + 1 for count in shape])
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cut = tuple(slice(None, -1) for _ in shape)
    low = number[cut]
    offsets = [number[c] - number[0, 0, 0] for c in corner]
    cells = np.stack([low.ravel() + offset for offset in offsets], axis=1)
    places = np.indices(shape).reshape(3, -1)
    box = [p * parts // count for p, parts, count in zip(places, GROUPS, shape, strict=True)]
    tag = 1 + np.ravel_multi_index(box, GROUPS)
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(int(np.prod(GROUPS)))]
    lines += [f'3 {g} "box{g}"' for g in range(1, int(np.prod(GROUPS)) + 1)] + ["$EndPhysicalNames", "$Nodes"]
    lines += [str(len(grid)), *(f"{n} {x:.9g} {y:.9g} {z:.9g}" for n, (x, y, z) in enumerate(grid, 1)), "$EndNodes"]
    lines += ["$Elements", str(len(cells))]
    rows = zip(tag.tolist(), cells.tolist(), strict=True)
    lines += [f"{e} 5 2 {g} {g} {' '.join(map(str, cell))}" for e, (g, cell) in enumerate(rows, 1)]
    return "\n".join([*lines, "$EndElements", ""])


def simulate(folder: Path, shape: tuple[int, ...], n_lines: int, noise: float, seed: int) -> None:
    """Write the mesh, the noisy record of a block whose moduli are off by 10 %, those moduli, and the study file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "block.msh").write_text(mesh_text(shape), encoding="utf-8")
    mesh = sid.read_mesh(folder / "block.msh", "m")
    names = [f"box{g}" for g in range(1, int(np.prod(GROUPS)) + 1)]
    generator = np.random.default_rng(seed)
    truth = YOUNG * np.exp(SPREAD * generator.standard_normal(len(names)))
    sets = [sid.Solid(n, mesh.cells(n), e, DENSITY, POISSON, LOSS) for n, e in zip(names, truth, strict=True)]
    held = [f"{node}{d}" for node in mesh.nodes_at({"x": (-1e-9, 1e-9)}) for d in "XYZ"]
    structure = sid.Structure(mesh.nodes, sets, held)
    usable = [dof for dof in structure.dofs if dof.direction in "XYZ"]
    sensors = [usable[i] for i in np.linspace(0, len(usable) - 1, SENSORS).astype(int)]
    empty = sid.FrfRecord(
        np.linspace(*BAND, n_lines), np.ones((n_lines, SENSORS, 1)), sensors, sensors[-1:], "receptance"
    )
    known = sid.parameters(structure, [sid.Unknown("youngs_modulus", n) for n in names])
    model = response(structure, known, empty)
    pattern = Pattern(model.slopes, model.channels)
    data = model.slopes.assembled.data(known.values(known.start))
    stiffness = DynamicStiffness(pattern.analysis, data, model.fixed_coefficients, empty.frequency)
    loads = model.channels.columns[:, np.unique(model.channels.inputs[0])].toarray()
    with single_blas():
        found = reduced_sweep(stiffness, pattern.indices, loads, model.channels.sensors, EXACT)
    exact = found.values * model.channels.inputs[1]
    size = noise * np.sqrt((np.abs(exact) ** 2).mean(axis=0, keepdims=True)) * np.ones(exact.shape)
    shift = generator.standard_normal((2, *exact.shape)) * size / np.sqrt(2)
    values = exact + shift[0] + 1j * shift[1]
    sid.write_record(
        folder / "frf.npz",
        sid.FrfRecord(empty.frequency, values, empty.outputs, empty.inputs, "receptance", size**2),
    )
    (folder / "truth.json").write_text(json.dumps(dict(zip(names, truth.tolist(), strict=True))), encoding="utf-8")
    print(
        f"{structure.n_dofs} degrees of freedom, {sum(len(s.nodes) for s in sets)} elements; {n_lines} lines simulated"
        f" with {found.n_factorizations} factorizations and {found.n_basis} vectors, verified error {found.error:.0e}"
    )


def write_study(folder: Path, iterations: int, reduced: float | None) -> None:
    """The study file: nominal moduli, all of them unknown."""
    names = list(json.loads((folder / "truth.json").read_text(encoding="utf-8")))
    common = f"youngs_modulus = {YOUNG}\ndensity = {DENSITY}\npoisson = {POISSON}\nloss_factor = {LOSS}\n"
    parts = [
        'title = "Block"\n[structure]\nmesh = { path = "block.msh", length_unit = "m" }\n',
        '[[structure.support]]\nx = [-1e-9, 1e-9]\ndirections = ["X", "Y", "Z"]\n',
        *(f'[[structure.solid]]\nname = "{n}"\ngroup = "{n}"\n{common}' for n in names),
        *(f'[[unknown]]\nproperty = "youngs_modulus"\nelements = "{n}"\n' for n in names),
        '[record]\npath = "frf.npz"\n',
        f"[method]\npole_free_start = false\nrestarts = 0\nmax_iterations = {iterations}\n",
        "" if reduced is None else f"reduced = {reduced}\n",
    ]
    (folder / "study.toml").write_text("".join(parts), encoding="utf-8")


def identify(folder: Path) -> dict[str, float]:
    """Run the command line on the study: wall and processor time, s, and peak memory, GB."""
    start = time.perf_counter()
    command = [str(Path(sys.executable).with_name("structid")), "identify", str(folder / "study.toml")]
    subprocess.run([*command, "--no-report", "--out", str(folder / "results")], check=False, env=os.environ)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "wall": time.perf_counter() - start,
        "processor": used.ru_utime + used.ru_stime,
        "peak": used.ru_maxrss / 1e6,
    }


def errors(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Of the identified moduli: relative errors, and errors in standard deviations."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    found = json.loads((folder / "results" / "estimate.json").read_text(encoding="utf-8"))["parameters"]
    rows = {row["name"].split("[")[1].rstrip("]"): row for row in found}
    off = np.array([rows[n]["value"] - true for n, true in truth.items()])
    return off / np.array(list(truth.values())), off / np.array([rows[n]["std"] for n in truth])
