"""Templates of a study: a dataclass of the numbers that it asks for, and the study text that it makes of them."""

from __future__ import annotations

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np

from structid.core.display import plural
from structid.core.errors import FileError, InputError
from structid.core.units import LENGTHS
from structid.fem.meshes import Mesh, read_mesh
from structid.fem.meshes.mesh import CELL_DIMENSIONS, orphan_nodes
from structid.files import atomic_write, make_folder

T = TypeVar("T")

#: What stands at the end of every new study until a record is there.
NO_RECORD = """
# The record, once it is there (`structid app` writes this section, too):
# [record]
# path = "record.csv"
# outputs = ["2Y", "3Y"]  # nodes and directions of a table of FRFs whose columns have names of their own, in its order
# inputs = ["2Y"]
# averages = 10  # with the coherence in the file they say the noise
"""


_SUPPORTS = {
    "clamped": ("clamped at its left end", ('"1Y"', '"1RZ"')),
    "simple": ("on supports at both ends", ()),
    "free": ("free", ()),
}
_EDGES = ("one", "all", "none")
#: Length over radius of gyration of a member whose section is not asked for.
_SLENDERNESS = 80.0
_FLAT = 1e-9
#: Directions that a support holds, by the table of the elements.
_HELD = {"plate": ["Z", "RX", "RY"], "shell": ["X", "Y", "Z", "RX", "RY", "RZ"], "solid": ["X", "Y", "Z"]}
_FREE = "none"


class Template(ABC):
    """Template of a study for one kind of structure; a subclass is a frozen dataclass whose fields are its questions."""

    words: ClassVar[str] = ""

    @abstractmethod
    def text(self, folder: Path) -> str:
        """The study file, for `folder`, where the files are that it names."""


def asked(words: str, unit: str, default: T, choices: tuple[str, ...] = ()) -> T:
    """A field of a template: what it is, its unit, the value that stands where none is given, and all that it may be."""
    return field(default=default, metadata={"words": words, "unit": unit, "default": default, "choices": choices})


@dataclass(frozen=True)
class TemplateQuestion:
    """One number or text that a template asks for."""

    name: str
    words: str
    unit: str
    default: float | int | str
    choices: tuple[str, ...]


def asked_of(template: type[Template]) -> tuple[TemplateQuestion, ...]:
    """Questions that `template` asks, one for each of its fields that has a text, in order."""
    asked = (one for one in fields(template) if "words" in one.metadata)  # type: ignore[arg-type]
    return tuple(TemplateQuestion(one.name, **one.metadata) for one in asked)


def template_with(template: type[Template], answers: Mapping[str, object]) -> Template:
    """A `template` filled with the values in `answers`, text or numbers by name, and defaults for the others.

    Raises
    ------
    InputError
        If a name is unknown, or a value is not of the kind or in the limits that its question states.
    """
    questions = {question.name: question for question in asked_of(template)}
    values: dict[str, float | int | str] = {}
    for name, value in answers.items():
        if name not in questions:
            listed = ", ".join(
                f"{question.name} ({question.words}, {question.unit or 'no unit'})" for question in questions.values()
            )
            raise InputError(f"there is no {name!r} to give; this template asks for {listed}")
        values[name] = asked_value(questions[name], str(value))
    return template(**values)


def asked_value(question: TemplateQuestion, answer: str) -> float | int | str:
    """The text `answer` as a float, an int or a text, whichever the default of the question is.

    Raises
    ------
    InputError
        If it is none of the choices; no number greater than 0 (float); no whole number from 1 to 2000 (int); or
        empty or with quotes, backslashes or unprintable characters (text).
    """
    text = answer.strip()
    if question.choices and text not in question.choices:
        raise InputError(f"{question.name} must be one of {', '.join(question.choices)}, got {text!r}")
    if isinstance(question.default, str):
        if not text or any(not letter.isprintable() or letter in '"\\' for letter in text):
            raise InputError(f"{question.name} must be a text without quotes, as in {question.default}, got {text!r}")
        return text
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"{question.name} must be a number, as in {question.default}, got {text!r}") from None
    if isinstance(question.default, int):
        if not (number.is_integer() and 1 <= number <= 2000):
            raise InputError(f"{question.name} must be a whole number from 1 to 2000, got {text}")
        return int(number)
    if not 0 < number < float("inf"):
        raise InputError(f"{question.name} must be greater than 0 ({question.unit or 'no unit'}), got {text}")
    return number


