"""CalculiX, really run: matrices and modes of a plate with two materials beside structid's own hexahedra."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from solver_cases import MATRICES_STEP, MODES_STEP, needs_ccx, own_plate, parameter, plate_deck, plate_record, unknown
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.errors import FileError
from structid.external.outputs import read_shapes
from structid.fem.importers import read_matrix
from structid.forward.frf.response import response
from structid.records import FrfRecord
from structid.records.formats import write_record
from structid.unknowns import parameters

RUN = CliRunner()
LEFT, RIGHT = 1.9e11, 0.77e11
#: Of a model that is exact, since the record is simulated with it.
STRUCTURE = "[structure]\ntolerance = 0\n"
RECORD = '[record]\npath = "measured.csv"\n[record.modes]\nfrequency_error = 0.001\nshape_error = 0.01\n'


def study(folder, gives, record=RECORD):
    step, files = (
        (MATRICES_STEP, 'stiffness = "{stem}.sti"\nmass = "{stem}.mas"')
        if gives == "matrices"
        else (MODES_STEP, 'modes = "{stem}.frd"')
    )
    (folder / "plate.inp").write_text(plate_deck("{{E_left}}", "{{E_right}}", step))
    path = folder / "study.toml"
    own = parameter("E_left", 2.1e11) + parameter("E_right", 0.7e11) + unknown("E_left") + unknown("E_right")
    head = f'{STRUCTURE}[structure.solver]\ndeck = "plate.inp"\ncommand = "ccx {{stem}}"\ngives = "{gives}"\n{files}\n'
    path.write_text(head + own.replace("N/m", "Pa") + record)
    return path


def own_study(folder):
    """The same of structid's own hexahedra."""
    (folder / "own.inp").write_text(plate_deck("2.1e11", "0.7e11", MATRICES_STEP))
    sets = "".join(
        f'[[structure.solid]]\nname = "{name}"\ngroup = "{name.upper()}"\nyoungs_modulus = {modulus!r}\ndensity = {density!r}\n'
        'poisson = 0.3\nformulation = "full"\n'
        for name, modulus, density in (("left", 2.1e11, 7800.0), ("right", 0.7e11, 2700.0))
    )
    unknowns = "".join(f'[[unknown]]\nproperty = "youngs_modulus"\nelements = "{name}"\n' for name in ("left", "right"))
    held = '[[structure.support]]\nx = [-0.01, 0.01]\ndirections = ["X", "Y", "Z"]\n'
    path = folder / "own.toml"
    path.write_text(f'{STRUCTURE}[structure.mesh]\npath = "own.inp"\n{held}{sets}{unknowns}{RECORD}')
    return path


def identified(path, name):
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(path.parent / name), "--no-report"])
    assert done.exit_code in (0, 1, 3), done.stderr
    return json.loads((path.parent / name / "estimate.json").read_text())


@needs_ccx
def test_exported_matrices_give_the_answer_of_structids_own_hexahedra(tmp_path):
    plate_record(own_plate(tmp_path, LEFT, RIGHT), tmp_path / "measured.csv", rng=np.random.default_rng(3))
    found, own = identified(study(tmp_path, "matrices"), "out"), identified(own_study(tmp_path), "own")
    assert [one["elements"] for one in found["parameters"]] == [["model"], ["model"]]
    for ours, theirs in zip(own["parameters"], found["parameters"], strict=True):
        assert theirs["value"] == pytest.approx(ours["value"], rel=1e-6)
        assert theirs["std"] == pytest.approx(ours["std"], rel=1e-5)
    assert found["solver"]["runs_made"] == 6
    assert found["solver"]["largest_difference"] < 1e-10


@needs_ccx
def test_differences_of_modes_agree_and_the_updated_deck_gives_the_fitted_frequencies(tmp_path):
    plate_record(own_plate(tmp_path, LEFT, RIGHT), tmp_path / "measured.csv", rng=np.random.default_rng(3))
    found, own = identified(study(tmp_path, "modes"), "out"), identified(own_study(tmp_path), "own")
    for ours, theirs in zip(own["parameters"], found["parameters"], strict=True):
        assert theirs["value"] == pytest.approx(ours["value"], abs=1e-2 * ours["std"])
        assert theirs["std"] == pytest.approx(ours["std"], rel=1e-3)
    assert found["solver"]["largest_difference"] < 1e-6
    moduli = re.findall(r"\*ELASTIC\n([^,]*),", (tmp_path / "out" / "updated" / "plate.inp").read_text())
    np.testing.assert_allclose([float(word) for word in moduli], [p["value"] for p in found["parameters"]], rtol=1e-12)


RESPONSE = """*FREQUENCY, STORAGE=YES
40
*END STEP
** RESPONSE
*STEADY STATE DYNAMICS
FREQUENCY, FREQUENCY, 2
*MODAL DAMPING
1, 40, 0.01
*CLOAD
9, 3, 1.
*NODE FILE
U
"""


