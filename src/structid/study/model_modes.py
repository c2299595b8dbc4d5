"""Modes of a structure with given property values."""

from __future__ import annotations

from structid.arrays import FloatArray
from structid.dynamics import Modes, modes
from structid.structure import Structure


def structure_modes(structure: Structure, values: FloatArray, n_modes: int) -> Modes:
    """The lowest modes of `structure` with the property values `values`; friction is left out."""
    mass, stiffness, damping, structural = (
        structure.matrix(law, values) for law in ("inertia", "elastic", "viscous", "structural")
    )
    return modes(mass, stiffness, damping, structural, n_modes)