def study_file(path: Path) -> Path:
    """`path` with the suffix by which studies are known."""
    return path if path.suffix.lower() == ".toml" else path.with_name(f"{path.name}.toml")


def write_study(template: Template, path: Path) -> Path:
    """Write the study of `template` to a new file, `path` with the suffix ``.toml``, and return the path of the file.

    Raises
    ------
    FileError
        If there is a file of that name already, it cannot be written, or a file that the template reads is damaged.
    """
    path = study_file(path)
    if path.exists():
        raise FileError(f"{path}: is there already; give another name, or remove it first")
    text = template.text(path.parent)
    make_folder(path.parent)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def node_lines(positions: Mapping[int, Sequence[float]]) -> str:
    """The lines of ``[structure.nodes]``."""
    return "\n".join(f"{label} = [{', '.join(number(x) for x in place)}]" for label, place in positions.items())


def number(value: float) -> str:
    """`value` as TOML has it, to nine digits."""
    text = f"{value:.9g}"
    return text if any(letter in text for letter in ".e") else f"{text}.0"


def unknown(property: str, elements: str, each: bool = False) -> str:
    """TOML text of an ``[[unknown]]`` table for a property of element sets; with `each` for every element alone."""
    return f'\n[[unknown]]\nproperty = "{property}"\nelements = {json.dumps(elements, ensure_ascii=False)}\n' + (
        "each = true\n" if each else ""
    )


def _pairs(first: int, count: int) -> str:
    return ", ".join(f"[{k}, {k + 1}]" for k in range(first, first + count))


def _beams(name: str, nodes: str, mass: float, bending: float, loss_factor: float, length: float | None = None) -> str:
    """Text of the ``[[structure.beam]]`` table of the set `name`; with a `length` in m it has an axial stiffness too.

    `nodes` is the text of the pairs of nodes, `mass` in kg/m, `bending` the stiffness in N m^2, `loss_factor` that of
    the stiffness. The axial stiffness (N) is that of a section of usual slenderness at this length.
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
        """The text of the study file (TOML) of a beam along x, whose bending stiffness and loss factor are unknown.

        `folder` is not used.
        """
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
        """The text of the study file (TOML) of a bridge, with a set and an unknown bending stiffness for each span.

        `folder` is not used.
        """
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
        """The text of the study file (TOML) of a plane frame of one bay, with columns for each storey and girders.

        The bending stiffness of each set of elements is unknown. `folder` is not used.
        """
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
subdivide = 4  # for a plan; without this line a record divides beams until the mesh moves no value

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
        """The text of the study file (TOML) of a shear building, a chain of masses and unknown springs.

        `folder` is not used.
        """
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
        """The text of the study file (TOML) of a rectangular plate in bending, clamped at one edge, at all or free.

        Young's modulus and loss factor are unknown. `folder` is not used.
        """
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


@dataclass(frozen=True)
class MeshTemplate(Template):
    """Plate, shells or solids on a mesh, an element set a group."""

    words: ClassVar[str] = "A mesh from a file: a flat one bends as a plate, others are shells or solids; a set a group"
    path: str = asked("file of the mesh", "", "mesh.msh")
    length_unit: str = asked("unit of its coordinates", "", "m", tuple(LENGTHS))
    held: str = asked("group that is held; none where it is free", "", _FREE)
    youngs_modulus: float = asked("Young's modulus", "Pa", 7.0e10)
    density: float = asked("density", "kg/m^3", 2700.0)
    thickness: float = asked("thickness, of plates and shells", "m", 0.003)

    def text(self, folder: Path) -> str:
        """The text of the study file (TOML) on a mesh, which is read from `folder` to find its sets and supports.

        Elements are solids, or plates if the mesh is flat, or shells. Young's modulus of each set and one loss factor
        are unknown. `InputError` if the mesh has no cells of two or three dimensions.
        """
        mesh = read_mesh(folder / self.path, self.length_unit)
        if mesh.dimension < 2:
            raise InputError(
                f"{self.path}: has no cells of two or three dimensions; declare its beams in the study file"
            )
        flat = bool(np.ptp(mesh.positions[:, 2]) <= _FLAT * np.ptp(mesh.positions, axis=0).max())
        table = "solid" if mesh.dimension == 3 else "plate" if flat else "shell"
        sets = _covering_groups(mesh)
        names = [_name(group) for group in sets]
        entries = "".join(self._entry(table, name, group) for name, group in zip(names, sets, strict=True))
        orphans = ', orphan_nodes = "drop"' if orphan_nodes(mesh).size else ""
        unknowns = "".join(unknown("youngs_modulus", name) for name in names) + _damping_text(names)
        direction = '\n[method]\ntotal_mass_direction = "Z"\n' if table == "plate" else ""
        return f"""title = {json.dumps(f"Mesh {Path(self.path).stem}", ensure_ascii=False)}

