"""Harwell-Boeing and Rutherford-Boeing files, as Ansys writes them by HBMAT: symmetric or not, real or complex.

Of a symmetric matrix the file has one triangle. What is kept: values as printed; right-hand sides are left out.

References
----------
Duff, Grimes and Lewis (1992), Users' Guide for the Harwell-Boeing Sparse Matrix Collection, CERFACS TR/PA/92/86.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import sparse

from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import FieldError, chunks, fields_at, real_numbers, whole_numbers
from structid.fem.importers.imported import ImportedMatrix, complete_triangles

_FORM = re.compile(rb"\(?\s*(?:\d+P\s*,?\s*)?(\d*)\s*([IEDFG])\s*(\d+)", re.IGNORECASE)
#: Letters of a line of forms that are looked at; it has 80.
_LONGEST = 200
_REMEDY = "the file is cut short or of another form; write it again (HBMAT with ASCII)"


def read(path: Path) -> list[ImportedMatrix]:
    """The matrix in the Harwell-Boeing or Rutherford-Boeing file at `path`, as a list of one without numbering of rows.

    Raises
    ------
    FileError
        If the file is cut short, binary, in elements, skew or Hermitian, or a pattern without values.
    """
    lines = path.read_bytes().replace(b"\r\n", b"\n").split(b"\n")
    try:
        return [_parse_matrix(path, lines)]
    except FileError:
        raise
    except (ValueError, IndexError) as error:
        raise FileError(f"{path}: holds no Harwell-Boeing matrix that can be read ({error}); {_REMEDY}") from error


def _parse_matrix(path: Path, lines: list[bytes]) -> ImportedMatrix:
    """The matrix in the `lines` of the file, named as the file in capitals, without numbering; symmetric ones complete.

    Raises `FileError` for a type that is not read, and `ValueError` if the numbers do not fit together.
    """
    counts = [int(word) for word in lines[1].split()]
    n_right = counts[4] if len(counts) > 4 else 0
    kind, *sizes = lines[2].split()
    kind = kind.upper()
    n_rows, n_columns, n_entries = (int(word) for word in sizes[:3])
    if len(kind) != 3 or kind[:1] not in (b"R", b"C") or kind[1:2] not in (b"S", b"U", b"Z", b"H") or kind[2:] != b"A":
        raise FileError(
            f"{path}: is of type {kind.decode('latin-1')}; assembled matrices with real or complex values can be read"
        )
    forms = lines[3][:_LONGEST]
    pointer_form, index_form, value_form = (match.groups() for match in list(_FORM.finditer(forms))[:3])
    line_index = 5 if n_right else 4
    parts = 2 if kind[:1] == b"C" else 1
    first, line_index = _read_block(path, lines, line_index, pointer_form, n_columns + 1, whole_numbers)
    rows, line_index = _read_block(path, lines, line_index, index_form, n_entries, whole_numbers)
    values, line_index = _read_block(path, lines, line_index, value_form, parts * n_entries, real_numbers)
    if not n_right and any(line.strip() for line in lines[line_index:]):
        raise ValueError("there are more lines than it says")
    if first[0] != 1 or first[-1] != n_entries + 1 or (np.diff(first) < 0).any():
        raise ValueError("the columns do not add up to the number of entries")
    if n_entries and (rows.min() < 1 or rows.max() > n_rows):
        raise ValueError("a row lies outside the matrix")
    if parts == 2:
        values = values[::2] + 1j * values[1::2]
    name = path.stem.upper()
    matrix = sparse.csc_array((values, rows - 1, first - 1), shape=(n_rows, n_columns))
    if kind[1:2] == b"U":
        return ImportedMatrix(name, matrix)
    if kind[1:2] != b"S":
        raise FileError(f"{path}: is skew or Hermitian, as no mass, damping or stiffness is")
    return ImportedMatrix(name, complete_triangles(matrix.tocoo(), name))


def _read_block(
    path: Path,
    lines: list[bytes],
    first: int,
    form: tuple[bytes, ...],
    count: int,
    convert: Callable[[np.ndarray], np.ndarray],
) -> tuple[np.ndarray, int]:
    """Numbers (count,) from line index `first` on in a Fortran format, and the index of the line behind them.

    `form` has the parts of the format: numbers a line, letter and width. `convert` turns a table of text fields (n,
    width) into numbers. Raises `ValueError` if there are fewer numbers, `FileError` for a field that is none.
    """
    per_line, width = int(form[0] or b"1"), int(form[2])
    stop = first + -(-count // per_line)
    if stop > len(lines):
        raise ValueError("there are fewer lines than it says")
    words = b" ".join(lines[first:stop]).split()
    if len(words) == count:  # blanks between all of them: widths need not be as the format says
        width = max(map(len, words), default=1)
        text = b"".join(word.ljust(width) for word in words)
    else:
        text = b"".join(line[: per_line * width].ljust(per_line * width) for line in lines[first:stop])
    buffer = np.frombuffer(text, dtype=np.uint8)
    start = np.arange(count, dtype=np.int64) * width
    parts = []
    for piece in chunks(count):
        fields = fields_at(buffer, start[piece], start[piece] + width, width)
        if (fields <= ord(" ")).all(axis=1).any():
            raise ValueError("there are fewer numbers than it says")
        try:
            parts.append(convert(fields))
        except FieldError as error:
            line = first + (piece.start + error.index) // per_line + 1
            raise FileError(f"{path}, line {line}: must hold numbers, got {error.text!r}; {_REMEDY}") from None
    return np.concatenate(parts) if parts else np.zeros(0, np.int64), stop
