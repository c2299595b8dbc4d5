"""Abaqus and CalculiX input files as meshes: nodes, elements, sets and section offsets, flat files and assemblies."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.meshes.abaqus_assembly import ONE_LINE, Assembly, PartData
from structid.fem.meshes.abaqus_keywords import KeywordBlock, keyword_blocks, number_of, numbers_of, spelled_out
from structid.fem.meshes.abaqus_parts import displacement_axes, is_part, read_parts
from structid.fem.meshes.abaqus_surfaces import Surfaces
from structid.fem.meshes.coordinate_systems import unit_normals
from structid.fem.meshes.deck_parts import CellOffsets, DeckPart, DeckUnits, split_by_obstacle
from structid.fem.meshes.mesh import CellBlock, Mesh

#: Numbers of nodes of elements that are no cells; others run on where a line ends in a comma. Connectors with one node have the
#: ground at the other end.
_NODES_BESIDE = {
    **dict.fromkeys(("SPRING1", "DASHPOT1", "HEATCAP"), 1),
    **dict.fromkeys(("SPRING2", "SPRINGA", "DASHPOT2", "DASHPOTA"), 2),
    **dict.fromkeys(("CONN3D2", "CONN2D2", "JOINTC"), ONE_LINE),
}
_KINDS = (
    (r"C3D4", "tetra", 4),
    (r"C3D5", "pyramid", 5),
    (r"C3D10", "tetra10", 10),
    (r"C3D6", "wedge", 6),
    (r"C3D15", "wedge15", 15),
    (r"C3D8", "hexahedron", 8),
    (r"C3D20", "hexahedron20", 20),
    (r"C3D27", "hexahedron27", 27),
    (r"(CPS|CPE|CPEG|M3D|S|STRI|R3D)3", "triangle", 3),
    (r"(CPS|CPE|CPEG|M3D|S|R3D)4", "quad", 4),
    (r"(CPS|CPE|CPEG|M3D|S|STRI)(6|65)", "triangle6", 6),
    (r"(CPS|CPE|CPEG|M3D|S)8", "quad8", 8),
    (r"(M3D|S)9", "quad9", 9),
    (r"(B21|B23|B31|B33|T2D2|T3D2)", "line", 2),
    (r"(B22|B32|T2D3|T3D3)", "line3", 3),
    (r"MASS|ROTARYI", "vertex", 1),
)
#: Where Abaqus numbers the middles of volume, faces and lines in another order than VTK.
_ORDERS = {"hexahedron27": (*range(20), 26, 24, 23, 25, 21, 22, 20), "line3": (0, 2, 1)}
#: Keywords that make nodes or elements by rule: what they say is not read.
_REFUSED = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SUBSTRUCTURE PATH", "IMPORT")
#: Keywords that make the mesh: a <name> of *PARAMETER among their words is refused. Of other keywords it makes an obstacle.
_OF_MESH = ("NODE", "ELEMENT", "NSET", "ELSET", "SYSTEM", "TRANSFORM", "INSTANCE")
_SECTIONS = ("SHELL SECTION", "SHELL GENERAL SECTION", "BEAM SECTION", "BEAM GENERAL SECTION")
_SIDES = {"SPOS": 0.5, "SNEG": -0.5, "MIDDLE": 0.0}
#: Cosine of the angle between normals of cells at a node up to which solvers take the mean of them.
_SMOOTH = np.cos(np.radians(20.0))


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of an Abaqus input file in SI units, with what it has beside its cells.

    Instances stand where the assembly puts them. Labels are those of the parts; where those of several instances
    repeat, the second has a power of ten added, the third twice that. Nodes of the assembly itself that no cell uses
    are no part of the mesh, but of what works on them.

    Raises
    ------
    FileError
        If it has several parts with the same numbers and no instances, or keywords that make nodes by rule.
    """
    assembly = _Reader(path).read()
    return _make_mesh(path, assembly, units)


