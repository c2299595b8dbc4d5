"""Thin plates in bending: discrete Kirchhoff triangles and quadrilaterals."""

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
from structid.structure.elements.cells.elastic import plane_law
from structid.structure.elements.cells.kirchhoff import bending_stiffness, plate_mass
from structid.structure.elements.element import Positions, Term

PLATE_CELLS = {3: "triangle", 4: "quad"}


@dataclass(frozen=True, eq=False)
class Plate:
    """Thin plates in the x-y plane that bend: deflection Z and rotations RX, RY at each corner.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, n_nodes) int array
        Node labels, 3 (triangles) or 4 (quadrilaterals) an element, in either sense; rows of a set with both end in -1.
        Positions are 2-D, or 3-D with equal z in an element.
    youngs_modulus : float or (n_elements,)
        Pa.
    density : float or (n_elements,)
        kg/m^3.
    thickness : float or (n_elements,)
        m. Mass goes with its first power, stiffness with its third.
    poisson : float
        Poisson's ratio, known.
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^4.
    stiffness_damping : float or (n_elements,)
        Viscous damping in proportion to strain rate, Pa s.

    Notes
    -----
    No shear strain and no rotary inertia: for wavelengths of more than about 20 thicknesses. Rotations of the sensor's
    node are RX = dw/dy and RY = -dw/dx.

    References
    ----------
    Batoz, Bathe and Ho (1980), Int. J. Numer. Meth. Eng. 15, 1771-1812; Batoz and Ben Tahar (1982), ibid. 18, 1655-1677.
    """

    #: Directions that 2-D structures get besides those of their plane.
    transverse: ClassVar[tuple[str, ...]] = ("Z", "RX", "RY")

    name: str
    nodes: IntArray
    youngs_modulus: FloatArray
    density: FloatArray
    thickness: FloatArray
    poisson: float
    loss_factor: FloatArray
    mass_damping: FloatArray
    stiffness_damping: FloatArray

    def __init__(
        self,
        name: str,
        nodes: ArrayLike,
        youngs_modulus: ArrayLike,
        density: ArrayLike,
        thickness: ArrayLike,
        poisson: float,
        loss_factor: ArrayLike = 0.0,
        mass_damping: ArrayLike = 0.0,
        stiffness_damping: ArrayLike = 0.0,
    ) -> None:
        store_cells(
            self,
            name,
            nodes,
            PLATE_CELLS,
            poisson,
            youngs_modulus=youngs_modulus,
            density=density,
            thickness=thickness,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
            stiffness_damping=stiffness_damping,
        )

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        corners = cell_positions(self.name, self.nodes, positions, 2)
        law = plane_law(self.poisson, strain=False)
        t = self.thickness[:, None, None]

        def stiffness(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            return bending_stiffness(self.name, nodes, at, cell, law)

        def mass(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            return plate_mass(self.name, nodes, at, cell)

        heavy, stiff = (cell_matrices(self.nodes, corners, PLATE_CELLS, 3, each) for each in (mass, stiffness))
        codes = cell_codes(self.nodes, ("Z", "RX", "RY"))
        return elastic_terms(self, codes, heavy * t, stiff * t**3, (1, 3), "N s/m^4")
