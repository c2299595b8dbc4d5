"""Beams on a line and in a plane, with Hermite cubics: Euler-Bernoulli, or Timoshenko where they shear."""

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
    OptionalValues,
    Positions,
    ShearShare,
    Values,
    declared,
    element,
    element_vectors,
    node_codes,
    node_table,
    rotated,
    shear_share,
)

#: What both types of beam say of their shear.
SHEAR = "G times the shear area; without it, or infinite, the beam does not shear"


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


def bending_layers(
    codes: IntArray,
    across: FloatArray,
    length: FloatArray,
    bending: tuple[str, FloatArray],
    shear: tuple[str, FloatArray | None],
) -> tuple[Layer, ...]:
    """Bending stiffness of unit EI, less what shear gives way: exact for Timoshenko beams loaded at their ends.

    Hermite's matrix is a sum of two: a uniform curvature e = theta2 - theta1 with the stiffness EI / L, and one that
    grows along the beam, a = w1 - w2 + (theta1 + theta2) L / 2, with 12 EI / L^3. Of the two only the second goes with
    a shear force, whose compliance L / GA adds to L^3 / 12 EI.

    Parameters
    ----------
    codes : (n, n_codes) int array
    across : (n, 4, n_codes) float array
        From the coordinates of the elements to w1 theta1 w2 theta2.
    length : (n,) float array
    bending, shear : (str, (n,) float array)
        Properties EI and G A_s: name and nominal values; None for the second where nothing shears.

    References
    ----------
    Przemieniecki (1968), Theory of Matrix Structural Analysis, Eq. (5.116).
    """
    name, values = shear
    if values is None:
        return (Layer(codes, rotated(hermite_stiffness(length), across)),)
    one, none = np.ones_like(length), np.zeros_like(length)
    even = np.stack([none, -one, none, one], axis=1)
    odd = np.stack([one, length / 2, -one, length / 2], axis=1)
    share = ShearShare(bending[0], name, 12 / length**2)
    left = shear_share(bending[1], values, share.ratio)
    uniform = even[:, :, None] * even[:, None, :] / length[:, None, None]
    growing = odd[:, :, None] * odd[:, None, :] * (left * 12 / length**3)[:, None, None]
    return (
        Layer(codes, rotated(uniform, across)),
        Layer(codes, rotated(growing, across), shear=share),
    )


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
    shear_stiffness: OptionalValues = declared(SHEAR, "stiffness", "N", positive=True, unlimited=True, default=None)

    def matrices(self, positions: Positions, present: IntArray) -> Matrices:
        """See `ElementSet.matrices`."""
        length, direction = element_vectors(self.name, self.nodes, positions)
        mass = hermite_mass(length)
        bending, shear = ("bending_stiffness", self.bending_stiffness), ("shear_stiffness", self.shear_stiffness)
        shears: Matrices = {} if self.shear_stiffness is None else {"shear_stiffness": ()}
        if direction.shape[1] == 1:
            if (direction < 0).any():
                raise InputError(f"beams of {self.name!r} must run along +X: give the end with the smaller x first")
            codes = node_codes(self.nodes, ("Y", "RZ"))
            layers = bending_layers(codes, np.broadcast_to(np.eye(4), mass.shape), length, bending, shear)
            return {"mass": (Layer(codes, mass),), "bending_stiffness": layers, **shears}
        if direction.shape[1] == 3:
            raise InputError(f"beams of {self.name!r} have 3-D nodes; use the element type `space_beam`")
        codes = node_codes(self.nodes, ("X", "Y", "RZ"))
        along, across = _plane_maps(direction)
        return {
            "mass": (Layer(codes, rotated(mass, across) + rotated(rod_mass(length), along)),),
            "bending_stiffness": bending_layers(codes, across, length, bending, shear),
            "axial_stiffness": (Layer(codes, rotated(rod_stiffness(length), along)),),
            **shears,
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
