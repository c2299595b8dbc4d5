"""The ``[structure]`` of a study file as a `Structure`."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from typing import Annotated, cast

from structid.core.constraints import Limits, Positive
from structid.core.dof import Dof, dofs_of_text, parse_dof
from structid.core.errors import InputError
from structid.external.solved import Solved
from structid.fem import (
    ELEMENT_TYPES,
    Base,
    Component,
    Constraint,
    MatrixGroup,
    MeasuredComponent,
    RigidLink,
    Structure,
)
from structid.fem.elements import ElementSet
from structid.fem.importers import require_total_mass
from structid.fem.meshes import Mesh
from structid.fem.structure import MOST_PIECES
from structid.fem.supports import Tie
from structid.study.schema.kinds import (
    DOF,
    DOFS,
    NODES,
    POSITION,
    RANGE,
    TEXT,
    TEXTS,
    TOLERANCE,
    WEIGHTED,
    WHOLE,
    as_list,
    choice,
    either,
    flat,
    limited,
    or_none,
)
from structid.study.schema.model.matrices import MATRIX_TABLES, read_groups
from structid.study.schema.model.measured import MEASURED, read_measured
from structid.study.schema.model.mesh import (
    MESH_TABLES,
    group_table,
    read_points,
    read_structure_mesh,
    read_supports,
    require_all_assigned,
    take_parts,
)
from structid.study.schema.model.solver import SOLVER_TABLES, positions_of, read_solver
from structid.study.schema.records.sensors import read_sensors
from structid.study.schema.root import InputFiles
from structid.study.schema.section import Section
from structid.study.schema.tables import Given, Key, Table, held_by, own_table, table_of
from structid.unknowns.tolerances import EXACT, Tolerances

Positions = dict[int, list[float]]
Elements = list[tuple[Section, ElementSet]]
Ties = list[tuple[Section, Tie]]
Bases = list[tuple[Section, Base]]
Components = list[tuple[Section, Component]]
Measured = list[tuple[Section, MeasuredComponent]]
Parts = tuple[Elements, Ties, list[Dof], Measured]

_RIGID_LINK, _CONSTRAINT = (
    table_of(RigidLink, dependents=NODES, directions=TEXTS),
    table_of(Constraint, depends_on=WEIGHTED),
)
_TIES = {
    "rigid_link": Key(_RIGID_LINK, "Nodes that move with another as one body", listed=True),
    "constraint": Key(_CONSTRAINT, "One degree of freedom as a sum of others", listed=True),
}
_BASE = table_of(Base, supports=TEXTS)
DampingRatio = Annotated[float, Limits(least=0, below=1)]
#: Highest frequency of a component's modes, in parts of that of the band.
_UP_TO = 3.0
#: Of `[method]`, which a component without `up_to` goes by.
_BAND = Table({"band": Key(RANGE)})
_COMPONENT = table_of(Component, elements=TEXTS, interface=TEXTS)
_COMPONENT = _COMPONENT | {
    "up_to": Key(
        _COMPONENT.keys["up_to"].holds,
        "Modes up to this frequency are kept, Hz; three times the end of `band` by default",
    )
}
_FIXED = Key(
    or_none(TEXTS), "Degrees of freedom held at zero: `3X`, or several of one node `3 X RZ`, or all six of it `3`"
)
#: The choice of the number of pieces by what the mesh moves values by.
AUTO = "auto"
_NUMBER_OF_PIECES = limited(WHOLE, Limits(least=1, most=MOST_PIECES))
_PIECES = replace(either(_NUMBER_OF_PIECES, choice(AUTO)), words=f'{_NUMBER_OF_PIECES.words}, or "{AUTO}"')
_POSITIONS = Table(labels=POSITION)
_NODES = Key(_POSITIONS, "One line a node: its label, and one to three coordinates in m")


def structure_table() -> Table:
    """All keys of ``[structure]``."""
    own = {
        "active": Key(TEXTS, "Directions in which the structure can move; by default all of its dimension"),
        "fixed": _FIXED,
        "total_mass": Key(held_by(Positive), "kg, as weighed; a model that differs by more than 10 % is refused"),
        "subdivide": Key(
            _PIECES,
            "Equal pieces of which each beam is made, one element still, and each bar that these leave held sideways; auto"
            " cuts until the mesh moves no value by more than a fifth of its deviation",
            default=1,
        ),
        "sliding": Key(NODES, "Nodes whose place along their bars and beams is a property, `position` of `node 3`"),
        "damping_ratio": Key(
            held_by(DampingRatio),
            "Viscous damping of all modes, the property `damping_ratio` of `all modes`; 0.01 is 1 %",
        ),
        "tolerance": Key(
            TOLERANCE,
            "How well held values are known, a standard deviation in parts of each: a number for masses and stiffnesses, 0 where"
            " all is exact, or a table of `mass`, `stiffness` and `damping`; 0.01, 0.01 and 0.3 by default",
        ),
        "base": Key(
            _BASE, "Held supports that drive the structure with one motion, as a shaking table does", listed=True
        ),
        "component": Key(_COMPONENT, "Element sets that are reduced to their interface and a few modes", listed=True),
        "measured_component": Key(
            MEASURED,
            "Parts that have no model but measured FRFs at their interface: machines, mounts, soil",
            listed=True,
        ),
        "nodes": _NODES,
    }
    return Table(own) | MESH_TABLES | MATRIX_TABLES | SOLVER_TABLES | _element_tables() | _TIES


def changes_table() -> Table:
    """All keys of ``[record.structure]``."""
    own = {
        "fixed": _FIXED,
        "without": Key(TEXTS, "Element sets, ties and measured components that were not there"),
        "nodes": _NODES,
        "support": MESH_TABLES["support"],
    }
    return Table(own) | _element_tables() | _TIES


def _element_tables() -> dict[str, Key]:
    first = {name: (inspect.getdoc(kind) or "").partition("\n")[0] for name, kind in ELEMENT_TYPES.items()}
    return {name: Key(element_table(kind), first[name], listed=True) for name, kind in ELEMENT_TYPES.items()}


def element_table(kind: type[ElementSet], on_mesh: bool = True) -> Table:
    """All keys of an element type; `on_mesh` says whether nodes may come from a mesh."""
    table = own_table(kind)
    if "nodes" not in table.keys:
        return table
    nodes = table.keys["nodes"]
    words = "In place of `nodes`: a group of cells of the mesh (of nodes, for masses); without both, all cells"
    return table | {"nodes": replace(nodes, required=not on_mesh), "group": Key(TEXT, words)}


def read_tolerances(section: Section) -> Tolerances:
    """How well held values are known by ``[structure]``; the calibration of records is as it is by default.

    Raises
    ------
    StudyError
        If it names another kind than masses, stiffnesses and dampings.
    """
    given = section.table.get("tolerance")
    if given is None:
        return Tolerances()
    if not isinstance(given, Mapping):
        part = float(cast(float, given))
        return replace(EXACT, calibration=Tolerances().calibration) if part == 0 else Tolerances(part, part)
    kinds = [item.name for item in fields(Tolerances) if item.name != "calibration"]
    for name in given:
        if name not in kinds:
            raise section.error(
                f"`tolerance` takes {', '.join(kinds)}, got {name!r}; state it in the element set", "tolerance"
            )
    return Tolerances(**cast(dict[str, float], given))


def read_structure(
    section: Section, files: InputFiles, changes: Section | None = None, record: Section | None = None
) -> Structure:
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
    record : Section, optional
        ``[record]``, whose ``[record.sensors]`` may have nodes of their own.
    """
    given = section.values(structure_table())
    groups, held = read_groups(section, files)
    mesh = read_structure_mesh(section, files)
    solved = read_solver(section, files)
    nodes = _nodes(section, groups, mesh, solved)
    elements = _elements(section, nodes, mesh)
    elements.extend(groups)
    if solved is not None:
        elements.append((section.inner("solver"), solved.model))
        held = [*held, *solved.held]
    if not elements:
        kinds = ", ".join(f"[[structure.{kind}]]" for kind in ELEMENT_TYPES)
        raise section.error(f"the structure has no elements; add some of {kinds} or [[structure.matrix_group]]")
    ties = _ties(section, nodes)
    if solved is not None:
        ties += [(section.inner("solver"), tie) for tie in solved.ties]
    if mesh is not None:
        require_all_assigned(section, mesh, [element for _, element in elements])
    taken = take_parts(section, mesh, [element for _, element in elements])
    if mesh is not None:
        deck = section if isinstance(section.table["mesh"], str) else section.inner("mesh")
        elements += [(deck, element) for element in taken.elements]
        ties += [(deck, tie) for tie in taken.ties]
    for entry, point in read_points(section, mesh, [element for _, element in elements]):
        nodes[point.label] = list(nodes[point.node])
        ties.append((entry, point))
    fixed = _fixed(section, given.get("fixed", ()), nodes) + read_supports(section, mesh, nodes)
    bases = [(entry, _base(entry, nodes)) for entry in section.sections("base")]
    components = [(entry, _component(entry, nodes)) for entry in section.sections("component")]
    measured = [(entry, _measured(entry, files, nodes)) for entry in section.sections("measured_component")]
    if "total_mass" in given:
        whole = _built(section, nodes, (elements, ties, [*fixed, *held], []), bases, [], given)
        with section.located("total_mass"):
            require_total_mass(whole.mass_of(), given["total_mass"], "; ".join(taken.left_aside))
    if changes is not None:
        elements, ties, fixed, measured = _changed(changes, nodes, (elements, ties, fixed, measured), mesh)
    aims = record is not None and "sensors" in record.table
    parts = elements, ties, [*fixed, *held], measured
    file_words = taken.left_aside, taken.notes
    structure = _built(section, nodes, parts, bases, [] if aims else components, given, file_words)
    if record is not None and aims:
        aimed = read_sensors(record, nodes, structure)
        for entry, sensor in aimed:
            nodes.setdefault(sensor.label, nodes[sensor.node])
            ties.append((entry, sensor))
        structure = _built(section, nodes, parts, bases, components, given, file_words)
    if structure.n_dofs == 0:
        raise section.error("no degree of freedom is free; take some out of `fixed` or add to `active`")
    return structure


