"""Files of SciPy and NumPy: NPZ of `scipy.sparse.save_npz`, MatrixMarket, NPY and MAT.

What is kept: values; all digits. There is no numbering in these formats. MatrixMarket is read here, many words at once:
coordinates or whole columns; real, integer or complex; general, symmetric, skew or Hermitian.

References
----------
Boisvert, Pozo and Remington (1996), The Matrix Market Exchange Formats: Initial Design, NISTIR 5935.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.core.arrays import AnyArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import Bytes, FieldError, chunks, fields_at, real_numbers, whole_numbers
from structid.fem.importers.imported import ImportedMatrix
from structid.files import damage_told
from structid.files.contained import matlab_variables
from structid.files.npy import npy_array, npz_arrays
from structid.files.sparse import checked_sparse_matrix, coordinates

_REMEDY = "write it with scipy.sparse.save_npz, scipy.io.mmwrite (.mtx) or numpy.save (.npy)"
_KIND = "a file of a matrix"
_MATLAB_NAME = re.compile(r"[A-Za-z]\w{0,62}", re.ASCII)
_MTX_REMEDY = "the file is cut short or damaged; write it again (scipy.io.mmwrite does)"
_WIDEST = 64
_WORDS = {"real": 1, "integer": 1, "complex": 2}
_MIRRORS = {"general": 0, "symmetric": 1, "skew-symmetric": -1, "hermitian": 1}


def read(path: Path) -> list[ImportedMatrix]:
    """The matrix in the file at `path`, as a list; from a MAT file every numeric matrix, named as its variable.

    The matrix of another file is named as the file, in capitals. Rows have no numbering.

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
    """Sparse matrix of `shape` whose diagonal ``offsets[k]`` is row k of `values`, in the columns where they stand.

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
    variables = matlab_variables(path)
    return {
        name: value
        for name, value in variables.items()
        if not isinstance(value, str | tuple) and "." not in name and len(value.shape) == 2 and max(value.shape) > 1
    }


_READERS: dict[str, Callable[[Path], Mapping[str, Any]]] = {
    ".npz": _read_npz,
    ".npy": lambda path: {path.stem.upper(): npy_array(path)},
    ".mtx": lambda path: {path.stem.upper(): matrix_market(path)},
    ".mat": _mat,
}


def write(path: Path, matrices: Sequence[ImportedMatrix], called: Path | None = None) -> None:
    """Write matrices to `path` as NPZ, MatrixMarket (17 digits), NPY (one matrix each) or MAT, by the suffix.

    `called` is the path in errors, by default `path`. Node and component of rows are not written.

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


class _WordTable(NamedTuple):
    """Start and end of the words of the lines with content, (n_lines, n_words) each, and the numbers of the lines."""

    path: Path
    buffer: Bytes
    start: IntArray
    end: IntArray
    line: IntArray

    def whole(self, word: int) -> IntArray:
        """The whole numbers in one place of every line."""
        return self._numbers(word, "a whole number", whole_numbers)

    def real(self, word: int) -> NDArray[np.floating]:
        """The real numbers in one place of every line."""
        return self._numbers(word, "a finite number", real_numbers)

    def _numbers(self, word, wanted, convert):  # type: ignore[no-untyped-def]
        """Numbers (n_lines,) in the column with index `word` of the table, made of the texts by `convert`.

        Raises `FileError`, with the line, for the first word that is not what `wanted` says, such as "a whole number".
        """
        start, end = self.start[:, word], self.end[:, word]
        width = int((end - start).max(initial=1))
        parts = []
        for part in chunks(len(start)):
            try:
                if width > _WIDEST:
                    bad = int(np.argmax(end - start))
                    raise FieldError(bad - part.start, bytes(self.buffer[start[bad] : end[bad]]).decode("latin-1")[:40])
                numbers = convert(fields_at(self.buffer, start[part], end[part], width))
            except FieldError as error:
                line = self.line[part.start + error.index]
                raise FileError(
                    f"{self.path}, line {line}: word {word + 1} must be {wanted}, got {error.text!r}; {_MTX_REMEDY}"
                ) from None
            parts.append(numbers)
        return np.concatenate(parts) if parts else np.zeros(0)


