"""Files of SciPy and NumPy: NPZ of `scipy.sparse.save_npz`, MatrixMarket, NPY and MAT.

What is kept: values; all digits. There is no numbering in these formats.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from structid.errors import FileError
from structid.structure.importers.imported import ImportedMatrix

SUFFIXES: tuple[str, ...] = (".npz", ".npy", ".mtx", ".mat")

_REMEDY = "write it with scipy.sparse.save_npz, scipy.io.mmwrite (.mtx) or numpy.save (.npy)"

#: What SciPy and NumPy raise on damaged files.
_DAMAGE = (
    ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile, zlib.error, TypeError, IndexError, OverflowError,
    NotImplementedError, MemoryError, SyntaxError, AttributeError,
)  # fmt: skip


def read(path: Path) -> list[ImportedMatrix]:
    """The matrix in the file at `path`; of a MAT file every numeric matrix under its variable's name.

    Raises
    ------
    FileError
        If the file is damaged, or holds no real or complex matrix of two dimensions.
    """
    try:
        found = _READERS[path.suffix.lower()](path)
    except _DAMAGE as error:
        raise FileError(f"{path}: holds no matrix that can be read ({error}); {_REMEDY}") from error
    matrices = []
    for name, matrix in found.items():
        kind = getattr(matrix, "dtype", None)
        if kind is None or kind.kind not in "fiuc" or len(matrix.shape) != 2:
            shape = getattr(matrix, "shape", ())
            raise FileError(
                f"{path}: must hold a real or complex matrix of two dimensions, got {kind} {shape}; {_REMEDY}"
            )
        dtype = np.complex128 if kind.kind == "c" else np.float64
        matrices.append(ImportedMatrix(name, sparse.csc_array(matrix, dtype=dtype)))
    if not matrices:
        raise FileError(f"{path}: holds no numeric matrix; {_REMEDY}")
    return matrices


def _npz(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        return {path.stem.upper(): sparse.load_npz(stream)}


def _npy(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        return {path.stem.upper(): np.load(stream, allow_pickle=False)}


def _matrix_market(path: Path) -> dict[str, Any]:
    from scipy.io import mmread  # so that `import structid` stays light

    with path.open("rb") as stream:
        return {path.stem.upper(): mmread(stream)}


def _mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    content = loadmat(path)
    keep = {name: value for name, value in content.items() if not name.startswith("__")}
    return {name: value for name, value in keep.items() if _is_matrix(value)}


def _is_matrix(value: Any) -> bool:
    """More than one entry: single numbers and texts of a MAT file are no matrices."""
    kind = getattr(value, "dtype", None)
    return kind is not None and kind.kind in "fiuc" and len(value.shape) == 2 and max(value.shape) > 1


_READERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".npz": _npz,
    ".npy": _npy,
    ".mtx": _matrix_market,
    ".mat": _mat,
}


def write(path: Path, item: ImportedMatrix) -> None:
    """One matrix as NPZ, MatrixMarket (17 digits) or NPY, by the suffix.

    Raises
    ------
    FileError
        If the suffix is none of these.
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        sparse.save_npz(path, item.matrix)
    elif suffix == ".npy":
        np.save(path, item.matrix.toarray())
    elif suffix == ".mtx":
        from scipy.io import mmwrite

        with path.open("wb") as stream:
            mmwrite(stream, sparse.coo_array(item.matrix), precision=17)
    else:
        raise FileError(f"{path}: cannot be written; take one of .npz .mtx .npy")