class _Reader:
    """Parts, instances and the assembly of a file, one keyword after another."""

    def __init__(self, path: Path) -> None:
        """A reader of the input file at `path` that has read nothing yet: no parts, an empty assembly."""
        self._path = path
        self._root, self._parts = PartData(), dict[str, PartData]()
        self._assembly = Assembly([])
        self._scope = self._root
        self._placing: list[list[str]] = []
        self._owners: dict[str, str] = {}

    def read(self) -> Assembly:
        """Read all keywords of the file and return the assembly of its instances.

        Raises `FileError`, with the line, for a keyword that is not read or whose lines cannot be read, and if there
        are no nodes or elements.
        """
        for block in keyword_blocks(self._path):
            if block.keyword in _REFUSED:
                raise FileError(
                    f"{self._path}, line {block.line}: *{block.keyword} is not read; write the mesh with all nodes and elements"
                )
            if block.keyword in _OF_MESH and (name := _parameter_name(block)):
                raise FileError(
                    f"{self._path}, line {block.line}: *{block.keyword} has {name}, and *PARAMETER is not evaluated; write numbers"
                    " in place of the <names>"
                )
            if full := spelled_out(block.keyword):
                raise FileError(
                    f"{self._path}, line {block.line}: *{block.keyword} is short for *{full}; write it in full"
                )
            try:
                self._take_keyword(block)
            except (ValueError, KeyError) as error:
                raise FileError(
                    f"{self._path}, line {block.line}: cannot read the lines of *{block.keyword} ({error}); export it again"
                ) from error
        return self._finish()

    def _take_keyword(self, block: KeywordBlock) -> None:
        """Take up a keyword: enter or leave a part, an instance or the assembly, or add its data to the current one.

        The state of the reader changes. Raises `ValueError` or `KeyError` if the lines of the keyword cannot be read.
        """
        assembly_part, name = self._assembly.own, block.options.get("NAME", "")
        if block.keyword == "PART":
            self._scope = self._parts.setdefault(name.upper(), PartData(name))
        elif block.keyword == "ASSEMBLY":
            self._assembly.own = self._scope = PartData()
        elif block.keyword == "INSTANCE":
            self._begin_instance(block, name)
        elif block.keyword == "END INSTANCE":
            self._scope.move(self._placing)
            self._scope = assembly_part if assembly_part is not None else self._root
        elif block.keyword in ("END PART", "END ASSEMBLY"):
            self._scope = self._root
        elif self._scope is assembly_part and assembly_part is not None and block.keyword in ("NSET", "ELSET"):
            self._assembly.take_set(block)
        else:
            self._scope.take(block, _node_counts(block))

    def _begin_instance(self, block: KeywordBlock, name: str) -> None:
        """Enter an instance called `name`, with a copy of the mesh of the part that the keyword `block` names.

        Its data lines, which say where it stands, are applied at its end. Raises `ValueError` if it is imported, or its
        part has not been read.
        """
        if "LIBRARY" in block.options or "INSTANCE" in block.options:
            raise ValueError("it is imported from another analysis; write its mesh into the file")
        part = block.options.get("PART", "")
        if part and part.upper() not in self._parts:
            raise ValueError(f"there is no part {part!r} before this line")
        instance = self._parts[part.upper()].instance(name) if part else PartData(name)
        self._assembly.scopes.append(instance)
        self._scope, self._placing = instance, block.rows
        self._owners[name.upper()] = part or name

    def _finish(self) -> Assembly:
        """The assembly when all keywords were read, with the labels of its instances shifted where they repeat.

        A flat file, or parts without instances, become a single unnamed instance. Raises `FileError` if nodes repeat
        between parts without instances, or there are no nodes or elements.
        """
        if not self._assembly.scopes:
            for part in self._parts.values():
                for field in ("nodes", "elements"):
                    mine, theirs = getattr(self._root, field), getattr(part, field)
                    for key in set(mine) & set(theirs) if field == "nodes" else ():
                        raise FileError(
                            f"{self._path}: node {key} stands twice, in several parts, and no *INSTANCE says where they are"
                        )
                    mine.update(theirs)
                for sets in ("node_sets", "cell_sets", "names"):
                    getattr(self._root, sets).update(getattr(part, sets))
                self._root.blocks.extend(part.blocks)
                self._root.overlong |= part.overlong
                self._root.unsorted |= part.unsorted
                self._root.ranges += part.ranges
            self._assembly.scopes.append(self._root)
        else:  # what stands behind the assembly works on the whole model
            assembly_part = self._assembly.own = self._assembly.own or PartData()
            assembly_part.blocks.extend(self._root.blocks)
        if not any(scope.nodes and scope.elements for scope in self._assembly.scopes):
            raise FileError(f"{self._path}: holds no *NODE and *ELEMENT lines; export the mesh, not only the steps")
        self._assembly.owners = self._owners if len(self._assembly.scopes) == 1 else {}
        self._assembly.number()
        self._assembly.unknown = self._assembly.drop_unknown()
        return self._assembly


