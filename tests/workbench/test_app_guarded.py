"""Commands are confirmed, the token is in nobody's list, runs wait for their turn, and requests that do not end are ended."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from app_cases import ENVIRONMENT, require_workbench, served

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
require_workbench()

from fuzz.seeds import write_chain  # noqa: E402

from structid.workbench import runner, server, user_state  # noqa: E402
from structid.workbench.handlers import Watcher  # noqa: E402
from structid.workbench.security import HEADER_SECONDS  # noqa: E402

SOLVER = """\
title = "a stranger's"
[structure.solver]
deck = "deck.txt"
command = "{python} {{study}}/solve.py {{deck}}"
modes = "{{stem}}.csv"
gives = "modes"
[[structure.solver.parameter]]
name = "k"
value = 1.0
[[unknown]]
property = "k"
elements = "model"
[record]
path = "modes.csv"
[record.modes]
frequency_error = 0.01
shape_error = 0.02
"""


@pytest.fixture
def stranger(tmp_path):
    """A study with a command that leaves ``ran``, and imports a module that lies beside it."""
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "study.toml").write_text(SOLVER.format(python=sys.executable), encoding="utf-8")
    (folder / "deck.txt").write_text("k = {{k}}\n", encoding="utf-8")
    (folder / "modes.csv").write_text("frequency_hz,damping_ratio,1X+\n2.0,0.01,1.0\n", encoding="utf-8")
    (folder / "solve.py").write_text(f"import json\nopen({str(folder / 'ran')!r}, 'a').write('x')\n", encoding="utf-8")
    (folder / "json.py").write_text(f"open({str(folder / 'harmed')!r}, 'a').write('x')\n", encoding="utf-8")
    return folder


def ended(bench, run: str) -> str:
    end = time.monotonic() + 120
    while (state := bench.get(f"runs/{run}")[1]["state"]) in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.1)
    return state


def test_a_command_runs_once_it_was_shown_and_confirmed_as_it_is(stranger, tmp_path):
    state = tmp_path / "state"
    with served(stranger, environment={"XDG_STATE_HOME": str(state)}) as bench:
        for name in ("scene", "channels", "check", "needs", "plan", "line"):
            bench.get(name, study="study.toml")
        assert not (stranger / "ran").exists()
        asked = {"study": "study.toml", "results": "out"}
        status, found = bench.post("runs", asked)
        assert status == 428
        assert found["solver"]["command"] == f"{sys.executable} {{study}}/solve.py {{deck}}"
        assert found["solver"]["words"] == [sys.executable, str(stranger / "solve.py"), "deck.txt"]
        assert bench.post("runs", {**asked, "confirmed": "0" * 64})[0] == 428
        assert bench.get("folder")[1]["runs"] == []
        first = found["solver"]["confirmation"]
        run = bench.post("runs", {**asked, "confirmed": first})[1]["id"]
        ended(bench, run)
        assert (stranger / "ran").exists(), bench.get(f"runs/{run}")[1]["log"]
        assert not (stranger / "harmed").exists()
        again = bench.post("runs", {**asked, "results": "again"})
        assert again[0] == 200  # it was confirmed, and is as it was
        ended(bench, again[1]["id"])
        for name, text in (("solve.py", "# other\n"), ("deck.txt", "# k = {{k}}\n"), ("study.toml", None)):
            text = text or (stranger / name).read_text().replace("{deck}", "{deck} --more")
            (stranger / name).write_text(text, encoding="utf-8")
            status, found = bench.post("runs", {**asked, "results": name})
            assert status == 428, name
            assert bench.post("runs", {**asked, "results": name, "confirmed": first})[0] == 428, name
    kept = state / "structid" / "confirmed_commands.json"
    assert json.loads(kept.read_text()) == [first]
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    assert stat.S_IMODE(kept.parent.stat().st_mode) == 0o700


def test_a_command_that_changes_behind_the_confirmation_does_not_run(stranger):
    environment = {**ENVIRONMENT, "STRUCTID_CONFIRMED_SOLVER": "of another command"}
    words = [sys.executable, "-m", "structid", "identify", str(stranger / "study.toml"), "--out", str(stranger / "out")]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "was not confirmed as it is now" in done.stderr
    assert not (stranger / "ran").exists()


def test_the_command_line_says_the_command_before_it_runs(stranger):
    words = [sys.executable, "-m", "structid", "check", str(stranger / "study.toml")]
    done = subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert (stranger / "ran").exists()
    lines = done.stderr.splitlines()
    assert lines[0] == f"runs the command of the study in {stranger}: {sys.executable} {{study}}/solve.py {{deck}}"
    assert done.stderr.count("runs the command") == 1


def test_the_token_is_in_no_list_of_processes_and_in_no_file_that_others_read(tmp_path):
    """The browser is one that tells how it was called."""
    folder, state = tmp_path / "folder", tmp_path / "state"
    folder.mkdir()
    called = tmp_path / "called"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$@" >> {called}\n', encoding="utf-8")
    browser.chmod(0o755)
    log = tmp_path / "log.txt"
    log.touch(mode=0o644)
    environment = {**ENVIRONMENT, "BROWSER": f"{browser} %s", "XDG_STATE_HOME": str(state)}
    with log.open("w") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "structid", "app", str(folder)], env=environment, stdout=stream
        )
    try:
        end = time.monotonic() + 60
        while not (called.exists() and called.read_text().strip()):
            assert time.monotonic() < end
            time.sleep(0.1)
        page = Path(called.read_text().strip().removeprefix("file://"))
        assert stat.S_IMODE(page.stat().st_mode) == 0o600
        address = page.read_text(encoding="utf-8").split('href="')[1].split('"')[0]
        token = address.rstrip("/").rpartition("/")[2]
        assert len(token) >= 32
        listed = [" ".join(one.info["cmdline"] or ()) for one in psutil.process_iter(["cmdline"])]
        assert not [line for line in listed if token in line]
        assert token not in called.read_text()
        assert token not in log.read_text()
        for path in tmp_path.rglob("*"):
            if path.is_file() and path.stat().st_mode & 0o044:
                assert token.encode() not in path.read_bytes(), path
    finally:
        process.terminate()
        process.wait(20)
    assert not page.exists()


def test_an_address_is_printed_where_only_the_user_reads_it(tmp_path):
    for mode, is_open in ((0o600, False), (0o644, True), (0o640, True)):
        path = tmp_path / f"{mode:o}"
        path.touch(mode=mode)
        path.chmod(mode)
        with path.open("w") as stream:
            assert server._is_read_by_others(stream) is is_open


def test_a_page_is_opened_from_a_file_and_nothing_else_is_from_elsewhere(tmp_path):
    elsewhere = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    with served(tmp_path) as bench:
        assert bench.ask("GET", "/", headers=elsewhere)[0] == 200
        assert bench.ask("GET", "/", headers={**elsewhere, "Sec-Fetch-Dest": "iframe"})[0] == 403
        assert bench.ask("GET", "/api/folder", headers=elsewhere)[0] == 403
        assert bench.ask("POST", "/", b"", headers=elsewhere)[0] == 403
        assert bench.ask("GET", "/", headers=elsewhere, token="wrong")[0] == 403


def test_of_many_runs_two_compute_and_the_others_wait_in_order(tmp_path, monkeypatch):
    """Runners whose run waits for a file, in one state directory."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    code = (
        "import sys, time; from pathlib import Path; from structid.workbench import runner\n"
        "folder = Path(sys.argv[1])\n"
        "def executed(*_):\n"
        "    (folder / 'begun').touch()\n"
        "    while not (folder / 'go').exists(): time.sleep(0.02)\n"
        "    return 0\n"
        "runner._run_command = executed\n"
        "runner.main()\n"
    )
    folders, processes = [tmp_path / str(k) for k in range(5)], []

    def wait(path: Path) -> None:
        end = time.monotonic() + 60
        while not path.exists():
            assert time.monotonic() < end, path
            time.sleep(0.02)

    try:
        for k, folder in enumerate(folders):
            folder.mkdir()
            processes.append(subprocess.Popen([sys.executable, "-c", code, str(folder)]))
            wait(folder / ("begun" if k < 2 else "queued"))
        assert [(folder / "begun").exists() for folder in folders] == [True, True, False, False, False]
        (folders[3] / "stop").touch()  # one that waits is stopped
        assert processes[3].wait(30) == 0
        assert json.loads((folders[3] / "ended.json").read_text())["code"] == 130
        processes[0].kill()  # one that computes is killed
        wait(folders[2] / "begun")
        assert not (folders[2] / "queued").exists()
        assert not (folders[4] / "begun").exists()
        (folders[1] / "go").touch()
        wait(folders[4] / "begun")
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert runner.AT_ONCE == 2


