"""Plates loaded in their plane: plane stress and plane strain, triangles and quadrilaterals."""

from __future__ import annotations

from functools import partial
from typing import Literal

from structid.core.arrays import IntArray
from structid.fem.elements.cells.cells import (
    DENSITY,
    POISSON,
    YOUNGS_MODULUS,
    CellSet,
    Formulation,
    Poisson,
    cell_positions,
    cell_table,
)
from structid.fem.elements.cells.elastic import elastic_stiffness, plane_elasticity, unit_mass
from structid.fem.elements.cells.isoparametric import PLANE_CELLS
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
class Plane(CellSet):
    """Plane stress or plane strain in the x-y plane; moves along X and Y.

    References
    ----------
    Taylor, Beresford and Wilson (1976), Int. J. Numer. Meth. Eng. 10, 1211-1219 (incompatible modes).
    """

    cells = PLANE_CELLS
    symbol = "flat"
    moves = ("X", "Y")

    nodes: Nodes = declared(
        "Node labels: 3 or 6 (triangles), 4, 8 or 9 (quadrilaterals) an element, in either sense, mid-side nodes after the"
        " corners; rows of a set with several cell types end in -1. Positions are 2-D, or 3-D with equal z in an element",
        stored=cell_table(PLANE_CELLS),
    )
    youngs_modulus: Values = declared(*YOUNGS_MODULUS)
    density: Values = declared(*DENSITY)
    thickness: Values = declared("Mass and stiffness go with its first power", "thickness", "m", positive=True)
    poisson: Poisson = declared(POISSON)
    state: Literal["stress", "strain"] = declared(
        "Plane stress (thin plates) or plane strain (long prisms)", default="stress"
    )
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^4", "density", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "Pa s", "youngs_modulus", default=0.0)
    formulation: Formulation = declared("Of four-node quadrilaterals; see `elastic_stiffness`", default="incompatible")

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices of density (mass) and Young's modulus (stiffness), by property.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not needed.
        """
        corners = cell_positions(self.name, self.nodes, positions, 2)
        elasticity = plane_elasticity(self.poisson, self.state == "strain")
        stiffness = partial(elastic_stiffness, elasticity=elasticity, formulation=self.formulation)
        return {
            "density": (self.matrix_term(corners, unit_mass, power=1),),
            "youngs_modulus": (self.matrix_term(corners, stiffness, power=1),),
        }
