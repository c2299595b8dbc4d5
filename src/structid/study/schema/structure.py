"""The ``[structure]`` of a study file as a `Structure`."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Mapping
from typing import Any

from structid.dof import DIRECTIONS, Dof, parse_dof
from structid.errors import InputError
from structid.structure import ELEMENT_TYPES, Constraint, MatrixGroup, RigidLink, Structure
from structid.structure.elements import ElementSet
from structid.structure.importers import require_total_mass
from structid.structure.meshes import Mesh
from structid.structure.supports import Tie
from structid.study.schema.input_files import InputFiles
from structid.study.schema.matrices import read_groups
from structid.study.schema.mesh import (
    group_table,
    read_points,
    read_structure_mesh,
    read_supports,
    require_all_assigned,
)
from structid.study.schema.section import (
    BOOLEAN,
    INTEGER,
    NODES,
    NUMBER,
    NUMBERS,
    POSITION,
    POSITIVE,
    TEXT,
    TEXTS,
    VECTOR,
    WEIGHTED,
    Kind,
    Section,
    as_list,
)

Positions = dict[int, list[float]]
Elements = list[tuple[Section, ElementSet]]
Ties = list[tuple[Section, Tie]]
Parts = tuple[Elements, Ties, list[Dof]]

_KINDS = {
    "name": TEXT,
    "nodes": NODES,
    "first": TEXTS,
    "second": TEXTS,
    "measured_by": TEXTS,
    "directions": TEXTS,
    "direction": TEXT,
    "smoothing": INTEGER,
    "lumped": BOOLEAN,
    "orientation": VECTOR,
    "poisson": NUMBER,
    "state": TEXT,
    "formulation": TEXT,
    "linear_strains": NUMBER,
}
_ONE_END = {"first": TEXT, "second": TEXT}
_DOF_KEYS = ("first", "second", "measured_by")
_SEVERAL = re.compile(r"^\s*(\d+)((?:\s+R?[XYZ]){2,})\s*$", re.IGNORECASE)


def read_structure(section: Section, files: InputFiles, changes: Section | None = None) -> Structure:
    """The structure that `section` describes.

    Parameters
    ----------
    section : Section
        ``[structure]``.
    files : InputFiles
        Takes note of the matrix files read.
    changes : Section, optional
        ``[record.structure]``: element sets, nodes and ties that one set-up has beside, what it is `without`, and what
        is `fixed` instead.
    """
    plain = {"active": TEXTS, "fixed": TEXTS, "total_mass": POSITIVE}
    own = ("nodes", "mesh", "support", "points", "matrices", "matrix_group")
    given = section.values(plain, others=(*own, *ELEMENT_TYPES, "rigid_link", "constraint"))
    groups, held = read_groups(section, files)
    mesh = read_structure_mesh(section, files)
    nodes = _nodes(section, groups, mesh)
    entries = [(entry, kind) for kind in ELEMENT_TYPES for entry in section.sections(kind)]
    elements: Elements = [(entry, _element(entry, kind, nodes, mesh)) for entry, kind in entries]
    elements.extend(groups)
    if not elements:
        kinds = ", ".join(f"[[structure.{kind}]]" for kind in ELEMENT_TYPES)
        raise section.error(f"the structure has no elements; add some of {kinds} or [[structure.matrix_group]]")
    ties = [_tie(entry, nodes) for key in ("rigid_link", "constraint") for entry in section.sections(key)]
    if mesh is not None:
        require_all_assigned(section, mesh, [element for _, element in elements])
    for entry, point in read_points(section, mesh, [element for _, element in elements]):
        nodes[point.label] = list(nodes[point.node])
        ties.append((entry, point))
    fixed = [dof for text in as_list(given.get("fixed", [])) for dof in _fixed(section, text, nodes)]
    fixed += read_supports(section, mesh, nodes)
    active = as_list(given["active"]) if "active" in given else None
    if "total_mass" in given:
        whole = _built(section, nodes, elements, ties, [*fixed, *held], active)
        with section.located("total_mass"):
            require_total_mass(whole.mass_of(), given["total_mass"])
    if changes is not None:
        elements, ties, fixed = _changed(changes, nodes, (elements, ties, fixed), mesh)
    structure = _built(section, nodes, elements, ties, [*fixed, *held], active)
    if structure.n_dofs == 0:
        raise section.error("no degree of freedom is free; take some out of `fixed` or add to `active`")
    return structure


def _built(
    section: Section, nodes: Positions, elements: Elements, ties: Ties, fixed: list[Dof], active: list[str] | None
) -> Structure:
    try:
        return Structure(nodes, [element for _, element in elements], fixed, [tie for _, tie in ties], active)
    except InputError as error:
        raise _placed(section, str(error), elements, ties) from error


def _changed(changes: Section, nodes: Positions, parts: Parts, mesh: Mesh | None) -> Parts:
    """What one set-up makes of the structure; its own nodes are added to `nodes`."""
    elements, ties, fixed = parts
    tables = ("nodes", *ELEMENT_TYPES, "rigid_link", "constraint", "support")
    given = changes.values({"fixed": TEXTS, "without": TEXTS}, others=tables)
    names = [element.name for _, element in elements] + [tie.name for _, tie in ties]
    absent = as_list(given.get("without", []))
    for name in absent:
        if name not in names:
            near = difflib.get_close_matches(name, names, 1, 0.0)
            raise changes.error(f"there is no element set or tie {name!r}; the nearest is {near[0]!r}", "without")
    if changes.section("nodes") is not None:
        size = len(next(iter(nodes.values())))
        for label, position in _nodes(changes, []).items():
            if label in nodes:
                raise changes.error(
                    f"node {label} is in [structure.nodes] already; take it out of one of them", "nodes"
                )
            if len(position) != size:
                raise changes.error(f"node {label} must have {size} coordinates like the others", "nodes")
            nodes[label] = position
    elements = [pair for pair in elements if pair[1].name not in absent]
    ties = [pair for pair in ties if pair[1].name not in absent]
    entries = [(entry, kind) for kind in ELEMENT_TYPES for entry in changes.sections(kind)]
    elements += [(entry, _element(entry, kind, nodes, mesh)) for entry, kind in entries]
    ties += [_tie(entry, nodes) for key in ("rigid_link", "constraint") for entry in changes.sections(key)]
    if "fixed" in given or "support" in changes.table:
        fixed = [dof for text in as_list(given.get("fixed", [])) for dof in _fixed(changes, text, nodes)]
        fixed += read_supports(changes, mesh, nodes)
    return elements, ties, fixed


def _placed(section: Section, message: str, elements: Elements, ties: Ties) -> InputError:
    """The error with the place of the element set or tie that its message names."""
    named = [(entry, element.name) for entry, element in elements] + [(entry, tie.name) for entry, tie in ties]
    for entry, name in named:
        if repr(name) in message:
            return entry.error(message)
    for key in ("fixed", "active", "nodes"):
        if f"`{key}`" in message and key in section.table:
            return section.error(message, key)
    return section.error(message)


def _nodes(section: Section, groups: list[tuple[Section, MatrixGroup]], mesh: Mesh | None = None) -> Positions:
    inner = section.section("nodes")
    if mesh is not None:
        nodes = {label: position.tolist() for label, position in mesh.nodes.items()}
        return nodes if inner is None else nodes | _besides(inner, _nodes(section, []), mesh)
    if inner is None:
        if groups:
            return {dof.node: [0.0, 0.0, 0.0] for _, group in groups for dof in group.dofs}
        raise section.error("the structure has no nodes; add [structure.nodes] with lines such as `1 = [0.0, 0.0]`")
    if not inner.table:
        raise inner.error("holds no node; add lines such as `1 = [0.0, 0.0]`")
    for key in inner.table:
        if not re.fullmatch(r"\d{1,9}", key):
            raise inner.error("node labels must be whole numbers, as in `1 = [0.0, 0.0]`", key)
    given = inner.values(dict.fromkeys(inner.table, POSITION))
    nodes = {int(label): [float(x) for x in as_list(position)] for label, position in given.items()}
    for key, position in given.items():
        size, usual = len(as_list(position)), len(as_list(next(iter(given.values()))))
        if size > 3 or size != usual:
            raise inner.error(f"must have {min(usual, 3)} coordinates like the first node, got {size}", key)
    return nodes


def _besides(inner: Section, own: Positions, mesh: Mesh) -> Positions:
    """Nodes beside those of a mesh."""
    for label, position in own.items():
        if label in mesh.nodes:
            raise inner.error(f"is a node of {mesh.source} already; take another number", str(label))
        if len(position) != 3:
            raise inner.error(f"must have 3 coordinates like the mesh, got {len(position)}", str(label))
    return own


def _element(entry: Section, kind: str, nodes: Positions, mesh: Mesh | None = None) -> ElementSet:
    signature = inspect.signature(ELEMENT_TYPES[kind])
    kinds: dict[str, Kind] = {key: _KINDS.get(key, NUMBERS) for key in signature.parameters}
    if kind == "friction":
        kinds.update(_ONE_END)
    required = [key for key, item in signature.parameters.items() if item.default is inspect.Parameter.empty]
    has_nodes, on_mesh = "nodes" in kinds, mesh is not None and "nodes" in kinds and "nodes" not in entry.table
    if has_nodes:
        kinds["group"] = TEXT
    given = entry.values(kinds, [key for key in required if key != "nodes" or not on_mesh])
    group = given.pop("group", None)
    if group is not None and not on_mesh:
        raise entry.error("needs a mesh, and no `nodes`; add [structure.mesh], or take one of them out", "group")
    for key in _DOF_KEYS:
        for text in as_list(given.get(key, [])):
            _known_dof(entry, key, text, nodes)
    for node in _flat(given.get("nodes", [])):
        _require_node(entry, "nodes", node, nodes)
    if "directions" in given:
        given["directions"] = tuple(as_list(given["directions"]))
    if on_mesh:
        assert mesh is not None
        given["nodes"] = group_table(entry, kind, group, mesh)
    with entry.located():
        made: ElementSet = ELEMENT_TYPES[kind](**given)
    return made


def _flat(nodes: Any) -> list[int]:
    return [node for row in as_list(nodes) for node in as_list(row)]


def _require_node(entry: Section, key: str, node: int, nodes: Mapping[int, Any]) -> None:
    if node not in nodes:
        near = difflib.get_close_matches(str(node), [str(label) for label in nodes], 1, 0.0)
        raise entry.error(f"node {node} does not exist; the nearest is {near[0]}, or add it to [structure.nodes]", key)


def _known_dof(entry: Section, key: str, text: str, nodes: Positions) -> Dof:
    """`text` as a degree of freedom of a node that exists."""
    with entry.located(key):
        dof = parse_dof(text)
    _require_node(entry, key, dof.node, nodes)
    return dof


def _fixed(section: Section, text: str, nodes: Positions) -> list[Dof]:
    """``1X`` is one degree of freedom, ``1 X RZ`` two of node 1, ``1`` all six."""
    several = _SEVERAL.match(text)
    if text.strip().isdigit():
        words = [f"{text.strip()}{direction}" for direction in DIRECTIONS]
    elif several:
        words = [several[1] + direction for direction in several[2].split()]
    else:
        words = [text]
    return [_known_dof(section, "fixed", word, nodes) for word in words]


def _tie(entry: Section, nodes: Positions) -> tuple[Section, Tie]:
    if entry.path[-2] == "rigid_link":
        given = entry.values({"name": TEXT, "main": INTEGER, "dependents": NODES}, ("name", "main", "dependents"))
        for key in ("main", "dependents"):
            for node in _flat(given[key]):
                _require_node(entry, key, node, nodes)
        with entry.located():
            return entry, RigidLink(given["name"], given["main"], _flat(given["dependents"]))
    keys = {"name": TEXT, "dependent": TEXT, "depends_on": WEIGHTED}
    given = entry.values(keys, tuple(keys))
    dependent = _known_dof(entry, "dependent", given["dependent"], nodes)
    pairs = [(_known_dof(entry, "depends_on", text, nodes), factor) for text, factor in given["depends_on"]]
    with entry.located():
        return entry, Constraint(given["name"], dependent, pairs)
