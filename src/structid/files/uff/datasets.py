"""Datasets of a universal file: separated and checked to be complete, their numbers in columns, and its units (164).

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, dataset 164.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError
from structid.core.units import FORCES, LENGTHS
from structid.files import require_readable

_TAG = re.compile(rb"[ ]{4}-1[ \t]*(\r\n|\n|\r|\Z)")
_BLANK = b" \t\r\n\x1a\0"
#: Lines of dataset 58 before its values, with its number and without the tag.
HEADER_LINES = 12
#: Bytes of a number, and numbers a value, by the ordinate data type of dataset 58.
ORDINATES = {2: (4, 1), 4: (8, 1), 5: (4, 2), 6: (8, 2)}
_NUMBER = re.compile(
    rb"[ \t\r\n]*([+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d{1,3}|[+-]\d{3}(?![\d.]))?|[+-]?(?:nan|inf)(?:inity)?)",
    re.IGNORECASE,
)
_PLAIN = re.compile(rb"[0-9+\-.eE \t\r\n]*")
_SHORT_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")
_POUNDAL = 0.3048 * 0.45359237
#: Length in m and force in N of each units code of dataset 164; 9 is for other ones.
_CODES = {
    1: (1.0, 1.0), 2: (LENGTHS["ft"], FORCES["lbf"]), 3: (1.0, FORCES["kgf"]), 4: (LENGTHS["ft"], _POUNDAL),
    5: (1e-3, 1e-3), 6: (1e-2, 1e-2), 7: (LENGTHS["in"], FORCES["lbf"]), 8: (1e-3, FORCES["kgf"]), 10: (1e-3, 1.0),
}  # fmt: skip
_SAME = 1e-4


@dataclass(frozen=True)
class UffDataset:
    """One dataset.

    Attributes
    ----------
    ordinal : int
        Its number in the file, from 1.
    number : int
        Its kind, such as 58.
    head : str
        The line that holds the number.
    content : bytes
        All between that line and the closing tag.
    values_at : int
        Of a binary dataset 58: where its values begin in `content`; 0 of a text.
    """

    ordinal: int
    number: int
    head: str
    content: bytes
    values_at: int = 0

    @property
    def lines(self) -> list[str]:
        """Lines of a text dataset as UTF-8 or else Latin-1; of a binary dataset 58 only those before its values."""
        content = self.content[: self.values_at] if self.values_at else self.content
        try:
            content.decode("utf-8")
            encoding = "utf-8"
        except UnicodeDecodeError:
            encoding = "latin-1"  # as a label such as µm is written
        # bytes end lines at CR and LF only, texts at a dozen letters more
        return [line.decode(encoding) for line in content.rstrip(b"\r\n \t").splitlines()]


def read_blocks(path: Path) -> list[UffDataset]:
    """Every dataset of the universal file at `path`, in order.

    Raises
    ------
    FileError
        If the file has no datasets, cannot be read, or is truncated or damaged.
    """
    path = require_readable(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error}); check the disk") from error
    blocks: list[UffDataset] = []
    offset = _skip_blank(data, 0)
    while offset < len(data):
        tag = _TAG.match(data, max(offset - 4, 0))
        if tag is None:
            what = "is not a universal file" if not blocks else f"goes on with junk after dataset {len(blocks)}"
            raise FileError(f"{path}: {what} (byte {offset}); copy or export it again")
        block, offset = _read_block(path, data, tag.end(), len(blocks) + 1)
        blocks.append(block)
        offset = _skip_blank(data, offset)
    if not blocks:
        raise FileError(f"{path}: is not a universal file, it has no datasets; check the export")
    return blocks


def dataset_lines(path: Path, wanted: int) -> list[tuple[int, list[str]]]:
    """Number in the file (from 1) and lines, without tags, of each ASCII dataset of the kind `wanted`.

    Raises
    ------
    FileError
        If the file is not a universal file, or is truncated or damaged.
    """
    return [(block.ordinal, block.lines) for block in read_blocks(path) if block.number == wanted]


def _skip_blank(data: bytes, offset: int) -> int:
    """First byte of `data` from `offset` on that is not blank, as its index; the length of `data` if there is none."""
    while offset < len(data) and data[offset] in _BLANK:
        offset += 1
    return offset


def _truncation_error(path: Path, ordinal: int) -> FileError:
    return FileError(f"{path}: ends within dataset {ordinal}; the file is truncated, copy or export it again")


def _read_block(path: Path, data: bytes, begin_of_head: int, count: int) -> tuple[UffDataset, int]:
    """The dataset whose number (its kind) stands at byte `begin_of_head` of the file `data`, and the byte behind it.

    It ends with its closing tag; `count` is its ordinal in the file, from 1. Raises `FileError` if it has no number or
    is cut short.
    """
    if not data[begin_of_head : begin_of_head + 6].strip().isdigit():
        raise FileError(f"{path}: dataset {count} has no number (byte {begin_of_head}); the file is damaged")
    number, end_of_head = int(data[begin_of_head : begin_of_head + 6]), data.find(b"\n", begin_of_head)
    if end_of_head < 0:
        end_of_head = len(data) - 1
    head, begin = data[begin_of_head:end_of_head].decode("ascii", errors="replace").rstrip(), end_of_head + 1
    if number == 58 and head[6:7].lower() == "b":
        values_at, size = _binary_values_range(path, data, begin_of_head, head, count)
        end = values_at + size
        while end < len(data) and data[end] in b"\r\n":
            end += 1
        tag = _TAG.match(data, end)
        assert tag is not None
        return UffDataset(count, number, head, data[begin : values_at + size], values_at - begin), tag.end()
    begin_of_head = begin - 1  # the tag may follow the number
    while True:
        end = data.find(b"    -1", begin_of_head)
        if end < 0:
            raise _truncation_error(path, count)
        tag = _TAG.match(data, end)
        if tag is not None and data[end - 1 : end] in (b"\n", b"\r"):
            return UffDataset(count, number, head, data[begin:end]), tag.end()
        begin_of_head = end + 1


def _binary_values_range(path: Path, data: bytes, offset: int, head: str, ordinal: int) -> tuple[int, int]:
    """First byte in `data` and number of bytes of the values of a binary dataset 58.

    Its first line `head` begins at byte `offset`; `ordinal` is its place in the file, for errors. Abscissas of uneven spacing
    have four or eight bytes in double precision: the position of the closing tag decides, else the size in the header.
    """
    lines, body = [], offset
    for _ in range(HEADER_LINES):
        end = data.find(b"\n", body)
        if end < 0:
            raise _truncation_error(path, ordinal)
        lines.append(data[body:end])
        body = end + 1
    try:
        ordinate, points, even = (int(lines[7][10 * i : 10 * i + 10]) for i in range(3))
        item, per_value = ORDINATES[ordinate]
    except (ValueError, KeyError) as error:
        raise FileError(f"{path}: dataset {ordinal} has a damaged header (record 7); export it again") from error
    if points < 1:
        raise FileError(f"{path}: dataset {ordinal} has {points} points; export it again")
    abscissas = {0} if even else {item, 4}
    sizes = [points * (abscissa + per_value * item) for abscissa in sorted(abscissas, reverse=True)]
    closed = [size for size in sizes if _is_closed(data, body + size)]
    if len(closed) == 1:
        return body, closed[0]
    if closed and head[31:43].strip().isdigit() and int(head[31:43]) in closed:
        return body, int(head[31:43])
    if min(sizes) > len(data) - body:
        raise _truncation_error(path, ordinal)
    raise FileError(
        f"{path}: dataset {ordinal} does not end after its {points} points; the file is truncated or damaged"
    )


def _is_closed(data: bytes, end: int) -> bool:
    """True if the closing tag of a dataset stands behind byte `end` of `data`, but for ends of lines."""
    while end < len(data) and data[end] in b"\r\n":
        end += 1
    return end < len(data) and _TAG.match(data, end) is not None


def real_number(text: str) -> float:
    """The number in `text`, one field of a Fortran file: ``1.5E+01``, ``1.5D+01`` or ``1.5-100``.

    Raises
    ------
    ValueError
        If the field is blank or holds something else.
    """
    plain = text.strip().replace("D", "E").replace("d", "e")
    if "e" not in plain.lower():
        plain = _SHORT_EXPONENT.sub(r"E\1", plain)
    return float(plain)


def _split_fields(line: str, widths: Sequence[int]) -> list[str]:
    """The fields of a line as texts without blanks around them.

    They are its words if there are as many as `widths`, else its columns of these widths (characters). Words come first
    because some writers make a column wider than the format has it, so that the others do not line up.
    """
    words = line.split()
    if len(words) == len(widths):
        return words
    fields, column = [], 0
    for width in widths:
        fields.append(line[column : column + width].strip())
        column += width
    return fields


def integers(line: str, widths: Sequence[int]) -> list[int]:
    """The whole numbers of a line, see `_split_fields`; a blank field is 0.

    Raises
    ------
    ValueError
        If a field holds something else.
    """
    return [int(field) if field else 0 for field in _split_fields(line, widths)]


def reals(line: str, widths: Sequence[int]) -> list[float]:
    """The numbers of a line, see `_split_fields`.

    Raises
    ------
    ValueError
        If a field is blank or holds something else.
    """
    return [real_number(field) for field in _split_fields(line, widths)]


def read_reals(text: bytes) -> FloatArray:
    """All numbers in `text`, (n,), also if Fortran left no blank between them or no letter before the exponent.

    Raises
    ------
    ValueError
        If something else stands among them; with the text.
    """
    if _PLAIN.fullmatch(text):
        try:
            return np.array(text.split(), dtype=np.float64)
        except ValueError:
            pass  # numbers without a blank between them, separated below
    numbers, offset = [], 0
    end = len(text.rstrip())
    while offset < end:
        match = _NUMBER.match(text, offset)
        if match is None:
            raise ValueError(f"{text[offset : offset + 20].decode('ascii', errors='replace').strip()!r} is no number")
        numbers.append(real_number(match[1].decode("ascii")))
        offset = match.end()
    return np.array(numbers, dtype=np.float64)


class UnitFactors(NamedTuple):
    """Units of a universal file: its numbers are divided by these to become m and N."""

    length: float
    force: float


def read_unit_factors(path: Path, blocks: Sequence[UffDataset]) -> UnitFactors | None:
    """The unit factors that dataset 164 states, by which numbers are divided to become m and N; None without dataset 164.

    `blocks` are the datasets of the file at `path`.

    Raises
    ------
    FileError
        If a factor is not positive, contradicts the units code beside it, or two datasets 164 differ.
    """
    stated = {_read_dataset_164(path, block) for block in blocks if block.number == 164}
    if len(stated) > 1:
        raise FileError(
            f"{path}: has several datasets 164 with different units; export the parts to files of their own"
        )
    return stated.pop() if stated else None


def _read_dataset_164(path: Path, block: UffDataset) -> UnitFactors:
    """The unit factors in `block`, a dataset 164, by which numbers are divided to become m and N.

    `FileError` if they are damaged, not positive, or contradict their units code by more than 1e-4.
    """
    where = f"{path}: dataset {block.ordinal} (164)"
    lines = block.content.splitlines()
    try:
        code = int(lines[0][:10])
        numbers = read_reals(b"\n".join(lines[1:]))
        length, force = float(numbers[0]), float(numbers[1])
    except (ValueError, IndexError) as error:
        raise FileError(f"{where} is damaged ({error}); export it again") from error
    if not all(math.isfinite(factor) and factor > 0 for factor in (length, force)):
        raise FileError(f"{where} has unit factors {(length, force)}; they must be positive")
    if code in _CODES:
        unit = _CODES[code]
        if abs(length * unit[0] - 1) > _SAME or abs(force * unit[1] - 1) > _SAME:
            raise FileError(
                f"{where} has units code {code}, which stands for factors {1 / unit[0]:g} of length and {1 / unit[1]:g} of"
                f" force, but states {length:g} and {force:g}; correct one of them (code 9 is for other units)"
            )
    return UnitFactors(length, force)
