"""A steady tone that no force made, such as mains, is in the record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import Candidate, few_words
from structid.diagnose.data_rows import rows_of, tones
from structid.diagnose.model_edits import AddTones, Edits
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem
from structid.forward.time import compares_spectra


@dataclass(frozen=True, eq=False, kw_only=True)
class Tone(Candidate):
    """Steady tones in histories of a record, all together."""

    kind: ClassVar[str] = "tone"
    result_kind: ClassVar[str] = "outlying_lines"
    has_reserved_place: ClassVar[bool] = True
    record: int | None = 0

    @classmethod
    def from_residual(cls, problems: Sequence[RecordProblem], residual: FloatArray) -> Iterator[Candidate]:
        """A candidate for each record of histories fitted as spectra whose misfit shows steady tones: all of them.

        A tone is a line whose misfit is over 8 times that of the lines about it and falls to 1/16 four lines off, as
        that of a sine (see `tones`). `problems` has one problem for each record; `residual` (n_rows,) are the whitened
        data rows of all of them, one after another.
        """
        for number, (problem, own) in enumerate(rows_of(problems, residual)):
            heard = tones(problem, own) if compares_spectra(problem) else ()
            if heard:
                yield cls(where=heard, record=number)

    @property
    def n_own(self) -> int:
        return len(self.where)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return [AddTones(self.record or 0, tuple(float(where.removesuffix(" Hz")) for where in self.where))]

    def sentence(self, value: float | None) -> str:
        return f"a tone at {few_words(self.where)} that no force made, such as mains, is in the record"
