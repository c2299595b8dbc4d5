"""Templates of structures of beams, of storeys, of plates, and of matrices of another code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from structid.core.display import plural
from structid.study.templates.template import NO_RECORD, Template, asked, node_lines, number, unknown

_SUPPORTS = {
    "clamped": ("clamped at its left end", ('"1Y"', '"1RZ"')),
    "simple": ("on supports at both ends", ()),
    "free": ("free", ()),
}
_EDGES = ("one", "all", "none")
#: Length over radius of gyration of a member whose section is not asked for.
_SLENDERNESS = 80.0


def _pairs(first: int, count: int) -> str:
    return ", ".join(f"[{k}, {k + 1}]" for k in range(first, first + count))


def _beams(name: str, nodes: str, mass: float, bending: float, loss_factor: float, length: float | None = None) -> str:
    """Text of the ``[[structure.beam]]`` table of the set `name`; with a `length` in m it has an axial stiffness too.

    `nodes` is the text of the pairs of nodes, `mass` in kg/m, `bending` the stiffness in N m^2, `loss_factor` that of the
    stiffness.
    """
    axial = ""
    if length is not None:
        stiffness = float(f"{bending * (_SLENDERNESS / length) ** 2:.3g}")
        axial = f"axial_stiffness = {number(stiffness)}  # N, E A of a section of slenderness {_SLENDERNESS:g}; write its own\n"
    return f"""
[[structure.beam]]
name = "{name}"
nodes = [{nodes}]
mass = {number(mass)}  # kg/m
bending_stiffness = {number(bending)}  # N m^2
{axial}loss_factor = {loss_factor}
"""


@dataclass(frozen=True)
class BeamTemplate(Template):
    """A straight beam along X that bends in Y."""

    words: ClassVar[str] = "A straight beam that bends: clamped at one end, on two supports, or free"
    length: float = asked("length", "m", 0.6)
    elements: int = asked("elements along it", "", 12)
    mass: float = asked("mass", "kg/m", 0.81)
    bending_stiffness: float = asked("bending stiffness E I", "N m^2", 25.0)
    support: str = asked("clamped, simple or free", "", "clamped", tuple(_SUPPORTS))

    def text(self, folder: Path) -> str:
        """The text of the study file (TOML) of a beam along x; `folder` is not used."""
        words, held = _SUPPORTS[self.support]
        last = self.elements + 1
        held = ('"1Y"', f'"{last}Y"') if self.support == "simple" else held
        fixed = f"fixed = [{', '.join(held)}]  # {words}\n" if held else ""
        positions = {k + 1: [self.length * k / self.elements] for k in range(last)}
        beam = _beams("beam", _pairs(1, self.elements), self.mass, self.bending_stiffness, 0.01)
        unknowns = unknown("bending_stiffness", "beam") + unknown("loss_factor", "beam")
        return f"""title = "Beam {words}"

[structure]
{fixed}
[structure.nodes]  # m
{node_lines(positions)}
{beam}{unknowns}{NO_RECORD}"""


@dataclass(frozen=True)
class BridgeTemplate(Template):
    """A girder over several spans, one bending stiffness a span."""

    words: ClassVar[str] = "A girder over several spans on rigid piers, one bending stiffness a span"
    spans: int = asked("spans", "", 3)
    length: float = asked("length of a span", "m", 30.0)
    elements: int = asked("elements a span", "", 8)
    mass: float = asked("mass", "kg/m", 12000.0)
    bending_stiffness: float = asked("bending stiffness E I", "N m^2", 4.0e10)

    def text(self, folder: Path) -> str:
        """The text of the study file (TOML) of a bridge, with an element set for each span; `folder` is not used."""
        total = self.spans * self.elements
        positions = {k + 1: [self.length * k / self.elements] for k in range(total + 1)}
        piers = ", ".join(f'"{1 + k * self.elements}Y"' for k in range(self.spans + 1))
        sets = "".join(
            _beams(
                f"span {k + 1}", _pairs(1 + k * self.elements, self.elements), self.mass, self.bending_stiffness, 0.02
            )
            for k in range(self.spans)
        )
        unknowns = "".join(unknown("bending_stiffness", f"span {k + 1}") for k in range(self.spans))
        return f"""title = "Bridge of {plural(self.spans, "span")}"

