"""The mesh is too coarse for the highest frequencies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import Edits, SubdivideElements
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem

_PIECES = 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class CoarseMesh(Candidate):
    """A mesh that is too coarse; the strength is the factor on the number of pieces of all beams and bars."""

    kind: ClassVar[str] = "mesh"
    where: tuple[str, ...] = ("all lines",)
    strengths: FloatArray = field(default_factory=lambda: np.array([_PIECES]))

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        if model.setups[0].structure.divisible:
            yield cls()

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [SubdivideElements(round(strength) * model.setups[0].structure.subdivide)]

    def sentence(self, value: float | None) -> str:
        return "the mesh is too coarse for the highest frequencies"
