"""MAT files of MATLAB: numbers, texts, cells of texts, structs and sparse matrices, read in a child process (`read_in_child`).

Objects, functions, arrays of structs and cells of other things are passed over.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy import sparse

from structid.core.errors import FileError
from structid.files.contained import ReaderError, read_in_child
from structid.files.hdf5 import matlab_73_fields
from structid.files.reading import damage_told, require_readable
from structid.files.sparse import checked_sparse_matrix

#: A variable: numbers, a text, or a list of texts.
Variable: TypeAlias = np.ndarray | sparse.csc_array | str | tuple[str, ...]

_REMEDY = "copy or save it again"
_HDF5_START = b"\x89HDF\r\n\x1a\n"


def matlab_variables(path: Path) -> dict[str, Variable]:
    """Variables in the MAT file at `path` by name: arrays, sparse matrices, texts and tuples of texts.

    Fields of a struct are named ``name.field``. Variables of other kinds are passed over.

    Raises
    ------
    FileError
        If the file is not a MAT file, or is damaged.
    """
    path = require_readable(path)
    if _is_73(path):
        return dict(matlab_73_fields(path))
    with damage_told(path, "a whole MAT file", _REMEDY):
        try:
            variables = read_in_child(path, "matlab")
        except ReaderError as error:
            raise FileError(f"{path}: is not a whole MAT file ({error}); {_REMEDY}") from error
        return {name: _to_variable(value) for name, value in variables.items()}


def _is_73(path: Path) -> bool:
    """True if the MAT file at `path` is of version 7.3, which is HDF5."""
    with path.open("rb") as stream:
        head = stream.read(520)
    return head.startswith((b"MATLAB 7.3", _HDF5_START)) or head[512:] == _HDF5_START


def _to_variable(value: np.ndarray | str | list[str] | dict[str, np.ndarray]) -> Variable:
    """The variable of `value` as the child process sent it: a sparse matrix from its parts, a tuple from a list, else unchanged."""
    if isinstance(value, dict):
        n_rows, n_columns = value["shape"].tolist()
        return checked_sparse_matrix((n_rows, n_columns), value["starts"], value["rows"], value["values"])
    return tuple(value) if isinstance(value, list) else value
