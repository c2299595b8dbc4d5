"""A point mass sits off its node."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import DIRECTIONS
from structid.core.errors import InputError
from structid.diagnose.causes.candidate import MOST_NODES, Candidate, inertia, spread
from structid.diagnose.effects import Directions, effect_of_coupling
from structid.diagnose.model_edits import AddNode, AddPart, Edits, MoveMass, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem import PointMass
from structid.fem.elements.element import dof_code

#: Levers that are tried, in parts of the largest extent of the structure.
_LEVERS = np.array([0.005, 0.01, 0.02, 0.05, 0.1, 0.2, -0.005, -0.01, -0.02, -0.05, -0.1, -0.2])
_TRANSLATIONS = ("X", "Y", "Z")


@dataclass(frozen=True, eq=False, kw_only=True)
class MassOffset(Candidate):
    """A point mass that sits off its node along an axis; the strength is the lever, m.

    Attributes
    ----------
    moves_along : tuple of str
        Translations in which the mass moves.
    node : int
    mass : float
    lever : (3, 3) float array
        Translations of the mass by rotations of its node, for a lever of 1 m.
    """

    kind: ClassVar[str] = "offset"
    n_hidden: ClassVar[int] = 1
    other_strengths: ClassVar[tuple[float, ...]] = (1.6, 1.25, 1.1, 1.04, 1.015, 1.005, 1.002)
    moves_along: tuple[str, ...] = ()
    node: int = -1
    mass: float = 0.0
    lever: FloatArray = field(default_factory=lambda: np.zeros((3, 3)), repr=False)

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate offsets of each point mass along each axis, where a rotation of its node would then move the mass.

        Strengths are levers, m, of 0.5 to 20 % of the largest extent of the structure, either way; the bounds are this
        extent. Of more, 60 masses are tried, evenly chosen. `records` are the receptances of each record, of which the
        first counts; `record_names` are not used.
        """
        first = records[0]
        nodes = {one.name: one.nodes.ravel() for one in first.structure.elements if isinstance(one, PointMass)}
        size = float(np.ptp(list(first.structure.nodes.values()), axis=0).max())
        masses = [one for one in first.elements(("mass",)) if one.element in nodes and size > 0]
        for one in spread(masses, MOST_NODES):
            node = int(nodes[one.element][one.number])
            codes = np.array([dof_code(node, direction) for direction in DIRECTIONS])
            moves = np.isin(codes[:3], one.codes)
            along = tuple(direction for direction, there in zip(_TRANSLATIONS, moves, strict=True) if there)
            for axis, direction in enumerate(_TRANSLATIONS[: len(first.structure.nodes[node])]):
                lever = np.cross(np.eye(3), np.eye(3)[axis]).T * moves[:, None]
                if (lever @ first.reached(codes[3:])).any():
                    yield cls(
                        where=(f"{one.element}:{one.number + 1}", direction), strengths=size * _LEVERS,
                        bounds=(-size, size), moves_along=along, node=node, mass=float(one.matrix.max()), lever=lever,
                    )  # fmt: skip

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        """Changes of a record's FRFs, exact, by levers q (m): with one the mass moves by u + q L theta instead of u.

        L is `self.lever`, u and theta are the translations and rotations of its node. `strengths` (n_strengths,) are
        the levers, `receptances` those of the record; the shape is (n_strengths, n_lines, n_outputs, n_inputs).
        """
        codes = np.array([dof_code(self.node, direction) for direction in DIRECTIONS])
        first, second = np.zeros((6, 6)), np.zeros((6, 6))
        first[:3, 3:], first[3:, :3], second[3:, 3:] = self.lever, self.lever.T, self.lever.T @ self.lever
        q = strengths[:, None, None, None]
        k = self.mass * inertia(receptances)[:, None, None] * (q * first + q**2 * second)
        return effect_of_coupling(receptances, Directions(codes, np.eye(6)), k)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that move the mass to a new node, `strength` m away, with a rigid link to its present node.

        Raises
        ------
        InputError
            If the model has no element set of this name.
        """
        element, direction = self.where
        name, _, number = element.rpartition(":")
        sets = [one for setup in model.setups for one in setup.structure.elements if one.name == name]
        if not sets:
            raise InputError(f"{name} is no element set of the model")
        main, label = int(sets[0].nodes.ravel()[int(number) - 1]), model.new_node()
        x, y, z = (rounded(strength) * (axis == direction) for axis in _TRANSLATIONS)
        link = {"name": model.unique_name(f"offset {element}"), "main": main, "dependents": [label]}
        return [
            AddNode(label, main, offset=(x, y, z)),
            MoveMass(name, int(number), label, self.moves_along),
            AddPart("rigid_link", link),
        ]

    def sentence(self, value: float | None) -> str:
        return f"the mass {self.where[0]} sits off its node along {self.where[-1]}"
