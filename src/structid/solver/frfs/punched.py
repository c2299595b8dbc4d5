"""FRFs as Nastran punches them (SOL 108, 111): complex motions of points, by frequency or by point."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from structid.arrays import ComplexArray
from structid.dof import DIRECTIONS, Dof
from structid.errors import FileError
from structid.modal.files.nastran import numbers
from structid.records import FrfRecord
from structid.structure.importers.exports import FORCES, LENGTHS
from structid.units import FrfKind

_KINDS: dict[str, FrfKind] = {
    "$DISPLACEMENTS": "receptance",
    "$VELOCITY": "mobility",
    "$ACCELERATION": "accelerance",
}
_HEADER = re.compile(r"^\$(SUBCASE ID|POINT ID|FREQUENCY)\s*=\s*([-+.\dEDed]+)")
_WIDTH, _CONTINUED, _LINES = 72, "-CONT-", 4
_RUN_AGAIN = "punch them as in DISPLACEMENT(PUNCH,REAL) = ALL"

#: Subcase, frequency, point and its six components, in the units of the deck.
Entry = tuple[int, float, int, ComplexArray]


def punched_frfs(path: Path, loads: Sequence[Dof], length: str, force: str) -> FrfRecord:
    """The FRFs in a punch file, in SI units.

    Parameters
    ----------
    path : Path
    loads : sequence of Dof
        What acts in each subcase, in ascending order, with a size of 1.
    length, force : str
        Units of the deck.

    Raises
    ------
    FileError
        If there are none, the file is cut short, or subcases are not as many as loads.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    kind = next((kind for title, kind in _KINDS.items() if any(line.startswith(title) for line in lines)), None)
    if kind is None:
        raise FileError(f"{path}: holds no displacements, velocities or accelerations; {_RUN_AGAIN}")
    table = {(case, frequency, node): values for case, frequency, node, values in _entries(path, lines, kind)}
    cases, frequency, nodes = (sorted({*found}) for found in zip(*table, strict=True)) if table else ([], [], [])
    if len(table) != len(cases) * len(frequency) * len(nodes) or not table:
        raise FileError(
            f"{path}: points or frequencies are missing in a part of it; the file is cut short, {_RUN_AGAIN}"
        )
    if len(cases) != len(loads):
        raise FileError(
            f"{path}: holds {len(cases)} subcases, and `loads` names {len(loads)}; name what acts in each, in their order"
        )
    outputs = [Dof(int(node), direction) for node in nodes for direction in DIRECTIONS]
    values = np.array([[np.concatenate([table[case, f, node] for node in nodes]) for case in cases] for f in frequency])
    motion = np.array([1.0 if dof.is_rotation else LENGTHS[length] for dof in outputs])
    acting = np.array([dof.sign * FORCES[force] * (LENGTHS[length] if dof.is_rotation else 1.0) for dof in loads])
    scaled = np.moveaxis(values, 1, 2) * motion[:, None] / acting
    return FrfRecord(frequency, scaled, outputs, [dof.unsigned for dof in loads], kind)


def _entries(path: Path, lines: Sequence[str], wanted: FrfKind) -> Iterator[Entry]:
    """Points at frequencies, whichever of both is in the header."""
    kind: FrfKind | None = None
    known: dict[str, str] = {}
    polar, begun = False, 0
    rows: list[list[str]] = []
    for place, line in enumerate(lines, 1):
        if line.startswith("$"):
            title = line[:_WIDTH].split()[0]
            found = _HEADER.match(line)
            if title == "$TITLE" or title in _KINDS:
                kind, known = None if "(SOLUTION" in line else _KINDS.get(title), {}
            elif line.startswith("$REAL OUTPUT") and kind == wanted:
                raise FileError(
                    f"{path}, line {place}: holds real motions; write real and imaginary parts: {_RUN_AGAIN}"
                )
            elif "OUTPUT" in line:
                polar = line.startswith("$MAGNITUDE-PHASE")
            elif found:
                known[found[1]] = found[2]
            continue
        if kind != wanted or not ("FREQUENCY" in known or "POINT ID" in known):
            continue
        words = line[:_WIDTH].split()
        if (words[:1] == [_CONTINUED]) != bool(rows) or len(words) != (4 if rows else 5):
            raise FileError(
                f"{path}, line {place}: is not part of a motion of a point; the file is damaged, {_RUN_AGAIN}"
            )
        rows.append(words)
        begun = place
        if len(rows) == _LINES:
            first, rest = rows[0][0], [*rows[0][2:], *(word for row in rows[1:] for word in row[1:])]
            frequency, node = (known["FREQUENCY"], first) if "FREQUENCY" in known else (first, known["POINT ID"])
            parts = numbers(path, rest).reshape(2, 6)
            values = parts[0] * np.exp(1j * np.radians(parts[1])) if polar else parts[0] + 1j * parts[1]
            yield int(known.get("SUBCASE ID", "1")), float(frequency.replace("D", "E")), int(node), values
            rows = []
    if rows:
        raise FileError(f"{path}, line {begun}: ends within a point; the file is cut short, {_RUN_AGAIN}")
