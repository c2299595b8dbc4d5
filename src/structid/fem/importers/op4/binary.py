"""Binary OUTPUT4: Fortran records of 32- or 64-bit words, little or big endian."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.imported import ImportedMatrix
from structid.fem.importers.op4.strings import Op4Options, Strings, assemble_strings, finish_matrix

_REMEDY = "the file is cut short or damaged; copy it in binary mode or write it again"


class Kind(NamedTuple):
    """Byte order (``<`` or ``>``) and bytes of a word."""

    order: str
    word: int

    @property
    def integer(self) -> str:
        return "i" if self.word == 4 else "q"


class Header(NamedTuple):
    """The first record of a matrix."""

    columns: int
    rows: int
    form: int
    kind: int
    name: str


def kind_of(content: bytes) -> Kind | None:
    """Byte order and word size of the binary OUTPUT4 file `content`, from the length of its first record.

    None if it is text.
    """
    for order in "<>":
        for marker, word in ((24, 4), (48, 8)):
            if content[:4] == struct.pack(f"{order}i", marker):
                return Kind(order, word)
    return None


def matrices(path: Path, content: bytes, kind: Kind) -> list[ImportedMatrix]:
    """Every matrix in the bytes `content` of a binary OUTPUT4 file."""
    read: list[ImportedMatrix] = []
    begin = 0
    padded = content + b"\0" * (-len(content) % 4)
    view = np.frombuffer(padded, dtype=np.uint32)
    while begin < len(content):
        header, begin = _read_header(path, content, begin, kind)
        columns, begin = _read_columns(path, content, begin, kind, header)
        matrix = _read_matrix(path, view, kind, header, columns)
        read.append(finish_matrix(path, header.name, matrix, header.form))
    return read


def _record_range(path: Path, content: bytes, offset: int, kind: Kind, what: str) -> tuple[int, int]:
    """Byte of `content` where the data of the record at byte `offset` begin, and their length in bytes, its two markers compared.

    Raises `FileError`, which names the record `what`, if it is cut short or damaged.
    """
    if offset + 4 > len(content):
        raise FileError(f"{path}: ends at byte {len(content)} before {what}; {_REMEDY}")
    (length,) = struct.unpack_from(f"{kind.order}i", content, offset)
    end = offset + 4 + length
    if length < 3 * kind.word or end + 4 > len(content):
        raise FileError(f"{path}: byte {offset}: {what} should have {length} bytes, but the file ends; {_REMEDY}")
    if struct.unpack_from(f"{kind.order}i", content, end)[0] != length:
        raise FileError(f"{path}: byte {offset}: {what} does not end where it says; {_REMEDY}")
    return offset + 4, length


def _read_header(path: Path, content: bytes, offset: int, kind: Kind) -> tuple[Header, int]:
    """The header of the matrix at byte `offset` of the file `content`, and the byte behind it.

    Raises `FileError` if it is cut short, or its sizes or type are not possible.
    """
    start, length = _record_range(path, content, offset, kind, "the header of a matrix")
    if length != 6 * kind.word:
        raise FileError(
            f"{path}: byte {offset}: the header of a matrix has {length} bytes instead of {6 * kind.word}; {_REMEDY}"
        )
    columns, rows, form, number = struct.unpack_from(f"{kind.order}4{kind.integer}", content, start)
    name = content[start + 4 * kind.word : start + 6 * kind.word].decode("latin-1").replace("\0", " ").strip()
    if columns <= 0 or rows == 0 or number not in (1, 2, 3, 4):
        raise FileError(
            f"{path}: byte {offset}: matrix {name!r} has {rows} rows, {columns} columns and type {number}; {_REMEDY}"
        )
    return Header(columns, rows, form, number, name.replace(" ", "")), start + length + 4


def _read_columns(path: Path, content: bytes, offset: int, kind: Kind, header: Header) -> tuple[IntArray, int]:
    """Byte, column, row and number of words of each column record, (n_records, 4), and the byte behind the matrix.

    Columns count from 0; rows from 1, with 0 where strings follow. `content` is that of the file; the records begin at byte
    `offset`.
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
                f"{_REMEDY}"
            )
        rows.append((start + 3 * kind.word, column - 1, row, words))
        offset = next_at
    return np.array(rows, dtype=np.int64).reshape(-1, 4), next_at