def _built(
    section: Section,
    nodes: Positions,
    parts: Parts,
    bases: Bases,
    components: Components,
    given: Given,
    file_words: tuple[tuple[str, ...], tuple[str, ...]] = ((), ()),
) -> Structure:
    elements, ties, fixed, measured = parts
    active = as_list(given["active"]) if "active" in given else None
    sets, links = [element for _, element in elements], [tie for _, tie in ties]
    try:
        drives, sliding = [base for _, base in bases], flat(given.get("sliding", []))
        inner = [component for _, component in components]
        pieces, ratio = given.get("subdivide", 1), given.get("damping_ratio")
        pieces = 1 if pieces == AUTO else pieces  # until the records are read
        return Structure(
            nodes,
            sets,
            fixed,
            links,
            active,
            pieces,
            drives,
            sliding,
            inner,
            ratio,
            [one for _, one in measured],
            *file_words,
        )
    except InputError as error:
        raise _placed(section, str(error), [*measured, *components, *elements, *ties, *bases]) from error


def _changed(changes: Section, nodes: Positions, parts: Parts, mesh: Mesh | None) -> Parts:
    """What one set-up makes of the structure; its own nodes are added to `nodes`."""
    elements, ties, fixed, measured = parts
    given = changes.values(changes_table())
    names = [element.name for _, element in elements] + [tie.name for _, tie in ties]
    names += [one.name for _, one in measured]
    absent = as_list(given.get("without", []))
    for name in absent:
        if name not in names:
            near = difflib.get_close_matches(name, names, 1, 0.0)
            raise changes.error(
                f"there is no element set, tie or measured component {name!r}; the nearest is {near[0]!r}", "without"
            )
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
    elements += _elements(changes, nodes, mesh)
    ties += _ties(changes, nodes)
    if "fixed" in given or "support" in changes.table:
        fixed = _fixed(changes, given.get("fixed", ()), nodes) + read_supports(changes, mesh, nodes)
    return elements, ties, fixed, [pair for pair in measured if pair[1].name not in absent]


