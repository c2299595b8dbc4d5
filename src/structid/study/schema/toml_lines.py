"""Line of each key of a TOML text, which `tomllib` does not give."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from typing import Any

#: Names of tables and keys, and positions in arrays of tables.
KeyPath = tuple[str | int, ...]
#: Words with the place of their first letter.
TomlTokens = list[tuple[str, int]]

#: Texts, brackets, signs, line ends, comments, blanks and all other words of TOML.
WORD = re.compile(
    r'"""(?:\\[\s\S]|(?!""")[^\\])*"{3,5}'  # long texts may end with two quotes of their own
    r"|'''(?:(?!''')[\s\S])*'{3,5}"
    r'|"(?:\\.|[^"\\])*"'
    r"|'[^']*'"
    r"|[\[\]{},=.\n]|#[^\n]*|[ \t]+|[^\s\[\]{},=.#\"']+"
)
#: Parts of a dotted key at most; a study has five.
_MOST_PARTS = 32
_LONG_KEY = re.compile(rf"(?:\.[ \t]*(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*){{{_MOST_PARTS}}}")


def parse_toml(text: str) -> dict[str, Any]:
    """The content of a TOML text, after a check that its keys are short: `tomllib` takes memory with the square of their parts.

    Raises
    ------
    ValueError
        If it is no TOML (`tomllib.TOMLDecodeError`), or a key has too many parts or a number too many digits.
    RecursionError
        If values are nested too deep.
    """
    if _LONG_KEY.search(text):
        raise ValueError(f"a key has more than {_MOST_PARTS} parts")
    return tomllib.loads(text)


def toml_lines(text: str) -> dict[KeyPath, int]:
    """Line (from 1) of every key, table header and array entry of a valid TOML text.

    Parameters
    ----------
    text : str
        A text that `tomllib.loads` accepts; for another the result is not defined.

    Returns
    -------
    mapping of path to line
        A path is a tuple of table names and keys, and of positions (from 0) in arrays and arrays of tables.

    Examples
    --------
    >>> lines = toml_lines("a = 1\\n[[b]]\\n[[b]]\\n  c.d = [\\n 5,\\n 6]\\n")
    >>> lines["a",], lines["b", 1], lines["b", 1, "c", "d"], lines["b", 1, "c", "d", 1]
    (1, 3, 4, 6)
    """
    begin_of: dict[KeyPath, int] = {}
    text = text.replace("\r\n", "\n")
    tokens = words_of(text, " \t#")
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    while tokens:
        if tokens[-1][0] == "[":
            table = header(tokens, counts, begin_of)
        elif tokens[-1][0] == "\n":
            tokens.pop()
        else:
            _note_key_lines(tokens, begin_of, table)
    ends = [end.start() for end in re.finditer("\n", text)]
    return {path: bisect_left(ends, at) + 1 for path, at in begin_of.items()}


def words_of(text: str, passed_over: str) -> TomlTokens:
    """The tokens of a TOML text in reverse order, each with its index in the text, so that `pop` takes the next.

    Tokens that begin with a character of `passed_over` are left out.
    """
    tokens = [(match[0], match.start()) for match in WORD.finditer(text) if match[0][0] not in passed_over]
    return tokens[::-1]  # the next word is the last


def read_key(tokens: TomlTokens, end: str) -> tuple[list[str], int]:
    """The parts of a dotted key up to the token `end`, and the index in the text where the key begins.

    `tokens` are words with their indices, the next one last; the key and `end` are removed from them.
    """
    parts: list[str] = []
    line = tokens[-1][1]
    while (token := tokens.pop()[0]) != end:
        if token[0] in "\"'":
            parts += tomllib.loads(f"{token} = 0")
        elif token != ".":
            parts.append(token)
    return parts, line


def header(tokens: TomlTokens, counts: dict[KeyPath, int], lines: dict[KeyPath, int]) -> KeyPath:
    """Path of the header ``[a.b]`` or ``[[a.b]]`` at the head of `tokens`, with positions (from 0) in arrays of tables.

    Its words are removed from `tokens`. `counts` holds the present length of each array and is updated. The index in
    the text where the path begins is noted in `lines` for each table on the way that is not there yet.
    """
    tokens.pop()
    is_array = tokens[-1][0] == "["
    if is_array:
        tokens.pop()
    parts, line = read_key(tokens, "]")
    if is_array:
        tokens.pop()
    path: KeyPath = ()
    for i, part in enumerate(parts):
        path = (*path, part)
        lines.setdefault(path, line)
        if is_array and i == len(parts) - 1:
            counts[path] = counts.get(path, 0) + 1
        if path in counts:
            path = (*path, counts[path] - 1)
            lines.setdefault(path, line)
    return path


def _note_key_lines(tokens: TomlTokens, lines: dict[KeyPath, int], path: KeyPath) -> None:
    """Note where ``key = value`` under `path` begins (index in the text) in `lines`, and remove it from `tokens`.

    `tokens` are words with their indices, the next one last. Entries of a list or table in the value are noted too;
    keys and tables that `lines` has already keep their index.
    """
    parts, line = read_key(tokens, "=")
    for part in parts:
        path = (*path, part)
        lines.setdefault(path, line)
    _value(tokens, lines, path)


def _value(tokens: TomlTokens, lines: dict[KeyPath, int], path: KeyPath) -> None:
    """Note where entries of the value under `path` begin (index in the text) in `lines`, and remove it from `tokens`.

    `tokens` are words with their indices, the next one last. A value that is no list or table is only removed.
    """
    first, position = tokens.pop()[0], 0
    if first not in ("[", "{"):
        while tokens and tokens[-1][0] not in "]},\n":
            tokens.pop()
        return
    while tokens[-1][0] not in "]}":
        token, line = tokens[-1]
        if token in "\n,":
            tokens.pop()
        elif first == "{":
            _note_key_lines(tokens, lines, path)
        else:
            lines[(*path, position)] = line
            _value(tokens, lines, (*path, position))
            position += 1
    tokens.pop()
