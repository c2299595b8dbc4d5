"""A sensor or load is at another node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import Edits, renamed_channels
from structid.diagnose.tested_model import TestedModel


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorPosition(Candidate):
    """A sensor at another node than the record says: `where` is its degree of freedom there, then that at the node.

    It is tried only of sensors without which the fit is much better.
    """

    kind: ClassVar[str] = "place"
    record: int | None = 0

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [renamed_channels(model, self.record or 0, {self.where[0]: self.where[1]})]

    def sentence(self, value: float | None) -> str:
        return f"sensor {self.where[0]} sits at {self.where[1]}"


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadPosition(Candidate):
    """A load at another node than the record says: `where` is its degree of freedom there, then that at the node.

    It is tried of every load.
    """

    kind: ClassVar[str] = "load_place"
    record: int | None = 0

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [renamed_channels(model, self.record or 0, {f"load {self.where[0]}": self.where[1]})]

    def sentence(self, value: float | None) -> str:
        return f"the force at {self.where[0]} acts at {self.where[1]}"
