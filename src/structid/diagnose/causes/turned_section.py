"""The section of beams in space is turned by 90 degrees about their axis: EI about y and about z are exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.places import MOST_ELEMENTS, spread
from structid.diagnose.model_edits import Edits, SetProperty, rounded
from structid.diagnose.tested_model import TestedModel
from structid.fem import SpaceBeam, Structure
from structid.forward import RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class TurnedSection(Candidate):
    """Sets of beams whose local y and z axes are exchanged, in the model or in how the beams stand."""

    kind: ClassVar[str] = "turned_section"
    begins_at_start: ClassVar[bool] = True
    is_screened_at_start: ClassVar[bool] = True

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """Candidates for all sets of beams with two different bending stiffnesses together, then for each set.

        The first is left out where there is one set only. Sets without a `turned_orientation` do not count. Of many sets
        `MOST_ELEMENTS` are tried alone, evenly chosen.
        """
        structure = model.setups[0].structure
        names = [
            one.name
            for one in space_beams(structure)
            if not np.array_equal(one.bending_stiffness_y, one.bending_stiffness_z)
            and turned_orientation(one, structure.nodes) is not None
        ]
        if len(names) > 1:
            yield cls(where=tuple(names))
        for name in spread(names, MOST_ELEMENTS):
            yield cls(where=(name,))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        structure = model.setups[0].structure
        turned = {one.name: turned_orientation(one, structure.nodes) for one in space_beams(structure)}
        return [SetProperty(name, "orientation", turned[name] or []) for name in self.where]

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"the sections of {join_words(self.where)} are turned by 90 degrees: EI about y and z are exchanged"
        return f"the section of {self.where[0]} is turned by 90 degrees: EI about y and z are exchanged"


def space_beams(structure: Structure) -> list[SpaceBeam]:
    """The sets of beams in space of a structure, in order."""
    return [one for one in structure.elements if isinstance(one, SpaceBeam)]


def turned_orientation(element: SpaceBeam, nodes: Mapping[int, FloatArray]) -> list[float] | None:
    """The `orientation` [x, y, z] that turns the section of each beam of a set by 90 degrees, or None.

    It is the sum of the local z axes of the beams, each direction once, or a global axis. `nodes` are positions, m.
    """
    z = element.section_directions(nodes)["VZ"][:, :3]
    x = element.section_directions(nodes)["N"][:, :3]
    first = np.argmax(np.abs(z) > 0.5, axis=1)
    alike = z * np.sign(z[np.arange(len(z)), first])[:, None]
    for guide in (np.unique(alike.round(6), axis=0).sum(axis=0), *np.eye(3)):
        across = guide - (x @ guide)[:, None] * x
        length = np.linalg.norm(across, axis=1)
        is_turned = np.abs((across * z).sum(axis=1)) > (1 - 1e-6) * length
        if (length > 1e-3).all() and is_turned.all():
            return [rounded(component) for component in guide.tolist()]
    return None