def test_one_look_at_the_folder_tells_all_pages():
    """Each look waits for the test's leave: one leave serves all pages, and at most one more look is under way."""
    leave, begun, looks = threading.Semaphore(0), [], []

    def stamps() -> dict[str, int]:
        begun.append(None)
        assert leave.acquire(timeout=60)
        looks.append(None)
        return {"a.toml": len(looks)}

    async def never() -> bool:
        return False

    n_begun = []

    async def heard() -> list[list[dict[str, int]]]:
        watcher = Watcher(SimpleNamespace(stamps=stamps), SimpleNamespace(summaries=list))
        pages = [watcher.states(never) for _ in range(20)]

        async def next_state(page) -> dict[str, int]:
            while not (words := await anext(page)):
                pass
            return json.loads(words)["studies"]

        rounds = []
        async with asyncio.timeout(60):
            for _ in range(2):
                leave.release()
                rounds.append(list(await asyncio.gather(*map(next_state, pages))))
        n_begun.append(len(begun))
        leave.release(100)  # of looks that are under way
        for page in pages:
            await page.aclose()
        return rounds

    assert asyncio.run(heard()) == [[{"a.toml": 1}] * 20, [{"a.toml": 2}] * 20]
    assert n_begun[0] <= 3


def test_many_pages_are_told_of_a_change(tmp_path):
    (tmp_path / "a.toml").write_text("[structure]\n", encoding="utf-8")
    with served(tmp_path) as bench:
        sockets = []
        for _ in range(20):
            made = socket.create_connection(("127.0.0.1", bench.port), timeout=30)
            made.sendall(f"GET /{bench.token}/api/events HTTP/1.1\r\nHost: 127.0.0.1:{bench.port}\r\n\r\n".encode())
            sockets.append(made)
        heard = [b""] * 20

        def hear(words: bytes) -> None:
            for k, made in enumerate(sockets):
                while words not in heard[k]:
                    heard[k] += made.recv(65536)

        hear(b'"a.toml"')
        (tmp_path / "b.toml").write_text("[structure]\n", encoding="utf-8")
        hear(b'"b.toml"')
        for made in sockets:
            made.close()
        assert bench.get("folder")[0] == 200


