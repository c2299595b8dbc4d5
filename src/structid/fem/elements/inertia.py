"""Point masses and rotary inertias."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np

from structid.core.arrays import IntArray
from structid.core.errors import InputError
from structid.fem.elements.element import (
    TRANSLATIONS,
    ElementMatrixTerm,
    ElementSet,
    Matrices,
    NodeCoordinates,
    Nodes,
    Translations,
    Values,
    declared,
    element,
    node_codes,
    node_table,
)


def _checked_translations(name: str, directions_given: Iterable[str]) -> tuple[str, ...]:
    """`directions_given` as a tuple; raises `InputError`, which names the set `name`, unless all are among X, Y, Z."""
    directions = tuple(directions_given)
    if not set(directions) <= set(TRANSLATIONS):
        raise InputError(f"`directions` of {name!r} must be among X Y Z, got {directions}")
    return directions


@element
class PointMass(ElementSet):
    """Masses at nodes, the same in every translation."""

    follows = True
    symbol = "disc"

    nodes: Nodes = declared("Node labels", stored=node_table(1))
    mass: Values = declared("Mass", "mass", "kg")
    directions: Translations = declared(
        "Translations in which the mass moves; by default those that other elements give to the node, or all that the"
        " node's position has coordinates for where no other element gives any",
        stored=_checked_translations,
        default=None,
    )

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Diagonal 3 x 3 mass matrices for unit mass, with ones in the translations in which the node moves.

        Rows without motion have the code -1. The translations are the `directions` if stated, else those in
        `used_codes`, which other elements use; a node without any has all that `positions` (m) have coordinates for.
        """
        codes = node_codes(self.nodes, TRANSLATIONS)
        moves = np.isin(codes, used_codes)
        if self.directions is not None:
            moves[:] = np.isin(TRANSLATIONS, self.directions)
        without_motion = ~moves.any(axis=1)
        moves[without_motion] = np.arange(3) < len(next(iter(positions.values())))
        return {"mass": (ElementMatrixTerm(np.where(moves, codes, -1), np.eye(3) * moves[:, None, :]),)}


@element
class RotaryInertia(ElementSet):
    """Mass moments of inertia at nodes about one axis."""

    follows = True
    symbol = "ring"

    nodes: Nodes = declared("Node labels", stored=node_table(1))
    rotary_inertia: Values = declared("Mass moment of inertia", "rotary_inertia", "kg m^2")
    direction: Literal["RX", "RY", "RZ"] = declared("Axis of rotation")

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Unit rotary inertia at each node, by property name; the arguments have no influence."""
        codes = node_codes(self.nodes, (self.direction,))
        return {"rotary_inertia": (ElementMatrixTerm(codes, np.ones((len(self.nodes), 1, 1))),)}
