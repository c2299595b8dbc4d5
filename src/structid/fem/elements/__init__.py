"""Element types, one a file: each declares its properties, and gives the matrices that they weigh.

A new type is a module here and a line in `ELEMENT_TYPES`.
"""

from structid.fem.elements.bar import Bar
from structid.fem.elements.beam import Beam
from structid.fem.elements.connector import Dashpot, Spring
from structid.fem.elements.element import ElementSet, Kind, Term
from structid.fem.elements.friction import Friction
from structid.fem.elements.inertia import PointMass, RotaryInertia
from structid.fem.elements.joint import Joint
from structid.fem.elements.matrix_group import MatrixGroup
from structid.fem.elements.membrane import Membrane
from structid.fem.elements.plane import Plane
from structid.fem.elements.plate import Plate
from structid.fem.elements.shell import Shell
from structid.fem.elements.solid import Solid
from structid.fem.elements.space_beam import SpaceBeam

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
