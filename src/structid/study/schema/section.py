"""A table of a study file: its keys checked and read, and every error told with file, line and key."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from structid.errors import InputError
from structid.study.schema.toml_lines import KeyPath, toml_lines

_LARGEST = 1e100  # its square is still finite, and that of its reciprocal no zero


class StudyError(InputError):
    """Something in a study file cannot be used; the message begins with file, line, section and key."""


@dataclass(frozen=True)
class Kind:
    """What a key may hold, in words, and how to tell."""

    words: str
    accepts: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return value == 0 or (1 / _LARGEST <= abs(value) <= _LARGEST and (isinstance(value, float) or abs(value) < 2**63))


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31


def _is_text(value: Any) -> bool:
    """Characters that steer a terminal, and null, which no file name may hold, are no text."""
    return isinstance(value, str) and value.strip() != "" and all(c.isprintable() or c in "\n\t" for c in value)


def _list_of(accepts: Callable[[Any], bool], size: int | None = None) -> Callable[[Any], bool]:
    def accepted(value: Any) -> bool:
        fits = isinstance(value, list) and (len(value) > 0 if size is None else len(value) == size)
        return fits and all(accepts(entry) for entry in value)

    return accepted


def _either(*tests: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: any(test(value) for test in tests)


def _is_node_table(value: Any) -> bool:
    rows = _list_of(_list_of(_is_integer))(value)
    return rows and len({len(row) for row in value}) == 1


def _is_range(value: Any) -> bool:
    return _list_of(_is_number, 2)(value) and value[0] < value[1]


NUMBER = Kind("a number, as in 0.4", _is_number)
POSITIVE = Kind("a number greater than 0", lambda value: _is_number(value) and value > 0)
NOT_NEGATIVE = Kind("a number of at least 0", lambda value: _is_number(value) and value >= 0)
NUMBERS = Kind("a number or a list of numbers", _either(_is_number, _list_of(_is_number)))
POSITION = Kind("one to three coordinates in m, as in [0.0, 1.5]", _either(_is_number, _list_of(_is_number)))
VECTOR = Kind(
    "three numbers that are not all 0, as in [0, 1, 0]", lambda value: _list_of(_is_number, 3)(value) and any(value)
)
INTEGER = Kind("a whole number of at least 0", _is_integer)
COUNT = Kind("a whole number of at least 1", lambda value: _is_integer(value) and value > 0)
COUNTS = Kind(
    "whole numbers of at least 1, as in [4, 3]",
    _either(COUNT.accepts, lambda value: _list_of(COUNT.accepts)(value) and len(value) <= 3),
)
BOOLEAN = Kind("true or false", lambda value: isinstance(value, bool))
TEXT = Kind("a text in quotes", _is_text)
TEXTS = Kind("a text or a list of texts", _either(_is_text, _list_of(_is_text)))
NODES = Kind("node numbers, as in [[1, 2], [2, 3]]", _either(_is_integer, _list_of(_is_integer), _is_node_table))
RANGE = Kind("two increasing numbers, as in [4.5, 85.0]", _is_range)
RANGES = Kind("a list of pairs of increasing numbers, as in [[49.5, 50.5]]", _list_of(_is_range))
WEIGHTED = Kind(
    'a list of degrees of freedom with coefficients, as in [["1X", 1.0]]',
    _list_of(lambda value: isinstance(value, list) and len(value) == 2 and _is_text(value[0]) and _is_number(value[1])),
)


def choice(*names: str) -> Kind:
    """A text that is one of `names`."""
    return Kind("one of " + ", ".join(f'"{name}"' for name in names), lambda value: value in names)


@dataclass(frozen=True, eq=False)
class StudyText:
    """The study file as read.

    Attributes
    ----------
    path : Path
    text : str
    """

    path: Path
    text: str

    @cached_property
    def table(self) -> dict[str, Any]:
        """Its content; a `TOMLDecodeError` of `tomllib` where it is not TOML."""
        return tomllib.loads(self.text)

    @cached_property
    def lines(self) -> Mapping[KeyPath, int]:
        """Line of every path of keys; found when first asked for, as only errors name lines."""
        return toml_lines(self.text)

    def line(self, path: KeyPath) -> int:
        """Line of `path`, or of the nearest table that holds it."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


