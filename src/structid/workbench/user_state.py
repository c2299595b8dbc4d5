"""State that the workbench keeps for a user outside all folders: recent folders, confirmed commands, queue of runs."""

from __future__ import annotations

import os
from pathlib import Path


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
