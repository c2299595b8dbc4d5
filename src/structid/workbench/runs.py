"""Runs: processes of their own that outlive page and server; what is known of them stands in files."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import psutil

from structid.core.errors import FileError, InputError
from structid.core.isolation import NEUTRAL_FOLDER, SAFE_FLAGS, child_environment
from structid.files import atomic_write, require_no_file
from structid.workbench.folder import OWN, OpenFolder, read_json

_ENDS = {0: "done", 1: "undetermined", 2: "unusable", 3: "wrong_model", 130: "stopped"}
_LIVE = ("running", "paused", "stopping")
_LOG_BYTES = 20_000
_SAME_SECONDS = 2.0


@dataclass(frozen=True)
class Run:
    """One run, known by what it writes into its folder."""

    opened: OpenFolder
    folder: Path

    @property
    def id(self) -> str:
        return self.folder.name

    @cached_property
    def _told(self) -> dict[str, Any]:
        found = read_json(self.folder / "run.json")
        return found if isinstance(found, dict) else {}

    def _process(self) -> psutil.Process | None:
        """The process that runs it, if that is still the one that was started."""
        told = self._told
        with suppress(psutil.Error, KeyError, TypeError):
            process = psutil.Process(int(told["pid"]))
            if abs(process.create_time() - float(told["born"])) < _SAME_SECONDS and process.status() != "zombie":
                return process
        return None

    def _worker(self, process: psutil.Process | None) -> psutil.Process | None:
        """The process that computes, which `process` has begun."""
        with suppress(psutil.Error):
            children = process.children() if process is not None else []
            return children[0] if children else None
        return None

    @property
    def state(self) -> str:
        """running, paused, stopping, killed, disk_full, or how it ended."""
        ended = read_json(self.folder / "ended.json")
        if isinstance(ended, dict):
            code = ended.get("code", -1)
            return "disk_full" if ended.get("disk_full") and code != 0 else _ENDS.get(code, "killed")
        process = self._process()
        if process is None:
            return "killed"
        worker = self._worker(process)
        with suppress(psutil.Error):
            if worker is not None and worker.status() == psutil.STATUS_STOPPED:
                return "paused"
        return "stopping" if (self.folder / "stop").exists() else "running"

    def summary(self) -> dict[str, Any]:
        """What a list of runs shows."""
        told, state = self._told, self.state
        results = str(told.get("results", ""))
        checkpoint = self.opened.root / f"{results}.checkpoint" / "run.json"
        return {
            "id": self.id,
            "study": told.get("study", ""),
            "results": results,
            "started": told.get("started", 0),
            "state": state,
            "can_resume": state not in _LIVE and bool(results) and checkpoint.exists(),
            "has_results": bool(results) and (self.opened.root / results / "estimate.json").exists(),
            "last": self._last(),
        }

    def _last(self) -> dict[str, Any]:
        """The last line of progress."""
        lines = _tail(self.folder / "progress.jsonl", 100_000).splitlines()
        for line in reversed(lines):
            with suppress(ValueError):
                found = json.loads(line)
                if isinstance(found, dict) and "words" in found:
                    return {key: found.get(key) for key in ("words", "done", "total", "time")}
        return {}

    def progress(self, after: int) -> dict[str, Any]:
        """Lines of progress from the byte `after` on, and the end of the log."""
        path, lines, at = self.folder / "progress.jsonl", [], after
        with suppress(OSError), path.open("rb") as stream:
            stream.seek(after)
            text = stream.read(4_000_000)
            whole = text[: text.rfind(b"\n") + 1]
            at += len(whole)
            for line in whole.splitlines():
                with suppress(ValueError):
                    lines.append(json.loads(line))
        return {**self.summary(), "lines": lines, "at": at, "log": _tail(self.folder / "log.txt", _LOG_BYTES)}

    def stop(self) -> None:
        """Ask it to end as Ctrl-C does; it writes what it has, and can be resumed."""
        worker = self._worker(self._process())
        if worker is None:
            raise InputError("this run has ended already")
        (self.folder / "stop").write_text("", encoding="utf-8")
        with suppress(psutil.Error):
            worker.resume()
            worker.terminate()

    def pause(self, still: bool) -> None:
        """Hold it where it is, or let it go on."""
        worker = self._worker(self._process())
        if worker is None:
            raise InputError("this run has ended already")
        with suppress(psutil.Error):
            for one in (worker, *worker.children(recursive=True)):
                one.suspend() if still else one.resume()


class Runs:
    """All runs of a folder."""

    def __init__(self, opened: OpenFolder) -> None:
        self.opened = opened

    def __iter__(self) -> Iterator[Run]:
        folder = self.opened.root / OWN / "runs"
        paths = sorted(folder.iterdir(), reverse=True) if folder.is_dir() else []
        return (Run(self.opened, path) for path in paths if (path / "run.json").exists())

    def __getitem__(self, name: str) -> Run:
        found = next((run for run in self if run.id == name), None)
        if found is None:
            raise InputError(f"there is no run {name!r} any more")
        return found

    def summaries(self) -> list[dict[str, Any]]:
        """Of every run, the newest first; none can be resumed whose results another one writes or has written since."""
        found, taken = [], set[str]()
        for run in self:
            told = run.summary()
            told["can_resume"] = told["can_resume"] and told["results"] not in taken
            taken.add(told["results"])
            found.append(told)
        return found

    def start(self, study: str, results: str, resume: bool = False) -> Run:
        """Start `structid identify` on a study.

        Raises
        ------
        InputError
            If a path is outside the folder, or another run writes to the same results.
        FileError
            If nothing can be written, or a file is in the way of the results.
        """
        path, out = self.opened.inside(study), self.opened.inside(results)
        require_no_file(out)
        for run in self:
            told = run.summary()
            if told["results"] == results and told["state"] in _LIVE:
                raise InputError(f"a run writes to {results} already; wait for it, or give other results")
        folder = self.opened.own("runs", f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(3)}")
        words = ["identify", str(path), "--out", str(out), "--progress", str(folder / "progress.jsonl")]
        words += ["--resume"] if resume else []
        process = subprocess.Popen(
            [sys.executable, *SAFE_FLAGS, "-m", "structid.workbench.runner", str(folder), *words],
            cwd=NEUTRAL_FOLDER,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=child_environment({"OPENBLAS_NUM_THREADS": os.environ.get("OPENBLAS_NUM_THREADS", "1")}),
        )
        _waited.append(process)
        told = {
            "study": study,
            "results": results,
            "started": time.time(),
            "pid": process.pid,
            "born": psutil.Process(process.pid).create_time(),
        }
        try:
            with atomic_write(folder / "run.json") as temporary:
                temporary.write_text(json.dumps(told), encoding="utf-8")
        except FileError:  # nobody would know of it
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL) if os.name == "posix" else process.kill()
            process.wait()
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return Run(self.opened, folder)


#: Those that this server started: their ends are taken, so that none stays as a zombie.
_waited: list[subprocess.Popen[bytes]] = []


def reap() -> None:
    """Take the ends of runs that have ended."""
    _waited[:] = [process for process in _waited if process.poll() is None]


def _tail(path: Path, most: int) -> str:
    try:
        with path.open("rb") as stream:
            stream.seek(max(0, path.stat().st_size - most))
            return stream.read().decode("utf-8", "replace")
    except OSError:
        return ""
