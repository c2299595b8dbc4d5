"""Gmsh files as meshes: versions 2.0 to 2.2 and 4.1, with their node numbers and physical groups.

A section is a list of numbers, read one after another from text or from bytes.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import join_words, plural
from structid.core.errors import FileError
from structid.fem.meshes.deck_parts import DeckUnits
from structid.fem.meshes.mesh import CellBlock, Mesh

_REMEDY = "save it as version 4.1 or 2.2 (Mesh.MshFileVersion = 4.1)"
_AGAIN = "copy the file again, or save the mesh again"
#: Name, number of nodes and dimension of each element type, and the order of its nodes as in VTK where it differs.
_TYPES: dict[int, tuple[str, int, int, tuple[int, ...]]] = {
    1: ("line", 2, 1, ()),
    2: ("triangle", 3, 2, ()),
    3: ("quad", 4, 2, ()),
    4: ("tetra", 4, 3, ()),
    5: ("hexahedron", 8, 3, ()),
    6: ("wedge", 6, 3, ()),
    7: ("pyramid", 5, 3, ()),
    8: ("line3", 3, 1, ()),
    9: ("triangle6", 6, 2, ()),
    10: ("quad9", 9, 2, ()),
    11: ("tetra10", 10, 3, (*range(8), 9, 8)),
    12: (
        "hexahedron27",
        27,
        3,
        (*range(8), 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15, 22, 23, 21, 24, 20, 25, 26),
    ),
    13: ("wedge18", 18, 3, ()),
    14: ("pyramid14", 14, 3, ()),
    15: ("vertex", 1, 0, ()),
    16: ("quad8", 8, 2, ()),
    17: ("hexahedron20", 20, 3, (*range(8), 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15)),
    18: ("wedge15", 15, 3, (*range(6), 6, 9, 7, 12, 14, 13, 8, 10, 11)),
    19: ("pyramid13", 13, 3, (*range(5), 5, 8, 10, 6, 7, 9, 11, 12)),
}
_HEAD = re.compile(rb"\$MeshFormat\s+([\d.]+)\s+([01])\s+(\d+)\s*?\n")
#: Cells of one type: the type, the physical group and the entity of each (0 where it has none), and their nodes.
Cells = tuple[int, IntArray, IntArray]
#: A physical group: its dimension (not in version 2.0), its number and its name.
_GROUP = re.compile(rb'\s*(?:(\d+)[ \t]+)?(\d+)[ \t]+"([^"]*)"[^\r\n]*')


@dataclass(eq=False)
class _Content:
    """Contents read so far: cells by type with the physical groups that each is in."""

    names: dict[tuple[int, int], str] = field(default_factory=dict)
    physical: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    labels: list[IntArray] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)
    cells: dict[int, list[IntArray]] = field(default_factory=dict)
    tags: dict[int, list[tuple[int, list[int]]]] = field(default_factory=dict)


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of the Gmsh file at `path` (version 2 or 4.1, text or binary), in m.

    `units` has the length unit of the file. Groups are the physical groups of cells, by name or number.

    Raises
    ------
    FileError
        If it is of another version, is cut short or damaged, or lacks nodes of its cells.
    """
    data = path.read_bytes()
    head = _HEAD.search(data)
    if head is None:
        raise FileError(f"{path}: has no $MeshFormat as Gmsh files have; {_REMEDY}")
    version = head[1].decode()
    if version not in ("2", "2.0", "2.1", "2.2", "4.1"):
        raise FileError(f"{path}: is of version {version}; {_REMEDY}")
    is_version_2, is_binary = version.startswith("2"), head[2] == b"1"
    content = _Content()
    sections = {
        b"PhysicalNames": _names,
        b"Entities": _read_entities,
        b"Nodes": _old_nodes if is_version_2 else _read_nodes,
        b"Elements": _read_elements_2 if is_version_2 else _read_elements,
    }
    try:
        swapped = is_binary and _is_swapped(data, head.end())
        for name, take in sections.items():
            section = re.search(rb"^\$" + name + rb"[ \t]*\r?\n", data, re.MULTILINE)
            if section is None and name in (b"PhysicalNames", b"Entities"):
                continue
            if section is None:
                raise FileError(f"{path}: is cut short: there is no ${name.decode()}; {_AGAIN}")
            stop = data.find(b"$End" + name, section.end())
            if stop < 0:
                raise FileError(f"{path}: is cut short: ${name.decode()} is not closed; {_AGAIN}")
            in_text = not is_binary or name == b"PhysicalNames"
            numbers: _Numbers = _Ascii(data, section.end(), stop) if in_text else _Binary(data, section.end(), swapped)
            take(content, numbers)
            if not data[numbers.offset :].lstrip().startswith(b"$End" + name):
                raise FileError(f"{path}: ${name.decode()} has more or fewer numbers than it says; {_AGAIN}")
    except FileError:
        raise
    except (ValueError, IndexError, KeyError) as error:
        raise FileError(f"{path}: cannot be read as gmsh ({error}); {_REMEDY}") from error
    return _make_mesh(path, content, units.length)


