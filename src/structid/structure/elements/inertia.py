"""Point masses and rotary inertias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.dof import DIRECTIONS
from structid.errors import InputError
from structid.structure.elements.element import (
    TRANSLATIONS,
    Positions,
    Term,
    dof_code,
    node_codes,
    node_table,
    property_values,
    set_fields,
)


@dataclass(frozen=True, eq=False)
class PointMass:
    """Masses at nodes, the same in every translation.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements,) int array
        Node labels.
    mass : float or (n_elements,)
        Mass, kg.
    directions : tuple of {"X", "Y", "Z"}, optional
        Translations in which the mass moves; by default those that other elements give to the node, or all
        that the node's position has coordinates for where no other element gives any.
    """

    name: str
    nodes: IntArray
    mass: FloatArray
    directions: tuple[str, ...] | None

    def __init__(self, name: str, nodes: ArrayLike, mass: ArrayLike, directions: tuple[str, ...] | None = None) -> None:
        table = node_table(name, nodes, 1)
        if directions is not None and not set(directions) <= set(TRANSLATIONS):
            raise InputError(f"`directions` of {name!r} must be among X Y Z, got {directions}")
        values = property_values(name, "mass", mass, len(table))
        set_fields(self, name=name, nodes=table, mass=values, directions=directions and tuple(directions))

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        codes = -np.ones((len(self.nodes), 3), dtype=np.int64)
        for row, node in enumerate(self.nodes[:, 0]):
            for axis, direction in enumerate(self._directions(int(node), positions, present)):
                codes[row, axis] = dof_code(int(node), direction)
        local = np.eye(3) * (codes >= 0)[:, None, :]
        return (Term("mass", "mass", "kg", self.mass, codes, local),)

    def _directions(self, node: int, positions: Positions, present: frozenset[int]) -> tuple[str, ...]:
        if self.directions is not None:
            return self.directions
        used = tuple(d for d in TRANSLATIONS if dof_code(node, d) in present)
        return used or TRANSLATIONS[: len(positions[node])]


@dataclass(frozen=True, eq=False)
class RotaryInertia:
    """Mass moments of inertia at nodes about one axis.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements,) int array
        Node labels.
    rotary_inertia : float or (n_elements,)
        Mass moment of inertia, kg m^2.
    direction : {"RX", "RY", "RZ"}
        Axis of rotation.
    """

    name: str
    nodes: IntArray
    rotary_inertia: FloatArray
    direction: str

    def __init__(self, name: str, nodes: ArrayLike, rotary_inertia: ArrayLike, direction: str) -> None:
        table = node_table(name, nodes, 1)
        if direction not in DIRECTIONS[3:]:
            raise InputError(f"`direction` of {name!r} must be RX, RY or RZ, got {direction!r}")
        values = property_values(name, "rotary_inertia", rotary_inertia, len(table))
        set_fields(self, name=name, nodes=table, rotary_inertia=values, direction=direction)

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        codes = node_codes(self.nodes, (self.direction,))
        local = np.ones((len(self.nodes), 1, 1))
        return (Term("rotary_inertia", "rotary_inertia", "kg m^2", self.rotary_inertia, codes, local),)