def matrix_market(path: Path) -> sparse.csc_array:
    """The sparse matrix in the MatrixMarket file at `path`, both triangles where the banner says that one is stored.

    Exponents may be written ``D``, or left out as in ``1.5+3``. Entries with the same row and column add up.

    Raises
    ------
    FileError
        If the banner, the line of sizes or an entry is not as the format has it; with the line.
    """
    content = path.read_bytes()
    first, _, rest = content.partition(b"\n")
    layout, field, symmetry = _read_banner(path, first)
    per_line = _WORDS[field] + (2 if layout == "coordinate" else 0)
    sizes, words = _read_lines(path, rest, 3 if layout == "coordinate" else 2, per_line)
    n_rows, n_columns = sizes[:2]
    if layout == "coordinate":
        if len(words.line) != sizes[2]:
            raise FileError(f"{path}: says {sizes[2]} entries and has {len(words.line)} lines of them; {_MTX_REMEDY}")
        row, column = (_indices(words, k, side, sizes[k]) for k, side in enumerate(("row", "column")))
    else:
        row, column = _array_positions(path, n_rows, n_columns, symmetry, len(words.line))
    values = words.real(per_line - 1)
    if field == "complex":
        values = words.real(per_line - 2) + 1j * values
    if _MIRRORS[symmetry]:
        _require_triangle(path, words, row, column, n_rows, n_columns, symmetry)
        off = row != column
        mirrored = _MIRRORS[symmetry] * (values[off].conj() if symmetry == "hermitian" else values[off])
        row, column = np.concatenate([row, column[off]]), np.concatenate([column, row[off]])
        values = np.concatenate([values, mirrored])
    return coordinates((n_rows, n_columns), row, column, values)


def _indices(words: _WordTable, word: int, side: str, count: int) -> IntArray:
    """Indices from 0 (n_entries,) of the rows or columns of the entries, which are column `word` of the table `words`.

    The file counts from 1 to `count`; raises `FileError`, which says `side` ("row" or "column"), for others.
    """
    numbers = words.whole(word)
    outside = (numbers < 1) | (numbers > count)
    if outside.any():
        first = int(np.argmax(outside))
        raise FileError(
            f"{words.path}, line {words.line[first]}: {side} must be from 1 to {count}, got {numbers[first]}; MatrixMarket counts"
            " from 1"
        )
    return numbers - 1


def _read_banner(path: Path, line: bytes) -> tuple[str, str, str]:
    """Layout (coordinate or array), field (real, integer or complex) and symmetry from the first line of the file.

    Raises `FileError` if it is no banner of MatrixMarket.
    """
    words = line.decode("latin-1").lower().split()
    good = len(words) == 5 and words[:2] == ["%%matrixmarket", "matrix"] and words[2] in ("coordinate", "array")
    if not good or words[3] not in _WORDS or words[4] not in _MIRRORS:
        raise FileError(
            f"{path}, line 1: must read %%MatrixMarket matrix, coordinate or array, real, integer or complex, and general,"
            f" symmetric, skew-symmetric or hermitian, got {line.decode('latin-1').strip()[:80]!r}; {_MTX_REMEDY}"
        )
    return words[2], words[3], words[4]


