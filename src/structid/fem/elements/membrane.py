"""Stretched membranes: linear triangles that move across their plane."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.elements.cells import CellSet, cell_positions, cell_table
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_VELOCITY,
    ElementMatrixTerm,
    Matrices,
    NodeCoordinates,
    Nodes,
    Values,
    declared,
    element,
    node_codes,
)
from structid.fem.elements.isoparametric import CELLS, gradients

_CELLS = {3: "triangle"}


def triangle_mass(area: FloatArray, lumped: bool = False) -> FloatArray:
    """Mass of linear triangles of unit mass per area, (n, 3, 3).

    Parameters
    ----------
    area : (n,) float array
        m^2.
    lumped : bool
        A third of the mass at each corner instead of the consistent area / 12 (1 + delta_ij).

    References
    ----------
    Zienkiewicz and Taylor (2000), The Finite Element Method, 5th ed., vol. 1, section 17.2.
    """
    unit = np.eye(3) / 3 if lumped else (np.ones((3, 3)) + np.eye(3)) / 12
    return unit * area[:, None, None]


def triangle_stiffness(corners: FloatArray, area: FloatArray) -> FloatArray:
    """Stiffness of linear triangles under unit tension, (n, 3, 3): area times the products of shape gradients.

    The gradient of corner i's shape function is the opposite side, turned by 90 degrees, over twice the area.

    Parameters
    ----------
    corners : (n, 3, 2) float array
        Positions in m.
    area : (n,) float array
        m^2.
    """
    sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    return sides @ np.swapaxes(sides, 1, 2) / (4 * area)[:, None, None]


@element
class Membrane(CellSet):
    """Membranes under uniform tension: linear triangles in the x-y plane that move along Z.

    The matrices are closed forms, computed for all triangles at once; they need no mesh library.

    Notes
    -----
    Frequencies of the consistent form lie above those of the continuum, by O(h^2 omega^2) for sides h.
    A structure with 2-D nodes moves along Z where it holds a membrane; see `Structure`.
    """

    cells = _CELLS
    symbol = "flat"
    moves = ("Z",)

    nodes: Nodes = declared(
        "Node labels of the corners, in either sense. Positions are 2-D, or 3-D with equal z in a triangle",
        stored=cell_table(_CELLS),
    )
    mass: Values = declared("Mass per area", "mass", "kg/m^2")
    tension: Values = declared("Force per length", "stiffness", "N/m")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^3", "mass", default=0.0)
    lumped: bool = declared(
        "A third of each triangle's mass (and mass-like damping) at each corner instead of the consistent matrix",
        default=False,
    )

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices for unit mass per area and unit tension, by property, on the motions normal to the membrane.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not
        needed. Raises `InputError` if a triangle has no area.
        """
        corners = cell_positions(self.name, self.nodes, positions, 2)
        gradients(self.name, self.nodes, corners, CELLS["triangle"], np.zeros((1, 2)))  # so that a flat one is told
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        codes = node_codes(self.nodes, self.moves)
        mass = triangle_mass(area, self.lumped)
        return {
            "mass": (ElementMatrixTerm(codes, mass),),
            "tension": (ElementMatrixTerm(codes, triangle_stiffness(corners, area)),),
        }
