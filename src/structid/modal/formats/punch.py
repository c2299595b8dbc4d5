"""Modes in the punch files of Nastran (``.pch``, ``.pun``): eigenvectors with their eigenvalues, real or complex."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.arrays import NumberArray
from structid.core.dof import is_whole_number
from structid.core.errors import FileError
from structid.files.uff.datasets import real_number
from structid.modal.formats.printed import (
    RUN_AGAIN,
    ModeFileOptions,
    PrintedMode,
    PrintedModes,
    VectorKey,
    chosen_run,
    complex_values,
    oscillating,
    parse_numbers,
    undamped,
)
from structid.modal.modal_record import ModalRecord

_REAL = r"[-+]?\d*\.\d*(?:[EDed]?[-+]\d+)?"
_EIGENVALUE = re.compile(rf"^\$EIGENVALUE\s*=\s*({_REAL})\s+MODE\s*=\s*(\d+)")
_COMPLEX_EIGENVALUE = re.compile(rf"^\$EIGENVALUE\s*=\s*\(\s*({_REAL})\s*,\s*({_REAL})\s*\)\s+MODE\s*=\s*(\d+)")
_SUBCASE = re.compile(r"^\$SUBCASE ID\s*=\s*(\d+)")
_SUPERELEMENT = re.compile(r"^\$SUPERELEMENT(?: ID)?\s*=\s*(\d+)|^\$SEID\s*=\s*(\d+)")
#: What else may stand above a vector.
_HEADINGS = ("TITLE", "SUBTITLE", "LABEL", "RANDOM", "ENTIRE", "COORDINATE")
#: Columns of a punched line: a label, or ``-CONT-``, the kind of point, three numbers, and the number of the line.
_LABEL, _KIND, _FIRST, _WIDTH, _END = slice(0, 10), slice(10, 18), 18, 18, 72
_CONTINUED = "-CONT-"
_LARGEST_LABEL = 99_999_999
#: Width of a punched line, its number included.
_LINE = 80
#: Numbers of a point by the form that they are punched in.
_FORMS = {"REAL": 6, "REAL-IMAGINARY": 12, "MAGNITUDE-PHASE": 12}


@dataclass
class _Vector:
    form: str
    line: int
    rows: dict[int, list[str]] = field(default_factory=dict)
    scalars: set[int] = field(default_factory=set)


def modes_punch(path: Path, modes: ModalRecord) -> str:
    """Text of a Nastran punch file of real `modes`: one vector for each mode, six components for each grid point.

    Numbers have seven digits; directions that were not measured are 0. Damping ratios are left out, since a real eigenvector of
    Nastran has none. `path` is for errors.

    Raises
    ------
    FileError
        If a shape is complex or has an unknown entry, or a node has more digits than a label of Nastran.
    """
    if np.iscomplexobj(modes.mode_shapes) or not modes.known.all():
        raise FileError(f"{path}: a punch file holds real and complete mode shapes; write these as .json or .csv")
    if wide := [dof.node for dof in modes.channels if dof.node > _LARGEST_LABEL]:
        raise FileError(
            f"{path}: node {wide[0]} has more than the eight digits of a grid point; renumber it, or write .json"
        )
    nodes = sorted({dof.node for dof in modes.channels})
    row_of = {node: row for row, node in enumerate(nodes)}
    lines: list[str] = []
    for k in range(modes.n_modes):
        motion = np.zeros((len(nodes), 6))
        for dof, value in zip(modes.channels, modes.mode_shapes[:, k].tolist(), strict=True):
            motion[row_of[dof.node], dof.axis] = dof.sign * value
        eigenvalue = f"$EIGENVALUE = {modes.omega[k] ** 2:14.7E}  MODE = {k + 1:5d}"
        lines += ["$TITLE   =", "$SUBTITLE=", "$LABEL   =", "$EIGENVECTOR", "$REAL OUTPUT", "$SUBCASE ID =           1"]
        lines.append(eigenvalue)
        for node, values in zip(nodes, motion.tolist(), strict=True):
            first, second = ("".join(f"{value:18.6E}" for value in part) for part in (values[:3], values[3:]))
            lines += [f"{node:10d}       G{first}", f"{_CONTINUED:<18s}{second}"]
    return "".join(f"{line:<{_END}s}{number:{_LINE - _END}d}\n" for number, line in enumerate(lines, 1))


def punch_modes(path: Path, text: str, options: ModeFileOptions) -> PrintedModes:
    """Vibration modes in the `text` of a Nastran punch file, in the units of the model; no mode if it has no vectors.

    `options` choose the subcase, and real or complex modes where the file has both. Eigenvalues are s in rad/s, of
    complex modes those with a positive imaginary part; generalized masses are NaN, as the file has none. `path` is for
    errors.

    Raises
    ------
    FileError
        If several runs have modes, or a line is damaged or cut short.
    """
    lines = text.splitlines()
    vectors: dict[VectorKey, _Vector] = {}
    subcase: int | None = None
    superelement: int | None = None
    vector: _Vector | None = None
    values: list[str] | None = None
    is_vector, form = False, ""
    for number, line in enumerate(lines, 1):
        if line.startswith("$"):
            words = line[:_END].split()
            name = words[0].removeprefix("$").partition("=")[0]
            if line[:_END].rstrip() == "$EIGENVECTOR":
                is_vector, form, subcase, superelement, vector = True, "", None, None, None
            elif words[-1] == "OUTPUT" and is_vector:
                form = line[1:_END].rsplit("OUTPUT", 1)[0].strip()
                if form not in _FORMS:
                    raise FileError(f"{path}, line {number}: holds a vector in the form {form!r}; {RUN_AGAIN}")
            elif match := _SUBCASE.match(line):
                subcase = int(match[1])
            elif match := _SUPERELEMENT.match(line):
                superelement = int(match[1] or match[2])
            elif is_vector and name.startswith("EIGENVALUE"):
                key = _read_key(path, number, line, subcase, superelement)
                vector = vectors.setdefault(key, _Vector(form, number))
            elif name not in _HEADINGS:
                is_vector, vector = False, None
            continue
        if vector is None:
            continue
        fields = [line[_FIRST + k * _WIDTH : _FIRST + (k + 1) * _WIDTH].strip() for k in range(3)]
        if not all(fields):
            raise FileError(
                f"{path}, line {number}: must hold three numbers, got {line[:_END].strip()!r}; the file is cut short,"
                f" {RUN_AGAIN}"
            )
        label, kind = line[_LABEL].strip(), line[_KIND].strip()
        if label == _CONTINUED:
            if values is None:
                raise FileError(f"{path}, line {number}: goes on with a point that has not begun; the file is damaged")
            values.extend(fields)
            continue
        if not is_whole_number(label):
            raise FileError(
                f"{path}, line {number}: {label[:20]!r} is no label of a point; the file is damaged, {RUN_AGAIN}"
            )
        values = list(fields)
        if kind == "G":
            _add(path, number, vector, int(label), values)
        else:
            vector.scalars.add(int(label))
    if vector is not None and not text.endswith(("\n", "\r")) and len(lines[-1]) <= _END:
        raise FileError(f"{path}, line {len(lines)}: ends within a line; the file is cut short, {RUN_AGAIN}")
    if not vectors:
        return PrintedModes([])
    keys = chosen_run(path, list(vectors), options)
    if keys[0].is_complex:
        chosen, notes = oscillating(path, keys, [complex(*map(real_number, key.eigenvalue)) for key in keys])
    else:
        s = undamped(path, [real_number(key.eigenvalue[0]) for key in keys])
        chosen = list(zip(keys, s, strict=True))
        notes = ("eigenvalues taken as squares of circular frequencies (a punch file of buckling looks alike)",)
    return PrintedModes([_printed_mode(path, key, vectors[key], value) for key, value in chosen], notes)


def _read_key(path: Path, number: int, line: str, subcase: int | None, superelement: int | None) -> VectorKey:
    """Key of the vector that an EIGENVALUE line of a punch file announces; `FileError` if the line holds none.

    The key has the number of the mode and its eigenvalue as text, real and imaginary part if it is complex. `number` is
    that of the line, from 1; `subcase` and `superelement` are the numbers stated above the line, None if there are
    none.
    """
    if match := _EIGENVALUE.match(line):
        return VectorKey(subcase, superelement, int(match[2]), (match[1],))
    if match := _COMPLEX_EIGENVALUE.match(line):
        return VectorKey(subcase, superelement, int(match[3]), (match[1], match[2]), True)
    raise FileError(
        f"{path}, line {number}: must hold the eigenvalue and number of a mode, got {line[:_END].strip()!r}; {RUN_AGAIN}"
    )


def _add(path: Path, number: int, vector: _Vector, node: int, values: list[str]) -> None:
    if node in vector.rows:
        raise FileError(f"{path}, line {number}: point {node} is punched twice in one mode; leave one of them")
    vector.rows[node] = values


def _printed_mode(path: Path, key: VectorKey, vector: _Vector, eigenvalue: complex) -> PrintedMode:
    """`PrintedMode` from the rows of a vector in a punch file: values (n_points, 6), complex for a complex vector.

    `key` names the mode in errors, `eigenvalue` is s in rad/s; the generalized mass is NaN. `FileError` if a row is
    incomplete or a value is not finite.
    """
    width = _FORMS[vector.form]
    for node, values in vector.rows.items():
        if len(values) != width:
            raise FileError(
                f"{path}: point {node} of mode {key.mode} has {len(values)} of its {width} numbers; the file is cut short"
            )
    texts: Sequence[str] = [text for values in vector.rows.values() for text in values]
    table = parse_numbers(path, texts).reshape(-1, width)
    nodes = np.array(list(vector.rows), dtype=np.int64)
    if not np.isfinite(table).all():
        point = nodes[np.argmin(np.isfinite(table).all(axis=1))]
        raise FileError(f"{path}: the shape of mode {key.mode} is NaN or infinite at point {point}; {RUN_AGAIN}")
    shape: NumberArray = table
    if width == 12:
        shape = complex_values(table[:, :6], table[:, 6:], vector.form.startswith("MAGNITUDE"))
    return PrintedMode(eigenvalue, nodes, shape, np.full(len(nodes), -1), n_scalar=len(vector.scalars))
