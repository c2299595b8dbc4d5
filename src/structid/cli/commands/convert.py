"""The command `structid convert`: a record, matrices or modes from one format to another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated
from zipfile import ZipFile, is_zipfile

import numpy as np
import typer

from structid.cli.base import say
from structid.core.display import plural
from structid.core.errors import FileError, InputError
from structid.fem.importers import FORMATS as MATRIX_FORMATS
from structid.fem.importers import (
    ImportedMatrix,
    dof_table,
    dofs_of,
    read_matrices,
    read_matrix,
    read_numbering,
    write_abaqus,
    write_matrices,
    write_numbering,
)
from structid.fem.importers.abaqus import Form
from structid.files import claim_path, require_readable
from structid.modal import ModalRecord
from structid.modal.formats.files import read_modes, write_modes
from structid.modal.formats.options import JSON_SUFFIXES, PUNCH_SUFFIXES, UFF_SUFFIXES, ModeFileOptions
from structid.modal.formats.recognition import holds_modes
from structid.records import FrfRecord, ReadOptions, Record, read_record, write_record
from structid.records.formats import how_read

_CONTENTS = ("record", "matrices", "modes")
_MATRIX_SUFFIXES = {suffix for module in MATRIX_FORMATS for suffix in module.SUFFIXES}
#: Suffixes that hold nothing but matrices, and those that hold records or matrices.
_MATRICES_ONLY = _MATRIX_SUFFIXES - {".npz", ".npy", ".mat", *PUNCH_SUFFIXES}
_ARRAYS = (".npz", ".npy", ".mat")
#: Suffixes of DMIG, which holds node and component of each row.
_NUMBERED = next(module.SUFFIXES for module in MATRIX_FORMATS if ".pch" in module.SUFFIXES)


@dataclass(frozen=True)
class MatrixOptions:
    """Options of reading and writing matrices.

    Parameters
    ----------
    matrix : str
        Name of the matrix that is meant, of a file with several; all by default.
    name : str
        Name that the matrix gets, as where the format of OUT has room for eight characters.
    dofs : Path, optional
        File with the node and component of each row, where the file of the matrix does not hold them.
    write_dofs : Path, optional
        File to write the node and component of each row to, where the format of OUT does not hold them.
    mtx : str
        Form of OUT where that is .mtx: `matrixmarket`, or `labels` or `coordinate` of Abaqus.
    """

    matrix: str = ""
    name: str = ""
    dofs: Path | None = None
    write_dofs: Path | None = None
    mtx: str = "matrixmarket"

    def __post_init__(self) -> None:
        if self.mtx not in ("matrixmarket", "labels", "coordinate"):
            raise InputError(f"`mtx` must be matrixmarket, labels or coordinate, got {self.mtx!r}", "mtx")


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN",
            help="Record (NPZ, NPY, HDF5, CSV, MAT, UFF, TDMS, MDF, miniSEED, WAV, Parquet), matrices (OP4, DMIG, Abaqus,"
            " MatrixMarket, NPZ, MAT, Harwell-Boeing ...) or modes (JSON, UFF, CSV, F06, punch, FRD).",
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; the suffix gives the format.")],
    read: ReadOptions,
    modes: ModeFileOptions,
    matrices: MatrixOptions,
    contents: Annotated[
        str,
        typer.Option(help="record, matrices or modes: what IN holds, where its suffix and first lines do not say it."),
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Write OUT even where it exists.")] = False,
) -> None:
    """Read a record, matrices or modes and write them in another format; the suffix of each file gives its format.

    Records are written in SI units, modes in SI units and global axes, matrices in the units of their file. What OUT cannot
    hold is said.

    \b
    Examples:
      structid convert measured.uff measured.h5
      structid convert impact.npy impact.csv --sampling-rate 1024 --channels 1X+,2X+ --units g,N
      structid convert logger.tdms record.h5 --columns "Acc 1,Force" --channels 1X+,3X+
      structid convert frf.npz frf.uff --array accelerance --frequency-array freq_hz
          --outputs 1X-,2X+ --inputs 1X+ --kind accelerance
      structid convert model.op4 stiffness.mtx --matrix KAA
      structid convert stiffness.mtx stiffness.pch --dofs rows.txt --name KAAX
      structid convert frame.f06 modes.uff --length-unit mm
    """
    require_readable(source)
    if target.exists():
        if target.samefile(source):
            raise FileError(f"{target}: is the file that is read; write to another one")
        if not force:
            raise FileError(f"{target}: exists already; add --force to write it anew, or write to another file")
    kind = contents or _contents_of(source, target)
    if kind not in _CONTENTS:
        raise InputError(f"`contents` must be one of {', '.join(_CONTENTS)}, got {contents!r}", "contents")
    for name, options, default in (
        ("record", read, ReadOptions()), ("modes", modes, ModeFileOptions()), ("matrices", matrices, MatrixOptions()),
    ):  # fmt: skip
        if name != kind and options != default:
            raise InputError(
                f"{source}: holds {_words(kind)}; leave out the options of {_words(name)}, or set --contents"
            )
    with claim_path(target):
        if kind == "record":
            lines = _record(source, target, read)
        else:
            lines = _modes(source, target, modes) if kind == "modes" else _matrices(source, target, matrices)
    for line in lines:
        say(line)


def _words(kind: str) -> str:
    return "a record" if kind == "record" else kind


def _contents_of(source: Path, target: Path) -> str:
    """Kind of data in `source`: "record", "matrices" or "modes", by its suffix and content.

    Modes are JSON files and those whose content is modes; matrices are files with a suffix of matrices alone, and punch
    files. NPZ, NPY and MAT files hold matrices if `target` has such a suffix, an NPZ file also by its members. What
    nothing else says is a record.
    """
    suffix = source.suffix.lower()
    if suffix in JSON_SUFFIXES or holds_modes(source):
        return "modes"
    if suffix in (*_MATRICES_ONLY, *PUNCH_SUFFIXES):
        return "matrices"
    if suffix in _ARRAYS and target.suffix.lower() in _MATRICES_ONLY | set(PUNCH_SUFFIXES):
        return "matrices"
    if suffix == ".npz" and is_zipfile(source):
        with ZipFile(source) as archive:
            return "matrices" if {"format.npy", "shape.npy", "data.npy"} <= set(archive.namelist()) else "record"
    return "record"


def _record(source: Path, target: Path, options: ReadOptions) -> list[str]:
    """Convert the record file `source` to `target`, read with `options`, and return the lines to print.

    A line says how the file was read if that is not plain, another what was written.
    """
    record = read_record(source, options)
    write_record(target, record)
    read = [f"read: {record.source}"] if how_read(record.source, source) else []
    return [*read, f"{target}: {_record_size(record)}"]


def _record_size(record: Record) -> str:
    """Kind and size of a record in words, such as "accelerance, 400 lines, 8 outputs, 1 inputs"."""
    if isinstance(record, FrfRecord):
        return (
            f"{record.kind}, {len(record.frequency)} lines, {len(record.outputs)} outputs, {len(record.inputs)} inputs"
        )
    size = f"time histories, {record.values.shape[0]} samples at {record.sampling_rate:g} Hz"
    return f"{size}, {len(record.channels)} channels"


def _modes(source: Path, target: Path, options: ModeFileOptions) -> list[str]:
    """Convert the file of modes `source` to `target`, read with `options`, and return the lines to print.

    Lines say how the file was read if that is not plain, what was written, and what the format of `target` cannot hold.
    """
    record = read_modes(source, options)
    write_modes(target, record)
    is_told = source.suffix.lower() not in JSON_SUFFIXES and "; " in record.source
    read = [f"read: {record.source}"] if is_told else []
    lost = _lost_of_modes(record, target)
    size = f"{plural(record.n_modes, 'mode')} at {plural(len(record.channels), 'channel')}, scaling {record.scaling}"
    return [*read, f"{target}: {size}", *([f"not kept by {target.suffix}: {', '.join(lost)}"] if lost else [])]


def _lost_of_modes(record: ModalRecord, target: Path) -> list[str]:
    """Names of the data in `record` that the format of `target` cannot hold; [] if nothing is lost."""
    suffix = target.suffix.lower()
    lost = []
    if suffix in UFF_SUFFIXES:
        if record.covariance is not None or record.shape_std is not None:
            lost.append("standard deviations")
        if any(dof.sign < 0 for dof in record.channels):
            lost.append("negative senses of sensors (shapes are turned round)")
        lost.append("digits beyond the sixth")
    if suffix not in JSON_SUFFIXES and record.changes is not None:
        lost.append("how errors move together")
    return lost


def _matrices(source: Path, target: Path, options: MatrixOptions) -> list[str]:
    """Convert the file of matrices `source` to `target`, and return the lines to print.

    There is a line for each matrix, and one on node and component of the rows. The options choose one matrix, give it a
    name, read node and component of the rows from a file or write them to one, and choose a form of ``.mtx``.
    `InputError` if `target` can hold one matrix and there are more.
    """
    items = [read_matrix(source, options.matrix)] if options.matrix else list(read_matrices(source).values())
    if options.name:
        if len(items) > 1:
            names = ", ".join(item.name for item in items)
            raise InputError(f"{source}: `name` is for one matrix, not {names}; choose one with `matrix`", "name")
        items = [replace(items[0], name=options.name)]
    if options.dofs:
        table = dof_table(read_numbering(require_readable(options.dofs)))
        items = [_with_row_numbering(item, table, options.dofs) for item in items]
    suffix = target.suffix.lower()
    numbered = [item for item in items if item.dofs is not None]
    lines = [f"{target}: {item.name}, {_matrix_size(item)}" for item in items]
    if options.write_dofs:
        lines.append(_write_numbering(options.write_dofs, numbered))
    elif numbered and suffix not in _NUMBERED and options.mtx != "labels":
        lines.append(f"not kept by {suffix}: node and component of the rows (write them with --write-dofs FILE)")
    if suffix != ".mtx" or options.mtx == "matrixmarket":
        write_matrices(target, items)
    elif len(items) > 1:
        raise InputError(f"{source}: holds {len(items)} matrices, {target} one; choose it with `matrix`", "matrix")
    else:
        form: Form = "labels" if options.mtx == "labels" else "coordinate"
        write_abaqus(target, items[0], form)
    return lines


def _matrix_size(item: ImportedMatrix) -> str:
    n_rows, n_columns = item.matrix.shape
    kind = "complex" if np.iscomplexobj(item.matrix.data) else "real"
    return f"{n_rows} x {n_columns}, {kind}, {item.matrix.nnz} entries"


def _with_row_numbering(item: ImportedMatrix, table: np.ndarray, path: Path) -> ImportedMatrix:
    """Matrix with node and component of its rows from `table`, (n_rows, 2), which was read from the file `path`.

    Raises `InputError` if the matrix has them already, or the number of rows differs.
    """
    if item.dofs is not None:
        raise InputError(f"{item.name!r} has node and component of its rows in its own file; leave `dofs` out", "dofs")
    if len(table) != item.matrix.shape[0]:
        raise InputError(f"{path}: names {len(table)} rows, {item.name!r} has {item.matrix.shape[0]}", "dofs")
    return replace(item, dofs=table)


def _write_numbering(path: Path, items: Sequence[ImportedMatrix]) -> str:
    """Write node and component of each row of the matrices to the file `path`, and return the line to print.

    Raises `InputError` if there are no matrices or their rows differ.
    """
    if not items:
        raise InputError("no matrix has node and component of its rows; leave `write_dofs` out", "write_dofs")
    first = items[0]
    table = np.asarray(first.dofs)
    for item in items[1:]:
        if not np.array_equal(np.asarray(item.dofs), table):
            raise InputError(
                f"{first.name!r} and {item.name!r} have other rows; choose one with `matrix`", "write_dofs"
            )
    dofs_of(table)
    write_numbering(path, table)
    return f"{path}: node and component of {plural(len(table), 'row')}"
