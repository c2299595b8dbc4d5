"""Checkpoint of a long run in a folder beside its results: written by renaming, so that it is whole at any instant.

The folder holds ``run.json`` (what it belongs to), ``done-*.npz`` (finished searches and tasks), ``search.npz`` (the
running search after its last iteration) and, after an interruption, ``so_far.json`` (the values reached, to read).
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np

from structid._version import __version__
from structid.core.errors import FileError
from structid.core.json_types import JsonValue, StoredEntry, json_text
from structid.files import atomic_write, claim, damage_told, make_folder, release
from structid.files.npy import npz_arrays
from structid.files.worker import fill_tree, plain
from structid.inversion.search.least_squares import State
from structid.study.schema.study import Study

_LAYOUTS = "structid checkpoint "
_LAYOUT = f"{_LAYOUTS}2"
_RUN, _SEARCH, _SO_FAR = "run.json", "search.npz", "so_far.json"
_WHOLE, _ANEW = "a whole checkpoint", "run without --resume to begin anew"
_MOST_FILES = 64


class RunIdentity(TypedDict):
    """Versions and contents of all input files, which decide about every digit of a run."""

    layout: str
    versions: dict[str, str]
    inputs: dict[str, str]


def checkpoint_folder(results: Path) -> Path:
    """Folder of the checkpoint of a run whose results go to the folder `results`."""
    return results.parent / f"{results.name}.checkpoint"


def fingerprint(study: Study) -> RunIdentity:
    """Description of the run of a study by which its checkpoint is recognized: layout, versions and digests of input files."""
    import scipy

    versions = {"structid": __version__, "numpy": np.__version__, "scipy": scipy.__version__}
    return {"layout": _LAYOUT, "versions": versions, "inputs": dict(study.digests)}


class Checkpoint:
    """Finished searches and tasks of a run by name, and the state of the search that runs.

    Parameters
    ----------
    folder : Path
    owner : RunIdentity
        The `fingerprint` of the study.
    resume : bool
        True to go on from what is there; otherwise it is removed.
    seconds : float
        At most one file in that time: what a killed run may have to do again. 0 writes every iteration and every task.

    Raises
    ------
    FileError
        If there is nothing to resume, it is damaged, it belongs to other input files or versions, or another process
        writes to it.
    """

    def __init__(self, folder: Path, owner: RunIdentity, resume: bool = False, seconds: float = 0.0) -> None:
        """Claim `folder` for the run that `owner` describes; read its entries with `resume`, else remove an old checkpoint.

        The checkpoint is written at most once in `seconds`.

        Raises
        ------
        FileError
            If another run has claimed the folder, it holds other files, or there is no checkpoint of this run to resume.
        """
        self.folder, self.owner, self.seconds = folder, owner, seconds
        self.entries: dict[str, Any] = {}
        self._search: tuple[str, State] | None = None
        self._latest: tuple[str, Callable[[], State]] | None = None
        self._unwritten: list[str] = []
        self._written = time.monotonic()
        self._files = 0
        self._is_made = False
        make_folder(folder.parent)
        claim(folder)
        try:
            if resume:
                self._read()
            elif folder.exists():
                _require_checkpoint(folder)
                shutil.rmtree(folder)
        except BaseException:
            self.close()
            raise

    @property
    def n_found(self) -> int:
        """Number of finished searches and tasks."""
        return len(self.entries)

    def state_of(self, name: str) -> State | None:
        """State of the search `name` when the previous run ended; None where it had not begun or was finished."""
        return self._search[1] if self._search is not None and self._search[0] == name else None

    def finished(self, name: str, result: object) -> None:
        """Store the result of the search or task `name`, drop the state of a search under way, and write if due.

        Writing is due if `seconds` of this checkpoint have passed since the last time.
        """
        self.entries[name] = result
        self._unwritten.append(name)
        self._latest = None
        self._write_if_due()

    def running(self, name: str, state: Callable[[], State]) -> None:
        """Take note of the running search `name` and of `state`, which makes its state when called; write if it is due."""
        self._latest = name, state
        self._write_if_due()

    def write(self, so_far: Mapping[str, StoredEntry] | None = None) -> None:
        """Write all entries that are not written yet, and the state of the search under way.

        Entries go into a new file; after 64 files, all go into one. `so_far` are the values reached so far, by name; if
        given, they are written as JSON for people to read.

        Raises
        ------
        FileError
            If the disk is full, or the folder cannot be written.
        """
        self._make_folder()
        if self._unwritten:
            if self._files >= _MOST_FILES:
                self._write_all()
            else:
                self._files += 1
                _save(_part(self.folder, self._files), {name: self.entries[name] for name in self._unwritten})
            self._unwritten.clear()
        if self._latest is not None:
            name, state = self._latest
            _save(self.folder / _SEARCH, {"name": name, "state": dict(state())})
            self._latest = None
        if so_far is not None:
            _write_json(self.folder / _SO_FAR, so_far)
        self._written = time.monotonic()

    def close(self) -> None:
        """Give up the claim of this run on the folder, so that another run may have it; its files stay."""
        release(self.folder)

    def remove(self) -> None:
        """Remove the folder of the checkpoint and release it, after the run is complete."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.close()

    def _write_if_due(self) -> None:
        if time.monotonic() - self._written >= self.seconds:
            self.write()

    def _make_folder(self) -> None:
        """Create the folder with the description of its run, unless this object has done so."""
        if not self._is_made:
            make_folder(self.folder)
            _write_json(self.folder / _RUN, cast(Mapping[str, StoredEntry], self.owner))
            self._is_made = True

    def _write_all(self) -> None:
        """Write all entries to one file, and remove the other files, which it replaces.

        The first file holds all entries before the others are removed, so that nothing is lost if the process ends between.
        """
        _save(_part(self.folder, 1), self.entries)
        for number in range(2, self._files + 1):
            _part(self.folder, number).unlink(missing_ok=True)
        self._files = 1

    def _read(self) -> None:
        """Read the entries and the state of an unfinished search that an earlier run wrote.

        Raises `FileError` if there are none, they are damaged, or they belong to another run.
        """
        if not (self.folder / _RUN).is_file():
            raise FileError(f"{self.folder}: there is no checkpoint to go on from; run without --resume")
        with damage_told(self.folder / _RUN, _WHOLE, _ANEW):
            owner = json.loads((self.folder / _RUN).read_text(encoding="utf-8"))
        _require_same_run(self.folder, self.owner, owner)
        for stale in self.folder.glob(".*"):
            stale.unlink(missing_ok=True)
        for path in sorted(self.folder.glob("done-*.npz")):
            self.entries.update(_load(path))
            self._files = int(path.stem.split("-")[1])
        if (self.folder / _SEARCH).is_file():
            search = _load(self.folder / _SEARCH)
            name, state = search.get("name"), search.get("state")
            if not isinstance(name, str) or not isinstance(state, dict):
                raise FileError(f"{self.folder / _SEARCH}: is not {_WHOLE} (no name and state); {_ANEW}")
            self._search = name, state