@pytest.mark.long
@needs_ccx
def test_frfs_of_calculix_give_the_answer_of_structids_own_hexahedra(tmp_path):
    shutil.copy(Path(__file__).parent / "ccx_frfs.py", tmp_path)
    cells = (8, 4, 1)
    deck = plate_deck("{{E_left}}", "{{E_right}}", RESPONSE, cells)
    frequency = np.linspace(20.0, 260.0, 49)
    record = FrfRecord(frequency, np.zeros((49, 2, 1)), ("45Z", "23Z"), ("9Z",), "receptance")
    held = replace(own_plate(tmp_path, LEFT, RIGHT, cells), damping_ratio=0.01)
    true = response(held, parameters(held, []), record).values_at(np.zeros(0))
    real, imaginary = np.random.default_rng(3).standard_normal((2, *true.shape))
    size = 0.01 * np.abs(true)
    noisy = true + size * (real + 1j * imaginary) / np.sqrt(2)
    write_record(tmp_path / "frf.npz", replace(record, values=noisy, variance=size**2))
    frfs = '[record]\npath = "frf.npz"\ncalibration = 0\n'
    own_path = own_study(tmp_path)
    (tmp_path / "own.inp").write_text(plate_deck("2.1e11", "0.7e11", MATRICES_STEP, cells))
    own_path.write_text(
        own_path.read_text().replace(STRUCTURE, f"{STRUCTURE}damping_ratio = 0.01\n").replace(RECORD, frfs)
    )
    path = study(tmp_path, "modes", frfs)
    text = path.read_text()
    text = text.replace('gives = "modes"\nmodes = "{stem}.frd"', 'gives = "frfs"\nfrfs = "{stem}.csv"')
    path.write_text(text.replace("ccx {stem}", f"{sys.executable} {{study}}/ccx_frfs.py {{deck}} 9Z 45Z 23Z"))
    (tmp_path / "plate.inp").write_text(deck[: deck.rindex("*END STEP")])
    found, own = identified(path, "out"), identified(own_path, "own")
    for ours, theirs, value in zip(own["parameters"], found["parameters"], (LEFT, RIGHT), strict=True):
        assert theirs["value"] == pytest.approx(ours["value"], rel=1e-3)
        assert theirs["value"] == pytest.approx(value, rel=5e-3)
        assert theirs["std"] == pytest.approx(ours["std"], rel=0.01)


@needs_ccx
def test_calculix_matrices_are_read_whole_or_not_at_all(tmp_path):
    path = study(tmp_path, "matrices", RECORD)
    plate_record(own_plate(tmp_path, LEFT, RIGHT), tmp_path / "measured.csv")
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 0, done.stderr
    folder = next(one.parent for one in tmp_path.glob("study.runs/*/run.json") if _is_nominal(one))
    own = own_plate(tmp_path, 2.1e11, 0.7e11)
    item = read_matrix(folder / "plate.sti")
    full = own.matrix("stiffness").toarray()
    order = [own.dofs.index(dof) for dof in _dofs(item)]
    np.testing.assert_allclose(item.matrix.toarray(), full[np.ix_(order, order)], atol=1e-10 * abs(full).max())
    for name in ("plate.sti", "plate.mas"):
        content = (folder / name).read_bytes()
        for cut in (len(content) // 2, len(content) - 1, len(content) - 30):
            (tmp_path / name).write_bytes(content[:cut])
            (tmp_path / "plate.dof").write_bytes((folder / "plate.dof").read_bytes())
            with pytest.raises(FileError, match=re.escape(name)):
                read_matrix(tmp_path / name)
    (tmp_path / "plate.dof").unlink()
    with pytest.raises(FileError, match=r"plate\.dof"):
        read_matrix(tmp_path / "plate.sti")


def _is_nominal(path):
    return json.loads(path.read_text())["values"] == {"E_left": 2.1e11, "E_right": 0.7e11}


def _dofs(item):
    from structid.fem.importers import dofs_of

    return dofs_of(item.dofs)


@needs_ccx
def test_calculix_modes_are_read_whole_or_not_at_all(tmp_path):
    path = study(tmp_path, "modes")
    plate_record(own_plate(tmp_path, LEFT, RIGHT), tmp_path / "measured.csv")
    assert RUN.invoke(cli.app, ["check", str(path)]).exit_code == 0
    source = next(one.parent for one in tmp_path.glob("study.runs/*/run.json") if _is_nominal(one)) / "plate.frd"
    own = own_plate(tmp_path, 2.1e11, 0.7e11)
    from structid.dynamics.normal_modes import modes

    true, found = modes(own.matrix("mass"), own.matrix("stiffness"), n_modes=8), read_shapes(source)
    np.testing.assert_allclose(found.frequency, true.frequency, rtol=1e-8)
    rows = {(int(node), int(c)): row for row, (node, c) in zip(found.values, found.dofs, strict=True)}
    shapes = np.array([rows[dof.node, dof.axis + 1] for dof in own.dofs])
    signs = np.sign(np.einsum("ij,ij->j", shapes, true.mode_shapes))
    np.testing.assert_allclose(shapes * signs, true.mode_shapes, atol=1e-5 * abs(shapes).max())
    content = source.read_bytes()
    for cut in np.linspace(0, len(content) - 8, 12).astype(int)[1:]:
        (tmp_path / "cut.frd").write_bytes(content[:cut])
        with pytest.raises(FileError, match=r"cut\.frd"):
            read_shapes(tmp_path / "cut.frd")


@needs_ccx
def test_modes_that_calculix_did_not_find_are_no_finished_run(tmp_path):
    path = study(tmp_path, "modes")
    deck = tmp_path / "plate.inp"
    assert "*FREQUENCY\n8\n" in deck.read_text()
    deck.write_text(deck.read_text().replace("*FREQUENCY\n8\n", "*FREQUENCY\n16\n"))  # too many for 72 equations
    plate_record(own_plate(tmp_path, LEFT, RIGHT), tmp_path / "measured.csv")
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert "plate.frd: nothing moves in mode 1; the solver found no such mode" in words, words
    assert not list(tmp_path.glob("study.runs/*/run.json"))
