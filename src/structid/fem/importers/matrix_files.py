"""Files of matrices, read and written: one format a module, chosen by the suffix (and for .mtx the first line)."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from structid.core.errors import FileError, InputError
from structid.fem.importers.imported import ImportedMatrix
from structid.files import atomic_write, damage_told, require_readable
from structid.lazy import FormatModule

if TYPE_CHECKING:
    from structid.fem.importers.abaqus import Form
    from structid.fem.importers.dmig import Field

OP4 = FormatModule("structid.fem.importers.op4", (".op4", ".ou1"))  # the second is MYSTRAN's
DMIG = FormatModule("structid.fem.importers.dmig", (".pch", ".pun", ".dmig", ".bdf", ".nas", ".bulk", ".blk", ".dat"))
ABAQUS = FormatModule("structid.fem.importers.abaqus", (".mtx",))
ANSYS = FormatModule("structid.fem.importers.ansys", (".full", ".emat"))
ARRAYS = FormatModule("structid.fem.importers.arrays", (".npz", ".npy", ".mtx", ".mat"))
HARWELL_BOEING = FormatModule("structid.fem.importers.harwell_boeing", (".hb", ".rb", ".rua", ".rsa", ".matrix"))
CALCULIX = FormatModule("structid.fem.importers.calculix", (".sti", ".mas"))
Layout = Literal["bigmat", "sparse", "dense"]
#: Each module has read(path). A .mtx file is MatrixMarket where its first line says so, else Abaqus.
FORMATS: tuple[FormatModule, ...] = (OP4, DMIG, ABAQUS, ANSYS, ARRAYS, HARWELL_BOEING, CALCULIX)


@dataclass(frozen=True)
class Op4Options:
    """Format of an OUTPUT4 file.

    Attributes
    ----------
    binary : bool
        Binary (default) or ASCII.
    layout : {"bigmat", "sparse", "dense"}
        Strings with 32-bit rows (any size), strings with 16-bit rows (up to 65535 rows), or whole columns from the
        first to the last entry that is not zero.
    byte_order : {"little", "big"}
        Byte order of binary files.
    words : {32, 64}
        Bits of an integer in binary files.
    single : bool
        Single precision: seven digits.
    """

    binary: bool = True
    layout: Layout = "bigmat"
    byte_order: Literal["little", "big"] = "little"
    words: Literal[32, 64] = 32
    single: bool = False

    def __post_init__(self) -> None:
        """Raise `InputError` unless layout, byte order and word size are among those of the format."""
        if self.layout not in ("bigmat", "sparse", "dense"):
            raise InputError(f"`layout` must be 'bigmat', 'sparse' or 'dense', got {self.layout!r}")
        if self.byte_order not in ("little", "big") or self.words not in (32, 64):
            raise InputError(
                "`byte_order` must be 'little' or 'big' and `words` 32 or 64, got "
                f"{self.byte_order!r} and {self.words!r}"
            )


def _format_of(path: Path) -> FormatModule:
    """The module that reads matrices of the file at `path`, by its suffix (for .mtx by its first bytes).

    Raises `FileError` for an unknown suffix.
    """
    suffix = path.suffix.lower()
    if suffix == ".mtx":
        with path.open("rb") as stream:
            return ARRAYS if stream.read(2) == b"%%" else ABAQUS
    for module in FORMATS:
        if suffix in module.SUFFIXES:
            return module
    known = " ".join(dict.fromkeys(suffix for module in FORMATS for suffix in module.SUFFIXES))
    raise FileError(
        f"{path}: the suffix {path.suffix!r} is of no known matrix format; rename or convert it to one of {known}"
    )


def read_matrices(path: str | Path) -> dict[str, ImportedMatrix]:
    """Every matrix in the file at `path` by its name, in the units of the file.

    Parameters
    ----------
    path : str or Path
        Nastran OUTPUT4 (.op4), DMIG in bulk data or punch files (.pch .bdf .dat ...), Abaqus (.mtx), Ansys (.full
        .emat, with `ansys-mapdl-reader` installed), CalculiX (.sti .mas, with the .dof beside it), MatrixMarket (.mtx),
        NPZ, NPY, MAT, Harwell-Boeing (.hb .rb .rua .rsa, and .matrix of Ansys HBMAT).

    Raises
    ------
    FileError
        If the file is missing, damaged, cut short or of no known format; the message begins with its path, and the
        line where there is one.

    Examples
    --------
    >>> read_matrices("plate.op4")["KAA"].matrix.shape  # doctest: +SKIP
    (3390, 3390)
    """
    path = require_readable(path)
    matrices: dict[str, ImportedMatrix] = {}
    with damage_told(path, "a whole file of its format"):
        items = _format_of(path).read(path)
    for item in items:
        name = item.name
        if name in matrices:
            raise FileError(f"{path}: holds two matrices {name!r}; write each under a name of its own")
        matrices[name] = item
    return matrices


def read_matrix(path: str | Path, name: str | None = None) -> ImportedMatrix:
    """One matrix of the file at `path`: the only one, or the one called `name` in any case.

    Raises
    ------
    FileError
        If the file cannot be read, has no such matrix (the nearest is named) or has several and `name` is not given.
    """
    matrices = read_matrices(path)
    if name is None:
        if len(matrices) > 1:
            raise FileError(f"{path}: holds {len(matrices)} matrices ({', '.join(matrices)}); say which by its name")
        return next(iter(matrices.values()))
    for key, item in matrices.items():
        if key.upper() == name.upper():
            return item
    nearest = difflib.get_close_matches(name.upper(), matrices, 1, 0.0)
    raise FileError(f"{path}: holds no matrix {name!r}, only {', '.join(matrices)}; the nearest is {nearest[0]!r}")


def write_op4(path: str | Path, matrices: Iterable[ImportedMatrix], options: Op4Options | None = None) -> None:
    """Write `matrices` to `path` as a Nastran OUTPUT4 file, whole or not at all.

    `options` choose text or binary, layout and digits; None takes their defaults. All digits are kept unless they say
    `single`.

    Raises
    ------
    FileError
        If a name or a matrix does not fit the format, or the file cannot be written.
    """
    path = Path(path)
    content = OP4.file_bytes(path, list(matrices), options or Op4Options())
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def write_dmig(path: str | Path, matrices: Iterable[ImportedMatrix], field: Field = "large") -> None:
    """Write `matrices`, which need node and component of their rows (`dofs`), as DMIG cards, whole or not at all.

    Parameters
    ----------
    path : str or Path
    matrices : iterable of ImportedMatrix
    field : {"large", "small", "free"}
        "large" holds twelve digits of positive numbers (eleven of negative ones, one less beyond 1e10), "small" four or
        five, "free" all of them.

    Raises
    ------
    InputError
        If `field` is none of these.
    FileError
        If a name does not fit the format, numbering is missing, or the file cannot be written.
    """
    path = Path(path)
    text = DMIG.file_text(path, list(matrices), field)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def write_abaqus(path: str | Path, matrix: ImportedMatrix, form: Form = "labels") -> None:
    """Write one matrix to `path` in a form of Abaqus ("labels", "coordinate" or "elements"), whole or not at all.

    Raises
    ------
    InputError
        If `form` is none of these.
    FileError
        If the matrix lacks what the form needs, or the file cannot be written.
    """
    path = Path(path)
    text = ABAQUS.file_text(path, matrix, form)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def write_matrix(path: str | Path, matrix: ImportedMatrix) -> None:
    """Write one matrix by the suffix; see `write_matrices`."""
    write_matrices(path, [matrix])


def write_matrices(path: str | Path, matrices: Iterable[ImportedMatrix]) -> None:
    """Write matrices by the suffix, whole or not at all.

    Parameters
    ----------
    path : str or Path
        .op4, .pch (DMIG) and .mat hold several; .npz, .npy and .mtx (MatrixMarket) hold one. DMIG alone keeps the node
        and component of each row.

    Raises
    ------
    FileError
        If the suffix is none of these, the matrices do not fit the format, or the file cannot be written.
    """
    path, items = Path(path), list(matrices)
    if path.suffix.lower() in OP4.SUFFIXES:
        write_op4(path, items)
    elif path.suffix.lower() in DMIG.SUFFIXES:
        write_dmig(path, items)
    else:
        with atomic_write(path) as temporary:
            ARRAYS.write(temporary, items, path)
