"""Thin plates in bending: discrete Kirchhoff triangles and quadrilaterals."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.elements.cells.cells import (
    DENSITY,
    POISSON,
    YOUNGS_MODULUS,
    CellSet,
    Poisson,
    cell_positions,
    cell_table,
)
from structid.fem.elements.cells.elastic import plane_elasticity
from structid.fem.elements.cells.kirchhoff import PLATE_CELLS, bending_stiffness, centre_curvatures, plate_mass
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    Matrices,
    NodeCoordinates,
    Nodes,
    Values,
    declared,
    element,
)


@element
class ThinSet(CellSet):
    """Thin triangles and quadrilaterals, of plates and shells."""

    cells = PLATE_CELLS

    nodes: Nodes = declared(
        "Node labels, 3 (triangles) or 4 (quadrilaterals) an element; rows of a set with both end in -1",
        stored=cell_table(PLATE_CELLS),
    )
    youngs_modulus: Values = declared(*YOUNGS_MODULUS)
    density: Values = declared(*DENSITY)
    thickness: Values = declared(
        "Mass and stretching go with its first power, bending and rotary inertia with its third",
        "thickness",
        "m",
        positive=True,
    )
    poisson: Poisson = declared(POISSON)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^4", "density", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "Pa s", "youngs_modulus", default=0.0)

    def centre_strains(self, positions: NodeCoordinates, row: int) -> tuple[FloatArray, FloatArray]:
        """Maps from an element's motion to the strains of its middle surface at its centre, and to those per height.

        Both are (3, n_coordinates): strains xx, yy and engineering xy, from what its corners move in, corner by corner. The axis x
        is the part of global X in the plane of the element, or of global Y where X is normal to it; height counts along the
        normal, about which the corners run counter-clockwise, and along Z in a plate.
        """
        raise NotImplementedError


@element
class Plate(ThinSet):
    """Thin plates in the x-y plane that bend: deflection Z and rotations RX, RY at each corner.

    Nodes are numbered in either sense; positions are 2-D, or 3-D with equal z in an element.

    Notes
    -----
    No shear strain and no rotary inertia: for wavelengths of more than about 20 thicknesses. Rotations of the sensor's
    node are RX = dw/dy and RY = -dw/dx.

    References
    ----------
    Batoz, Bathe and Ho (1980), Int. J. Numer. Meth. Eng. 15, 1771-1812; Batoz and Ben Tahar (1982), ibid. 18, 1655-1677.
    """

    moves = ("Z", "RX", "RY")
    symbol = "flat"

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices of density (mass) and Young's modulus (bending stiffness), by property.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not needed.
        """
        corners = cell_positions(self.name, self.nodes, positions, 2)
        bending = partial(bending_stiffness, elasticity=plane_elasticity(self.poisson, strain=False))
        return {
            "density": (self.matrix_term(corners, plate_mass, power=1),),
            "youngs_modulus": (self.matrix_term(corners, bending, power=3),),
        }

    def centre_strains(self, positions: NodeCoordinates, row: int) -> tuple[FloatArray, FloatArray]:
        """Maps from the motion of the element in `row` to in-plane strains, which are zero, and to strains per height (1/m).

        Both are (3, 3 n_corners), at the centre, as in `ThinSet.centre_strains`; `positions` of nodes in m.
        """
        nodes = self.nodes[row][self.nodes[row] >= 0][None]
        corners = cell_positions(self.name, nodes, positions, 2)
        curvatures = centre_curvatures(self.name, nodes, corners, PLATE_CELLS[nodes.shape[1]])[0]
        return np.zeros_like(curvatures), curvatures
