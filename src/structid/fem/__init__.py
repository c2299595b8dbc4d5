"""Structures: nodes, elements and supports; they give element matrices, never data."""

from structid.fem.component import Component
from structid.fem.elements import (
    ELEMENT_TYPES,
    Bar,
    Beam,
    Dashpot,
    Friction,
    Joint,
    MatrixGroup,
    Membrane,
    Plane,
    Plate,
    PointMass,
    RotaryInertia,
    Shell,
    Solid,
    SpaceBeam,
    Spring,
)
from structid.fem.matrices.blocks import Blocks, ElementMatrices, MatrixBlocks
from structid.fem.matrices.contribution import Contribution, Property
from structid.fem.measured import MeasuredComponent
from structid.fem.structure import Structure, from_matrices
from structid.fem.supports import Base, Constraint, RigidLink

__all__ = [
    "ELEMENT_TYPES",
    "Bar",
    "Base",
    "Beam",
    "Blocks",
    "Component",
    "Constraint",
    "Contribution",
    "Dashpot",
    "ElementMatrices",
    "Friction",
    "Joint",
    "MatrixBlocks",
    "MatrixGroup",
    "MeasuredComponent",
    "Membrane",
    "Plane",
    "Plate",
    "PointMass",
    "Property",
    "RigidLink",
    "RotaryInertia",
    "Shell",
    "Solid",
    "SpaceBeam",
    "Spring",
    "Structure",
    "from_matrices",
]
