"""Nastran bulk data as table rows: small, large and free field, continuations, comments, tabs, any case.

Fixed fields are read where they stand. Lines in free field are rewritten with four fields of 24 characters a line, so
that what follows is one table whatever the form of the file. What stands behind column 72 (continuation marks, sequence
numbers of punch files) is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import IntArray
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import (
    Bytes,
    FieldError,
    as_real,
    chunks,
    fields_at,
    real_numbers,
    whole_numbers,
)

_WIDE = 24
_MARKS = np.array([ord(c) for c in " +*\r\n\t"], dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Origins:
    """The file and the line that each line of a text comes from.

    Attributes
    ----------
    paths : tuple of Path
    file : (n_lines,) int array
        Index into `paths`.
    number : (n_lines,) int array
        From 1.
    """

    paths: tuple[Path, ...]
    file: IntArray
    number: IntArray


@dataclass(frozen=True, eq=False)
class BulkLines:
    """The lines of bulk data cards of some names.

    Attributes
    ----------
    path : Path
    buffer : (n_characters,) uint8 array
        The text, upper case, tabs expanded; free fields rewritten in wide ones.
    start, end : (n_lines,) int arrays
        Where each line begins and ends in `buffer`.
    number : (n_lines,) int array
        Its number in the file, from 1.
    width : (n_lines,) int array
        Columns of a field: 8 (eight fields a line), 16 (large field, four a line) or 24 (was free field, four a line).
    card : (n_lines,) int array
        Line (as an index) where the card begins that it continues; its own where it begins one.
    origins : Origins, optional
        Where the lines come from, where the text was put together of files.
    """

    path: Path
    buffer: Bytes
    start: IntArray
    end: IntArray
    number: IntArray
    width: IntArray
    card: IntArray
    origins: Origins | None = None

    def take(self, lines: IntArray, column: IntArray | int, width: IntArray | int) -> Bytes:
        """Characters from `column` (from 0) on of each of `lines` (indices), (n, width) uint8; blanks behind its end.

        Where widths differ, the table is as wide as the widest, and at least eight.
        """
        start = self.start[lines] + column
        end = np.minimum(self.end[lines], start + width)
        return fields_at(self.buffer, start, end, int(np.max(width, initial=8)))

    def integers(self, lines: IntArray, column: IntArray | int, width: IntArray | int, what: str) -> IntArray:
        """Whole numbers (n,) in the field of `width` characters at `column` (from 0) of each of `lines`; 0 where blank.

        `lines` are indices. Raises `FileError`, which names the field `what` and the line, if it is no whole number.
        """
        values = np.zeros(len(lines), dtype=np.int64)
        for part in chunks(len(lines)):
            try:
                values[part] = whole_numbers(self.take(lines[part], _part(column, part), _part(width, part)))
            except FieldError as error:
                raise self.error(int(lines[part.start + error.index]), what, error.text, "a whole number") from None
        return values

    def reals(self, lines: IntArray, column: IntArray | int, width: IntArray | int, what: str) -> np.ndarray:
        """Real numbers (n,) in the field of `width` characters at `column` (from 0) of each of `lines`; 0 where blank.

        `lines` are indices. Raises `FileError`, which names the field `what` and the line, if it is no number.
        """
        values = np.zeros(len(lines))
        for part in chunks(len(lines)):
            try:
                values[part] = real_numbers(self.take(lines[part], _part(column, part), _part(width, part)))
            except FieldError as error:
                raise self.error(int(lines[part.start + error.index]), what, error.text, "a real number") from None
        return values

    def words(self, lines: IntArray, column: int, width: IntArray | int) -> NDArray[np.bytes_]:
        """The text in one field of each of `lines`, without blanks around it."""
        fields = self.take(lines, column, width)
        return np.char.strip(np.ascontiguousarray(fields).view(f"S{fields.shape[1]}").ravel())

    def error(self, line: int, what: str, text: str, wanted: str) -> FileError:
        """The error at a field of a line (as an index)."""
        return FileError(
            f"{self.location(line)}: {what} must be {wanted}, got {text!r}; correct the line or write "
            "the file again (a line cut short shifts its fields)"
        )

    def location(self, line: int) -> str:
        """File and line number, as text, of the line with index `line`; of an included file if the line is of one."""
        number = int(self.number[line])
        if self.origins is None:
            return f"{self.path}, line {number}"
        return f"{self.origins.paths[self.origins.file[number - 1]]}, line {self.origins.number[number - 1]}"


def _part(given: IntArray | int, part: slice) -> IntArray | int:
    return given if isinstance(given, int) else given[part]


def bulk_lines(
    path: Path,
    names: tuple[str, ...],
    content: bytes | None = None,
    whole_lines: bool = False,
    origins: Origins | None = None,
) -> BulkLines:
    """The lines of the cards called `names` in the file at `path`; comments and all other cards are left out.

    Parameters
    ----------
    path : Path
    names : tuple of str
        In capitals.
    content : bytes, optional
        Text to take instead of that of the file.
    whole_lines : bool
        True if a free-field line always becomes two lines of four fields, so that fields keep their column in a card.
    origins : Origins, optional
        File and line number that each line of `content` comes from.

    Raises
    ------
    FileError
        If a continuation line does not follow the line that it continues.
    """
    content = (path.read_bytes() if content is None else content).upper()
    if b"\t" in content:
        content = b"\n".join(line.expandtabs(8) for line in content.split(b"\n"))
    buffer, start, end, number = _split_lines(content)
    free = _with_comma(buffer, start, end)
    if free.any():
        content, number = _widen_free_lines(content, free, number, whole_lines)
        buffer, start, end, _ = _split_lines(content)
    return _select_cards(path, buffer, start, end, number, names, origins)


def _split_lines(content: bytes) -> tuple[Bytes, IntArray, IntArray, IntArray]:
    """The bytes of `content`, first and last byte (exclusive) of each line without its comment, and line numbers.

    Numbers count from 1. All but the bytes are (n_lines,). A comment begins with $.
    """
    buffer = np.frombuffer(content, dtype=np.uint8)
    ends = np.flatnonzero(buffer == ord("\n"))
    if not len(ends) or ends[-1] != len(buffer) - 1:
        ends = np.append(ends, len(buffer))
    start = np.concatenate([[0], ends[:-1] + 1])
    end = ends.copy()
    dollars = np.flatnonzero(buffer == ord("$"))
    if dollars.size:
        line, first = np.unique(np.searchsorted(ends, dollars), return_index=True)
        end[line] = dollars[first]
    return buffer, start, end, np.arange(1, len(start) + 1)


def _with_comma(buffer: Bytes, start: IntArray, end: IntArray) -> NDArray[np.bool_]:
    commas = np.flatnonzero(buffer == ord(","))
    return np.asarray(np.searchsorted(commas, end) > np.searchsorted(commas, start))


def _widen_free_lines(
    content: bytes, free: NDArray[np.bool_], number: IntArray, whole_lines: bool
) -> tuple[bytes, IntArray]:
    """Text in which free-field lines are rewritten in wide fixed fields, and the source line number of each line.

    `free` (n_lines,) marks such lines and `number` has their numbers; `whole_lines` gives each of them two lines of
    four fields.
    """
    lines, numbers = [], []
    for line, is_free, source in zip(content.split(b"\n"), free.tolist(), number.tolist(), strict=False):
        for text in _widen_line(line, whole_lines) if is_free else (line,):
            lines.append(text)
            numbers.append(source)
    return b"\n".join(lines), np.array(numbers)


def _widen_line(line: bytes, whole: bool) -> list[bytes]:
    """A free-field line as lines with four fixed fields each, 24 characters wide, and its comment removed.

    With `whole`, a line of eight fields always makes two lines, blank or not; else blank continuation lines are left
    out. Fields beyond the eighth (the fourth of a large-field line) make further continuation lines.
    """
    fields = [field.strip() for field in line.split(b"$")[0].split(b",")]
    is_large = b"*" in fields[0]
    name, most = fields[0].rstrip(b"*"), 4 if is_large else 8
    values = fields[1:] if any(fields[most + 2 :]) else fields[1 : most + 1]  # a longer line goes on without marks
    is_start = name[:1].isalpha()
    whole = whole and not is_large
    wide_lines = []
    for i in range(0, -(-len(values) // 8) * 8 or 8 if whole else max(len(values), 1), 4):
        head = name if is_start and i == 0 else b"*"
        group = values[i : i + 4]
        if i == 0 or whole or any(group):
            wide_lines.append(head[:7].ljust(7) + b"#" + b"".join(_fit_field(value).ljust(_WIDE) for value in group))
    return wide_lines


def _fit_field(value: bytes) -> bytes:
    """The field `value` in at most 24 characters: a longer number rounded to a float's digits, other text cut."""
    if len(value) <= _WIDE:
        return value
    try:
        return repr(as_real(value)).upper().encode()
    except FieldError:
        return value[:_WIDE]