[structure]
fixed = [{piers}]  # abutments and piers

[structure.nodes]  # m
{node_lines(positions)}
{sets}{unknowns}{NO_RECORD}"""


@dataclass(frozen=True)
class FrameTemplate(Template):
    """A plane frame of one bay, columns and girders stiff against stretch."""

    words: ClassVar[str] = "A plane frame of one bay: columns clamped at their feet, a girder on every floor"
    storeys: int = asked("storeys", "", 3)
    height: float = asked("height of a storey", "m", 3.0)
    width: float = asked("width of the bay", "m", 6.0)
    column_mass: float = asked("mass of a column", "kg/m", 60.0)
    column_bending_stiffness: float = asked("bending stiffness of a column", "N m^2", 1.2e7)
    girder_mass: float = asked("mass of a girder with its floor", "kg/m", 900.0)
    girder_bending_stiffness: float = asked("bending stiffness of a girder", "N m^2", 4.0e7)

    def text(self, folder: Path) -> str:
        """The text of the study file (TOML) of a plane frame of one bay; `folder` is not used."""
        floors = range(self.storeys + 1)
        positions = {10 * f + 1: [0.0, f * self.height] for f in floors}
        positions |= {10 * f + 2: [self.width, f * self.height] for f in floors}
        positions |= {10 * f + 3: [0.5 * self.width, f * self.height] for f in floors if f}
        positions = dict(sorted(positions.items()))
        columns = "".join(
            _beams(
                f"columns {f}",
                f"[{10 * f - 9}, {10 * f + 1}], [{10 * f - 8}, {10 * f + 2}]",
                self.column_mass,
                self.column_bending_stiffness,
                0.02,
                self.height,
            )
            for f in floors
            if f
        )
        girders = ", ".join(f"[{10 * f + 1}, {10 * f + 3}], [{10 * f + 3}, {10 * f + 2}]" for f in floors if f)
        unknowns = "".join(unknown("bending_stiffness", f"columns {f}") for f in floors if f)
        floor = _beams("girders", girders, self.girder_mass, self.girder_bending_stiffness, 0.02, self.width)
        unknowns += unknown("bending_stiffness", "girders")
        return f"""title = "Frame of {plural(self.storeys, "storey")}"

[structure]
active = ["X", "Y", "RZ"]
fixed = ["1", "2"]  # feet of the columns
subdivide = 4  # "auto", once there is a record, cuts until the mesh moves no value

[structure.nodes]  # m; floor f has the nodes f1 (left), f2 (right) and f3 (middle)
{node_lines(positions)}
{columns}{floor}{unknowns}{NO_RECORD}"""


@dataclass(frozen=True)
class ShearBuildingTemplate(Template):
    """Floors that sway along X, a spring a storey."""

    words: ClassVar[str] = "Rigid floors that sway along X, a spring a storey"
    storeys: int = asked("storeys", "", 4)
    height: float = asked("height of a storey", "m", 3.0)
    mass: float = asked("mass of a floor", "kg", 5000.0)
    stiffness: float = asked("stiffness of a storey", "N/m", 1.6e6)

    def text(self, folder: Path) -> str:
        """The text of the study file (TOML) of a shear building, a chain of masses and springs; `folder` is not used."""
        positions = {k: [0.0, 0.0, k * self.height] for k in range(self.storeys + 1)}
        floors = ", ".join(str(k) for k in range(1, self.storeys + 1))
        lower = ", ".join(f'"{k}X"' for k in range(self.storeys))
        upper = ", ".join(f'"{k}X"' for k in range(1, self.storeys + 1))
        return f"""title = "Shear building of {plural(self.storeys, "storey")}"

