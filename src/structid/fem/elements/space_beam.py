"""Beams in space: two bending planes with or without shear, extension and torsion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, IntArray, locked, require_shape
from structid.core.dof import DIRECTIONS
from structid.core.errors import InputError
from structid.fem.elements.beam import (
    AXIAL_FORCE,
    ROTARY_INERTIA,
    SHEAR,
    BendingPlane,
    add_local_matrix,
    rod_mass,
    rod_stiffness,
)
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_VELOCITY,
    ElementMatrixTerm,
    ElementSet,
    Matrices,
    NodeCoordinates,
    Nodes,
    OptionalSignedValues,
    OptionalValues,
    Values,
    Vector,
    declared,
    element,
    element_vectors,
    node_codes,
    node_table,
    rotate_matrices,
)


def _checked_direction(name: str, orientation: ArrayLike) -> FloatArray:
    """The `orientation` of a set as a locked vector (3,); `InputError` unless it is finite and not zero.

    `name` is that of the set, for the message.
    """
    vector = locked(orientation, np.float64)
    require_shape("orientation", vector, (3,))
    if not (np.isfinite(vector).all() and vector.any()):
        raise InputError(f"`orientation` of {name!r} must be a direction, got {vector.tolist()}")
    return vector


@element
class SpaceBeam(ElementSet):
    """Straight beams between nodes in space, six degrees of freedom a node.

    The local x axis runs from the first node to the second, local y is the part of `orientation` across it.
    """

    moves = DIRECTIONS
    is_line = True
    symbol = "line"
    section_stiffness: ClassVar = {
        "N": "axial_stiffness",
        "T": "torsional_stiffness",
        "MY": "bending_stiffness_y",
        "MZ": "bending_stiffness_z",
    }

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    bending_stiffness_y: Values = declared("EI about local y (deflection along local z)", "stiffness", "N m^2")
    bending_stiffness_z: Values = declared("EI about local z (deflection along local y)", "stiffness", "N m^2")
    axial_stiffness: Values = declared("EA", "stiffness", "N", default=0.0)
    torsional_stiffness: Values = declared("GJ", "stiffness", "N m^2", default=0.0)
    polar_inertia: Values = declared("Polar mass moment per length", "rotary_inertia", "kg m", default=0.0)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^2", "mass", default=0.0)
    orientation: Vector = declared(
        "In the local x-y plane; by default global Y, or global X for beams along Y",
        stored=_checked_direction,
        default=None,
    )
    shear_stiffness_y: OptionalValues = declared(
        f"{SHEAR} along local y, with EI about z", "stiffness", "N", positive=True, unlimited=True, default=None
    )
    shear_stiffness_z: OptionalValues = declared(
        f"{SHEAR} along local z, with EI about y", "stiffness", "N", positive=True, unlimited=True, default=None
    )

    rotary_inertia_y: OptionalValues = declared(
        f"{ROTARY_INERTIA}, about local y", "rotary_inertia", "kg m", optional=True, default=None
    )
    rotary_inertia_z: OptionalValues = declared(
        f"{ROTARY_INERTIA}, about local z", "rotary_inertia", "kg m", optional=True, default=None
    )

    axial_force: OptionalSignedValues = declared(AXIAL_FORCE, "axial_force", "N", optional=True, default=None)

    def section_directions(self, positions: NodeCoordinates) -> Mapping[str, FloatArray]:
        """Unit vectors of the internal forces N, VY, VZ, T, MY and MZ on the motions X Y Z RX RY RZ of a node.

        They are (n_elements, 6) by the name of the force: normal and shear forces, torque and moments in the local axes
        of the beam. `positions` of nodes in m.
        """
        axes = _local_axes(self.name, element_vectors(self.name, self.nodes, positions)[1], self.orientation)
        wide = np.zeros((len(axes), 6, 6))
        wide[:, :3, :3] = wide[:, 3:, 3:] = axes
        return {name: wide[:, row] for row, name in enumerate(("N", "VY", "VZ", "T", "MY", "MZ"))}

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Matrices of all beams for a unit value of each property, as terms by the property's name.

        They act on the six motions of both nodes. The names are mass, axial, torsional and bending stiffness, polar
        inertia, and where stated shear stiffness (no terms: it acts by the shear ratio), rotary inertia and axial
        force. `positions` maps nodes to X, Y, Z in m, else `InputError`; `used_codes` are not needed.
        """
        length, direction = element_vectors(self.name, self.nodes, positions)
        if direction.shape[1] != 3:
            raise InputError(f"beams of {self.name!r} need 3-D nodes; use the element type `beam`")
        codes = node_codes(self.nodes, DIRECTIONS)
        maps = _space_maps(_local_axes(self.name, direction, self.orientation))
        rod = rod_stiffness(length)
        by_property = {
            "polar_inertia": rotate_matrices(rod_mass(length), maps["twist"]),
            "axial_stiffness": rotate_matrices(rod, maps["along"]),
            "torsional_stiffness": rotate_matrices(rod, maps["twist"]),
        }
        about_y = ("bending_stiffness_y", self.bending_stiffness_y), ("shear_stiffness_z", self.shear_stiffness_z)
        about_z = ("bending_stiffness_z", self.bending_stiffness_z), ("shear_stiffness_y", self.shear_stiffness_y)
        rotary = {"about_y": self.rotary_inertia_y, "about_z": self.rotary_inertia_z}
        matrix_terms: dict[str, tuple[ElementMatrixTerm, ...]] = {
            name: (ElementMatrixTerm(codes, local),) for name, local in by_property.items()
        }
        matrix_terms["mass"] = (ElementMatrixTerm(codes, rotate_matrices(rod_mass(length), maps["along"])),)
        for name, (bending, shear) in (("about_y", about_y), ("about_z", about_z)):
            plane = BendingPlane(codes, maps[name], length, bending, shear)
            matrix_terms[bending[0]] = plane.stiffness
            matrix_terms["mass"] = (*add_local_matrix(matrix_terms["mass"], plane.mass[0].local), *plane.mass[1:])
            if shear[1] is not None:
                matrix_terms[shear[0]] = ()
            if rotary[name] is not None:
                matrix_terms[f"rotary_inertia_{name[-1]}"] = plane.rotary_inertia
            if self.axial_force is not None:
                matrix_terms["axial_force"] = (*matrix_terms.get("axial_force", ()), *plane.axial_force)
        return matrix_terms


