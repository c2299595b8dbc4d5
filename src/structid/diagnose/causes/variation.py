"""A parameter differs from record to record."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.fixed_value import ELASTIC
from structid.diagnose.model_edits import Edits, LetVary
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem
from structid.forward.scatter import scatter_problems
from structid.unknowns.parameters import BEGUN

#: Records of which a scatter is distinguished from one that stands out: of fewer, the one is the likelier cause.
_FEWEST = 5


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordVariation(Candidate):
    """A parameter with a value of its own in each record; its scatter is chosen by the data."""

    kind: ClassVar[str] = "varies"
    strengths: FloatArray = field(default_factory=lambda: np.array([BEGUN]))

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """A candidate for each mass or stiffness parameter that five records or more share and that does not vary already.

        The parameter must be bounded below by 0 or more. `problems` has one problem for each record, with its
        parameters.
        """
        known = {name for problem in problems for scatter in problem.parameters.scatters for name in scatter.own}
        known |= {common for one in scatter_problems(problems) for common in one.names}
        counts = Counter[str]()
        for problem in problems:
            unknown = problem.parameters
            for name, kind, low in zip(unknown.names, unknown.kinds, unknown.transforms.lower.tolist(), strict=True):
                if kind in ELASTIC and low >= 0 and name not in known:
                    counts[name] += 1
        for name, count in counts.items():
            if count >= _FEWEST:
                yield cls(where=(name,))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [LetVary(self.where[0])]

    def sentence(self, value: float | None) -> str:
        return f"{self.where[0]} differs from record to record"
