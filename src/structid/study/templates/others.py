"""Templates of plates, and of matrices of another code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from structid.study.templates.template import NO_RECORD, Template, asked, node_lines, number, unknown

_EDGES = ("one", "all", "none")


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
        nx, ny = self.elements_along, self.elements_across
        label = {(i, j): 1 + i * (ny + 1) + j for i in range(nx + 1) for j in range(ny + 1)}
        places = {n: [self.length * i / nx, self.width * j / ny] for (i, j), n in label.items()}
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
{node_lines(places)}

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
