"""Modes as CSV, one row a mode: what a spreadsheet opens, and what a table of published modes becomes."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from structid.arrays import FloatArray
from structid.dof import Dof, parse_dof
from structid.errors import FileError, InputError
from structid.modal.modal_record import ModalRecord, Scaling, unit_largest
from structid.modal.poles import modal_phase_collinearity

_NUMBERS = ("frequency_hz", "frequency_std_hz", "damping_ratio", "damping_std")
_PARTS = ("real", "imaginary", "std")


def modes_csv(modes: ModalRecord) -> str:
    """The text: frequency, damping ratio, their standard deviations, MPC, scaling, then the shape by channel."""
    n, shapes = modes.n_modes, modes.mode_shapes
    std = np.full(2 * n, np.nan) if modes.covariance is None else np.sqrt(np.diag(modes.covariance))
    columns = [("mode", np.arange(1, n + 1)), ("frequency_hz", modes.frequency), ("frequency_std_hz", std[:n])]
    columns += [("damping_ratio", modes.damping_ratio), ("damping_std", std[n:])]
    columns += [("mpc", modal_phase_collinearity(shapes.astype(np.complex128))), ("scaling", np.full(n, modes.scaling))]
    for i, dof in enumerate(modes.channels):
        columns.append((f"{dof} real" if np.iscomplexobj(shapes) else str(dof), shapes[i].real))
        if np.iscomplexobj(shapes):
            columns.append((f"{dof} imaginary", shapes[i].imag))
        if modes.shape_std is not None:
            columns.append((f"{dof} std", modes.shape_std[i]))
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow([name for name, _ in columns])
    table.writerows([[_cell(values[k]) for _, values in columns] for k in range(n)])
    return stream.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, float | np.floating):
        return repr(float(value)) if np.isfinite(value) else ""
    return str(value)


def read_modes_csv(path: Path) -> ModalRecord:
    """The modes in the table at `path`: ``frequency_hz`` and one column a channel are needed, the rest is optional.

    Raises
    ------
    FileError
        If the file is not such a table, or a cell cannot be used; with its line and column.
    """
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines(), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{path}: is not a CSV table in UTF-8 ({error}); save it as CSV UTF-8") from error
    header, lines = [cell.strip() for cell in rows[0]], [row for row in rows[1:] if any(cell.strip() for cell in row)]
    if "frequency_hz" not in header or not lines:
        raise FileError(f"{path}: must have a column `frequency_hz` and one row a mode, got {', '.join(header[:8])}")
    for number, row in enumerate(lines, 2):
        if len(row) != len(header):
            raise FileError(f"{path}: line {number} has {len(row)} cells, the header {len(header)}; mend the line")
    order = np.argsort(_column(path, header, lines, "frequency_hz"), kind="stable")
    found = {name: _column(path, header, lines, name)[order] for name in _NUMBERS}
    if np.isnan(found["frequency_hz"]).any():
        raise FileError(f"{path}: a mode has no `frequency_hz`; give it, or leave the mode out")
    scaling = _scaling(path, header, lines)
    dofs = _channels(path, header)
    shapes, shape_std = _shapes(path, header, lines, dofs)
    size = np.abs(shapes).max(axis=0)
    if not size.all():
        raise FileError(
            f"{path}: line {int(np.argmin(size)) + 2} has a mode shape of zeros; give it, or leave the mode out"
        )
    if scaling == "mass" or np.allclose(size, 1.0, rtol=0, atol=1e-9):
        size = np.ones(len(lines))
    else:
        shapes = unit_largest(shapes)
    stds = np.concatenate([found["frequency_std_hz"], found["damping_std"]])
    return ModalRecord(
        found["frequency_hz"], found["damping_ratio"], shapes[:, order], dofs, scaling=scaling, source=path.name,
        covariance=None if np.isnan(stds).all() else _independent(stds),
        shape_std=None if shape_std is None else (shape_std / size)[:, order],
    )  # fmt: skip


def _independent(stds: FloatArray) -> FloatArray:
    """Covariance of errors that are taken as independent; NaN throughout where a standard deviation is missing."""
    known = ~np.isnan(stds)
    covariance = np.where(np.outer(known, known), 0.0, np.nan)
    np.fill_diagonal(covariance, stds**2)
    return covariance


def _column(path: Path, header: list[str], lines: list[list[str]], name: str) -> FloatArray:
    """NaN where a cell is empty or the column is missing."""
    values = np.full(len(lines), np.nan)
    if name in header:
        at = header.index(name)
        for k, row in enumerate(lines):
            text = row[at].strip()
            try:
                values[k] = float(text) if text else np.nan
            except ValueError:
                raise FileError(f"{path}: line {k + 2}, column `{name}` must be a number, got {text!r}") from None
    return values


def _scaling(path: Path, header: list[str], lines: list[list[str]]) -> Scaling:
    given = {row[header.index("scaling")].strip() for row in lines} if "scaling" in header else {"unit_largest"}
    if given == {"mass"}:
        return "mass"
    if given == {"unit_largest"}:
        return "unit_largest"
    raise FileError(f"{path}: column `scaling` must be unit_largest or mass, the same for all, got {sorted(given)}")


def _channels(path: Path, header: list[str]) -> tuple[Dof, ...]:
    """Every channel that a column names, in order."""
    known = {"mode", "mpc", "scaling", *_NUMBERS}
    found: dict[Dof, None] = {}
    for name in header:
        if name in known:
            continue
        first, _, part = name.partition(" ")
        try:
            dof = parse_dof(first)
        except InputError as error:
            raise FileError(f"{path}: column {name!r} is no channel ({error})") from error
        if part and part not in _PARTS:
            raise FileError(f"{path}: column {name!r} must end in {', '.join(_PARTS)}, or name the channel only")
        found[dof] = None
    if not found:
        raise FileError(f"{path}: has no column of a mode shape; name one after each channel, as in 1X+")
    return tuple(found)


def _shapes(
    path: Path, header: list[str], lines: list[list[str]], dofs: tuple[Dof, ...]
) -> tuple[NDArray[np.inexact], FloatArray | None]:
    """Shapes and standard deviations of their entries, one row a channel."""
    names = {}
    for name in header:
        first, _, part = name.partition(" ")
        if first[:1].isdigit():
            names[parse_dof(first), part or "real"] = name
    rows: dict[str, list[FloatArray]] = {part: [] for part in _PARTS}
    for dof in dofs:
        for part in _PARTS:
            rows[part].append(_column(path, header, lines, names.get((dof, part), "")))
        if np.isnan(rows["real"][-1]).any():
            raise FileError(f"{path}: the shape at {dof} has an empty cell; give every mode a value at every channel")
    real, imaginary, std = (np.array(rows[part]) for part in _PARTS)
    shapes = real if np.isnan(imaginary).all() else real + 1j * np.nan_to_num(imaginary)
    return shapes, None if np.isnan(std).all() else std