def _is_swapped(data: bytes, offset: int) -> bool:
    """True if a binary file is not in the byte order of this machine, by the whole number 1 behind its header.

    `offset` is its byte in `data`; raises `ValueError` if there is something else.
    """
    marker = data[offset : offset + 4]
    if marker not in (b"\x01\0\0\0", b"\0\0\0\x01"):
        raise ValueError("the number one is missing behind $MeshFormat")
    return (np.frombuffer(marker, "<i4")[0] == 1) != (sys.byteorder == "little")


def _names(content: _Content, numbers: _Numbers) -> None:
    """Read the names of physical groups, by dimension and tag, into `content`; for all four without a dimension."""
    for dimension, tag, name in numbers.groups():
        for stated in range(4) if dimension is None else (dimension,):
            content.names[stated, tag] = name


def _read_entities(content: _Content, numbers: _Numbers) -> None:
    """Read the $Entities section into `content`: physical groups of each geometric entity, by (dimension, tag).

    `numbers` are those of the section, which are consumed. Raises `ValueError` if there are too few.
    """
    counts = numbers.sizes(4).tolist()
    for dimension, count in enumerate(counts):
        for _ in range(count):
            tag = numbers.integer()
            numbers.reals(3 if dimension == 0 else 6)
            groups = numbers.integers(int(numbers.sizes(1)[0]))
            content.physical[dimension, tag] = groups.tolist()
            if dimension:
                numbers.integers(int(numbers.sizes(1)[0]))


def _read_nodes(content: _Content, numbers: _Numbers) -> None:
    """Append the nodes of a $Nodes section of version 4.1 to `content`: labels and positions, in the unit of the file.

    `numbers` are those of the section, which are consumed. Raises `ValueError` if there are too few.
    """
    for _ in range(int(numbers.sizes(4)[0])):
        dimension, _tag, parametric = numbers.integers(3).tolist()
        count = int(numbers.sizes(1)[0])
        content.labels.append(numbers.sizes(count))
        width = 3 + (dimension if parametric else 0)
        content.positions.append(numbers.reals(width * count).reshape(count, width)[:, :3])


def _read_elements(content: _Content, numbers: _Numbers) -> None:
    """Append the $Elements section of version 4.1 to `content`: cells by type, and physical groups of their entities.

    `numbers` are those of the section, which are consumed. Raises `ValueError` if there are too few or a type is not
    known.
    """
    for _ in range(int(numbers.sizes(4)[0])):
        dimension, tag, kind = numbers.integers(3).tolist()
        count = int(numbers.sizes(1)[0])
        width = 1 + _known(kind)[1]
        rows = numbers.sizes(width * count).reshape(count, width)[:, 1:]
        content.cells.setdefault(kind, []).append(rows)
        content.tags.setdefault(kind, []).append((count, content.physical.get((dimension, tag), [])))