def _parameter_name(block: KeywordBlock) -> str:
    """The first word of a keyword that is a name of *PARAMETER, such as ``<width>``; "" if there is none."""
    words = (word for row in (list(block.options.values()), *block.rows) for word in row)
    return next((word for word in words if word.startswith("<")), "")


def _node_counts(block: KeywordBlock) -> Mapping[str, int]:
    kind = block.options.get("TYPE", "").upper()
    return {kind: _NODES_BESIDE.get(kind) or _kind(kind)[1]} if block.keyword == "ELEMENT" else {}


def _kind(name: str) -> tuple[str, int]:
    """Cell type and number of nodes of the Abaqus element type `name`; `name` and 0 if structid does not know it."""
    for pattern, kind, count in _KINDS:
        if re.fullmatch(rf"{pattern}[A-Z]*5?", name.upper()):
            return kind, count
    return name, 0


def _make_mesh(path: Path, assembly: Assembly, units: DeckUnits) -> Mesh:
    """The mesh of an assembly: nodes, cells, groups, parts beside the cells and displacement axes, in SI units.

    `units` are those of the file. Raises `FileError`, which names `path`, if nodes of an element or a *TRANSFORM cannot
    be read.
    """
    tables: dict[tuple[str, int, bool], dict[int, list[int]]] = {}
    for scope in assembly.all_scopes:
        for name, table in scope.elements.items():
            if scope is assembly.own and is_part(name):
                continue  # masses and springs of the assembly do not make a node one of the mesh
            kind = _kind(name)[0]
            for label, words in table.items():
                try:
                    nodes = [assembly.node(scope, word) for word in words]
                except ValueError as error:
                    raise FileError(
                        f"{path}: the nodes of element {label} ({name}) cannot be read ({error})"
                    ) from error
                key = (kind, len(nodes), is_part(name))
                tables.setdefault(key, {})[label + assembly.shift(scope)] = nodes
    blocks, rows_of = [], []
    for (kind, width, is_beside), nodes_by_label in tables.items():
        rows = np.array(list(nodes_by_label.values()), dtype=np.int64).reshape(len(nodes_by_label), width)
        blocks.append(CellBlock(kind, rows[:, list(_ORDERS.get(kind, range(width)))], is_beside))
        rows_of.append({label: row for row, label in enumerate(nodes_by_label)})
    labels, positions = _mesh_nodes(assembly, blocks, units.length)
    nodes_of = dict(zip(labels.tolist(), positions, strict=True))
    points = _reference_points(assembly, units.length)
    axes = displacement_axes(path, assembly, nodes_of | points, units.length)
    parts = read_parts(path, assembly, nodes_of | points, axes, units, Surfaces(assembly, _kind))
    parts += _SectionOffsets(assembly, blocks, rows_of, nodes_of | points, units.length).parts()
    return Mesh(
        labels,
        positions,
        tuple(blocks),
        _cell_groups(assembly, rows_of),
        _node_groups(assembly),
        path.name,
        tuple(parts),
        _notes(assembly, axes),
        axes,
        cells_are_elements=True,
        points=points,
    )


def _mesh_nodes(assembly: Assembly, blocks: Iterable[CellBlock], factor: float) -> tuple[IntArray, FloatArray]:
    """Labels (n,) and positions (n, 3), m, of the nodes of instances, and of those of the assembly that cells use.

    `blocks` are the cells; `factor` turns lengths of the file into m.
    """
    labels: list[int] = []
    positions: list[list[float]] = []
    for scope in assembly.scopes:
        labels += [label + assembly.shift(scope) for label in scope.nodes]
        positions += scope.nodes.values()
    if assembly.own is not None and assembly.own.nodes:
        used = {int(n) for block in blocks for n in np.unique(block.nodes)}
        for label, position in assembly.own.nodes.items():
            if label + assembly.shift(assembly.own) in used:
                labels.append(label + assembly.shift(assembly.own))
                positions.append(position)
    return np.array(labels, dtype=np.int64), factor * np.array(positions, dtype=np.float64)


