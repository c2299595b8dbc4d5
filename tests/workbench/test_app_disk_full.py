"""A full disk is told in words, and nothing is lost or half written: studies, dropped files, new studies, modes, runs."""

from __future__ import annotations

import errno
import json
import os
import time
from pathlib import Path

import psutil
import pytest
from app_cases import filling_disk, require_workbench, served, write_beam_record

from modes_cases import write_ambient

require_workbench()

from structid.core.errors import FileError  # noqa: E402
from structid.study.templates import TEMPLATES, template_with, write_study  # noqa: E402
from structid.workbench.folder import open_study_folder  # noqa: E402

_PATIENCE = 240.0


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "work"
    made.mkdir()
    write_study(template_with(TEMPLATES["beam"], {"elements": 4}), made / "beam.toml")
    write_beam_record(made / "beam.toml", made / "frf.npz", ("3Y+", "5Y+"), ("3Y+", "5Y+"))
    with (made / "beam.toml").open("a", encoding="utf-8") as stream:
        stream.write('\n[record]\npath = "frf.npz"\n\n[method]\nintervals = "bootstrap"\n')
    return made


def content(folder: Path) -> dict[str, bytes]:
    """Every file but those that the workbench keeps for itself."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and ".structid" not in path.parts
    }


def test_studies_files_and_modes_stay_as_they_were(folder, tmp_path):
    marker, environment = filling_disk(tmp_path)
    write_ambient(folder / "ambient.h5")
    before = content(folder)
    with served(folder, environment=environment) as bench:
        now = bench.get("study", study="beam.toml")[1]
        marker.touch()
        asked = {"study": "beam.toml", "digest": now["digest"]}
        pick = {"record": "ambient.h5", "options": {}, "frequencies": [1.27], "out": "picked", "band": None}
        answers = [
            bench.post("edit", {**asked, "edits": [{"set": ["title"], "to": '"mine"'}]}),
            bench.post("study", {**asked, "text": now["text"] + "# more\n"}),
            bench.post("study", {"study": "new.toml", "digest": "", "text": "a = 1\n"}),
            bench.post("init", {"template": "beam", "path": "other.toml", "numbers": {}}),
            bench.post("pick", pick),
        ]
        status, _, body = bench.ask("PUT", "/api/file?name=dropped.csv", b"a,b\n1,2\n")
        answers.append((status, json.loads(body)))
        for status, found in answers:
            assert status in (422, 507), found
            assert "No space left on device" in found["error"]
            assert "free disk space" in found["error"]
        assert content(folder) == before
        marker.unlink()
        status, found = bench.post("edit", {**asked, "edits": [{"set": ["title"], "to": '"mine"'}]})
        assert status == 200
        assert found["text"] == now["text"].replace('title = "Beam clamped at its left end"', 'title = "mine"')


def test_a_run_that_cannot_be_written_down_is_not_left_running(folder, tmp_path):
    marker, environment = filling_disk(tmp_path)
    open_study_folder(folder).data_folder("runs")
    with served(folder, environment=environment) as bench:
        marker.touch()
        before = content(folder)
        status, found = bench.post("runs", {"study": "beam.toml", "results": "first"})
        assert status == 422
        assert "No space left on device" in found["error"]
        assert bench.get("folder")[1]["runs"] == []
        assert not list((folder / ".structid" / "runs").iterdir())
        running = [one.cmdline() for one in psutil.Process(bench.process.pid).children(recursive=True)]
        assert not any("structid.workbench.runner" in words for words in running)
    assert content(folder) == before


@pytest.mark.long
def test_a_run_whose_results_find_no_room_is_told_and_resumed(folder, tmp_path):
    marker, environment = filling_disk(tmp_path)
    (folder / "first").mkdir()
    (folder / "first" / "mine.txt").write_text("kept", encoding="utf-8")
    with served(folder, environment=environment) as bench:
        asked = {"study": "beam.toml", "results": "first", "replace": True}
        run = bench.post("runs", asked)[1]["id"]
        wait_for(lambda: bench.get(f"runs/{run}")[1]["lines"], "progress")
        marker.touch()
        wait_for(lambda: bench.get(f"runs/{run}")[1]["state"] not in ("running", "paused"), "end")
        found = bench.get(f"runs/{run}")[1]
        assert found["state"] == "disk_full"
        assert "No space left on device" in found["log"]
        assert "free disk space" in found["log"]
        assert not found["has_results"]
        assert {path.name for path in (folder / "first").iterdir()} == {"mine.txt"}
        marker.unlink()
        run = bench.post("runs", {**asked, "resume": found["can_resume"]})[1]["id"]
        wait_for(lambda: bench.get(f"runs/{run}")[1]["state"] == "done", "done")
        assert bench.get("results", results="first")[1]["results"]["verdict"] == "sound"
    assert (folder / "first" / "mine.txt").read_text(encoding="utf-8") == "kept"


def test_what_was_written_in_part_is_taken_away(folder, monkeypatch):
    place, name = open_study_folder(folder), "beam.toml"
    text, mark = place.text(name)

    def cut(self, raw):
        with self.open("wb") as stream:
            stream.write(raw[:10])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = content(folder)
    monkeypatch.setattr(Path, "write_bytes", cut)
    with pytest.raises(FileError, match=r"beam\.toml: cannot be written \(No space left on device\); free disk space"):
        place.save(name, text + "# more\n", mark)
    assert content(folder) == before


def wait_for(holds, words: str) -> None:
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        if holds():
            return
        time.sleep(0.1)
    raise AssertionError(f"not within {_PATIENCE} s: {words}")
