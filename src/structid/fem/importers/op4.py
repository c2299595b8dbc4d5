"""Nastran OUTPUT4 files: ASCII or binary, dense or sparse, real or complex, single or double precision.

A matrix is stored as strings: runs of entries without a gap in one column. What is kept: name, values, form. There is
no numbering in the format; rows follow the set that was written (the a-set in the order of its nodes and components,
unless the model was resequenced).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.core.arrays import AnyArray, FloatArray, IntArray
from structid.core.errors import FileError, InputError
from structid.fem.importers.fixed_fields import FieldError, chunks, fields_at, real_numbers
from structid.fem.importers.imported import ImportedMatrix, complete_triangles
from structid.fem.importers.matrix_files import Layout, Op4Options
from structid.files.sparse import coordinates

_BINARY_REMEDY = "the file is cut short or damaged; copy it in binary mode or write it again"
_FORMAT = re.compile(rb"(?:1P,?)?\s*(\d+)\s*[EDG](\d+)\.(\d+)", re.IGNORECASE)
#: Letters of a form that are looked at.
_LONGEST = 100
#: Entries of a string of the sparse layout at most: its length has 15 bits and is counted in words.
_LONGEST_STRING = 4096
_TEXT_REMEDY = "the file is cut short or damaged; copy it or write it again"


def read(path: Path) -> list[ImportedMatrix]:
    """Every matrix in the OUTPUT4 file at `path`, in order; symmetric ones complete.

    ASCII or binary, byte order and 32- or 64-bit words are recognized from the file.

    Raises
    ------
    FileError
        If the file is cut short or damaged, with the matrix, byte or line; if it holds no matrix, or entries of a
        symmetric one disagree.
    """
    content = path.read_bytes()
    kind = _word_format(content)
    matrices = _text_matrices(path, content) if kind is None else _binary_matrices(path, content, kind)
    if not matrices:
        raise FileError(f"{path}: holds no matrix; write some with OUTPUT4")
    return matrices


def file_bytes(path: Path, matrices: Sequence[ImportedMatrix], options: Op4Options) -> bytes:
    """Content of an OUTPUT4 file of `matrices` in the format of `options`: text or binary; `path` is for errors.

    Raises
    ------
    FileError
        If a name is empty, longer than eight characters, not ASCII or has a blank, a matrix has too many rows for the
        layout, or an entry is not finite.
    """
    parts = []
    for item in matrices:
        strings = _make_strings(path, item, options)
        parts.append(_encode_binary(strings, options) if options.binary else _encode_text(strings, options))
    return b"".join(parts)


def _make_strings(path: Path, item: ImportedMatrix, options: Op4Options) -> _Strings:
    """The matrix `item` as strings of OUTPUT4, runs of entries in a column, in the layout and precision of `options`.

    Raises `FileError`, which names `path`, if its name, size or values do not fit the format.
    """
    if len(item.name) > 8 or not item.name.isascii() or not item.name or " " in item.name:
        raise FileError(f"{path}: the name {item.name!r} must have 1 to 8 ASCII characters; rename the matrix")
    if options.layout == "sparse" and item.matrix.shape[0] > 65535:
        raise FileError(f"{path}: {item.name!r} has more than 65535 rows; write it with the layout 'bigmat'")
    if not np.isfinite(item.matrix.data).all():
        raise FileError(f"{path}: {item.name!r} holds NaN or infinite entries, which the format does not have")
    return _strings_of(item.name, sparse.csc_array(item.matrix), _form(item.matrix), options.layout, options.single)


def _form(matrix: sparse.csc_array) -> int:
    """Number of OUTPUT4 for the form of `matrix`: 2 rectangular, 6 symmetric, 1 square."""
    if matrix.shape[0] != matrix.shape[1]:
        return 2
    return 6 if abs(matrix - matrix.T).nnz == 0 else 1


class _WordFormat(NamedTuple):
    """Byte order (``<`` or ``>``) and bytes of a word."""

    order: str
    word: int

    @property
    def integer(self) -> str:
        return "i" if self.word == 4 else "q"


class _Header(NamedTuple):
    """The first record of a matrix; `rows` is negative in the layout "bigmat"."""

    columns: int
    rows: int
    form: int
    kind: int
    name: str


def _word_format(content: bytes) -> _WordFormat | None:
    """Byte order and word size of the binary OUTPUT4 file `content`, from the length of its first record.

    None if it is text.
    """
    for order in "<>":
        for marker, word in ((24, 4), (48, 8)):
            if content[:4] == struct.pack(f"{order}i", marker):
                return _WordFormat(order, word)
    return None


def _binary_matrices(path: Path, content: bytes, kind: _WordFormat) -> list[ImportedMatrix]:
    """Every matrix in the bytes `content` of a binary OUTPUT4 file, in order; symmetric ones complete.

    `kind` has byte order and word size. Raises `FileError`, which names `path`, if the file is cut short or damaged.
    """
    read: list[ImportedMatrix] = []
    begin = 0
    padded = content + b"\0" * (-len(content) % 4)
    view = np.frombuffer(padded, dtype=np.uint32)
    while begin < len(content):
        header, begin = _read_header(path, content, begin, kind)
        columns, begin = _read_columns(path, content, begin, kind, header)
        matrix = _read_matrix(path, view, kind, header, columns)
        read.append(_finish_matrix(path, header.name, matrix, header.form))
    return read


def _record_range(path: Path, content: bytes, offset: int, kind: _WordFormat, what: str) -> tuple[int, int]:
    """Byte where the data of the record at byte `offset` begin, and their length in bytes; its two markers must agree.

    `content` are all bytes of the file. Raises `FileError`, which names the record `what`, if it is cut short or
    damaged. `kind` has byte order and word size.
    """
    if offset + 4 > len(content):
        raise FileError(f"{path}: ends at byte {len(content)} before {what}; {_BINARY_REMEDY}")
    (length,) = struct.unpack_from(f"{kind.order}i", content, offset)
    end = offset + 4 + length
    if length < 3 * kind.word or end + 4 > len(content):
        raise FileError(
            f"{path}: byte {offset}: {what} should have {length} bytes, but the file ends; {_BINARY_REMEDY}"
        )
    if struct.unpack_from(f"{kind.order}i", content, end)[0] != length:
        raise FileError(f"{path}: byte {offset}: {what} does not end where it says; {_BINARY_REMEDY}")
    return offset + 4, length


def _read_header(path: Path, content: bytes, offset: int, kind: _WordFormat) -> tuple[_Header, int]:
    """The header of the matrix at byte `offset` of the file `content`, and the byte behind it.

    The header has sizes, form, type and name. Raises `FileError` if it is cut short, or its sizes or type are not
    possible. `kind` has byte order and word size.
    """
    start, length = _record_range(path, content, offset, kind, "the header of a matrix")
    if length != 6 * kind.word:
        raise FileError(
            f"{path}: byte {offset}: the header of a matrix has {length} bytes instead of {6 * kind.word}; {_BINARY_REMEDY}"
        )
    columns, rows, form, number = struct.unpack_from(f"{kind.order}4{kind.integer}", content, start)
    name = content[start + 4 * kind.word : start + 6 * kind.word].decode("latin-1").replace("\0", " ").strip()
    if columns <= 0 or rows == 0 or number not in (1, 2, 3, 4):
        raise FileError(
            f"{path}: byte {offset}: matrix {name!r} has {rows} rows, {columns} columns and type {number}; {_BINARY_REMEDY}"
        )
    return _Header(columns, rows, form, number, name.replace(" ", "")), start + length + 4


def _read_columns(path: Path, content: bytes, offset: int, kind: _WordFormat, header: _Header) -> tuple[IntArray, int]:
    """Byte, column, row and number of words of each column record, (n_records, 4), and the byte behind the matrix.

    Columns count from 0; rows from 1, with 0 where strings follow. `content` is that of the file; the records begin at
    byte `offset`. Raises `FileError` for a record that is cut short or not possible. `kind` has byte order and word
    size, `header` sizes and name of the matrix.
    """
    rows = []
    unpack = struct.Struct(f"{kind.order}3{kind.integer}").unpack_from
    what = f"column record of matrix {header.name!r}"
    while True:
        start, length = _record_range(path, content, offset, kind, f"a {what}")
        column, row, words = unpack(content, start)
        next_at = start + length + 4
        if column == header.columns + 1:
            break
        if not 1 <= column <= header.columns or row < 0 or (3 + words) * kind.word != length:
            raise FileError(
                f"{path}: byte {offset}: a {what} has column {column}, row {row} and {words} words in {length} bytes; "
                f"{_BINARY_REMEDY}"
            )
        rows.append((start + 3 * kind.word, column - 1, row, words))
        offset = next_at
    return np.array(rows, dtype=np.int64).reshape(-1, 4), next_at


def _read_matrix(path: Path, view: NDArray[np.uint32], kind: _WordFormat, header: _Header, columns: IntArray) -> Any:
    """The sparse matrix of one header, put together from the strings in its column records.

    `view` is the file as 32-bit words, `columns` (n_records, 4) the byte, column, row and number of words of each
    record. Raises `FileError` if entries lie outside the matrix, or a string ends within a number or beyond its record.
    """
    is_complex = header.kind > 2
    single = header.kind % 2 == 1
    shape = (abs(header.rows), header.columns)
    per_real = 2 if kind.word == 4 and not single else 1  # words of a number
    first_byte, first_row, first_column, length = _string_table(path, view, kind, header, columns)
    per_entry = per_real * (2 if is_complex else 1)
    if (length % per_entry).any():
        raise FileError(f"{path}: matrix {header.name!r} has a string that ends within a number; {_BINARY_REMEDY}")
    length = length // per_entry
    if len(length) and ((first_row < 0) | (first_row + length > shape[0]) | (length < 1)).any():
        raise FileError(f"{path}: matrix {header.name!r} has entries outside its {shape[0]} rows; {_BINARY_REMEDY}")
    reals = length * (2 if is_complex else 1)
    before = np.cumsum(reals) - reals
    within = np.arange(int(reals.sum())) - np.repeat(before, reals)
    step = per_real * kind.word // 4
    numbers = _numbers(view, np.repeat(first_byte // 4, reals) + within * step, step, kind)
    return _assemble_strings(shape, first_row, first_column, length, numbers, is_complex)


def _string_table(
    path: Path, view: NDArray[np.uint32], kind: _WordFormat, header: _Header, columns: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """First byte, row and column (from 0) and number of words of each string, (n_strings,) each.

    The k-th strings of all columns are read together. `view` is the file as 32-bit words, `columns` (n_records, 4) the
    byte, column, row and number of words of each record. Raises `FileError` for a string that is longer than its
    record. `kind` has byte order and word size.
    """
    start, column, row, words = columns.T
    dense = row > 0
    parts_found = [(start[dense], row[dense] - 1, column[dense], words[dense])]
    offset, column, words_left = start[~dense], column[~dense], words[~dense]
    big = header.rows < 0 or header.rows > 65535
    while True:
        more = words_left > 0
        offset, column, words_left = offset[more], column[more], words_left[more]
        if not offset.size:
            break
        first = _integers(view, offset, kind)
        if big:
            length, top, head = first - 1, _integers(view, offset + kind.word, kind) - 1, 2
        else:
            length, top, head = (first >> 16) - 1, (first & 0xFFFF) - 1, 1
        if ((length < 1) | (length + head > words_left)).any():
            bad = int(column[np.argmax((length < 1) | (length + head > words_left))])
            raise FileError(
                f"{path}: matrix {header.name!r}: a string of column {bad + 1} is longer than its record; {_BINARY_REMEDY}"
            )
        parts_found.append((offset + head * kind.word, top, column, length))
        offset, words_left = offset + (head + length) * kind.word, words_left - head - length
    parts = [np.concatenate(column_of) for column_of in zip(*parts_found, strict=True)]
    return parts[0], parts[1], parts[2], parts[3]


def _integers(view: NDArray[np.uint32], byte: IntArray, kind: _WordFormat) -> IntArray:
    pair = view[(byte // 4)[:, None] + np.arange(kind.word // 4)]
    return np.ascontiguousarray(pair).view(f"{kind.order}i{kind.word}").ravel().astype(np.int64)


def _numbers(view: NDArray[np.uint32], offsets: IntArray, words: int, kind: _WordFormat) -> FloatArray:
    """Real numbers (n,) of `words` (1 or 2) 32-bit words each, from the 32-bit words at `offsets` (n,) on."""
    taken = view[offsets] if words == 1 else view[offsets[:, None] + np.arange(words)]
    return np.ascontiguousarray(taken).view(f"{kind.order}f{4 * words}").ravel().astype(np.float64)


def _encode_binary(strings: _Strings, options: Op4Options) -> bytes:
    """Bytes of a matrix as records of a binary OUTPUT4 file: header, one for each column with entries, a last one.

    `strings` are its entries; `options` give byte order, word size and precision.
    """
    kind = _WordFormat("<" if options.byte_order == "little" else ">", options.words // 8)
    name = strings.name.upper().ljust(2 * kind.word).encode("ascii")
    head = struct.pack(
        f"{kind.order}4{kind.integer}", strings.shape[1], strings.stated_rows, strings.form, strings.kind
    )
    parts = [_frame_record(head + name, kind)]
    size = 4 if options.single and kind.word == 4 else 8
    numbers = strings.numbers.astype(f"{kind.order}f{size}").tobytes()
    per_entry = (2 if strings.kind > 2 else 1) * size
    byte, byte_end = strings.first * per_entry, (strings.first + strings.length) * per_entry
    for a, b in strings.column_ranges:
        body = []
        for s in range(a, b):
            data = numbers[byte[s] : byte_end[s]]
            body.append(_pack_string_head(int(strings.row[s]) + 1, len(data) // kind.word, strings.layout, kind) + data)
        whole = b"".join(body)
        first = int(strings.row[a]) + 1 if strings.layout == "dense" else 0
        start = struct.pack(f"{kind.order}3{kind.integer}", int(strings.column[a]) + 1, first, len(whole) // kind.word)
        parts.append(_frame_record(start + whole, kind))
    last = struct.pack(f"{kind.order}3{kind.integer}", strings.shape[1] + 1, 1, size // kind.word)
    parts.append(_frame_record(last + struct.pack(f"{kind.order}{'f' if size == 4 else 'd'}", 1.0), kind))
    return b"".join(parts)


def _pack_string_head(row: int, words: int, layout: str, kind: _WordFormat) -> bytes:
    """Bytes before a string of a sparse layout: number of `words` and first `row` (from 1); b"" in the dense `layout`.

    `kind` has byte order and word size.
    """
    if layout == "dense":
        return b""
    if layout == "bigmat":
        return struct.pack(f"{kind.order}2{kind.integer}", words + 1, row)
    return struct.pack(f"{kind.order}{kind.integer}", row + 65536 * (words + 1))


def _frame_record(body: bytes, kind: _WordFormat) -> bytes:
    marker = struct.pack(f"{kind.order}i", len(body))
    return marker + body + marker


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
        """`count` whole numbers on the line with index `line_index`, in fields of eight columns or between blanks.

        Raises `FileError`, which calls them `what`, if there is no such line or something else on it.
        """
        if line_index >= len(self.text):
            raise FileError(f"{self.path}: ends at line {len(self.text)} before {what}; {_TEXT_REMEDY}")
        line = self.text[line_index]
        try:
            words = line.split()
            if len(words) == count:
                return [int(word) for word in words]
            return [int(line[8 * i : 8 * i + 8]) for i in range(count)]
        except ValueError:
            shown = line.decode("latin-1").strip()[:40]
            raise FileError(
                f"{self.path}, line {line_index + 1}: must be {what} ({count} whole numbers), got {shown!r}; {_TEXT_REMEDY}"
            ) from None


def _text_matrices(path: Path, content: bytes) -> list[ImportedMatrix]:
    """Every matrix in the text `content` of an ASCII OUTPUT4 file, in order; symmetric ones complete.

    Raises `FileError`, which names `path` and mostly the line, if the file is cut short or damaged.
    """
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
            raise FileError(f"{path}: ends within matrix {title.name!r}; {_TEXT_REMEDY}")
        numbers = _read_numbers(path, buffer, offset, length, table, title)
        is_complex = title.kind > 2
        shape = (abs(title.rows), title.columns)
        count = table[:, 1] // (2 if is_complex else 1)
        matrix = _assemble_strings(shape, table[:, 2], table[:, 3], count, numbers, is_complex)
        read.append(_finish_matrix(path, title.name, matrix, title.form))
    return read


def _read_title(lines: _Lines, line_index: int) -> _Title:
    """The title line of a matrix at line index `line_index`: sizes, form, type, name and number format.

    Five numbers a line of 16 columns if it states no format. Raises `FileError` for sizes or types that are not
    possible.
    """
    line = lines.text[line_index]
    wide = 16 if line.rstrip().upper().endswith(b"|I16") else 0  # large dimensions have fields of sixteen columns
    columns, rows, form, kind = _title_numbers(lines, line_index, wide)
    name = line[32 + wide : 40 + wide].decode("latin-1").replace("\0", " ").strip().upper()
    match = _FORMAT.search(line[40 + wide :][:_LONGEST])
    if columns <= 0 or rows == 0 or kind not in (1, 2, 3, 4):
        raise FileError(
            f"{lines.path}, line {line_index + 1}: matrix {name!r} has {rows} rows, {columns} columns and type {kind};"
            f" {_TEXT_REMEDY}"
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
            f"{_TEXT_REMEDY}"
        ) from None


def _read_strings(lines: _Lines, line_index: int, title: _Title) -> tuple[IntArray, int]:
    """First line, number of reals, row and column of each string, (n_strings, 4), and the line index behind the matrix.

    Lines, rows and columns count from 0. The strings begin at `line_index`, behind the `title` of the matrix; raises
    `FileError` for positions that are not possible.
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
                f" which is not possible; {_TEXT_REMEDY}"
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
            f"{_TEXT_REMEDY}"
        )


