"""Bars: straight members that carry axial force only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.fem.elements.beam import rod_mass, rod_stiffness
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    TRANSLATIONS,
    ElementMatrixTerm,
    ElementSet,
    Matrices,
    NodeCoordinates,
    Nodes,
    OptionalSignedValues,
    Values,
    declared,
    element,
    element_vectors,
    node_codes,
    node_table,
    rotate_matrices,
)


@element
class Bar(ElementSet):
    """Bars between nodes on a line (X), in a plane (X, Y) or in space (X, Y, Z)."""

    is_line = True
    symbol = "line"
    section_stiffness: ClassVar = {"N": "axial_stiffness"}

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    axial_stiffness: Values = declared("EA", "stiffness", "N")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^2", "mass", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "N s", "axial_stiffness", default=0.0)

    axial_force: OptionalSignedValues = declared(
        "Static axial force, tension positive; it stiffens the bar sideways, as a string",
        "axial_force",
        "N",
        optional=True,
        default=None,
    )

    def section_directions(self, positions: NodeCoordinates) -> Mapping[str, FloatArray]:
        """Axial force N; see `ElementSet.section_directions`."""
        return {"N": element_vectors(self.name, self.nodes, positions)[1]}

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices of mass, axial stiffness and, if it is stated, axial force, by property.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not
        needed. Raises `InputError` for an axial force of bars on a line.
        """
        length, direction = element_vectors(self.name, self.nodes, positions)
        dimensions = direction.shape[1]
        codes = node_codes(self.nodes, TRANSLATIONS[:dimensions])
        along = np.zeros((len(length), 2, 2 * dimensions))
        along[:, 0, :dimensions] = along[:, 1, dimensions:] = direction
        stiffness = rotate_matrices(rod_stiffness(length), along)
        mass = np.einsum("nij,kl->nikjl", rod_mass(length), np.eye(dimensions)).reshape(stiffness.shape)
        terms = {"mass": (ElementMatrixTerm(codes, mass),), "axial_stiffness": (ElementMatrixTerm(codes, stiffness),)}
        if self.axial_force is not None:
            if dimensions == 1:
                raise InputError(
                    f"`axial_force` of {self.name!r} needs nodes in a plane or in space, where bars move sideways; got a line"
                )
            sideways = np.eye(dimensions) - direction[:, :, None] * direction[:, None, :]
            string = np.einsum("nij,nkl->nikjl", rod_stiffness(length), sideways).reshape(stiffness.shape)
            terms["axial_force"] = (ElementMatrixTerm(codes, string),)
        return terms
