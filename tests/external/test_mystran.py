"""MYSTRAN, really run: a beam of two materials, its matrices by OUTPUT4 and its modes by the F06 file."""

from __future__ import annotations

import json
import re
import subprocess

import numpy as np
import pytest
from solver_cases import MYSTRAN, needs_mystran, parameter, unknown
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.dof import parse_dof
from structid.dynamics.normal_modes import modes
from structid.external.deck import number_text
from structid.external.outputs import read_shapes
from structid.fem import SpaceBeam, Structure
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.prediction.identified_model import identified_model
from structid.study.run.exports import export_matrices, model_modes
from structid.unknowns import Unknown, parameters

RUN = CliRunner()
SENSORS = ("2Y", "3Y", "4Y", "5Y", "2Z", "3Z", "5Z")


def deck(first: str, second: str, output: str) -> str:
    grids = "\n".join(f"GRID,{i + 1},,{0.25 * i},0.0,0.0" for i in range(5))
    bars = "\n".join(f"CBAR,{i},{1 + (i > 2)},{i},{i + 1},0.,1.,0." for i in range(1, 5))
    return f"""ID BEAM,MODES
SOL 3
{output}CEND
TITLE = CANTILEVER
SPC = 1
METHOD = 10
DISPLACEMENT(PRINT) = ALL
BEGIN BULK
EIGRL,10,,,6
{grids}
{bars}
PBAR,1,1,1.E-4,8.E-10,4.E-10,1.6E-9
PBAR,2,2,1.E-4,8.E-10,4.E-10,1.6E-9
MAT1,1,{first},,0.3,7800.
MAT1,2,{second},,0.3,2700.
SPC1,1,123456,1
ENDDATA
"""


OUTPUT = "OUTPUT4 KAA,MAA,,,//-1/21 $\n"


def study(folder, gives):
    output = OUTPUT if gives == "matrices" else ""
    (folder / "beam.bdf").write_text(deck("{{E1}}", "{{E2:8}}", output))
    dofs = [f"{node}{d}" for node in range(2, 6) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    files = 'modes = "{stem}.F06"'
    if gives == "matrices":
        keys = (("stiffness", "KAA"), ("mass", "MAA"))
        lines = [f'{key} = {{ path = "{{stem}}.OU1", matrix = "{name}" }}' for key, name in keys]
        files = "\n".join([*lines, f"dofs = {dofs}"])
    own = parameter("E1", 2.1e11) + parameter("E2", 0.7e11) + unknown("E1") + unknown("E2")
    head = f'[structure.solver]\ndeck = "beam.bdf"\ncommand = "{MYSTRAN} {{deck}}"\ngives = "{gives}"\n{files}\n'
    record = '[record]\npath = "measured.csv"\n[record.modes]\nfrequency_error = 0.001\nshape_error = 0.01\n'
    path = folder / "study.toml"
    path.write_text(head + own + record)
    return path


def identified(folder, gives):
    path = study(folder, gives)
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(folder / "out"), "--no-report"])
    assert done.exit_code in (0, 1, 3), done.stderr
    return json.loads((folder / "out" / "estimate.json").read_text())


@needs_mystran
def test_matrices_and_modes_of_a_beam_give_the_moduli_of_the_solver_itself(tmp_path):
    truth = tmp_path / "truth"
    truth.mkdir()
    (truth / "measured.csv").write_text("frequency_hz,2Y\n1.0,1.0\n")
    path = study(truth, "matrices")
    assert RUN.invoke(cli.app, ["check", str(path)]).exit_code in (0, 1, 2)
    from structid.study.schema.model.structure import read_structure
    from structid.study.schema.section import read_root

    root, files = read_root(path)
    structure = read_structure(root.inner("structure"), files)
    values = structure.values.copy()
    values[:2] = 1.9e11, 0.77e11
    found = modes(structure.matrix("mass", values), structure.matrix("stiffness", values), n_modes=6)
    channels = tuple(map(parse_dof, SENSORS))
    shapes = structure.selection(channels).toarray().T @ found.mode_shapes
    record = ModalRecord(found.frequency, np.full(6, np.nan), shapes / np.abs(shapes).max(axis=0), channels)
    for gives, digits in (("matrices", 1e-6), ("modes", 1e-5)):
        folder = tmp_path / gives
        folder.mkdir()
        write_modes(folder / "measured.csv", record)
        answer = identified(folder, gives)
        assert [one["value"] for one in answer["parameters"]] == pytest.approx([1.9e11, 0.77e11], rel=digits)
        assert answer["solver"]["largest_difference"] < 1e-6


