"""Nastran bulk data cards as tables of fields, with the files that INCLUDE brings in."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.bulk_lines import BulkLines, bulk_lines
from structid.fem.importers.fixed_fields import FieldError, chunks, is_blank, real_numbers, whole_numbers
from structid.files import require_readable

_INCLUDE = re.compile(rb"^\s*INCLUDE\s+(?:'([^']*)'|\"([^\"]*)\"|(\S+))", re.IGNORECASE | re.DOTALL)
_REMEDY = "a bulk data file goes from BEGIN BULK to ENDDATA; export it again, or add the two lines"
_MOST_INCLUDES = 20


def bulk_text(path: Path) -> bytes:
    """The bulk data of a file, included files in their places; lines before BEGIN BULK are blank.

    Raises
    ------
    FileError
        If bulk data do not begin or end, or an included file cannot be read.
    """
    lines = path.read_bytes().replace(b"\r\n", b"\n").split(b"\n")
    found, begun, ended = [], False, False
    for line in _expanded(path, lines, 0):
        word = line.strip().upper()
        if begun and word.startswith(b"ENDDATA"):
            ended = True
            break
        found.append(line if begun else b"")
        begun = begun or re.match(rb"BEGIN\s+(BULK|SUPER)", word) is not None
    if not begun or not ended:
        missing = "BEGIN BULK" if not begun else "ENDDATA"
        raise FileError(f"{path}: is no whole bulk data file, or was cut short: there is no {missing}; {_REMEDY}")
    return b"\n".join(found)


def _expanded(path: Path, lines: list[bytes], depth: int) -> list[bytes]:
    """Lines with those of included files in the place of INCLUDE."""
    if depth > _MOST_INCLUDES:
        raise FileError(f"{path}: includes itself, or more than {_MOST_INCLUDES} files in one another; write one file")
    found: list[bytes] = []
    at = 0
    while at < len(lines):
        if lines[at].lstrip()[:7].upper() != b"INCLUDE":
            found.append(lines[at])
            at += 1
            continue
        text, last = lines[at].rstrip(), at
        while text.count(b"'") % 2 and last + 1 < len(lines):  # a name may run over several lines
            last += 1
            text += lines[last].strip()
        match = _INCLUDE.match(text)
        name = next((g for g in match.groups() if g), b"").decode("latin-1") if match else ""
        try:
            place = require_readable(path.parent / name.strip().replace("\\", "/"))
        except FileError as error:
            raise FileError(f"{path}, line {at + 1}: the included file cannot be read ({error})") from error
        found += _expanded(place, place.read_bytes().replace(b"\r\n", b"\n").split(b"\n"), depth + 1)
        at = last + 1
    return found


@dataclass(frozen=True, eq=False)
class Cards:
    """All cards of one name.

    Attributes
    ----------
    lines : BulkLines
    first : (n_cards,) int array
        Line where each begins.
    fields : (n_cards, n_fields, width) uint8 array
        Data fields, from the first behind the name.
    """

    lines: BulkLines
    first: IntArray
    fields: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    def integers(self, place: int) -> IntArray:
        """The whole numbers in one field; 0 where blank."""
        return self._converted(place, whole_numbers, "a whole number").astype(np.int64)

    def reals(self, place: int) -> FloatArray:
        """The real numbers in one field; 0 where blank."""
        return self._converted(place, real_numbers, "a real number")

    def is_blank(self, place: int) -> np.ndarray:
        return np.ones(len(self), dtype=bool) if place >= self.fields.shape[1] else is_blank(self.fields[:, place])

    def words(self, place: int) -> list[str]:
        """The text of one field."""
        return [bytes(field).decode("latin-1").strip() for field in self.fields[:, place]]

    def _converted(self, place: int, convert: Callable[[np.ndarray], np.ndarray], wanted: str) -> np.ndarray:
        if place >= self.fields.shape[1]:
            return np.zeros(len(self))
        try:
            return convert(self.fields[:, place])
        except FieldError as error:
            raise self.lines.error(int(self.first[error.index]), f"field {place + 2}", error.text, wanted) from None


def cards_of(path: Path, content: bytes, names: tuple[str, ...]) -> dict[str, Cards]:
    """The cards of each of `names` that the text has."""
    lines = bulk_lines(path, names, content, whole_lines=True)
    if not len(lines.start):
        return {}
    own = np.arange(len(lines.start))
    heads = own[lines.card == own]
    name_of = np.array([w.decode("latin-1").rstrip("*# ") for w in lines.words(heads, 0, 8).tolist()])
    count = np.where(lines.width == 8, 8, 4)
    before = np.cumsum(count) - count
    offset = before - before[lines.card]
    found = {}
    for name in dict.fromkeys(name_of.tolist()):
        first = heads[name_of == name]
        rows = own[np.isin(lines.card, first)]
        card = np.searchsorted(first, lines.card[rows])
        size = int((offset[rows] + count[rows]).max())
        fields = np.full((len(first), size, 24), ord(" "), dtype=np.uint8)
        for width, each in ((8, 8), (16, 4), (24, 4)):
            same = np.flatnonzero(lines.width[rows] == width)
            for part in chunks(len(same)):
                at = same[part]
                text = lines.take(rows[at], 8, each * width).reshape(len(at), each, width)
                place = offset[rows[at]][:, None] + np.arange(each)
                fields[card[at][:, None], place, :width] = text
        found[name] = Cards(lines, first, fields)
    return found
