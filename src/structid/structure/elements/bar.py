"""Bars: straight members that carry axial force only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.structure.elements.beam import rod_mass, rod_stiffness
from structid.structure.elements.element import (
    TRANSLATIONS,
    Positions,
    Term,
    element_vectors,
    node_codes,
    rotated,
    store_element_set,
)


@dataclass(frozen=True, eq=False)
class Bar:
    """Bars between nodes on a line (X), in a plane (X, Y) or in space (X, Y, Z).

    Parameters
    ----------
    name : str
        Name of the set.
    nodes : (n_elements, 2) int array
        Node labels of the two ends.
    mass : float or (n_elements,)
        Mass per length, kg/m.
    axial_stiffness : float or (n_elements,)
        EA, N.
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    mass_damping : float or (n_elements,)
        Viscous damping in proportion to velocity, N s/m^2.
    stiffness_damping : float or (n_elements,)
        Strain-rate damping, N s.
    """

    name: str
    nodes: IntArray
    mass: FloatArray
    axial_stiffness: FloatArray
    loss_factor: FloatArray
    mass_damping: FloatArray
    stiffness_damping: FloatArray

    def __init__(
        self,
        name: str,
        nodes: ArrayLike,
        mass: ArrayLike,
        axial_stiffness: ArrayLike,
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
            axial_stiffness=axial_stiffness,
            loss_factor=loss_factor,
            mass_damping=mass_damping,
            stiffness_damping=stiffness_damping,
        )

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        length, direction = element_vectors(self.name, self.nodes, positions)
        dimensions = direction.shape[1]
        codes = node_codes(self.nodes, TRANSLATIONS[:dimensions])
        along = np.zeros((len(length), 2, 2 * dimensions))
        along[:, 0, :dimensions] = along[:, 1, dimensions:] = direction
        stiffness = rotated(rod_stiffness(length), along)
        mass = np.einsum("nij,kl->nikjl", rod_mass(length), np.eye(dimensions)).reshape(stiffness.shape)
        return (
            Term("mass", "mass", "kg/m", self.mass, codes, mass),
            Term("axial_stiffness", "stiffness", "N", self.axial_stiffness, codes, stiffness),
            Term("loss_factor", "loss_factor", "1", self.loss_factor),
            Term("mass_damping", "viscous_damping", "N s/m^2", self.mass_damping, codes, mass),
            Term("stiffness_damping", "viscous_damping", "N s", self.stiffness_damping, codes, stiffness),
        )
