"""State that the workbench keeps for a user outside all folders: recent folders, confirmed commands, queue of runs."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

from structid.workbench.folder import read_json

_FOLDERS, _MOST_FOLDERS = "folders.json", 12
_COMMANDS, _MOST_COMMANDS = "confirmed_commands.json", 500


def state_folder() -> Path:
    """Folder of structid in the user's state directory, readable by the user alone; created if missing.

    It is ``structid`` in ``$XDG_STATE_HOME``, by default ``~/.local/state``; on Windows in the local application data.

    Raises
    ------
    OSError
        If it cannot be created.
    """
    base = os.environ.get("XDG_STATE_HOME") or (os.environ.get("LOCALAPPDATA") if os.name == "nt" else None)
    folder = (Path(base) if base else Path.home() / ".local" / "state") / "structid"
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    return folder


def write_private(path: Path, text: str) -> None:
    """Write `text` to a file that only the user may read; an existing file is replaced as a whole."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
        stream.write(text)
    temporary.replace(path)


def recent_folders() -> list[str]:
    """Up to 12 folders that were open before and still exist, the latest first."""
    return [path for path in _read_list(_FOLDERS) if Path(path).is_absolute() and Path(path).is_dir()][:_MOST_FOLDERS]


def remember(folder: Path) -> None:
    """Put `folder` first in the list of recent folders; a list that cannot be written is left unchanged."""
    _put_first(_FOLDERS, str(folder), _MOST_FOLDERS)


def is_confirmed(confirmation: str) -> bool:
    """True if the user has confirmed the command with this `confirmation`, see `confirmation_of`."""
    return confirmation in _read_list(_COMMANDS)


def remember_confirmed(confirmation: str) -> None:
    """Store that the user has confirmed a command; if that fails, the user is asked again next time."""
    _put_first(_COMMANDS, confirmation, _MOST_COMMANDS)


def _read_list(name: str) -> list[str]:
    """Texts in the JSON list `name` of the user's state folder, without repeats; [] if it is missing or no list."""
    with suppress(OSError):
        listed = read_json(state_folder() / name)
        return list(dict.fromkeys(text for text in listed if isinstance(text, str))) if isinstance(listed, list) else []
    return []


def _put_first(name: str, entry: str, most: int) -> None:
    with suppress(OSError):
        write_private(state_folder() / name, json.dumps(list(dict.fromkeys([entry, *_read_list(name)]))[:most]))
