"""The ``[structure]`` of a study file as a `Structure`."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Annotated, cast

from structid.core.constraints import Limits, Positive
from structid.core.dof import Dof, dofs_of_text, parse_dof
from structid.core.errors import InputError
from structid.fem import (
    ELEMENT_TYPES,
    Base,
    Component,
    Constraint,
    RigidLink,
    Structure,
    importers,
)
from structid.fem.elements import ElementSet
from structid.fem.structure import MOST_PIECES
from structid.fem.supports import Tie
from structid.study.schema import model
from structid.study.schema.records.sensors import read_sensors
from structid.study.schema.section import InputFiles, Section
from structid.study.schema.tables import (
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
    Given,
    Key,
    Table,
    as_list,
    choice,
    deferred,
    either,
    flat,
    kind_of_argument,
    limit_kind,
    or_none,
    own_table,
    table_of,
)
from structid.unknowns.tolerances import EXACT, Tolerances

if TYPE_CHECKING:
    from structid.external.solved import SolvedModel
    from structid.fem import MatrixGroup, MeasuredComponent
    from structid.fem.meshes import Mesh

    Measured = list[tuple[Section, MeasuredComponent]]
    Parts = tuple["Elements", "Ties", list[Dof], Measured]

Positions = dict[int, list[float]]
Elements = list[tuple[Section, ElementSet]]
Ties = list[tuple[Section, Tie]]
Bases = list[tuple[Section, Base]]
Components = list[tuple[Section, Component]]

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
_NUMBER_OF_PIECES = limit_kind(WHOLE, Limits(least=1, most=MOST_PIECES))
_PIECES = replace(either(_NUMBER_OF_PIECES, choice(AUTO)), words=f'{_NUMBER_OF_PIECES.words}, or "{AUTO}"')
_POSITIONS = Table(labels=POSITION)
_SUPPORT = Key(deferred(lambda: model.SUPPORT), "Nodes that are held at zero", listed=True)
_NODES = Key(_POSITIONS, "One line a node: its label, and one to three coordinates in m")


def leaves_pieces_open(section: Section) -> bool:
    """True if ``[structure]`` leaves it to the error of the mesh into how many pieces beams are cut: no number is stated."""
    return section.table.get("subdivide", AUTO) == AUTO


def structure_table() -> Table:
    """All keys of ``[structure]``."""
    own = {
        "active": Key(TEXTS, "Directions in which the structure can move; by default all of its dimension"),
        "fixed": _FIXED,
        "total_mass": Key(
            kind_of_argument(Positive), "kg, as weighed; a model that differs by more than 10 % is refused"
        ),
        "subdivide": Key(
            _PIECES,
            "Equal pieces of which each beam is made, one element still, and each bar that these leave held sideways; auto"
            " divides them until the mesh moves no value by a fifth of its deviation, 1 keeps them as drawn",
            default=AUTO,
        ),
        "sliding": Key(NODES, "Nodes whose place along their bars and beams is a property, `position` of `node 3`"),
        "damping_ratio": Key(
            kind_of_argument(DampingRatio),
            "Viscous damping of all modes, the property `damping_ratio` of `all modes`; 0.01 is 1 %",
        ),
        "tolerance": Key(
            TOLERANCE,
            "How well fixed values are known, a standard deviation in parts of each: a number for masses and stiffnesses, 0 where"
            " all is exact, or a table of `mass`, `stiffness` and `damping`; 0.01, 0.01 and 0.3 by default",
        ),
        "base": Key(
            _BASE, "Held supports that drive the structure with one motion, as a shaking table does", listed=True
        ),
        "component": Key(_COMPONENT, "Element sets that are reduced to their interface and a few modes", listed=True),
        "measured_component": Key(
            deferred(lambda: model.MEASURED),
            "Parts that have no model but measured FRFs at their interface: machines, mounts, soil",
            listed=True,
        ),
        "nodes": _NODES,
        "mesh": Key(
            deferred(lambda: model.MESH, TEXT),
            "A mesh from a file, or its path where it is in m",
        ),
        "points": Key(
            Table(labels=POSITION), "Places of sensors and loads by label, m; each moves as the nearest node"
        ),
        "support": _SUPPORT,
        "matrices": Key(
            deferred(lambda: model.NUMBERING),
            "What the rows of matrix files stand for, and their units",
        ),
        "matrix_group": Key(deferred(lambda: model.GROUP), "A group of matrices of another code", listed=True),
        "solver": Key(deferred(lambda: model.SOLVER), "A finite element solver, run by structid"),
    }
    return Table(own) | _element_tables() | _TIES


def changes_table() -> Table:
    """All keys of ``[record.structure]``."""
    own = {
        "fixed": _FIXED,
        "without": Key(TEXTS, "Element sets, ties and measured components that were not there"),
        "nodes": _NODES,
        "support": _SUPPORT,
    }
    return Table(own) | _element_tables() | _TIES


def _element_tables() -> dict[str, Key]:
    """A key for each element type; the module of a type loads where a study has elements of it."""
    return {name: _element_key(name) for name in ELEMENT_TYPES}


def _element_key(name: str) -> Key:
    def first_line() -> str:
        return (inspect.getdoc(ELEMENT_TYPES[name]) or "").partition("\n")[0]

    return Key(deferred(lambda: element_table(ELEMENT_TYPES[name])), first_line, listed=True)


def element_table(kind: type[ElementSet], on_mesh: bool = True) -> Table:
    """All keys of the element type `kind`.

    With `on_mesh`, a type that has nodes may leave ``nodes`` out. Its key ``group`` names cells of the mesh in their
    place.
    """
    table = own_table(kind)
    if "nodes" not in table.keys:
        return table
    nodes = table.keys["nodes"]
    words = "In place of `nodes`: a group of cells of the mesh (of nodes, for masses); without both, all cells"
    return table | {"nodes": replace(nodes, required=not on_mesh), "group": Key(TEXT, words)}


def read_tolerances(section: Section) -> Tolerances:
    """The tolerances of fixed values that ``[structure]`` states, as one number for all kinds or by kind.

    Kinds that are not stated have the defaults. One number holds for masses and stiffnesses, 0 also for dampings. The
    calibration of records keeps its default.

    Raises
    ------
    StudyError
        If it names another kind than masses, stiffnesses and dampings.
    """
    stated = section.table.get("tolerance")
    if stated is None:
        return Tolerances()
    if not isinstance(stated, Mapping):
        part = float(cast(float, stated))
        return replace(EXACT, calibration=Tolerances().calibration) if part == 0 else Tolerances(part, part)
    kinds = [item.name for item in fields(Tolerances) if item.name != "calibration"]
    for name in stated:
        if name not in kinds:
            raise section.error(
                f"`tolerance` takes {', '.join(kinds)}, got {name!r}; state it in the element set", "tolerance"
            )
    return Tolerances(**cast(dict[str, float], stated))


def read_structure(
    section: Section, files: InputFiles, changes: Section | None = None, record: Section | None = None
) -> Structure:
    """The structure that `section` describes.

    Parameters
    ----------
    section : Section
        ``[structure]``.
    files : InputFiles
        List of input files, to which mesh, matrix and measured files are added.
    changes : Section, optional
        ``[record.structure]``: element sets, nodes and ties that one set-up has in addition, those that it is `without`, and
        what is `fixed` instead.
    record : Section, optional
        ``[record]``, whose ``[record.sensors]`` may have nodes of their own.

    Raises
    ------
    StudyError
        If a key, a file or an entry cannot be used; with its place in the study.
    """
    given = section.values(structure_table())
    groups: list[tuple[Section, MatrixGroup]] = []
    constrained: list[Dof] = []
    mesh, solved = None, None
    if "matrices" in section.table or "matrix_group" in section.table:
        groups, constrained = model.read_groups(section, files)
    if "mesh" in section.table:
        mesh = model.read_structure_mesh(section, files)
    if "solver" in section.table:
        solved = model.read_solver(section, files)
    nodes = _read_nodes(section, groups, mesh, solved)
    elements = _elements(section, nodes, mesh)
    elements.extend(groups)
    if solved is not None:
        elements.append((section.inner("solver"), solved.model))
        constrained = [*constrained, *solved.constrained]
    if not elements:
        kinds = ", ".join(f"[[structure.{kind}]]" for kind in ELEMENT_TYPES)
        raise section.error(f"the structure has no elements; add some of {kinds} or [[structure.matrix_group]]")
    ties = _ties(section, nodes)
    if solved is not None:
        ties += [(section.inner("solver"), tie) for tie in solved.ties]
    left_aside: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    if mesh is not None:
        model.require_all_assigned(section, mesh, [element for _, element in elements])
        taken = model.take_parts(section, mesh, [element for _, element in elements])
        deck = section if isinstance(section.table["mesh"], str) else section.inner("mesh")
        elements += [(deck, element) for element in taken.elements]
        ties += [(deck, tie) for tie in taken.ties]
        left_aside, notes = taken.left_aside, taken.notes
    if "points" in section.table:
        for entry, point in model.read_points(section, mesh, [element for _, element in elements]):
            nodes[point.label] = list(nodes[point.node])
            ties.append((entry, point))
    fixed = _read_fixed(section, given.get("fixed", ()), nodes) + _read_supports(section, mesh, nodes)
    bases = [(entry, _read_base(entry, nodes)) for entry in section.sections("base")]
    components = [(entry, _read_component(entry, nodes)) for entry in section.sections("component")]
    measured = [
        (entry, _read_measured_component(entry, files, nodes)) for entry in section.sections("measured_component")
    ]
    if "total_mass" in given:
        whole = _make_structure(section, nodes, (elements, ties, [*fixed, *constrained], []), bases, [], given)
        with section.located("total_mass"):
            importers.require_total_mass(whole.mass_of(), given["total_mass"], "; ".join(left_aside))
    if changes is not None:
        elements, ties, fixed, measured = _apply_changes(changes, nodes, (elements, ties, fixed, measured), mesh)
    aims = record is not None and "sensors" in record.table
    parts = elements, ties, [*fixed, *constrained], measured
    file_words = left_aside, notes
    structure = _make_structure(section, nodes, parts, bases, [] if aims else components, given, file_words)
    if record is not None and aims:
        aimed = read_sensors(record, nodes, structure)
        for entry, sensor in aimed:
            nodes.setdefault(sensor.label, nodes[sensor.node])
            ties.append((entry, sensor))
        structure = _make_structure(section, nodes, parts, bases, components, given, file_words)
    if structure.n_dofs == 0:
        raise section.error("no degree of freedom is free; take some out of `fixed` or add to `active`")
    return structure


def _make_structure(
    section: Section,
    nodes: Positions,
    parts: Parts,
    bases: Bases,
    components: Components,
    options: Given,
    file_words: tuple[tuple[str, ...], tuple[str, ...]] = ((), ()),
) -> Structure:
    """The structure of the parts that were read; an error gets the place of the part that its message names.

    `parts` are elements, ties, fixed degrees of freedom and measured components. `options` are the plain values of
    ``[structure]``; `file_words` are texts on parts of the mesh file that were left aside, and notes on it. Beams are
    not cut unless ``subdivide`` is a number.
    """
    elements, ties, fixed, measured = parts
    active = as_list(options["active"]) if "active" in options else None
    element_sets, links = [element for _, element in elements], [tie for _, tie in ties]
    try:
        drives, sliding = [base for _, base in bases], flat(options.get("sliding", []))
        inner = [component for _, component in components]
        pieces, ratio = options.get("subdivide", AUTO), options.get("damping_ratio")
        pieces = 1 if pieces == AUTO else pieces  # as drawn, until an answer shows what the mesh moves
        return Structure(
            nodes,
            element_sets,
            fixed,
            links,
            active,
            pieces,
            drives,
            sliding,
            inner,
            ratio,
            [component for _, component in measured],
            *file_words,
        )
    except InputError as error:
        raise _error_at_part(section, str(error), [*measured, *components, *elements, *ties, *bases]) from error


def _apply_changes(changes: Section, nodes: Positions, parts: Parts, mesh: Mesh | None) -> Parts:
    """The parts of the structure as ``[record.structure]`` of one set-up changes them.

    Its own nodes are added to `nodes`. Sets, ties and measured components named in ``without`` are left out, further
    ones added; ``fixed`` or ``support`` replaces all fixed degrees of freedom. `mesh` is None if the study has none.
    `StudyError` for an unknown name or a node that is there already.
    """
    elements, ties, fixed, measured = parts
    values = changes.values(changes_table())
    names = [element.name for _, element in elements] + [tie.name for _, tie in ties]
    names += [component.name for _, component in measured]
    absent = as_list(values.get("without", []))
    for name in absent:
        if name not in names:
            nearest = difflib.get_close_matches(name, names, 1, 0.0)
            raise changes.error(
                f"there is no element set, tie or measured component {name!r}; the nearest is {nearest[0]!r}", "without"
            )
    if changes.section("nodes") is not None:
        size = len(next(iter(nodes.values())))
        for label, position in _read_nodes(changes, []).items():
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
    if "fixed" in values or "support" in changes.table:
        fixed = _read_fixed(changes, values.get("fixed", ()), nodes) + _read_supports(changes, mesh, nodes)
    return elements, ties, fixed, [pair for pair in measured if pair[1].name not in absent]


def _error_at_part(
    section: Section,
    message: str,
    named: Sequence[tuple[Section, MeasuredComponent | Component | ElementSet | Tie | Base]],
) -> InputError:
    """An error with `message` and the place in the study of the first part, else of the key, that the message names.

    `named` are the parts of the structure, each with its section; `section` is ``[structure]``, which is named alone if
    nothing fits.
    """
    for entry, part in named:
        if repr(part.name) in message:
            return entry.error(message)
    for key in ("fixed", "active", "subdivide", "sliding", "damping_ratio", "nodes"):
        if f"`{key}`" in message and key in section.table:
            return section.error(message, key)
    return section.error(message)


def _read_nodes(
    section: Section,
    groups: list[tuple[Section, MatrixGroup]],
    mesh: Mesh | None = None,
    solved: SolvedModel | None = None,
) -> Positions:
    """Positions in m by node label, from the mesh, ``[structure.nodes]``, or else the solver or the matrix groups.

    A mesh may have further nodes in ``[structure.nodes]``. Nodes of matrix groups are all at the origin. `mesh` and
    `solved` are None if the study has none. `StudyError` without any node, or with different numbers of coordinates.
    """
    inner = section.section("nodes")
    if inner is None and mesh is None and solved is not None:
        return model.positions_of(solved)
    if mesh is not None:
        nodes = {label: position.tolist() for label, position in mesh.nodes.items()}
        return nodes if inner is None else nodes | _check_beside_mesh(inner, _read_nodes(section, []), mesh)
    if inner is None:
        if groups:
            return {dof.node: [0.0, 0.0, 0.0] for _, group in groups for dof in group.dofs}
        raise section.error("the structure has no nodes; add [structure.nodes] with lines such as `1 = [0.0, 0.0]`")
    if not inner.table:
        raise inner.error("holds no node; add lines such as `1 = [0.0, 0.0]`")
    nodes = {int(key): [float(x) for x in as_list(position)] for key, position in inner.values(_POSITIONS).items()}
    usual = len(next(iter(nodes.values())))
    for label, position in nodes.items():
        if len(position) != usual:
            raise inner.error(f"must have {usual} coordinates like the first node, got {len(position)}", str(label))
    return nodes


def _check_beside_mesh(inner: Section, positions: Positions, mesh: Mesh) -> Positions:
    """The nodes `positions` of the study, returned unchanged after a check that labels are new and have three coordinates."""
    for label, position in positions.items():
        if label in mesh.nodes:
            raise inner.error(f"is a node of {mesh.source} already; take another number", str(label))
        if len(position) != 3:
            raise inner.error(f"must have 3 coordinates like the mesh, got {len(position)}", str(label))
    return positions


def _elements(section: Section, nodes: Positions, mesh: Mesh | None) -> Elements:
    entries = [(entry, ELEMENT_TYPES[name]) for name in ELEMENT_TYPES for entry in section.sections(name)]
    return [(entry, _read_element(entry, kind, nodes, mesh)) for entry, kind in entries]


def _read_element(entry: Section, kind: type[ElementSet], nodes: Positions, mesh: Mesh | None = None) -> ElementSet:
    """The element set of the class `kind` that one entry describes.

    Its nodes are those in the entry, or else those of a group of the mesh or of all its cells. `mesh` is None if the
    study has none. `StudyError` for a node that does not exist, or a key that does not fit.
    """
    table = element_table(kind, mesh is not None)
    if "subdivide" in entry.table and kind.is_line:
        raise entry.error(
            "is no key of one set; write it in [structure], where it cuts every beam into as many pieces; bars whose pieces"
            " nothing would hold sideways stay whole (make a beam of a bar that is to be cut)",
            "subdivide",
        )
    values = entry.values(table)
    on_mesh = mesh is not None and "nodes" in table.keys and "nodes" not in values
    group = values.pop("group", None)
    if group is not None and not on_mesh:
        raise entry.error("needs a mesh, and no `nodes`; add [structure.mesh], or take one of them out", "group")
    for key in values:
        for text in as_list(values[key]) if table.keys[key].holds in (DOF, DOFS) else ():
            _known_dof(entry, key, text, nodes)
    for node in flat(values.get("nodes", [])):
        _require_node(entry, "nodes", node, nodes)
    if on_mesh:
        assert mesh is not None
        values["nodes"] = model.group_table(entry, kind, group, mesh)
    with entry.located():
        return kind(**values)


def _require_node(entry: Section, key: str, node: int, nodes: Collection[int]) -> None:
    if node not in nodes:
        near = min(nodes, key=lambda label: (abs(label - node), label))
        raise entry.error(f"node {node} does not exist; the nearest is {near}, or add it to [structure.nodes]", key)


def _known_dof(entry: Section, key: str, text: str | Dof, nodes: Positions) -> Dof:
    """The degree of freedom that `text` names, after a check that its node exists, else `StudyError`.

    `key` is named in errors.
    """
    with entry.located(key):
        dof = parse_dof(text)
    _require_node(entry, key, dof.node, nodes)
    return dof


def _read_fixed(section: Section, texts: str | tuple[str, ...], nodes: Positions) -> list[Dof]:
    """Degrees of freedom of the texts in `fixed`, such as "1" (all directions of node 1) or "2 Z RX", in their order.

    `StudyError` if a text cannot be read, or its node is not in `nodes`.
    """
    dofs = []
    for text in as_list(texts):
        with section.located("fixed"):
            of_text = dofs_of_text(text)
        _require_node(section, "fixed", of_text[0].node, nodes)
        dofs += of_text
    return dofs


def _read_supports(section: Section, mesh: Mesh | None, nodes: Positions) -> list[Dof]:
    """Degrees of freedom that the ``[[structure.support]]`` tables fix; none where there are no such tables."""
    return model.read_supports(section, mesh, nodes) if "support" in section.table else []


def _read_base(entry: Section, nodes: Positions) -> Base:
    """The base of one ``[[structure.base]]`` table: supports that move together.

    `StudyError` if the node of a support is not in `nodes`.
    """
    values = entry.values(_BASE)
    supports: list[str | Dof] = []
    for text in as_list(values["supports"]):
        with entry.located("supports"):
            dofs = dofs_of_text(text)
        supports += [_known_dof(entry, "supports", dof, nodes) for dof in dofs]
    with entry.located():
        return Base(values["name"], supports)


def _read_component(entry: Section, nodes: Positions) -> Component:
    """The component, a substructure to be reduced, that one ``[[structure.component]]`` table describes.

    Without ``up_to`` its frequency limit in Hz is three times the upper end of the band. `StudyError` without either,
    or if a node of the interface does not exist.
    """
    values = entry.values(_COMPONENT)
    if "up_to" not in values:
        method = Section(entry.source, (), entry.source.table).inner("method")
        if "band" not in method.table:
            raise entry.error(
                "`up_to` is missing; add `up_to = ...`, Hz, such as three times the highest frequency of the record, or `band`"
                " in [method]"
            )
        band = replace(method, table={"band": method.table["band"]}).values(_BAND)["band"]
        values["up_to"] = _UP_TO * band[1]
    dofs = [
        _known_dof(entry, "interface", dof, nodes)
        for text in as_list(values.get("interface", []))
        for dof in dofs_of_text(text)
    ]
    with entry.located():
        return Component(**{**values, "interface": dofs})


def _read_measured_component(entry: Section, files: InputFiles, nodes: Positions) -> MeasuredComponent:
    """The measured component of one entry, after a check that the nodes of its interface exist, else `StudyError`."""

    def known(text: str) -> list[Dof]:
        with entry.located("interface"):
            dofs = dofs_of_text(text)
        return [_known_dof(entry, "interface", dof, nodes) for dof in dofs]

    return model.read_measured(entry, files, known)


def _ties(section: Section, nodes: Positions) -> Ties:
    links = [(entry, _read_rigid_link(entry, nodes)) for entry in section.sections("rigid_link")]
    return [*links, *((entry, _read_constraint(entry, nodes)) for entry in section.sections("constraint"))]


def _read_rigid_link(entry: Section, nodes: Positions) -> Tie:
    """The rigid link of one ``[[structure.rigid_link]]`` table; `StudyError` if one of its nodes is not in `nodes`."""
    values = entry.values(_RIGID_LINK)
    for key in ("main", "dependents"):
        for node in flat(values[key]):
            _require_node(entry, key, node, nodes)
    with entry.located():
        return RigidLink(
            values["name"],
            values["main"],
            flat(values["dependents"]),
            as_list(values["directions"]) if "directions" in values else None,
        )


def _read_constraint(entry: Section, nodes: Positions) -> Tie:
    """The multi-point constraint of one entry: a dependent degree of freedom as a sum of others times factors.

    `StudyError` if a node is not in `nodes`.
    """
    values = entry.values(_CONSTRAINT)
    dependent = _known_dof(entry, "dependent", values["dependent"], nodes)
    pairs = [(_known_dof(entry, "depends_on", text, nodes), factor) for text, factor in values["depends_on"]]
    with entry.located():
        return Constraint(values["name"], dependent, pairs)
