"""Elastic solids: tetrahedra, pyramids, wedges and hexahedra."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.structure.elements.cells.cells import (
    cell_codes,
    cell_matrices,
    cell_positions,
    elastic_terms,
    store_cells,
)
from structid.structure.elements.cells.elastic import elastic_stiffness, solid_law, unit_mass
from structid.structure.elements.cells.isoparametric import SOLID_CELLS
from structid.structure.elements.element import Positions, Term, set_fields
from structid.structure.elements.plane import require_formulation


@dataclass(frozen=True, eq=False)
class Solid:
    """Isotropic elastic solids; move along X, Y and Z.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, n_nodes) int array
        Node labels, numbered as in VTK: 4 or 10 (tetrahedra), 5 (pyramids), 6 or 15 (wedges), 8, 20 or 27 (hexahedra) an
        element; rows of a set with several cell types end in -1. Positions are 3-D.
    youngs_modulus : float or (n_elements,)
        Pa.
    density : float or (n_elements,)
        kg/m^3.
    poisson : float
        Poisson's ratio, known.
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^4.
    stiffness_damping : float or (n_elements,)
        Viscous damping in proportion to strain rate, Pa s.
    formulation : {"incompatible", "full", "mean_dilatation"}
        Of eight-node hexahedra; see `elastic_stiffness`.

    Notes
    -----
    Four-node tetrahedra and plain hexahedra are far too stiff in bending; take ten nodes or incompatible modes.
    """

    #: Directions in which its nodes move.
    directions: ClassVar[tuple[str, ...]] = ("X", "Y", "Z")

    name: str
    nodes: IntArray
    youngs_modulus: FloatArray
    density: FloatArray
    poisson: float
    loss_factor: FloatArray
    mass_damping: FloatArray
    stiffness_damping: FloatArray
    formulation: str

    def __init__(
        self,
        name: str,
        nodes: ArrayLike,
        youngs_modulus: ArrayLike,
        density: ArrayLike,
        poisson: float,
        loss_factor: ArrayLike = 0.0,
        mass_damping: ArrayLike = 0.0,
        stiffness_damping: ArrayLike = 0.0,
        formulation: str = "incompatible",
    ) -> None:
        store_cells(
            self,
            name,
            nodes,
            SOLID_CELLS,
            poisson,
            youngs_modulus=youngs_modulus,
            density=density,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
            stiffness_damping=stiffness_damping,
        )
        require_formulation(name, formulation)
        set_fields(self, formulation=formulation)

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        corners = cell_positions(self.name, self.nodes, positions, 3)
        law = solid_law(self.poisson)

        def stiffness(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            return elastic_stiffness(self.name, nodes, at, cell, law, self.formulation)

        def mass(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            return unit_mass(self.name, nodes, at, cell)

        heavy, stiff = (cell_matrices(self.nodes, corners, SOLID_CELLS, 3, each) for each in (mass, stiffness))
        return elastic_terms(self, cell_codes(self.nodes, ("X", "Y", "Z")), heavy, stiff, (0, 0), "N s/m^4")
