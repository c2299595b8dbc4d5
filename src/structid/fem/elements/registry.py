"""Registry of the element types."""

from structid.fem.elements.element import ElementSet
from structid.lazy import LoadedByKey

#: Every element type by the name that a study file uses; its module loads at its first use.
ELEMENT_TYPES: LoadedByKey[type[ElementSet]] = LoadedByKey(
    {
        "bar": "structid.fem.elements.beam:Bar",
        "beam": "structid.fem.elements.beam:Beam",
        "dashpot": "structid.fem.elements.connector:Dashpot",
        "friction": "structid.fem.elements.connector:Friction",
        "joint": "structid.fem.elements.connector:Joint",
        "membrane": "structid.fem.elements.membrane:Membrane",
        "plane": "structid.fem.elements.elastic:Plane",
        "plate": "structid.fem.elements.plate:Plate",
        "point_mass": "structid.fem.elements.inertia:PointMass",
        "rotary_inertia": "structid.fem.elements.inertia:RotaryInertia",
        "shell": "structid.fem.elements.shell:Shell",
        "solid": "structid.fem.elements.elastic:Solid",
        "space_beam": "structid.fem.elements.space_beam:SpaceBeam",
        "spring": "structid.fem.elements.connector:Spring",
    }
)
