"""Stretched membranes: linear triangles that move across their plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.errors import InputError
from structid.structure.elements.element import (
    Positions,
    Term,
    node_codes,
    set_fields,
    store_element_set,
)

_FLAT = 1e-12  # area over the square of the longest side, below which three corners lie on a line


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


@dataclass(frozen=True, eq=False)
class Membrane:
    """Membranes under uniform tension: linear triangles in the x-y plane that move along Z.

    The matrices are closed forms, computed for all triangles at once; they need no mesh library.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, 3) int array
        Node labels of the corners, in either sense. Positions are 2-D, or 3-D with equal z in a triangle.
    mass : float or (n_elements,)
        Mass per area, kg/m^2.
    tension : float or (n_elements,)
        Force per length, N/m.
    loss_factor : float or (n_elements,)
        Structural damping: tension times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^3 (mass-like: c times the matrix of unit mass).
    lumped : bool
        A third of each triangle's mass (and mass-like damping) at each corner instead of the consistent matrix.

    Notes
    -----
    Frequencies of the consistent form lie above those of the continuum, by O(h^2 omega^2) for sides h.
    A structure with 2-D nodes moves along Z where it holds a membrane; see `Structure`.
    """

    #: Direction that 2-D structures get besides those of their plane.
    transverse: ClassVar[tuple[str, ...]] = ("Z",)

    name: str
    nodes: IntArray
    mass: FloatArray
    tension: FloatArray
    loss_factor: FloatArray
    mass_damping: FloatArray
    lumped: bool

    def __init__(
        self,
        name: str,
        nodes: ArrayLike,
        mass: ArrayLike,
        tension: ArrayLike,
        loss_factor: ArrayLike = 0.0,
        mass_damping: ArrayLike = 0.0,
        lumped: bool = False,
    ) -> None:
        store_element_set(
            self,
            name,
            nodes,
            3,
            mass=mass,
            tension=tension,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
        )
        set_fields(self, lumped=bool(lumped))

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        corners = self._corners(positions)
        area = self._area(corners)
        codes = node_codes(self.nodes, self.transverse)
        mass = triangle_mass(area, self.lumped)
        return (
            Term("mass", "mass", "kg/m^2", self.mass, codes, mass),
            Term("tension", "stiffness", "N/m", self.tension, codes, triangle_stiffness(corners, area)),
            Term("loss_factor", "loss_factor", "1", self.loss_factor),
            Term("mass_damping", "viscous_damping", "N s/m^3", self.mass_damping, codes, mass),
        )

    def _corners(self, positions: Positions) -> FloatArray:
        """Positions in the plane, (n_elements, 3, 2)."""
        corners = np.array([[positions[int(node)] for node in row] for row in self.nodes])
        dimensions = corners.shape[2]
        if dimensions == 1:
            raise InputError(f"triangles of {self.name!r} need 2-D or 3-D nodes, got positions with one coordinate")
        if dimensions == 3:
            size = np.ptp(corners[..., :2], axis=1).max(axis=1)
            tilted = np.ptp(corners[..., 2], axis=1) > 1e-9 * size
            if tilted.any():
                e = int(np.argmax(tilted))
                raise InputError(
                    f"element {e + 1} of {self.name!r} is not parallel to the x-y plane: nodes "
                    f"{', '.join(map(str, self.nodes[e]))} have z = {', '.join(f'{z:g}' for z in corners[e, :, 2])}; "
                    "turn the model so that the membrane lies in x-y"
                )
        return corners[..., :2]

    def _area(self, corners: FloatArray) -> FloatArray:
        """Area of each triangle, (n_elements,), m^2."""
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        flat = area <= _FLAT * longest**2
        if flat.any():
            e = int(np.argmax(flat))
            corner_names = ", ".join(map(str, self.nodes[e]))
            raise InputError(f"element {e + 1} of {self.name!r} has no area: nodes {corner_names} lie on a line")
        return area
