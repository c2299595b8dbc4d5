"""Modes beside the model of the open study, and set-ups merged, as the page asks for them; checked against plain algebra."""

from __future__ import annotations

import json

import numpy as np
import pytest
from app_cases import STOREYS, require_workbench, served

from modes_cases import write_ambient

require_workbench()

from structid.core.errors import InputError  # noqa: E402
from structid.modal import ModalRecord  # noqa: E402
from structid.modal.formats.files import read_modes, write_modes  # noqa: E402
from structid.modal.merging import merge_modes  # noqa: E402
from structid.study.templates import TEMPLATES, template_with, write_study  # noqa: E402
from structid.workbench.folder import upload_name  # noqa: E402


def storeys(stiffness: float = 1.6e6):
    """Frequencies and shapes of three equal storeys, by numpy alone."""
    matrix = stiffness * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    square, shapes = np.linalg.eigh(matrix / 5000.0)
    return np.sqrt(square) / (2 * np.pi), shapes


@pytest.fixture
def folder(tmp_path):
    write_study(template_with(TEMPLATES["shear-building"], STOREYS), tmp_path / "storeys.toml")
    return tmp_path


def measured(folder, name: str, channels=("1X+", "2X+", "3X+"), stiffness=1.6e6, turned=1.0):
    frequency, shapes = storeys(stiffness)
    rows = [("1X", "2X", "3X").index(channel.rstrip("+-")) for channel in channels]
    (folder / name).mkdir()
    modes = ModalRecord(frequency, [0.01] * 3, turned * shapes[rows], channels)
    write_modes(folder / name / "modes.json", modes)
    return modes


def test_saved_modes_stand_beside_the_model(folder):
    modes = measured(folder, "stiff", stiffness=2.0e6)
    ask = {"study": "storeys.toml", "number": 0, "measured": "stiff/modes.json", "at": ""}
    with served(folder) as bench:
        status, found = bench.post("beside", ask)
        assert status == 200, found
        np.testing.assert_allclose(found["model"], storeys()[0], rtol=1e-9)
        np.testing.assert_allclose(found["frequency"], modes.frequency)
        np.testing.assert_allclose(found["mac"], np.eye(3), atol=1e-12)
        assert found["pair"] == [0, 1, 2]
        np.testing.assert_allclose(found["difference"], np.sqrt(1.6 / 2.0) - 1, rtol=1e-9)
        status, found = bench.post("beside", {**ask, "measured": "../modes.json"})
        assert status == 422
        assert "no path inside the open folder" in found["error"]
        status, found = bench.post("beside", {**ask, "at": "stiff"})
        assert status == 422
        assert "estimate.h5" in found["error"]


@pytest.mark.long
def test_modes_that_are_not_saved_yet_and_channels_under_other_names(folder):
    frequency, shapes = storeys()
    text = (folder / "storeys.toml").read_text(encoding="utf-8")
    (folder / "storeys.toml").write_text(
        text + '[record]\npath = "r.npz"\nrelabel = { "7X" = "2X-" }\n', encoding="utf-8"
    )
    turned = shapes * np.array([[1.0], [-1.0], [1.0]])
    given = {"frequency": frequency.tolist(), "damping": [0.01] * 3, "shapes": turned.T.tolist()}
    ask = {"study": "storeys.toml", "number": 0, "at": "", "measured": {**given, "channels": ["1X+", "7X+", "3X+"]}}
    with served(folder) as bench:
        found = bench.post("beside", ask)[1]
        np.testing.assert_allclose(np.diag(found["mac"]), 1.0, rtol=1e-9)
        status, found = bench.post("beside", {**ask, "measured": {**given, "channels": ["1X+", "8X+", "3X+"]}})
        assert status == 422
        assert "8X" in found["error"]


def test_files_of_modes_are_merged_as_the_library_merges_them(folder):
    parts = [
        measured(folder, "lower", ("1X+", "2X+"), turned=3.0),
        measured(folder, "upper", ("2X+", "3X+"), turned=-0.2),
    ]
    ask = {"records": ["lower/modes.json", "upper/modes.json"], "options": {}, "out": "merged", "band": None}
    with served(folder) as bench:
        status, found = bench.post("merge", ask)
        assert status == 200, found
        assert found["channels"] == ["1X+", "2X+", "3X+"]
        assert found["path"] == "merged/modes.json"
        np.testing.assert_allclose(found["setups"], np.column_stack([storeys()[0]] * 2))
        beside = {"study": "storeys.toml", "number": 0, "measured": "merged/modes.json", "at": ""}
        np.testing.assert_allclose(np.diag(bench.post("beside", beside)[1]["mac"]), 1.0, rtol=1e-9)
        assert "merged/modes.json" in [one["path"] for one in bench.get("folder")[1]["records"]]
        status, one = bench.post("merge", {**ask, "records": ["lower/modes.json"], "out": "alone"})
        assert (status, "two set-ups or more" in one["error"]) == (422, True)
        assert bench.post("merge", ask)[0] == 409  # what is there stays
        assert bench.post("merge", {**ask, "replace": True})[0] == 200
        status, found = bench.post("merge", {**ask, "records": ["lower/modes.json"], "replace": True})
        assert (status, list(found)) == (422, ["error"])  # the report of the earlier merge is not that of this one
        assert bench.post("merge", {**ask, "out": "../merged"})[0] == 403
        assert not (folder.parent / "merged").exists()
    kept = read_modes(folder / "merged" / "modes.json")
    np.testing.assert_array_equal(kept.mode_shapes, merge_modes(parts).mode_shapes)


