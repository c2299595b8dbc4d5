"""Seconds that 40 modes of a model of 2,000 degrees of freedom take beside those measured at 100 sensors, with the page.

Run: python benchmarks/correlation.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from structid import ModalRecord, SpaceBeam, Structure
from structid.core.dof import DIRECTIONS, Dof
from structid.dynamics.normal_modes import modes
from structid.modal.formats.files import write_modes

N_MODES, N_SENSORS = 40, 100
_BEAM = """
[[structure.space_beam]]
name = "{name}"
nodes = {pairs}
mass = 12.0
bending_stiffness_y = {stiffness}
bending_stiffness_z = {stiffness}
axial_stiffness = 4e8
torsional_stiffness = {stiffness}
polar_inertia = 0.05
orientation = {orientation}
"""


def grid(
    n_x: int = 26, n_y: int = 13
) -> tuple[dict[int, tuple[float, float, float]], list[list[int]], list[list[int]]]:
    """Nodes of a grid in a plane, and pairs of nodes along X and along Y."""
    nodes = {1 + i + n_x * j: (0.5 * i, 0.5 * j, 0.0) for j in range(n_y) for i in range(n_x)}
    along = [[1 + i + n_x * j, 2 + i + n_x * j] for j in range(n_y) for i in range(n_x - 1)]
    across = [[1 + i + n_x * j, 1 + i + n_x * (j + 1)] for j in range(n_y - 1) for i in range(n_x)]
    return nodes, along, across


def written(folder: Path) -> Path:
    """The study, whose measurement is the model with beams along Y stiffer by a tenth, 2 % of noise."""
    nodes, along, across = grid()
    edge = [1, 26, 1 + 26 * 12, 26 * 13]
    parts = {"along": (along, 2e5, (0.0, 0.0, 1.0)), "across": (across, 2.2e5, (0.0, 0.0, 1.0))}
    sets = [
        SpaceBeam(
            name, pairs, mass=12.0, bending_stiffness_y=size, bending_stiffness_z=size, axial_stiffness=4e8,
            torsional_stiffness=size, polar_inertia=0.05, orientation=up,
        )
        for name, (pairs, size, up) in parts.items()
    ]  # fmt: skip
    truth = Structure(nodes, sets, [Dof(node, d) for node in edge for d in DIRECTIONS])
    rng = np.random.default_rng(0)
    chosen = rng.choice([n for n in nodes if n not in edge], N_SENSORS, replace=False)
    sensors = tuple(Dof(int(n), "Z") for n in sorted(chosen))
    found = modes(truth.matrix("mass"), truth.matrix("stiffness"), n_modes=N_MODES)
    shapes = truth.selection(sensors).T @ found.mode_shapes
    shapes /= np.abs(shapes).max(axis=0)
    shapes += 0.02 * rng.standard_normal(shapes.shape)
    write_modes(folder / "modes.csv", ModalRecord(found.frequency, np.full(N_MODES, 0.01), shapes, sensors))
    lines = ['title = "Grid"', "[structure]", f"fixed = {[str(n) for n in edge]}", "[structure.nodes]"]
    lines += [f"{label} = {list(place)}" for label, place in nodes.items()]
    text = "\n".join(lines)
    for name, (pairs, _, up) in parts.items():
        text += _BEAM.format(name=name, pairs=pairs, stiffness=2e5, orientation=list(up))
    text += '[[unknown]]\nproperty = "bending_stiffness_y"\nelements = "across"\n'
    text += '[record]\npath = "modes.csv"\n[record.modes]\nfrequency_error = 0.005\nshape_error = 0.02\n'
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder / "study.toml"


def main() -> None:
    from structid.compare.correlation import correlate
    from structid.report.correlation import correlation_page
    from structid.study.schema.study import load_study

    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder))
        for turn in ("first", "again"):
            begin, busy = perf_counter(), process_time()
            study = load_study(path)
            read = perf_counter()
            found = correlate(study)
            held = perf_counter()
            page = correlation_page(found).write(Path(folder))
            end = perf_counter()
            part = found.modes[0]
            print(
                f"{turn}: study read {read - begin:.2f} s, {part.n_paired} of {part.measured.n_modes} modes paired of"
                f" {study.structure.n_dofs} degrees of freedom at {len(part.measured.channels)} sensors {held - read:.2f} s,"
                f" page {end - held:.2f} s ({page.stat().st_size / 1e6:.1f} MB), together {end - begin:.2f} s,"
                f" of the processor {process_time() - busy:.2f} s"
            )


if __name__ == "__main__":
    main()
