"""A sensor fits far worse than the others: noisy, clipped or dead."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import Edits, UseChannels
from structid.diagnose.tested_model import TestedModel
from structid.forward import FrfProblem, RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultyChannel(Candidate):
    """A sensor whose data are left out.

    Attributes
    ----------
    others : tuple of str
        The sensors that stay.
    """

    kind: ClassVar[str] = "channel"
    leaves_data_out: ClassVar[bool] = True
    n_hidden: ClassVar[int] = 1
    record: int | None = 0
    others: tuple[str, ...] = ()

    @classmethod
    def from_data(cls, problems: Sequence[RecordProblem], record_names: Sequence[str]) -> Iterator[FaultyChannel]:
        """A candidate that a sensor is faulty for each sensor of every FRF record with two sensors or more.

        `problems` has one problem for each record; `record_names` are not used.
        """
        for number, problem in enumerate(problems):
            outputs = tuple(dof.place for dof in problem.record.outputs) if isinstance(problem, FrfProblem) else ()
            for name in outputs if len(outputs) > 1 else ():
                yield cls(where=(name,), record=number, others=tuple(other for other in outputs if other != name))

    def rows_left_out(self, problem: RecordProblem) -> np.ndarray:
        """Mask (n_data,) of the data rows of `problem` that come from the sensor `self.where[0]`.

        `problem` is that of the candidate's record.
        """
        channels = [name.split("/")[0].removeprefix("shape at ").rstrip("+-") for name in problem.rows.names]
        is_it = np.array([channel == self.where[0] for channel in channels])
        taken: np.ndarray = is_it[np.unique(problem.rows.series, return_inverse=True)[1]]
        return taken

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [UseChannels(self.record or 0, self.others)]

    def sentence(self, value: float | None) -> str:
        return f"sensor {self.where[0]} fits far worse than the others: noisy, clipped, dead, or turned"
