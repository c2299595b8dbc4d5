"""Thin shells of flat facets in space: stretching and bending of triangles and quadrilaterals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.dof import DIRECTIONS
from structid.errors import InputError
from structid.structure.elements.cells.cells import (
    cell_codes,
    cell_matrices,
    cell_positions,
    elastic_terms,
    store_cells,
)
from structid.structure.elements.cells.drilling_membrane import drilling_stiffness
from structid.structure.elements.cells.elastic import plane_law, unit_mass
from structid.structure.elements.cells.facets import facets
from structid.structure.elements.cells.kirchhoff import bending_stiffness, plate_mass
from structid.structure.elements.element import Layer, Positions, Term, set_fields
from structid.structure.elements.plate import PLATE_CELLS


@dataclass(frozen=True, eq=False)
class Shell:
    """Thin shells of flat facets: all six degrees of freedom at each corner.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, n_nodes) int array
        Node labels, 3 (triangles) or 4 (quadrilaterals) an element; rows of a set with both end in -1. Positions are 3-D,
        on the middle surface.
    youngs_modulus : float or (n_elements,)
        Pa.
    density : float or (n_elements,)
        kg/m^3.
    thickness : float or (n_elements,)
        m. Mass and stretching go with its first power, bending and rotary inertia with its third.
    poisson : float
        Poisson's ratio, known.
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^4.
    stiffness_damping : float or (n_elements,)
        Viscous damping in proportion to strain rate, Pa s.
    linear_strains : float
        Share, above 0 and up to 1, of the stiffness against strains that vary linearly within a facet. 1 is exact for webs one
        cell deep that bend in their plane; less spares thin curved shells, whose facets meet at angles, a false stiffness.

    Notes
    -----
    Bending is that of `Plate` (discrete Kirchhoff, no shear strain). Stretching is the membrane of Felippa (2003), in which
    the rotation about the normal is that of the material, so that no spring holds it. Rotary inertia is
    thickness^3 / 12 times density about all three axes: about the normal this is none of nature's, and changes
    in-plane waves of wave number k by (k thickness)^2 / 96 in frequency, but every degree of freedom has mass.
    Corners of a warped quadrilateral are joined to its mean plane by rigid links.

    References
    ----------
    Batoz, Bathe and Ho (1980), Int. J. Numer. Meth. Eng. 15, 1771-1812; Batoz and Ben Tahar (1982), ibid. 18, 1655-1677;
    Felippa (2003), Comput. Methods Appl. Mech. Engrg. 192, 2125-2168.
    """

    #: Directions in which its nodes move.
    directions: ClassVar[tuple[str, ...]] = DIRECTIONS

    name: str
    nodes: IntArray
    youngs_modulus: FloatArray
    density: FloatArray
    thickness: FloatArray
    poisson: float
    loss_factor: FloatArray
    mass_damping: FloatArray
    stiffness_damping: FloatArray
    linear_strains: float

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
        linear_strains: float = 0.1,
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
        if not 0 < linear_strains <= 1:
            raise InputError(f"`linear_strains` of {name!r} must be above 0 and at most 1, got {linear_strains:g}")
        set_fields(self, linear_strains=float(linear_strains))

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        corners = cell_positions(self.name, self.nodes, positions, 3)
        law = plane_law(self.poisson, strain=False)
        t = self.thickness[:, None, None]

        def stretching(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            flat = facets(self.name, nodes, at)
            return flat.in_space(
                _placed(drilling_stiffness(flat.corners, law, self.poisson, self.linear_strains), (0, 1, 5))
            )

        def bending(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            flat = facets(self.name, nodes, at)
            return flat.in_space(_placed(bending_stiffness(self.name, nodes, flat.corners, cell, law), (2, 3, 4)))

        def mass(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            flat = facets(self.name, nodes, at)
            across = _placed(plate_mass(self.name, nodes, flat.corners, cell), (2, 3, 4))
            return flat.in_space(across + _placed(unit_mass(self.name, nodes, flat.corners, cell), (0, 1)))

        def rotary(nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
            linear = unit_mass(self.name, nodes, facets(self.name, nodes, at).corners, cell)[:, ::2, ::2]
            return np.einsum("eij,kl->eikjl", linear / 12, np.eye(3)).reshape(len(nodes), 3 * nodes.shape[1], -1)

        stretch, bend, heavy = (
            cell_matrices(self.nodes, corners, PLATE_CELLS, 6, each) for each in (stretching, bending, mass)
        )
        turn = cell_matrices(self.nodes, corners, PLATE_CELLS, 3, rotary)
        codes, turns = cell_codes(self.nodes, DIRECTIONS), cell_codes(self.nodes, DIRECTIONS[3:])
        besides = (Layer(turns, turn * t**3, 3),), (Layer(codes, bend * t**3, 3),)
        return elastic_terms(self, codes, heavy * t, stretch * t, (1, 1), "N s/m^4", *besides)


def _placed(small: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """Matrices on some coordinates of each corner as matrices on all six."""
    n = small.shape[1] // len(axes)
    rows = np.ravel([[6 * k + axis for axis in axes] for k in range(n)])
    found = np.zeros((len(small), 6 * n, 6 * n))
    found[:, rows[:, None], rows[None]] = small
    return found