def _read_numbers(
    path: Path, buffer: NDArray[np.uint8], offset: IntArray, length: IntArray, table: IntArray, title: _Title
) -> FloatArray:
    """The real numbers (n_numbers,) of all strings, one after another.

    Raises `FileError` with the line for a field that is no number. `offset` and `length` (n_lines,) are first byte and
    size of each line in `buffer`; `table` (n_strings, 4) has first line, number of reals, row and column of each
    string. `title` has width and number of the fields of a line.
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
            line_number = int(line[part.start + error.index]) + 1
            raise FileError(
                f"{path}, line {line_number}: matrix {title.name!r} has {error.text!r} where a number in {title.width} columns "
                f"should be; {_TEXT_REMEDY}"
            ) from None
    return values


def _encode_text(strings: _Strings, options: Op4Options) -> bytes:
    """Bytes of a matrix as text of an ASCII OUTPUT4 file: title, columns with entries, and the last column.

    `strings` are its entries; of `options` only the precision counts: 10 digits in single, 17 in double.
    """
    digits, per_line = (9, 5) if options.single else (16, 3)
    width = digits + 7 if options.single else digits + 8  # a third digit of an exponent fits
    name = strings.name.upper().ljust(8)
    wide, mark = (16, "|I16") if max(strings.shape) > 9_999_999 else (8, "")
    title = f"{strings.shape[1]:{wide}d}{strings.stated_rows:{wide}d}{strings.form:8d}{strings.kind:8d}{name}"
    lines = [f"{title}1P,{per_line}E{width}.{digits}{mark}"]
    parts = 2 if strings.kind > 2 else 1
    words = parts * (1 if options.single else 2)
    texts = [f"{number:{width}.{digits}E}" for number in strings.numbers.tolist()]
    head = {"dense": 0, "sparse": 1, "bigmat": 2}[strings.layout]
    for a, b in strings.column_ranges:
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


@dataclass(frozen=True, eq=False)
class _Strings:
    """A matrix as strings.

    Attributes
    ----------
    name : str
    shape : (int, int)
    form : int
        1 square, 2 rectangular, 6 symmetric.
    kind : int
        1 and 2 real, 3 and 4 complex; 1 and 3 single, 2 and 4 double precision.
    layout : {"bigmat", "sparse", "dense"}
    row, column, length, first : (n_strings,) int arrays
        Row and column (from 0) where each string begins, its number of entries, and where its first entry stands in
        `values`.
    values : (n_entries,) float or complex array
    """

    name: str
    shape: tuple[int, int]
    form: int
    kind: int
    layout: Layout
    row: IntArray
    column: IntArray
    length: IntArray
    first: IntArray
    values: AnyArray

    @property
    def numbers(self) -> AnyArray:
        """The values as real numbers, real and imaginary parts in turn where complex."""
        return self.values.view(np.float64) if np.iscomplexobj(self.values) else self.values

    @property
    def stated_rows(self) -> int:
        """Number of rows as a header states it: negative in the layout "bigmat"."""
        return -self.shape[0] if self.layout == "bigmat" else self.shape[0]

    @property
    def column_ranges(self) -> list[tuple[int, int]]:
        """Index of the first string of each column that has any, and of the first behind."""
        begins = np.flatnonzero(np.diff(self.column, prepend=-1)).tolist()
        return list(pairwise([*begins, len(self.column)]))


def _strings_of(name: str, matrix: sparse.csc_array, form: int, layout: Layout, single: bool) -> _Strings:
    """The entries of `matrix` as strings, column by column: runs without a gap.

    The sparse layout limits their length: longer runs are cut. In the dense layout a column is a single string from its
    first to its last entry, zeros included.

    `name` is that of the matrix, `form` the number of OUTPUT4 for its form (1, 2 or 6), `layout` that of the file.
    `single` sets the type to single precision; values are not rounded here. Sorts `matrix` and removes its zeros in
    place.
    """
    matrix.sort_indices()
    matrix.eliminate_zeros()
    kind = (3 if np.iscomplexobj(matrix.data) else 1) + (0 if single else 1)
    column = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    row, values = matrix.indices.astype(np.int64), matrix.data
    if layout == "dense":
        row, column, values = _fill_columns(matrix)
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = (np.diff(row) != 1) | (np.diff(column) != 0)
    if layout == "sparse":
        begins |= _cut_long_strings(begins)
    first = np.flatnonzero(begins)
    length = np.diff(np.append(first, len(row)))
    shape = (int(matrix.shape[0]), int(matrix.shape[1]))
    return _Strings(name, shape, form, kind, layout, row[first], column[first], length, first, np.array(values))


def _cut_long_strings(begins: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the entries that begin a string when strings are cut after `_LONGEST_STRING` entries, (n_entries,).

    `begins` (n_entries,) marks the entries that begin one anyway.
    """
    index = np.arange(len(begins))
    start = np.maximum.accumulate(np.where(begins, index, 0))
    return (index - start) % _LONGEST_STRING == 0