def _placed(
    section: Section,
    message: str,
    named: Sequence[tuple[Section, MeasuredComponent | Component | ElementSet | Tie | Base]],
) -> InputError:
    """The error with the place of what its message names, the first of them that it does."""
    for entry, one in named:
        if repr(one.name) in message:
            return entry.error(message)
    for key in ("fixed", "active", "subdivide", "sliding", "damping_ratio", "nodes"):
        if f"`{key}`" in message and key in section.table:
            return section.error(message, key)
    return section.error(message)


def _nodes(
    section: Section,
    groups: list[tuple[Section, MatrixGroup]],
    mesh: Mesh | None = None,
    solved: Solved | None = None,
) -> Positions:
    inner = section.section("nodes")
    if inner is None and mesh is None and solved is not None:
        return positions_of(solved)
    if mesh is not None:
        nodes = {label: position.tolist() for label, position in mesh.nodes.items()}
        return nodes if inner is None else nodes | _besides(inner, _nodes(section, []), mesh)
    if inner is None:
        if groups:
            return {dof.node: [0.0, 0.0, 0.0] for _, group in groups for dof in group.dofs}
        raise section.error("the structure has no nodes; add [structure.nodes] with lines such as `1 = [0.0, 0.0]`")
    if not inner.table:
        raise inner.error("holds no node; add lines such as `1 = [0.0, 0.0]`")
    nodes = {int(key): [float(x) for x in as_list(place)] for key, place in inner.values(_POSITIONS).items()}
    usual = len(next(iter(nodes.values())))
    for label, place in nodes.items():
        if len(place) != usual:
            raise inner.error(f"must have {usual} coordinates like the first node, got {len(place)}", str(label))
    return nodes