def _part(folder: Path, number: int) -> Path:
    return folder / f"done-{number:05d}.npz"


def _require_same_run(folder: Path, this_run: RunIdentity, owner: JsonValue) -> None:
    """Raise `FileError` if the checkpoint in `folder` is of another run, and name what differs: layout, an input or a version.

    `this_run` describes the present run, `owner` is the description read from the checkpoint.
    """
    anew = f"put it back, or {_ANEW}"
    layout = owner.get("layout") if isinstance(owner, dict) else None
    if not isinstance(owner, dict) or not isinstance(layout, str) or not layout.startswith(_LAYOUTS):
        raise FileError(f"{folder}: is no checkpoint of this program; {anew}")
    if layout != _LAYOUT:
        raise FileError(f"{folder}: was written by another version of structid; {_ANEW}")
    inputs, versions = owner.get("inputs"), owner.get("versions")
    if not isinstance(inputs, dict) or not isinstance(versions, dict):
        raise FileError(f"{folder / _RUN}: is not {_WHOLE} (no inputs and versions); {_ANEW}")
    for name in sorted({*inputs, *this_run["inputs"]}):
        if inputs.get(name) != this_run["inputs"].get(name):
            raise FileError(f"{folder}: {name} has changed since this checkpoint was written; {anew}")
    for name, version in this_run["versions"].items():
        if versions.get(name) != version:
            raise FileError(
                f"{folder}: was written with {name} {versions.get(name)}, this is {version}, whose digits may"
                f" differ; install that version, or {_ANEW}"
            )


def _require_checkpoint(folder: Path) -> None:
    """Raise `FileError` if `folder` is a file or holds any file that no checkpoint has, so that it must not be removed."""
    own_files = {_RUN, _SEARCH, _SO_FAR}
    if not folder.is_dir():
        raise FileError(f"{folder}: is a file where the checkpoint goes; move it, or give another --out")
    foreign = [p.name for p in folder.iterdir() if p.name not in own_files and not p.name.startswith(("done-", "."))]
    if foreign:
        raise FileError(f"{folder}: holds {foreign[0]}, which is no checkpoint; move it, or give another --out")


def _write_json(path: Path, value: Mapping[str, StoredEntry]) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text(json_text(value), encoding="utf-8")


def _save(path: Path, tree: Mapping[str, StoredEntry]) -> None:
    """Write nested mappings and lists of numbers, texts and arrays to an NPZ file: the tree as JSON, arrays bit for bit."""
    arrays: list[np.ndarray] = []
    text = json.dumps(plain(tree, arrays))
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        named: dict[str, Any] = {f"a{k}": array for k, array in enumerate(arrays)}
        np.savez(stream, tree=np.array(text), **named)


def _load(path: Path) -> dict[str, StoredEntry]:
    """Nested mappings and lists of numbers, texts and arrays from the NPZ file at `path`, a part of a checkpoint.

    `FileError` if the file is damaged.
    """
    arrays = npz_arrays(path, _WHOLE, _ANEW)
    with damage_told(path, _WHOLE, _ANEW):
        entries = fill_tree(json.loads(str(arrays["tree"])), lambda number: arrays[f"a{number}"])
        if not isinstance(entries, dict):
            raise ValueError("it holds no entries by name")
        return entries
