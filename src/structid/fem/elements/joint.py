"""Flexible joints: the end of one element that turns or moves against its node."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import IntArray, locked
from structid.core.dof import Dof, parse_dof
from structid.fem.elements.element import (
    LOSS_FACTOR,
    At,
    Declared,
    ElementMatrixTerm,
    ElementSet,
    Matrices,
    NodeCoordinates,
    Nodes,
    Values,
    declared,
    dof_code,
    element,
)


@element
class Joint(ElementSet):
    """A flexible joint: the end of one bar or beam gives way against its node in one direction, held by a spring.

    In all other directions the end stays with the node. An end may have several joints, each in another direction. Where
    supports hold the node, the joint is that of a yielding support.
    """

    follows = True
    symbol = "ring"

    nodes: Nodes = declared("The node", init=False)
    element: str = declared("The element, counted from 1, such as ``girder:1``")
    at: At = declared("Which of its nodes, and the global direction that gives way, such as ``4RZ``")
    stiffness: Values = declared("Stiffness", "stiffness", "N/m", about_axes="N m/rad")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", parse_dof(self.at).unsigned)
        object.__setattr__(self, "nodes", locked(np.array([[self.at.node]]), np.int64))
        super().__post_init__()

    @property
    def loosened(self) -> tuple[str, Dof]:
        """The element and the degree of freedom."""
        return self.element, self.at

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """The spring between the node and the end, which the structure numbers; see `ElementSet.loosened`."""
        codes = np.array([[dof_code(self.at.node, self.at.direction), -1]])
        return {"stiffness": (ElementMatrixTerm(codes, np.array([[[1.0, -1.0], [-1.0, 1.0]]])),)}

    def unit(self, what: Declared) -> str:
        """The unit that fits the direction."""
        return what.about_axes or what.unit if self.at.is_rotation else what.unit
