"""Runs: processes of their own that outlive page and server; what is known of them stands in files."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import psutil

from structid.core.errors import FileError, InputError
from structid.core.isolation import kill_child, python_arguments, start_child
from structid.external.confirmation import CONFIRMED
from structid.files import atomic_write, read_part, require_no_file
from structid.workbench.folder import OWN, ChangedError, OpenFolder, OutsideError, parse_json, read_json

_ENDS = {0: "done", 1: "undetermined", 2: "unusable", 3: "wrong_model", 130: "stopped"}
_LIVE = ("queued", "running", "paused", "stopping")
#: Runs at most that a folder tells of, the newest; names of their folders are made by `Runs.start`.
_MOST_RUNS, _NAME = 60, re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}")
_MOST_TOLD = 100_000
_LOG_BYTES = 20_000
_SAME_SECONDS = 2.0
#: Greater than any time and number of a process, and small enough for every part of the system.
_LATEST = 2**53


@dataclass(frozen=True)
class Run:
    """One run, known by what it writes into its folder."""

    opened: OpenFolder
    folder: Path

    @property
    def id(self) -> str:
        return self.folder.name

    @cached_property
    def _read_run_file(self) -> dict[str, Any]:
        """Content of ``run.json`` without invalid entries: ``study``, ``results``, ``started``, ``pid`` and ``born``.

        The first two are paths in the folder, the last one is the time when process number ``pid`` began; times are in
        seconds since 1970. Empty if a path leads out of the folder or nothing can be read.
        """
        stored = self._json("run.json")
        texts = {key: stored[key] for key in ("study", "results") if isinstance(stored.get(key), str)}
        numbers = {
            key: stored[key]
            for key in ("started", "pid", "born")
            if isinstance(stored.get(key), int | float) and 0 <= stored[key] < _LATEST
        }
        for name in texts.values():
            try:
                self.opened.inside(name)
            except OutsideError:
                return {}
        return {**texts, **numbers}

    def _json(self, name: str) -> dict[str, Any]:
        content = read_json(self.folder / name, follow=False)
        return content if isinstance(content, dict) else {}

    def _process(self) -> psutil.Process | None:
        """Process of this run, or None if it has ended or another process now has its number."""
        stored = self._read_run_file
        with suppress(psutil.Error, KeyError, TypeError):
            process = psutil.Process(int(stored["pid"]))
            is_same = abs(process.create_time() - float(stored["born"])) < _SAME_SECONDS
            if is_same and process.status() != "zombie" and str(self.folder) in process.cmdline():
                return process
        return None

    def _worker(self, process: psutil.Process | None) -> psutil.Process | None:
        """First child process of `process`, which does the computing; None if there is none or `process` is None."""
        with suppress(psutil.Error):
            children = process.children() if process is not None else []
            return children[0] if children else None
        return None

    @property
    def state(self) -> str:
        """State of the run: "queued", "running", "paused", "stopping", or how it ended.

        Ends by exit code are "done" (0), "undetermined" (1), "unusable" (2), "wrong_model" (3) and "stopped" (130);
        "disk_full" if the disk was full and the code is not 0; "killed" for any other code, or a process that is gone
        without one.
        """
        ended = self._json("ended.json")
        if ended:
            code = ended.get("code")
            if ended.get("disk_full") and code != 0:
                return "disk_full"
            return _ENDS.get(code, "killed") if isinstance(code, int) else "killed"
        process = self._process()
        if process is None:
            return "killed"
        worker = self._worker(process)
        with suppress(psutil.Error):
            if worker is not None and worker.status() == psutil.STATUS_STOPPED:
                return "paused"
        if (self.folder / "stop").exists():
            return "stopping"
        return "queued" if (self.folder / "queued").exists() else "running"

    def summary(self) -> dict[str, Any]:
        """The run for the page: ``id``, ``study``, ``results``, ``started``, ``state``, ``can_resume``, ``has_results``, ``last``.

        ``started`` is in seconds since 1970 (0 if unknown); ``can_resume`` is True if the run has ended and left a checkpoint;
        ``last`` is its last progress record.
        """
        told, state = self._read_run_file, self.state
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
        """Last progress record of the run: ``words`` and, as far as they are numbers, ``done``, ``total`` and ``time``.

        {} if there is none yet.
        """
        lines = _tail(self.folder / "progress.jsonl", _MOST_TOLD).splitlines()
        for line in reversed(lines):
            entry = parse_json(line)
            if isinstance(entry, dict) and isinstance(entry.get("words"), str):
                counts = {key: entry.get(key) for key in ("done", "total", "time")}
                return {"words": entry["words"], **{k: v for k, v in counts.items() if isinstance(v, int | float)}}
        return {}

    def progress(self, after: int) -> dict[str, Any]:
        """Summary of the run with its progress records from byte `after` of the file on, and the end of its log.

        ``lines`` are the records, at most 4 MB; ``at`` is the byte to continue from; ``log`` holds the last 20 kB. An
        `after` below 0 counts as 0.
        """
        path, at = self.folder / "progress.jsonl", max(after, 0)
        lines: list[dict[str, Any]] = []
        with suppress(OSError, OverflowError):
            text = read_part(path, at, 4_000_000)
            whole = text[: text.rfind(b"\n") + 1]
            at += len(whole)
            lines = [told for line in whole.splitlines() if isinstance(told := parse_json(line), dict)]
        return {**self.summary(), "lines": lines, "at": at, "log": _tail(self.folder / "log.txt", _LOG_BYTES)}

    def stop(self) -> None:
        """Ask the run to end as with Ctrl-C, so that it saves a checkpoint and can be resumed; returns at once.

        Raises
        ------
        InputError
            If the run has ended already.
        """
        process = self._process()
        worker = self._worker(process)
        if process is None or (worker is None and self.state != "queued"):
            raise InputError("this run has ended already")
        with suppress(FileExistsError):
            (self.folder / "stop").open("x").close()
        if worker is None:
            return
        with suppress(psutil.Error):
            worker.resume()
            worker.terminate()

    def pause(self, still: bool) -> None:
        """Suspend the processes of the run if `still` is True, or let them continue if False.

        Raises
        ------
        InputError
            If the run has ended or computes nothing yet.
        """
        worker = self._worker(self._process())
        if worker is None:
            raise InputError("this run has ended already")
        with suppress(psutil.Error):
            for one in (worker, *worker.children(recursive=True)):
                one.suspend() if still else one.resume()


class Runs:
    """The runs of a folder, the 60 newest, newest first."""

    def __init__(self, opened: OpenFolder) -> None:
        self.opened = opened

    def __iter__(self) -> Iterator[Run]:
        return (Run(self.opened, path) for path in self._folders()[:_MOST_RUNS])

    def _folders(self) -> list[Path]:
        """Folders of all runs that have a ``run.json``, newest first; links are left out.

        Empty if the folder of runs is missing, a link, or cannot be read.
        """
        holder = self.opened.root / OWN
        folder = holder / "runs"
        if holder.is_symlink() or folder.is_symlink():
            return []
        with suppress(OSError), os.scandir(folder) as scan:
            names = [
                entry.name for entry in scan if _NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False)
            ]
            return [
                path
                for name in sorted(names, reverse=True)
                if (path := folder / name) and (path / "run.json").is_file()
            ]
        return []

    def __getitem__(self, name: str) -> Run:
        """Run with the identifier `name` among the 60 newest; raises `InputError` if there is none."""
        wanted = next((run for run in self if run.id == name), None)
        if wanted is None:
            raise InputError(f"there is no run {name!r} any more")
        return wanted

    def summaries(self) -> list[dict[str, Any]]:
        """Summaries of the 60 newest runs, newest first; only the newest run of a results folder can be resumed."""
        found, taken = [], set[str]()
        for run in self:
            summary = run.summary()
            summary["can_resume"] = summary["can_resume"] and summary["results"] not in taken
            taken.add(summary["results"])
            found.append(summary)
        return found

    def start(
        self,
        study: str,
        results: str,
        resume: bool = False,
        replace: bool = False,
        confirmation: str = "",
        seconds: float | None = None,
        explain: bool = False,
    ) -> Run:
        """Start `structid identify` on a study in a new process; it waits in a queue while two other runs compute.

        Parameters
        ----------
        study, results : str
            Study file and results folder, as paths in the open folder.
        resume : bool, optional
            True to continue an interrupted run from its checkpoint.
        replace : bool, optional
            True to start although `results` is not empty; the run then writes its files in place of those there.
        confirmation : str, optional
            Confirmation of the solver command that the run may execute; any other command is refused.
        seconds : float, optional
            Processor time (s) for the search for causes of a misfit; None for the default of the command.
        explain : bool, optional
            True to search for causes even if the model explains the record.

        Raises
        ------
        InputError
            If a path is outside the folder, `seconds` is negative or not finite, or another run writes to the same results.
        ChangedError
            If the results folder is not empty, and neither `resume` nor `replace` is True.
        FileError
            If nothing can be written, or `results` is a file.
        """
        path, out = self.opened.inside(study), self.opened.inside(results)
        self.opened.inside(f"{results}.checkpoint")
        require_no_file(out)
        if seconds is not None and not 0 <= seconds < float("inf"):
            raise InputError(f"the time for causes must be at least 0 s, got {seconds:g}; leave it out for the usual")
        for run in self:
            summary = run.summary()
            if summary["results"] == results and summary["state"] in _LIVE:
                raise InputError(f"a run writes to {results} already; wait for it, or give other results")
        if out.is_dir() and not (resume or replace) and any(out.iterdir()):
            raise ChangedError(f"{results}: is there already; give another folder, or replace what is in it")
        folder = self.opened.data_folder("runs", f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(3)}")
        words = ["identify", str(path), "--out", str(out), "--progress", str(folder / "progress.jsonl")]
        words += ["--resume"] if resume else []
        words += [] if seconds is None else ["--seconds", f"{seconds:g}"]
        words += ["--explain"] if explain else []
        threads = os.environ.get("OPENBLAS_NUM_THREADS", "1")
        process = start_child(
            python_arguments("-m", "structid.workbench.runner", str(folder), *words),
            changes={"OPENBLAS_NUM_THREADS": threads, CONFIRMED: confirmation},
        )
        _waited.append(process)
        description = {
            "study": study,
            "results": results,
            "started": time.time(),
            "pid": process.pid,
            "born": psutil.Process(process.pid).create_time(),
        }
        try:
            with atomic_write(folder / "run.json") as temporary:
                temporary.write_text(json.dumps(description), encoding="utf-8")
        except FileError:  # nobody would know of it
            kill_child(process)
            process.wait()
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return Run(self.opened, folder)


#: Those that this server started: their ends are taken, so that none stays as a zombie.
_waited: list[subprocess.Popen[bytes]] = []


def reap() -> None:
    """Collect the exit status of ended runs that this server started, so that no zombie processes remain."""
    _waited[:] = [process for process in _waited if process.poll() is None]


def _tail(path: Path, most: int) -> str:
    """Text of the last `most` bytes of a file, in UTF-8; "" if it cannot be read."""
    try:
        return read_part(path, max(0, path.stat(follow_symlinks=False).st_size - most), most).decode("utf-8", "replace")
    except OSError:
        return ""
