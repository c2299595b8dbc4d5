"""The axis of the records is off: a clock, a sampling rate, or a frequency axis in another unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import POSITIVE, Candidate
from structid.diagnose.model_edits import Edits, ScaleAxis
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem

#: Factors on all frequencies that are tried: radians and minutes taken for what they are not, and clocks that are slow or fast.
_FACTORS = np.array([1 / (2 * np.pi), 2 * np.pi, 1 / 60, 60.0, 0.95, 0.98, 0.99, 1.01, 1.02, 1.05])
_UNITS = {2 * np.pi: "rad/s", 60.0: "rpm or minutes"}
#: Part by which a factor may differ from that of a unit.
_NEAR_UNIT = 0.005


@dataclass(frozen=True, eq=False, kw_only=True)
class Clock(Candidate):
    """All frequencies of all records times one factor, which is the strength.

    The records cannot distinguish a clock from a common factor on all stiffnesses where responses are accelerations: A(s) of
    masses M and stiffnesses K at c s is that of M and K / c^2 at s.
    """

    kind: ClassVar[str] = "clock"
    n_hidden: ClassVar[int] = 1
    begins_at_start: ClassVar[bool] = True
    other_strengths: ClassVar[tuple[float, ...]] = (1.01, 1.003, 1.001)
    where: tuple[str, ...] = ("all records",)
    strengths: FloatArray = field(default_factory=lambda: _FACTORS)
    bounds: tuple[float, float] = POSITIVE

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """One candidate for each of ten factors: mistaken units of frequency (rad/s, rpm, Hz), and errors of 1, 2 and 5 %.

        They are apart since a fit that starts at one factor does not reach another, and a linear step cannot tell them.
        """
        for factor in _FACTORS:
            yield cls(strengths=np.array([factor]))

    @property
    def handicap(self) -> float:
        return 0.5

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [ScaleAxis(strength)]

    def sentence(self, value: float | None) -> str:
        """A clause that states the factor `value` on the time or frequency axis, and the unit that it may come from.

        A unit (rad/s, rpm) is named if the factor is that of a mistaken one to 0.5 %. None for `value` leaves numbers
        out.
        """
        size, stiffness = (
            ("one factor", "one factor") if value is None else (f"a factor of {value:.4g}", f"{value**-2:.4g} times")
        )
        near = (name for factor, name in _UNITS.items() if value and abs(np.log(value * factor)) < _NEAR_UNIT)
        unit = next((f" ({name} taken for Hz)" for name in near), "")
        return (
            f"the time or frequency axis of the records is off by {size}{unit}: a clock, a sampling rate or a unit; {stiffness} on"
            " all stiffnesses looks the same"
        )