def _select_cards(
    path: Path,
    buffer: Bytes,
    start: IntArray,
    end: IntArray,
    number: IntArray,
    names: tuple[str, ...],
    origins: Origins | None,
) -> BulkLines:
    """The lines of the cards called `names`, with the index of the line at which the card of each begins.

    `start` and `end` are the first and last byte (exclusive) of each line in `buffer`, `number` its line number,
    `origins` the file of each line, or None if all are of `path`. Raises `FileError` if a continuation line is out of
    order.
    """
    head = np.concatenate([fields_at(buffer, start[part], end[part], 8) for part in chunks(len(start))])
    blank_line = (head <= ord(" ")).all(axis=1) & (end - start <= 8)
    blank_line |= end <= start
    is_start = ~np.isin(head[:, 0], _MARKS) & ~blank_line
    width = np.where(head[:, 7] == ord("#"), _WIDE, np.where((head == ord("*")).any(axis=1), 16, 8))
    card = np.maximum.accumulate(np.where(is_start, np.arange(len(start)), -1))
    words = np.ascontiguousarray(
        np.where((head == ord("*")) | (head == ord("#")) | (head < ord(" ")), np.uint8(ord(" ")), head)
    )
    name = np.char.strip(words.view("S8").ravel())
    wanted = np.isin(name, [word.encode() for word in names]) & is_start
    every_line = BulkLines(path, buffer, start, end, number, width, np.maximum(card, 0), origins)
    _require_marks_behind(every_line, np.flatnonzero(~blank_line), ~is_start & (head[:, 1:] > ord(" ")).any(axis=1))
    keep = np.flatnonzero((card >= 0) & wanted[np.maximum(card, 0)] & ~blank_line)
    card_index = np.searchsorted(keep, card[keep])
    lines = BulkLines(path, buffer, start[keep], end[keep], number[keep], width[keep], card_index, origins)
    _require_order(lines)
    return lines