[structure]
active = ["X"]
fixed = ["0X"]  # the ground

[structure.nodes]  # m
{node_lines(positions)}

[[structure.point_mass]]
name = "floor"
nodes = [{floors}]
mass = {number(self.mass)}  # kg, each

[[structure.spring]]
name = "storey"
first = [{lower}]
second = [{upper}]
stiffness = {number(self.stiffness)}  # N/m, each
loss_factor = 0.02
{unknown("stiffness", "storey", each=True)}{NO_RECORD}"""


@dataclass(frozen=True)
class PlateTemplate(Template):
    """A rectangular plate in the x-y plane that bends."""

    words: ClassVar[str] = "A flat rectangular plate that bends: one edge clamped, all edges, or none"
    length: float = asked("length along X", "m", 0.4)
    width: float = asked("width along Y", "m", 0.3)
    thickness: float = asked("thickness", "m", 0.003)
    elements_along: int = asked("elements along X", "", 8)
    elements_across: int = asked("elements along Y", "", 6)
    youngs_modulus: float = asked("Young's modulus", "Pa", 7.0e10)
    density: float = asked("density", "kg/m^3", 2700.0)
    clamped: str = asked("clamped edges: one (X = 0), all or none", "", "one", _EDGES)

    def text(self, folder: Path) -> str:
        """The text of the study file (TOML) of a rectangular plate in bending; `folder` is not used."""
        nx, ny = self.elements_along, self.elements_across
        label = {(i, j): 1 + i * (ny + 1) + j for i in range(nx + 1) for j in range(ny + 1)}
        positions = {n: [self.length * i / nx, self.width * j / ny] for (i, j), n in label.items()}
        cells = ",\n  ".join(
            ", ".join(
                f"[{label[i, j]}, {label[i + 1, j]}, {label[i + 1, j + 1]}, {label[i, j + 1]}]" for j in range(ny)
            )
            for i in range(nx)
        )
        edge = {
            "one": [label[0, j] for j in range(ny + 1)],
            "all": [n for (i, j), n in label.items() if i in (0, nx) or j in (0, ny)],
            "none": [],
        }[self.clamped]
        fixed = ", ".join(f'"{n} Z RX RY"' for n in edge)
        held = f"fixed = [{fixed}]\n" if edge else ""
        return f"""title = "Plate"

[structure]
active = ["Z", "RX", "RY"]
{held}
[structure.nodes]  # m
{node_lines(positions)}

[[structure.plate]]
name = "plate"
nodes = [
  {cells},
]
youngs_modulus = {number(self.youngs_modulus)}  # Pa
density = {number(self.density)}  # kg/m^3
thickness = {number(self.thickness)}  # m
poisson = 0.33
loss_factor = 0.01
{unknown("youngs_modulus", "plate")}{unknown("loss_factor", "plate")}
[method]
total_mass_direction = "Z"
{NO_RECORD}"""


@dataclass(frozen=True)
class OwnMatricesTemplate(Template):
    """Mass and stiffness matrices of another program, each scaled by a factor."""

    words: ClassVar[str] = "Mass and stiffness matrices of another program, each scaled by a factor"
    mass: str = asked("file of the mass matrix", "", "M.npz")
    stiffness: str = asked("file of the stiffness matrix", "", "K.npz")
    dofs: str = asked("file that says what the rows stand for", "", "dofs.txt")

    def text(self, folder: Path) -> str:
        return f"""title = "Matrices of another program"

[structure.matrices]
dofs = "{self.dofs}"  # node and direction of every row, as in 12Z; see docs/import-models.md

[[structure.matrix_group]]
name = "model"
mass = "{self.mass}"
stiffness = "{self.stiffness}"
loss_factor = 0.01
{unknown("mass", "model")}{unknown("stiffness", "model")}{unknown("loss_factor", "model")}{NO_RECORD}"""
