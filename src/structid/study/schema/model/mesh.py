"""``[structure.mesh]``, ``[[structure.support]]`` and ``[structure.points]``: a structure on a mesh from a file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from structid.core.arrays import IntArray
from structid.core.display import join_words
from structid.core.dof import DIRECTIONS, Dof
from structid.core.units import FORCES, LENGTHS
from structid.fem.elements import ElementSet
from structid.fem.measuring_points import MeshPoint, mesh_points
from structid.fem.meshes import (
    Mesh,
    choose_parts,
    describe_left_aside,
    describe_unassigned_cells,
    read_mesh,
    require_sound,
)
from structid.fem.supports import MiddleNode, RigidLink, Tie
from structid.study.schema.section import InputFiles, Section
from structid.study.schema.tables import NODES, NUMBER, POSITION, RANGE, Table, as_list, choice, either, flat, table_of

_AXES = ("x", "y", "z")
_PLACE = replace(either(NUMBER, RANGE), words="a number or two increasing ones in m, as in [0.0, 0.1]")
_Place = Annotated[float | tuple[float, float] | None, _PLACE, "Where in m, a number or a range"]


@dataclass(frozen=True)
class MeshEntry:
    """``[structure.mesh]``."""

    path: Annotated[str, "Gmsh .msh, Nastran .bdf .nas .fem .dat, Abaqus .inp, VTK .vtu .vtk"]
    length_unit: Annotated[str, choice(*LENGTHS), "Of the coordinates in the file"] = "m"
    force_unit: Annotated[str, choice(*FORCES), "With length and s, of masses and springs in the file"] = "N"
    take: Annotated[
        tuple[str, ...],
        "Kinds of masses, springs and rigid elements of the file that become element sets and ties, as in"
        ' `["CONM2", "RBE2"]`; `"all"` for all that can',
    ] = ()
    leave_out: Annotated[
        tuple[str, ...],
        "Groups of cells, and kinds of masses, springs and rigid elements, that are no part of the structure",
    ] = ()
    orphan_nodes: Annotated[Literal["refuse", "drop"], "What becomes of nodes that belong to no cell"] = "refuse"
    duplicate_nodes: Annotated[
        Literal["refuse", "merge", "keep"], "What becomes of nodes at one place; `keep` is for cracks and joints"
    ] = "refuse"


@dataclass(frozen=True)
class SupportEntry:
    """``[[structure.support]]``: nodes that satisfy every condition are constrained."""

    group: Annotated[str | None, "A group of the mesh"] = None
    nodes: Annotated[int | list[int] | list[list[int]] | None, NODES, "Node numbers"] = None
    directions: Annotated[tuple[str, ...], "What is held"] = DIRECTIONS
    x: _Place = None
    y: _Place = None
    z: _Place = None


#: All keys of ``[structure.mesh]`` and of ``[[structure.support]]``.
MESH, SUPPORT = table_of(MeshEntry), table_of(SupportEntry)


def read_structure_mesh(section: Section, files: InputFiles) -> Mesh | None:
    """The mesh that ``[structure]`` names, in SI units and checked; None if it names none.

    Nodes without an element and duplicate nodes are treated as the section says. `StudyError` if the mesh cannot be
    used, or lacks a part that ``take`` names.
    """
    inner = _mesh_section(section)
    if inner is None:
        return None
    short = isinstance(section.table["mesh"], str)
    wanted = inner.read(MeshEntry)
    with inner.located("mesh" if short else "path"):
        mesh = read_mesh(files.path(wanted.path), wanted.length_unit, wanted.force_unit)
    with inner.located(None if short else "take"):
        choose_parts(mesh.parts, as_list(wanted.take), mesh.source)
    with inner.located("mesh" if short else None):
        return require_sound(mesh, wanted.orphan_nodes == "drop", wanted.duplicate_nodes, as_list(wanted.take))


def _mesh_section(section: Section) -> Section | None:
    """The section ``[structure.mesh]``; a section with only the path if ``mesh`` is just a path; None if there is no mesh."""
    stated = section.table.get("mesh")
    if stated is None:
        return None
    return (
        Section(section.source, section.path, {"path": stated}) if isinstance(stated, str) else section.section("mesh")
    )


@dataclass(frozen=True, eq=False)
class TakenParts:
    """Parts of a deck beside its cells that a study takes, and those that it leaves.

    Attributes
    ----------
    elements : tuple of ElementSet
    ties : tuple of Tie
    left_aside : tuple of str
        What no element of the structure stands for, in sentences.
    notes : tuple of str
        What else the deck says that the mesh does not.
    """

    elements: tuple[ElementSet, ...] = ()
    ties: tuple[Tie, ...] = ()
    left_aside: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def take_parts(section: Section, mesh: Mesh, elements: list[ElementSet]) -> TakenParts:
    """Element sets and ties from those parts of the deck that ``[structure.mesh]`` takes, and texts on the others.

    `elements` are the element sets of the study file; nothing is taken if the structure names no mesh. `StudyError` for
    a part that is not there, or offsets on nodes that do not move in all six directions.
    """
    inner = _mesh_section(section)
    if inner is None:
        return TakenParts()
    wanted = inner.read(MeshEntry)
    take, leave_out = as_list(wanted.take), {name.lstrip("*").upper() for name in as_list(wanted.leave_out)}
    with inner.located("take" if take else None):
        taken = choose_parts(mesh.parts, take, mesh.source)
        part_elements = [element for part in taken for element in part.elements()]
    moves = tuple(d for d in DIRECTIONS if any(d in element.moves for element in elements))
    offsets = [
        part.kind
        for part in taken
        if any(isinstance(t, RigidLink) and t.dependents[0] in mesh.carriers for t in part.ties)
    ]
    if offsets and moves != DIRECTIONS:
        raise inner.error(
            f"offsets of {join_words(offsets)} need element sets that move in all six directions (shells, space beams), since an"
            f" arm turns with its node; these move in {' '.join(moves)}; leave the offsets out",
            "take",
        )
    ties = [
        replace(tie, directions=moves) if isinstance(tie, MiddleNode) else tie for part in taken for tie in part.ties
    ]
    considered = [part for part in mesh.parts if part.kind not in leave_out]
    words = describe_left_aside(considered, taken, mesh.source)
    bare = (
        describe_unassigned_cells(mesh, _assigned_tables(mesh, wanted, elements), lower=True)
        if mesh.cells_are_elements
        else None
    )
    bars = f"{bare} of {mesh.source}, belong to no element set: add one with `group`, or name the group in `leave_out`"
    return TakenParts(
        tuple(part_elements),
        tuple(ties),
        (*([words] if words else []), *([bars] if bare else [])),
        tuple(f"{mesh.source}: {note}" for note in mesh.notes),
    )


def _assigned_tables(mesh: Mesh, wanted: MeshEntry, elements: list[ElementSet]) -> list[IntArray]:
    """Node labels of the cells that belong to an element set or to a group that is left out, one array a set or block.

    `elements` are the sets of the structure; the arrays are (n_cells, n_nodes), -1 where a row has ended.
    """
    kinds = {part.kind for part in mesh.parts}
    groups = [
        name for name in as_list(wanted.leave_out) if name in mesh.groups or name.lstrip("*").upper() not in kinds
    ]
    return [
        *(element.nodes for element in elements),
        *(block.nodes[rows] for name in groups for block, rows in mesh.chosen(str(name))),
    ]


def group_table(entry: Section, kind: type[ElementSet], group: str | None, mesh: Mesh) -> IntArray:
    """Node labels of an element set on `group` of the mesh, or on all its cells if that is None.

    The table is (n_elements, n_nodes). `kind` is the class of the element set. A class that follows nodes, such as a
    mass, takes a group of nodes, one element each. `StudyError` if there is no such group.
    """
    with entry.located("group" if group is not None else None):
        if kind.follows and group is not None:
            return mesh.group_nodes(group)
        return mesh.cells(group)


def require_all_assigned(section: Section, mesh: Mesh, elements: list[ElementSet]) -> None:
    """Raise `StudyError` if cells of the mesh belong to none of the sets `elements` and are not in ``leave_out``.

    `section` is ``[structure]``, whose ``mesh`` has that key.
    """
    inner = section.section("mesh") if isinstance(section.table.get("mesh"), dict) else None
    wanted = inner.read(MeshEntry) if inner is not None else MeshEntry("")
    with (inner or section).located("leave_out" if wanted.leave_out else "mesh" if inner is None else None):
        words = describe_unassigned_cells(mesh, _assigned_tables(mesh, wanted, elements))
    if words:
        raise (inner or section).error(
            f"{words} of {mesh.source}, belong to no element set; add one with `group`, or name the group in `leave_out`"
            " of [structure.mesh]"
        )


def read_supports(section: Section, mesh: Mesh | None, nodes: Collection[int]) -> list[Dof]:
    """Degrees of freedom that the ``[[structure.support]]`` tables fix, each once.

    `nodes` are the labels of all nodes of the structure, `mesh` is None if there is none. Raises `StudyError` if a table cannot
    be used.
    """
    fixed: dict[Dof, None] = {}
    for entry in section.sections("support"):
        support = entry.read(SupportEntry)
        directions = [d.upper() for d in as_list(support.directions)]
        if not set(directions) <= set(DIRECTIONS):
            raise entry.error(f"must be among {' '.join(DIRECTIONS)}, got {directions}", "directions")
        for node in _nodes_of_support(entry, support, mesh, nodes):
            fixed.update(dict.fromkeys(Dof(int(node), d) for d in directions))
    return list(fixed)


def _nodes_of_support(entry: Section, support: SupportEntry, mesh: Mesh | None, nodes: Collection[int]) -> list[int]:
    """Sorted labels of the nodes that satisfy every condition of a support: its list, its group and its coordinates.

    `nodes` are all labels, `mesh` is None if there is none. `StudyError` if the entry has no condition, names a node or
    group that does not exist, needs a mesh where there is none, or leaves no node.
    """
    chosen = set(nodes)
    if not {"group", "nodes", *_AXES} & set(entry.table):
        raise entry.error("names no nodes; add `group`, `nodes`, or a coordinate such as `x = 0.0`")
    if support.nodes is not None:
        named = flat(support.nodes)
        if set(named) - chosen:
            raise entry.error(f"node {min(set(named) - chosen)} does not exist", "nodes")
        chosen &= set(named)
    if mesh is None and {"group", *_AXES} & set(entry.table):
        raise entry.error("`group`, `x`, `y` and `z` need a mesh; add [structure.mesh], or give `nodes`")
    if mesh is not None and support.group is not None:
        with entry.located("group"):
            chosen &= set(mesh.group_nodes(support.group).tolist())
    coordinates = zip(_AXES, (support.x, support.y, support.z), strict=True)
    ends = {
        axis: limits if isinstance(limits, tuple) else (limits, limits)
        for axis, limits in coordinates
        if limits is not None
    }
    if mesh is not None and ends:
        chosen &= set(mesh.nodes_at(ends).tolist())
    if not chosen:
        raise entry.error("no node is at this place; compare it with the mesh, whose coordinates are meant in m")
    return sorted(chosen)


def read_points(section: Section, mesh: Mesh | None, elements: list[ElementSet]) -> list[tuple[Section, MeshPoint]]:
    """Points of sensors and loads in ``[structure.points]``, each with its section and tied to the nearest mesh node.

    `elements` are the sets of the structure; coordinates that a point leaves out are 0. The list is empty without
    such a table. `StudyError` if there is no `mesh`, or a point cannot be tied to it.
    """
    inner = section.section("points")
    if inner is None:
        return []
    if mesh is None:
        raise inner.error("points need a mesh; add [structure.mesh], or name nodes")
    points = []
    for key, position in inner.values(Table(labels=POSITION)).items():
        coordinates = [*map(float, as_list(position)), 0.0, 0.0][:3]
        with inner.located(key):
            points.append((inner, mesh_points(mesh, elements, {int(key): coordinates})[0]))
    return points
