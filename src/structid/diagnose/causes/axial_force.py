"""Beams or bars carry an axial force that the model lacks: a cable, a tie rod, a column, a preloaded frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import AddUnknown, Edits, SetProperty, rounded
from structid.diagnose.tested_model import TestedModel
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.forward import RecordProblem

#: Parts of the Euler load of a set, or of a strain of a thousandth where it does not bend, that are tried.
_PARTS = np.array([0.3, -0.3, 0.05, -0.05])
_STRAIN = 1e-3
_BENDING = ("bending_stiffness", "bending_stiffness_z")
#: Sets that are tried.
_MOST_SETS = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class AxialForce(Candidate):
    """An axial force in all elements of a set, N; tension is positive."""

    kind: ClassVar[str] = "axial_force"

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """A candidate axial force for each beam or bar set that has none; no candidates where more than six have none.

        The sets are those of the first record's structure, without bars on a line, which do not move sideways.
        Strengths are forces, N: plus and minus 0.3 and 0.05 times the Euler load of the set as one strut (bars: the
        force of a strain of 0.001). `problems` are not used.
        """
        structure = model.setups[0].structure
        slack = [
            one
            for one in structure.elements
            if "axial_force" in declarations(one)
            and vars(one)["axial_force"] is None
            and (structure.dimension > 1 or _bending_stiffness(one) is not None)
        ]
        for one in slack if len(slack) <= _MOST_SETS else ():
            yield cls(where=(one.name,), strengths=_first_guess(structure, one) * _PARTS)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        name, force = self.where[0], rounded(strength)
        unknown = {"property": "axial_force", "elements": name, "positive": False, "start": force}
        return [SetProperty(name, "axial_force", force), AddUnknown(unknown)]

    def sentence(self, value: float | None) -> str:
        kind = "an axial force" if value is None else "a tension" if value > 0 else "a compression"
        return f"{self.where[0]} carries {kind} that the model lacks"


def _bending_stiffness(element: ElementSet) -> FloatArray | None:
    """Bending stiffness of each element of a set of beams, in space that about its z axis, N m²; None for bars."""
    values = vars(element)
    return next((values[key] for key in _BENDING if key in values), None)


def _first_guess(structure: Structure, element: ElementSet) -> float:
    """First guess of a set's axial force, N: its Euler load as one strut, or for bars the force of a strain of 0.001.

    The strut is as long as all elements of the set together; stiffnesses are means over the set.
    """
    bending = _bending_stiffness(element)
    if bending is None:
        return float(_STRAIN * np.mean(vars(element)["axial_stiffness"]))
    ends = np.array([[structure.nodes[n] for n in pair] for pair in element.nodes.tolist()])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    return float(np.pi**2 * np.mean(bending) / length**2)
