"""Some lines do not go with the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import Candidate, few_words
from structid.diagnose.data_rows import outlying_spans, rows_of
from structid.diagnose.model_edits import Edits, ExcludeLines
from structid.diagnose.tested_model import TestedModel
from structid.forward import FrfProblem, RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class OutlyingLines(Candidate):
    """Lines of a record of FRFs whose misfit stands out, all of a record together."""

    kind: ClassVar[str] = "outlying_lines"
    leaves_data_out: ClassVar[bool] = True
    record: int | None = 0

    @classmethod
    def from_residual(cls, problems: Sequence[RecordProblem], residual: FloatArray) -> Iterator[Candidate]:
        """A candidate for each record of FRFs with lines whose misfit is over 8 times that of the lines about them.

        It holds all spans of such lines of the record (see `outlying_spans`). `problems` has one problem for each
        record; `residual` (n_rows,) are the whitened data rows of all of them, one after another.
        """
        for number, (problem, own) in enumerate(rows_of(problems, residual)):
            spans = outlying_spans(problem, own) if isinstance(problem, FrfProblem) else ()
            if spans:
                yield cls(where=spans, record=number)

    @property
    def n_own(self) -> int:
        return len(self.where)

    @property
    def _spans(self) -> tuple[tuple[float, float], ...]:
        pairs = [where.removesuffix(" Hz").split(" to ") for where in self.where]
        return tuple((float(low), float(high)) for low, high in pairs)

    def rows_left_out(self, problem: RecordProblem) -> np.ndarray:
        """Mask (n_data,) of the data rows of `problem`, that of the record, on the outlying lines in `self.where`."""
        is_out = np.zeros(len(problem.frequency), dtype=bool)
        for low, high in self._spans:
            is_out |= (problem.frequency >= low) & (problem.frequency <= high)
        taken: np.ndarray = is_out[problem.rows.lines]
        return taken

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [ExcludeLines(self._spans)]

    def sentence(self, value: float | None) -> str:
        return f"lines at {few_words(self.where)} do not go with the others"
