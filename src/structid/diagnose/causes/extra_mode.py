"""A measured mode is none of this structure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import Edits, UseModes
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes

_FEWEST_MODES = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class ExtraMode(Candidate):
    """A mode of a record that is left out.

    Attributes
    ----------
    mode : int
        Position of the mode in the record, from 0.
    others : tuple of int
        Numbers of the modes that stay, from 1.
    """

    kind: ClassVar[str] = "extra_mode"
    leaves_data_out: ClassVar[bool] = True
    n_hidden: ClassVar[int] = 1
    record: int | None = 0
    mode: int
    others: tuple[int, ...]

    @classmethod
    def from_residual(cls, problems: Sequence[RecordProblem], residual: FloatArray) -> Iterator[Candidate]:
        """A candidate that a mode is spurious for each mode of every record of more than two measured modes.

        `problems` has one problem for each record; only modal ones count. `residual` is not used.
        """
        for number, problem in enumerate(problems):
            if compares_modes(problem) and len(problem.data.measured) > _FEWEST_MODES:
                used = [mode + 1 for mode in problem.data.measured.tolist()]
                for mode in problem.data.measured.tolist():
                    where = (f"{problem.record.frequency[mode]:.5g} Hz",)
                    others = tuple(other for other in used if other != mode + 1)
                    yield cls(where=where, record=number, mode=mode, others=others)

    def rows_left_out(self, problem: RecordProblem) -> np.ndarray:
        """A mask (n_data,) of the data rows that belong to the mode; `problem` is that of its record."""
        taken: np.ndarray = problem.rows.lines == self.mode
        return taken

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [UseModes(self.record or 0, self.others)]

    def sentence(self, value: float | None) -> str:
        return f"the mode at {self.where[0]} is none of this structure"
