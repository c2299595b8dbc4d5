"""Where each key of a TOML text stands, which `tomllib` does not tell."""

from __future__ import annotations

import tomllib
from bisect import bisect_right

KeyPath = tuple[str | int, ...]

_BLANK = " \t\r\n"
_BARE_END = ",]}#\n"


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
    return _Scanner(text.replace("\r\n", "\n")).scan()


class _Scanner:
    """One pass over the text; it lives as long as one call of `toml_lines`."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.found: dict[KeyPath, int] = {}
        self.breaks = [i for i, letter in enumerate(text) if letter == "\n"]

    def scan(self) -> dict[KeyPath, int]:
        table: KeyPath = ()
        counts: dict[KeyPath, int] = {}
        self.skip_blank()
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self.header(counts)
            else:
                self.pair(table)
            self.skip_blank()
        return self.found

    def note(self, path: KeyPath, start: int) -> None:
        self.found.setdefault(path, bisect_right(self.breaks, start - 1) + 1)

    def note_all(self, table: KeyPath, parts: list[str], start: int) -> KeyPath:
        """Note every prefix of a dotted key; the path of the whole."""
        for part in parts:
            table = (*table, part)
            self.note(table, start)
        return table

    def skip_blank(self) -> None:
        """Past spaces, line ends and comments."""
        while self.at < len(self.text):
            if self.text[self.at] == "#":
                self.at = self.end_of_line()
            elif self.text[self.at] in _BLANK:
                self.at += 1
            else:
                return

    def end_of_line(self) -> int:
        end = self.text.find("\n", self.at)
        return len(self.text) if end < 0 else end

    def header(self, counts: dict[KeyPath, int]) -> KeyPath:
        """Past ``[a.b]`` or ``[[a.b]]``; the path of the table, with the position in every array of tables."""
        start = self.at
        is_array = self.text.startswith("[[", self.at)
        self.at += 2 if is_array else 1
        parts = self.key("]")
        self.at += 2 if is_array else 1
        path: KeyPath = ()
        for i, part in enumerate(parts):
            path = (*path, part)
            self.note(path, start)
            if is_array and i == len(parts) - 1:
                counts[path] = counts.get(path, 0) + 1
            if path in counts:
                path = (*path, counts[path] - 1)
                self.note(path, start)
        return path

    def key(self, end: str) -> list[str]:
        """Past a dotted key, up to `end`."""
        parts = []
        while True:
            self.skip_blank()
            start = self.at
            if self.text[start] in "\"'":
                self.string()
                [part] = tomllib.loads(self.text[start : self.at] + "=0")
            else:
                while self.text[self.at] not in ". \t=]":
                    self.at += 1
                part = self.text[start : self.at]
            parts.append(part)
            self.skip_blank()
            if self.text[self.at] == end:
                return parts
            self.at += 1

    def pair(self, table: KeyPath) -> None:
        """Past ``key = value``."""
        start = self.at
        path = self.note_all(table, self.key("="), start)
        self.at += 1
        self.value(path)

    def value(self, path: KeyPath) -> None:
        self.skip_blank()
        letter = self.text[self.at]
        if letter in "\"'":
            self.string()
        elif letter == "[":
            self.array(path)
        elif letter == "{":
            self.inline_table(path)
        else:
            while self.at < len(self.text) and self.text[self.at] not in _BARE_END:
                self.at += 1

    def array(self, path: KeyPath) -> None:
        self.at += 1
        position = 0
        while True:
            self.skip_blank()
            if self.text[self.at] == "]":
                self.at += 1
                return
            if self.text[self.at] == ",":
                self.at += 1
                continue
            self.note((*path, position), self.at)
            self.value((*path, position))
            position += 1

    def inline_table(self, path: KeyPath) -> None:
        self.at += 1
        while True:
            self.skip_blank()
            if self.text[self.at] == "}":
                self.at += 1
                return
            if self.text[self.at] == ",":
                self.at += 1
                continue
            self.pair(path)

    def string(self) -> None:
        """Past a string of any of the four forms."""
        quote = self.text[self.at]
        is_long = self.text.startswith(3 * quote, self.at)
        fence = 3 * quote if is_long else quote
        self.at += len(fence)
        while not self.text.startswith(fence, self.at):
            self.at += 2 if quote == '"' and self.text[self.at] == "\\" else 1
        self.at += len(fence)
        for _ in range(2 if is_long else 0):  # a long string may end with two quotes of its own
            if self.text.startswith(quote, self.at):
                self.at += 1
