"""Modes that a solver wrote in a file of any format."""

import numpy as np
import pytest

from structid.core.errors import FileError
from structid.external import outputs
from structid.external.outputs import read_shapes
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
