"""Euler-Bernoulli beams on a line, in a plane and in space, with Hermite cubics."""

from __future__ import annotations

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.errors import InputError
from structid.structure.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    ElementSet,
    Layer,
    Matrices,
    Nodes,
    Positions,
    Values,
    declared,
    element,
    element_vectors,
    node_codes,
    node_table,
    rotated,
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


@element
class Beam(ElementSet):
    """Straight beams on a line (deflection Y, rotation RZ) or in a plane (X, Y, RZ)."""

    is_line = True

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    bending_stiffness: Values = declared("EI", "stiffness", "N m^2")
    axial_stiffness: Values = declared("EA; in a plane only", "stiffness", "N", default=0.0)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^2", "mass", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "N m^2 s", "bending_stiffness", default=0.0)

    def matrices(self, positions: Positions, present: IntArray) -> Matrices:
        """See `ElementSet.matrices`."""
        length, direction = element_vectors(self.name, self.nodes, positions)
        mass, bending = hermite_mass(length), hermite_stiffness(length)
        if direction.shape[1] == 1:
            if (direction < 0).any():
                raise InputError(f"beams of {self.name!r} must run along +X: give the end with the smaller x first")
            codes = node_codes(self.nodes, ("Y", "RZ"))
            return {"mass": (Layer(codes, mass),), "bending_stiffness": (Layer(codes, bending),)}
        if direction.shape[1] == 3:
            raise InputError(f"beams of {self.name!r} have 3-D nodes; use the element type `space_beam`")
        codes = node_codes(self.nodes, ("X", "Y", "RZ"))
        along, across = _plane_maps(direction)
        return {
            "mass": (Layer(codes, rotated(mass, across) + rotated(rod_mass(length), along)),),
            "bending_stiffness": (Layer(codes, rotated(bending, across)),),
            "axial_stiffness": (Layer(codes, rotated(rod_stiffness(length), along)),),
        }


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
