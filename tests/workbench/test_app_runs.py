"""Runs go on without page and server; stopped and killed ones are told and resumed to the same digits."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from app_cases import ENVIRONMENT, ROOT, require_workbench, served, write_beam_record

require_workbench()

from structid.core.errors import InputError  # noqa: E402
from structid.core.isolation import start_child  # noqa: E402
from structid.study.templates import TEMPLATES, template_with, write_study  # noqa: E402
from structid.workbench.folder import open_study_folder  # noqa: E402
from structid.workbench.runs import Run, Runs  # noqa: E402

_PATIENCE = 240.0


def written(folder: Path) -> Path:
    """The folder with a beam's study and record."""
    write_study(template_with(TEMPLATES["beam"], {"elements": 4}), folder / "beam.toml")
    write_beam_record(folder / "beam.toml", folder / "frf.npz", ("3Y+", "5Y+"), ("3Y+", "5Y+"))
    with (folder / "beam.toml").open("a", encoding="utf-8") as stream:
        stream.write('\n[record]\npath = "frf.npz"\n\n[method]\nintervals = "bootstrap"\n')
    return folder


@pytest.fixture
def folder(tmp_path):
    return written(tmp_path)


@pytest.fixture(scope="module")
def open_folder(tmp_path_factory):
    """A folder and its workbench, for tests that start no run and leave the study readable."""
    folder = written(tmp_path_factory.mktemp("open"))
    with served(folder) as bench:
        yield folder, bench


