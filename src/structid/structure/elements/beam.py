"""Euler-Bernoulli beams on a line, in a plane and in space, with Hermite cubics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.errors import InputError
from structid.structure.elements.element import (
    Positions,
    Term,
    element_vectors,
    node_codes,
    rotated,
    store_element_set,
)


def hermite_mass(length: FloatArray) -> FloatArray:
    """Consistent mass of unit mass per length, (n, 4, 4), order w1 theta1 w2 theta2 with theta = dw/dx.

    References
    ----------
    Norris (1986), Eqs. (3.19a) and (3.19b).
    """
    h, one = length, np.ones_like(length)
    rows = [
        [156 * one, 22 * h, 54 * one, -13 * h],
        [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54 * one, 13 * h, 156 * one, -22 * h],
        [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]
    return np.moveaxis(np.array(rows), 2, 0) * (h / 420)[:, None, None]


def hermite_stiffness(length: FloatArray) -> FloatArray:
    """Bending stiffness of unit EI, (n, 4, 4), order w1 theta1 w2 theta2 with theta = dw/dx.

    References
    ----------
    Norris (1986), Eq. (3.20a).
    """
    h, one = length, np.ones_like(length)
    rows = [
        [12 * one, 6 * h, -12 * one, 6 * h],
        [6 * h, 4 * h**2, -6 * h, 2 * h**2],
        [-12 * one, -6 * h, 12 * one, -6 * h],
        [6 * h, 2 * h**2, -6 * h, 4 * h**2],
    ]
    return np.moveaxis(np.array(rows), 2, 0) / (h**3)[:, None, None]


def rod_mass(length: FloatArray) -> FloatArray:
    """Consistent mass of a rod of unit mass per length, (n, 2, 2)."""
    return np.array([[2.0, 1.0], [1.0, 2.0]]) * (length / 6)[:, None, None]


def rod_stiffness(length: FloatArray) -> FloatArray:
    """Stiffness of a rod of unit EA (or GJ), (n, 2, 2)."""
    return np.array([[1.0, -1.0], [-1.0, 1.0]]) / length[:, None, None]


@dataclass(frozen=True, eq=False)
class Beam:
    """Straight beams on a line (deflection Y, rotation RZ) or in a plane (X, Y, RZ).

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, 2) int array
        Node labels of the two ends.
    mass : float or (n_elements,)
        Mass per length, kg/m.
    bending_stiffness : float or (n_elements,)
        EI, N m^2.
    axial_stiffness : float or (n_elements,)
        EA, N; in a plane only.
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^2 (mass-like: c times the matrix of unit mass).
    stiffness_damping : float or (n_elements,)
        Strain-rate damping, N m^2 s (stiffness-like: c times the matrix of unit EI).
    """

    name: str
    nodes: IntArray
    mass: FloatArray
    bending_stiffness: FloatArray
    axial_stiffness: FloatArray
    loss_factor: FloatArray
    mass_damping: FloatArray
    stiffness_damping: FloatArray

    def __init__(
        self,
        name: str,
        nodes: ArrayLike,
        mass: ArrayLike,
        bending_stiffness: ArrayLike,
        axial_stiffness: ArrayLike = 0.0,
        loss_factor: ArrayLike = 0.0,
        mass_damping: ArrayLike = 0.0,
        stiffness_damping: ArrayLike = 0.0,
    ) -> None:
        store_element_set(
            self,
            name,
            nodes,
            2,
            mass=mass,
            bending_stiffness=bending_stiffness,
            axial_stiffness=axial_stiffness,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
            stiffness_damping=stiffness_damping,
        )

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        length, direction = element_vectors(self.name, self.nodes, positions)
        dimensions = direction.shape[1]
        bending_mass, bending = hermite_mass(length), hermite_stiffness(length)
        if dimensions == 1:
            if (direction < 0).any():
                raise InputError(f"beams of {self.name!r} must run along +X: give the end with the smaller x first")
            codes = node_codes(self.nodes, ("Y", "RZ"))
            axial = None
            mass, stiffness = bending_mass, bending
        elif dimensions == 2:
            codes = node_codes(self.nodes, ("X", "Y", "RZ"))
            along, across = _plane_maps(direction)
            axial = rotated(rod_stiffness(length), along)
            stiffness = rotated(bending, across)
            mass = rotated(bending_mass, across) + rotated(rod_mass(length), along)
        else:
            raise InputError(f"beams of {self.name!r} have 3-D nodes; use the element type `space_beam`")
        terms = [
            Term("mass", "mass", "kg/m", self.mass, codes, mass),
            Term("bending_stiffness", "stiffness", "N m^2", self.bending_stiffness, codes, stiffness),
            Term("loss_factor", "loss_factor", "1", self.loss_factor),
            Term("mass_damping", "viscous_damping", "N s/m^2", self.mass_damping, codes, mass),
            Term("stiffness_damping", "viscous_damping", "N m^2 s", self.stiffness_damping, codes, stiffness),
        ]
        if axial is not None:
            terms.insert(2, Term("axial_stiffness", "stiffness", "N", self.axial_stiffness, codes, axial))
        return tuple(terms)


def _plane_maps(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Maps from (X Y RZ, X Y RZ) to axial (u1 u2) and bending (w1 theta1 w2 theta2) coordinates of each element."""
    c, s = direction[:, 0], direction[:, 1]
    along = np.zeros((len(c), 2, 6))
    across = np.zeros((len(c), 4, 6))
    for end in (0, 1):
        at = 3 * end
        along[:, end, at], along[:, end, at + 1] = c, s
        across[:, 2 * end, at], across[:, 2 * end, at + 1] = -s, c
        across[:, 2 * end + 1, at + 2] = 1.0
    return along, across
