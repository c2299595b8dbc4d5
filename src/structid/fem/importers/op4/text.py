"""ASCII OUTPUT4: integer lines in I8, numbers in the columns that the title line says (`1P,3E23.16`)."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import FieldError, chunks, fields_at, real_numbers
from structid.fem.importers.imported import ImportedMatrix
from structid.fem.importers.op4.strings import Op4Options, Strings, assemble_strings, finish_matrix

_FORMAT = re.compile(rb"(?:1P,?)?\s*(\d+)\s*[EDG](\d+)\.(\d+)", re.IGNORECASE)
#: Letters of a form that are looked at.
_LONGEST = 100
_REMEDY = "the file is cut short or damaged; copy it or write it again"


class _Title(NamedTuple):
    columns: int
    rows: int
    form: int
    kind: int
    name: str
    per_line: int
    width: int


class _Lines(NamedTuple):
    path: Path
    text: list[bytes]

    def integers(self, line_index: int, count: int, what: str) -> list[int]:
        """`count` whole numbers on line `line_index`, in fields of eight columns or between blanks; `what` is for errors."""
        if line_index >= len(self.text):
            raise FileError(f"{self.path}: ends at line {len(self.text)} before {what}; {_REMEDY}")
        line = self.text[line_index]
        try:
            words = line.split()
            if len(words) == count:
                return [int(word) for word in words]
            return [int(line[8 * i : 8 * i + 8]) for i in range(count)]
        except ValueError:
            shown = line.decode("latin-1").strip()[:40]
            raise FileError(
                f"{self.path}, line {line_index + 1}: must be {what} ({count} whole numbers), got {shown!r}; {_REMEDY}"
            ) from None


def matrices(path: Path, content: bytes) -> list[ImportedMatrix]:
    """Every matrix in the text `content` of an ASCII OUTPUT4 file."""
    lines = _Lines(path, content.split(b"\n"))
    length = np.array([len(line) for line in lines.text], dtype=np.int64) + 1
    offset = np.cumsum(length) - length
    buffer = np.frombuffer(content, dtype=np.uint8)
    read: list[ImportedMatrix] = []
    line_index = 0
    while line_index < len(lines.text):
        if not lines.text[line_index].strip():
            line_index += 1
            continue
        title = _read_title(lines, line_index)
        table, line_index = _read_strings(lines, line_index + 1, title)
        if table.size and table[-1, 0] + -(-table[-1, 1] // title.per_line) > len(lines.text):
            raise FileError(f"{path}: ends within matrix {title.name!r}; {_REMEDY}")
        numbers = _read_numbers(path, buffer, offset, length, table, title)
        is_complex = title.kind > 2
        shape = (abs(title.rows), title.columns)
        count = table[:, 1] // (2 if is_complex else 1)
        matrix = assemble_strings(shape, table[:, 2], table[:, 3], count, numbers, is_complex)
        read.append(finish_matrix(path, title.name, matrix, title.form))
    return read


def _read_title(lines: _Lines, line_index: int) -> _Title:
    """The title line of a matrix at line index `line_index`: sizes, form, type, name and number format.

    Five numbers a line of 16 columns if it states no format. Raises `FileError` for sizes or types that are not possible.
    """
    line = lines.text[line_index]
    wide = 16 if line.rstrip().upper().endswith(b"|I16") else 0  # large dimensions have fields of sixteen columns
    columns, rows, form, kind = _title_numbers(lines, line_index, wide)
    name = line[32 + wide : 40 + wide].decode("latin-1").replace("\0", " ").strip().upper()
    match = _FORMAT.search(line[40 + wide :][:_LONGEST])
    if columns <= 0 or rows == 0 or kind not in (1, 2, 3, 4):
        raise FileError(
            f"{lines.path}, line {line_index + 1}: matrix {name!r} has {rows} rows, {columns} columns and type {kind}; {_REMEDY}"
        )
    per_line, width = (int(match[1]), int(match[2])) if match else (5, 16)
    return _Title(columns, rows, form, kind, name.replace(" ", ""), per_line, width)


def _title_numbers(lines: _Lines, line_index: int, wide: int) -> list[int]:
    """The four whole numbers of a title line: columns, rows, form and type.

    `wide` is the number of characters by which its first two fields together are wider (0 or 16). The line is
    ``lines.text[line_index]``. Raises `FileError` for a field that is no whole number.
    """
    line = lines.text[line_index]
    edges = [0, 8 + wide // 2, 16 + wide, 24 + wide, 32 + wide]
    try:
        return [int(line[a:b]) for a, b in pairwise(edges)]
    except ValueError:
        shown = line.decode("latin-1").strip()[:40]
        raise FileError(
            f"{lines.path}, line {line_index + 1}: must be the title of a matrix (four whole numbers and a name), got {shown!r}; "
            f"{_REMEDY}"
        ) from None


def _read_strings(lines: _Lines, line_index: int, title: _Title) -> tuple[IntArray, int]:
    """First line, number of reals, row and column of each string, (n_strings, 4), and the line index behind the matrix.

    Lines, rows and columns count from 0. The strings begin at `line_index`; raises `FileError` for positions that are not
    possible.
    """
    strings: list[tuple[int, int, int, int]] = []
    words_per_real = 1 if title.kind % 2 == 1 else 2
    big = title.rows < 0 or title.rows > 65535
    limit = abs(title.rows) * (2 if title.kind > 2 else 1)
    what = f"a column of matrix {title.name!r}"
    while True:
        column, row, words = lines.integers(line_index, 3, what)
        line_index += 1
        if column > title.columns + 1 or column < 1 or row < 0 or words < 0:
            raise FileError(
                f"{lines.path}, line {line_index}: says column {column} of {title.columns}, row {row} and {words} words,"
                f" which is not possible; {_REMEDY}"
            )
        if column > title.columns:
            return np.array(strings, dtype=np.int64).reshape(-1, 4), line_index + 1
        if row > 0:
            _require(lines, line_index, column, row, words, limit)
            strings.append((line_index, words, row - 1, column - 1))
            line_index += -(-words // title.per_line)
            continue
        while words > 0:
            if big:
                length, top = lines.integers(line_index, 2, f"a string of column {column}")
                length, head = length - 1, 2
            else:
                packed = lines.integers(line_index, 1, f"a string of column {column}")[0]
                length, top, head = (packed >> 16) - 1, packed & 0xFFFF, 1
            reals = length // words_per_real
            line_index += 1
            _require(lines, line_index, column, top, reals, limit)
            strings.append((line_index, reals, top - 1, column - 1))
            words -= length + head
            line_index += -(-reals // title.per_line)


def _require(lines: _Lines, line_index: int, column: int, row: int, reals: int, limit: int) -> None:
    if column < 1 or row < 1 or not 0 < reals <= limit:
        raise FileError(
            f"{lines.path}, line {line_index}: says column {column}, row {row} and {reals} numbers, which is not possible; "
            f"{_REMEDY}"
        )


def _read_numbers(
    path: Path, buffer: NDArray[np.uint8], offset: IntArray, length: IntArray, table: IntArray, title: _Title
) -> FloatArray:
    """The real numbers (n_numbers,) of all strings, one after another; `FileError` with the line for a field that is none.

    `offset` and `length` (n_lines,) are first byte and size of each line in `buffer`; `table` (n_strings, 4) has first line,
    number of reals, row and column of each string.
    """
    count = table[:, 1]
    before = np.cumsum(count) - count
    within = np.arange(int(count.sum())) - np.repeat(before, count)
    line = np.repeat(table[:, 0], count) + within // title.per_line
    start = offset[line] + title.width * (within % title.per_line)
    end = offset[line] + length[line] - 1
    values = np.zeros(len(line))
    for part in chunks(len(line)):
        fields = fields_at(buffer, start[part], end[part], title.width)
        empty = (fields <= ord(" ")).all(axis=1)
        try:
            values[part] = real_numbers(fields)
            if empty.any():
                raise FieldError(int(np.argmax(empty)), "")
        except FieldError as error:
            at = int(line[part.start + error.index]) + 1
            raise FileError(
                f"{path}, line {at}: matrix {title.name!r} has {error.text!r} where a number in {title.width} columns "
                f"should be; {_REMEDY}"
            ) from None
    return values


def encode_matrix(strings: Strings, options: Op4Options) -> bytes:
    """Bytes of a matrix as text of an ASCII OUTPUT4 file: title, columns with entries, and the last column.

    `strings` are its entries; of `options` only the precision counts: 10 digits in single, 17 in double.
    """
    digits, per_line = (9, 5) if options.single else (16, 3)
    width = digits + 7 if options.single else digits + 8  # a third digit of an exponent fits
    rows = -strings.shape[0] if strings.layout == "bigmat" else strings.shape[0]
    name = strings.name.upper().ljust(8)
    wide, mark = (16, "|I16") if max(strings.shape) > 9_999_999 else (8, "")
    title = f"{strings.shape[1]:{wide}d}{rows:{wide}d}{strings.form:8d}{strings.kind:8d}{name}"
    lines = [f"{title}1P,{per_line}E{width}.{digits}{mark}"]
    parts = 2 if strings.kind > 2 else 1
    words = parts * (1 if options.single else 2)
    texts = [f"{number:{width}.{digits}E}" for number in strings.numbers.tolist()]
    begins = np.flatnonzero(np.diff(strings.column, prepend=-1))
    ends = np.append(begins[1:], len(strings.column))
    head = {"dense": 0, "sparse": 1, "bigmat": 2}[strings.layout]
    for a, b in zip(begins.tolist(), ends.tolist(), strict=True):
        dense = strings.layout == "dense"
        total = sum(int(strings.length[s]) * (parts if dense else words) + head for s in range(a, b))
        lines.append(f"{strings.column[a] + 1:8d}{strings.row[a] + 1 if dense else 0:8d}{total:8d}")
        for s in range(a, b):
            length = int(strings.length[s]) * words
            if strings.layout == "bigmat":
                lines.append(f"{length + 1:8d}{strings.row[s] + 1:8d}")
            elif not dense:
                lines.append(f"{strings.row[s] + 1 + 65536 * (length + 1):12d}")
            first = int(strings.first[s]) * parts
            number_texts = texts[first : first + int(strings.length[s]) * parts]
            lines.extend("".join(number_texts[i : i + per_line]) for i in range(0, len(number_texts), per_line))
    lines.append(f"{strings.shape[1] + 1:8d}{1:8d}{1:8d}")
    lines.append(f"{1.0:{width}.{digits}E}")
    return "\n".join([*lines, ""]).encode("ascii")
