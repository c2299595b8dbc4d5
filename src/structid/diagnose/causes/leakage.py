"""Resonances leak into the lines beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import AverageSegments, Edits
from structid.diagnose.tested_model import TestedModel
from structid.forward import FrfProblem, RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class Leakage(Candidate):
    """FRFs that are averages of segments of random motion under a Hann window."""

    kind: ClassVar[str] = "leakage"
    result_kind: ClassVar[str] = "window"
    has_reserved_place: ClassVar[bool] = True
    where: tuple[str, ...] = ("all channels",)

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        if all(isinstance(problem, FrfProblem) and problem.record.segment is None for problem in problems):
            yield cls()

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [AverageSegments()]

    def sentence(self, value: float | None) -> str:
        return "resonances leak into the lines beside them: averages of segments of random motion under a Hann window"
