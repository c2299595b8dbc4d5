"""Files of SciPy and NumPy: NPZ of `scipy.sparse.save_npz`, MatrixMarket, NPY and MAT.

What is kept: values; all digits. There is no numbering in these formats.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from structid.core.arrays import AnyArray
from structid.core.errors import FileError
from structid.fem.importers.imported import ImportedMatrix
from structid.fem.importers.matrix_market import matrix_market
from structid.files import damage_told
from structid.files.matlab import matlab_variables
from structid.files.npy import npy_array, npz_arrays
from structid.files.sparse import checked_sparse_matrix, coordinates

_REMEDY = "write it with scipy.sparse.save_npz, scipy.io.mmwrite (.mtx) or numpy.save (.npy)"
_KIND = "a file of a matrix"
_MATLAB_NAME = re.compile(r"[A-Za-z]\w{0,62}", re.ASCII)


def read(path: Path) -> list[ImportedMatrix]:
    """The matrix in the file at `path`; from a MAT file every numeric matrix, named as its variable.

    Raises
    ------
    FileError
        If the file is damaged, or holds no real or complex matrix of two dimensions.
    """
    with damage_told(path, _KIND, _REMEDY):
        matrices = _READERS[path.suffix.lower()](path)
        if not matrices:
            raise FileError(f"{path}: holds no numeric matrix; {_REMEDY}")
        return [_as_imported(path, name, matrix) for name, matrix in matrices.items()]


def _as_imported(path: Path, name: str, matrix: AnyArray | sparse.csc_array) -> ImportedMatrix:
    """`matrix` as an `ImportedMatrix` called `name`; `FileError` unless it is numeric and has two dimensions."""
    kind = matrix.dtype.kind
    if kind not in "fiuc" or len(matrix.shape) != 2:
        raise FileError(
            f"{path}: must hold a real or complex matrix of two dimensions, got {matrix.dtype} {matrix.shape}; {_REMEDY}"
        )
    return ImportedMatrix(name, sparse.csc_array(matrix, dtype=np.complex128 if kind == "c" else np.float64))


def _read_npz(path: Path) -> dict[str, Any]:
    """The matrix that `scipy.sparse.save_npz` wrote, by the name of the file in capitals.

    Raises `ValueError` unless its form is csc, csr, coo or dia.
    """
    parts = npz_arrays(path, "a whole matrix in NPZ", "write it with scipy.sparse.save_npz")
    form = _text(parts["format"])
    n_rows, n_columns = (int(n) for n in parts["shape"])
    if form in ("csc", "csr"):
        shape = (n_rows, n_columns) if form == "csc" else (n_columns, n_rows)
        stored = checked_sparse_matrix(shape, parts["indptr"], parts["indices"], parts["data"])
        matrix = stored if form == "csc" else stored.T.tocsc()
    elif form == "coo":
        row, column = parts["coords"] if "coords" in parts else (parts["row"], parts["col"])
        matrix = coordinates((n_rows, n_columns), row, column, parts["data"])
    elif form == "dia":
        matrix = _matrix_of_diagonals((n_rows, n_columns), parts["offsets"], parts["data"])
    else:
        raise ValueError(f"it is of the form {form!r}; write it as csc, csr, coo or dia")
    return {path.stem.upper(): matrix}


def _text(array: AnyArray) -> str:
    """A single text, which SciPy keeps as bytes."""
    value = array.item()
    return value.decode("ascii") if isinstance(value, bytes) else str(value)


def _matrix_of_diagonals(shape: tuple[int, int], offsets: AnyArray, values: AnyArray) -> sparse.csc_array:
    """Sparse matrix of `shape` whose diagonal ``offsets[k]`` is row k of `values`, each value in the column where it stands.

    Offsets count from the main diagonal, positive above it. `ValueError` unless `values` has a row for each offset.
    """
    if values.ndim != 2 or offsets.shape != values.shape[:1]:
        raise ValueError(f"{offsets.shape} offsets belong to diagonals of shape {values.shape}")
    columns = np.broadcast_to(np.arange(values.shape[1]), values.shape)
    rows = columns - offsets.astype(np.int64)[:, None]
    inside = (rows >= 0) & (rows < shape[0]) & (columns < shape[1])
    return coordinates(shape, rows[inside], columns[inside], values[inside])


def _mat(path: Path) -> Mapping[str, Any]:
    """Variables of more than one entry: single numbers and texts of a MAT file are no matrices."""
    found = matlab_variables(path)
    return {
        name: value
        for name, value in found.items()
        if not isinstance(value, str | tuple) and "." not in name and len(value.shape) == 2 and max(value.shape) > 1
    }


_READERS: dict[str, Callable[[Path], Mapping[str, Any]]] = {
    ".npz": _read_npz,
    ".npy": lambda path: {path.stem.upper(): npy_array(path)},
    ".mtx": lambda path: {path.stem.upper(): matrix_market(path)},
    ".mat": _mat,
}


def write(path: Path, matrices: Sequence[ImportedMatrix], called: Path | None = None) -> None:
    """Write matrices as NPZ, MatrixMarket (17 digits), NPY (one matrix) or MAT, by the suffix.

    `called` is the path in errors.

    Raises
    ------
    FileError
        If the suffix is none of these, several matrices do not fit the format, or a name does not.
    """
    suffix, called = path.suffix.lower(), called or path
    if suffix == ".mat":
        from scipy.io import savemat

        for item in matrices:
            if not _MATLAB_NAME.fullmatch(item.name):
                raise FileError(
                    f"{called}: {item.name!r} is no name of a MATLAB variable; give another one with `name`"
                )
        savemat(path, {item.name: item.matrix for item in matrices}, do_compression=True)
        return
    if len(matrices) != 1:
        names = ", ".join(item.name for item in matrices)
        raise FileError(f"{called}: the format holds one matrix, not {len(matrices)} ({names}); choose one by its name")
    item = matrices[0]
    if suffix == ".npz":
        sparse.save_npz(path, item.matrix)
    elif suffix == ".npy":
        np.save(path, item.matrix.toarray())
    elif suffix == ".mtx":
        from scipy.io import mmwrite

        with path.open("wb") as stream:
            mmwrite(stream, sparse.coo_array(item.matrix), precision=17)
    else:
        raise FileError(f"{called}: cannot be written; take one of .op4 .pch .mtx .npz .npy .mat")
