"""No command takes code or settings from the folder in which it is called."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from fuzz.hostile import SETTINGS, recording_environment, write_good_study, write_modules  # noqa: E402

from structid.core.isolation import child_environment, import_paths, isolated, paths_as_called  # noqa: E402

COMMAND = Path(sys.executable).with_name("structid")
pytestmark = pytest.mark.skipif(not COMMAND.exists(), reason="the command is not installed beside Python")


@pytest.fixture
def hostile(tmp_path):
    """A folder with a good study among modules, and a folder beside it from which every process records what it opens."""
    folder, beside = tmp_path / "hostile", tmp_path / "beside"
    folder.mkdir()
    beside.mkdir()
    write_good_study(folder / "good.toml")
    write_modules(folder)
    return folder, *recording_environment(folder, beside)


def call(folder: Path, environment: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    given = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg", **environment}
    return subprocess.run([COMMAND, *words], cwd=folder, env=given, capture_output=True, text=True, check=False)


def opened_paths(log: Path) -> set[str]:
    """First parts of the paths in the folder that some process opened."""
    return {line.split("/")[0] for line in log.read_text(encoding="utf-8").splitlines()}


def test_no_module_and_no_setting_of_the_folder_is_read(hostile):
    folder, log, environment = hostile
    done = call(folder, environment, "identify", "good.toml", "--workers", "2", "--png", "--no-explain", "--out", "out")
    assert done.returncode == 0, done.stderr
    assert "out/report.html" in done.stdout.splitlines()
    assert (folder / "out" / "estimate.json").is_file()
    seen = opened_paths(log)
    assert {"good.toml", "frf.npz"} <= seen  # the recorder works
    assert not seen & {*SETTINGS, "harmed", "structid"}
    assert not [name for name in seen if name.endswith((".py", ".pyc", "__pycache__"))]


def test_the_recorder_sees_what_python_itself_takes_from_the_working_directory(hostile):
    folder, log, environment = hostile
    given = {**os.environ, **environment, "PYTHONPATH": environment["PYTHONPATH"]}
    subprocess.run([sys.executable, "-c", "import json"], cwd=folder, env=given, check=True)
    assert "json.py" in opened_paths(log)
    assert "json" in (folder / "harmed").read_text()


def test_children_have_no_working_directory_among_their_places_of_modules(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", ".", str(tmp_path / "lib"), str(tmp_path)]))
    made = child_environment()
    assert made["PYTHONPATH"] == str(tmp_path / "lib")
    assert made["PYTHONSAFEPATH"] == "1"
    assert import_paths(["", ".", "lib", str(tmp_path)], tmp_path) == [str(tmp_path / "lib")]


def test_a_command_works_elsewhere_and_comes_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = list(sys.path), dict(os.environ)
    with isolated():
        assert Path.cwd() == Path(sys.prefix)
        assert str(tmp_path) not in sys.path
        assert os.environ["PYTHONSAFEPATH"] == "1"
    assert (list(sys.path), dict(os.environ)) == before
    assert Path.cwd() == tmp_path
    text = f"{tmp_path}/a.toml, line 3: see {tmp_path}/b and /other{tmp_path}/c; in {tmp_path}: no, {tmp_path}x/d"
    assert paths_as_called(text) == f"a.toml, line 3: see b and /other{tmp_path}/c; in .: no, {tmp_path}x/d"
