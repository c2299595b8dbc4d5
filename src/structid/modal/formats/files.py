"""Modes written to files and read back: JSON (complete), universal files (dataset 55), Nastran punch files and CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.errors import FileError, InputError
from structid.core.json_types import StoredEntry, json_text
from structid.files import atomic_write, damage_told, require_readable
from structid.modal.formats.calculix import read_modes_calculix
from structid.modal.formats.csv import modes_csv, read_modes_csv
from structid.modal.formats.nastran import read_modes_nastran
from structid.modal.formats.options import (
    CSV_SUFFIXES,
    F06_SUFFIXES,
    FRD_SUFFIXES,
    JSON_SUFFIXES,
    OP2_SUFFIXES,
    PUNCH_SUFFIXES,
    UFF_SUFFIXES,
    WRITTEN_SUFFIXES,
    ModeFileOptions,
)
from structid.modal.formats.punch import modes_punch
from structid.modal.formats.uff import modes_uff, read_modes_uff
from structid.modal.modal_record import ModalChanges, ModalRecord
from structid.modal.poles.poles import modal_phase_collinearity
from structid.records.formats.geometry import Geometry

_NASTRAN = (*F06_SUFFIXES, *PUNCH_SUFFIXES, *OP2_SUFFIXES)
#: Suffixes of the files that an option is about, where these are not those of Nastran alone.
_ABOUT = {"shape_axes": UFF_SUFFIXES} | dict.fromkeys(
    ("length_unit", "force_unit"), (*_NASTRAN, *UFF_SUFFIXES, *FRD_SUFFIXES)
)
_READ = (*dict.fromkeys((*WRITTEN_SUFFIXES, *_NASTRAN, *FRD_SUFFIXES)),)
#: What to do about files that are often at hand.
_ELSEWHERE = {
    ".xdb": "is a database of Nastran; let it print the vectors (.f06) or punch them (.pch)",
    ".odb": "is read by Abaqus alone; print the shapes (*NODE PRINT) to a table, and give it as CSV",
    ".rst": "is read by Ansys alone; list the shapes (PRNSOL) to a table, and give it as CSV",
}


def read_modes(path: str | Path, options: ModeFileOptions | None = None) -> ModalRecord:
    """Modes in the file at `path`, in the format of its suffix.

    Parameters
    ----------
    path : str or Path
        ``.json`` as written by `write_modes` or by the command ``structid modes``; ``.uff``, ``.unv`` or ``.uf`` with
        datasets 55 or 2414; ``.csv`` with one row a mode; ``.f06``, ``.pch``, ``.pun`` or ``.op2`` with eigenvectors of Nastran;
        ``.frd`` of CalculiX.
    options : ModeFileOptions, optional
        Facts that a universal file or one of Nastran does not state.

    Raises
    ------
    FileError
        If the file is missing, damaged, of another kind, or a field of it cannot be used; the message begins with
        its path and names the field.
    InputError
        If an option is of no use for the format, or contradicts the file.

    Notes
    -----
    JSON keeps everything, with all digits. A universal file keeps six digits, and no covariance, standard
    deviations, warnings or unknown entries of shapes; each sense becomes the positive one, and a damping ratio of 0
    means that it is not known. CSV keeps standard deviations but not how errors move together: they count as
    independent. Shape entries that are blank or ``nan`` there, or null in JSON, are unknown. Of Nastran's files
    translations are read, and rotations where `options.length_unit` is stated, beside which alone their size has a
    meaning; real modes there hold no damping. What a reader took for granted or left out stands in the `source` of the
    record, behind the name of the file.
    """
    path, options = Path(path), options or ModeFileOptions()
    suffix = path.suffix.lower()
    _require_suffix(path, suffix, _READ)
    for name in (item.name for item in fields(options)):
        if getattr(options, name) and suffix not in _ABOUT.get(name, _NASTRAN):
            subject = "universal files" if name == "shape_axes" else "files of Nastran"
            raise InputError(f"{path}: `{name}` is about {subject}; leave it out", name)
    require_readable(path)
    with damage_told(path, "a file of modes", "copy it again, or run `structid modes` again"):
        if suffix in UFF_SUFFIXES:
            return read_modes_uff(path, options)
        if suffix in _NASTRAN:
            return read_modes_nastran(path, options)
        if suffix in FRD_SUFFIXES:
            return read_modes_calculix(path, options)
        return _read_json(path) if suffix in JSON_SUFFIXES else read_modes_csv(path)


def write_modes(path: str | Path, modes: ModalRecord, geometry: Geometry | None = None) -> None:
    """Write `modes` to `path` in the format of its suffix, complete or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in ``.json``, ``.csv``, or a suffix of universal or Nastran punch files; an existing file is replaced.
    modes : ModalRecord
    geometry : Geometry, optional
        Nodes and lines of the test, which universal files hold (datasets 15, 2411, 82); other formats ignore it.

    Raises
    ------
    FileError
        If the suffix is not known, the format cannot hold the modes, or the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    _require_suffix(path, suffix, WRITTEN_SUFFIXES)
    if suffix in JSON_SUFFIXES:
        content = json_text(modal_fields(modes)).encode("utf-8")
    elif suffix in PUNCH_SUFFIXES:
        content = modes_punch(path, modes).encode("ascii")
    else:
        content = modes_csv(modes).encode("utf-8") if suffix in CSV_SUFFIXES else modes_uff(path, modes, geometry)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def _require_suffix(path: Path, suffix: str, known: tuple[str, ...]) -> None:
    """Raise `FileError` unless `suffix` is among `known`, with a hint for formats that are read elsewhere."""
    if suffix in _ELSEWHERE:
        raise FileError(f"{path}: {_ELSEWHERE[suffix]}")
    if suffix not in known:
        raise FileError(f"{path}: the suffix {suffix!r} is of no format for modes; use one of {' '.join(known)}")