def _old_nodes(content: _Content, numbers: _Numbers) -> None:
    """Read the nodes of format 2 into `content`: labels and positions, in the unit of the file."""
    labels, positions = numbers.old_nodes(int(numbers.counts(1)[0]))
    content.labels.append(labels)
    content.positions.append(positions)


def _read_elements_2(content: _Content, numbers: _Numbers) -> None:
    """Read the $Elements section of version 2 into `content`: cells by type, and the physical groups of each.

    A cell that is repeated for each of its physical groups counts once, with all of them. `numbers` are those of the
    section. Raises `ValueError` if there are too few.
    """
    total = int(numbers.counts(1)[0])
    by_kind: dict[int, list[tuple[IntArray, IntArray]]] = {}
    for kind, tags, rows in numbers.old_elements(total):
        by_kind.setdefault(kind, []).append((tags, rows))
    for kind, parts in by_kind.items():
        tags, rows = (np.concatenate(tables) for tables in zip(*parts, strict=True))
        keys = np.column_stack([tags[:, 1], rows])  # one cell of one entity
        _, first, cell = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        order = np.sort(first)
        content.cells[kind] = [rows[order]]
        groups: list[list[int]] = [[] for _ in order]
        for index, tag in zip(np.searchsorted(order, first[cell.ravel()]).tolist(), tags[:, 0].tolist(), strict=True):
            if tag and tag not in groups[index]:
                groups[index].append(tag)
        content.tags[kind] = [(1, groups_of_cell) for groups_of_cell in groups]


def _known(kind: int) -> tuple[str, int, int, tuple[int, ...]]:
    """Entry of `_TYPES` of element type `kind`; `ValueError` if the type is not known."""
    if kind not in _TYPES:
        raise ValueError(f"element type {kind} is not known")
    return _TYPES[kind]


def _make_mesh(path: Path, content: _Content, factor: float) -> Mesh:
    """The mesh of the `content` that was read; `factor` turns its lengths into m.

    Nodes of cells are brought into the order of structid. Raises `FileError`, which names `path`, if there are no
    nodes, or cells name nodes that are not there.
    """
    labels = np.concatenate(content.labels) if content.labels else np.zeros(0, np.int64)
    if not len(labels):
        raise FileError(f"{path}: holds no whole table of nodes; {_AGAIN}")
    positions = factor * np.concatenate(content.positions)
    blocks, members = [], []
    for kind, parts in content.cells.items():
        name, _, dimension, order = _known(kind)
        rows = np.concatenate(parts)
        _require_nodes(path, name, rows, labels)
        blocks.append(CellBlock(name, rows[:, list(order)] if order else rows))
        members.append(_group_rows(content, dimension, content.tags[kind]))
    names = dict.fromkeys(name for of_block in members for name in of_block)
    empty = np.zeros(0, np.int64)
    groups = {name: tuple(of_block.get(name, empty) for of_block in members) for name in names}
    return Mesh(labels, positions, tuple(blocks), groups, {}, path.name)


def _require_nodes(path: Path, name: str, rows: IntArray, labels: IntArray) -> None:
    """Raise `FileError`, which names `path`, if cells of the type `name` have nodes that the file does not have.

    `rows` are the nodes of cells (n_cells, n_nodes), `labels` those of the file.
    """
    is_known = np.isin(rows, labels)
    if is_known.all():
        return
    missing, bad_rows = np.unique(rows[~is_known]), np.flatnonzero(~is_known.all(axis=1))
    raise FileError(
        f"{path}: lacks node {join_words(missing.tolist())} of {plural(len(bad_rows), 'cell')} of type {name} (the first has nodes"
        f" {join_words(rows[bad_rows[0]].tolist(), 27)}); save the mesh again with all its nodes"
    )


