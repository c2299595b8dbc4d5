"""Geometry of a test: node positions and the lines that join them, from universal files and CSV tables."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

from structid.core.errors import FileError, InputError
from structid.files import damage_told, require_readable
from structid.files.uff.datasets import UffDataset, integers, read_blocks, read_unit_factors
from structid.files.uff.geometry import Point, read_elements, read_nodes

_REMEDY = "write node,x,y,z rows, and rows as line,1,2,3"


@dataclass(frozen=True)
class Geometry:
    """Nodes of a test and the lines that draw it.

    Parameters
    ----------
    nodes : dict of int to (x, y, z)
        Position of each node label in m.
    lines : tuple of tuple of int
        Trace lines: node labels to join in order; 0 lifts the pen.
    has_unit : bool
        False if the file did not say a unit of length, so that its numbers count as m.

    Raises
    ------
    InputError
        If a line names a node that is not there.
    """

    nodes: dict[int, Point]
    lines: tuple[tuple[int, ...], ...] = field(default=())
    has_unit: bool = True

    @property
    def unit_words(self) -> str:
        """Sentence on what the numbers count as where the file says no unit of length; else empty."""
        if self.has_unit:
            return ""
        return "The file of the geometry says no unit of length (dataset 164): its numbers count as m."

    def __post_init__(self) -> None:
        """Raise `InputError` if a line joins a node without a position; 0, which lifts the pen, needs none."""
        for line in self.lines:
            unknown = [node for node in line if node != 0 and node not in self.nodes]
            if unknown:
                raise InputError(f"a trace line joins node {unknown[0]}, which has no position; add it to `nodes`")


def read_geometry(path: str | Path) -> Geometry:
    """Nodes in m and lines of the CSV table (``node,x,y,z`` and ``line,1,2`` rows) or universal file at `path`.

    From a universal file: datasets 15 and 2411 (nodes), 82 (trace lines) or else the edges of elements (2412). A node
    in both 15 and 2411 is taken from 2411, which has more digits. Coordinate systems (datasets 18 and 2420) are
    applied: positions are global.

    Raises
    ------
    FileError
        If the file is damaged, has no nodes, or defines one node twice in different places.
    """
    path = require_readable(path)
    with damage_told(path, "a geometry that can be read", "export it again"):
        if path.suffix.lower() in (".csv", ".txt"):
            return _read_csv(path)
        return _read_universal_file(path)


def _read_universal_file(path: Path) -> Geometry:
    """Nodes and lines of a universal file; the edges of its elements if there are no trace lines.

    Raises `FileError` if the file has no nodes.
    """
    blocks = read_blocks(path)
    nodes = read_nodes(path, blocks).points
    if not nodes:
        raise FileError(f"{path}: has no nodes (dataset 15 or 2411); export the geometry too")
    lines = tuple(_trace_line(path, block) for block in blocks if block.number == 82)
    has_unit = read_unit_factors(path, blocks) is not None
    return Geometry(nodes, lines or tuple(read_elements(path, blocks).edges()), has_unit)


def _trace_line(path: Path, block: UffDataset) -> tuple[int, ...]:
    """Node labels of the trace line in a block of dataset 82, in drawing order; 0 lifts the pen.

    Raises `FileError` if the block is damaged.
    """
    where, lines = f"{path}: dataset {block.ordinal} (82)", block.lines
    try:
        count = integers(lines[0], (10, 10, 10))[1]
        nodes = [int(line[column : column + 10]) for line in lines[2:] for column in range(0, len(line.rstrip()), 10)]
        if len(nodes) < count:
            nodes = [int(word) for line in lines[2:] for word in line.split()]
    except (ValueError, IndexError) as error:
        raise FileError(f"{where} is damaged ({error}); export the geometry again") from error
    if len(nodes) < count or any(nodes[count:]):
        raise FileError(f"{where} has {len(nodes)} of its {count} nodes; export the geometry again")
    return tuple(nodes[:count])


def _read_csv(path: Path) -> Geometry:
    """Geometry of a CSV table in UTF-8: rows ``label,x,y,z`` of nodes, in m, and ``line,1,2,...``, which joins nodes in order.

    A header ``node,x,y,z``, blank rows and rows that begin with ``#`` are skipped. Lines may stand above their nodes; 0 in a
    line lifts the pen.

    Raises `FileError` for any other row, a node with two positions, a line to a node without a position, or no nodes at all.
    """
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines(), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{path}: is not a CSV table in UTF-8 ({error}); {_REMEDY}") from error
    nodes: dict[int, Point] = {}
    lines: list[tuple[int, ...]] = []
    for number, cells in enumerate(rows, 1):
        words = [cell.strip() for cell in cells]
        while words and not words[-1]:
            words.pop()
        if not words or words[0].startswith("#") or [word.lower() for word in words] == ["node", "x", "y", "z"]:
            continue
        try:
            if words[0].lower() == "line":
                lines.append(tuple(int(word) for word in words[1:]))
                continue
            label, (x, y, z) = int(words[0]), (float(word) for word in words[1:])
        except ValueError:
            raise FileError(f"{path}: line {number} reads {','.join(cells)!r}; {_REMEDY}") from None
        if nodes.setdefault(label, (x, y, z)) != (x, y, z):
            raise FileError(f"{path}: line {number} gives node {label} a second position; keep one")
    if not nodes:
        raise FileError(f"{path}: holds no nodes; {_REMEDY}")
    try:
        return Geometry(nodes, tuple(lines))
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
