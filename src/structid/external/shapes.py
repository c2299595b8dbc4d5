"""Modes as solvers print them: frequencies and mass-normalized shapes of all nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS
from structid.core.errors import FileError, InputError
from structid.files import damage_told, require_readable
from structid.modal.formats.files import read_modes
from structid.modal.formats.nastran import F06_SUFFIXES, PUNCH_SUFFIXES, nastran_modes
from structid.modal.formats.printed import numbers

#: Suffixes that are read here; others are files of modes as `read_modes` knows them.
FRD, NASTRAN = (".frd",), (*F06_SUFFIXES, *PUNCH_SUFFIXES)
#: Six and seven digits.
_ROUNDING = {".frd": 5e-6, **dict.fromkeys(NASTRAN, 5e-7)}
_RUN_AGAIN = "let the solver print frequencies and displacements of all modes"
_FRD_WIDTH, _FRD_FIRST = 12, 13


@dataclass(frozen=True, eq=False)
class Shapes:
    """Modes of a run.

    Attributes
    ----------
    frequency : (n_modes,) float array
        Hz, ascending.
    dofs : (n_dofs, 2) int array
        Node and component (1 to 6) of each row.
    values : (n_dofs, n_modes) float array
        In the length unit of the solver.
    has_mass : bool
        Whether modal masses are 1 in the units of the solver; otherwise the scale of each shape is free.
    rounding : float
        Of printed shapes, as a part of their size.
    """

    frequency: FloatArray
    dofs: IntArray
    values: FloatArray
    has_mass: bool
    rounding: float = 1e-9


def read_shapes(path: Path) -> Shapes:
    """The modes in the file at `path`.

    Parameters
    ----------
    path : Path
        CalculiX ``.frd`` in text, Nastran or MYSTRAN ``.f06`` or ``.pch``, or what `structid.modal.formats.files.read_modes` reads.

    Raises
    ------
    FileError
        If the file is missing, cut short, or holds no modes.
    """
    suffix = path.suffix.lower()
    if suffix not in (*FRD, *NASTRAN):
        return _of_record(path)
    require_readable(path)
    with damage_told(path, "a file of modes", _RUN_AGAIN):
        if suffix in FRD:
            frequency, modes = _frd(path, path.read_text(encoding="latin-1").splitlines())
        else:
            frequency, modes = _nastran(path)
    if not modes:
        raise FileError(f"{path}: holds no modes; {_RUN_AGAIN}")
    nodes = modes[0][0]
    for number, (own, values) in enumerate(modes, 1):
        if len(own) != len(nodes) or not np.array_equal(own, nodes) or values.shape != modes[0][1].shape:
            raise FileError(
                f"{path}: mode {number} has {len(own)} nodes, the first {len(nodes)}; the file is cut short"
            )
    width = modes[0][1].shape[1]
    dofs = np.stack([np.repeat(nodes, width), np.tile(np.arange(1, width + 1), len(nodes))], axis=1)
    return _sorted(path, frequency, dofs, np.stack([values.ravel() for _, values in modes], axis=1), True, suffix)


def _nastran(path: Path) -> tuple[list[float], list[tuple[IntArray, FloatArray]]]:
    """Frequencies and mass-normalized shapes of a listing, which prints modal masses, or of a punch file, where they are 1."""
    printed = nastran_modes(path).modes
    if any(np.iscomplexobj(mode.values) for mode in printed):
        raise FileError(f"{path}: holds complex modes; let the solver print real ones (SOL 103)")
    modes: list[tuple[IntArray, FloatArray]] = []
    for mode in printed:
        values = np.real(mode.values if np.isfinite(mode.values[:, 3:]).all() else mode.values[:, :3])
        scale = np.sqrt(mode.generalized_mass) if mode.generalized_mass > 0 else 1.0
        modes.append((mode.nodes, values / scale))
    return [mode.frequency for mode in printed], modes


def require_last_line(path: Path) -> None:
    """Raise a `FileError` where a table ends within a line, as where the run that writes it was cut short."""
    if path.suffix.lower() == ".csv" and not path.read_bytes().endswith((b"\n", b"\r")):
        raise FileError(f"{path}: ends within a line; the file is cut short: end each line, the last one too")


def _of_record(path: Path) -> Shapes:
    record = read_modes(path)
    require_last_line(path)
    signs = np.array([dof.sign for dof in record.channels])
    dofs = np.array([(dof.node, DIRECTIONS.index(dof.direction) + 1) for dof in record.channels], dtype=np.int64)
    values = np.real(np.asarray(record.mode_shapes)) * signs[:, None]
    return _sorted(path, record.frequency, dofs, values, record.scaling == "mass", "")


def _sorted(
    path: Path, frequency: Sequence[float] | FloatArray, dofs: IntArray, values: FloatArray, has_mass: bool, suffix: str
) -> Shapes:
    own = np.asarray(frequency, dtype=np.float64)
    if len(own) != values.shape[1]:
        raise FileError(f"{path}: holds {len(own)} frequencies and {values.shape[1]} shapes; {_RUN_AGAIN}")
    if not (np.isfinite(own).all() and np.isfinite(values).all()):
        raise FileError(f"{path}: holds frequencies or shapes that are not finite; check the model, and {_RUN_AGAIN}")
    still = np.flatnonzero(~values.any(axis=0))
    if len(still):
        raise FileError(
            f"{path}: nothing moves in mode {still[0] + 1}; the solver found no such mode: look into its log, ask for fewer modes"
        )
    order = np.argsort(own, kind="stable")
    return Shapes(own[order], dofs, values[:, order], has_mass, _ROUNDING.get(suffix, Shapes.rounding))


def _frd(path: Path, lines: Sequence[str]) -> tuple[list[float], list[tuple[IntArray, FloatArray]]]:
    """CalculiX: blocks ``100CL`` of a mode with its frequency, whose ``-4  DISP`` has the shape."""
    frequency: list[float] = []
    modes: list[tuple[IntArray, FloatArray]] = []
    for at, line in enumerate(lines):
        if line.startswith("  100C") and "MODAL" in line and at + 1 < len(lines) and "DISP" in lines[at + 1]:
            begin = next((i for i in range(at + 1, len(lines)) if lines[i].startswith(" -1")), len(lines))
            end = next((i for i in range(begin, len(lines)) if not lines[i].startswith(" -1")), len(lines))
            if end == len(lines) or not lines[end].startswith(" -3"):
                raise FileError(f"{path}, line {end}: a shape has no end; the file is cut short, {_RUN_AGAIN}")
            frequency.append(float(line[12:24]))
            rows = lines[begin:end]
            fields = [
                row[_FRD_FIRST + k * _FRD_WIDTH : _FRD_FIRST + (k + 1) * _FRD_WIDTH] for row in rows for k in range(3)
            ]
            modes.append((np.array([int(row[3:_FRD_FIRST]) for row in rows]), numbers(path, fields).reshape(-1, 3)))
    if not any(line.startswith(" 9999") for line in lines[-3:]):
        raise FileError(f"{path}: has no last line 9999; the file is cut short, {_RUN_AGAIN}")
    return frequency, modes


def require_same_dofs(first: Shapes, other: Shapes, words: str) -> None:
    """Raise an `InputError` where two runs have other nodes."""
    if not np.array_equal(first.dofs, other.dofs):
        raise InputError(
            f"the shapes of the run at {words} have {len(other.dofs)} degrees of freedom, those of the nominal run"
            f" {len(first.dofs)}, or others; keep the mesh, and mark numbers that do not renumber it"
        )
