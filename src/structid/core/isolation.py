"""Processes that take no code and no settings from the folder in which a command is called, or that it opens.

Python looks for modules in the working directory, and libraries look there for settings (``matplotlibrc``,
``.numba_config.yaml``, ``arvizrc``). A folder of measurements may come from a stranger. Commands therefore work in
`NEUTRAL_FOLDER`, with paths made absolute before, and every child begins there with Python's safe path.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

#: Folder of the Python environment: who can write there can run code anyway.
NEUTRAL_FOLDER = Path(sys.prefix)
#: Flags of every Python that is started: the folder of a script and the working directory are no places of modules.
SAFE_FLAGS = ("-P",)
_PACKAGE_ROOT = Path(__file__).resolve().parents[2]
_changing_environment = threading.Lock()
#: Folders of the calls of commands in this process, and folders whose absolute paths the user wrote.
_calling: list[Path] = []
_given_absolute: set[str] = set()


def calling_folder() -> Path:
    """The folder in which the command was called, to which its relative paths refer."""
    return _calling[-1] if _calling else Path.cwd()


def absolute_paths(value: Any) -> Any:
    """Absolute path of `value`, or a list of them, from the folder in which the command was called.

    Lists are followed to any depth; values that are neither paths nor lists are unchanged. The folder of a path that is
    absolute already is noted, so that messages leave it so.
    """
    if isinstance(value, Path):
        if value.is_absolute():
            _given_absolute.add(str(value.parent if value.suffix else value))
        return calling_folder() / value
    return [absolute_paths(entry) for entry in value] if isinstance(value, list) else value


def paths_as_called(text: str) -> str:
    """The message `text` with absolute paths inside the calling folder shortened to relative ones.

    Paths that the user wrote as absolute ones stay.
    """
    folder = calling_folder()
    if str(folder) == folder.anchor:
        return text

    def shortened(match: re.Match[str]) -> str:
        """Replacement of the folder in `match`: ".", or "" before more of a path; itself in an absolute path given."""
        if any(text.startswith(absolute, match.start()) for absolute in _given_absolute):
            return match[0]
        return "" if match[1] else "."

    return re.sub(rf"(?<![\w.~/\\-]){re.escape(str(folder))}(?:([/\\])|(?![\w.-]))", shortened, text)


def import_paths(entries: list[str], folder: Path) -> list[str]:
    """`entries` of an import path made absolute from `folder`, each once.

    `folder` itself is left out, unless structid lies there.
    """
    absolute = [os.path.abspath(folder / entry) for entry in entries]  # noqa: PTH100 - zip archives are no folders
    refused = {str(folder), str(folder.resolve())} - {str(_PACKAGE_ROOT)}
    return [entry for entry in dict.fromkeys(absolute) if entry not in refused]


def child_environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment variables of a child process: those of this one with `changes`, and Python's safe path on.

    None makes no changes. The working directory is taken out of ``PYTHONPATH``, which is left out if nothing remains.
    """
    environment = {**os.environ, **(changes or {}), "PYTHONSAFEPATH": "1"}
    listed = environment.get("PYTHONPATH", "")
    kept = import_paths(listed.split(os.pathsep), Path.cwd()) if listed else []
    environment.pop("PYTHONPATH", None)
    return environment | ({"PYTHONPATH": os.pathsep.join(kept)} if kept else {})


def start_child(
    arguments: Sequence[str],
    folder: Path = NEUTRAL_FOLDER,
    *,
    stdin: int = subprocess.DEVNULL,
    output: IO[bytes] | int = subprocess.DEVNULL,
    errors: IO[bytes] | int = subprocess.DEVNULL,
    changes: Mapping[str, str] | None = None,
    has_group: bool = True,
) -> subprocess.Popen[bytes]:
    """A child process that works in `folder` with the `child_environment` of `changes`.

    Parameters
    ----------
    arguments : sequence of str
        Program and its arguments; `OSError` if it cannot be started.
    stdin, output, errors : file or int
        As `subprocess.Popen` takes them; nothing is read or kept by default.
    has_group : bool
        True if it begins a group of processes, with which `kill_child` ends what it started; False to get the signals
        that this process gets.
    """
    return subprocess.Popen(
        arguments, cwd=folder, stdin=stdin, stdout=output, stderr=errors, env=child_environment(changes),
        start_new_session=has_group,
    )  # fmt: skip


def python_arguments(*words: str) -> list[str]:
    """Arguments that start this Python with `words`, its script or ``-m`` and module, and with Python's safe path."""
    return [sys.executable, *SAFE_FLAGS, *words]


def kill_child(process: subprocess.Popen[bytes]) -> None:
    """Kill the child `process`, which must lead a process group of its own, and all that it started.

    It is not waited for; a group that has ended already is no error.
    """
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):  # it has ended, or its children take another user
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()


@contextmanager
def safe_child_environment() -> Iterator[None]:
    """Context manager that gives this process the environment of its children while the block runs.

    It has Python's safe path on and no working directory in ``PYTHONPATH``, for children to which no environment can be
    passed. Threads wait for each other; the old environment is restored.
    """
    with _changing_environment:
        before = dict(os.environ)
        changed = child_environment()
        try:
            _replace_environment(changed)
            yield
        finally:
            _replace_environment(before)


@contextmanager
def isolated() -> Iterator[None]:
    """Context manager whose block runs in `NEUTRAL_FOLDER` and imports nothing from the folder of the call.

    That folder is noted for `calling_folder`, also beyond the end of the block, so that relative paths still begin
    there. Folder, import path and environment are restored at the end.
    """
    folder, modules, environment = Path.cwd(), list(sys.path), dict(os.environ)
    _calling.append(folder)
    _given_absolute.clear()
    try:
        sys.path[:] = import_paths(sys.path, folder)
        _replace_environment(child_environment())
        os.chdir(NEUTRAL_FOLDER)
        yield
    finally:
        sys.path[:] = modules
        _replace_environment(environment)
        with suppress(OSError):  # it was removed meanwhile
            os.chdir(folder)


def _replace_environment(wanted: Mapping[str, str]) -> None:
    """Make the environment variables of this process those of `wanted`; only those that differ are touched."""
    for name in set(os.environ) - set(wanted):
        del os.environ[name]
    for name, value in wanted.items():
        if os.environ.get(name) != value:
            os.environ[name] = value
