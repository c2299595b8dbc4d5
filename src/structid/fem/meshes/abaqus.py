"""Abaqus input files as meshes: nodes, elements, node and element sets of one part."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.meshes.mesh import CellBlock, Mesh
from structid.files import require_readable

SUFFIXES: tuple[str, ...] = (".inp",)

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
#: Where Abaqus numbers the middles of volume and faces in another order than VTK.
_ORDERS = {"hexahedron27": (*range(20), 26, 24, 23, 25, 21, 22, 20)}
_MOST_MEMBERS = 20_000_000
#: Keywords that make nodes or elements by rule: what they say is not read.
_REFUSED = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")
_SCOPES = {"PART": "PART", "ASSEMBLY": "ASSEMBLY", "INSTANCE": "INSTANCE"}
_SCOPES |= {"END PART": "", "END ASSEMBLY": "", "END INSTANCE": "ASSEMBLY"}
Block = tuple[int, str, dict[str, str], list[list[str]]]
_MOST_INCLUDES = 20


@dataclass(eq=False)
class _Content:
    """What has been read so far: of the parts; nodes, elements and sets of the assembly itself are left out.

    Sets have their names in capital letters as keys, as Abaqus does not tell them apart. `owner` is the part or instance
    that is being read; a set of it that the assembly has too is called OWNER.SET.
    """

    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: dict[str, dict[int, list[int]]] = field(default_factory=dict)
    cell_sets: dict[str, set[int]] = field(default_factory=dict)
    node_sets: dict[str, set[int]] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    owners: dict[str, str] = field(default_factory=dict)
    instances: int = 0
    placing: list[list[float]] = field(default_factory=list)
    owner: str = ""


def read(path: Path, factor: float) -> Mesh:
    """The mesh of an Abaqus input file; coordinates times `factor` are in m.

    Of an assembly of one part, nodes and elements are those of the part, where its instance puts them; reference points
    and elements of the assembly itself are left out.

    Raises
    ------
    FileError
        If it has several parts with the same numbers, several instances, or keywords that make nodes by rule.
    """
    content, scope = _Content(), ""
    for number, keyword, options, rows in keyword_blocks(path):
        scope = _SCOPES.get(keyword, scope)
        if keyword in _REFUSED:
            raise FileError(
                f"{path}, line {number}: *{keyword} is not read; write the mesh with all nodes and elements"
            )
        content.owner = options.get("NAME", "") if keyword in _SCOPES else content.owner
        try:
            if keyword == "INSTANCE":
                content.instances += 1
                content.placing += [[float(word) for word in row if word] for row in rows if any(row)]
            elif keyword == "END INSTANCE":
                _place(content)
            elif scope != "ASSEMBLY" or "INSTANCE" in options:
                _take(content, keyword, options, rows)
        except ValueError as error:
            raise FileError(
                f"{path}, line {number}: cannot read the lines of *{keyword} ({error}); export it again"
            ) from error
    if not content.nodes or not content.elements:
        raise FileError(f"{path}: holds no *NODE and *ELEMENT lines; export the mesh, not only the steps")
    return _mesh(path, content, factor)


def _place(content: _Content) -> None:
    """Move the nodes of the part to where its instance is: a shift, then a turn about a line."""
    numbers = content.placing
    if not numbers or not content.nodes:
        return
    if content.instances > 1:
        raise ValueError("there are several instances, and one is moved; write the mesh as a flat input file")
    positions = np.array(list(content.nodes.values())) + np.array([*numbers[0], 0.0, 0.0, 0.0][:3])
    if len(numbers) > 1:
        if len(numbers[1]) != 7:
            raise ValueError("an instance is turned by two points and an angle")
        start, end, degrees = np.array(numbers[1][:3]), np.array(numbers[1][3:6]), numbers[1][6]
        positions = start + (positions - start) @ _turned(end - start, degrees).T
    content.nodes = dict(zip(content.nodes, positions.tolist(), strict=True))


def _turned(axis: FloatArray, degrees: float) -> FloatArray:
    """The rotation about `axis` (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    turned: FloatArray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turned


def _take(content: _Content, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    if keyword == "NODE":
        for row in rows:
            if int(row[0]) in content.nodes:
                raise ValueError(f"node {row[0]} stands twice, as it does where a file has several parts")
            content.nodes[int(row[0])] = [float(x or 0) for x in (*row[1:4], "0", "0", "0")[:3]]
        _set(content, content.node_sets, options.get("NSET", "")).update(int(row[0]) for row in rows)
    elif keyword == "ELEMENT":
        kind, count = _kind(options.get("TYPE", ""))
        table = _element_rows(rows, count)
        twice = next((label for label in table if any(label in other for other in content.elements.values())), None)
        if twice is not None:
            raise ValueError(f"element {twice} stands twice, as it does where a file has several parts")
        content.elements.setdefault(kind, {}).update(table)
        _set(content, content.cell_sets, options.get("ELSET", "")).update(table)
    elif keyword in ("NSET", "ELSET"):
        known = content.node_sets if keyword == "NSET" else content.cell_sets
        members = _set(content, known, options.get(keyword, ""))
        for row in rows:
            members.update(_members(row, "GENERATE" in options, known))


def _set(content: _Content, known: dict[str, set[int]], name: str) -> set[int]:
    """The set called `name` in any case, made where it is new."""
    key = name.upper()
    other = content.owners.setdefault(key, content.owner)
    if other != content.owner:  # a set of a part and one of the assembly
        for sets in (content.cell_sets, content.node_sets):
            if key in sets:
                sets[f"{other}.{name}".upper()] = sets.pop(key)
        content.names[f"{other}.{name}".upper()] = f"{other}.{content.names[key]}"
        content.owners[key] = content.owner
        content.names[key] = name
    content.names.setdefault(key, name)
    return known.setdefault(key, set())


def _members(row: list[str], generate: bool, known: dict[str, set[int]]) -> set[int]:
    if generate:
        first, last, step = ([int(w) for w in row if w] + [1])[:3]
        if (last - first) // step > _MOST_MEMBERS:
            raise ValueError(f"a set from {first} to {last} has more than {_MOST_MEMBERS} members")
        return set(range(first, last + 1, step))
    found: set[int] = set()
    for word in filter(None, row):
        own, label = word.strip('"').upper(), word.rpartition(".")[2]  # INSTANCE.SET, INSTANCE.LABEL
        key = own if own in known else own.rpartition(".")[2]
        if not label.isdigit() and key not in known:
            raise ValueError(f"there is no set {word!r} before this line")
        found |= {int(label)} if label.isdigit() else known[key]
    return found


def _element_rows(rows: list[list[str]], count: int) -> dict[int, list[int]]:
    """Nodes by element label; the data of one element may run over several lines."""
    found, pending = {}, []
    for row in rows:
        pending += [int(word) for word in row if word]
        if len(pending) >= count + 1 or count == 0:
            if count and len(pending) != count + 1:
                raise ValueError(f"element {pending[0]} has {len(pending) - 1} nodes instead of {count}")
            found[pending[0]] = pending[1:]
            pending = []
    if pending:
        raise ValueError(f"element {pending[0]} has {len(pending) - 1} nodes instead of {count}")
    return found


def _kind(name: str) -> tuple[str, int]:
    """Cell type and number of nodes of an Abaqus element type; the type itself and 0 where it is none of ours."""
    for pattern, kind, count in _KINDS:
        if re.fullmatch(rf"{pattern}[A-Z]*5?", name.upper()):
            return kind, count
    return name, 0


def _mesh(path: Path, content: _Content, factor: float) -> Mesh:
    blocks, rows_of = [], []
    for kind, table in content.elements.items():
        widths = {len(row) for row in table.values()}
        for width in sorted(widths):
            own = [label for label, row in table.items() if len(row) == width]
            nodes = np.array([table[label] for label in own], dtype=np.int64)
            blocks.append(CellBlock(kind, nodes[:, list(_ORDERS.get(kind, range(width)))]))
            rows_of.append({label: i for i, label in enumerate(own)})
    groups = {
        content.names[key]: tuple(_rows(members, known) for known in rows_of)
        for key, members in content.cell_sets.items()
        if key
    }
    node_sets = {content.names[key]: np.array(sorted(members)) for key, members in content.node_sets.items() if key}
    labels = np.array(list(content.nodes), dtype=np.int64)
    positions = factor * np.array(list(content.nodes.values()), dtype=np.float64)
    return Mesh(labels, positions, tuple(blocks), groups, node_sets, path.name)


def _rows(members: set[int], known: dict[int, int]) -> IntArray:
    return np.array(sorted(known[label] for label in members if label in known), dtype=np.int64)


def keyword_blocks(path: Path) -> Iterator[Block]:
    """Line, keyword, options and data lines of every keyword; included files stand in the place of *INCLUDE.

    Raises
    ------
    FileError
        If an included file cannot be read.
    """
    found: Block | None = None
    for number, text in _lines(path, 0):
        words = [word.strip() for word in text.split(",")]
        if text.startswith("*"):
            if found is not None:
                yield found
            found = (number, " ".join(words[0][1:].upper().split()), keyword_options(words[1:]), [])
        elif found is not None:
            found[3].append(words)
    if found is not None:
        yield found


def keyword_options(words: list[str]) -> dict[str, str]:
    """Options such as ``NAME=STEEL`` by their names in capitals; those without a value have an empty one."""
    pairs = (word.partition("=") for word in words if word)
    return {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


def _lines(path: Path, depth: int) -> Iterator[tuple[int, str]]:
    """Lines without comments and blank ones; keyword lines that go on behind a comma are joined."""
    if depth > _MOST_INCLUDES:
        raise FileError(f"{path}: includes itself, or more than {_MOST_INCLUDES} files in one another; write one file")
    number, pending = 0, ""
    with path.open(encoding="utf-8", errors="replace") as stream:
        for at, line in enumerate(stream, 1):
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            number = number if pending else at
            text, pending = pending + text, ""
            name, *options = text.split(",")
            if text.startswith("*") and text.endswith(","):
                pending = text
            elif name.replace(" ", "").upper() == "*INCLUDE":
                yield from _included(path, number, keyword_options(options), depth)
            else:
                yield number, text
    if pending:
        yield number, pending


def _included(path: Path, number: int, options: dict[str, str], depth: int) -> Iterator[tuple[int, str]]:
    name = options.get("INPUT", "").replace("\\", "/")
    try:
        place = require_readable(path.parent / name)
    except FileError as error:
        raise FileError(f"{path}, line {number}: the included file cannot be read ({error})") from error
    yield from _lines(place, depth + 1)
