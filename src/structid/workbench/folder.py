"""The folder that is open: its studies, records and results, and no path outside it."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import stat
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from threading import Lock
from typing import Any

from structid.core.errors import FileError, InputError
from structid.fem import importers, meshes
from structid.files import claim_path, read_start, replace_unchanged
from structid.lazy import FormatModule
from structid.modal.formats.options import F06_SUFFIXES, FRD_SUFFIXES, JSON_SUFFIXES, OP2_SUFFIXES, PUNCH_SUFFIXES
from structid.modal.formats.recognition import holds_modes
from structid.records.formats import FORMATS, LOGGERS, LoggerFormat
from structid.study.schema.toml_lines import parse_toml

#: Where the workbench keeps its own things inside the folder: logs of runs, overviews of long records.
OWN = ".structid"
#: How a folder of files for other programs ends, beside the results that they are made of; it holds no records of the study.
EXPORTS = "_exports"
#: By their suffix; JSON, TOML and text files are looked into.
_RECORDS: tuple[FormatModule | LoggerFormat, ...] = (*FORMATS, *LOGGERS)
RECORD_SUFFIXES = (
    *(suffix for one in _RECORDS for suffix in one.SUFFIXES),
    *F06_SUFFIXES,
    *OP2_SUFFIXES,
    *FRD_SUFFIXES,
)
_MODELS: tuple[FormatModule, ...] = (*meshes.FORMATS, *importers.FORMATS)
MODEL_SUFFIXES = tuple(suffix for one in _MODELS for suffix in one.SUFFIXES if suffix not in RECORD_SUFFIXES)
_LISTED = {".toml", *RECORD_SUFFIXES, *MODEL_SUFFIXES, *PUNCH_SUFFIXES, *JSON_SUFFIXES}
#: Levels of folders and files that are looked at, and entries of a folder at most that are put in order.
_DEEPEST, _MOST, _MOST_SORTED = 4, 3000, 100_000
_RESULT, _MODES = "estimate.json", "modes.json"
#: Bytes of a study that are looked at for the list, and of all studies that are parsed for one list.
_STUDY_BYTES, _PARSED_BYTES = 200_000, 500_000
#: Bytes of a study at most that the page shows, and of a file of JSON at most that the server reads.
_MOST_TEXT, _MOST_JSON = 50_000_000, 100_000_000
#: A number in a line of nothing but numbers; commas and semicolons are blanks there.
_NUMBER, _APART = re.compile(rb"[-+]?\d[\d.eE+-]*"), bytes.maketrans(b";,\0", b"   ")
_SECTIONS = {"structure", "unknown", "record", "plan", "method"}
#: The same in the text of a study that is too long to be parsed for a list, and its title.
_HEADER = re.compile(rf"^[ \t]*\[\[?[ \t]*(?:{'|'.join(sorted(_SECTIONS))})\b", re.M)
_TITLE = re.compile(r'^title[ \t]*=[ \t]*"((?:[^"\\\n]|\\.)*)"', re.M)


#: One save of this process at a time; another process is waited for so long, s.
_saving, _SAVE_SECONDS = Lock(), 5.0


class OutsideError(FileError):
    """A path that does not lie in the open folder."""


class ChangedError(FileError):
    """A study was changed by something else since it was read."""


@dataclass(frozen=True)
class OpenFolder:
    """The folder at `root`, an absolute path without links."""

    root: Path

    def inside(self, name: str) -> Path:
        """Absolute path of `name`, a relative path with slashes, in the open folder.

        Raises
        ------
        OutsideError
            If `name` is empty, absolute or the folder itself, contains "..", a backslash, a colon or a null character,
            or
            leads out of the folder through a link.
        """
        parts = PurePosixPath(name).parts
        if not name or "\0" in name or "\\" in name or name.startswith("/") or ".." in parts or ":" in name:
            raise OutsideError(f"{name!r}: is no path inside the open folder")
        try:
            path = self.root.joinpath(*parts).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a name that no system has
            raise OutsideError(f"{name!r}: is no path inside the open folder ({error})") from error
        if path == self.root or not path.is_relative_to(self.root):
            raise OutsideError(f"{name!r}: is no path inside the open folder")
        return path

    def name(self, path: Path) -> str:
        """Path relative to the open folder, with slashes; `path` must lie inside."""
        return path.relative_to(self.root).as_posix()

    @property
    def is_writable(self) -> bool:
        return os.access(self.root, os.W_OK)

    def listing(self) -> dict[str, Any]:
        """Studies, records, models and results of the folder, up to four levels deep: lists of mappings with ``path``.

        Studies have ``title`` and ``broken`` (the error, "" if none), records ``bytes`` and ``modes`` (True if they
        hold modes), models ``bytes``, results ``changed`` (s since 1970). ``unusable`` lists files that cannot be used,
        with the reason as ``words``; ``most`` is None, or 3000 if more files exist and the rest was left out.
        ``folder`` is its path and ``writable`` says if it can be written. Only the beginnings of ordinary files are
        read.
        """
        files, is_all = self._files()
        lists: dict[str, list[dict[str, Any]]] = {
            "studies": [], "records": [], "models": [], "results": [], "unusable": []
        }  # fmt: skip
        results = {path.parent for path, _ in files if path.name == _RESULT}
        modes = {path.parent for path, _ in files if path.name == _MODES}
        budget = _PARSED_BYTES
        for path, size in files:
            name, suffix = self.name(path), path.suffix.lower()
            is_copy = path.name in ("modes.csv", "modes.uff") and path.parent in modes
            try:
                if path.name == _RESULT:
                    self.inside(name)
                    lists["results"].append({"path": self.name(path.parent), "changed": path.stat().st_mtime})
                elif is_copy or path.parent in results or path.parent.name == "figures" or suffix not in _LISTED:
                    continue
                elif words := self._refusal(path):
                    lists["unusable"].append({"path": _shown_name(name), "words": words})
                elif suffix == ".toml":
                    budget -= min(size, _STUDY_BYTES)
                    lists["studies"] += _study(name, path, size, budget > 0)
                elif suffix in RECORD_SUFFIXES:
                    if suffix != ".txt" or holds_numbers(path):
                        lists["records"].append({"path": name, "bytes": size, "modes": holds_modes(path)})
                elif suffix in (*PUNCH_SUFFIXES, *JSON_SUFFIXES) and holds_modes(path):
                    lists["records"].append({"path": name, "bytes": size, "modes": True})
                elif suffix in MODEL_SUFFIXES:
                    lists["models"].append({"path": name, "bytes": size})
            except (OSError, OutsideError) as error:
                words = f"cannot be read ({getattr(error, 'strerror', None) or error})"
                lists["unusable"].append({"path": _shown_name(name), "words": words})
        return {"folder": str(self.root), "writable": self.is_writable, "most": None if is_all else _MOST, **lists}

    def stamps(self) -> dict[str, str]:
        """Modification time (ns) and size (bytes), joined by a space, of each TOML file in the folder, by path in it.

        Files are searched for up to four levels deep; those that cannot be read are left out.
        """
        stamps = {}
        for path, _ in self._files()[0]:
            if path.suffix.lower() == ".toml":
                with suppress(OSError):
                    stat = path.stat()
                    stamps[_shown_name(self.name(path))] = f"{stat.st_mtime_ns} {stat.st_size}"
        return stamps

    def _refusal(self, path: Path) -> str:
        """Reason in words why the page cannot use the file at `path`, such as a broken link; "" if it can."""
        if not _is_printable(path.name) or any(sign in path.name for sign in ":\\"):
            return "its name holds a sign that is not used here; give it another name"
        if path.is_symlink():
            try:
                target = path.resolve(strict=True)
            except FileNotFoundError:
                return "is a broken link; restore its target, or remove the link"
            except (OSError, RuntimeError):
                return "is a link that leads to itself; remove it"
            if not target.is_relative_to(self.root):
                return "is a link that leaves the folder, which is not followed; copy the file itself"
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            return "is a pipe or a device, and no file"
        return "" if stat.S_ISREG(mode) else "is a folder"

    def _files(self) -> tuple[list[tuple[Path, int]], bool]:
        """Files up to four levels below the folder with their sizes in bytes, and True if none was left out.

        At most 3000 entries are taken. Hidden files and folders, checkpoints and folders of exports are skipped.
        """
        files: list[tuple[Path, int]] = []
        folders, count = [(self.root, 0)], 0
        while folders:
            folder, depth = folders.pop()
            try:
                with os.scandir(folder) as scan:
                    entries = sorted(islice(scan, _MOST_SORTED), key=lambda entry: entry.name)
            except OSError:  # one that may not be read, or that was just removed
                continue
            inner = []
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    if (
                        depth < _DEEPEST
                        and not entry.name.startswith(".")
                        and not entry.name.endswith((".checkpoint", EXPORTS))
                    ):
                        inner.append((folder / entry.name, depth + 1))
                    continue
                count += 1
                if count > _MOST:
                    return files, False
                if not entry.name.startswith("."):
                    with suppress(OSError):
                        files.append((folder / entry.name, entry.stat(follow_symlinks=False).st_size))
            folders += reversed(inner)
        return files, True

    def files_in(self, folder: Path, most: int) -> list[Path]:
        """Sorted paths of at most `most` ordinary files in `folder` and its subfolders; links and hidden files are left out.

        Of more files those are taken that a walk from the top meets first.
        """
        files: list[Path] = []
        for inner, folders, names in os.walk(folder):
            folders[:] = sorted(
                name for name in folders if not (name.startswith(".") or Path(inner, name).is_symlink())
            )
            paths = [Path(inner, name) for name in sorted(names) if not name.startswith(".")]
            files += [path for path in paths if _is_printable(path.name) and not path.is_symlink() and path.is_file()]
            if len(files) > most:
                break
        return sorted(files[:most])

    def text(self, name: str) -> tuple[str, str]:
        """Text of the study file `name` (UTF-8, a byte-order mark left out) and the digest of its bytes.

        Raises
        ------
        FileError
            If the file is missing, is no text, or is larger than 50 MB.
        OutsideError
            If it lies outside the open folder.
        """
        path = self.inside(name)
        try:
            content = read_start(path, _MOST_TEXT + 1)
            if len(content) > _MOST_TEXT:
                raise FileError(f"{name}: is larger than {_MOST_TEXT // 1_000_000} MB, which the page does not show")
            return content.decode("utf-8-sig"), digest(content)
        except FileNotFoundError:
            raise FileError(f"{name}: is not there any more; it was moved or removed") from None
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(f"{name}: cannot be read as text ({error})") from error

    def save(self, name: str, text: str, before: str) -> str:
        """Save the text of a study if its file still has the digest `before` ("" if new), and return its new digest.

        Other processes may write at the same time; what they wrote is never overwritten.

        Raises
        ------
        ChangedError
            If the file was changed or removed since; nothing is written then.
        InputError
            If `name` does not end in .toml.
        FileError
            If it cannot be written or is no file, or, as `OutsideError`, lies outside the open folder.
        """
        path = self.inside(name)
        if path.suffix.lower() != ".toml":
            raise InputError(f"{name}: a study is a file that ends in .toml")
        if path.exists() and not path.is_file():
            raise FileError(f"{name}: is no file")
        content = text.encode("utf-8")
        with _saving, claim_path(path, _SAVE_SECONDS):
            is_saved = replace_unchanged(
                path, content, lambda there: before == ("" if there is None else digest(there))
            )
        if not is_saved:
            raise ChangedError(
                f"{name}: was changed by another page or program; what it says now is shown, change it again"
                if path.exists()
                else f"{name}: was removed; save it under a new name"
            )
        return digest(content)

    def data_folder(self, *parts: str) -> Path:
        """Path of the subfolder `parts` of ``.structid``, the data folder in the open folder; created if missing.

        The data folder also gets a ``.gitignore`` that keeps all of it out of version control.

        Raises
        ------
        FileError
            If it cannot be created, or is a link.
        """
        path = self.root
        try:
            for part in (OWN, *parts):
                path = path / part
                path.mkdir(exist_ok=True)
                if path.is_symlink():
                    raise FileError(f"{self.name(path)}: is a link, to which nothing is written; remove it")
            ignore = self.root / OWN / ".gitignore"
            with suppress(FileExistsError), ignore.open("x", encoding="utf-8") as stream:
                stream.write("*\n")
        except OSError as error:
            raise FileError(
                f"{self.root}: cannot be written ({error.strerror or error}); open a folder that you may write to"
            ) from error
        return path


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def open_study_folder(path: Path) -> OpenFolder:
    """Folder at `path`, opened for the workbench.

    Raises
    ------
    FileError
        If there is no such folder, or it cannot be read.
    """
    try:
        if not path.is_dir():
            raise FileError(f"{path}: {_no_folder(path)}; give the folder of your studies and records")
        next(path.iterdir(), None)
        return OpenFolder(path.resolve())
    except OSError as error:
        raise FileError(f"{path}: cannot be opened ({error.strerror or error}); check its permissions") from error


def _no_folder(path: Path) -> str:
    """Reason in words why `path` is not a folder, naming the nearest parent folder that exists."""
    if path.exists():
        return "is a file and no folder"
    there = next((one for one in path.absolute().parents if one.is_dir()), None)
    return f"is no folder; {there} is there, and nothing of that name in it" if there else "is no folder"


def typed_folder(text: str) -> Path:
    """Path of a folder from `text` as typed or pasted by a user: absolute or from ``~``, with or without quotes.

    The folder need not exist.

    Raises
    ------
    InputError
        If it is empty or relative.
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
    """Safe file name for an uploaded file: no folders, other signs replaced by "_", cut to 120 characters before its suffix.

    Raises
    ------
    InputError
        If nothing is left, or a study reads no files of the suffix.
    """
    clean = Path(re.sub(r"[^\w .()+-]", "_", name.replace("\\", "/").rpartition("/")[2]).strip(" ."))
    if clean.suffix.lower() not in (*RECORD_SUFFIXES, *MODEL_SUFFIXES, ".toml", ".json", ".txt"):
        raise InputError(f"{name}: a file of this kind is no study, record, mesh or matrix; convert it first")
    return clean.stem[: 120 - len(clean.suffix)].rstrip(" .") + clean.suffix


