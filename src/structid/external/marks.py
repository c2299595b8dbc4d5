"""Numbers of a deck marked by where they stand: field of a Nastran card, or entry of a data line of a keyword of Abaqus.

They become marks ``{{name}}`` in the text, as if the user had written these; see `Deck`. Cards and keywords are found in the
text of a deck with the characters where each field stands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, NamedTuple, Protocol

from structid.core.constraints import Count, Limits
from structid.core.errors import InputError
from structid.fem.meshes.abaqus_keywords import keyword_options

#: Columns of a small field; a large one has two. Continuations begin the fields 12, 22, ... of a card.
_SMALL, ROW = 8, 10
_NUMBER = re.compile(r"([-+]?(?:\d+(?:\.\d*)?|\.\d+))(?:[EDed]([-+]?\d+)|([-+]\d+))?")
_MOST_NAMED = 8
_LISTED = "files that it includes must be listed in `deck` too"


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


@dataclass(frozen=True)
class DeckPosition:
    """Position of a number in a deck: file, line and characters.

    Attributes
    ----------
    file, line : str, int
    start, end : int
        Characters of the file that the mark takes the place of.
    width : int, optional
        Characters that a number may have, where they are fewer than `WIDTH` or must stay.
    value : float
    """

    file: str
    line: int
    start: int
    end: int
    width: int | None
    value: float


class DeckMark(Protocol):
    """Mark of a parameter: how its number is found in a deck."""

    def locate(self, texts: Mapping[str, str]) -> DeckPosition:
        """The one position in the files of a deck; an `InputError` where there is none, or more than one."""
        ...


@dataclass(frozen=True)
class CardField:
    """A field of a Nastran card in small, large or free field.

    Parameters
    ----------
    card : str
        Name of the card, such as ``MAT1``.
    field : int
        As the manual counts: 1 is the name, 2 to 9 stand on the first line, 12 to 19 on the next.
    id : int or str, optional
        Content of field 2, such as the number of the material; not needed where only one card has the name.
    """

    card: str
    field: Annotated[int, Limits(least=2)]
    id: int | str | None = None

    @property
    def _name(self) -> str:
        return self.card.strip().upper().rstrip("*")

    @property
    def words(self) -> str:
        return self._name + ("" if self.id is None else f" {self.id}")

    def locate(self, texts: Mapping[str, str]) -> DeckPosition:
        """Position of the number of this field in the deck `texts`, which maps file names to contents, and its value.

        `InputError` unless exactly one card matches and its field holds a real number, with a decimal point.
        """
        if self.field % ROW in (0, 1):
            raise InputError(
                f"field {self.field} of a card holds no number; fields are counted as in the manual, 2 to 9 on the first line,"
                " 12 to 19 on the next"
            )
        cards = [card_there for file, text in texts.items() for card_there in cards_in(file, text, self._name)]
        matching = [card_there for card_there in cards if self.id is None or card_there.first == str(self.id).upper()]
        if not matching:
            others = (
                f"; there are {', '.join(card_there.said for card_there in cards[:_MOST_NAMED])}"
                if cards
                else f"; {_LISTED}"
            )
            raise InputError(f"{', '.join(texts)}: there is no card {self.words}{others}")
        if len(matching) > 1:
            remedy = "give `id`, what its field 2 holds" if self.id is None else "leave one"
            raise InputError(f"the card {self.words} stands {len(matching)} times: {_lines_of(matching)}; {remedy}")
        [card] = matching
        where = f"{card.file}, line {card.line}: field {self.field} of {self.words}"
        if self.field not in card.fields:
            raise InputError(
                f"{where} is not there, the card ends before it; write the number there, or correct `field`"
            )
        field = card.fields[self.field]
        where = f"{card.file}, line {field.line}: field {self.field} of {self.words}"
        if "{{" in field.whole and "," not in field.whole:
            raise InputError(
                f"{where}: marks in braces move the columns of its line; mark all of the line by card and field"
            )
        value = _parse_number(where, field.text)
        if "." not in field.text:
            raise InputError(f"{where} holds the whole number {field.text}, a parameter is a real one; correct `field`")
        return DeckPosition(card.file, field.line, field.start, field.end, field.width, value)


@dataclass(frozen=True)
class KeywordEntry:
    """An entry of a data line below a keyword of Abaqus or CalculiX.

    Parameters
    ----------
    keyword : str
        With as many of its options as tell it from others, such as ``*SHELL SECTION, ELSET=WEB``.
    entry : int
        On the data line, from 1.
    line : int
        Data line below the keyword, from 1; comments are not counted.
    of : str, optional
        The keyword above that it belongs to, such as ``*MATERIAL, NAME=STEEL``.
    """

    keyword: str
    entry: Count
    line: Count = 1
    of: str | None = None

    @property
    def words(self) -> str:
        return self.keyword + ("" if self.of is None else f" of {self.of}")

    def locate(self, texts: Mapping[str, str]) -> DeckPosition:
        """Position of the number of this entry in the deck `texts`, which maps file names to contents, and its value.

        `InputError` unless exactly one keyword matches and the entry of its data line holds a number.
        """
        matching: list[Keyword] = []
        same_name: list[Keyword] = []
        for file, text in texts.items():
            above: dict[str, Keyword] = {}
            for block in keywords_in(file, text):
                above[block.name] = block
                if not block.is_called(self.keyword, with_options=False):
                    continue
                parent = None if self.of is None else above.get(parse_keyword_line(self.of)[0])
                same_name.append(block)
                if block.is_called(self.keyword) and (
                    self.of is None or (parent is not None and parent.is_called(self.of))
                ):
                    matching.append(block)
        if not matching:
            others = (
                f"; {parse_keyword_line(self.keyword)[0]} stands in {_lines_of(same_name)}"
                if same_name
                else f"; {_LISTED}"
            )
            raise InputError(f"{', '.join(texts)}: there is no {self.words}{others}")
        if len(matching) > 1:
            raise InputError(
                f"{self.words} stands {len(matching)} times: {_lines_of(matching)}; say which by an option of it, or by `of`, as in"
                ' "*MATERIAL, NAME=STEEL"'
            )
        [block] = matching
        where = f"{block.file}, line {block.line}: {self.words}"
        if self.line > len(block.data):
            raise InputError(f"{where} has {len(block.data)} data lines, no line {self.line}; correct `line`")
        line, start, text = block.data[self.line - 1]
        entries = text.split(",")
        if self.entry > len(entries):
            raise InputError(
                f"{block.file}, line {line}: the data line of {self.words} has {len(entries)} entries, no entry {self.entry};"
                " correct `entry`"
            )
        start += sum(len(entry) + 1 for entry in entries[: self.entry - 1])
        whole = entries[self.entry - 1]
        start += len(whole) - len(whole.lstrip())
        value = _parse_number(f"{block.file}, line {line}: entry {self.entry} of {self.words}", whole.strip())
        return DeckPosition(block.file, line, start, start + len(whole.strip()), None, value)


def with_marks(texts: Mapping[str, str], positions: Sequence[tuple[str, DeckPosition]]) -> dict[str, str]:
    """The files of a deck with marks ``{{name}}`` in place of the numbers at `positions`; of fixed fields ``{{name:width}}``.

    Parameters
    ----------
    texts : mapping of str to str
        Content by file name.
    positions : sequence of (str, DeckPosition)
        Name of a parameter and the position of its number; a name may occur several times.

    Raises
    ------
    InputError
        If two positions are the same number.
    """
    made, names = dict(texts), dict[tuple[str, int], str]()
    for name, position in sorted(positions, key=lambda pair: (pair[1].file, pair[1].start), reverse=True):
        other = names.setdefault((position.file, position.start), name)
        if made[position.file][position.start :].startswith("{{"):
            raise InputError(
                f"{position.file}, line {position.line}: {other!r} and {name!r} are the same number; take one out"
            )
        mark = f"{{{{{name}}}}}" if position.width is None else f"{{{{{name}:{position.width}}}}}"
        made[position.file] = made[position.file][: position.start] + mark + made[position.file][position.end :]
    return made


def value_at(name: str, positions: Sequence[DeckPosition]) -> float:
    """Value that the deck holds for the parameter `name`: that at the first of its `positions`.

    `InputError` if the numbers at these positions differ by more than 1e-6 of their size.
    """
    first = positions[0]
    for position in positions:
        if not math.isclose(first.value, position.value, rel_tol=1e-6):
            raise InputError(
                f"{position.file}, line {position.line}: {name!r} is {position.value:g} here and {first.value:g} in {first.file},"
                f" line {first.line}; give `value`, or make two parameters"
            )
    return first.value


def _parse_number(where: str, text: str) -> float:
    """The number in a field, in the notation of Nastran, Abaqus and CalculiX, also 2.1+11 and 2.1D11.

    `where` begins the `InputError` for a mark, a blank or any other text.
    """
    if text.startswith("{{"):
        raise InputError(f"{where} is marked by {text}; take this out, or `mark`")
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise InputError(
            f"{where} holds no number, but {text!r}; correct the place"
            if text
            else f"{where} is blank; write the number there"
        )
    return float(f"{match[1]}e{match[2] or match[3] or 0}")


def _lines_of(cards: Sequence[Card] | Sequence[Keyword]) -> str:
    return ", ".join(f"{card.file} line {card.line}" for card in cards[:_MOST_NAMED])
