"""Beams shear that are taken for slender."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.display import join_words
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import AddUnknown, Edits, SetProperty, rounded
from structid.diagnose.tested_model import TestedModel
from structid.fem import Structure
from structid.fem.contribution import Property
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.forward import RecordProblem

#: Bending stiffness over shear stiffness and squared length of a set, of a first guess.
_SHEAR = 0.02
#: Factors on it: short pieces of many beams in one set are stiffer by far.
_STIFFER = np.array([1.0, 10.0, 100.0])
#: Shear stiffnesses of beams, with the bending stiffness of the same plane.
_SHEARS = {
    "shear_stiffness": "bending_stiffness",
    "shear_stiffness_z": "bending_stiffness_y",
    "shear_stiffness_y": "bending_stiffness_z",
}
#: Sets that are tried one by one.
_MOST_SLENDER = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class ShearFlexibility(Candidate):
    """Beams with a shear stiffness, which is the strength.

    Attributes
    ----------
    property_name : str
    """

    kind: ClassVar[str] = "shear"
    property_name: str

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        yield from cls.of_structure(model.setups[0].structure)

    @classmethod
    def of_structure(cls, structure: Structure) -> Iterator[ShearFlexibility]:
        """Candidates for the beam sets without shear in each bending plane: all together, and each alone.

        Sets are not tried alone where there are more than six of a plane. Strengths are shear stiffnesses: a first
        guess times 1, 10 and 100, of all together the median of the guesses.
        """
        bends = [one for one in structure.properties if one.term.property in _SHEARS.values() and _acts(structure, one)]
        acting = {(one.element, one.term.property) for one in bends}
        for shear, bending in _SHEARS.items():
            slender = [
                one
                for one in structure.elements
                if shear in declarations(one) and vars(one)[shear] is None and (one.name, bending) in acting
            ]
            guesses = [_first_guess(structure, one, bending) for one in slender]
            if len(slender) > 1:
                names = tuple(one.name for one in slender)
                yield cls(where=names, strengths=float(np.median(guesses)) * _STIFFER, property_name=shear)
            if len(slender) <= _MOST_SLENDER:
                for one, guess in zip(slender, guesses, strict=True):
                    yield cls(where=(one.name,), strengths=guess * _STIFFER, property_name=shear)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        names = list(self.where)
        return [
            *(SetProperty(name, self.property_name, rounded(strength)) for name in names),
            AddUnknown({"property": self.property_name, "elements": names if len(names) > 1 else names[0]}),
        ]

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"{join_words(self.where)} shear: they are no slender beams"
        return f"{self.where[0]} shears: it is no slender beam"


def _acts(structure: Structure, item: Property) -> bool:
    """True where a stiffness property acts on free degrees of freedom, so that its assembled matrix is not zero."""
    own = [part for part in structure.contributions if part.matrix_kind == "stiffness" and part.value == item.values]
    return any(part.blocks.assemble(part.weights(structure.values)).count_nonzero() for part in own)


def _first_guess(structure: Structure, element: ElementSet, bending: str) -> float:
    """A first guess of a set's shear stiffness, N: its mean bending stiffness over 0.02 times its squared total length.

    `bending` names the property of bending stiffness, N m^2.
    """
    ends = np.array([[structure.nodes[n] for n in pair] for pair in element.nodes.tolist()])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    return float(np.mean(vars(element)[bending]) / (_SHEAR * length**2))
