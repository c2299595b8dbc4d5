"""Runs of a solver: each in a folder of its own that is named by what goes in, made whole or not at all, and kept."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from structid.core.errors import FileError, InputError
from structid.core.isolation import kill_child, start_child
from structid.external.confirmation import command_words, require_confirmed, tell_command
from structid.external.deck import Deck
from structid.inversion.search.work import TaskContext, TaskExecutor

_LAYOUT = "structid solver run 1"
_DONE = "run.json"
_FAILED, _FAILED_MARK = "failed", "failed_run.json"
_TRIAL = re.compile(r"\.[0-9a-f]{12}\.[0-9a-f]{8}")
_LOG = "solver.log"
_LOG_BYTES = 4000
_SHOWN_LINES = 3
#: Seconds after which a folder of an unfinished run is of a process that is gone.
_STALE_SECONDS = 7 * 24 * 3600.0


class RunFailedError(InputError):
    """A solver gave no usable result in any of its tries."""


class RunOutputs(Protocol):
    """Files that a run of the solver gives, and how they are read."""

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that are kept, in the folder of the run."""
        ...

    def require_whole(self, folder: Path) -> None:
        """Raise `InputError` if a file of the run in `folder` is missing or cannot be read to its end."""
        ...


@dataclass(frozen=True, eq=False)
class Solver:
    """A solver with its deck.

    Attributes
    ----------
    deck : Deck
    command : str
        Command with ``{deck}`` (name of the deck's file), ``{stem}`` (that without the suffix) and ``{study}`` (folder of the
        study file); no shell reads it.
    folder : Path
        Where runs are kept.
    study : Path
        Folder of the study file.
    linked : mapping of str to Path
        Further files that the solver reads, by the name that they have in the folder of a run.
    outputs : RunOutputs
    timeout : float
        Longest time of a run, s.
    retries : int
        How often a run that fails is tried again.
    confirmation : str, optional
        What a user confirms before the command runs, see `confirmation_of`.
    """

    deck: Deck
    command: str
    folder: Path
    study: Path
    linked: Mapping[str, Path]
    outputs: RunOutputs
    timeout: float
    retries: int
    confirmation: str = ""

    @property
    def arguments(self) -> list[str]:
        """The command as a list of arguments for the operating system."""
        return command_words(self.command, self.deck.main, self.study)

    def key(self, values: Mapping[str, float]) -> str:
        """Name of a run: SHA-256 digest of all that its result depends on, 32 hexadecimal digits.

        `values` are the parameters by name; the digest covers command, written decks, linked files and names of outputs.
        """
        parts = {
            "layout": _LAYOUT,
            "command": self.command,
            "outputs": list(self.outputs.files),
            "deck": self.deck.written(values),
            "linked": {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in self.linked.items()},
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]

    def run_folder(self, values: Mapping[str, float]) -> Path:
        """Folder in which the run at these parameter values (by name) is kept, whether or not it exists."""
        return self.folder / self.key(values)


@dataclass(frozen=True)
class RunCounts:
    """Runs that a study needed.

    Attributes
    ----------
    kept, made : int
        Found where earlier runs are kept, and made now.
    """

    kept: int = 0
    made: int = 0

    def __add__(self, other: RunCounts) -> RunCounts:
        return RunCounts(self.kept + other.kept, self.made + other.made)


def runs(
    solver: Solver, points: Sequence[Mapping[str, float]], work: TaskExecutor
) -> tuple[list[Path | RunFailedError], RunCounts]:
    """Folders of the solver runs at `points`, in their order, or the error of each run that failed.

    Finished runs are kept.

    Parameters
    ----------
    solver : Solver
        Deck, command and folder of the runs.
    points : sequence of mapping of str to float
        Parameter values by name, a mapping for each run.
    work : TaskExecutor
        Executor of the runs.

    Returns
    -------
    list of Path or RunFailedError
        An error if the run failed at each attempt.
    RunCounts
        Numbers of runs that were kept from before and that were made now; equal points count once, failed runs do not.

    Raises
    ------
    InputError
        If the solver's program is missing, or its command is not confirmed.
    FileError
        If the folder cannot be written, or `failed` in it is none of a failed run.
    """
    keys = [solver.key(point) for point in points]
    missing = {key: point for key, point in zip(keys, points, strict=True) if not _is_done(solver.folder / key)}
    failed: dict[str, RunFailedError] = {}
    if missing:
        _require_program(solver)
        require_confirmed(solver.command, solver.confirmation)
        tell_command(solver.command, solver.study, solver.confirmation)
        try:
            solver.folder.mkdir(parents=True, exist_ok=True)
            _require_own_failed(solver.folder / _FAILED)
            _remove_stale_folders(solver.folder)
        except OSError as error:
            raise FileError(
                f"{solver.folder}: cannot hold the runs of the solver ({error.strerror}); give `runs`"
            ) from error
        messages = work.map("solver runs", run_once, solver, [dict(point) for point in missing.values()])
        failed = {key: RunFailedError(words) for key, words in zip(missing, messages, strict=True) if words}
    folders: list[Path | RunFailedError] = [failed.get(key) or solver.folder / key for key in keys]
    return folders, RunCounts(len(set(keys)) - len(missing), len(missing) - len(failed))