@dataclass(frozen=True, eq=False)
class Section:
    """One table of a study file.

    Attributes
    ----------
    source : StudyText
    path : tuple
        Names and positions that lead to it; () for the whole file.
    table : mapping
        Its content.
    """

    source: StudyText
    path: KeyPath
    table: Mapping[str, Any]

    @property
    def title(self) -> str:
        """The header as the user wrote it, with the name of the entry where it has one."""
        if not self.path:
            return "top level"
        words = ".".join(str(part) for part in self.path if isinstance(part, str))
        if not isinstance(self.path[-1], int):
            return f"[{words}]"
        name = self.table.get("name") or self.table.get("property")
        return f"[[{words}]] " + (f'"{name}"' if isinstance(name, str) else f"number {self.path[-1] + 1}")

    def error(self, message: str, key: str | None = None) -> StudyError:
        """`message` with its place before it."""
        line = self.source.line(self.path if key is None else (*self.path, key))
        return StudyError(f"{self.source.path}, line {line}: {self.title}{'' if key is None else ' ' + key}: {message}")

    @contextmanager
    def located(self, key: str | None = None) -> Iterator[None]:
        """Gives any `InputError` of the block the place of this section."""
        try:
            yield
        except StudyError:
            raise
        except InputError as error:
            raise self.error(str(error), key) from error

    def values(
        self, kinds: Mapping[str, Kind], required: Collection[str] = (), others: Collection[str] = ()
    ) -> dict[str, Any]:
        """Every given key of `kinds`, checked.

        Parameters
        ----------
        kinds : mapping of key to Kind
        required : collection of str
            Keys that must be there.
        others : collection of str
            Keys that are read elsewhere.

        Raises
        ------
        StudyError
            If a key is unknown (the nearest is named), missing or of the wrong kind.
        """
        known = [*kinds, *others]
        for key in self.table:
            if key not in kinds and key not in others:
                near = difflib.get_close_matches(key, known, 1, 0.0)
                nearest = f"the nearest is `{near[0]}`; " if near else ""
                raise self.error(f"unknown key; {nearest}valid keys are {', '.join(known)}", key)
        for key in required:
            if key not in self.table:
                raise self.error(f"`{key}` is missing; add `{key} = ...`" + self._wanted(kinds.get(key)))
        for key, kind in kinds.items():
            if key in self.table and not kind.accepts(self.table[key]):
                raise self.error(f"must be {kind.words}, got {_shown(self.table[key])}", key)
        return {key: self.table[key] for key in kinds if key in self.table}

    @staticmethod
    def _wanted(kind: Kind | None) -> str:
        return "" if kind is None else f" ({kind.words})"

    def section(self, key: str) -> Section | None:
        """The table `key` inside this one; None where it is not there."""
        if key not in self.table:
            return None
        inner = self.table[key]
        if not isinstance(inner, dict):
            raise self.error(f"must be a table, got {_shown(inner)}; write [{self._joined(key)}] above its keys", key)
        return Section(self.source, (*self.path, key), inner)

    def sections(self, key: str) -> list[Section]:
        """The entries of the array of tables `key` inside this one."""
        given = self.table.get(key, [])
        if not isinstance(given, list) or not all(isinstance(entry, dict) for entry in given):
            raise self.error(f"must be an array of tables; write [[{self._joined(key)}]] above each entry", key)
        return [Section(self.source, (*self.path, key, i), entry) for i, entry in enumerate(given)]

    def _joined(self, key: str) -> str:
        return ".".join([str(part) for part in self.path if isinstance(part, str)] + [key])


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def as_list(value: Any) -> list[Any]:
    """A single entry as a list of one."""
    return value if isinstance(value, list) else [value]
