"""Keyword lines of Abaqus input files with their options and data, and the files that *INCLUDE brings in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from structid.errors import FileError
from structid.files import require_readable

Block = tuple[int, str, dict[str, str], list[list[str]]]

_MOST_INCLUDES = 20


def keyword_blocks(path: Path) -> Iterator[Block]:
    """Line, keyword, options and data lines of every keyword; included files stand in the place of *INCLUDE.

    Raises
    ------
    FileError
        If an included file cannot be read.
    """
    found: Block | None = None
    for number, text in _lines(path, 0):
        words = [word.strip() for word in text.split(",")]
        if text.startswith("*"):
            if found is not None:
                yield found
            found = (number, " ".join(words[0][1:].upper().split()), keyword_options(words[1:]), [])
        elif found is not None:
            found[3].append(words)
    if found is not None:
        yield found


def keyword_options(words: list[str]) -> dict[str, str]:
    """Options such as ``NAME=STEEL`` by their names in capitals; those without a value have an empty one."""
    pairs = (word.partition("=") for word in words if word)
    return {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


def _lines(path: Path, depth: int) -> Iterator[tuple[int, str]]:
    """Lines without comments and blank ones; keyword lines that go on behind a comma are joined."""
    if depth > _MOST_INCLUDES:
        raise FileError(f"{path}: includes itself, or more than {_MOST_INCLUDES} files in one another; write one file")
    number, pending = 0, ""
    with path.open(encoding="utf-8", errors="replace") as stream:
        for at, line in enumerate(stream, 1):
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            number = number if pending else at
            text, pending = pending + text, ""
            name, *options = text.split(",")
            if text.startswith("*") and text.endswith(","):
                pending = text
            elif name.replace(" ", "").upper() == "*INCLUDE":
                yield from _included(path, number, keyword_options(options), depth)
            else:
                yield number, text
    if pending:
        yield number, pending


def _included(path: Path, number: int, options: dict[str, str], depth: int) -> Iterator[tuple[int, str]]:
    name = options.get("INPUT", "").replace("\\", "/")
    try:
        place = require_readable(path.parent / name)
    except FileError as error:
        raise FileError(f"{path}, line {number}: the included file cannot be read ({error})") from error
    yield from _lines(place, depth + 1)
