"""Cards of Nastran and keywords of Abaqus in the text of a deck, with the characters where each field stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from structid.errors import InputError
from structid.structure.meshes.abaqus_keywords import keyword_options

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


def _lines(text: str) -> Iterator[tuple[int, int, str]]:
    """Number, first character and text of every line."""
    start = 0
    for number, line in enumerate(text.split("\n"), 1):
        yield number, start, line.removesuffix("\r")
        start += len(line) + 1


@dataclass(frozen=True, eq=False)
class Card:
    """A card of bulk data, with its fields by number."""

    file: str
    line: int
    name: str
    fields: dict[int, Field]

    @property
    def first(self) -> str:
        """What field 2 holds."""
        return self.fields[2].text.upper() if 2 in self.fields else ""

    @property
    def said(self) -> str:
        """As messages name it."""
        return f"{self.name} {self.first} (line {self.line})"


def cards_in(file: str, text: str, name: str) -> Iterator[Card]:
    """The cards of bulk data that are called `name`; an `InputError` where tabs move their columns."""
    card: Card | None = None
    row, half, is_open = 0, 0, False
    for number, start, whole in _lines(text):
        line = whole.partition("$")[0]
        if not line.strip():
            continue
        is_free = "," in line
        head = line.partition(",")[0] if is_free else line[:_SMALL]
        is_large = "*" in head
        if head[:1].isalpha():
            if card is not None:
                yield card
            own = head.replace("*", " ").split()[0].upper()
            card, row, half = Card(file, number, name, {}) if own == name else None, 0, 0
        elif is_large and is_open:
            half = 1
        else:
            row, half = row + ROW, 0
        is_open = is_large and half == 0
        if card is None:
            continue
        if "\t" in line and not is_free:
            raise InputError(f"{file}, line {number}: tabs move the columns of this {name}; write blanks")
        first = row + 2 + 4 * half
        n_fields, width = (4, 2 * _SMALL) if is_large else (8, _SMALL)
        at = start + (len(head) + 1 if is_free else _SMALL)
        entries = line.split(",")[1:] if is_free else ()
        for k in range(n_fields):
            if is_free:
                if k == len(entries):
                    break
                size = len(entries[k])
                item = entries[k].strip()
                card.fields[first + k] = Field(number, at, at + size, max(width, len(item)), item, whole)
                at += size + 1
            else:
                end = min(at + width, start + len(line))
                if at >= end:
                    break
                card.fields[first + k] = Field(number, at, end, width, text[at:end].strip(), whole)
                at += width
    if card is not None:
        yield card


@dataclass(frozen=True, eq=False)
class Keyword:
    """A keyword with its options, and its data lines: number, first character and text."""

    file: str
    line: int
    name: str
    options: dict[str, str]
    data: list[tuple[int, int, str]]

    def is_called(self, words: str, with_options: bool = True) -> bool:
        """Whether it is this keyword, with these options."""
        name, options = called(words)
        known = {key: value.upper() for key, value in self.options.items()}
        return self.name == name and (
            not with_options or all(known.get(key) == value.upper() for key, value in options.items())
        )


def called(words: str) -> tuple[str, dict[str, str]]:
    """Name and options of a keyword line."""
    name, *options = words.split(",")
    return " ".join(name.replace("*", " ").upper().split()), keyword_options(options)


def keywords_in(file: str, text: str) -> Iterator[Keyword]:
    """All keywords of an input file of Abaqus or CalculiX; lines that go on behind a comma are joined, comments left out."""
    found: Keyword | None = None
    begun, pending = 1, ""
    for number, start, line in _lines(text):
        bare = line.strip()
        if not bare or bare.startswith("**"):
            continue
        if pending or bare.startswith("*"):
            if not pending and found is not None:
                yield found
            begun = begun if pending else number
            pending += bare
            found = Keyword(file, begun, *called(pending), [])
            pending = pending if bare.endswith(",") else ""
        elif found is not None:
            found.data.append((number, start, line))
    if found is not None:
        yield found
