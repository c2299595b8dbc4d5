"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.fem.elements.beam import Bar as Bar
from structid.fem.elements.beam import Beam as Beam
from structid.fem.elements.beam import SpaceBeam as SpaceBeam
from structid.fem.elements.discrete import Dashpot as Dashpot
from structid.fem.elements.discrete import Friction as Friction
from structid.fem.elements.discrete import Joint as Joint
from structid.fem.elements.discrete import PointMass as PointMass
from structid.fem.elements.discrete import RotaryInertia as RotaryInertia
from structid.fem.elements.discrete import Spring as Spring
from structid.fem.elements.elastic import Membrane as Membrane
from structid.fem.elements.elastic import Plane as Plane
from structid.fem.elements.elastic import Solid as Solid
from structid.fem.elements.element import ELEMENT_TYPES as ELEMENT_TYPES
from structid.fem.elements.element import ElementSet as ElementSet
from structid.fem.elements.element import Kind as Kind
from structid.fem.elements.element import PropertyMatrices as PropertyMatrices
from structid.fem.elements.matrix_group import MatrixGroup as MatrixGroup
from structid.fem.elements.plate import Plate as Plate
from structid.fem.elements.shell import Shell as Shell
