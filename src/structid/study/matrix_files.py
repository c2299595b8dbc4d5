"""Matrices and their degrees of freedom from files: what a finite element code can write."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from structid.errors import FileError

_REMEDY = "write it with scipy.sparse.save_npz, scipy.io.mmwrite (.mtx) or numpy.save (.npy)"


def read_matrix(path: Path) -> Any:
    """The matrix in a ``.npz`` (of `scipy.sparse.save_npz`), ``.mtx`` (MatrixMarket) or ``.npy`` file.

    Raises
    ------
    FileError
        If the file is damaged or of another format.
    """
    from scipy.io import mmread  # so that `import structid` stays light

    readers = {".npz": sparse.load_npz, ".mtx": mmread, ".npy": np.load}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise FileError(f"{path}: the suffix {path.suffix!r} is none of {' '.join(readers)}; {_REMEDY}")
    try:
        with path.open("rb") as stream:
            matrix = reader(stream)
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: holds no matrix that can be read ({error}); {_REMEDY}") from error
    kind = getattr(matrix, "dtype", None)
    if kind is None or kind.kind not in "fiu" or len(matrix.shape) != 2:
        raise FileError(f"{path}: must hold a real matrix of two dimensions, got {kind} {matrix.shape}; {_REMEDY}")
    return matrix


def read_dofs(path: Path) -> list[str]:
    """Degrees of freedom in a text file, between blanks, commas or line ends; ``#`` begins a comment."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read as text ({error}); write one degree of freedom a line") from error
    return [word for line in lines for word in line.split("#")[0].replace(",", " ").split()]
