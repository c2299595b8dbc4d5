"""A deck with marked numbers, and the text of it for given values."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from structid.core.constraints import Positive
from structid.core.errors import FileError, InputError

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
#: ``{{name}}`` in a deck, or ``{{name:8}}`` for a field of eight characters.
_MARK = re.compile(r"\{\{\s*(" + _NAME.pattern + r")\s*(?::\s*(\d+)\s*)?\}\}")
_ANY_MARK = re.compile(r"\{\{[^}\n]*\}?\}?")
#: Characters of a number where the mark does not say it: a large field of Nastran, and less than the 20 that CalculiX reads.
WIDTH = 16
_NARROWEST = 5
#: The file beside a deck that lists the lines at which FRFs are needed, and the mark of a line of the deck that tells them.
FREQUENCIES = "frequencies.csv"
_LINE_MARK = re.compile(r"\{\{\s*frequency\s*(?::\s*(\d+)\s*)?\}\}")


@dataclass(frozen=True)
class DeckParameter:
    """A marked number of a deck.

    Parameters
    ----------
    name : str
        As in the mark.
    value : float
        Nominal value, in the units of the deck.
    unit : str
        Unit of the value, for results and pages; ``1`` by default.
    step : float, optional
        Change for differences, as a part of the value (in its unit where that is 0): 0.01 at first for modes, 0.002 for
        FRFs, 0.5 for matrices.
    bounds : (float, float), optional
        Least and greatest value that the solver may be asked for; no limits by default.
    at : float, optional
        Value about which differences of modes or FRFs are taken; the nominal value by default.
    """

    name: str
    value: float
    unit: str = "1"
    step: Positive | None = None
    bounds: tuple[float, float] | None = None
    at: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` unless the name is one word, and value and centre of differences lie within the bounds."""
        if _NAME.fullmatch(self.name) is None:
            raise InputError(f"`name` must be made of letters, digits and _, as in E_left, got {self.name!r}")
        low, high = self.limits
        for key, value in (("value", self.value), ("at", self.centre)):
            if not low <= value <= high:
                raise InputError(
                    f"`{key}` of {self.name!r} must lie within `bounds`, {low:g} to {high:g}, got {value:g}"
                )

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest value that the solver may be asked for."""
        return (-math.inf, math.inf) if self.bounds is None else self.bounds

    @property
    def centre(self) -> float:
        """Value about which differences of modes or FRFs are taken."""
        return self.value if self.at is None else self.at


@dataclass(frozen=True, eq=False)
class Deck:
    """Text files of a solver with marks in place of numbers; the first is the one that the solver is given.

    Parameters
    ----------
    texts : mapping of str to str
        Text by name of the file, as it stands in the folder of a run.
    parameters : sequence of DeckParameter

    Raises
    ------
    InputError
        If a parameter has no mark, or a mark no parameter.
    """

    texts: Mapping[str, str]
    parameters: tuple[DeckParameter, ...]

    def __init__(self, texts: Mapping[str, str], parameters: Sequence[DeckParameter]) -> None:
        """Keep the deck's texts, by file name, and its parameters, after checks that marks and parameters match.

        `InputError` if a mark has no parameter, a parameter no mark, or two parameters have the same name.
        """
        object.__setattr__(self, "texts", dict(texts))
        object.__setattr__(self, "parameters", tuple(parameters))
        names = [parameter.name for parameter in self.parameters]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two parameters of the deck are called {name!r}; give each a name of its own")
        marked: set[str] = set()
        for file, text in self.texts.items():
            for mark in _ANY_MARK.finditer(text):
                marked.add(_parameter_of_mark(file, text, mark, names))
        for name in names:
            if name not in marked:
                raise InputError(
                    f"{', '.join(self.texts)}: nothing is marked {{{{{name}}}}}; write it in the deck in place of the number"
                    f" that parameter {name!r} is, say by `mark` where this stands, or take the parameter out"
                )

    @property
    def main(self) -> str:
        """Name of the file that is passed to the solver, the first of the deck."""
        return next(iter(self.texts))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal value of each parameter, as the deck shows it."""
        return self.shown({parameter.name: parameter.value for parameter in self.parameters})

    def shown(self, values: Mapping[str, float]) -> dict[str, float]:
        """`values` by parameter name, rounded as the solver sees them.

        They have the digits that fit in the narrowest mark of each parameter, 16 characters without a width.
        """
        width = dict.fromkeys(self.names, WIDTH)
        for text in self.texts.values():
            for mark in _MARK.finditer(text):
                width[mark[1]] = min(width[mark[1]], int(mark[2] or WIDTH))
        return {name: float(number_text(float(values[name]), width[name])) for name in self.names}

    def written(self, values: Mapping[str, float]) -> dict[str, str]:
        """Text of each file of the deck, by file name, with `values` (by parameter name) in place of the marks.

        A mark with a width keeps it, so that columns stay in place: the number comes first, blanks after it. All marks
        of a parameter show the same rounded value.
        """

        def number(mark: re.Match[str]) -> str:
            if mark[2] is None:
                return number_text(exact[mark[1]], WIDTH)
            return number_text(exact[mark[1]], int(mark[2])).ljust(int(mark[2]))

        exact = self.shown(values)
        return {file: _MARK.sub(number, text) for file, text in self.texts.items()}


