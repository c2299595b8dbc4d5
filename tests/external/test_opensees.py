"""OpenSeesPy, really run: matrices of a cantilever of two moduli by the recipe of docs/solver-in-the-loop.md."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from solver_cases import OPENSEES, needs_opensees, parameter, unknown
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.dof import parse_dof
from structid.dynamics.normal_modes import modes
from structid.fem import Beam, PointMass, Structure
from structid.fem.importers import read_matrix, read_numbering
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes

PAGE = Path(__file__).parents[2] / "docs" / "solver-in-the-loop.md"
SENSORS = ("2Y", "3Y", "4Y", "5Y", "3X", "5X")
TRUE = {"E1": 1.9e11, "E2": 0.77e11}

MODEL = """
ops.model("basic", "-ndm", 2, "-ndf", 3)
for i in range(5):
    ops.node(i + 1, 0.25 * i, 0.0)
ops.fix(1, 1, 1, 1)
ops.geomTransf("Linear", 1)
for i in range(4):
    modulus = {{E1}} if i < 2 else {{E2}}
    ops.element("elasticBeamColumn", i + 1, i + 1, i + 2, 1e-4, modulus, 8e-10, 1, "-mass", 0.5, "-cMass")
ops.mass(5, 0.1, 0.1, 0.0)
"""


def study(folder):
    """The recipe of the page with the model before its last line, and a study that runs it."""
    recipe = re.search(r"## OpenSeesPy.*?```python\n(.*?)```", PAGE.read_text(), re.DOTALL).group(1)
    head, last = recipe.rsplit("\n\n\n", 1)
    assert last.startswith("write_matrices(")
    (folder / "frame.py").write_text(f"{head}\n\n{MODEL}\n{last}")
    keys = re.search(r"## OpenSeesPy.*?```toml\n(.*?)```", PAGE.read_text(), re.DOTALL).group(1)
    own = "".join(parameter(name, value) + unknown(name) for name, value in (("E1", 2.1e11), ("E2", 0.7e11)))
    record = '[record]\npath = "measured.csv"\n[record.modes]\nfrequency_error = 0.001\nshape_error = 0.01\n'
    path = folder / "study.toml"
    path.write_text(keys.replace("/path/to/python", str(OPENSEES)) + own + record)
    return path


def own_beams(first, second):
    """The same of structid's own beams, each with the axial stiffness and mass of its bar."""
    nodes = {i + 1: (0.25 * i, 0.0) for i in range(5)}
    sets = [
        Beam(name, table, mass=0.5, bending_stiffness=8e-10 * modulus, axial_stiffness=1e-4 * modulus)
        for name, table, modulus in (("a", [[1, 2], [2, 3]], first), ("b", [[3, 4], [4, 5]], second))
    ]
    tip = PointMass("tip", [5], 0.1, directions=("X", "Y"))
    return Structure(nodes, [*sets, tip], ["1X", "1Y", "1RZ"])


@needs_opensees
def test_the_recipe_gives_the_matrices_of_structids_own_beams_and_their_moduli(tmp_path):
    own = own_beams(*TRUE.values())
    found = modes(own.matrix("mass"), own.matrix("stiffness"), n_modes=5)
    channels = tuple(map(parse_dof, SENSORS))
    shapes = own.selection(channels).toarray().T @ found.mode_shapes
    record = ModalRecord(found.frequency, np.full(5, np.nan), shapes / np.abs(shapes).max(axis=0), channels)
    write_modes(tmp_path / "measured.csv", record)
    done = CliRunner().invoke(
        cli.app, ["identify", str(study(tmp_path)), "--out", str(tmp_path / "out"), "--no-report"]
    )
    assert done.exit_code == 0, done.stderr
    answer = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert [one["value"] for one in answer["parameters"]] == pytest.approx(list(TRUE.values()), rel=1e-6)
    assert answer["solver"]["largest_difference"] < 1e-6

    run = next(p.parent for p in tmp_path.glob("*.runs/*/run.json") if '"E1": 210000000000.0' in p.read_text())
    rows = read_numbering(run / "frame.dofs")
    values = json.loads((run / "run.json").read_text())["values"]
    own = own_beams(values["E1"], values["E2"])
    order = [own.dofs.index(dof) for dof in rows]
    for file, kind in (("frame_k.npy", "stiffness"), ("frame_m.npy", "mass")):
        expected = own.matrix(kind).toarray()[np.ix_(order, order)]
        given = read_matrix(run / file).matrix.toarray()
        np.testing.assert_allclose(given, expected, atol=1e-12 * abs(expected).max())
