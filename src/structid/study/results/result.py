"""Result of one run of a study, complete when constructed; files and reports are made from it."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy

from structid._version import __version__
from structid.core.display import Overview, Shown
from structid.core.json_types import StoredEntry
from structid.core.provenance import Provenance
from structid.diagnose.verdict import Diagnosis
from structid.dynamics.receptance import factorizer_words
from structid.identification.identified import Identification
from structid.inversion import Estimate
from structid.study.results.view import ResultsView, results_view
from structid.study.schema.study import Study

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

    def summary(self) -> dict[str, StoredEntry]:
        """The entry ``solver`` of estimate.json.

        The keys are ``command``, ``values``, ``updated_deck``, ``runs_made``, ``runs_kept``, ``facts``, ``check`` and
        ``largest_difference``.
        """
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
        """Write the updated deck, with all files that it reads, into the new folder ``updated`` inside `folder`.

        `FileExistsError` if there is such a folder already.
        """
        target = folder / UPDATED
        target.mkdir()
        for name, path in self.linked.items():
            (target / name).write_bytes(path.read_bytes())
        for name, text in self.deck.items():
            (target / name).write_text(text, encoding="utf-8", newline="")


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult(Shown):
    """A study, what was identified, and from what.

    Attributes
    ----------
    study : Study
    identification : Identification
    provenance : Provenance
    diagnosis : Diagnosis, optional
        Whether the answer is to be trusted, and what would explain a misfit.
    solver : SolverAnswer, optional
        The study's solver at the answer.
    """

    study: Study
    identification: Identification
    provenance: Provenance
    diagnosis: Diagnosis | None = None
    solver: SolverAnswer | None = None

    @property
    def estimate(self) -> Estimate:
        """Identified values of all parameters, with their uncertainty and the search."""
        return self.identification.estimate

    @cached_property
    def view(self) -> ResultsView:
        """The answer as console, files and pages show it."""
        return results_view(self.identification, self.diagnosis, self.study.title, asdict(self.provenance))

    def overview(self) -> Overview:
        """Title and verdict, and the parameters."""
        shown = self.view.overview()
        return replace(shown, words=f"{self.study.title}\n{shown.words}")

    def __repr__(self) -> str:
        verdict = "not judged" if self.diagnosis is None else self.diagnosis.judgement.verdict.replace("_", " ")
        return f"<{type(self).__name__}: {self.study.title}: {verdict}>"


def provenance(study: Study) -> Provenance:
    """Versions, digests of the study's input files as they were when it was read, and its settings."""
    return Provenance(
        structid=__version__,
        numpy=np.__version__,
        scipy=scipy.__version__,
        python=platform.python_version(),
        inputs=dict(study.digests),
        seed=study.options.seed if study.options.restarts or study.options.uniqueness_starts else None,
        settings=study.settings,
        factorizer=factorizer_words(max(source.structure.n_dofs for source in study.setups)),
    )
