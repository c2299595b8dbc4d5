"""Modes that a solver wrote in a file of any format."""

from dataclasses import replace

import numpy as np
import pytest

from structid.core.dof import Dof
from structid.core.errors import FileError
from structid.external import outputs
from structid.external.frf_model import FrfsOut
from structid.external.outputs import ModesOut, RunDeck, read_shapes
from structid.modal.formats.files import write_modes
from structid.modal.formats.printed import PrintedMode, PrintedModes
from structid.modal.modal_record import ModalRecord

SHAPES = np.array([[1.0, 0.4], [0.5, -1.0], [-0.2, 0.7]])


def _written(path, shapes):
    write_modes(path, ModalRecord([3.0, 7.0], [0.01, 0.02], shapes, ["1X", "2X", "3X"]))
    return path


@pytest.mark.parametrize("name", ["modes.csv", "modes.json", "modes.uff"])
def test_shapes_of_any_phase_are_turned_to_be_real(tmp_path, name):
    turned = SHAPES * np.exp(1j * np.array([1.4, -0.9]))
    values = read_shapes(_written(tmp_path / name, turned)).values
    scale = values[0] / SHAPES[0]
    assert values == pytest.approx(SHAPES * scale, rel=1e-5)
    assert abs(scale) == pytest.approx([1.0, 1.0], rel=1e-5)  # the largest entry keeps its size


@pytest.mark.parametrize("name", ["modes.csv", "modes.json", "modes.uff"])
def test_a_truly_complex_mode_is_refused(tmp_path, name):
    shapes = SHAPES + 1j * np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    with pytest.raises(FileError, match=rf"{name}: mode 2 at 7 Hz is complex, .* print the real modes"):
        read_shapes(_written(tmp_path / name, shapes))


def _printed(**more):
    return PrintedMode(2j * np.pi * 3.0, np.array([4]), np.ones((1, 6)), **{"systems": np.array([-1]), **more})


def test_shapes_have_unit_modal_mass_where_the_solver_prints_it(tmp_path, monkeypatch):
    (tmp_path / "a.pch").write_text("any")
    for mass, is_known in ((4.0, True), (np.nan, False)):
        modes = PrintedModes([_printed(generalized_mass=mass)])
        monkeypatch.setattr(outputs, "nastran_modes", lambda path, modes=modes: modes)
        found = read_shapes(tmp_path / "a.pch")
        assert found.has_mass is is_known
        assert [note for note in found.notes if "displacement systems of its points, taken as basic" in note]
        assert found.values[0, 0] == (0.5 if is_known else 1.0)
    said = PrintedModes([_printed(systems=np.array([0]))])
    monkeypatch.setattr(outputs, "nastran_modes", lambda path: said)
    assert read_shapes(tmp_path / "a.pch").notes == ()


def test_motions_in_another_system_than_the_basic_one_are_refused(tmp_path, monkeypatch):
    (tmp_path / "a.f06").write_text("any")
    modes = PrintedModes([_printed(systems=np.array([7]))])
    monkeypatch.setattr(outputs, "nastran_modes", lambda path: modes)
    with pytest.raises(FileError, match="point 4 is printed in coordinate system 7; let the deck give it in the basic"):
        read_shapes(tmp_path / "a.f06")


#: Point 4 stands at 90 degrees of cylinder 7, so that its radial axis is Y and the one around -X.
BULK = "SOL 103\nCEND\nBEGIN BULK\nCORD2C,7,0,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n{}ENDDATA\n"
GRIDS = "GRID,4,,0.,2.,0.,7\nGRID,5,,0.,3.,0.\n"