def modal_fields(modes: ModalRecord) -> dict[str, StoredEntry]:
    """Fields of `modes` for JSON; matrices as lists of rows, a row of `mode_shapes` for each of `channels`.

    Keys are those of modes.json: ``frequency_hz``, ``damping_ratio``, their ``..._std``, ``mpc``, ``channels``,
    ``scaling``, ``mode_shapes`` (``real``, ``imaginary``), ``shape_std``, ``covariance``, ``changes``, ``source`` and
    ``warnings``. What is not known is None, single numbers NaN.
    """
    std = np.full(2 * modes.n_modes, np.nan) if modes.covariance is None else np.sqrt(np.diag(modes.covariance))
    shapes = modes.mode_shapes
    return {
        "frequency_hz": modes.frequency.tolist(),
        "frequency_std_hz": std[: modes.n_modes].tolist(),
        "damping_ratio": modes.damping_ratio.tolist(),
        "damping_std": std[modes.n_modes :].tolist(),
        "mpc": modal_phase_collinearity(shapes.astype(np.complex128)).tolist(),
        "channels": [str(dof) for dof in modes.channels],
        "scaling": modes.scaling,
        "mode_shapes": {
            "real": shapes.real.tolist(),
            "imaginary": shapes.imag.tolist() if np.iscomplexobj(shapes) else None,
        },
        "shape_std": None if modes.shape_std is None else modes.shape_std.tolist(),
        "covariance": None if modes.covariance is None else modes.covariance.tolist(),
        "changes": None if modes.changes is None else _changes_fields(modes.changes),
        "source": modes.source,
        "warnings": list(modes.warnings),
    }


def _changes_fields(changes: ModalChanges) -> dict[str, Any]:
    """Changes of modes for JSON, as tables with one row for each change.

    Rows hold frequencies (Hz), damping ratios, and real and imaginary parts of shapes, all modes of one channel after another.
    """
    shapes = changes.mode_shapes.reshape(len(changes.frequency), -1)
    parts = {
        "frequency_hz": changes.frequency,
        "damping_ratio": changes.damping_ratio,
        "shapes_real": shapes.real,
        "shapes_imaginary": shapes.imag,
    }
    return {key: part.tolist() for key, part in parts.items()}