def needed_runs(
    solver: Solver, points: Sequence[Mapping[str, float]], work: TaskExecutor
) -> tuple[list[Path], RunCounts]:
    """Folders of the solver runs at `points` (values by name), in their order, and the counts of kept and new runs.

    `work` makes the runs that are not there yet; equal points count once.

    Raises
    ------
    RunFailedError
        If a run failed; the message says where its log is and how many runs are kept.
    """
    results, counts = runs(solver, points, work)
    folders = []
    for result in results:
        if isinstance(result, RunFailedError):
            kept = sum(isinstance(other, Path) for other in results)
            raise RunFailedError(
                f"{result}; deck and log of it are in {solver.folder / _FAILED}, {kept} finished runs are kept in {solver.folder}"
            )
        folders.append(result)
    return folders, counts


def run_once(solver: Solver, values: Mapping[str, float], _: TaskContext) -> str:
    """Run the solver at `values` (by name), again up to `retries` times if it fails; "" on success, else the reason.

    A run that is kept already is not repeated. `InputError` if the command is not confirmed, `FileError` if the files
    cannot be written.
    """
    words, folder = "", solver.run_folder(values)
    require_confirmed(solver.command, solver.confirmation)
    for _attempt in range(solver.retries + 1):
        if _is_done(folder):  # made by another process meanwhile
            return ""
        words = _try_run(solver, values, folder)
        if not words:
            return ""
    values_text = ", ".join(f"{name} = {value:g}" for name, value in solver.deck.shown(values).items())
    times = f" {solver.retries + 1} times" if solver.retries else ""
    return f"the solver failed{times} at {values_text}: {words}"


def _is_done(folder: Path) -> bool:
    """True if the run in `folder` has ended and is complete."""
    return (folder / _DONE).is_file()


def _try_run(solver: Solver, values: Mapping[str, float], folder: Path) -> str:
    """Run the solver a single time at `values` (by name); "" if the result is complete, else the reason of the failure.

    A good run is moved to `folder`, with its outputs, decks, log and a record only; a failed one to `failed` beside the
    runs. `FileError` if the files cannot be written.
    """
    start, trial = time.perf_counter(), _trial_folder(folder)
    try:
        trial.mkdir()
        for name, path in solver.linked.items():
            shutil.copyfile(path, trial / name)
        for name, text in solver.deck.written(values).items():
            (trial / name).write_text(text, encoding="utf-8", newline="")
        words = _execute_command(solver, trial)
        if not words:
            try:
                solver.outputs.require_whole(trial)
            except InputError as error:
                words = f"{str(error).replace(str(trial) + os.sep, '')}{_last_words(trial)}"
        record: dict[str, object] = {"values": solver.deck.shown(values), "command": solver.command}
        if words:
            _keep_failed_run(folder, trial, {"layout": _LAYOUT, **record, "reason": words})
            return words
        keep = {*solver.outputs.files, *solver.deck.texts, _LOG}
        for path in trial.iterdir():
            if path.name not in keep:
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        record["seconds"] = time.perf_counter() - start
        (trial / _DONE).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        try:
            trial.rename(folder)
        except OSError:
            if not _is_done(folder):
                raise
        return ""
    except OSError as error:
        raise FileError(
            f"{trial}: the run of the solver cannot be written ({error.strerror or error}); free disk space, or give another"
            " folder with `runs`"
        ) from error
    finally:
        shutil.rmtree(trial, ignore_errors=True)