@pytest.mark.parametrize("system", [-1, 7])
def test_motions_are_turned_to_basic_axes_by_the_deck_of_the_run(tmp_path, monkeypatch, system):
    mode = PrintedMode(
        2j * np.pi * 3.0,
        np.array([4, 5]),
        np.tile([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], (2, 1)),
        np.array([system, min(system, 0)]),
    )
    monkeypatch.setattr(outputs, "nastran_modes", lambda path: PrintedModes([mode]))
    run, beside = tmp_path / "run", tmp_path / "beside"
    run.mkdir()
    beside.mkdir()
    (run / "a.f06").write_text("any")
    (beside / "grids.bdf").write_text(GRIDS)
    for bulk in (GRIDS, "INCLUDE 'grids.bdf'\n"):
        (run / "a.bdf").write_text(BULK.format(bulk))
        found = ModesOut("a.f06", RunDeck("a.bdf", {"grids.bdf": beside / "grids.bdf"})).read(run)
        assert found.values[:, 0] == pytest.approx([-2.0, 1.0, 3.0, -5.0, 4.0, 6.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        assert found.notes == ("motions of 1 point turned to basic axes by the deck",)
    (run / "a.bdf").write_text(BULK.format(GRIDS.replace(",7\n", "\n")))
    found = ModesOut("a.f06", RunDeck("a.bdf", {})).read(run)
    assert found.values[:6, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert found.notes == ()


def test_a_deck_that_does_not_tell_axes_leaves_the_note(tmp_path, monkeypatch):
    (tmp_path / "a.pch").write_text("any")
    monkeypatch.setattr(outputs, "nastran_modes", lambda path: PrintedModes([_printed()]))
    for text in ("print('a script')\n", BULK.format("")):
        (tmp_path / "a.bdf").write_text(text)
        found = ModesOut("a.pch", RunDeck("a.bdf", {})).read(tmp_path)
        assert "taken as basic" in found.notes[0]
        assert found.values[0, 0] == 1.0


@pytest.mark.parametrize(
    "text, words",
    [
        (BULK.format("GRID,9,,0.,2.,0.,7\n"), "has no GRID 4, which a.pch prints; name the deck of that run"),
        (BULK.format("PARAM,OUGCORD,7\n" + GRIDS), r"asks for motions in system 7 \(PARAM,OUGCORD\); leave it out"),
        (BULK.format(GRIDS + "INCLUDE 'lost.bdf'\n"), "the included file cannot be read"),
        (BULK.format(GRIDS.replace(",7\n", ",8\n")), "coordinate system 8 is not in the file"),
    ],
)
def test_a_deck_that_does_not_tell_the_axes_of_its_points_is_refused(tmp_path, monkeypatch, text, words):
    (tmp_path / "a.pch").write_text("any")
    (tmp_path / "a.bdf").write_text(text)
    monkeypatch.setattr(outputs, "nastran_modes", lambda path: PrintedModes([_printed()]))
    with pytest.raises(FileError, match=words):
        ModesOut("a.pch", RunDeck("a.bdf", {})).read(tmp_path)


@pytest.mark.parametrize("card", ["PARAM,OUGCORD,BASIC", "PARAM*,OUGCORD,BASIC", "PARAM*  OUGCORD         BASIC"])
def test_motions_in_the_basic_system_are_not_turned_again(tmp_path, monkeypatch, card):
    """A file that states systems is that of MYSTRAN, which passes over the parameter."""
    (tmp_path / "a.f06").write_text("any")
    (tmp_path / "a.bdf").write_text(BULK.format(card + "\n" + GRIDS))
    for system, first, notes in ((-1, 1.0, 0), (7, -1.0, 1)):
        modes = PrintedModes([_printed(systems=np.array([system]))])
        monkeypatch.setattr(outputs, "nastran_modes", lambda path, modes=modes: modes)
        found = ModesOut("a.f06", RunDeck("a.bdf", {})).read(tmp_path)
        assert found.values[0, 0] == pytest.approx(first)
        assert len(found.notes) == notes


def test_punched_frfs_are_turned_to_basic_axes(tmp_path):
    rows = ["1.0 2.0 3.0", "4.0 5.0 6.0", "0.1 0.2 0.3", "0.4 0.5 0.6"]
    point = f"         4       G      {rows[0]}\n" + "".join(f"-CONT-  {row}\n" for row in rows[1:])
    head = "$TITLE   = A\n$DISPLACEMENTS\n$REAL-IMAGINARY OUTPUT\n$SUBCASE ID =           1\n$FREQUENCY =   5.0\n"
    (tmp_path / "a.pch").write_text(head + point)
    (tmp_path / "a.bdf").write_text(BULK.format(GRIDS))
    outputs_wanted, load = tuple(Dof(4, direction) for direction in "XYZ"), (Dof(5, "X"),)
    out = FrfsOut("a.pch", np.array([5.0]), outputs_wanted, load, load)
    assert out.read(tmp_path)[0, :, 0] == pytest.approx([1 + 0.1j, 2 + 0.2j, 3 + 0.3j])
    assert "taken as basic" in out.notes(tmp_path)[0]
    with_deck = replace(out, deck=RunDeck("a.bdf", {}))
    (tmp_path / "a.bdf").write_text(BULK.format("SPOINT,9\n" + GRIDS))
    scalar = point.replace("         4       G", "         9       S")
    for points in (point, point + scalar):
        (tmp_path / "a.pch").write_text(head + points)
        assert with_deck.read(tmp_path)[0, :, 0] == pytest.approx([-2 - 0.2j, 1 + 0.1j, 3 + 0.3j])
        assert with_deck.notes(tmp_path) == ("motions of 1 point turned to basic axes by the deck",)
    (tmp_path / "a.pch").write_text(head + scalar)
    with pytest.raises(FileError, match="holds no motions of grid points; punch them"):
        with_deck.read(tmp_path)
    (tmp_path / "a.pch").write_text(head + point)
    load = (Dof(4, "X"),)
    for card in ("", "PARAM,OUGCORD,BASIC\n"):
        (tmp_path / "a.bdf").write_text(BULK.format(card + GRIDS))
        with pytest.raises(
            FileError, match=r"load 4X\S* acts at node 4, .* \(field 7 of GRID\), .*; leave that field empty"
        ):
            replace(with_deck, inputs=load, loads=load).read(tmp_path)
    assert with_deck.read(tmp_path)[0, :, 0] == pytest.approx([1 + 0.1j, 2 + 0.2j, 3 + 0.3j])
    (tmp_path / "a.bdf").write_text(BULK.format(GRIDS.replace(",7\n", "\n")))
    assert replace(with_deck, inputs=load, loads=load).read(tmp_path).any()
    assert with_deck.notes(tmp_path) == ()