def _read_changes(path: Path, data: Mapping[str, object], shape: tuple[int, int]) -> ModalChanges | None:
    """`ModalChanges` from the field `changes` of the fields `data` of a modes.json; None if it has no such field.

    With n changes, the tables `frequency_hz` and `damping_ratio` have n rows of n_modes, `shapes_real` and
    `shapes_imaginary` n rows of n_channels * n_modes. `shape` is (n_channels, n_modes). `FileError` if the shape tables
    have another size.
    """
    tables = data.get("changes")
    if tables is None:
        return None
    if not isinstance(tables, dict):
        raise FileError(f"{path}: `changes` must hold tables of changes, got {_short(tables)}; write it again")
    frequency, ratio, real, imaginary = (
        _array(path, tables, key, 2, "changes.")
        for key in ("frequency_hz", "damping_ratio", "shapes_real", "shapes_imaginary")
    )
    if real.shape != (len(frequency), shape[0] * shape[1]) or imaginary.shape != real.shape:
        raise FileError(
            f"{path}: `changes.shapes_real` and `changes.shapes_imaginary` must hold {shape[0] * shape[1]} entries in each"
            f" of {len(frequency)} rows, got {real.shape} and {imaginary.shape}; write it again"
        )
    return ModalChanges(frequency, ratio, (real + 1j * imaginary).reshape(-1, *shape))


def _read_json(path: Path) -> ModalRecord:
    """Modal record stored in a modes.json of `structid modes`; `FileError` if it holds no modes or a field cannot be used."""
    with damage_told(path, "JSON", "copy it again, or run `structid modes` again"):
        data = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(data, dict) or "frequency_hz" not in data:
        raise FileError(f"{path}: has no `frequency_hz`, so it holds no modes; give a modes.json of `structid modes`")
    frequency = _array(path, data, "frequency_hz", 1)
    shapes = data.get("mode_shapes")
    if not isinstance(shapes, dict) or "real" not in shapes:
        raise FileError(f"{path}: `mode_shapes` must hold `real` and `imaginary`, got {_short(shapes)}; write it again")
    real = _array(path, shapes, "real", 2, "mode_shapes.")
    shape = real + 1j * _array(path, shapes, "imaginary", 2, "mode_shapes.") if shapes.get("imaginary") else real
    optional = {key: _array(path, data, key, 2) for key in ("covariance", "shape_std") if data.get(key) is not None}
    return ModalRecord(
        frequency, _array(path, data, "damping_ratio", 1), shape, _texts(path, data, "channels"),
        warnings=_texts(path, data, "warnings", ()), source=str(data.get("source", "")),
        scaling=data.get("scaling", "unit_largest"), changes=_read_changes(path, data, real.shape), **optional,
    )  # fmt: skip


def _array(path: Path, data: Mapping[str, object], key: str, n_axes: int, prefix: str = "") -> np.ndarray:
    """Numbers under `key` of `data` as an array with `n_axes` axes, null read as NaN.

    An empty list gets the missing axes, of length 0. `FileError` if the key is missing, or holds other things than
    numbers, rows of several lengths or another number of axes. `prefix` completes the key in errors.
    """
    try:
        array = np.array(data.get(key), dtype=float)
    except (ValueError, TypeError) as error:
        raise FileError(f"{path}: `{prefix}{key}` must hold numbers, in rows of one length; write it again") from error
    if array.size == 0:
        array = array.reshape((array.shape[0],) + (0,) * (n_axes - 1)) if array.ndim else array
    if array.ndim != n_axes:
        raise FileError(f"{path}: `{prefix}{key}` must be a list of {n_axes} levels, got {_short(data.get(key))}")
    return array


def _texts(path: Path, data: Mapping[str, object], key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """List of texts under `key` of JSON `data`; `FileError` if the value is no list of texts.

    `default` is taken where the key is missing; without a default that is an error too.
    """
    texts = data.get(key, default)
    if not isinstance(texts, list | tuple) or not all(isinstance(text, str) for text in texts):
        raise FileError(f"{path}: `{key}` must be a list of texts, got {_short(texts)}; write it again")
    return tuple(texts)


def _short(value: object) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
