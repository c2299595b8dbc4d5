"""Registry of the element types."""

from structid.fem.elements.element import ElementSet
from structid.lazy import LoadedByKey

#: Every element type by the name that a study file uses; its module loads at its first use.
ELEMENT_TYPES: LoadedByKey[type[ElementSet]] = LoadedByKey(
    {
        "bar": "structid.fem.elements.bar:Bar",
        "beam": "structid.fem.elements.beam:Beam",
        "dashpot": "structid.fem.elements.connector:Dashpot",
        "friction": "structid.fem.elements.friction:Friction",
        "joint": "structid.fem.elements.joint:Joint",
        "membrane": "structid.fem.elements.membrane:Membrane",
        "plane": "structid.fem.elements.plane:Plane",
        "plate": "structid.fem.elements.plate:Plate",
        "point_mass": "structid.fem.elements.inertia:PointMass",
        "rotary_inertia": "structid.fem.elements.inertia:RotaryInertia",
        "shell": "structid.fem.elements.shell:Shell",
        "solid": "structid.fem.elements.solid:Solid",
        "space_beam": "structid.fem.elements.space_beam:SpaceBeam",
        "spring": "structid.fem.elements.connector:Spring",
    }
)
