"""Where each key of a TOML text stands, which `tomllib` does not tell."""

from __future__ import annotations

import re
import tomllib

KeyPath = tuple[str | int, ...]
Words = list[tuple[str, int]]

#: Texts, brackets, signs, line ends, comments, blanks and all other words of TOML.
WORD = re.compile(
    r'"""(?:\\[\s\S]|(?!""")[^\\])*"{3,5}'  # long texts may end with two quotes of their own
    r"|'''(?:(?!''')[\s\S])*'{3,5}"
    r'|"(?:\\.|[^"\\])*"'
    r"|'[^']*'"
    r"|[\[\]{},=.\n]|#[^\n]*|[ \t]+|[^\s\[\]{},=.#\"']+"
)


def toml_lines(text: str) -> dict[KeyPath, int]:
    """Line (from 1) of every key, table header and array entry of a valid TOML text.

    Parameters
    ----------
    text : str
        A text that `tomllib.loads` accepts; for another the answer is not defined.

    Returns
    -------
    mapping of path to line
        A path holds table names and keys, and positions (from 0) in arrays and arrays of tables.

    Examples
    --------
    >>> lines = toml_lines("a = 1\\n[[b]]\\n[[b]]\\n  c.d = [\\n 5,\\n 6]\\n")
    >>> lines["a",], lines["b", 1], lines["b", 1, "c", "d"], lines["b", 1, "c", "d", 1]
    (1, 3, 4, 6)
    """
    found: dict[KeyPath, int] = {}
    words, line = [], 1
    for match in WORD.finditer(text.replace("\r\n", "\n")):
        if match[0][0] not in " \t#":
            words.append((match[0], line))
        line += match[0].count("\n")
    words.reverse()  # a stack: the next word is the last
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    while words:
        if words[-1][0] == "[":
            table = _header(words, found, counts)
        elif words[-1][0] == "\n":
            words.pop()
        else:
            _pair(words, found, table)
    return found


def _key(words: Words, end: str) -> tuple[list[str], int]:
    """The parts of a dotted key up to `end`, and its line."""
    parts: list[str] = []
    line = words[-1][1]
    while (word := words.pop()[0]) != end:
        if word[0] in "\"'":
            parts += tomllib.loads(f"{word} = 0")
        elif word != ".":
            parts.append(word)
    return parts, line


def _header(words: Words, found: dict[KeyPath, int], counts: dict[KeyPath, int]) -> KeyPath:
    """The path of ``[a.b]`` or ``[[a.b]]``, with the position in every array of tables."""
    words.pop()
    is_array = words[-1][0] == "["
    if is_array:
        words.pop()
    parts, line = _key(words, "]")
    if is_array:
        words.pop()
    path: KeyPath = ()
    for i, part in enumerate(parts):
        path = (*path, part)
        found.setdefault(path, line)
        if is_array and i == len(parts) - 1:
            counts[path] = counts.get(path, 0) + 1
        if path in counts:
            path = (*path, counts[path] - 1)
            found.setdefault(path, line)
    return path


def _pair(words: Words, found: dict[KeyPath, int], path: KeyPath) -> None:
    parts, line = _key(words, "=")
    for part in parts:
        path = (*path, part)
        found.setdefault(path, line)
    _value(words, found, path)


def _value(words: Words, found: dict[KeyPath, int], path: KeyPath) -> None:
    first, position = words.pop()[0], 0
    if first not in ("[", "{"):
        while words and words[-1][0] not in "]},\n":
            words.pop()
        return
    while words[-1][0] not in "]}":
        word, line = words[-1]
        if word in "\n,":
            words.pop()
        elif first == "{":
            _pair(words, found, path)
        else:
            found[(*path, position)] = line
            _value(words, found, (*path, position))
            position += 1
    words.pop()