def _local_axes(name: str, x: FloatArray, orientation: FloatArray | None) -> FloatArray:
    """Local axes x, y, z as rows, (n_elements, 3, 3), from unit vectors `x` (n_elements, 3) along the beams.

    Local y is the part of `orientation` (3,) across the beam; by default (None) of global Y, or of global X for beams
    with a Y part above 0.99. Raises `InputError`, which names the set, if `orientation` runs along a beam.
    """
    if orientation is not None:
        guide = np.broadcast_to(orientation, x.shape)
    else:
        guide = np.where(np.abs(x[:, [1]]) > 0.99, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    y = guide - (guide * x).sum(axis=1, keepdims=True) * x
    size = np.linalg.norm(y, axis=1, keepdims=True)
    if (size < 1e-8 * np.linalg.norm(guide, axis=1, keepdims=True)).any():
        raise InputError(f"`orientation` of {name!r} must not run along the beam, got {guide[0].tolist()}")
    y = y / size
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _space_maps(axes: FloatArray) -> dict[str, FloatArray]:
    """Maps (n_elements, 2 or 4, 12) from the twelve global coordinates of a beam to its local ones, by name.

    ``along`` and ``twist`` give axial motion and rotation at both ends; ``about_y`` and ``about_z`` give w1 theta1 w2
    theta2 of each bending plane. `axes` (n_elements, 3, 3) are the local axes as rows.
    """
    n = len(axes)
    maps: dict[str, FloatArray] = {
        key: np.zeros((n, size, 12)) for key, size in (("along", 2), ("twist", 2), ("about_y", 4), ("about_z", 4))
    }
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    for end in (0, 1):
        translations, rotations = slice(6 * end, 6 * end + 3), slice(6 * end + 3, 6 * end + 6)
        maps["along"][:, end, translations] = x
        maps["twist"][:, end, rotations] = x
        maps["about_z"][:, 2 * end, translations] = y
        maps["about_z"][:, 2 * end + 1, rotations] = z
        maps["about_y"][:, 2 * end, translations] = z
        maps["about_y"][:, 2 * end + 1, rotations] = -y
    return maps
