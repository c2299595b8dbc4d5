"""The section of beams in space is turned by 90 degrees about their axis: EI about y and about z are exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.errors import InputError
from structid.diagnose.causes.candidate import MOST_ELEMENTS, Candidate, spread
from structid.diagnose.model_edits import Edits, SetProperty, rounded
from structid.diagnose.tested_model import TestedModel
from structid.fem import SpaceBeam, Structure
from structid.forward import RecordProblem
from structid.unknowns import Parameters

#: Part of the largest eigenvalue of y'y below which the local y axes are all parallel.
_PARALLEL = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class TurnedSection(Candidate):
    """Sets of beams whose local y and z axes are exchanged, in the model or in how the beams stand."""

    kind: ClassVar[str] = "turned_section"
    begins_at_start: ClassVar[bool] = True
    is_screened_at_start: ClassVar[bool] = True

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """Candidates that sections are turned by 90 degrees: all sets of beams that this may change together, and each.

        Sets are of the first record's structure, of beams with two different bending stiffnesses. Left out are sets
        whose beams have no common direction that turns every one, and those whose parameters may take either stiffness
        anyhow. Of many sets 150 are tried alone, evenly chosen. `problems` are not used.
        """
        structure, parameters = model.setups[0].structure, model.setups[0].parameters
        names = [
            one.name
            for one in space_beams(structure)
            if _makes_a_difference(one, structure, parameters) and turned_orientation(one, structure.nodes) is not None
        ]
        if len(names) > 1:
            yield cls(where=tuple(names))
        for name in spread(names, MOST_ELEMENTS):
            yield cls(where=(name,))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that give each set in `self.where` the orientation that turns its sections by 90 degrees.

        `strength` is not used.

        Raises
        ------
        InputError
            If a set has no beams in space that one orientation turns.
        """
        structure = model.setups[0].structure
        turned = {one.name: turned_orientation(one, structure.nodes) for one in space_beams(structure)}
        edits = []
        for name in self.where:
            guide = turned.get(name)
            if guide is None:
                raise InputError(
                    f"{name!r} has no beams in space that one `orientation` turns; put beams along other directions in sets of"
                    " their own"
                )
            edits.append(SetProperty(name, "orientation", guide))
        return edits

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"the sections of {join_words(self.where)} are turned by 90 degrees: EI about y and z are exchanged"
        return f"the section of {self.where[0]} is turned by 90 degrees: EI about y and z are exchanged"


def space_beams(structure: Structure) -> list[SpaceBeam]:
    """The sets of beams in space of a structure, in order."""
    return [one for one in structure.elements if isinstance(one, SpaceBeam)]


def _makes_a_difference(element: SpaceBeam, structure: Structure, parameters: Parameters) -> bool:
    """True unless a set of beams has the same stiffnesses, or may take the same, in both planes of bending.

    It may take the same where parameters without priors or couplings change both stiffnesses in the same way, each by
    different parameters. True too if parameters change the stiffness of one plane alone.
    """
    y, z = (
        _columns(element.name, name, structure, parameters) for name in ("bending_stiffness_y", "bending_stiffness_z")
    )
    used_y, used_z = y.any(axis=0), z.any(axis=0)
    is_held = (parameters.priors.stated & (used_y | used_z)).any() or bool(parameters.couplings)
    if used_y.any() and used_z.any() and not (used_y & used_z).any() and not is_held:
        both = np.column_stack([y, z])
        n_y, n_z, n_both = (int(np.linalg.matrix_rank(columns)) for columns in (y, z, both))
        if n_y == n_z == n_both:
            return False
    is_one_unknown = used_y.any() != used_z.any()
    return bool(is_one_unknown) or not np.array_equal(element.bending_stiffness_y, element.bending_stiffness_z)


def _columns(element: str, name: str, structure: Structure, parameters: Parameters) -> FloatArray:
    """Derivative (n_elements, n_params) of the values of property `name` of the set `element` by each parameter."""
    item = next(one for one in structure.properties if (one.element, one.term.property) == (element, name))
    return np.asarray(parameters.design.tocsr()[item.values].toarray())


def turned_orientation(element: SpaceBeam, nodes: Mapping[int, FloatArray]) -> list[float] | None:
    """The `orientation` [x, y, z] that turns the section of each beam of a set by 90 degrees; None if there is none.

    It is across every local y axis and along no beam; its largest component is 1. `nodes` are positions, m, by node
    label.
    """
    axes = element.section_directions(nodes)
    x, y, z = (axes[name][:, :3] for name in ("N", "VY", "VZ"))
    sizes, across_y = np.linalg.eigh(y.T @ y)  # the first vectors are across all y
    guide = across_y[:, 0]
    if sizes[1] < _PARALLEL * sizes[2]:
        guide = across_y[:, :2] @ _between_beams(x @ across_y[:, :2])
    largest = int(np.argmax(np.abs(guide).round(6)))
    guide = (guide / guide[largest]).round(6) + 0.0
    across = guide - (x @ guide)[:, None] * x
    length = np.linalg.norm(across, axis=1)
    is_turned = np.abs((across * z).sum(axis=1)) > (1 - 1e-6) * length
    if not (length > 1e-3).all() or not is_turned.all():
        return None
    return [rounded(component) for component in guide.tolist()]


def _between_beams(along: FloatArray) -> FloatArray:
    """Unit vector (2,) in a plane, in the middle of the widest angle between lines along the rows of `along` (n, 2)."""
    angles = np.sort(np.arctan2(along[:, 1], along[:, 0]) % np.pi)
    gaps = np.diff(np.append(angles, angles[0] + np.pi))
    widest = int(np.argmax(gaps.round(6)))
    middle = angles[widest] + gaps[widest] / 2
    return np.array([np.cos(middle), np.sin(middle)])