def test_files_of_modes_are_known_by_what_they_hold(folder):
    """Whatever they are called; copies of modes.json in other formats and other JSON are no records."""
    measured(folder, "found")
    (folder / "found" / "modes.json").rename(folder / "found" / "tower_2023.json")
    write_ambient(folder / "a.h5")
    (folder / "other.json").write_text('{"title": "x", "modal_records": [{"frequency_hz": 1}]}', encoding="utf-8")
    with served(folder) as bench:
        pick = {"record": "a.h5", "options": {}, "frequencies": [1.27, 3.55], "out": "a_modes", "band": None}
        assert bench.post("pick", pick)[0] == 200
        listed = [one["path"] for one in bench.get("folder")[1]["records"]]
    assert listed == ["a.h5", "a_modes/modes.json", "found/tower_2023.json"]


@pytest.mark.long
def test_all_files_that_readers_know_are_listed_and_taken(folder):
    for name in ("a.wav", "b.tsv", "c.f06", "d.pun", "e.full"):
        (folder / name).write_bytes(b"1")
    (folder / "run.txt").write_text("Logger 3\nt;a\n0,0;1,5\n0,1;-2E-3\n", encoding="utf-8")
    (folder / "dofs.txt").write_text("1X\n2X\n", encoding="utf-8")
    (folder / "notes.txt").write_text("Measured on 3 May 2024 by 2 people\n", encoding="utf-8")
    (folder / "modes.csv").write_text("Frequency [Hz];Damping [%];1X\n3,1;1;1\n", encoding="utf-8")
    (folder / "frf.csv").write_text("frequency_hz,1X+/3X+ re,1X+/3X+ im\n1,2,3\n", encoding="utf-8")
    (folder / "k.pch").write_text("$TITLE   = MODES\n$EIGENVALUE =  0.1E+01  MODE =  1\n", encoding="utf-8")
    shapes = ModalRecord([2.0, 5.0], [0.01, 0.02], [[1.0, 0.4], [0.5, -1.0]], ["1X", "2X"])
    write_modes(folder / "shapes.uff", shapes)
    with served(folder) as bench:
        found = bench.get("folder")[1]
        told = bench.post("facts", {"record": "modes.csv", "options": {}})[1]
    assert {one["path"]: one["modes"] for one in found["records"]} == {
        "a.wav": False, "b.tsv": False, "c.f06": True, "frf.csv": False, "k.pch": True, "modes.csv": True, "run.txt": False,
        "shapes.uff": True,
    }  # fmt: skip
    assert [one["path"] for one in found["models"]] == ["d.pun", "e.full"]
    assert (told["kind"], told["modes"]) == ("modes", [[3.1, 0.01]])
    assert [upload_name(name) for name in ("a.wav", "b.tsv", "c.f06", "e.full")] == [
        "a.wav",
        "b.tsv",
        "c.f06",
        "e.full",
    ]


@pytest.mark.long
def test_records_of_set_ups_are_merged_with_a_page(folder):
    """Two records of two sensors, seeds 5 and 6, with the first floor in common."""
    write_ambient(folder / "a.h5", ("1X+", "2X+"), 5)
    write_ambient(folder / "b.h5", ("1X+", "3X+"), 6)
    measured(folder, "saved")
    ask = {"records": ["a.h5", "b.h5"], "options": {}, "out": "both", "band": None}
    with served(folder) as bench:
        status, found = bench.post("merge", ask)
        assert status == 200, found
        assert found["page"].startswith("/view/")
        beside = {"study": "storeys.toml", "number": 0, "measured": "both/modes.json", "at": ""}
        told = bench.post("beside", beside)[1]
        assert np.diag(told["mac"]).min() > 0.98
        assert np.abs(told["difference"]).max() < 0.01
        status, found = bench.post("merge", {**ask, "records": ["a.h5", "saved/modes.json"], "out": "mixed"})
        assert (status, "save the modes of each record" in found["error"]) == (422, True)
    assert json.loads((folder / "both" / "modes.json").read_text())["channels"] == ["1X+", "2X+", "3X+"]


def test_no_modes_are_told():
    from structid.workbench.work.modes import posted_modes

    with pytest.raises(InputError, match="no mode is taken"):
        posted_modes({"frequency": []})
