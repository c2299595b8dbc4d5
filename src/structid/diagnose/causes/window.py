"""The records were windowed, which adds damping."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import AddChannelError, Edits, rounded
from structid.diagnose.tested_model import TestedModel
from structid.forward import FrfProblem, RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class ExponentialWindow(Candidate):
    """An exponential window on all channels of all FRFs; the strength is its decay, 1/s."""

    kind: ClassVar[str] = "window"
    where: tuple[str, ...] = ("all channels",)

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """One candidate where all records are FRFs and the decay of a window is not an unknown already; else none.

        The strength is a decay rate, 1/s: 0.002 of the median angular frequency of all lines. `problems` has one
        problem for each record.
        """
        responses = [problem for problem in problems if isinstance(problem, FrfProblem)]
        is_unknown = any(p.channels is not None and "window_decay" in p.channels.kinds for p in responses)
        if len(responses) == len(problems) and not is_unknown:
            middle = float(np.median(np.concatenate([problem.frequency for problem in problems])))
            yield cls(strengths=np.array([0.002 * 2 * np.pi * middle]))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        entry = {"property": "window_decay", "start": rounded(strength)}
        return [AddChannelError(number, entry) for number in range(len(model.setups))]

    def sentence(self, value: float | None) -> str:
        return "the records were windowed, which adds damping"