def _besides(inner: Section, own: Positions, mesh: Mesh) -> Positions:
    """Nodes beside those of a mesh."""
    for label, position in own.items():
        if label in mesh.nodes:
            raise inner.error(f"is a node of {mesh.source} already; take another number", str(label))
        if len(position) != 3:
            raise inner.error(f"must have 3 coordinates like the mesh, got {len(position)}", str(label))
    return own


def _elements(section: Section, nodes: Positions, mesh: Mesh | None) -> Elements:
    entries = [(entry, kind) for name, kind in ELEMENT_TYPES.items() for entry in section.sections(name)]
    return [(entry, _element(entry, kind, nodes, mesh)) for entry, kind in entries]


def _element(entry: Section, kind: type[ElementSet], nodes: Positions, mesh: Mesh | None = None) -> ElementSet:
    table = element_table(kind, mesh is not None)
    if "subdivide" in entry.table and kind.is_line:
        raise entry.error(
            "is no key of one set; write it in [structure], where it cuts every beam into as many pieces; bars whose pieces"
            " nothing would hold sideways stay whole (make a beam of a bar that is to be cut)",
            "subdivide",
        )
    given = entry.values(table)
    on_mesh = mesh is not None and "nodes" in table.keys and "nodes" not in given
    group = given.pop("group", None)
    if group is not None and not on_mesh:
        raise entry.error("needs a mesh, and no `nodes`; add [structure.mesh], or take one of them out", "group")
    for key in given:
        for text in as_list(given[key]) if table.keys[key].holds in (DOF, DOFS) else ():
            _known_dof(entry, key, text, nodes)
    for node in flat(given.get("nodes", [])):
        _require_node(entry, "nodes", node, nodes)
    if on_mesh:
        assert mesh is not None
        given["nodes"] = group_table(entry, kind, group, mesh)
    with entry.located():
        return kind(**given)


