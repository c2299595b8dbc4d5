"""What a structure is: nodes, elements, supports; it gives element matrices, never data."""

from structid.structure.component import Component
from structid.structure.elements import (
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
from structid.structure.matrices.blocks import Blocks, ElementMatrices, MatrixBlocks
from structid.structure.matrices.contribution import Contribution, Property
from structid.structure.measured import MeasuredComponent
from structid.structure.structure import Structure, from_matrices
from structid.structure.supports import Base, Constraint, RigidLink

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