def _require_marks_behind(lines: BulkLines, filled: IntArray, marked: NDArray[np.bool_]) -> None:
    """Raise `FileError` if a continuation line stands behind a line without its mark, and another ends in it.

    `filled` are the lines (indices) that are not blank, `marked` (n_lines,) those that go on and say by a mark with
    what. Lines in free field are passed over.
    """
    follows = np.flatnonzero(marked[filled] & (lines.width[filled] != _WIDE))
    follows = follows[follows > 0]
    rows, before = filled[follows], filled[follows - 1]
    marks = lines.words(rows, 1, 7)
    alone = (marks != b"") & (lines.words(before, 73, 7) != marks)
    if not alone.any():
        return
    ends = filled[lines.width[filled] != _WIDE]
    open_marks: set[bytes] = set()
    for part in chunks(len(ends)):
        open_marks.update(lines.words(ends[part], 73, 7).tolist())
    for row, mark in zip(rows[alone].tolist(), marks[alone].tolist(), strict=True):
        if mark in open_marks:
            raise FileError(
                f"{lines.location(row)}: goes on with mark {mark.decode('latin-1')!r}, in which the line before does not end, but"
                " another; put each line behind the one that it continues"
            )


def _require_order(lines: BulkLines) -> None:
    """Raise `FileError` if a continuation line begins with another mark than the line before it ends in.

    Lines in free field, and lines without a mark, are passed over.
    """
    all_lines = np.arange(len(lines.start))
    follows = all_lines[(lines.card != all_lines) & (lines.width != _WIDE)]
    follows = follows[lines.width[follows - 1] != _WIDE]
    for part in chunks(len(follows)):
        rows = follows[part]
        marks, before = lines.words(rows, 1, 7), lines.words(rows - 1, 73, 7)  # the first character is free
        wrong = (marks != b"") & (before != b"") & (marks != before)
        if wrong.any():
            row, mark, other = (of_lines[np.argmax(wrong)] for of_lines in (rows, marks, before))
            raise FileError(
                f"{lines.location(int(row))}: goes on with mark {mark.decode('latin-1')!r} where the line before ends in"
                f" {other.decode('latin-1')!r}; put each line behind the one that it continues"
            )
