"""A record is of another state than the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.diagnose.causes.candidate import Candidate, record_words
from structid.diagnose.model_edits import Edits, RemoveRecord
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class OtherState(Candidate):
    """One of several records that is of another state of the structure than the others, so that it is left out."""

    kind: ClassVar[str] = "record"
    leaves_data_out: ClassVar[bool] = True
    n_hidden: ClassVar[int] = 1
    record: int | None = 0

    @classmethod
    def from_data(cls, problems: Sequence[RecordProblem], record_names: Sequence[str]) -> Iterator[OtherState]:
        """A candidate for each record, by its name in `record_names`, where there are several."""
        for number, name in enumerate(record_names if len(problems) > 1 else ()):
            yield cls(where=(name,), record=number)

    def rows_left_out(self, problem: RecordProblem) -> np.ndarray:
        """Data rows of its record that are left out, (n_data,) bool."""
        return np.ones(problem.n_data, dtype=bool)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [RemoveRecord(self.record or 0)]

    def sentence(self, value: float | None) -> str:
        return f"{record_words(self.where[0])} is of another state than the others"
