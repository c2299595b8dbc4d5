"""Abaqus input files as meshes: nodes, elements, node and element sets of one part."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.arrays import IntArray
from structid.errors import FileError
from structid.structure.meshes.mesh import CellBlock, Mesh

_KINDS = (
    (r"C3D4", "tetra", 4),
    (r"C3D10", "tetra10", 10),
    (r"C3D6", "wedge", 6),
    (r"C3D8", "hexahedron", 8),
    (r"C3D20", "hexahedron20", 20),
    (r"(CPS|CPE|CPEG|M3D|S|STRI|R3D)3", "triangle", 3),
    (r"(CPS|CPE|CPEG|M3D|S|R3D)4", "quad", 4),
    (r"(CPS|CPE|CPEG|M3D|S|STRI)(6|65)", "triangle6", 6),
    (r"(CPS|CPE|CPEG|M3D|S)8", "quad8", 8),
    (r"(B21|B23|B31|B33|T2D2|T3D2)", "line", 2),
    (r"(B22|B32|T2D3|T3D3)", "line3", 3),
    (r"MASS|ROTARYI", "vertex", 1),
)
#: Keywords that make nodes or elements by rule, or bring other files or copies: what they say is not read.
_REFUSED = ("INCLUDE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")


@dataclass(eq=False)
class _Content:
    """What has been read so far."""

    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: dict[str, dict[int, list[int]]] = field(default_factory=dict)
    cell_sets: dict[str, set[int]] = field(default_factory=dict)
    node_sets: dict[str, set[int]] = field(default_factory=dict)


def read(path: Path, factor: float) -> Mesh:
    """The mesh of an Abaqus input file; coordinates times `factor` are in m.

    Raises
    ------
    FileError
        If it has several parts, or keywords that make nodes or elements by rule.
    """
    content = _Content()
    for number, keyword, options, rows in _blocks(path):
        if keyword in _REFUSED:
            raise FileError(f"{path}, line {number}: *{keyword} is not read; write the mesh as a flat input file")
        if keyword == "INSTANCE" and rows:
            raise FileError(
                f"{path}, line {number}: an instance that is moved is not read; write the mesh as a flat input file"
            )
        try:
            _take(content, keyword, options, rows)
        except ValueError as error:
            raise FileError(
                f"{path}, line {number}: cannot read the lines of *{keyword} ({error}); export it again"
            ) from error
    if not content.nodes or not content.elements:
        raise FileError(f"{path}: holds no *NODE and *ELEMENT lines; export the mesh, not only the steps")
    return _mesh(path, content, factor)


def _blocks(path: Path) -> Iterator[tuple[int, str, dict[str, str], list[list[str]]]]:
    """Line, keyword, options and data lines of every keyword."""
    found: tuple[int, str, dict[str, str], list[list[str]]] | None = None
    with path.open(encoding="utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, 1):
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            words = [word.strip() for word in text.split(",")]
            if text.startswith("*"):
                if found is not None:
                    yield found
                pairs = (word.partition("=") for word in words[1:])
                options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
                found = (number, words[0][1:].strip().upper(), options, [])
            elif found is not None:
                found[3].append(words)
    if found is not None:
        yield found


def _take(content: _Content, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    if keyword == "NODE":
        for row in rows:
            if int(row[0]) in content.nodes:
                raise ValueError(f"node {row[0]} stands twice, as it does where a file has several parts")
            content.nodes[int(row[0])] = [float(x or 0) for x in (*row[1:4], "0", "0", "0")[:3]]
        content.node_sets.setdefault(options.get("NSET", ""), set()).update(int(row[0]) for row in rows)
    elif keyword == "ELEMENT":
        kind, count = _kind(options.get("TYPE", ""))
        table = _element_rows(rows, count)
        content.elements.setdefault(kind, {}).update(table)
        content.cell_sets.setdefault(options.get("ELSET", ""), set()).update(table)
    elif keyword in ("NSET", "ELSET"):
        known = content.node_sets if keyword == "NSET" else content.cell_sets
        members = known.setdefault(options.get(keyword, ""), set())
        for row in rows:
            members.update(_members(row, "GENERATE" in options, known))


def _members(row: list[str], generate: bool, known: dict[str, set[int]]) -> set[int]:
    if generate:
        first, last, step = ([int(w) for w in row if w] + [1])[:3]
        return set(range(first, last + 1, step))
    found: set[int] = set()
    for word in filter(None, row):
        if not word.isdigit() and word not in known:
            raise ValueError(f"there is no set {word!r} before this line")
        found |= {int(word)} if word.isdigit() else known[word]
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
            blocks.append(CellBlock(kind, np.array([table[label] for label in own], dtype=np.int64)))
            rows_of.append({label: i for i, label in enumerate(own)})
    groups = {
        name: tuple(_rows(members, known) for known in rows_of) for name, members in content.cell_sets.items() if name
    }
    nodes = {name: np.array(sorted(members)) for name, members in content.node_sets.items() if name}
    labels = np.array(list(content.nodes), dtype=np.int64)
    positions = factor * np.array(list(content.nodes.values()), dtype=np.float64)
    return Mesh(labels, positions, tuple(blocks), groups, nodes, path.name)


def _rows(members: set[int], known: dict[int, int]) -> IntArray:
    return np.array(sorted(known[label] for label in members if label in known), dtype=np.int64)
