"""The template of a study on a mesh from a file: its groups become element sets; what holds it is to be filled in."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from structid.core.errors import InputError
from structid.core.units import LENGTHS
from structid.fem.meshes import Mesh, read_mesh
from structid.fem.meshes.mesh import CELL_DIMENSIONS, orphan_nodes
from structid.study.templates.template import NO_RECORD, Template, asked, number, unknown

_FLAT = 1e-9
#: Directions that a support holds, by the table of the elements.
_HELD = {"plate": ["Z", "RX", "RY"], "shell": ["X", "Y", "Z", "RX", "RY", "RZ"], "solid": ["X", "Y", "Z"]}
_FREE = "none"


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
        """The text of the study file; the mesh is read from `folder` to find its sets and supports.

        `InputError` if the mesh has no cells of two or three dimensions.
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
        own = f"group = {json.dumps(group, ensure_ascii=False)}\n" if group else ""
        thickness = "" if table == "solid" else f"thickness = {number(self.thickness)}  # m\n"
        return f"""
[[structure.{table}]]
name = {json.dumps(name, ensure_ascii=False)}
{own}youngs_modulus = {number(self.youngs_modulus)}  # Pa
density = {number(self.density)}  # kg/m^3
{thickness}poisson = 0.33
loss_factor = 0.01
"""

    def _support_text(self, mesh: Mesh, table: str) -> str:
        """Text of a ``[[structure.support]]`` table for the fixed group; as a comment if no group is fixed.

        `table` is the element type ("solid", "plate" or "shell"), which decides the fixed directions.
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