def _group_rows(content: _Content, dimension: int, tags: Iterable[tuple[int, list[int]]]) -> dict[str, IntArray]:
    """Row indices of the cells of each physical group in one block of cells, by its name, or number if it has no name.

    `tags` has pairs (number of neighbouring cells, their groups), `dimension` is that of the cells; `content` has the
    names.
    """
    rows_of: dict[str, list[IntArray]] = {}
    first = 0
    for count, groups in tags:
        for tag in groups:
            name = content.names.get((dimension, abs(tag)), str(abs(tag)))
            rows_of.setdefault(name, []).append(np.arange(first, first + count))
        first += count
    return {name: np.concatenate(parts) for name, parts in rows_of.items()}


class _Numbers(Protocol):
    """Reader of numbers from a Gmsh file, the part that text and binary files share.

    `integers` are whole numbers of 4 bytes, `sizes` those of 8, `counts` stand in text even in binary files.
    """

    offset: int

    def integers(self, count: int) -> IntArray: ...

    def sizes(self, count: int) -> IntArray: ...

    def counts(self, count: int) -> IntArray: ...

    def reals(self, count: int) -> FloatArray: ...

    def integer(self) -> int: ...

    def groups(self) -> list[tuple[int | None, int, str]]:
        """Dimension, number and name of each physical group; None where the file does not say its dimension."""
        ...

    def old_nodes(self, count: int) -> tuple[IntArray, FloatArray]:
        """Numbers and positions of the nodes of version 2."""
        ...

    def old_elements(self, count: int) -> Iterator[Cells]:
        """The `count` elements of version 2, neighbours of one type together."""
        ...


class _Ascii:
    """Numbers in the text from `offset` to `stop`."""

    def __init__(self, data: bytes, offset: int, stop: int) -> None:
        """Numbers in the text `data` from byte `offset` to byte `stop` (exclusive), read one after another."""
        self.offset, self.stop = offset, stop
        self._text = data[offset:stop]
        self._words: np.ndarray | None = None
        self._at = 0

    def _next(self, count: int) -> np.ndarray:
        """The next `count` words, an array (count,) of texts; `ValueError` if the section has fewer."""
        if self._words is None:
            self._words = np.array(self._text.split())
        part = self._words[self._at : self._at + count]
        if count < 0 or len(part) != count:
            raise ValueError("a section ends too soon")
        self._at += count
        if self._at == len(self._words):
            self.offset = self.stop
        return part

    def integers(self, count: int) -> IntArray:
        return self._next(count).astype(np.int64) if count else np.zeros(0, np.int64)

    sizes = counts = integers

    def reals(self, count: int) -> FloatArray:
        return self._next(count).astype(np.float64)

    def integer(self) -> int:
        """The next whole number."""
        return int(self._next(1)[0])

    def groups(self) -> list[tuple[int | None, int, str]]:
        """Dimension, number and name of each physical group; the dimension is None if the file does not say it.

        Raises `ValueError` if a group cannot be read.
        """
        head = re.match(rb"\s*(\d+)", self._text)
        if head is None:
            raise ValueError("the names of physical groups begin with no count")
        offset = head.end()
        groups: list[tuple[int | None, int, str]] = []
        for _ in range(int(head[1])):
            match = _GROUP.match(self._text, offset)
            if match is None:
                raise ValueError("a physical group has no number, or no name in quotation marks")
            offset = match.end()
            groups.append((int(match[1]) if match[1] else None, int(match[2]), match[3].decode("utf-8", "replace")))
        self.offset += offset
        return groups

    def old_nodes(self, count: int) -> tuple[IntArray, FloatArray]:
        table = self._next(4 * count).reshape(count, 4)
        return table[:, 0].astype(np.int64), table[:, 1:].astype(np.float64)

    def old_elements(self, count: int) -> Iterator[Cells]:
        """Yield runs of neighbouring elements of one type in a section of version 2: type, tags and nodes.

        Tags are (n, 2) and nodes (n, n_nodes). Tags are the physical group and the entity, 0 where absent. `count` is
        the number of elements. Raises `ValueError` or `IndexError` if the section has fewer.
        """
        assert self._words is not None
        numbers = self._words[self._at :].astype(np.int64)
        begin, elements = 0, []
        for _ in range(count):
            kind, n_tags = int(numbers[begin + 1]), int(numbers[begin + 2])
            stop = begin + 3 + n_tags + _known(kind)[1]
            if stop > len(numbers):
                raise ValueError("a section ends too soon")
            tags = [*numbers[begin + 3 : begin + 3 + min(n_tags, 2)].tolist(), 0, 0][:2]
            elements.append((kind, tags, begin + 3 + n_tags, stop))
            begin = stop
        if begin == len(numbers):
            self.offset = self.stop
        first = 0
        for last in range(1, len(elements) + 1):
            if last == len(elements) or elements[last][0] != elements[first][0]:
                run = elements[first:last]
                rows = np.stack([numbers[a:b] for _, _, a, b in run])
                yield run[0][0], np.array([tags for _, tags, _, _ in run]), rows
                first = last


