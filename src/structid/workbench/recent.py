"""Folders that were open before, and commands that the user confirmed: short lists outside those folders."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from structid.workbench.folder import read_json
from structid.workbench.user_state import state_folder, write_private

_FOLDERS, _MOST_FOLDERS = "folders.json", 12
_COMMANDS, _MOST_COMMANDS = "confirmed_commands.json", 500


def recent_folders() -> list[str]:
    """Folders that were open, the last one first; those that are gone are left out."""
    return [path for path in _kept(_FOLDERS) if Path(path).is_absolute() and Path(path).is_dir()][:_MOST_FOLDERS]


def remember(folder: Path) -> None:
    """Put `folder` first; where the list cannot be written it stays as it was."""
    _put_first(_FOLDERS, str(folder), _MOST_FOLDERS)


def is_confirmed(confirmation: str) -> bool:
    """True if the user has confirmed a command, by `structid.external.confirmation.confirmation_of`."""
    return confirmation in _kept(_COMMANDS)


def remember_confirmed(confirmation: str) -> None:
    """Note that the user has confirmed a command; where that cannot be written it is asked again."""
    _put_first(_COMMANDS, confirmation, _MOST_COMMANDS)


def _kept(name: str) -> list[str]:
    """Texts stored in the JSON file `name` of the user's state folder, without repeats; [] if there is none."""
    with suppress(OSError):
        listed = read_json(state_folder() / name)
        return list(dict.fromkeys(text for text in listed if isinstance(text, str))) if isinstance(listed, list) else []
    return []


def _put_first(name: str, entry: str, most: int) -> None:
    with suppress(OSError):
        write_private(state_folder() / name, json.dumps(list(dict.fromkeys([entry, *_kept(name)]))[:most]))