def with_frequencies(texts: Mapping[str, str], frequency: Sequence[float]) -> dict[str, str]:
    """`texts` of the deck, by file name, with the frequencies that the solver is to compute.

    One more file lists them. A line with the mark ``{{frequency}}`` is repeated for each of `frequency` in Hz. The file
    is called frequencies.csv and has one frequency (Hz) in each line; raises `InputError` if the deck has a file of
    that name already.
    """

    def number(mark: re.Match[str], value: float) -> str:
        return number_text(value, int(mark[1])).ljust(int(mark[1])) if mark[1] else number_text(value)

    def written(line: str) -> str:
        return "".join(_LINE_MARK.sub(partial(number, value=f), line) for f in frequency)

    marked = {}
    for file, text in texts.items():
        lines = text.splitlines(keepends=True)
        lines = (
            [line if line.endswith(("\n", "\r")) else f"{line}\n" for line in lines]
            if _LINE_MARK.search(text)
            else lines
        )
        marked[file] = "".join(written(line) if _LINE_MARK.search(line) else line for line in lines)
    if FREQUENCIES in marked:
        raise InputError(f"a file of the deck is called {FREQUENCIES}, as is the list of lines; give it another name")
    return marked | {FREQUENCIES: "".join(f"{number_text(f)}\n" for f in frequency)}


def number_text(value: float, width: int = WIDTH) -> str:
    """`value` as text of at most `width` characters, with a decimal point and as many digits as fit.

    Raises
    ------
    InputError
        If it is not finite, or not even one digit fits.
    """
    if not math.isfinite(value):
        raise InputError(f"a number of a deck must be finite, got {value}")
    for digits in range(17, 0, -1):
        candidates = []
        for text in (f"{value:.{digits}g}", f"{value:.{digits - 1}e}"):
            mantissa, _, exponent = text.partition("e")
            mantissa = mantissa if "." in mantissa else mantissa + "."
            mantissa = mantissa.rstrip("0") if "." in mantissa else mantissa
            mantissa = mantissa.replace("-0.", "-.") if len(mantissa) > width else mantissa
            candidates.append(mantissa + (f"E{int(exponent)}" if exponent else ""))
        short = min(candidates, key=len)
        if len(short) <= width:
            return short
    raise InputError(f"{value:g} does not fit in {width} characters; widen the mark to {{{{name:{WIDTH}}}}}")


def deck_texts(paths: Sequence[Path]) -> dict[str, str]:
    """Text of each file of a deck, by file name; files that are not UTF-8 are read as Latin-1.

    Raises
    ------
    FileError
        If a file is binary, or two have the same name.
    """
    texts: dict[str, str] = {}
    for path in paths:
        if path.name in texts:
            raise FileError(f"{path}: two files of the deck are called {path.name}; give each a name of its own")
        content = path.read_bytes()
        try:
            texts[path.name] = content.decode("utf-8")
        except UnicodeDecodeError:
            texts[path.name] = content.decode("latin-1")
        if "\0" in texts[path.name]:
            raise FileError(f"{path}: must be a deck in text, is binary; write it as text")
    return texts


def _parameter_of_mark(file: str, text: str, mark: re.Match[str], names: Sequence[str]) -> str:
    """Name of the parameter in the match `mark`, such as ``{{name:8}}``, among the known `names`.

    `file` and `text` locate it in errors. `InputError` if the mark is malformed, too narrow or its parameter unknown.
    """
    line = text.count("\n", 0, mark.start()) + 1
    parts = _MARK.fullmatch(mark[0])
    if parts is None:
        raise InputError(
            f"{file}, line {line}: {mark[0]!r} is no mark; write {{{{name}}}}, or {{{{name:8}}}} with a width"
        )
    if parts[1] not in names:
        nearest = difflib.get_close_matches(parts[1], names, 1, 0.0)
        raise InputError(
            f"{file}, line {line}: {mark[0]} has no parameter; add [[structure.solver.parameter]] with"
            f" name = {parts[1]!r}" + (f" (the nearest is {nearest[0]!r})" if nearest else "")
        )
    if parts[2] is not None and int(parts[2]) < _NARROWEST:
        raise InputError(f"{file}, line {line}: {mark[0]} is too narrow; give it {_NARROWEST} characters or more")
    return parts[1]


@dataclass(frozen=True)
class MatrixFile:
    """A matrix in a file of a run; the name where the file holds several."""

    path: str
    matrix: str | None = None