def _require_node(entry: Section, key: str, node: int, nodes: Collection[int]) -> None:
    if node not in nodes:
        near = min(nodes, key=lambda label: (abs(label - node), label))
        raise entry.error(f"node {node} does not exist; the nearest is {near}, or add it to [structure.nodes]", key)


def _known_dof(entry: Section, key: str, text: str | Dof, nodes: Positions) -> Dof:
    """`text` as a degree of freedom of a node that exists."""
    with entry.located(key):
        dof = parse_dof(text)
    _require_node(entry, key, dof.node, nodes)
    return dof


def _fixed(section: Section, texts: str | tuple[str, ...], nodes: Positions) -> list[Dof]:
    found = []
    for text in as_list(texts):
        with section.located("fixed"):
            held = dofs_of_text(text)
        _require_node(section, "fixed", held[0].node, nodes)
        found += held
    return found


def _base(entry: Section, nodes: Positions) -> Base:
    given = entry.values(_BASE)
    supports: list[str | Dof] = []
    for text in as_list(given["supports"]):
        with entry.located("supports"):
            found = dofs_of_text(text)
        supports += [_known_dof(entry, "supports", dof, nodes) for dof in found]
    with entry.located():
        return Base(given["name"], supports)


def _component(entry: Section, nodes: Positions) -> Component:
    given = entry.values(_COMPONENT)
    if "up_to" not in given:
        method = Section(entry.source, (), entry.source.table).inner("method")
        if "band" not in method.table:
            raise entry.error(
                "`up_to` is missing; add `up_to = ...`, Hz, such as three times the highest frequency of the record, or `band`"
                " in [method]"
            )
        band = replace(method, table={"band": method.table["band"]}).values(_BAND)["band"]
        given["up_to"] = _UP_TO * band[1]
    dofs = [
        _known_dof(entry, "interface", dof, nodes)
        for text in as_list(given.get("interface", []))
        for dof in dofs_of_text(text)
    ]
    with entry.located():
        return Component(**{**given, "interface": dofs})


def _measured(entry: Section, files: InputFiles, nodes: Positions) -> MeasuredComponent:
    def known(text: str) -> list[Dof]:
        with entry.located("interface"):
            found = dofs_of_text(text)
        return [_known_dof(entry, "interface", dof, nodes) for dof in found]

    return read_measured(entry, files, known)


def _ties(section: Section, nodes: Positions) -> Ties:
    links = [(entry, _rigid_link(entry, nodes)) for entry in section.sections("rigid_link")]
    return [*links, *((entry, _constraint(entry, nodes)) for entry in section.sections("constraint"))]


def _rigid_link(entry: Section, nodes: Positions) -> Tie:
    given = entry.values(_RIGID_LINK)
    for key in ("main", "dependents"):
        for node in flat(given[key]):
            _require_node(entry, key, node, nodes)
    with entry.located():
        return RigidLink(
            given["name"],
            given["main"],
            flat(given["dependents"]),
            as_list(given["directions"]) if "directions" in given else None,
        )


def _constraint(entry: Section, nodes: Positions) -> Tie:
    given = entry.values(_CONSTRAINT)
    dependent = _known_dof(entry, "dependent", given["dependent"], nodes)
    pairs = [(_known_dof(entry, "depends_on", text, nodes), factor) for text, factor in given["depends_on"]]
    with entry.located():
        return Constraint(given["name"], dependent, pairs)