class _Binary:
    """Numbers in the bytes from `offset`; `swapped` where they are in the other byte order."""

    def __init__(self, data: bytes, offset: int, swapped: bool) -> None:
        self.offset = offset
        self._data = data
        self._order = ">" if swapped == (sys.byteorder == "little") else "<"

    def _next(self, form: np.dtype, count: int) -> np.ndarray:
        """The next `count` numbers of the type `form`, (count,); `ValueError` if the file has fewer."""
        if count < 0 or self.offset + count * form.itemsize > len(self._data):
            raise ValueError("a section ends too soon")
        part = np.frombuffer(self._data, form, count, self.offset)
        self.offset += count * form.itemsize
        return part

    def integers(self, count: int) -> IntArray:
        return self._next(np.dtype(self._order + "i4"), count).astype(np.int64)

    def sizes(self, count: int) -> IntArray:
        return self._next(np.dtype(self._order + "u8"), count).astype(np.int64)

    def counts(self, count: int) -> IntArray:
        """The next `count` whole numbers, (count,), which stand on a line of text; fewer if the line has fewer.

        Raises `ValueError` for another word, or without a line end.
        """
        stop = self._data.index(b"\n", self.offset)
        words = np.array(self._data[self.offset : stop].split()[:count]).astype(np.int64)
        self.offset = stop + 1
        return words

    def reals(self, count: int) -> FloatArray:
        return self._next(np.dtype(self._order + "f8"), count).astype(np.float64)

    def integer(self) -> int:
        return int(self.integers(1)[0])

    def groups(self) -> list[tuple[int | None, int, str]]:
        raise ValueError("names of physical groups stand in text")

    def old_nodes(self, count: int) -> tuple[IntArray, FloatArray]:
        table = self._next(np.dtype([("label", self._order + "i4"), ("at", self._order + "f8", (3,))]), count)
        return table["label"].astype(np.int64), table["at"].astype(np.float64)

    def old_elements(self, count: int) -> Iterator[Cells]:
        """Yield blocks of elements in a section of version 2: type, tags (n, 2) and nodes (n, n_nodes).

        Tags are the physical group and the entity, 0 where absent. `count` is the number of elements. Raises
        `ValueError` for an empty block, or if the file has fewer.
        """
        done = 0
        while done < count:
            kind, n_elements, n_tags = self.integers(3).tolist()
            if n_elements < 1:
                raise ValueError("a block of elements is empty")
            rows = self.integers(n_elements * (1 + n_tags + _known(kind)[1])).reshape(n_elements, -1)
            tags = np.pad(rows[:, 1 : 1 + min(n_tags, 2)], ((0, 0), (0, 2 - min(n_tags, 2))))
            yield kind, tags, rows[:, 1 + n_tags :]
            done += n_elements
