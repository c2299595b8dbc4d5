"""What one run of a study gives, complete when constructed; files and reports are made from it."""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from structid._version import __version__
from structid.core.display import Overview, Shown
from structid.core.provenance import Provenance
from structid.criticism.verdict import Criticism
from structid.dynamics.receptance import factorizer_words
from structid.identification.identified import Identification
from structid.inversion import Estimate
from structid.study.results.solver import SolverAnswer
from structid.study.results.view import ResultsView, results_view
from structid.study.schema.study import Study


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult(Shown):
    """A study, what was identified, and from what.

    Attributes
    ----------
    study : Study
    identification : Identification
    provenance : Provenance
    criticism : Criticism, optional
        Whether the answer is to be trusted, and what would explain a misfit.
    solver : SolverAnswer, optional
        The study's solver at the answer.
    """

    study: Study
    identification: Identification
    provenance: Provenance
    criticism: Criticism | None = None
    solver: SolverAnswer | None = None

    @property
    def estimate(self) -> Estimate:
        """Values and their uncertainty."""
        return self.identification.estimate

    @cached_property
    def view(self) -> ResultsView:
        """The answer as console, files and pages show it."""
        return results_view(self.identification, self.criticism, self.study.title, asdict(self.provenance))

    def overview(self) -> Overview:
        """Title and verdict, and the parameters."""
        shown = self.view.overview()
        return replace(shown, words=f"{self.study.title}\n{shown.words}")

    def __repr__(self) -> str:
        verdict = "not judged" if self.criticism is None else self.criticism.judgement.verdict.replace("_", " ")
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
