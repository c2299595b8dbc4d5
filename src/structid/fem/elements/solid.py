"""Elastic solids: tetrahedra, pyramids, wedges and hexahedra."""

from __future__ import annotations

from functools import partial

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
from structid.fem.elements.cells.elastic import elastic_stiffness, solid_elasticity, unit_mass
from structid.fem.elements.cells.isoparametric import SOLID_CELLS
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    TRANSLATIONS,
    Matrices,
    NodeCoordinates,
    Nodes,
    Values,
    declared,
    element,
)


@element
class Solid(CellSet):
    """Isotropic elastic solids; move along X, Y and Z.

    Notes
    -----
    Four-node tetrahedra and plain hexahedra are far too stiff in bending; take ten nodes or incompatible modes.
    """

    cells = SOLID_CELLS
    symbol = "solid"
    moves = TRANSLATIONS

    nodes: Nodes = declared(
        "Node labels, numbered as in VTK: 4 or 10 (tetrahedra), 5 (pyramids), 6 or 15 (wedges), 8, 20 or 27 (hexahedra) an"
        " element; rows of a set with several cell types end in -1. Positions are 3-D",
        stored=cell_table(SOLID_CELLS),
    )
    youngs_modulus: Values = declared(*YOUNGS_MODULUS)
    density: Values = declared(*DENSITY)
    poisson: Poisson = declared(POISSON)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^4", "density", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "Pa s", "youngs_modulus", default=0.0)
    formulation: Formulation = declared("Of eight-node hexahedra; see `elastic_stiffness`", default="incompatible")

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices of density (mass) and Young's modulus (stiffness), by property.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not needed.
        """
        corners = cell_positions(self.name, self.nodes, positions, 3)
        stiffness = partial(elastic_stiffness, elasticity=solid_elasticity(self.poisson), formulation=self.formulation)
        return {
            "density": (self.matrix_term(corners, unit_mass),),
            "youngs_modulus": (self.matrix_term(corners, stiffness),),
        }