def wait_for(holds, words: str):
    """What `holds()` gives once it is true."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        found = holds()
        if found:
            return found
        time.sleep(0.1)
    raise AssertionError(f"not within {_PATIENCE} s: {words}")


def state(bench, run: str) -> str:
    return bench.get(f"runs/{run}")[1]["state"]


def processes(folder: Path, run: str) -> list[psutil.Process]:
    told = json.loads((folder / ".structid" / "runs" / run / "run.json").read_text())
    try:
        runner = psutil.Process(told["pid"])
        return [*runner.children(recursive=True), runner]
    except psutil.NoSuchProcess:
        return []


@pytest.mark.long
def test_a_run_outlives_the_server_and_a_killed_one_is_resumed(folder):
    with served(folder) as bench:
        run = bench.post("runs", {"study": "beam.toml", "results": "first"})[1]["id"]
        wait_for(lambda: bench.get(f"runs/{run}")[1]["lines"], "progress")
        status, found = bench.post("runs", {"study": "beam.toml", "results": "first"})
        assert status == 422
        assert "writes to first already" in found["error"]
        bench.post(f"runs/{run}/pause", {})
        wait_for(lambda: state(bench, run) == "paused", "paused")
    assert processes(folder, run)  # the server has ended, the run has not
    with served(folder) as bench:
        assert state(bench, run) == "paused"
        bench.post(f"runs/{run}/continue", {})
        wait_for(
            lambda: (
                (folder / "first.checkpoint" / "run.json").exists() or (folder / "first" / "estimate.json").exists()
            ),
            "checkpoint",
        )
        for process in processes(folder, run):
            process.kill()
        wait_for(lambda: state(bench, run) in ("killed", "done"), "killed")
        if not (folder / "first" / "estimate.json").exists():  # else its results were whole before it was killed
            assert bench.get(f"runs/{run}")[1]["can_resume"]
            run = bench.post("runs", {"study": "beam.toml", "results": "first", "resume": True})[1]["id"]
            wait_for(lambda: state(bench, run) == "done", "done")
        assert bench.get("results", results="first")[1]["results"]["verdict"] == "sound"
    words = [sys.executable, "-m", "structid", "identify", str(folder / "beam.toml"), "--out", str(folder / "whole")]
    subprocess.run(words, env=ENVIRONMENT, check=True, capture_output=True)
    values = [json.loads((folder / name / "estimate.json").read_text())["parameters"] for name in ("first", "whole")]
    assert values[0] == values[1]


def test_a_run_is_stopped_as_by_ctrl_c(folder):
    with served(folder) as bench:
        run = bench.post("runs", {"study": "beam.toml", "results": "r"})[1]["id"]
        wait_for(lambda: bench.get(f"runs/{run}")[1]["lines"], "progress")
        bench.post(f"runs/{run}/stop", {})
        wait_for(lambda: state(bench, run) in ("stopped", "done"), "stopped")
        if state(bench, run) == "stopped":
            assert "go on with" in bench.get(f"runs/{run}")[1]["log"]
        status, found = bench.post(f"runs/{run}/stop", {})
        assert (status, found["error"]) == (422, "this run has ended already")


def test_a_study_that_cannot_run_is_told_with_its_line(folder):
    text = (folder / "beam.toml").read_text().replace('property = "loss_factor"', 'property = "lost_factor"')
    (folder / "beam.toml").write_text(text)
    with served(folder) as bench:
        run = bench.post("runs", {"study": "beam.toml", "results": "r"})[1]["id"]
        wait_for(lambda: state(bench, run) == "unusable", "unusable")
        assert "line " in bench.get(f"runs/{run}")[1]["log"]


def test_a_changed_study_is_not_overwritten(open_folder):
    folder, bench = open_folder
    before = bench.get("study", study="beam.toml")[1]
    (folder / "beam.toml").write_text(before["text"] + "# by hand\n")
    edit = {"study": "beam.toml", "digest": before["digest"], "edits": [{"set": ["title"], "to": '"mine"'}]}
    status, found = bench.post("edit", edit)
    assert status == 409
    assert "was changed by another" in found["error"]
    assert (folder / "beam.toml").read_text().endswith("# by hand\n")
    now = bench.get("study", study="beam.toml")[1]
    status, found = bench.post("edit", {**edit, "digest": now["digest"]})
    assert status == 200
    assert (folder / "beam.toml").read_text() == found["text"]
    assert found["text"].endswith("# by hand\n")


def test_a_new_study_without_a_suffix_is_listed(open_folder):
    _, bench = open_folder
    assert bench.post("init", {"template": "beam", "path": "shelf", "numbers": {}}) == (200, {"path": "shelf.toml"})
    assert [one["path"] for one in bench.get("folder")[1]["studies"]] == ["beam.toml", "shelf.toml"]


def test_a_file_in_the_way_of_the_results_is_told_before_the_run(open_folder):
    _, bench = open_folder
    status, found = bench.post("runs", {"study": "beam.toml", "results": "beam.toml/first"})
    assert status == 422
    assert "beam.toml: is a file; give another folder" in found["error"]
    assert bench.get("folder")[1]["runs"] == []


def test_ctrl_c_ends_open_pages_and_questions_without_a_word(folder):
    with served(folder) as bench, ExitStack() as open_sockets:
        for question in ("events", "plan?study=beam.toml"):
            asking = open_sockets.enter_context(socket.create_connection(("127.0.0.1", bench.port)))
            asking.sendall(
                f"GET /{bench.token}/api/{question} HTTP/1.1\r\nHost: 127.0.0.1:{bench.port}\r\n\r\n".encode()
            )
        time.sleep(1)
        bench.process.send_signal(signal.SIGINT)
        said = bench.process.communicate(timeout=600)[0]
        assert said.strip() in ("", "(this machine only; Ctrl-C ends it, runs go on)")  # the rest of its first words
        assert bench.process.returncode == 0


def test_a_folder_that_cannot_be_written_is_told(folder):
    folder.chmod(0o555)
    try:
        if os.access(folder, os.W_OK):
            pytest.skip("this user may write everywhere")
        with served(folder) as bench:
            assert bench.get("folder")[1]["writable"] is False
            assert bench.post("runs", {"study": "beam.toml", "results": "r"})[0] == 422
    finally:
        folder.chmod(0o755)


def test_a_port_that_is_taken_is_told(folder):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        words = [
            sys.executable,
            "-m",
            "structid",
            "app",
            str(folder),
            "--no-browser",
            "--port",
            str(taken.getsockname()[1]),
        ]
        done = subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 2
    assert "give another one with --port" in done.stderr
    assert "Traceback" not in done.stderr


def test_no_folder_is_told(tmp_path):
    words = [sys.executable, "-m", "structid", "app", str(tmp_path / "nothing"), "--no-browser"]
    done = subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 2
    assert "is no folder" in done.stderr


@pytest.mark.long
def test_a_worker_that_is_killed_is_begun_anew(tmp_path):
    shutil.copy(ROOT / "examples" / "first_structure" / "study.toml", tmp_path)
    shutil.copy(ROOT / "examples" / "first_structure" / "record.csv", tmp_path)
    with served(tmp_path) as bench:
        assert bench.get("scene", study="study.toml")[0] == 200
        for child in psutil.Process(bench.process.pid).children(recursive=True):
            child.kill()
        time.sleep(0.5)
        found = [bench.get("channels", study="study.toml") for _ in range(2)]
        assert found[-1][0] == 200
        assert {one["name"] for one in found[-1][1]["channels"]} == {"2Y+", "3Y+", "4Y+"}


def test_the_first_lines_of_a_table_are_shown_as_they_stand(open_folder):
    folder, bench = open_folder
    (folder / "lab.csv").write_bytes("Träger 12\nZeit;Kraft\n0,1;2\n".encode("cp1252") * 9)
    assert bench.post("lines", {"record": "lab.csv", "encoding": "cp1252"}) == (
        200,
        {"lines": ["Träger 12", "Zeit;Kraft", "0,1;2"] * 4},
    )
    status, answer = bench.post("lines", {"record": "lab.csv", "encoding": "klingon"})
    assert (status, answer["error"]) == (422, "there is no encoding 'klingon'; write utf-8, cp1252 or utf-16")
    assert bench.post("lines", {"record": "../lab.csv"})[0] == 403
    status, answer = bench.post("lines", {"record": "gone.csv"})
    assert (status, answer["error"]) == (422, "gone.csv: is not there any more; put it back, or choose another record")


def test_progress_goes_on_where_it_was_read_to(tmp_path):
    (tmp_path / "progress.jsonl").write_text('{"words": "a"}\n{"words": "b"}\n{"words"', encoding="utf-8")
    run = Run(open_study_folder(tmp_path), tmp_path)
    for after, words in ((-3, ["a", "b"]), (0, ["a", "b"]), (15, ["b"]), (30, []), (99, [])):
        found = run.progress(after)
        assert [one["words"] for one in found["lines"]] == words
        assert found["at"] == max(after, 30)


def test_the_time_for_causes_goes_to_the_command(folder, monkeypatch):
    """The page's time limit and its wish to search on are options of the command that the run executes."""
    commands, children = [], []

    def recorded(command, **given):
        commands.append(command)
        children.append(start_child([sys.executable, "-c", ""], **given))
        return children[-1]

    monkeypatch.setattr("structid.workbench.runs.start_child", recorded)
    runs = Runs(open_study_folder(folder))
    runs.start("beam.toml", "a")
    runs.start("beam.toml", "b", seconds=90.0, explain=True)
    assert not {"--seconds", "--explain"} & set(commands[0])
    assert commands[1][-3:] == ["--seconds", "90", "--explain"]
    with pytest.raises(InputError, match="at least 0 s"):
        runs.start("beam.toml", "c", seconds=-1.0)
    assert len(commands) == 2
    for child in children:
        child.wait()
