"""Euler-Bernoulli beams in space: two bending planes, extension and torsion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray, locked, require_shape
from structid.dof import DIRECTIONS
from structid.errors import InputError
from structid.structure.elements.beam import hermite_mass, hermite_stiffness, rod_mass, rod_stiffness
from structid.structure.elements.element import (
    Positions,
    Term,
    element_vectors,
    node_codes,
    rotated,
    set_fields,
    store_element_set,
)


@dataclass(frozen=True, eq=False)
class SpaceBeam:
    """Straight beams between nodes in space, six degrees of freedom a node.

    The local x axis runs from the first node to the second, local y is the part of `orientation` across it.

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, 2) int array
        Node labels of the two ends.
    mass : float or (n_elements,)
        Mass per length, kg/m.
    bending_stiffness_y, bending_stiffness_z : float or (n_elements,)
        EI about the local y axis (deflection along local z) and about local z (deflection along local y), N m^2.
    axial_stiffness : float or (n_elements,)
        EA, N.
    torsional_stiffness : float or (n_elements,)
        GJ, N m^2.
    polar_inertia : float or (n_elements,)
        Polar mass moment per length, kg m.
    loss_factor : float or (n_elements,)
        Structural damping of all four stiffnesses.
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^2.
    orientation : (3,) array, optional
        A vector in the local x-y plane; by default global Y, or global X for beams along Y.
    """

    name: str
    nodes: IntArray
    mass: FloatArray
    bending_stiffness_y: FloatArray
    bending_stiffness_z: FloatArray
    axial_stiffness: FloatArray
    torsional_stiffness: FloatArray
    polar_inertia: FloatArray
    loss_factor: FloatArray
    mass_damping: FloatArray
    orientation: FloatArray | None

    def __init__(
        self,
        name: str,
        nodes: ArrayLike,
        mass: ArrayLike,
        bending_stiffness_y: ArrayLike,
        bending_stiffness_z: ArrayLike,
        axial_stiffness: ArrayLike = 0.0,
        torsional_stiffness: ArrayLike = 0.0,
        polar_inertia: ArrayLike = 0.0,
        loss_factor: ArrayLike = 0.0,
        mass_damping: ArrayLike = 0.0,
        orientation: ArrayLike | None = None,
    ) -> None:
        store_element_set(
            self,
            name,
            nodes,
            2,
            mass=mass,
            bending_stiffness_y=bending_stiffness_y,
            bending_stiffness_z=bending_stiffness_z,
            axial_stiffness=axial_stiffness,
            torsional_stiffness=torsional_stiffness,
            polar_inertia=polar_inertia,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
        )
        if orientation is not None:
            orientation = locked(orientation, np.float64)
            require_shape("orientation", orientation, (3,))
            if not (np.isfinite(orientation).all() and orientation.any()):
                raise InputError(f"`orientation` of {name!r} must be a direction, got {orientation.tolist()}")
        set_fields(self, orientation=orientation)

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        length, direction = element_vectors(self.name, self.nodes, positions)
        if direction.shape[1] != 3:
            raise InputError(f"beams of {self.name!r} need 3-D nodes; use the element type `beam`")
        codes = node_codes(self.nodes, DIRECTIONS)
        maps = _space_maps(self._axes(direction))
        rod, bend = rod_stiffness(length), hermite_stiffness(length)
        about_y, about_z = rotated(bend, maps["about_y"]), rotated(bend, maps["about_z"])
        mass = rotated(hermite_mass(length), maps["about_y"]) + rotated(hermite_mass(length), maps["about_z"])
        mass = mass + rotated(rod_mass(length), maps["along"])
        polar = rotated(rod_mass(length), maps["twist"])
        return (
            Term("mass", "mass", "kg/m", self.mass, codes, mass),
            Term("polar_inertia", "rotary_inertia", "kg m", self.polar_inertia, codes, polar),
            Term("bending_stiffness_y", "stiffness", "N m^2", self.bending_stiffness_y, codes, about_y),
            Term("bending_stiffness_z", "stiffness", "N m^2", self.bending_stiffness_z, codes, about_z),
            Term("axial_stiffness", "stiffness", "N", self.axial_stiffness, codes, rotated(rod, maps["along"])),
            Term(
                "torsional_stiffness",
                "stiffness",
                "N m^2",
                self.torsional_stiffness,
                codes,
                rotated(rod, maps["twist"]),
            ),
            Term("loss_factor", "loss_factor", "1", self.loss_factor),
            Term("mass_damping", "viscous_damping", "N s/m^2", self.mass_damping, codes, mass),
        )

    def _axes(self, x: FloatArray) -> FloatArray:
        """Local axes as rows, (n_elements, 3, 3)."""
        if self.orientation is not None:
            guide = np.broadcast_to(self.orientation, x.shape)
        else:
            guide = np.where(np.abs(x[:, [1]]) > 0.99, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        y = guide - (guide * x).sum(axis=1, keepdims=True) * x
        size = np.linalg.norm(y, axis=1, keepdims=True)
        if (size < 1e-8 * np.linalg.norm(guide, axis=1, keepdims=True)).any():
            raise InputError(f"`orientation` of {self.name!r} must not run along the beam, got {guide[0].tolist()}")
        y = y / size
        return np.stack([x, y, np.cross(x, y)], axis=1)


def _space_maps(axes: FloatArray) -> dict[str, FloatArray]:
    """Maps from the twelve global coordinates of each element to its axial, twist and bending coordinates."""
    n = len(axes)
    maps: dict[str, FloatArray] = {
        key: np.zeros((n, size, 12)) for key, size in (("along", 2), ("twist", 2), ("about_y", 4), ("about_z", 4))
    }
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    for end in (0, 1):
        shift, turn = slice(6 * end, 6 * end + 3), slice(6 * end + 3, 6 * end + 6)
        maps["along"][:, end, shift] = x
        maps["twist"][:, end, turn] = x
        maps["about_z"][:, 2 * end, shift] = y
        maps["about_z"][:, 2 * end + 1, turn] = z
        maps["about_y"][:, 2 * end, shift] = z
        maps["about_y"][:, 2 * end + 1, turn] = -y
    return maps
