"""``[structure.mesh]``, ``[[structure.support]]`` and ``[structure.points]``: a structure on a mesh from a file."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from structid.arrays import IntArray
from structid.dof import DIRECTIONS, Dof
from structid.structure.elements import ElementSet
from structid.structure.mesh_point import MeshPoint, mesh_points
from structid.structure.meshes import LENGTH_UNITS, Mesh, read_mesh, require_sound, unassigned
from structid.study.schema.input_files import InputFiles
from structid.study.schema.section import NODES, NUMBER, POSITION, RANGE, TEXT, TEXTS, Kind, Section, as_list, choice

_AXES = ("x", "y", "z")
_PLACE = Kind("a number or two increasing ones in m, as in [0.0, 0.1]", lambda v: NUMBER.accepts(v) or RANGE.accepts(v))
_KEYS = {
    "path": TEXT,
    "length_unit": choice(*LENGTH_UNITS),
    "orphan_nodes": choice("refuse", "drop"),
    "duplicate_nodes": choice("refuse", "merge", "keep"),
    "leave_out": TEXTS,
}
#: Element types that take any direction at single nodes: their `group` names nodes, not cells.
_ONE_NODE = ("point_mass", "rotary_inertia")


def read_structure_mesh(section: Section, files: InputFiles) -> Mesh | None:
    """The mesh that `[structure]` names, checked; None where it names none."""
    given = section.table.get("mesh")
    if given is None:
        return None
    inner = (
        Section(section.source, section.path, {"path": given}) if isinstance(given, str) else section.section("mesh")
    )
    assert inner is not None
    keys = inner.values(_KEYS, ("path",))
    with inner.located("mesh" if isinstance(given, str) else "path"):
        mesh = read_mesh(files.path(keys["path"]), keys.get("length_unit", "m"))
    with inner.located("mesh" if isinstance(given, str) else None):
        return require_sound(mesh, keys.get("orphan_nodes") == "drop", keys.get("duplicate_nodes", "refuse"))


def group_table(entry: Section, kind: str, group: str | None, mesh: Mesh) -> IntArray:
    """Node table of an element set on `group` of the mesh."""
    with entry.located("group" if group is not None else None):
        if kind in _ONE_NODE and group is not None:
            return mesh.group_nodes(group)
        return mesh.cells(group)


def require_all_assigned(section: Section, mesh: Mesh, elements: list[ElementSet]) -> None:
    """Raise a `StudyError` where cells of the mesh belong to no element set and are not left out."""
    inner = section.section("mesh") if isinstance(section.table.get("mesh"), dict) else None
    left_out = as_list(inner.table.get("leave_out", [])) if inner is not None else []
    with (inner or section).located("leave_out" if left_out else "mesh" if inner is None else None):
        tables = [element.nodes for element in elements]
        tables += [block.nodes[rows] for name in left_out for block, rows in mesh.chosen(name)]
        words = unassigned(mesh, tables)
    if words:
        raise (inner or section).error(
            f"{words} of {mesh.source}, belong to no element set; add one with `group`, or name the group in `leave_out`"
            " of [structure.mesh]"
        )


def read_supports(section: Section, mesh: Mesh | None, nodes: dict[int, Any]) -> list[Dof]:
    """Degrees of freedom that ``[[structure.support]]`` tables hold at zero."""
    held: dict[Dof, None] = {}
    for entry in section.sections("support"):
        keys: dict[str, Kind] = {"group": TEXT, "nodes": NODES, "directions": TEXTS, **dict.fromkeys(_AXES, _PLACE)}
        given = entry.values(keys)
        directions = [d.upper() for d in as_list(given.get("directions", list(DIRECTIONS)))]
        if not set(directions) <= set(DIRECTIONS):
            raise entry.error(f"must be among {' '.join(DIRECTIONS)}, got {directions}", "directions")
        for node in _supported(entry, given, mesh, nodes):
            held.update(dict.fromkeys(Dof(int(node), d) for d in directions))
    return list(held)


def _supported(entry: Section, given: dict[str, Any], mesh: Mesh | None, nodes: dict[int, Any]) -> list[int]:
    """Labels of the nodes that satisfy everything that a support says."""
    chosen = set(nodes)
    if not {"group", "nodes", *_AXES} & set(given):
        raise entry.error("names no nodes; add `group`, `nodes`, or a coordinate such as `x = 0.0`")
    if "nodes" in given:
        named = [n for row in as_list(given["nodes"]) for n in as_list(row)]
        if set(named) - chosen:
            raise entry.error(f"node {min(set(named) - chosen)} does not exist", "nodes")
        chosen &= set(named)
    if mesh is None and {"group", *_AXES} & set(given):
        raise entry.error("`group`, `x`, `y` and `z` need a mesh; add [structure.mesh], or give `nodes`")
    if mesh is not None and "group" in given:
        with entry.located("group"):
            chosen &= set(mesh.group_nodes(given["group"]).tolist())
    ranges = {axis: given[axis] for axis in _AXES if axis in given}
    if mesh is not None and ranges:
        ends = {axis: (min(as_list(v)), max(as_list(v))) for axis, v in ranges.items()}
        chosen &= set(mesh.nodes_at(ends).tolist())
    if not chosen:
        raise entry.error("no node is at this place; compare it with the mesh, whose coordinates are meant in m")
    return sorted(chosen)


def read_points(section: Section, mesh: Mesh | None, elements: list[ElementSet]) -> list[tuple[Section, MeshPoint]]:
    """The ``[structure.points]``: places of sensors and loads, each at the nearest node."""
    inner = section.section("points")
    if inner is None:
        return []
    if mesh is None:
        raise inner.error("points need a mesh; add [structure.mesh], or name nodes")
    for key in inner.table:
        if not re.fullmatch(r"\d{1,9}", key):
            raise inner.error("labels must be whole numbers, as in `9001 = [0.2, 0.1, 0.0]`", key)
    given = inner.values(dict.fromkeys(inner.table, POSITION))
    found = []
    for key, position in given.items():
        place = np.zeros(3)
        numbers = as_list(position)
        if len(numbers) > 3:
            raise inner.error(f"must have 1 to 3 coordinates, got {len(numbers)}", key)
        place[: len(numbers)] = numbers
        with inner.located(key):
            found.append((inner, mesh_points(mesh, elements, {int(key): place.tolist()})[0]))
    return found
