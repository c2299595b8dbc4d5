"""Where tables, keys and values stand in a TOML text, by letter: so that an edit touches nothing else."""

from __future__ import annotations

from dataclasses import dataclass, field

from structid.study.schema.toml_lines import KeyPath, Words, header, key, words_of


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
    """Tables of a valid TOML text in order, each with the places of its keys and values."""
    words = words_of(text, " \t#\n")
    blocks = [Block((), 0, 0)]
    counts: dict[KeyPath, int] = {}
    while words:
        if words[-1][0] == "[" and _begins_line(text, words[-1][1]):
            start = words[-1][1]
            path = header(words, counts, {})
            blocks.append(Block(path, text.rfind("\n", 0, start) + 1, _after_line(text, start)))
        else:
            _pair(text, words, blocks[-1])
    return blocks


def _begins_line(text: str, at: int) -> bool:
    return not text[text.rfind("\n", 0, at) + 1 : at].strip()


def _after_line(text: str, at: int) -> int:
    end = text.find("\n", at)
    return len(text) if end < 0 else end + 1


def _pair(text: str, words: Words, block: Block) -> None:
    """Add the key at the head of `words` with the places of its value in `text` to `block`."""
    parts, start = key(words, "=")
    begin = words[-1][1]
    end = _value_end(words)
    line_start = text.rfind("\n", 0, start) + 1
    block.pairs[tuple(parts)] = Place(line_start, begin, end, _after_line(text, end))
    block.own_end = _after_line(text, end)


def _value_end(words: Words) -> int:
    """Index of the end of the next value, whose words are removed from `words`."""
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
