"""Modes as Nastran prints them: real eigenvectors in ``.f06`` listings and in punch files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import FieldError, real_numbers
from structid.modal.modal_record import ModalRecord, unit_largest

F06_SUFFIXES, PUNCH_SUFFIXES = (".f06",), (".pch", ".pun")
_RUN_AGAIN = "let the solver print frequencies and displacements of all modes"
_REAL = r"[-+]?\d*\.\d*(?:[EDed]?[-+]\d+)?"
_TABLE = re.compile(r"R E A L\s+E I G E N V A L U E S")
_TABLE_ROW = re.compile(rf"^\s*(\d+)\s+(\d+)((?:\s+{_REAL}){{5}})\s*$")
_VECTOR = re.compile(r"E I G E N V E C T O R(?:\s+N O \.\s+(\d+))?")
_NODE = re.compile(rf"^\s*(\d+)\s+(?:\d+|G)\s+({_REAL}(?:\s+{_REAL}){{5}})\s*$")
_COMPLEX = re.compile(r"C O M P L E X\s+E I G E N")
_PUNCH_MODE = re.compile(rf"^\$EIGENVALUE\s*=\s*({_REAL})\s+MODE\s*=\s*(\d+)")
#: Columns of a punched line: a label, or ``-CONT-``, the kind of point, three numbers, and the number of the line.
_LABEL, _FIRST, _WIDTH = slice(0, 10), 18, 18
_CONTINUED = "-CONT-"


class PrintedMode(NamedTuple):
    """Frequency in Hz, labels of points (n_points,), and their motion (n_points, 6) in the units of the model."""

    frequency: float
    nodes: IntArray
    values: FloatArray


def f06_modes(path: Path, lines: Sequence[str]) -> list[PrintedMode]:
    """Modes of a listing: the table of real eigenvalues, and six components a point of each vector, page after page.

    Raises
    ------
    FileError
        If the run failed, modes are complex, or a vector has no frequency.
    """
    frequency: dict[int, float] = {}
    modes: dict[int, tuple[list[int], list[str]]] = {}
    state, number = "", 0
    for line in lines:
        if _COMPLEX.search(line):
            raise FileError(f"{path}: holds complex modes; print real ones (SOL 103)")
        if _TABLE.search(line):
            state = "table"
        elif found := _VECTOR.search(line):
            state, number = "vector", int(found[1] or number + 1)
            modes.setdefault(number, ([], []))
        elif state == "table" and (found := _TABLE_ROW.match(line)):
            frequency[int(found[1])] = float(found[3].split()[2].replace("D", "E"))
        elif state == "vector" and (found := _NODE.match(line)):
            modes[number][0].append(int(found[1]))
            modes[number][1].extend(found[2].split())
        elif "FATAL" in line:
            raise FileError(f"{path}: {' '.join(line.split())[:100]}; correct the deck")
    if missing := modes.keys() - frequency.keys():
        raise FileError(
            f"{path}: holds {len(frequency)} frequencies and {len(modes)} shapes, none of mode {min(missing)}; {_RUN_AGAIN}"
        )
    return [_printed(path, frequency[number], *modes[number]) for number in modes]


def punch_modes(path: Path, lines: Sequence[str]) -> list[PrintedMode]:
    """Modes of a punch file: vectors with their eigenvalue, two lines a point.

    Raises
    ------
    FileError
        If modes are complex, or a line is cut short.
    """
    found: list[tuple[float, list[int], list[str]]] = []
    is_vector = False
    for place, line in enumerate(lines, 1):
        if line.startswith("$"):
            words = line[:72].split()
            if words[0] == "$EIGENVECTOR":
                is_vector = True
            elif "OUTPUT" in words[1:] and is_vector and not line.startswith("$REAL OUTPUT"):
                raise FileError(f"{path}, line {place}: holds complex modes; punch real ones (SOL 103)")
            elif (mode := _PUNCH_MODE.match(line)) and is_vector:
                square = max(float(mode[1].replace("D", "E")), 0.0)
                found.append((float(np.sqrt(square)) / (2 * np.pi), [], []))
            elif words[0] in ("$DISPLACEMENTS", "$SPCF", "$STRESSES", "$ELEMENT", "$MPCF", "$FORCES"):
                is_vector = False
            continue
        if not (is_vector and found):
            continue
        label = line[_LABEL].strip()
        if label != _CONTINUED:
            found[-1][1].append(_label(path, place, label))
        found[-1][2].extend(line[_FIRST + k * _WIDTH : _FIRST + (k + 1) * _WIDTH].strip() for k in range(3))
    return [_printed(path, *mode) for mode in found]


def _label(path: Path, place: int, text: str) -> int:
    if not text.isdigit():
        raise FileError(
            f"{path}, line {place}: {text[:20]!r} is no label of a point; the file is damaged, {_RUN_AGAIN}"
        )
    return int(text)


def _printed(path: Path, frequency: float, nodes: Iterable[int], fields: Sequence[str]) -> PrintedMode:
    labels, values = np.array(list(nodes), dtype=np.int64), numbers(path, fields)
    if len(values) != 6 * len(labels):
        raise FileError(f"{path}: a shape has {len(values)} numbers at {len(labels)} points; the file is cut short")
    if not np.isfinite(values).all():
        at = labels[int(np.argmin(np.isfinite(values))) // 6]
        raise FileError(
            f"{path}: the shape of the mode at {frequency:.6g} Hz is NaN or infinite at point {at}; {_RUN_AGAIN}"
        )
    return PrintedMode(frequency, labels, values.reshape(-1, 6))


def numbers(path: Path, fields: Sequence[str]) -> FloatArray:
    """Numbers of text fields, Fortran's exponents among them.

    Raises
    ------
    FileError
        If one is none.
    """
    table = np.array([field.encode("latin-1") for field in fields], dtype="S24")
    width = table.dtype.itemsize
    letters = np.frombuffer(table.tobytes(), dtype=np.uint8).reshape(-1, width)
    try:
        return real_numbers(np.where(letters == 0, np.uint8(ord(" ")), letters))
    except FieldError as error:
        raise FileError(f"{path}: {error.text[:30]!r} is no number; the file is damaged, {_RUN_AGAIN}") from error


def read_modes_nastran(path: Path) -> ModalRecord:
    """The modes of a listing or punch file, translations that move at all, entry of largest magnitude 1.

    Rotations are left out: beside translations they mean something in metres only, and the file does not say its unit.

    Raises
    ------
    FileError
        If there are none, or points differ from mode to mode.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    is_listing = path.suffix.lower() in F06_SUFFIXES
    modes = sorted((f06_modes if is_listing else punch_modes)(path, lines), key=lambda mode: mode.frequency)
    if not modes:
        raise FileError(f"{path}: holds no real modes; {_RUN_AGAIN}")
    nodes = modes[0].nodes
    if len(np.unique(nodes)) != len(nodes):
        raise FileError(f"{path}: a point is printed twice in one mode, as of several subcases; leave one of them")
    for number, mode in enumerate(modes, 1):
        if not np.array_equal(mode.nodes, nodes):
            raise FileError(
                f"{path}: mode {number} has other points than the first; the file is cut short, {_RUN_AGAIN}"
            )
    shapes = np.stack([mode.values[:, :3].ravel() for mode in modes], axis=1)
    moving = np.flatnonzero(np.abs(shapes).max(axis=1) > 0)
    if (np.abs(shapes).max(axis=0) == 0).any():
        raise FileError(f"{path}: a mode has no translation anywhere; leave it out, or {_RUN_AGAIN}")
    channels = [Dof(int(nodes[row // 3]), DIRECTIONS[row % 3]) for row in moving.tolist()]
    frequency = np.array([mode.frequency for mode in modes])
    return ModalRecord(
        frequency, np.full(len(frequency), np.nan), unit_largest(shapes[moving]), channels, source=path.name
    )
