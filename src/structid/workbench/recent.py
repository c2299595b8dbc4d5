"""Folders that were open before: a short list of paths in the user's state directory, and nothing of what they hold."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

from structid.core.errors import FileError
from structid.files import atomic_write
from structid.workbench.folder import read_json

_MOST = 12


def _kept() -> Path:
    """``folders.json`` in the state directory (XDG Base Directory Specification 0.8; on Windows the local application data)."""
    own = os.environ.get("XDG_STATE_HOME") or (os.environ.get("LOCALAPPDATA") if os.name == "nt" else None)
    return (Path(own) if own else Path.home() / ".local" / "state") / "structid" / "folders.json"


def recent_folders() -> list[str]:
    """Folders that were open, the last one first; those that are gone are left out."""
    found = read_json(_kept())
    listed = [one for one in found if isinstance(one, str)] if isinstance(found, list) else []
    return [one for one in dict.fromkeys(listed) if Path(one).is_absolute() and Path(one).is_dir()][:_MOST]


def remember(folder: Path) -> None:
    """Put `folder` first; where the list cannot be written it stays as it was."""
    listed = dict.fromkeys([str(folder), *recent_folders()])
    with suppress(OSError, FileError):
        _kept().parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(_kept()) as temporary:
            temporary.write_text(json.dumps(list(listed)[:_MOST]), encoding="utf-8")