def _shown_name(name: str) -> str:
    """File name as printable text; bytes and signs that cannot be printed become U+FFFD."""
    text = os.fsencode(name).decode("utf-8", "replace")
    return "".join(sign if sign.isprintable() else "\ufffd" for sign in text)


def _is_printable(name: str) -> bool:
    """True if a name is a text in UTF-8 without signs that steer."""
    return name.isprintable()


def _study(name: str, path: Path, size: int, is_parsed: bool) -> list[dict[str, Any]]:
    """Entry of a TOML study for the listing, in a list; [] if the TOML file has no section of a study.

    An entry has ``path``, ``title`` (the file's name if there is none) and ``broken``, the error of a file that is no
    TOML, else "". `name` is its path in the folder, `size` is in bytes. Without `is_parsed`, or above 200 kB, the text
    is searched for section headers and a title only.
    """
    begin = read_start(path, _STUDY_BYTES)
    try:
        if not is_parsed or size > _STUDY_BYTES:
            text = begin.decode("utf-8-sig", "replace")
            title = _TITLE.search(text)
            return (
                [{"path": name, "title": title[1] if title else path.stem, "broken": ""}]
                if _HEADER.search(text)
                else []
            )
        table = parse_toml(begin.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        return [{"path": name, "title": path.stem, "broken": str(error)[:500]}]
    if not _SECTIONS & set(table):
        return []
    title = table.get("title")
    return [{"path": name, "title": title[:500] if isinstance(title, str) else path.stem, "broken": ""}]


def holds_numbers(path: Path) -> bool:
    """True if a line in the first 4096 bytes of a text file consists of two numbers or more."""
    for line in _begin(path).replace(b"\0", b"").splitlines():
        words = line.translate(_APART).split()
        if len(words) > 1 and all(map(_NUMBER.fullmatch, words)):
            return True
    return False


def _begin(path: Path, count: int = 4096) -> bytes:
    """First `count` bytes of a file; none if it cannot be read."""
    try:
        return read_start(path, count)
    except OSError:
        return b""


def read_json(path: Path, follow: bool = True) -> Any:
    """Content of a JSON file; None if it is missing, damaged or larger than 100 MB, or a link and `follow` is False."""
    try:
        content = read_start(path, _MOST_JSON + 1, follow)
    except OSError:
        return None
    return parse_json(content) if len(content) <= _MOST_JSON else None


def parse_json(content: bytes | str) -> Any:
    """Value of the JSON text `content`; None if it is not valid JSON. Numbers that are not finite become None too."""
    try:
        return json.loads(content, parse_constant=lambda _: None, parse_float=_finite)
    except (ValueError, RecursionError):
        return None


def _finite(text: str) -> float | None:
    value = float(text)
    return value if math.isfinite(value) else None
