"""The geometry of a test as a table of nodes and lines.

    node,x,y,z
    1,0,0,0
    2,0,0,3.5
    line,1,2

Positions in m; every row that begins with ``line`` joins nodes in order.
"""

from __future__ import annotations

import csv
from pathlib import Path

from structid.errors import FileError, InputError
from structid.files import require_readable
from structid.records.io.geometry import Geometry, Point

_REMEDY = "write node,x,y,z rows, and rows as line,1,2,3"


def read_geometry_csv(path: Path) -> Geometry:
    """Nodes and lines of the table at `path`.

    Raises
    ------
    FileError
        If the file is not such a table, or a row cannot be used; with its line.
    """
    path = require_readable(path)
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