def _reference_points(assembly: Assembly, factor: float) -> dict[int, FloatArray]:
    """Positions (3,) in m of the nodes of the assembly itself (reference points), by label in the mesh.

    Empty without an assembly. `factor` turns lengths of the file into m.
    """
    assembly_part = assembly.own
    if assembly_part is None:
        return {}
    return {
        label + assembly.shift(assembly_part): factor * np.array(position)
        for label, position in assembly_part.nodes.items()
    }


def _cell_groups(assembly: Assembly, rows_of: list[dict[int, int]]) -> dict[str, tuple[IntArray, ...]]:
    """Cells of each element set, by its name: one array of row indices for each cell block.

    `rows_of` maps element labels to rows in each block.
    """
    return {
        name: tuple(_rows_of_members(members, rows) for rows in rows_of)
        for name, members in _members_of_sets(assembly, False).items()
    }


def _node_groups(assembly: Assembly) -> dict[str, IntArray]:
    return {
        name: np.array(sorted(members), dtype=np.int64) for name, members in _members_of_sets(assembly, True).items()
    }


def _members_of_sets(assembly: Assembly, is_nodes: bool) -> dict[str, set[int]]:
    """Labels in the mesh of the members of each set of an assembly, by name: node sets if `is_nodes`, or of elements.

    A set of an instance is called INSTANCE.SET where there are several instances or the assembly has a set of that name
    (of a single instance PART.SET too). The bare name is then the set of the assembly, or that of all instances
    together.
    """
    shared = assembly.node_sets if is_nodes else assembly.cell_sets
    sets: dict[str, set[int]] = {}
    for scope in assembly.scopes:
        for key, members in (scope.node_sets if is_nodes else scope.cell_sets).items():
            labels = {label + assembly.shift(scope) for label in members}
            owners = dict.fromkeys([assembly.owners.get(scope.name.upper(), scope.name), scope.name])
            taken = key in shared or (assembly.own is not None and key in assembly.own.names)
            if len(assembly.scopes) > 1 or taken:
                sets |= {f"{owner}.{scope.names[key]}": labels for owner in owners}
            if not taken:
                name = next((name for name in sets if name.upper() == key), scope.names[key])
                sets[name] = sets.get(name, set()) | labels
    assembly_part = assembly.own
    if assembly_part is not None:
        for key, by_owner in shared.items():
            sets[assembly_part.names[key]] = {
                label + assembly.shifts[owner] for owner, labels in by_owner.items() for label in labels
            }
        for key, members in (assembly_part.node_sets if is_nodes else assembly_part.cell_sets).items():
            labels = {label + assembly.shift(assembly_part) for label in members}
            sets[assembly_part.names[key]] = sets.get(assembly_part.names[key], set()) | labels
    return {name: members for name, members in sets.items() if name}


def _rows_of_members(members: set[int], rows: dict[int, int]) -> IntArray:
    return np.array(sorted(rows[label] for label in members if label in rows), dtype=np.int64)


def _notes(assembly: Assembly, axes: Mapping[int, FloatArray]) -> tuple[str, ...]:
    """Sentences on what was changed or not read: sets, supports, overlong lines, shifted numbers, turned directions.

    `assembly` is the whole file, `axes` are the directions of motion (3, 3) of nodes that have their own, by label.
    Empty if there is nothing to say.
    """
    notes = list(assembly.unknown)
    scopes = assembly.all_scopes
    if any(block.keyword == "BOUNDARY" for scope in scopes for block in scope.blocks):
        notes.append("its *BOUNDARY is not read: supports are those of the study")
    overlong = sorted({kind for scope in scopes for kind in scope.overlong})
    if overlong:
        notes.append(
            f"lines of {', '.join(overlong)} name more nodes than it has: the first are taken, as CalculiX does"
        )
    moved = [scope for scope in assembly.scopes if assembly.shift(scope)]
    if moved:
        words = ", ".join(f"{scope.name} {assembly.shift(scope):+d}" for scope in moved[:5])
        notes.append(f"node and element numbers repeat between instances, so that they are shifted: {words}")
    if axes:
        few = ", ".join(map(str, sorted(axes)[:5]))
        more = f" and {len(axes) - 5} more" if len(axes) > 5 else ""
        notes.append(f"nodes {few}{more} have directions of their own (*TRANSFORM); directions here are global")
    return tuple(notes)


