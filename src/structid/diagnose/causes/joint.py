"""The end of an element turns against its node."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.diagnose.causes.candidate import MOST_ELEMENTS, POSITIVE, Candidate, added_spring, spread
from structid.diagnose.effects import effect_of_release, strengths_about
from structid.diagnose.model_edits import Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem.elements.element import dof_of_code

#: Power of s with which properties enter the dynamic stiffness.
_POWERS = {"mass": 2, "rotary_inertia": 2, "viscous_damping": 1}


class _Column(NamedTuple):
    """One column of an element matrix: codes of its rows (n,), entries (n,), the diagonal one, kind and loss factor."""

    codes: IntArray
    column: FloatArray
    diagonal: float
    kind: str
    loss: float


@dataclass(frozen=True, eq=False, kw_only=True)
class FlexibleJoint(Candidate):
    """The end of a beam that turns against its node; the strength is the compliance of the joint, rad/(N m)."""

    kind: ClassVar[str] = "joint"
    bounds: tuple[float, float] = POSITIVE
    columns: tuple[_Column, ...] = ()
    loss_factor: float | None = None

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate flexible joints at rotations of element ends with a bending stiffness, among at most 150 ends.

        More ends are evenly chosen from. `records` are the receptances of each record; the first one counts. Strengths
        are compliances, rad/(N m): 0.005 to 60 times the inverse of the element's dynamic stiffness at this end alone.
        `record_names` are not used.
        """
        first = records[0]
        ends: dict[tuple[str, int, int], list[_Column]] = {}
        for one in first.elements(("mass", "rotary_inertia", "viscous_damping", "stiffness", "axial_force")):
            for j, code in enumerate(one.codes.tolist()):
                if code >= 0 and dof_of_code(code).is_rotation:
                    part = _Column(one.codes, one.matrix[:, j], float(one.matrix[j, j]), one.kind, one.loss)
                    ends.setdefault((one.element, one.number, code), []).append(part)
        for (name, number, code), columns in spread(list(ends.items()), MOST_ELEMENTS):
            if any(part.kind == "stiffness" and part.diagonal > 0 for part in columns):
                scale = float(1 / np.median(np.abs(_couplings(first, columns)[1])))
                where = (f"{name}:{number + 1}", dof_of_code(code).place)
                yield cls(where=where, strengths=strengths_about(scale), columns=tuple(columns))

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return effect_of_release(receptances, *_couplings(receptances, self.columns), strengths)

    @property
    def handicap(self) -> float:
        return 0.5

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that put a rotational spring of unknown stiffness between the element's end and its node in `model`.

        The stiffness starts at the inverse of `strength`, a compliance in rad/(N m). If `self.loss_factor` is not None,
        the spring has that loss factor, as a further unknown.
        """
        element, place = self.where
        name = model.unique_name(f"joint {element} {place}")
        entry = {"name": name, "element": element, "at": place, "stiffness": rounded(1 / strength)}
        return added_spring("joint", entry, self.loss_factor)

    def sentence(self, value: float | None) -> str:
        return f"the end of {self.where[0]} at {self.where[1]} turns against its node"

    @property
    def places(self) -> tuple[str, ...]:
        return ("/".join(self.where),)


def _couplings(receptances: Receptances, columns: Sequence[_Column]) -> tuple[ComplexArray, ComplexArray]:
    """Dynamic stiffness between a released element end and the free degrees of freedom, and that of the end alone.

    Shapes are (n_lines, n_dofs) and (n_lines,), in SI units. `columns` are those of the element's matrices for the
    released rotation, one for each matrix, with its kind and loss factor.
    """
    coupling = np.zeros((len(receptances.laplace), receptances.structure.n_dofs), dtype=np.complex128)
    own = np.zeros(len(receptances.laplace), dtype=np.complex128)
    for part in columns:
        power = _POWERS.get(part.kind)
        law = np.full_like(receptances.laplace, 1 + 1j * part.loss) if power is None else receptances.laplace**power
        coupling += law[:, None] * (part.column @ receptances.reached(part.codes))
        own += law * part.diagonal
    return coupling, own
