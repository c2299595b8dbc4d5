"""Element types, one a file: each declares its properties, and gives the matrices that they weigh.

A new type is a module here and a line in `ELEMENT_TYPES`.
"""

from structid.structure.elements.bar import Bar
from structid.structure.elements.beam import Beam
from structid.structure.elements.connector import Dashpot, Spring
from structid.structure.elements.element import ElementSet, Kind, Term
from structid.structure.elements.friction import Friction
from structid.structure.elements.inertia import PointMass, RotaryInertia
from structid.structure.elements.joint import Joint
from structid.structure.elements.matrix_group import MatrixGroup
from structid.structure.elements.membrane import Membrane
from structid.structure.elements.plane import Plane
from structid.structure.elements.plate import Plate
from structid.structure.elements.shell import Shell
from structid.structure.elements.solid import Solid
from structid.structure.elements.space_beam import SpaceBeam

#: Every element type by the name that a study file uses.
ELEMENT_TYPES: dict[str, type[ElementSet]] = {
    "bar": Bar,
    "beam": Beam,
    "dashpot": Dashpot,
    "friction": Friction,
    "joint": Joint,
    "membrane": Membrane,
    "plane": Plane,
    "plate": Plate,
    "point_mass": PointMass,
    "rotary_inertia": RotaryInertia,
    "shell": Shell,
    "solid": Solid,
    "space_beam": SpaceBeam,
    "spring": Spring,
}

__all__ = [
    "ELEMENT_TYPES",
    "Bar",
    "Beam",
    "Dashpot",
    "ElementSet",
    "Friction",
    "Joint",
    "Kind",
    "MatrixGroup",
    "Membrane",
    "Plane",
    "Plate",
    "PointMass",
    "RotaryInertia",
    "Shell",
    "Solid",
    "SpaceBeam",
    "Spring",
    "Term",
]