class _SectionOffsets:
    """Offsets of the sections of an input file.

    Parameters
    ----------
    assembly : Assembly
    blocks : sequence of CellBlock
    rows_of : sequence of dict of label to row
        Cells of each block.
    positions : mapping of label to position in m
    length : float
        Unit of the file, m.
    """

    def __init__(
        self,
        assembly: Assembly,
        blocks: Sequence[CellBlock],
        rows_of: Sequence[Mapping[int, int]],
        positions: Mapping[int, FloatArray],
        length: float,
    ) -> None:
        self._assembly, self._blocks, self._rows_of = assembly, blocks, rows_of
        self._positions, self._length = positions, length

    def parts(self) -> list[DeckPart]:
        """Deck parts of the offsets by kind of section, apart for those that cannot be read, then centroids of beams.

        Parts that cannot be taken say why in `obstacle`; centroids and shear centres of beams are one such part. Empty
        without any.
        """
        parts = []
        every = self._assembly.all_scopes
        for keyword in _SECTIONS:
            kind = f"{keyword} OFFSET"
            items = []
            for scope in every:
                for block in scope.blocks:
                    if block.keyword == keyword and _is_offset(block):
                        try:
                            items.append(("", DeckPart(kind, 1, offsets=tuple(self._offsets(scope, block)))))
                        except (ValueError, IndexError, KeyError) as error:
                            items.append((str(error), DeckPart(kind, 1)))
            parts += split_by_obstacle(kind, items)
        count = sum(block.keyword in ("CENTROID", "SHEAR CENTER") for scope in every for block in scope.blocks)
        return [*parts, *([DeckPart("BEAM CENTROID", count, obstacle="move the nodes")] if count else [])]

    def _offsets(self, scope: PartData, block: KeywordBlock) -> list[CellOffsets]:
        """The offsets of the cells of one section block, one `CellOffsets` for each block of cells that has some.

        Each has the index of the cell block, the rows of the cells, and arms in m from the nodes to where the cell
        lies, (n_cells, n_nodes, 3). `scope` is the part or assembly in which the section stands. Raises `ValueError` if
        there is no such element set, its cells cannot have offsets, or the offsets cannot be read.
        """
        members = self._members(scope, block.options.get("ELSET", ""))
        chosen = []
        for index, rows_of in enumerate(self._rows_of):
            rows = np.array(sorted(rows_of[label] for label in members if label in rows_of), dtype=np.int64)
            if len(rows):
                chosen.append((index, rows))
        is_shell = block.keyword.startswith("SHELL")
        kinds = {self._blocks[index].kind for index, _ in chosen}
        if not kinds <= ({"triangle", "quad"} if is_shell else {"line"}):
            raise ValueError(f"no element for its cells ({', '.join(sorted(kinds))})")
        if is_shell:
            return self._shell_offsets(block, chosen)
        return [self._beam_offsets(scope, block, index, rows) for index, rows in chosen]

    def _members(self, scope: PartData, name: str) -> set[int]:
        """Labels in the mesh of the elements of the set `name`; raises `ValueError` if there are none.

        `scope` is the part or assembly in which the name is looked up; one of the assembly may hold elements of several
        instances.
        """
        key, labels = name.upper(), set[int]()
        by_owner = self._assembly.cell_sets.get(key, {}) if scope is self._assembly.own else {}
        for owner, members in by_owner.items():
            labels |= {label + self._assembly.shifts[owner] for label in members}
        labels |= {label + self._assembly.shift(scope) for label in scope.cell_sets.get(key, set())}
        if not labels:
            raise ValueError(f"there is no element set {name!r}")
        return labels

    def _shell_offsets(self, block: KeywordBlock, chosen: Sequence[tuple[int, IntArray]]) -> list[CellOffsets]:
        """Offsets in m of shells whose nodes lie on a surface some thicknesses above their middle, for each cell block.

        Arms lead from the nodes to the middle, along the mean normal at each node, or along the cell's where normals
        there differ too much. `chosen` are cell blocks, by index, with the rows of the section; `block` is the keyword
        of the section, with the option OFFSET. Raises `ValueError` if the offset or the thickness cannot be read.
        """
        part, thickness = _offset_in_thicknesses(block.options["OFFSET"]), self._length * _thickness(block)
        corners = [self._corners(index, rows) for index, rows in chosen]
        normals = [unit_normals(positions) for positions in corners]
        at_node: dict[int, list[FloatArray]] = {}
        for (index, rows), cell_normals in zip(chosen, normals, strict=True):
            for cell, normal in zip(self._blocks[index].nodes[rows].tolist(), cell_normals, strict=True):
                for node in cell:
                    at_node.setdefault(node, []).append(normal)
        mean = {node: _mean_direction(several) for node, several in at_node.items()}
        offsets = []
        for (index, rows), cell_normals in zip(chosen, normals, strict=True):
            cells = self._blocks[index].nodes[rows].tolist()
            along = [
                [normal if mean[n] is None else mean[n] for n in cell]
                for cell, normal in zip(cells, cell_normals, strict=True)
            ]
            offsets.append(CellOffsets(index, rows, -part * thickness * np.array(along)))
        return offsets

    def _beam_offsets(self, scope: PartData, block: KeywordBlock, index: int, rows: IntArray) -> CellOffsets:
        """Arms, m, from nodes to axis of beams of CalculiX whose nodes lie widths along local directions off it.

        These are directions 1 and 2. `index` is that of the cell block, `rows` are its cells in the section; `scope` is
        the part that has the section, `block` the keyword. Raises `ValueError` if the section has no widths, or local
        direction 1 is along a beam.
        """
        shape = block.options.get("SECTION", "").upper()
        rows_of_data = [row for row in block.rows if any(row)]
        if shape not in ("RECT", "CIRC"):
            raise ValueError(f"its section {shape or 'is not named, and'} has no width")
        stated = numbers_of(rows_of_data[0], 2)
        widths = self._length * np.array([stated[0], stated[1] or stated[0]])
        guide = np.array(numbers_of(rows_of_data[1], 3) if len(rows_of_data) > 1 else [0.0, 0.0, -1.0]) @ scope.turn.T
        ends = self._corners(index, rows)
        along = ends[:, 1] - ends[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        first = guide - (along @ guide)[:, None] * along
        size = np.linalg.norm(first, axis=1, keepdims=True)
        if not (size > 1e-8 * np.linalg.norm(guide)).all():
            raise ValueError("its local direction 1 is along its axis, or one of them has no length")
        first = first / size
        shares = [number_of(block.options.get(key, "") or "0") for key in ("OFFSET1", "OFFSET2")]
        arm = -(shares[0] * widths[0] * first + shares[1] * widths[1] * np.cross(along, first))
        return CellOffsets(index, rows, np.repeat(arm[:, None], 2, axis=1))

    def _corners(self, index: int, rows: IntArray) -> FloatArray:
        """Positions in m of the nodes of the cells `rows` of the cell block `index`, (n_cells, n_nodes, 3)."""
        return np.array([[self._positions[node] for node in cell] for cell in self._blocks[index].nodes[rows].tolist()])


def _is_offset(block: KeywordBlock) -> bool:
    return any(key.startswith("OFFSET") and not _is_zero(value) for key, value in block.options.items())


def _is_zero(word: str) -> bool:
    """True if `word` is an offset of 0; False for other offsets and for words that are none."""
    try:
        return _offset_in_thicknesses(word) == 0
    except ValueError:
        return False


def _offset_in_thicknesses(word: str) -> float:
    """An offset in thicknesses from `word`: a number, or SPOS (0.5), SNEG (-0.5) or MIDDLE (0).

    Raises `ValueError` for others.
    """
    side = _SIDES.get(word.upper())
    if side is not None:
        return side
    try:
        return number_of(word)
    except ValueError:
        raise ValueError(f"its offset {word!r} is a distribution, or no number") from None


def _thickness(block: KeywordBlock) -> float:
    """Thickness of a shell section, in the unit of the file; the sum of the layers of a composite.

    Raises `ValueError` if it varies over the section or is not stated.
    """
    if "NODAL THICKNESS" in block.options or block.options.get("SHELL THICKNESS"):
        raise ValueError("its thickness varies")
    firsts = [number_of(row[0]) for row in block.rows if any(row)]
    if not firsts or block.keyword != "SHELL SECTION":
        raise ValueError("it has no thickness")
    return sum(firsts) if "COMPOSITE" in block.options else firsts[0]


def _mean_direction(normals: Sequence[FloatArray]) -> FloatArray | None:
    """The unit mean (3,) of the unit vectors `normals`; None if one of them is too far from it.

    It is if the angle to the mean is above 20 degrees.
    """
    total = np.sum(normals, axis=0)
    size = float(np.linalg.norm(total))
    if size == 0 or min(float(normal @ total) for normal in normals) < _SMOOTH * size:
        return None
    mean: FloatArray = total / size
    return mean