def _read_lines(path: Path, body: bytes, n_sizes: int, per_line: int) -> tuple[list[int], _WordTable]:
    """The sizes, and a table of the words in the lines behind them; comments and blank lines are passed over.

    `body` follows the banner; `n_sizes` numbers are on its first line, and `per_line` words on each other. Raises
    `FileError` for a line with another number of words.
    """
    buffer = np.frombuffer(body.replace(b"\r", b" ") + b"\n", dtype=np.uint8)
    word = buffer > ord(" ")
    start = np.flatnonzero(word & ~np.concatenate([[False], word[:-1]]))
    end = np.flatnonzero(word & ~np.concatenate([word[1:], [False]])) + 1
    line = np.searchsorted(np.flatnonzero(buffer == ord("\n")), start)
    heads = np.flatnonzero(np.diff(line, prepend=-1))
    comment = np.zeros(int(line[-1]) + 1 if len(line) else 0, dtype=bool)
    comment[line[heads]] = buffer[start[heads]] == ord("%")
    keep = ~comment[line]
    start, end, line = start[keep], end[keep], line[keep]
    numbers, count = np.unique(line, return_counts=True)
    if not len(numbers):
        raise FileError(f"{path}: has no line of sizes; {_MTX_REMEDY}")
    wanted = np.full(len(numbers), per_line)
    wanted[0] = n_sizes
    wrong = count != wanted
    if wrong.any():
        bad = int(np.argmax(wrong))
        shown = body.split(b"\n")[numbers[bad]].decode("latin-1").strip()[:60]
        raise FileError(
            f"{path}, line {numbers[bad] + 2}: must have {wanted[bad]} numbers, got {shown!r}; {_MTX_REMEDY}"
        )
    head = _WordTable(path, buffer, start[None, :n_sizes], end[None, :n_sizes], numbers[:1] + 2)
    sizes = [int(head.whole(k)[0]) for k in range(n_sizes)]
    if min(sizes) < 0:
        raise FileError(f"{path}, line {numbers[0] + 2}: sizes must not be negative, got {sizes}; {_MTX_REMEDY}")
    table = (len(numbers) - 1, per_line)
    return sizes, _WordTable(
        path, buffer, start[n_sizes:].reshape(table), end[n_sizes:].reshape(table), numbers[1:] + 2
    )


def _array_positions(
    path: Path, n_rows: int, n_columns: int, symmetry: str, n_entries: int
) -> tuple[IntArray, IntArray]:
    """Row and column, from 0, of each of `n_entries` entries of an array layout, (n_entries,) each.

    The entries are whole columns of the `n_rows` by `n_columns` matrix, or the part on and below the diagonal (below,
    if skew); `symmetry` is the word in the banner. Raises `FileError` for another number of entries.
    """
    if symmetry == "general":
        wanted = n_rows * n_columns
    else:
        wanted = n_rows * (n_rows + 1) // 2 - (n_rows if symmetry == "skew-symmetric" else 0)
    if n_entries != wanted:
        raise FileError(f"{path}: {n_rows} x {n_columns} entries need {wanted} lines, got {n_entries}; {_MTX_REMEDY}")
    if symmetry == "general":
        index = np.arange(n_entries)
        return index % max(n_rows, 1), index // max(n_rows, 1)
    column, row = np.triu_indices(n_rows, 1 if symmetry == "skew-symmetric" else 0)
    return row, column


def _require_triangle(
    path: Path, words: _WordTable, row: IntArray, column: IntArray, n_rows: int, n_columns: int, symmetry: str
) -> None:
    """Raise `FileError` unless the matrix is square and its entries are on one side of the diagonal.

    `row` and `column` (n_entries,) are the indices of the entries, `n_rows` and `n_columns` the sizes of the matrix.
    `words` has the lines of the entries, and `symmetry` is the word in the banner, both for messages.
    """
    if n_rows != n_columns:
        raise FileError(f"{path}: is called {symmetry} and has {n_rows} rows and {n_columns} columns; {_MTX_REMEDY}")
    above = row < column
    if above.any() and (row > column).any():
        raise FileError(
            f"{path}, line {words.line[np.argmax(above)]}: a {symmetry} matrix has entries on one side of the diagonal only;"
            " call it general, or leave one side out"
        )
