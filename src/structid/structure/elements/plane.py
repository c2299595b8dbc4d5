"""Plates loaded in their plane: plane stress and plane strain, triangles and quadrilaterals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.errors import InputError
from structid.structure.elements.cells.cells import (
    cell_codes,
    cell_matrices,
    cell_positions,
    elastic_terms,
    store_cells,
)
from structid.structure.elements.cells.elastic import elastic_stiffness, plane_law, unit_mass
from structid.structure.elements.cells.isoparametric import PLANE_CELLS
from structid.structure.elements.element import Positions, Term, set_fields

FORMULATIONS = ("incompatible", "full", "mean_dilatation")


@dataclass(frozen=True, eq=False)
class Plane:
    """Plane stress or plane strain in the x-y plane; moves along X and Y.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, n_nodes) int array
        Node labels: 3 or 6 (triangles), 4, 8 or 9 (quadrilaterals) an element, in either sense, mid-side nodes after the
        corners; rows of a set with several cell types end in -1. Positions are 2-D, or 3-D with equal z in an element.
    youngs_modulus : float or (n_elements,)
        Pa.
    density : float or (n_elements,)
        kg/m^3.
    thickness : float or (n_elements,)
        m. Mass and stiffness go with its first power.
    poisson : float
        Poisson's ratio, known.
    state : {"stress", "strain"}
        Plane ``stress`` (thin plates, the default) or plane ``strain`` (long prisms).
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^4.
    stiffness_damping : float or (n_elements,)
        Viscous damping in proportion to strain rate, Pa s.
    formulation : {"incompatible", "full", "mean_dilatation"}
        Of four-node quadrilaterals; see `elastic_stiffness`.

    References
    ----------
    Taylor, Beresford and Wilson (1976), Int. J. Numer. Meth. Eng. 10, 1211-1219 (incompatible modes).
    """

    #: Directions in which its nodes move.
    directions: ClassVar[tuple[str, ...]] = ("X", "Y")

    name: str
    nodes: IntArray
    youngs_modulus: FloatArray
    density: FloatArray
    thickness: FloatArray
    poisson: float
    state: str
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
        thickness: ArrayLike,
        poisson: float,
        state: str = "stress",
        loss_factor: ArrayLike = 0.0,
        mass_damping: ArrayLike = 0.0,
        stiffness_damping: ArrayLike = 0.0,
        formulation: str = "incompatible",
    ) -> None:
        store_cells(
            self,
            name,
            nodes,
            PLANE_CELLS,
            poisson,
            youngs_modulus=youngs_modulus,
            density=density,
            thickness=thickness,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
            stiffness_damping=stiffness_damping,
        )
        if state not in ("stress", "strain"):
            raise InputError(f'`state` of {name!r} must be "stress" or "strain", got {state!r}')
        require_formulation(name, formulation)
        set_fields(self, state=state, formulation=formulation)

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        corners = cell_positions(self.name, self.nodes, positions, 2)
        law = plane_law(self.poisson, self.state == "strain")
        t = self.thickness[:, None, None]

        def stiffness(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            return elastic_stiffness(self.name, nodes, at, cell, law, self.formulation)

        def mass(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            return unit_mass(self.name, nodes, at, cell)

        heavy, stiff = (cell_matrices(self.nodes, corners, PLANE_CELLS, 2, each) * t for each in (mass, stiffness))
        return elastic_terms(self, cell_codes(self.nodes, ("X", "Y")), heavy, stiff, (1, 1), "N s/m^4")


def require_formulation(name: str, formulation: str) -> None:
    """Raise `InputError` unless `formulation` is one of those of `elastic_stiffness`."""
    if formulation not in FORMULATIONS:
        raise InputError(f"`formulation` of {name!r} must be one of {', '.join(FORMULATIONS)}, got {formulation!r}")