@pytest.mark.long
def test_half_requests_are_closed(tmp_path):
    with served(tmp_path) as bench:
        sockets = []
        for begin in (
            b"",
            b"GET / HTTP/1.1\r\nHost: a",
            f"GET /{bench.token}/ HTTP/1.1\r\nHost: 127.0.0.1:{bench.port}\r\n\r\nGE".encode(),
        ):
            made = socket.create_connection(("127.0.0.1", bench.port), timeout=HEADER_SECONDS + 110)
            made.sendall(begin)
            sockets.append(made)
        for made in sockets:
            while made.recv(65536):  # a timeout where the server leaves it open
                pass
            made.close()


def test_of_uploads_of_one_name_one_is_told_as_done(tmp_path):
    with served(tmp_path) as bench:
        answers: list[tuple[int, bytes]] = []

        def upload(k: int) -> None:
            status, _, body = bench.ask("PUT", "/api/file?name=a.csv", b"%d\n" % k * 200_000)
            answers.append((status, body))

        threads = [threading.Thread(target=upload, args=(k,)) for k in range(5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(status for status, _ in answers) == [200, 422, 422, 422, 422]
        assert len(set((tmp_path / "a.csv").read_text().split())) == 1
        assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_a_failed_export_leaves_no_archive(tmp_path, monkeypatch):
    (tmp_path / "folder" / "results").mkdir(parents=True)
    (tmp_path / "folder" / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    broken = tmp_path / "sitecustomize.py"
    broken.write_text(
        "import zipfile\ndef write(*_):\n    raise OSError(28, 'No space left on device')\nzipfile.ZipFile.write = write\n",
        encoding="utf-8",
    )
    environment = {"TMPDIR": str(temporary), "PYTHONPATH": str(tmp_path)}
    with served(tmp_path / "folder", environment=environment) as bench:
        assert bench.ask("GET", "/api/export?results=results")[0] == 507
        assert not list(temporary.glob("*.zip"))


def test_what_is_kept_for_the_user_is_for_the_user_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    from structid.workbench.user_state import is_confirmed, recent_folders, remember, remember_confirmed

    before = os.umask(0)
    try:
        remember(tmp_path)
        remember_confirmed("a" * 64)
    finally:
        os.umask(before)
    assert recent_folders() == [str(tmp_path)]
    assert is_confirmed("a" * 64)
    assert not is_confirmed("b" * 64)
    for path in user_state.state_folder().iterdir():
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(user_state.state_folder().stat().st_mode) == 0o700


def test_of_the_files_kept_for_the_user_only_its_own_are_removed(tmp_path, monkeypatch):
    """Tickets of dead runs and pages of killed servers, by their whole names."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(server.Path, "home", lambda: tmp_path / "home")
    queue = user_state.state_folder() / "runs"
    queue.mkdir()
    dead, foreign = queue / f"{1:020}-99", [queue / "1.txt", user_state.state_folder() / "open-house.html"]
    page = user_state.state_folder() / f"open-{1:016x}.html"
    for path in (dead, page, *foreign):
        path.write_text("x", encoding="utf-8")
        os.utime(path, (0, 0))
    ticket, path = runner._take_ticket(queue / f"{2:020}-1")
    try:
        assert runner._position(queue, path) == 0
    finally:
        os.close(ticket)
    server._redirect_page("http://127.0.0.1/")
    assert [one.exists() for one in (dead, page, *foreign)] == [False, False, True, True]


def test_the_good_chain_needs_no_confirmation(tmp_path):
    write_chain(tmp_path / "good.toml")
    with served(tmp_path) as bench:
        status, run = bench.post("runs", {"study": "good.toml", "results": "out"})
        assert status == 200
        assert bench.post(f"runs/{run['id']}/stop", {})[0] in (200, 422)
