"""A structure as the page draws it: places of nodes, faces and lines by element set, supports, masses, sensors.

A study may have several records; the page asks for the structure of one.
"""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import IntArray
from structid.core.constraints import parameter_descriptions
from structid.core.display import plural
from structid.core.dof import Dof, parse_dof, parse_dofs
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry
from structid.diagnose.checks.loose_parts import PlacedFinding, structure_findings
from structid.external.runs import Solver
from structid.fem import ELEMENT_TYPES, Dashpot, Friction, Joint, PointMass, RotaryInertia, Spring, Structure
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.fem.measuring_points import AimedSensor, MeshPoint
from structid.fem.meshes import read_mesh
from structid.fem.supports import RigidLink
from structid.inversion.search.work import SerialExecutor, StageProgress, Task
from structid.report.drawing.picture import AREA_CORNERS, SOLID_CORNERS, SOLID_FACES, is_cells
from structid.study.schema.model.structure import read_structure
from structid.study.schema.records.record import RecordSource, read_source
from structid.study.schema.records.sensors import channel_names
from structid.study.schema.section import Section, read_root, record_sections
from structid.study.schema.tables import as_list

#: Element types whose properties the page can edit.
EDITED = ("beam", "bar", "space_beam", "point_mass", "spring")


@dataclass(frozen=True)
class ReadModel:
    """A study's structure as it was under one of its records.

    Attributes
    ----------
    root : Section
        The study.
    record : Section or None
        ``[record]``, or one of several; None where there is none yet.
    structure : Structure
        With the changes that the record makes.
    """

    root: Section
    record: Section | None
    structure: Structure


def read_model(path: Path, number: int = 0) -> ReadModel:
    """Structure of the study at `path` as it was under its record `number` (counted from 0), with the study's sections.

    Without any record, number 0 gives the structure alone.

    Raises
    ------
    InputError
        If the file or its structure cannot be used, or there are records but none of this number.
    """
    root, files = read_root(path, work=LOOKING)
    record = _record(root, number)
    changes = record.section("structure") if record is not None else None
    return ReadModel(root, record, read_structure(root.inner("structure"), files, changes, record))


def read_record_section(path: Path, number: int = 0) -> Section:
    """Section of record `number` (counted from 0) of the study at `path`, the only ``[record]`` or one of several.

    Raises
    ------
    InputError
        If there is none.
    """
    return _required(_record(read_root(path, work=LOOKING)[0], number))


def _required(record: Section | None) -> Section:
    """`record`, or `InputError` if it is None: the study has no record yet."""
    if record is None:
        raise InputError("the study has no record yet: drop a record file on the start page, and use it in this study")
    return record


def read_record_source(path: Path, number: int = 0) -> tuple[Section, RecordSource]:
    """Root section of the study at `path`, and the source of its record `number` (counted from 0).

    Files of the other records may be missing.

    Raises
    ------
    InputError
        If the file, its structure or this record cannot be used.
    """
    root, files = read_root(path, work=LOOKING)
    record = _required(_record(root, number))
    structure = read_structure(root.inner("structure"), files, record.section("structure"), record)
    aimed = channel_names(structure)
    return root, read_source(record, files, aimed, structure.base_supports)


def require_record(n_records: int, number: int) -> None:
    """Raise `InputError` if a study of `n_records` records has none of index `number`, from 0."""
    if not 0 <= number < n_records:
        raise InputError(
            f"the study has {plural(n_records, 'record')} and none of number {number + 1}; it was changed since"
        )


def _record(root: Section, number: int) -> Section | None:
    """Section of record `number` (counted from 0) of a study; None if the study has no records.

    Raises `InputError` if it has records, but none of this number. `root` is the top section of the study.
    """
    listed = record_sections(root)
    if listed or number != 0:
        require_record(len(listed), number)
    return listed[number] if listed else None