@needs_mystran
def test_the_matrices_are_those_of_structids_own_beams(tmp_path):
    (tmp_path / "measured.csv").write_text("frequency_hz,2Y\n1.0,1.0\n")
    from structid.study.schema.model.structure import read_structure
    from structid.study.schema.section import read_root

    root, files = read_root(study(tmp_path, "matrices"))
    structure = read_structure(root.inner("structure"), files)
    nodes = {i + 1: (0.25 * i, 0.0, 0.0) for i in range(5)}
    sets = [
        SpaceBeam(
            name,
            table,
            mass=density * 1e-4,
            bending_stiffness_y=modulus * 4e-10,
            bending_stiffness_z=modulus * 8e-10,
            axial_stiffness=modulus * 1e-4,
            torsional_stiffness=modulus / 2.6 * 1.6e-9,
            orientation=(0.0, 1.0, 0.0),
        )
        for name, table, modulus, density in (
            ("a", [[1, 2], [2, 3]], 2.1e11, 7800.0),
            ("b", [[3, 4], [4, 5]], 0.7e11, 2700.0),
        )
    ]
    own = Structure(nodes, sets, ["1X", "1Y", "1Z", "1RX", "1RY", "1RZ"])
    full, given = own.matrix("stiffness").toarray(), structure.matrix("stiffness").toarray()
    order = [own.dofs.index(dof) for dof in structure.dofs]
    np.testing.assert_allclose(given, full[np.ix_(order, order)], atol=1e-9 * abs(full).max())


@needs_mystran
@pytest.mark.parametrize("gives", ["matrices", "modes"])
def test_fields_of_cards_in_small_and_large_field_give_what_braces_give(tmp_path, gives):
    output = OUTPUT if gives == "matrices" else ""

    def cards(first: str, second: str) -> str:
        small = f"MAT1    1       {first:8}        0.3     7800.\n"
        large = f"{'MAT1*':8}{'2':>16}{second:16}{'':16}{'0.3':16}*\n{'*':8}{'2700.':16}\n"
        own = deck("0.", "0.", output)
        return own.replace("MAT1,1,0.,,0.3,7800.\n", small).replace("MAT1,2,0.,,0.3,2700.\n", large)

    dofs = tuple(map(parse_dof, SENSORS))
    shapes = np.random.default_rng(0).standard_normal((len(SENSORS), 1))
    found = {}
    for name in ("braces", "cards"):
        folder = tmp_path / name
        folder.mkdir()
        write_modes(folder / "measured.csv", ModalRecord(np.array([9.3]), np.full(1, np.nan), shapes, dofs))
        path = study(folder, gives)
        if name == "braces":
            (folder / "beam.bdf").write_text(deck("{{E1:8}}", "{{E2}}", output))
        else:
            (folder / "beam.bdf").write_text(cards("2.1E11", "7.+10"))
            text = path.read_text()
            for k, value in ((1, 2.1e11), (2, 0.7e11)):
                assert f"value = {value!r}\n" in text
                text = text.replace(f"value = {value!r}\n", f'mark = {{ card = "MAT1", id = {k}, field = 3 }}\n')
            path.write_text(text)
        done = RUN.invoke(cli.app, ["check", str(path)])
        assert done.exit_code in (0, 1), done.stderr
        found[name] = {
            tuple(json.loads(one.read_text())["values"].values()): one.parent
            for one in folder.glob("*.runs/*/run.json")
        }
    assert set(found["cards"]) == set(found["braces"])
    for values, folder in found["cards"].items():
        text, other = (folder / "beam.bdf").read_text(), found["braces"][values]
        assert text == cards(number_text(values[0], 8), number_text(values[1], 16))
        if gives == "matrices":
            assert (folder / "beam.OU1").read_bytes() == (other / "beam.OU1").read_bytes()
        else:
            frequency, expected = (read_shapes(one / "beam.F06").frequency for one in (folder, other))
            np.testing.assert_array_equal(frequency, expected)


@needs_mystran
def test_exported_matrices_have_the_frequencies_of_the_model(tmp_path):
    nodes = {n: (0.3 * n, 0.02 * n**2, 0.0) for n in range(1, 6)}
    stiffness = {
        "bending_stiffness_y": 40.0,
        "bending_stiffness_z": 60.0,
        "axial_stiffness": 1e6,
        "torsional_stiffness": 30.0,
    }
    beams = SpaceBeam("beam", [[n, n + 1] for n in range(1, 5)], mass=0.8, polar_inertia=1e-4, **stiffness)
    structure = Structure(nodes, [beams], fixed=[f"1{direction}" for direction in ("X", "Y", "Z", "RX", "RY", "RZ")])
    unknown = parameters(structure, [Unknown("mass", "beam")])
    model = identified_model(structure, unknown, np.array([0.71]), np.array([[1e-4]]))
    export_matrices(model, tmp_path / "BEAM.OP4")
    grids = "\n".join(f"GRID,{n},,{x:.6f},{y:.6f},{z:.6f}" for n, (x, y, z) in nodes.items())
    (tmp_path / "user.bdf").write_text(f"""ID BEAM,USER
SOL 3
IN4 1 = BEAM.OP4
CEND
SPC = 1
METHOD = 10
BEGIN BULK
EIGRL,10,,,10
{grids}
SPC1,1,123456,1
PUSERIN,7,1,KAA,MAA
CUSERIN,1,7,4,0,0
+,2,123456,3,123456,4,123456,5,123456
ENDDATA
""")
    subprocess.run([MYSTRAN, "user.bdf"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    printed = re.findall(
        r"^ +\d+ +\d+ +\S+E\S+ +\S+E\S+ +(\S+E\S+) ", (tmp_path / "user.F06").read_text(), re.MULTILINE
    )
    np.testing.assert_allclose(np.array(printed, dtype=float)[:10], model_modes(model, 10).frequency, rtol=1e-6)
