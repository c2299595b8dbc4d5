"""Nastran OUTPUT4 files: ASCII or binary, dense or sparse, real or complex, single or double precision.

What is kept: name, values, form. There is no numbering in the format; rows follow the set that was written (the a-set in
the order of its nodes and components, unless the model was resequenced).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import sparse

from structid.core.errors import FileError
from structid.fem.importers.imported import ImportedMatrix
from structid.fem.importers.op4 import binary as op4_binary
from structid.fem.importers.op4 import text as op4_text
from structid.fem.importers.op4.strings import Op4Options, Strings, strings_of


def read(path: Path) -> list[ImportedMatrix]:
    """Every matrix in the OUTPUT4 file at `path`, in order; symmetric ones complete.

    ASCII or binary, byte order and 32- or 64-bit words are recognized from the file.

    Raises
    ------
    FileError
        If the file is cut short or damaged; with the matrix, and the byte or line.
    """
    content = path.read_bytes()
    kind = op4_binary.kind_of(content)
    matrices = op4_text.matrices(path, content) if kind is None else op4_binary.matrices(path, content, kind)
    if not matrices:
        raise FileError(f"{path}: holds no matrix; write some with OUTPUT4")
    return matrices


def file_bytes(path: Path, matrices: Sequence[ImportedMatrix], options: Op4Options) -> bytes:
    """Content of an OUTPUT4 file of `matrices` in the format of `options`; `path` is for errors.

    Raises
    ------
    FileError
        If a name is empty, longer than eight characters or not ASCII, or a matrix does not fit the layout.
    """
    parts = []
    for item in matrices:
        strings = _make_strings(path, item, options)
        parts.append(
            op4_binary.encode_matrix(strings, options) if options.binary else op4_text.encode_matrix(strings, options)
        )
    return b"".join(parts)


def _make_strings(path: Path, item: ImportedMatrix, options: Op4Options) -> Strings:
    """The matrix `item` as strings of OUTPUT4, in the layout and precision of `options`.

    Raises `FileError`, which names `path`, if its name, size or values do not fit the format.
    """
    if len(item.name) > 8 or not item.name.isascii() or not item.name or " " in item.name:
        raise FileError(f"{path}: the name {item.name!r} must have 1 to 8 ASCII characters; rename the matrix")
    if options.layout == "sparse" and item.matrix.shape[0] > 65535:
        raise FileError(f"{path}: {item.name!r} has more than 65535 rows; write it with the layout 'bigmat'")
    if not np.isfinite(item.matrix.data).all():
        raise FileError(f"{path}: {item.name!r} holds NaN or infinite entries, which the format does not have")
    return strings_of(item.name, sparse.csc_array(item.matrix), _form(item.matrix), options.layout, options.single)


def _form(matrix: sparse.csc_array) -> int:
    if matrix.shape[0] != matrix.shape[1]:
        return 2
    return 6 if abs(matrix - matrix.T).nnz == 0 else 1