[structure]
mesh = {{ path = "{self.path}", length_unit = "{self.length_unit}"{orphans} }}
{self._support_text(mesh, table)}{entries}{unknowns}{direction}{NO_RECORD}"""

    def _entry(self, table: str, name: str, group: str) -> str:
        group_line = f"group = {json.dumps(group, ensure_ascii=False)}\n" if group else ""
        thickness = "" if table == "solid" else f"thickness = {number(self.thickness)}  # m\n"
        return f"""
[[structure.{table}]]
name = {json.dumps(name, ensure_ascii=False)}
{group_line}youngs_modulus = {number(self.youngs_modulus)}  # Pa
density = {number(self.density)}  # kg/m^3
{thickness}poisson = 0.33
loss_factor = 0.01
"""

    def _support_text(self, mesh: Mesh, table: str) -> str:
        """Text of a ``[[structure.support]]`` table for the fixed group; as a comment if no group is fixed.

        `table` is the element type ("solid", "plate" or "shell"), which decides the fixed directions. `InputError` if
        the mesh lacks the group.
        """
        others = [name for name in (*mesh.groups, *mesh.node_groups) if name not in _covering_groups(mesh)]
        if self.held != _FREE:
            mesh.group_nodes(self.held)  # it may not be there
        words = f"; groups of the mesh besides its sets: {', '.join(map(_name, others[:20]))}" if others else ""
        lines = [
            "[[structure.support]]",
            f"group = {json.dumps(self.held if self.held != _FREE else (others or ['clamp'])[0], ensure_ascii=False)}",
            f"directions = {json.dumps(_HELD[table])}",
        ]
        if self.held != _FREE:
            return "\n" + "\n".join(lines) + "\n"
        return "\n" + "\n".join([f"# Nothing holds it yet{words}", *(f"# {line}" for line in lines)]) + "\n"


def _covering_groups(mesh: Mesh) -> list[str]:
    """Groups that share the cells of the mesh's highest dimension without overlap, first groups first.

    [""], which stands for all cells, if groups leave cells out or there are none.
    """
    free = [np.ones(len(block.nodes), dtype=bool) for block in mesh.blocks]
    top = [CELL_DIMENSIONS.get(block.kind, 3) == mesh.dimension for block in mesh.blocks]
    chosen = []
    for group, rows in mesh.groups.items():
        parts = [(k, part) for k, part in enumerate(rows) if len(part)]
        if parts and all(top[k] and free[k][part].all() for k, part in parts):
            chosen.append(group)
            for k, part in parts:
                free[k][part] = False
    is_uncovered = any(is_top and part.any() for is_top, part in zip(top, free, strict=True))
    return [""] if is_uncovered or not chosen else chosen


def _name(group: str) -> str:
    """The name of a group as an element set may have it."""
    return re.sub(r"[^\w .+-]", "_", group) or "all"


def _damping_text(names: list[str]) -> str:
    """Text of an ``[[unknown]]`` table that declares one loss factor for all element sets `names`."""
    if len(names) == 1:
        return unknown("loss_factor", names[0])
    sets = json.dumps(names, ensure_ascii=False)
    return f'\n[[unknown]]\nproperty = "loss_factor"\nelements = {sets}\nname = "material"\n'


#: Every template by the name that `structid init` takes.
TEMPLATES: dict[str, type[Template]] = {
    "beam": BeamTemplate,
    "bridge": BridgeTemplate,
    "frame": FrameTemplate,
    "shear-building": ShearBuildingTemplate,
    "plate": PlateTemplate,
    "mesh": MeshTemplate,
    "own-matrices": OwnMatricesTemplate,
}