def _fill_columns(matrix: sparse.csc_array) -> tuple[IntArray, IntArray, AnyArray]:
    """Row, column and value (n,) of the entries of `matrix` from the first to the last stored one of each column.

    Zeros between them are among these.
    """
    used = np.flatnonzero(np.diff(matrix.indptr))
    top = matrix.indices[matrix.indptr[used]].astype(np.int64)
    count = matrix.indices[matrix.indptr[used + 1] - 1] - top + 1
    before = np.cumsum(count) - count
    column = np.repeat(used, count)
    row = np.arange(int(count.sum())) - np.repeat(before, count) + np.repeat(top, count)
    values = np.zeros(len(row), dtype=matrix.dtype)
    offset = np.zeros(matrix.shape[1], dtype=np.int64)
    offset[used] = before - top
    column_of_entry = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    values[matrix.indices + offset[column_of_entry]] = matrix.data
    return row, column, values


def entries(row: IntArray, column: IntArray, length: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Row, column and place within its string of every entry, (n_entries,) each.

    `row`, `column` and `length` (n_strings,) are first row, column and number of entries of each string.
    """
    before = np.cumsum(length) - length
    within = np.arange(int(length.sum())) - np.repeat(before, length)
    return np.repeat(row, length) + within, np.repeat(column, length), within


def _assemble_strings(
    shape: tuple[int, int], row: IntArray, column: IntArray, length: IntArray, numbers: AnyArray, is_complex: bool
) -> sparse.csc_array:
    """The sparse matrix of `shape` from strings: first `row` and `column` (from 0) and `length` of each, (n_strings,).

    `numbers` are the values of all entries in order; real and imaginary parts alternate if `is_complex`. Zeros are left
    out of the matrix.
    """
    values = np.ascontiguousarray(numbers, dtype=np.float64)
    rows, columns, _ = entries(row, column, length)
    compact = coordinates(shape, rows, columns, values.view(np.complex128) if is_complex else values)
    compact.eliminate_zeros()
    return compact


def _finish_matrix(path: Path, name: str, matrix: sparse.csc_array, form: int) -> ImportedMatrix:
    """The matrix called `name`, both triangles if its OUTPUT4 form is 6 (symmetric); `FileError` if pairs disagree."""
    try:
        return ImportedMatrix(name, complete_triangles(matrix, name, form == 6))
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
