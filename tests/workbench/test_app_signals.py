"""Looks into long records: least and greatest of stretches, from the file, from its overview, and by samples."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from app_cases import write_beam_record

from structid.core.errors import FileError, InputError
from structid.records import ReadOptions
from structid.study.templates import TEMPLATES, template_with, write_study
from structid.workbench.work import signals
from structid.workbench.work.functions import answer_json
from structid.workbench.work.signals import BIN, facts, histories, overview_path, write_overview

OPTIONS = ReadOptions(sampling_rate=100.0, channels=("1X", "2X"), quantities=("acceleration",))
N = 100_003  # no whole number of stretches


def row(text: str, kind=np.float32) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


@pytest.fixture
def long(tmp_path, monkeypatch):
    """A record that counts as long, with one sample that stands out."""
    values = np.random.default_rng(4).standard_normal((N, 2))
    values[77_777, 1] = 50.0
    np.save(tmp_path / "long.npy", values)
    monkeypatch.setattr(signals, "_LARGE", 1000)
    monkeypatch.setattr(signals, "_READ", 5000)
    return tmp_path / "long.npy", values


def test_the_overview_has_the_least_and_greatest_of_every_stretch(long, tmp_path):
    path, values = long
    first = histories(path, OPTIONS, 0.0, None, 400, tmp_path)
    assert first["sampled"]
    write_overview(path, OPTIONS, tmp_path)
    found = histories(path, OPTIONS, 0.0, None, 400, tmp_path)
    assert not found["sampled"]
    starts = np.rint(row(found["time"], np.float64) * 100).astype(int)
    assert (np.diff(starts) % BIN == 0).all()
    for channel in (0, 1):
        low, high = (turn.reduceat(values[:, channel], starts) for turn in (np.minimum, np.maximum))
        np.testing.assert_allclose(row(found["low"][channel]), low, rtol=1e-6)
        np.testing.assert_allclose(row(found["high"][channel]), high, rtol=1e-6)
    assert row(found["high"][1]).max() == 50.0
    part = histories(path, OPTIONS, 100.0, 777.8, 400, tmp_path)  # its last stretch is not over at the end of the range
    assert row(part["high"][1]).max() == 50.0
    assert row(part["time"], np.float64)[0] == pytest.approx(100.0, abs=BIN / 100)


def test_a_zoom_into_few_samples_reads_them(long, tmp_path):
    path, values = long
    found = histories(path, OPTIONS, 777.0, 778.5, 1000, tmp_path)
    starts = np.rint(row(found["time"], np.float64) * 100).astype(int)
    assert starts[0] == 77_700
    np.testing.assert_allclose(row(found["low"][1]), values[starts, 1], rtol=1e-6)
    assert row(found["high"][1])[77] == 50.0


def test_the_overview_belongs_to_the_file_as_it_is(long, tmp_path):
    path, values = long
    write_overview(path, OPTIONS, tmp_path)
    before = overview_path(path, OPTIONS, tmp_path)
    np.save(path, 2 * values)
    assert overview_path(path, OPTIONS, tmp_path) != before
    assert histories(path, OPTIONS, 0.0, None, 400, tmp_path)["sampled"]


def test_a_record_that_is_gone_is_told(long, tmp_path):
    path, _ = long
    histories(path, OPTIONS, 0.0, None, 400, tmp_path)
    path.unlink()
    with pytest.raises(FileError, match="was moved or removed while it was open"):
        histories(path, OPTIONS, 0.0, None, 400, tmp_path)


def test_what_a_bare_file_lacks_is_told(tmp_path):
    np.save(tmp_path / "bare.npy", np.zeros((100, 2)))
    with pytest.raises(InputError, match="how fast it was sampled"):
        facts(tmp_path / "bare.npy", ReadOptions())


def test_faults_of_signals_are_told(tmp_path):
    values = np.random.default_rng(4).standard_normal((4000, 2)) * [1.0, 0.0]
    np.save(tmp_path / "dead.npy", values)
    found = facts(tmp_path / "dead.npy", OPTIONS)
    assert [one["words"] for one in found["findings"] if "0 at every sample" in one["words"]]
    assert found["seconds"] == 40.0


def test_a_record_is_shown_where_the_file_of_another_one_is_missing(tmp_path):
    write_study(template_with(TEMPLATES["beam"], {}), tmp_path / "beam.toml")
    write_beam_record(tmp_path / "beam.toml", tmp_path / "here.npz", ("13Y+",), ("13Y+",))
    records = '[[record]]\npath = "gone.npz"\n\n[[record]]\npath = "here.npz"\n\n[method]\nband = [5.0, 90.0]\n'
    with (tmp_path / "beam.toml").open("a", encoding="utf-8") as stream:
        stream.write("\n" + records)

    def asked(number: int) -> dict:
        given = {"study": "beam.toml", "outputs": [], "number": number}
        return json.loads(answer_json("responses", str(tmp_path), given))

    found = asked(1)
    assert found["outputs"] == ["13Y+"]
    assert found["band"] == [5.0, 90.0]
    assert "gone.npz" in asked(0)["error"]


def test_a_table_of_a_laboratory_is_read_by_its_columns(tmp_path):
    """As a ``[record]`` says it, the layout of the file included."""
    rows = "".join(f"{k / 50:.2f};{np.sin(k):.6f};{np.cos(k):.6f}\n" for k in range(200)).replace(".", ",")
    (tmp_path / "lab.csv").write_text("Test 12\nt;a;b\n" + rows, encoding="utf-8")
    given = {
        "path": "lab.csv", "columns": ["b"], "time_column": "t", "channels": ["1X"], "quantities": ["acceleration"],
        "axis_unit": "s", "csv": {"skip_rows": 1, "separator": "semicolon", "decimal": "comma"},
    }  # fmt: skip
    found = facts(tmp_path / "lab.csv", signals.options_of(given))
    assert (found["rate"], found["samples"]) == (pytest.approx(50.0), 200)
    assert [one["name"] for one in found["channels"]] == ["1X+"]
