"""A folder as a stranger may send it: listed in a moment, its good study runs, and nothing outside it is read or written."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from app_cases import ENVIRONMENT, require_workbench, served

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
require_workbench()

from fuzz.hostile import (  # noqa: E402
    HOSTILE_LINES,
    processor_seconds,
    recording_environment,
    write_modules,
    write_odd_entries,
)  # fmt: skip
from fuzz.seeds import write_chain  # noqa: E402

from structid.core.errors import FileError  # noqa: E402
from structid.files import _exchange_names, claim_path  # noqa: E402
from structid.files.npy import npz_arrays  # noqa: E402
from structid.modal.formats.csv import is_modes_table  # noqa: E402
from structid.study.results.folder import staged_folder  # noqa: E402
from structid.study.schema.toml_lines import parse_toml  # noqa: E402
from structid.workbench.folder import ChangedError, OutsideError, holds_modes, holds_numbers, open_study_folder  # noqa: E402
from structid.workbench.runs import Runs  # noqa: E402

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links, pipes and devices as POSIX has them")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile") / "folder"
    folder.mkdir()
    assert write_odd_entries(folder) >= 60
    return folder


def wait_until(holds, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.1)


def test_a_hostile_folder_is_listed_in_a_moment(hostile):
    place = open_study_folder(hostile)
    process = psutil.Process()
    before = process.memory_info().rss
    assert processor_seconds(lambda path: open_study_folder(path).listing(), hostile) <= 1.0
    assert process.memory_info().rss - before <= 100e6
    listing = place.listing()
    json.dumps(listing, allow_nan=False).encode("ascii")
    studies = {one["path"]: one for one in listing["studies"]}
    assert studies["good.toml"] == {"path": "good.toml", "title": "Chain of three masses", "broken": ""}
    assert "parts" in studies["dotted.toml"]["broken"]
    assert studies["deep_table.toml"]["broken"]
    reasons = {one["path"]: one["words"] for one in listing["unusable"]}
    assert "leaves the folder" in reasons["secrets.toml"]
    assert "leaves the folder" in reasons["device.csv"]
    assert "broken link" in reasons["dangling.toml"]
    assert "broken link" in reasons["annexed.npz"]
    assert "leads to itself" in reasons["itself.toml"]
    assert "pipe or a device" in reasons["fifo.toml"]
    assert "sign that is not used" in reasons["line\ufffdbreak.toml"]
    assert [name for name in reasons if "Tr" in name and "ger.toml" in name]
    assert not {one["path"] for kind in ("studies", "records", "models") for one in listing[kind]} & set(reasons)


@pytest.mark.parametrize("content", HOSTILE_LINES, ids=range(len(HOSTILE_LINES)))
def test_no_line_of_a_megabyte_holds_the_list_up(content, tmp_path):
    """A linear pattern takes 10 ms at most on a slow machine, one that goes back takes seconds."""
    for suffix in (".txt", ".csv", ".json", ".uff", ".pch"):
        path = tmp_path / f"line{suffix}"
        path.write_bytes(content)
        assert processor_seconds(holds_modes, path) <= 0.1, suffix
        assert processor_seconds(holds_numbers, path) <= 0.1, suffix


def test_a_list_knows_tables_of_numbers_and_of_modes(tmp_path):
    path = tmp_path / "a.txt"
    for text, is_table in (
        ("head\n1,5;2,5\n", True), ("1 2 3\n", True), ("-1.5e-3\t2\n", True), ("1\n2\n", False), ("a 1 2\n", False),
        ("1,2x\n", False),
    ):  # fmt: skip
        path.write_text(text, encoding="utf-8")
        assert holds_numbers(path) is is_table, text
    path = tmp_path / "modes.csv"
    path.write_text("mode;Frequency [Hz];Damping [%]\n1;2,5;1\n", encoding="utf-8")
    assert is_modes_table(path)
    path.write_text("frequency_hz,2.5,3.5\n1X+,1.0,-1.0\n", encoding="utf-8")
    assert is_modes_table(path)
    path.write_text("time,1X+\n0,1\n", encoding="utf-8")
    assert not is_modes_table(path)
    for head in (
        "Frequency [foo],damping [%],1X",
        "Frequency [Hz],damping [foo],1X",
    ):  # one file must not hide a folder
        path.write_text(f"{head}\n1,2,3\n", encoding="utf-8")
        assert not is_modes_table(path)


def test_keys_of_many_parts_are_refused_before_they_take_memory():
    for text in ("a" + ".a" * 20_000 + " = 1", '"a b"' + '."a b"' * 40 + " = 1", "[a" + " . 'x'" * 40 + "]"):
        with pytest.raises(ValueError, match="more than 32 parts"):
            parse_toml(text)
    assert parse_toml("a.b.c = [1.0, 2.5, 3.75]")["a"]["b"]["c"] == [1.0, 2.5, 3.75]


def test_the_good_study_of_a_hostile_folder_is_checked_and_run_and_no_module_of_it_is_read(tmp_path):
    folder, beside = tmp_path / "folder", tmp_path / "beside"
    folder.mkdir()
    beside.mkdir()
    write_odd_entries(folder)
    write_modules(folder)
    log, environment = recording_environment(folder, beside)
    command = [str(Path(sys.executable).with_name("structid")), "app", "--no-browser"]
    process = subprocess.Popen(
        command, cwd=folder, env={**ENVIRONMENT, **environment}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )  # fmt: skip
    try:
        from app_cases import Served

        bench = Served(process.stdout.readline().split()[-1], process)
        status, listing = bench.get("folder")
        assert status == 200
        assert "good.toml" in [one["path"] for one in listing["studies"]]
        assert all(run["state"] in ("killed", "done") for run in listing["runs"])
        for name in ("check", "scene", "channels", "line"):
            assert bench.get(name, study="good.toml")[0] == 200, name
        for name in ("fifo.csv", "device.csv", "sparse.json"):
            assert bench.post("facts", {"record": name, "options": {}})[0] in (403, 422), name
        for one in (*listing["studies"], {"path": "../../etc/passwd"}, {"path": "device.toml"}, {"path": "fifo.toml"}):
            assert bench.get("study", study=one["path"])[0] in (200, 403, 422)
        status, run = bench.post("runs", {"study": "good.toml", "results": "out"})
        assert status == 200
        wait_until(lambda: bench.get(f"runs/{run['id']}")[1]["state"] not in ("running", "queued"))
        assert bench.get(f"runs/{run['id']}")[1]["state"] == "done", bench.get(f"runs/{run['id']}")[1]["log"]
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close()
    seen = set(log.read_text(encoding="utf-8", errors="surrogateescape").splitlines())
    assert "good.toml" in seen
    assert not [
        name for name in seen if name.endswith((".py", "matplotlibrc", "arvizrc", ".numba_config.yaml", ".pyc"))
    ]
    assert not (folder / "harmed").exists()


def test_links_of_the_workbenchs_own_folder_are_not_followed(tmp_path):
    folder, outside = tmp_path / "folder", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    write_chain(folder / "good.toml")
    (folder / ".structid").symlink_to(outside)
    (outside / "runs" / "20260101-000000-aaaaaa").mkdir(parents=True)
    (outside / "runs" / "20260101-000000-aaaaaa" / "run.json").write_text("{}", encoding="utf-8")
    runs = Runs(open_study_folder(folder))
    assert runs.summaries() == []
    with pytest.raises(FileError, match="is a link"):
        runs.start("good.toml", "out")
    (folder / ".structid").unlink()
    (folder / ".structid").mkdir()
    (folder / ".structid" / ".gitignore").symlink_to(outside / "written")
    open_study_folder(folder).data_folder("runs")
    assert not (outside / "written").exists()
    for name in ("out", "other.checkpoint"):
        (folder / name).symlink_to(outside)
    for results in ("out", "other"):
        with pytest.raises(OutsideError):
            runs.start("good.toml", results)


def test_results_are_not_written_through_links_of_the_folder_that_they_replace(tmp_path):
    folder, outside = tmp_path / "results", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    (folder / "suggestions").symlink_to(outside)
    (folder / "estimate.json").symlink_to(outside / "written")

    def write() -> None:
        with staged_folder(folder, "estimate.json") as staged:
            (staged / "suggestions").mkdir()
            (staged / "suggestions" / "a.toml").write_text("a = 1", encoding="utf-8")

    with pytest.raises(FileError, match="is a link"):
        write()
    (folder / "suggestions").unlink()
    with staged_folder(folder, "estimate.json") as staged:
        (staged / "estimate.json").write_text("{}", encoding="utf-8")
    assert not list(outside.iterdir())
    assert not (folder / "estimate.json").is_symlink()


def test_no_lock_is_written_through_a_link(tmp_path):
    (tmp_path / "mine").write_text("mine", encoding="utf-8")
    (tmp_path / ".results.structid-lock").symlink_to(tmp_path / "mine")
    with pytest.raises(FileError, match="cannot be written"), claim_path(tmp_path / "results"):
        pass
    assert (tmp_path / "mine").read_text(encoding="utf-8") == "mine"


def test_an_archive_that_grows_a_thousandfold_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", values=np.zeros(15_000_000))
    with pytest.raises(FileError, match="would take 120 MB"):
        npz_arrays(tmp_path / "bomb.npz")
    np.savez_compressed(tmp_path / "small.npz", values=np.zeros(1_000_000))
    assert npz_arrays(tmp_path / "small.npz")["values"].shape == (1_000_000,)


def test_what_a_shipped_run_says_of_itself_is_not_believed(tmp_path):
    folder = tmp_path / "folder"
    run = folder / ".structid" / "runs" / "20260101-000000-aaaaaa"
    run.mkdir(parents=True)
    (folder.parent / "secret").write_text("secret", encoding="utf-8")
    (run / "log.txt").symlink_to(folder.parent / "secret")
    (run / "stop").symlink_to(folder.parent / "emptied")
    process = psutil.Process()
    told = {"study": "good.toml", "results": "out", "started": 1, "pid": process.pid, "born": process.create_time()}
    (run / "run.json").write_text(json.dumps(told), encoding="utf-8")
    (run / "progress.jsonl").write_text(
        '[1]\n{"words": 7}\n{"words": "x", "done": "y", "total": 1e999}\n', encoding="utf-8"
    )
    found = Runs(open_study_folder(folder))["20260101-000000-aaaaaa"]
    assert found.state == "killed"  # another process than the one that would run it
    progress = found.progress(0)
    assert progress["log"] == ""
    assert progress["last"] == {"words": "x"}
    json.dumps(progress, allow_nan=False)
    assert not (folder.parent / "emptied").exists()


def test_results_that_are_links_are_not_read(tmp_path):
    folder = tmp_path / "folder"
    (folder / "results").mkdir(parents=True)
    (tmp_path / "outside.json").write_text('{"title": "secret"}', encoding="utf-8")
    (folder / "results" / "estimate.json").symlink_to(tmp_path / "outside.json")
    with served(folder) as bench:
        status, found = bench.get("results", results="results")
        assert status == 403
        assert "secret" not in json.dumps(found)
        assert bench.get("folder")[1]["results"] == []


def test_results_that_are_there_are_replaced_only_where_that_is_asked_for(tmp_path):
    write_chain(tmp_path / "good.toml")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine", encoding="utf-8")
    runs = Runs(open_study_folder(tmp_path))
    with pytest.raises(ChangedError, match="is there already"):
        runs.start("good.toml", "mine")
    assert not (tmp_path / ".structid").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="names are exchanged on Linux")
def test_no_edit_that_was_told_as_saved_is_lost(tmp_path):
    """Two servers and an editor add lines to one study; each says which of its lines stand there."""
    study = tmp_path / "study.toml"
    study.write_text("# a study\n", encoding="utf-8")
    saver = (
        "import sys; from pathlib import Path; from structid.workbench.folder import open_study_folder, ChangedError\n"
        "place = open_study_folder(Path(sys.argv[1]))\n"
        "for k in range(70):\n"
        "    while True:\n"
        "        text, mark = place.text('study.toml')\n"
        "        try: place.save('study.toml', text + f'# {sys.argv[2]} {k}\\n', mark)\n"
        "        except ChangedError: continue\n"
        "        print(f'# {sys.argv[2]} {k}'); break\n"
    )
    servers = [
        subprocess.Popen([sys.executable, "-c", saver, str(tmp_path), name], stdout=subprocess.PIPE, text=True)
        for name in ("first", "second")
    ]
    told: list[str] = []

    overwritten: set[str] = set()

    def edit() -> None:
        """As an editor saves: a file of another name takes the place of the old one, which it does not look at any more."""
        for k in range(60):
            before, temporary = study.read_text(encoding="utf-8"), tmp_path / "editor.tmp"
            temporary.write_text(f"{before}# editor {k}\n", encoding="utf-8")
            assert _exchange_names(temporary, study)
            overwritten.update(set(temporary.read_text(encoding="utf-8").splitlines()) - set(before.splitlines()))
            told.append(f"# editor {k}")
            time.sleep(0.02)

    editor = threading.Thread(target=edit)
    editor.start()
    for server in servers:
        told += server.communicate(timeout=300)[0].splitlines()
        assert server.returncode == 0
    editor.join()
    assert len(told) == 200
    kept = set(study.read_text(encoding="utf-8").splitlines())
    assert not set(told) - overwritten - kept
    assert not {line for line in told if "editor" in line} - kept
    assert len(overwritten) < 20  # which the editor did itself, between its reading and its saving
    assert not list(tmp_path.glob(".study.*"))


def test_two_servers_lose_nothing(tmp_path):
    (tmp_path / "study.toml").write_text("# a study\n", encoding="utf-8")
    place, told = open_study_folder(tmp_path), []

    def save(name: str) -> None:
        for k in range(50):
            while True:
                text, mark = place.text("study.toml")
                try:
                    place.save("study.toml", f"{text}# {name} {k}\n", mark)
                except ChangedError:
                    continue
                told.append(f"# {name} {k}")
                break

    threads = [threading.Thread(target=save, args=(name,)) for name in ("first", "second")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(told) == 100
    assert set(told) <= set((tmp_path / "study.toml").read_text(encoding="utf-8").splitlines())


def test_permissions_are_kept_and_leftovers_swept(tmp_path):
    study = tmp_path / "study.toml"
    study.write_text("a = 1\n", encoding="utf-8")
    study.chmod(0o600)
    (tmp_path / ".study.structid-0123456789ab.toml").write_text("half", encoding="utf-8")
    place = open_study_folder(tmp_path)
    place.save("study.toml", "a = 2\n", place.text("study.toml")[1])
    assert stat.S_IMODE(study.stat().st_mode) == 0o600
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study.toml"]