class Looking(SerialExecutor):
    """Work that refuses to run solvers; stored runs are still read."""

    def map(
        self,
        name: str,
        task: Task,
        shared: Any,
        items: Sequence[Any],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[Any]:
        """Results of `task` for each of `items`, as from `SerialExecutor.map`, without ever starting a solver.

        Raises
        ------
        InputError
            If `shared` is a solver, which would have to run.
        """
        if isinstance(shared, Solver):
            raise InputError(
                f"[structure.solver] names a program that has yet to run {len(items)} times ({shared.command}), and looking at a"
                " study runs none: where you trust the study, start a run, or `structid check` in a terminal; both keep what"
                " the program gives"
            )
        return super().map(name, task, shared, items, progress, first)


LOOKING = Looking()


def element_kinds() -> dict[str, StoredEntry]:
    """Keys of each element type that the page can edit, by type: a list of mappings, one for each key.

    They have ``name``, ``unit``, ``words`` (description) and ``required`` (True if there is no default).
    """
    kinds: dict[str, StoredEntry] = {}
    for name in EDITED:
        kind = ELEMENT_TYPES[name]
        declared, words = declarations(kind), parameter_descriptions(kind)
        kinds[name] = [
            {
                "name": item.name,
                "unit": declared[item.name].unit,
                "words": words.get(item.name, ""),
                "required": item.default is dataclasses.MISSING,
            }
            for item in dataclasses.fields(kind)
            if item.init
        ]
    return kinds


#: Sides of cells beyond which only those between different directions or sets would help; none are drawn.
_MOST_MARKED = 4000
#: Degrees of freedom beyond which `check` alone looks for loose parts: here it would keep the picture waiting.
_MOST_JUDGED = 60_000


def scene(path: Path, number: int = 0) -> dict[str, StoredEntry]:
    """Drawing data of a study's structure, with the changes of its record `number` (counted from 0) applied.

    Nodes, element sets, supports and links are as `structure_scene` gives them. Besides, the mapping has ``title``, ``planned``
    (installed sensors and loads of a planned test), ``has_record``, and ``findings``, faults of the structure as
    `told_findings` marks them; a large structure is not searched for faults.

    Raises
    ------
    InputError
        If the file or its structure cannot be used, or there is no record of this number.
    """
    model = read_model(path, number)
    root, structure = model.root, model.structure
    plan = root.inner("plan").table
    return {
        "title": root.table.get("title", path.stem),
        **structure_scene(structure),
        "planned": {
            key: [str(dof) for dof in parse_dofs(map(str, as_list(plan.get(f"installed_{key}", []))))]
            for key in ("sensors", "loads")
        },
        "has_record": model.record is not None,
        "findings": told_findings(structure, structure_findings(structure, structure.values))
        if structure.n_dofs <= _MOST_JUDGED
        else [],
    }


def structure_scene(structure: Structure) -> dict[str, StoredEntry]:
    """Drawing data of a structure: packed node labels and positions (m), element sets, supports, links and mesh points.

    Nodes are named by their row in ``labels``; ``places`` is (n_nodes, 3), padded with zeros; ``moves`` (n_nodes,) sums
    1, 2 and 4 for the free directions X, Y and Z. ``sets``, ``supports``, ``links`` (main node first) and ``points``
    are lists; ``dimension`` and ``n_dofs`` are numbers of the structure.
    """
    labels = np.array(list(structure.nodes), dtype=np.int64)
    places = np.zeros((len(labels), 3), dtype=np.float32)
    places[:, : structure.dimension] = np.array(list(structure.nodes.values()))
    row = {int(label): k for k, label in enumerate(labels)}
    order = np.argsort(labels)

    def rows(nodes: ArrayLike) -> IntArray:
        """Rows, from 0, of node labels in ``labels``, in the shape of `nodes`."""
        given = np.asarray(nodes, dtype=np.int64)
        found: IntArray = order[np.searchsorted(labels, given, sorter=order)]
        return found

    return {
        "moves": packed(_moves(structure, labels, rows), np.uint8),
        "dimension": structure.dimension,
        "n_dofs": structure.n_dofs,
        "labels": packed(labels, np.int32),
        "places": packed(places, np.float32),
        "sets": [_describe_set(element, structure, rows) for element in structure.elements],
        "supports": _supports(structure, row),
        "links": [
            [row[tie.main], *(row[n] for n in tie.dependents)] for tie in structure.ties if isinstance(tie, RigidLink)
        ],
        "points": [
            {
                "node": row.get(tie.label, row[tie.node]),
                "to": row[tie.node],
                "distance": tie.distance,
                "label": tie.label,
            }
            for tie in structure.ties
            if isinstance(tie, MeshPoint)
        ],
    }


def _moves(structure: Structure, labels: IntArray, rows: Any) -> IntArray:
    """Directions in which each node can move, (n_nodes,) int: the sum of 1 for X, 2 for Y and 4 for Z.

    `labels` (n_nodes,) are the node labels; `rows` is a function that turns node labels into rows of `labels`.
    """
    nodes, axes = np.divmod(structure.numbering.moving, 6)
    own = np.isin(nodes, labels) & (axes < 3)
    bits = np.zeros(len(labels), dtype=np.int64)
    np.add.at(bits, rows(nodes[own]), 1 << axes[own])
    return bits


def told_findings(structure: Structure, findings: Sequence[PlacedFinding]) -> list[dict[str, StoredEntry]]:
    """Findings for the page, each with ``words``, ``nodes`` (labels) and ``outlines`` (lists of node labels around elements).

    At most `_MOST_MARKED` nodes, and `_MOST_MARKED` elements of a set, are marked for each finding.
    """
    return [
        {
            "words": one.words,
            "nodes": list(one.nodes[:_MOST_MARKED]),
            "outlines": [
                outline
                for element in structure.elements
                if element.name in one.elements
                for outline in _outlines(element, one.elements[element.name])
            ],
        }
        for one in findings
    ]


def _outlines(element: ElementSet, rows: IntArray) -> list[list[int]]:
    """Lists of node labels around elements of a set, not closed: one for each line or area, one for each face of a solid.

    `rows` (n,) are the rows of the elements in the set, of which the first 4000 are used. Nodes in the middle of sides
    of areas and solids are left out.
    """
    outlines: list[list[int]] = []
    for nodes in element.nodes[rows[:_MOST_MARKED]]:
        corners = nodes[nodes >= 0]
        if element.symbol == "solid":
            outlines += [corners[list(face)].tolist() for face in SOLID_FACES[SOLID_CORNERS[len(corners)]]]
        else:
            outlines.append(corners[: AREA_CORNERS[len(corners)] if is_cells(element) else None].tolist())
    return outlines


def packed(values: ArrayLike, kind: type[np.generic]) -> str:
    """Base64 text of `values` as the bytes of a C-ordered array of dtype `kind`."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def _describe_set(element: ElementSet, structure: Structure, rows: Any) -> dict[str, StoredEntry]:
    """Drawing data of one element set: name, type, element count, and the range of each property in its SI unit.

    Geometry is added under ``connectors``, ``triangles`` (with ``edges`` and ``owners``), ``marks`` (with ``weights``,
    masses in kg of point masses or ones) or ``lines``, depending on the type; at most 4000 connectors. `rows` is a
    function that turns node labels into rows of the drawn nodes.
    """
    properties: list[dict[str, StoredEntry]] = [
        {
            "name": item.term.property,
            "unit": item.term.unit,
            "kind": item.term.kind,
            "low": float(np.min(item.term.values)),
            "high": float(np.max(item.term.values)),
        }
        for item in structure.properties
        if item.element == element.name and item.term.kind != "length"
    ]
    entry: dict[str, StoredEntry] = {
        "name": element.name,
        "type": type(element).__name__,
        "count": len(element.nodes),
        "properties": properties,
    }
    if isinstance(element, Spring | Dashpot | Friction):
        second = element.second or (None,) * len(element.first)
        pairs = list(zip(element.first, second, strict=True))[:_MOST_MARKED]
        entry["connectors"] = [
            {"from": int(rows(a.node)), "to": None if b is None else int(rows(b.node)), "direction": a.direction}
            for a, b in pairs
        ]
    elif is_cells(element):
        entry["triangles"], entry["edges"], entry["owners"] = _faces(element, rows)
    elif isinstance(element, PointMass | RotaryInertia | Joint) or element.nodes.shape[1] == 1:
        weights = element.mass if isinstance(element, PointMass) else np.ones(len(element.nodes))
        entry["marks"] = packed(rows(element.nodes[:, 0]), np.uint32)
        entry["weights"] = packed(weights, np.float32)
    elif element.nodes.shape[1] == 2:
        entry["lines"] = packed(rows(element.nodes), np.uint32)
    else:
        used = np.unique(element.nodes[element.nodes >= 0])
        entry["marks"] = packed(rows(used[:_MOST_MARKED]), np.uint32)
    return entry


def _faces(element: ElementSet, rows: Any) -> tuple[str, str, str]:
    """Packed triangles (n, 3), edges (m, 2) and, for each triangle, the row of its element; solids by their outer faces only.

    Triangles and edges hold rows of nodes, to which the function `rows` turns node labels.
    """
    corners, owners = [], []
    counts = (element.nodes >= 0).sum(axis=1)
    solid = element.symbol == "solid"
    for count in np.unique(counts):
        which = np.flatnonzero(counts == count)
        cells = element.nodes[which]
        if solid:
            for face in SOLID_FACES[SOLID_CORNERS[int(count)]]:
                corners.append(_four(cells[:, list(face)]))
                owners.append(which)
        else:
            corners.append(_four(cells[:, : AREA_CORNERS[int(count)]]))
            owners.append(which)
    faces, owner = np.concatenate(corners), np.concatenate(owners)
    if solid:
        _, inverse, number = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
        outer = number[np.ravel(inverse)] == 1
        faces, owner = faces[outer], owner[outer]
    at = rows(faces)
    four = faces[:, 3] != faces[:, 2]
    triangles = np.concatenate([at[:, :3], at[four][:, [0, 2, 3]]])
    sides = np.concatenate([at[:, [0, 1]], at[:, [1, 2]], at[:, [2, 3]][four], at[:, [3, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0)
    return (
        packed(triangles, np.uint32),
        packed(sides, np.uint32),
        packed(np.concatenate([owner, owner[four]]), np.uint32),
    )


def _four(faces: IntArray) -> IntArray:
    """Faces (n, 4) from faces with four or three corners; a triangle repeats its last corner."""
    return faces if faces.shape[1] == 4 else np.column_stack([faces, faces[:, 2]])


def _supports(structure: Structure, row: dict[int, int]) -> list[dict[str, StoredEntry]]:
    """Supported nodes, each as ``node`` (row) and ``directions`` (those that are fixed); at most 4000.

    `row` maps node labels to rows.
    """
    held: dict[int, list[str]] = {}
    for dof in structure.fixed:
        if dof.node in row:
            held.setdefault(row[dof.node], []).append(dof.direction)
    supports: list[dict[str, StoredEntry]] = [{"node": node, "directions": to} for node, to in held.items()]
    return supports[:_MOST_MARKED]


def placed_channels(model: ReadModel, channels: list[tuple[str, str]]) -> list[dict[str, StoredEntry]]:
    """Each channel of a record with its node and direction on the structure, in the order of `channels`.

    `channels` are pairs of name and role, "sensor" or "load". ``node`` is a node label, None if the structure has no
    such node; ``direction`` is a unit vector of three with the channel's sign; ``rotation`` is True for a rotation or
    moment, and ``declared`` if the study gives the channel's position itself.
    """
    structure = model.structure
    aimed = {tie.channel: tie for tie in structure.ties if isinstance(tie, AimedSensor)}
    by_place = {
        (name.startswith("load "), parse_dof(name.removeprefix("load ")).place): tie for name, tie in aimed.items()
    }
    placed: list[dict[str, StoredEntry]] = []
    for name, role in channels:
        dof = parse_dof(name)
        tie = by_place.get((role == "load", dof.place)) or by_place.get((False, dof.place))
        node: int | None = dof.node if dof.node in structure.nodes else None
        direction, turned = _unit(dof), False
        if tie is not None:
            node, direction, turned = tie.node, [dof.sign * x for x in tie.direction], True
        placed.append(
            {
                "name": name,
                "role": role,
                "node": node,
                "direction": direction,
                "rotation": dof.is_rotation,
                "declared": turned,
            }
        )
    return placed


def _unit(dof: Dof) -> list[float]:
    return [float(dof.sign) if k == dof.axis % 3 else 0.0 for k in range(3)]


def mesh_facts(path: Path, length_unit: str) -> dict[str, StoredEntry]:
    """Number of nodes, extent (m), cells and groups of the mesh file at `path`, whose lengths are in `length_unit`.

    ``size`` is the extent along each axis; ``cells`` are pairs of cell kind and count; ``groups`` are the names of groups.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    mesh = read_mesh(path, length_unit)
    return {
        "nodes": len(mesh.labels),
        "size": np.ptp(mesh.positions, axis=0),
        "cells": [[block.kind, len(block.nodes)] for block in mesh.blocks],
        "groups": [name for name, rows in mesh.groups.items() if any(map(len, rows))] + list(mesh.node_groups),
    }
