"""The files that a study reads, by the names that it gives them, with their digests."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from structid.files import digest, require_readable


@dataclass(frozen=True, eq=False)
class InputFiles:
    """Files named in a study, relative to its folder; a list in the making, used while a study is read.

    Attributes
    ----------
    folder : Path
        Of the study file.
    digests : dict of str to str
        SHA-256 by the name in the study; the last part of it only where that is an absolute path.
    """

    folder: Path
    digests: dict[str, str] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        """The path of `name`, which is now one of the study's inputs.

        Raises
        ------
        FileError
            If there is no such file, or it is empty or not permitted.
        """
        path = require_readable(self.folder / name)
        self.digests[Path(name).name if Path(name).is_absolute() else Path(name).as_posix()] = digest(path)
        return path
