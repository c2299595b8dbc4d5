"""Modes in the result files of CalculiX (``.frd`` in text): one block of displacements for each mode of ``*FREQUENCY``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from structid.core.errors import FileError
from structid.modal.formats.printed import (
    RUN_AGAIN,
    ModeFileOptions,
    PrintedMode,
    PrintedModes,
    parse_numbers,
    printed_record,
)
from structid.modal.modal_record import ModalRecord

_MASS = re.compile(r"^\s+1PGM\s+(\S+)")
#: Columns of a row: the label ends at the first, and each number has this width.
_FIRST, _WIDTH = 13, 12


def frd_modes(path: Path, text: str) -> PrintedModes:
    """Modes with displacements in the `text` of a CalculiX result file (blocks ``100CL`` called MODAL), in order.

    Eigenvalues are i omega in rad/s, values (n_points, 6) with NaN for rotations, and the generalized mass is NaN where
    none is printed. There is no mode if the file has none. `path` is for errors.

    Raises
    ------
    FileError
        If the file is cut short, or a displacement is no number.
    """
    lines = text.splitlines()
    modes: list[PrintedMode] = []
    mass = np.nan
    for line_index, line in enumerate(lines):
        if match := _MASS.match(line):
            mass = float(match[1])
        if (
            line.startswith("  100C")
            and "MODAL" in line
            and line_index + 1 < len(lines)
            and "DISP" in lines[line_index + 1]
        ):
            begin = next((i for i in range(line_index + 1, len(lines)) if lines[i].startswith(" -1")), len(lines))
            end = next((i for i in range(begin, len(lines)) if not lines[i].startswith(" -1")), len(lines))
            if end == len(lines) or not lines[end].startswith(" -3"):
                raise FileError(f"{path}, line {end}: a shape has no end; the file is cut short, {RUN_AGAIN}")
            rows = lines[begin:end]
            fields = [row[_FIRST + k * _WIDTH : _FIRST + (k + 1) * _WIDTH] for row in rows for k in range(3)]
            values = np.full((len(rows), 6), np.nan)
            values[:, :3] = parse_numbers(path, fields).reshape(-1, 3)
            labels = np.array([int(row[3:_FIRST]) for row in rows])
            eigenvalue = 2j * np.pi * float(line[12:24])
            modes.append(PrintedMode(eigenvalue, labels, values, np.zeros(len(rows), dtype=np.int64), mass))
            mass = np.nan
    if not any(line.startswith(" 9999") for line in lines[-3:]):
        raise FileError(f"{path}: has no last line 9999; the file is cut short, {RUN_AGAIN}")
    return PrintedModes(modes, ("displacements taken as global (the default of *NODE FILE)",))


def read_modes_calculix(path: Path, options: ModeFileOptions) -> ModalRecord:
    """The modes of a CalculiX result file at the translations that move, largest entry 1.

    Modal masses are 1 instead where `options` state units of length and force, which needs generalized masses in the
    file.

    Raises
    ------
    FileError
        If there are none, as in a file of buckling, the file is cut short, or generalized masses are missing.
    """
    printed = frd_modes(path, path.read_text(encoding="latin-1"))
    if not printed.modes:
        raise FileError(f"{path}: holds no modes of vibration with displacements; run *FREQUENCY with *NODE FILE and U")
    return printed_record(path, printed, options)
