"""Reports written for the tests, with their pages as text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from page_parts import words

from structid.identification.identified import Identification
from structid.report.identification import write_report

TITLE = 'Frame <b>7</b> & "base"'
PROVENANCE = {"version": "0.1", "files": {"<frf>.npz": "ab" * 32}, "seed": 7}


@dataclass(frozen=True, eq=False)
class Report:
    """An identification, the folder of its report and the page as text."""

    identification: Identification
    folder: Path
    page: str

    @property
    def before_scripts(self) -> str:
        """The page up to the library that draws, which comes compressed."""
        return words(self.page)


def written(identification: Identification, folder: Path) -> Report:
    path = write_report(identification, folder, TITLE, PROVENANCE, png=True)
    return Report(identification, folder, path.read_text(encoding="utf-8"))
