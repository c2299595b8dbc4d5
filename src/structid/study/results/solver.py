"""What the results tell of a solver: its runs, the deck with the identified values, and what it gives with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from structid.core.json_types import Entry

#: Folder of the updated deck, inside that of the results.
UPDATED = "updated"


@dataclass(frozen=True, eq=False)
class SolverAnswer:
    """The solver of a study at the answer.

    Attributes
    ----------
    values : mapping of str to float
        Of the deck's parameters, as it shows them.
    deck : mapping of str to str
        The updated deck: text by name of the file.
    linked : mapping of str to Path
        Further files that it reads, by their names beside it.
    command : str
    runs_made, runs_kept : int
    facts : tuple of str
        What the runs gave.
    check : str
        What the solver gives with the updated deck, beside the identified model.
    difference : float
        Of that; NaN where it could not be run.
    """

    values: Mapping[str, float]
    deck: Mapping[str, str]
    linked: Mapping[str, Path]
    command: str
    runs_made: int
    runs_kept: int
    facts: tuple[str, ...]
    check: str
    difference: float

    def summary(self) -> dict[str, Entry]:
        """As in estimate.json."""
        return {
            "command": self.command,
            "values": self.values,
            "updated_deck": [f"{UPDATED}/{name}" for name in self.deck],
            "runs_made": self.runs_made,
            "runs_kept": self.runs_kept,
            "facts": self.facts,
            "check": self.check,
            "largest_difference": self.difference,
        }

    def write(self, folder: Path) -> None:
        """Write the updated deck, with all files that it reads, into a new folder inside `folder`."""
        target = folder / UPDATED
        target.mkdir()
        for name, path in self.linked.items():
            (target / name).write_bytes(path.read_bytes())
        for name, text in self.deck.items():
            (target / name).write_text(text, encoding="utf-8", newline="")
