"""The folder that is open: its studies, records and results, and no path outside it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tomllib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

from structid.core.errors import FileError, InputError
from structid.fem import importers, meshes
from structid.files import atomic_write
from structid.modal.formats.csv import is_modes_table
from structid.modal.formats.files import CSV_SUFFIXES, JSON_SUFFIXES, UFF_SUFFIXES
from structid.modal.formats.nastran import F06_SUFFIXES, PUNCH_SUFFIXES
from structid.records.formats import FORMATS, LOGGERS, LoggerFormat

#: Where the workbench keeps its own things inside the folder: logs of runs, overviews of long records.
OWN = ".structid"
#: By their suffix; JSON, TOML and text files are looked into.
_RECORDS: tuple[ModuleType | LoggerFormat, ...] = (*FORMATS, *LOGGERS)
RECORD_SUFFIXES = (*(suffix for one in _RECORDS for suffix in one.SUFFIXES), *F06_SUFFIXES)
_MODELS: tuple[ModuleType, ...] = (*meshes.FORMATS, *importers.FORMATS)
MODEL_SUFFIXES = tuple(suffix for one in _MODELS for suffix in one.SUFFIXES if suffix not in RECORD_SUFFIXES)
_DEEPEST, _MOST = 4, 3000
_RESULT, _MODES = "estimate.json", "modes.json"
#: Texts and numbers at most before the frequencies.
_MODES_BEGIN = re.compile(
    rb'\s*\{\s*(?:"(?:title|method|n_modes)":\s*(?:"(?:[^"\\]|\\.)*"|\d+|null),\s*)*"frequency_hz"'
)
#: A line of nothing but numbers, two or more.
_NUMBERS = re.compile(rb"^\s*[-+]?\d[\d.,eE+-]*(?:[;,\s]+[-+]?\d[\d.,eE+-]*)+\s*$", re.M)
#: Where a dataset of a universal file begins, with its number; and bytes of a file in which they are looked for.
_UFF_SETS, _OF_UFF = re.compile(rb"^ {4}-1[ \r]*\n +(\d+)", re.M), 1_000_000
_SECTIONS = {"structure", "unknown", "record", "plan", "method"}


class OutsideError(FileError):
    """A path that does not lie in the open folder."""


class ChangedError(FileError):
    """A study was changed by something else since it was read."""


@dataclass(frozen=True)
class OpenFolder:
    """The folder at `root`, an absolute path without links."""

    root: Path

    def inside(self, name: str) -> Path:
        """The path of `name`, given by slashes from the folder.

        Raises
        ------
        OutsideError
            If it is absolute, climbs out, or a link leads out.
        """
        parts = PurePosixPath(name).parts
        if not name or "\0" in name or "\\" in name or name.startswith("/") or ".." in parts or ":" in name:
            raise OutsideError(f"{name!r}: is no path inside the open folder")
        path = self.root.joinpath(*parts).resolve()
        if path == self.root or not path.is_relative_to(self.root):
            raise OutsideError(f"{name!r}: is no path inside the open folder")
        return path

    def name(self, path: Path) -> str:
        """`path` by slashes from the folder."""
        return path.relative_to(self.root).as_posix()

    @property
    def is_writable(self) -> bool:
        return os.access(self.root, os.W_OK)

    def listing(self) -> dict[str, Any]:
        """Studies with their titles, records, other inputs and results of the folder, a few levels deep.

        ``most`` is how many files are looked at where there are more, else None.
        """
        files, is_all = self._files()
        found: dict[str, list[dict[str, Any]]] = {"studies": [], "records": [], "models": [], "results": []}
        for path in files:
            name, suffix = self.name(path), path.suffix.lower()
            if path.name == _RESULT:
                found["results"].append({"path": self.name(path.parent), "changed": path.stat().st_mtime})
            elif self._is_result(path):
                continue
            elif suffix == ".toml":
                found["studies"] += _study(name, path)
            elif suffix in RECORD_SUFFIXES:
                if suffix != ".txt" or _holds_numbers(path):
                    found["records"].append({"path": name, "bytes": path.stat().st_size, "modes": holds_modes(path)})
            elif suffix in (*PUNCH_SUFFIXES, *JSON_SUFFIXES) and holds_modes(path):
                found["records"].append({"path": name, "bytes": path.stat().st_size, "modes": True})
            elif suffix in MODEL_SUFFIXES:
                found["models"].append({"path": name, "bytes": path.stat().st_size})
        return {"folder": str(self.root), "writable": self.is_writable, "most": None if is_all else _MOST, **found}

    def stamps(self) -> dict[str, int]:
        """When each TOML file that `listing` looks at was changed, ns."""
        found = {}
        for path in self._files()[0]:
            if path.suffix == ".toml":
                with suppress(OSError):
                    found[self.name(path)] = path.stat().st_mtime_ns
        return found

    def _is_result(self, path: Path) -> bool:
        """Whether it is a file of results but no suggested study, or the same modes that modes.json beside it holds."""
        copied = path.name in ("modes.csv", "modes.uff") and (path.parent / _MODES).exists()
        return copied or (path.parent / _RESULT).exists() or path.parent.name == "figures"

    def _files(self) -> tuple[list[Path], bool]:
        """Files of the folder, a few levels deep, and whether they are all that are there."""
        found: list[Path] = []
        count = 0
        for folder, folders, files in os.walk(self.root):
            here = Path(folder)
            depth = len(here.relative_to(self.root).parts)
            folders[:] = sorted(
                f for f in folders if depth < _DEEPEST and not f.startswith(".") and not f.endswith(".checkpoint")
            )
            for file in sorted(files):
                count += 1
                if count > _MOST:
                    return found, False
                if not file.startswith("."):
                    found.append(here / file)
        return found, True

    def text(self, name: str) -> tuple[str, str]:
        """The text of a study and its digest.

        Raises
        ------
        FileError
            If it is not there or no text.
        """
        path = self.inside(name)
        try:
            given = path.read_bytes()
            return given.decode("utf-8-sig"), digest(given)
        except FileNotFoundError:
            raise FileError(f"{name}: is not there any more; it was moved or removed") from None
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(f"{name}: cannot be read as text ({error})") from error

    def save(self, name: str, text: str, before: str) -> str:
        """Write the text of a study that still has the digest `before`; "" for a new one. The new digest.

        Raises
        ------
        ChangedError
            If it changed since; nothing is written then.
        FileError
            If it cannot be written.
        """
        path = self.inside(name)
        if path.suffix.lower() != ".toml":
            raise InputError(f"{name}: a study is a file that ends in .toml")
        now = digest(path.read_bytes()) if path.exists() else ""
        if now != before:
            raise ChangedError(
                f"{name}: was changed by another page or program; what it says now is shown, change it again"
                if now
                else f"{name}: was removed; save it under a new name"
            )
        raw = text.encode("utf-8")
        with atomic_write(path) as temporary:
            temporary.write_bytes(raw)
        return digest(raw)

    def own(self, *parts: str) -> Path:
        """A folder of the workbench's own, made where it does not exist.

        Raises
        ------
        FileError
            If it cannot be made.
        """
        path = self.root.joinpath(OWN, *parts)
        try:
            path.mkdir(parents=True, exist_ok=True)
            ignore = self.root / OWN / ".gitignore"
            if not ignore.exists():
                ignore.write_text("*\n", encoding="utf-8")
        except OSError as error:
            raise FileError(
                f"{self.root}: cannot be written ({error.strerror or error}); open a folder that you may write to"
            ) from error
        return path


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def opened(path: Path) -> OpenFolder:
    """The folder at `path`.

    Raises
    ------
    FileError
        If there is none, or what it holds may not be seen.
    """
    try:
        if not path.is_dir():
            raise FileError(f"{path}: {_no_folder(path)}; give the folder of your studies and records")
        next(path.iterdir(), None)
        return OpenFolder(path.resolve())
    except OSError as error:
        raise FileError(f"{path}: cannot be opened ({error.strerror or error}); check its permissions") from error


def _no_folder(path: Path) -> str:
    if path.exists():
        return "is a file and no folder"
    there = next((one for one in path.absolute().parents if one.is_dir()), None)
    return f"is no folder; {there} is there, and nothing of that name in it" if there else "is no folder"


def typed_folder(text: str) -> Path:
    """The path that somebody typed or pasted: whole, or from the home folder with ``~``, in quotes or not.

    Raises
    ------
    InputError
        If it is empty or no whole path.
    """
    words = text.strip()
    if len(words) > 1 and words[0] == words[-1] and words[0] in "'\"":
        words = words[1:-1]
    if words.startswith("~"):
        try:
            path = Path(words).expanduser()
        except RuntimeError as error:
            raise InputError(f"{words}: there is no such user; give the whole path of the folder") from error
    else:
        path = Path(words)
    if not words or "\0" in words or not path.is_absolute():
        raise InputError(
            f"{text.strip() or 'nothing'}: is no whole path; give the folder from the root of the disk, as in {Path.home()}, or"
            " from your home folder, as in ~/measurements"
        )
    return path


def upload_name(name: str) -> str:
    """`name` of a dropped file as it may be written: one part, no sign that leads elsewhere.

    Raises
    ------
    InputError
        If nothing is left, or its suffix is of no file that a study reads.
    """
    clean = re.sub(r"[^\w .()+-]", "_", name.replace("\\", "/").rpartition("/")[2]).strip(" .")[:120]
    suffix = Path(clean).suffix.lower()
    if not clean or suffix not in (*RECORD_SUFFIXES, *MODEL_SUFFIXES, ".toml", ".json", ".txt"):
        raise InputError(f"{name}: a file of this kind is no study, record, mesh or matrix; convert it first")
    return clean


def _study(name: str, path: Path) -> list[dict[str, Any]]:
    """A study of a folder, also one that is broken; nothing for other TOML files."""
    try:
        text = path.read_bytes()[:50_000_000].decode("utf-8-sig")
        if len(text) > 5_000_000:
            return [{"path": name, "title": path.stem, "broken": ""}]
        table = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        return [{"path": name, "title": path.stem, "broken": str(error)}]
    if not _SECTIONS & set(table):
        return []
    title = table.get("title")
    return [{"path": name, "title": title if isinstance(title, str) else path.stem, "broken": ""}]


def holds_modes(path: Path) -> bool:
    """Whether a file holds modes, and no responses: JSON by its first keys, tables by what heads their columns."""
    suffix = path.suffix.lower()
    if suffix in CSV_SUFFIXES:
        return is_modes_table(path)
    if suffix in PUNCH_SUFFIXES:
        return b"$EIGENVALUE" in _begin(path)
    if suffix in UFF_SUFFIXES:
        sets = set(_UFF_SETS.findall(_begin(path, _OF_UFF)))
        return b"55" in sets and b"58" not in sets
    return suffix in F06_SUFFIXES or (suffix in JSON_SUFFIXES and _MODES_BEGIN.match(_begin(path)) is not None)


def _holds_numbers(path: Path) -> bool:
    """Whether a text file begins as a table: a line of two numbers or more, whatever stands above it."""
    return _NUMBERS.search(_begin(path).replace(b"\0", b"")) is not None


def _begin(path: Path, count: int = 4096) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(count)
    except OSError:
        return b""


def read_json(path: Path) -> Any:
    """The content of a JSON file; None where it is not there or not whole."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
