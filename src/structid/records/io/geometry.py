"""Where the nodes of a test are and how lines join them, from universal files and CSV tables."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from structid.errors import FileError, InputError
from structid.files import damage_told, require_readable
from structid.records.io.uff.blocks import Dataset, datasets
from structid.records.io.uff.scales import unit_factors

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Geometry:
    """Nodes of a test and the lines that draw it.

    Parameters
    ----------
    nodes : dict of int to (x, y, z)
        Position of each node label in m.
    lines : tuple of tuple of int
        Trace lines: node labels to join in order; 0 lifts the pen.

    Raises
    ------
    InputError
        If a line names a node that is not there.
    """

    nodes: dict[int, Point]
    lines: tuple[tuple[int, ...], ...] = field(default=())

    def __post_init__(self) -> None:
        for line in self.lines:
            unknown = [node for node in line if node != 0 and node not in self.nodes]
            if unknown:
                raise InputError(f"a trace line joins node {unknown[0]}, which has no position; add it to `nodes`")


def read_geometry(path: str | Path) -> Geometry:
    """Nodes and lines of the CSV table (``node,x,y,z`` and ``line,1,2`` rows) or universal file at `path`, in m.

    Of a universal file: datasets 15 and 2411 (nodes) and 82 (trace lines). A node in both 15 and 2411 is taken from
    2411, which has more digits. Local coordinate systems are not applied.

    Raises
    ------
    FileError
        If the file is damaged, has no nodes, or defines one node twice in different places.
    """
    path = require_readable(path)
    with damage_told(path, "a geometry that can be read", "export it again"):
        if path.suffix.lower() in (".csv", ".txt"):
            from structid.records.io.geometry_csv import read_geometry_csv  # which needs Geometry

            return read_geometry_csv(path)
        return _of_universal_file(path)


def _of_universal_file(path: Path) -> Geometry:
    found = datasets(path)
    factors = unit_factors(path, found)
    scale = 1.0 if factors is None else 1 / factors.length
    nodes: dict[int, Point] = {}
    for number in (15, 2411):
        nodes.update(_nodes(path, [d for d in found if d["type"] == number], scale))
    if not nodes:
        raise FileError(f"{path}: has no nodes (dataset 15 or 2411); export the geometry too")
    return Geometry(nodes, tuple(tuple(int(n) for n in d["nodes"]) for d in found if d["type"] == 82))


def _nodes(path: Path, tables: list[Dataset], scale: float) -> dict[int, Point]:
    nodes: dict[int, Point] = {}
    for table in tables:
        if not len(table["node_nums"]) == len(table["x"]) == len(table["y"]) == len(table["z"]):
            raise FileError(f"{path}: dataset {table['type']} ends within a node; export the geometry again")
        for label, x, y, z in zip(table["node_nums"], table["x"], table["y"], table["z"], strict=True):
            point = (float(x) * scale, float(y) * scale, float(z) * scale)
            if nodes.setdefault(int(label), point) != point:
                raise FileError(f"{path}: dataset {table['type']} gives node {int(label)} two positions; keep one")
    return nodes
