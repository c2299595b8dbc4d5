"""Where tables, keys and values stand in a TOML text, by letter: so that an edit touches nothing else."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field

from structid.study.schema.toml_lines import WORD

#: Names of tables and keys, and positions in arrays of tables.
KeyPath = tuple[str | int, ...]
_Words = list[tuple[str, int]]


@dataclass(frozen=True)
class Place:
    """A key and its value: begin of its line, begin and end of the value, and where the next line begins."""

    start: int
    value: int
    end: int
    line_end: int


@dataclass
class Block:
    """A header and the keys under it; the first block, without a path, has the keys above all headers.

    `start` is where the line of the header begins, `own_end` where the line after the last of its keys begins.
    """

    path: KeyPath
    start: int
    own_end: int
    pairs: dict[KeyPath, Place] = field(default_factory=dict)


def blocks_of(text: str) -> list[Block]:
    """The blocks of a valid TOML text, in order."""
    words = [(found[0], found.start()) for found in WORD.finditer(text) if found[0][0] not in " \t#\n"]
    words.reverse()  # a stack: the next word is the last
    blocks = [Block((), 0, 0)]
    counts: dict[KeyPath, int] = {}
    while words:
        if words[-1][0] == "[" and _begins_line(text, words[-1][1]):
            blocks.append(_header(text, words, counts))
        else:
            _pair(text, words, blocks[-1])
    return blocks


def _begins_line(text: str, at: int) -> bool:
    return not text[text.rfind("\n", 0, at) + 1 : at].strip()


def _after_line(text: str, at: int) -> int:
    end = text.find("\n", at)
    return len(text) if end < 0 else end + 1


def _part(word: str) -> list[str]:
    if word[0] in "\"'":
        return list(tomllib.loads(f"{word} = 0"))
    return [] if word == "." else [word]


def _header(text: str, words: _Words, counts: dict[KeyPath, int]) -> Block:
    start = words.pop()[1]
    is_array = words[-1][0] == "["
    if is_array:
        words.pop()
    parts: list[str] = []
    while (word := words.pop()[0]) != "]":
        parts += _part(word)
    end = words.pop()[1] if is_array else start
    path: KeyPath = ()
    for number, part in enumerate(parts):
        path = (*path, part)
        if is_array and number == len(parts) - 1:
            counts[path] = counts.get(path, 0) + 1
        if path in counts:
            path = (*path, counts[path] - 1)
    line_start = text.rfind("\n", 0, start) + 1
    return Block(path, line_start, _after_line(text, max(end, start)))


def _pair(text: str, words: _Words, block: Block) -> None:
    start, parts = words[-1][1], list[str]()
    while (word := words.pop()[0]) != "=":
        parts += _part(word)
    begin = words[-1][1]
    end = _value_end(words)
    line_start = text.rfind("\n", 0, start) + 1
    block.pairs[tuple(parts)] = Place(line_start, begin, end, _after_line(text, end))
    block.own_end = _after_line(text, end)


def _value_end(words: _Words) -> int:
    """The end of the value that comes next, which is taken off; a number may be of several words, as in 1.5e-3."""
    word, at = words.pop()
    end = at + len(word)
    if word in ("[", "{"):
        depth = 1
        while depth:
            word, at = words.pop()
            depth += (word in "[{") - (word in "]}")
            end = at + len(word)
        return end
    while words and words[-1][1] == end and words[-1][0] not in "[]{},=":
        word, at = words.pop()
        end = at + len(word)
    return end
