"""Cards of Nastran and keywords of Abaqus in the text of a deck, with the characters where each field stands."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

from structid.core.errors import InputError
from structid.fem.meshes.abaqus_keywords import keyword_options

#: Columns of a small field; a large one has two. Continuations begin the fields 12, 22, ... of a card.
_SMALL, ROW = 8, 10


class Field(NamedTuple):
    """A field of a card.

    Attributes
    ----------
    line, start, end : int
        Line, first character, and that behind the last.
    width : int
        Characters that a number may have.
    text, whole : str
        What it holds, and its line.
    """

    line: int
    start: int
    end: int
    width: int
    text: str
    whole: str


#: A keyword with what is below it, comments too.
_KEYWORD = re.compile(r"^[ \t]*\*(?!\*).*(?:\n(?![ \t]*\*(?!\*)).*)*", re.MULTILINE)


def _matching_blocks(pattern: re.Pattern[str], text: str) -> Iterator[list[tuple[int, int, str]]]:
    """Lines of each match of `pattern` in `text`, as (line number from 1, index of its first character in `text`, line)."""
    number, n_before = 1, 0
    for match in pattern.finditer(text):
        number, n_before = number + text.count("\n", n_before, match.start()), match.start()
        start, lines = match.start(), []
        for line_number, line in enumerate(match[0].split("\n"), number):
            lines.append((line_number, start, line.removesuffix("\r")))
            start += len(line) + 1
        yield lines


@dataclass(frozen=True, eq=False)
class Card:
    """A card of bulk data, with its fields by number."""

    file: str
    line: int
    name: str
    fields: dict[int, Field]

    @property
    def first(self) -> str:
        """Text of field 2 in capitals, such as an identification number; "" without one."""
        return self.fields[2].text.upper() if 2 in self.fields else ""

    @property
    def said(self) -> str:
        """Name, first field and line of the card, for messages."""
        return f"{self.name} {self.first} (line {self.line})"


def cards_in(file: str, text: str, name: str) -> Iterator[Card]:
    """The bulk data cards called `name` in the Nastran deck `text`, in any case, with their fields by number.

    Fields are numbered as in the manual, 2 to 9 on the first line, 12 to 19 on the next; those that a card lacks are
    missing. `file` is named in errors. `InputError` if tabs move the columns of a card.
    """
    pattern = re.compile(rf"^{re.escape(name)}\b.*(?:\n(?![A-Z]).*)*", re.MULTILINE | re.IGNORECASE)
    for lines in _matching_blocks(pattern, text):
        fields: dict[int, Field] = {}
        row, half, is_open = -ROW, 0, False
        for number, start, whole in lines:
            line = whole.partition("$")[0]
            if not line.strip():
                continue
            is_free = "," in line
            if "\t" in line and not is_free:
                raise InputError(f"{file}, line {number}: tabs move the columns of this {name}; write blanks")
            is_large = "*" in (line.partition(",")[0] if is_free else line[:_SMALL])
            row, half = (row, 1) if is_large and is_open else (row + ROW, 0)
            is_open = is_large and half == 0
            n_fields, width = (4, 2 * _SMALL) if is_large else (8, _SMALL)
            for k, (offset, field_text) in enumerate(_split_fields(line, is_free, width)[:n_fields]):
                size = max(width, len(field_text.strip())) if is_free else width
                end = start + offset + len(field_text)
                fields[row + 2 + 4 * half + k] = Field(number, start + offset, end, size, field_text.strip(), whole)
        yield Card(file, lines[0][0], name, fields)


def _split_fields(line: str, is_free: bool, width: int) -> list[tuple[int, str]]:
    """Offset in the line and text of each field of a card after its name; a text keeps its blanks.

    `is_free` says that the card has commas between fields; else fields are `width` characters wide (8 or 16), in
    columns 9 to 72.
    """
    if not is_free:
        return [
            (start, line[start : start + width])
            for start in range(_SMALL, min(len(line), ROW * _SMALL - _SMALL), width)
        ]
    words = line.split(",")
    ends = accumulate(len(word) + 1 for word in words)
    return list(zip(ends, words[1:], strict=False))


@dataclass(frozen=True, eq=False)
class Keyword:
    """A keyword with its options, and its data lines: number, first character and text."""

    file: str
    line: int
    name: str
    options: dict[str, str]
    data: list[tuple[int, int, str]]

    def is_called(self, words: str, with_options: bool = True) -> bool:
        """True if the keyword has the name and all options in `words`, such as "*MATERIAL, NAME=STEEL".

        Without `with_options` the name alone counts; case does not matter.
        """
        name, options = parse_keyword_line(words)
        known = {key: value.upper() for key, value in self.options.items()}
        return self.name == name and (
            not with_options or all(known.get(key) == value.upper() for key, value in options.items())
        )


def parse_keyword_line(words: str) -> tuple[str, dict[str, str]]:
    """Name in capitals and options by name of a keyword line, such as "*MATERIAL, NAME=STEEL"."""
    name, *options = words.split(",")
    return " ".join(name.replace("*", " ").upper().split()), keyword_options(options)


def keywords_in(file: str, text: str) -> Iterator[Keyword]:
    """All keywords in the Abaqus or CalculiX input `text`, in order, with options and data lines.

    Comments are left out. Continued keyword lines are joined. `file` is the file's name, which each keyword keeps for
    messages.
    """
    for lines in _matching_blocks(_KEYWORD, text):
        lines_of_keyword = [line for line in lines if line[2].strip() and not line[2].lstrip().startswith("**")]
        words, data_lines = lines_of_keyword[0][2].strip(), lines_of_keyword[1:]
        while words.endswith(",") and data_lines:
            words, data_lines = words + data_lines[0][2].strip(), data_lines[1:]
        yield Keyword(file, lines_of_keyword[0][0], *parse_keyword_line(words), data_lines)