def _execute_command(solver: Solver, folder: Path) -> str:
    """Run the solver's command in `folder`, with its output in a log; "" if it ended with code 0, else a sentence.

    The sentence says that the program cannot be started, ended with another code, or was ended after `timeout`
    seconds.
    """
    with (folder / _LOG).open("wb") as log:
        try:
            process = start_child(solver.arguments, folder, output=log, errors=log)
        except OSError as error:
            return f"{solver.arguments[0]} cannot be started ({error.strerror or error})"
        try:
            code = process.wait(solver.timeout)
        except subprocess.TimeoutExpired:
            kill_child(process)
            process.wait()
            return f"it was still running after {solver.timeout:g} s (`timeout`) and was ended{_last_words(folder)}"
        except BaseException:
            kill_child(process)
            process.wait()
            raise
    return f"it ended with code {code}{_last_words(folder)}" if code else ""


def _last_words(folder: Path) -> str:
    """The last three lines of the solver's log in `folder` that have words, as the end of a sentence.

    It is "" if there is no log, and says so if the log has no words.
    """
    path = folder / _LOG
    if not path.is_file():
        return ""
    text = path.read_bytes()[-_LOG_BYTES:].decode("utf-8", "replace")
    lines = [" ".join(line.split()) for line in text.splitlines() if any(letter.isalnum() for letter in line)]
    words = " / ".join("".join(letter for letter in line if letter.isprintable()) for line in lines[-_SHOWN_LINES:])
    return f"; its last words: {words}" if words else "; it said nothing"


def _trial_folder(folder: Path) -> Path:
    """Path of a new folder, in which the run that is to be kept in `folder` is tried, as `_TRIAL` knows them by name."""
    return folder.with_name(f".{folder.name[:12]}.{secrets.token_hex(4)}")


def _keep_failed_run(folder: Path, trial: Path, record: Mapping[str, object]) -> None:
    """Move the `trial` of the run in `folder`, which failed, to `failed` beside it, with `record` as the mark of such a run.

    An earlier failed run there is removed; anything else stays, and the trial is not kept.
    """
    last = folder.with_name(_FAILED)
    (trial / _FAILED_MARK).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    with suppress(OSError):  # another worker's failure was faster
        if _is_failed_run(last):
            aside = _trial_folder(folder)
            last.rename(aside)
            shutil.rmtree(aside, ignore_errors=True)
        trial.rename(last)


def _is_failed_run(folder: Path) -> bool:
    """True if `folder` is one that a failed run left, as the mark in it says."""
    try:
        mark = json.loads((folder / _FAILED_MARK).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(mark, dict) and mark.get("layout") == _LAYOUT and not folder.is_symlink()


def _require_own_failed(folder: Path) -> None:
    """Raise `FileError` if `folder`, where a failed run goes, is a file or a folder of somebody else."""
    if (folder.exists() or folder.is_symlink()) and not _is_failed_run(folder):
        raise FileError(
            f"{folder}: is none that a failed run of the solver left, and would be in the way of one; move it, or give"
            " another folder with `runs`"
        )


def _remove_stale_folders(folder: Path) -> None:
    """Remove the trial folders in `folder` that killed runs left behind, a week after their last change.

    They are known by their names: a point and 12, a point and 8 hexadecimal digits.
    """
    for path in folder.glob(".*.*"):
        with suppress(FileNotFoundError):  # the run of another process that ends now has its own name from now on
            is_trial = _TRIAL.fullmatch(path.name) and path.is_dir() and not path.is_symlink()
            if is_trial and time.time() - path.stat().st_mtime > _STALE_SECONDS:
                shutil.rmtree(path, ignore_errors=True)


def _require_program(solver: Solver) -> None:
    """Raise `InputError` if the solver's command is empty or its program cannot be found."""
    arguments = solver.arguments
    if not arguments:
        raise InputError('`command` is empty; give the line that runs the solver, as in "ccx {stem}"')
    if shutil.which(arguments[0]) is None:
        raise InputError(
            f"the solver {arguments[0]!r} is not there: no program of this name can be run; install it, or give its full path in"
            " `command`"
        )


def point_words(point: Mapping[str, float]) -> str:
    """The values of a run, as messages say them."""
    return ", ".join(f"{name} = {value:g}" for name, value in point.items())


def run_words(counts: RunCounts) -> str:
    """Words on the number of runs, and how many of them were kept from before."""
    return f"{counts.kept + counts.made} runs, {counts.kept} of them kept from before"