def _read_matrix(path: Path, view: NDArray[np.uint32], kind: Kind, header: Header, columns: IntArray) -> Any:
    """The sparse matrix of one header, put together from the strings in its column records.

    `view` is the file as 32-bit words, `columns` (n_records, 4) the table of `_read_columns`. Raises `FileError` if entries
    lie outside the matrix.
    """
    is_complex = header.kind > 2
    single = header.kind % 2 == 1
    shape = (abs(header.rows), header.columns)
    per_real = 2 if kind.word == 4 and not single else 1  # words of a number
    at, first_row, first_column, length = _string_table(path, view, kind, header, columns)
    per_entry = per_real * (2 if is_complex else 1)
    if (length % per_entry).any():
        raise FileError(f"{path}: matrix {header.name!r} has a string that ends within a number; {_REMEDY}")
    length = length // per_entry
    if len(length) and ((first_row < 0) | (first_row + length > shape[0]) | (length < 1)).any():
        raise FileError(f"{path}: matrix {header.name!r} has entries outside its {shape[0]} rows; {_REMEDY}")
    reals = length * (2 if is_complex else 1)
    before = np.cumsum(reals) - reals
    within = np.arange(int(reals.sum())) - np.repeat(before, reals)
    step = per_real * kind.word // 4
    numbers = _numbers(view, np.repeat(at // 4, reals) + within * step, step, kind)
    return assemble_strings(shape, first_row, first_column, length, numbers, is_complex)


def _string_table(
    path: Path, view: NDArray[np.uint32], kind: Kind, header: Header, columns: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """First byte, row and column (from 0) and number of words of each string, (n_strings,) each.

    The k-th strings of all columns are read together. `view` is the file as 32-bit words, `columns` the table of column
    records.
    """
    start, column, row, words = columns.T
    dense = row > 0
    parts_found = [(start[dense], row[dense] - 1, column[dense], words[dense])]
    at, column, words_left = start[~dense], column[~dense], words[~dense]
    big = header.rows < 0 or header.rows > 65535
    while True:
        more = words_left > 0
        at, column, words_left = at[more], column[more], words_left[more]
        if not at.size:
            break
        first = _integers(view, at, kind)
        if big:
            length, top, head = first - 1, _integers(view, at + kind.word, kind) - 1, 2
        else:
            length, top, head = (first >> 16) - 1, (first & 0xFFFF) - 1, 1
        if ((length < 1) | (length + head > words_left)).any():
            bad = int(column[np.argmax((length < 1) | (length + head > words_left))])
            raise FileError(
                f"{path}: matrix {header.name!r}: a string of column {bad + 1} is longer than its record; {_REMEDY}"
            )
        parts_found.append((at + head * kind.word, top, column, length))
        at, words_left = at + (head + length) * kind.word, words_left - head - length
    parts = [np.concatenate(column_of) for column_of in zip(*parts_found, strict=True)]
    return parts[0], parts[1], parts[2], parts[3]


def _integers(view: NDArray[np.uint32], byte: IntArray, kind: Kind) -> IntArray:
    pair = view[(byte // 4)[:, None] + np.arange(kind.word // 4)]
    return np.ascontiguousarray(pair).view(f"{kind.order}i{kind.word}").ravel().astype(np.int64)


def _numbers(view: NDArray[np.uint32], offsets: IntArray, words: int, kind: Kind) -> FloatArray:
    """Real numbers (n,) of `words` (1 or 2) 32-bit words each, from the 32-bit words at `offsets` (n,) on."""
    taken = view[offsets] if words == 1 else view[offsets[:, None] + np.arange(words)]
    return np.ascontiguousarray(taken).view(f"{kind.order}f{4 * words}").ravel().astype(np.float64)


def encode_matrix(strings: Strings, options: Op4Options) -> bytes:
    """Bytes of a matrix as records of a binary OUTPUT4 file: header, a record for each column with entries, and the last one.

    `strings` are its entries; `options` give byte order, word size and precision.
    """
    kind = Kind("<" if options.byte_order == "little" else ">", options.words // 8)
    rows = -strings.shape[0] if strings.layout == "bigmat" else strings.shape[0]
    name = strings.name.upper().ljust(2 * kind.word).encode("ascii")
    head = struct.pack(f"{kind.order}4{kind.integer}", strings.shape[1], rows, strings.form, strings.kind)
    parts = [_frame_record(head + name, kind)]
    size = 4 if options.single and kind.word == 4 else 8
    numbers = strings.numbers.astype(f"{kind.order}f{size}").tobytes()
    per_entry = (2 if strings.kind > 2 else 1) * size
    byte, byte_end = strings.first * per_entry, (strings.first + strings.length) * per_entry
    begins = np.flatnonzero(np.diff(strings.column, prepend=-1))
    ends = np.append(begins[1:], len(strings.column))
    for a, b in zip(begins.tolist(), ends.tolist(), strict=True):
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


def _pack_string_head(row: int, words: int, layout: str, kind: Kind) -> bytes:
    """Bytes before a string of the sparse layouts: its number of words and first row; none in the dense layout."""
    if layout == "dense":
        return b""
    if layout == "bigmat":
        return struct.pack(f"{kind.order}2{kind.integer}", words + 1, row)
    return struct.pack(f"{kind.order}{kind.integer}", row + 65536 * (words + 1))


def _frame_record(body: bytes, kind: Kind) -> bytes:
    marker = struct.pack(f"{kind.order}i", len(body))
    return marker + body + marker
