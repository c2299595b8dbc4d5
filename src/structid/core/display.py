"""Objects and numbers as text: a line and a short table, and values with standard deviations to matching digits."""

from __future__ import annotations

import difflib
import html
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from structid.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from numpy.typing import ArrayLike

#: Rows that are shown; the table says how many more there are.
_MOST_ROWS = 30
#: Warnings that a terminal shows at once.
MOST_WARNINGS = 5
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_FORCES, _PREFIXES = re.compile(r"(N|Pa)\b(?!/N)"), ("", "k", "M", "G")
_POWER = re.compile(r"\^(-?\d+)")
MINUS, TIMES, DASH = "\u2212", "\u00d7", "\u2013"
#: What stands where there is no number.
NOTHING = DASH
#: Largest part of 100 that is the rounding of a computer's numbers.
_ROUNDING = 1e-10


@dataclass(frozen=True)
class Overview:
    """A line, and a table below it.

    Attributes
    ----------
    words : str
    header : sequence of str
    rows : sequence of sequences of str
    """

    words: str
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()


class Shown(ABC):
    """An object with an `overview`: its ``repr``, its table in notebooks, and `summary` as text."""

    @abstractmethod
    def overview(self) -> Overview:
        """The line and the table that describe the object."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.overview().words}>"

    def __str__(self) -> str:
        return self.summary()

    def summary(self) -> str:
        """The overview as plain text: its line of words, then the whole table, header first, in aligned columns."""
        shown = self.overview()
        lines = [list(shown.header), *map(list, shown.rows)] if shown.rows else []
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = ["  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)) for line in lines]
        return "\n".join([shown.words, *(line.rstrip() for line in table)])

    def _repr_html_(self) -> str:
        """The overview as HTML for notebooks: the class with the line of words, then the first 30 rows of the table.

        A last line says how many rows are left out, if any.
        """
        shown = self.overview()
        first, more = shown.rows[:_MOST_ROWS], len(shown.rows) - _MOST_ROWS
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in shown.header)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in first)
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if first else ""
        rest = f"<p>and {more} more</p>" if more > 0 else ""
        return f"<p><b>{type(self).__name__}</b>: {html.escape(shown.words)}</p>{table}{rest}"


def format_number(value: float, digits: int = 5) -> str:
    """`value` as text with `digits` significant digits; "-" for NaN."""
    return f"{value:.{digits}g}" if math.isfinite(value) else "-" if math.isnan(value) else str(value)


def plural(count: int, noun: str) -> str:
    """`count` and `noun` as text, such as ``1 mode``, ``3 modes`` or ``3 frequencies``."""
    if count == 1:
        return f"{count} {noun}"
    return f"{count} {noun[:-1]}ies" if noun.endswith("y") and noun[-2:-1] not in "aeou" else f"{count} {noun}s"


def join_words(items: Sequence[object], most: int = 6) -> str:
    """The first `most` items joined by commas, and how many more there are."""
    more = len(items) - most
    return ", ".join(map(str, items[:most])) + (f" and {more} more" if more > 0 else "")


def names_like(text: str, names: Sequence[str]) -> list[str]:
    """At most three of `names` that `text` may stand for: those that begin with it in any case, then alike spellings.

    The list is empty where no name is like it.
    """
    begin = [name for name in names if text and name.lower().startswith(text.lower())]
    return list(dict.fromkeys([*begin, *difflib.get_close_matches(text, names)]))[:3]


def as_sentence(words: str) -> str:
    """The clause `words` as a sentence: a capital if the first word has letters only, and a full stop at its end."""
    first = words.split(" ", 1)[0]
    start = words[0].upper() + words[1:] if first.isalpha() else words
    return start if start.endswith((".", "?", "!")) else f"{start}."


def file_names(paths: Sequence[str | Path]) -> list[str]:
    """A name for each file: its last path component, or its path where two files share one."""
    names = [Path(path).name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def first_warnings(warnings: Iterable[str], most: int = MOST_WARNINGS) -> list[str]:
    """The first `most` warnings as plain lines ``warning: ...``, then a line with the number of the others, if any."""
    texts = list(warnings)
    more = len(texts) - most
    note = [f"{plural(more, 'more warning')}: in the results"] if more > 0 else []
    return [*(f"warning: {words}" for words in texts[:most]), *note]


def data_array(
    values: ArrayLike, axes: Mapping[str, Iterable[object]], name: str, about: Mapping[str, object]
) -> xr.DataArray:
    """`values` as an ``xarray.DataArray`` with labelled axes, a `name` and attributes.

    `axes` maps the name of each axis, in order, to its labels; `about` maps the names of attributes to their values.

    Raises
    ------
    InputError
        If xarray is missing.
    """
    try:
        import xarray
    except ImportError as error:
        raise InputError("`xarray` must be installed for labelled arrays; `pip install 'structid[tables]'`") from error
    labels = {axis: list(entries) for axis, entries in axes.items()}
    return xarray.DataArray(values, labels, tuple(axes), name, dict(about))


def data_frame(columns: Mapping[str, Iterable[object]], index: str) -> pd.DataFrame:
    """A ``pandas.DataFrame`` of `columns`, sequences of equal length by name; that called `index` becomes its index.

    Raises
    ------
    InputError
        If pandas is missing.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError("`pandas` must be installed for data frames; `pip install 'structid[tables]'`") from error
    return pandas.DataFrame(dict(columns)).set_index(index)


def number(value: float, digits: int = 4) -> str:
    """`value` with `digits` significant digits; powers of ten below 1e-3 and from 1e5.

    A dash for NaN, ∞ or −∞ for infinite values, and "0" for 0.

    Examples
    --------
    >>> number(0.012345), number(2.1e6, 3), number(float("nan"))
    ('0.01235', '2.10×10⁶', '–')
    """
    if not math.isfinite(value):
        return NOTHING if math.isnan(value) else ("∞" if value > 0 else f"{MINUS}∞")
    if value == 0:
        return "0"
    exponent = _exponent(value, digits)
    if -3 <= exponent < 5:
        return _fixed(value, digits - 1 - exponent)
    return f"{_fixed(value / 10.0**exponent, digits - 1)}{TIMES}10{_superscript(exponent)}"


def exact(value: float, digits: int = 5) -> str:
    """`value` with up to `digits` significant digits and no zeros at the end, as for a number that was chosen.

    Examples
    --------
    >>> exact(80.0), exact(0.02), exact(2.1e6), exact(1234567.0)
    ('80', '0.02', '2.1×10⁶', '1.2346×10⁶')
    """
    mantissa, times, power = number(value, digits).partition(TIMES)
    return (mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa) + times + power


def with_std(value: float, std: float) -> str:
    """`value` ± `std`, the deviation with two significant digits and the value to the same place.

    A dash if `value` is not finite; "not determined" for a deviation that is not. The value has ten significant digits
    of its own where the deviation is below 1e-9 of it, and four where it is 0 or above 1000 times the value.

    Examples
    --------
    >>> with_std(8.31234, 0.0457), with_std(2.1e6, 3.1e4), with_std(3.0, float("nan"))
    ('8.312 ± 0.046', '(2.100 ± 0.031)×10⁶', '3.000 ± not determined')
    """
    if not math.isfinite(value):
        return NOTHING
    if not math.isfinite(std):
        return f"{number(value)} ± not determined"
    if std == 0:
        return f"{number(value)} ± 0"
    if value != 0 and not 1e-9 <= abs(std / value) <= 1e3:
        return f"{number(value, 4 if std > abs(value) else 10)} ± {number(std, 2)}"
    exponent = max(_exponent(value, 4) if value else -400, _exponent(std, 2))
    shown = 0 if -3 <= exponent < 5 else exponent
    decimals = 1 - _exponent(std, 2) + shown
    text = f"{_fixed(value / 10.0**shown, decimals)} ± {_fixed(std / 10.0**shown, decimals)}"
    return text if shown == 0 else f"({text}){TIMES}10{_superscript(shown)}"


def value_words(value: float, std: float) -> str:
    """`value` ± `std`, or the value alone where there is no standard deviation."""
    return with_std(float(value), float(std)) if math.isfinite(std) else number(float(value), 5)


def likeness(value: float, decimals: int = 3) -> str:
    """A MAC or its like, from 0 to 1.

    Examples
    --------
    >>> likeness(0.98765), likeness(1.0, 2), likeness(float("nan"))
    ('0.988', '1.00', '–')
    """
    return NOTHING if math.isnan(value) else _fixed(value, decimals)


def percent(ratio: float, digits: int = 3, signed: bool = True, most_decimals: int = 2) -> str:
    """`ratio` in per cent, with + before positive ones if `signed`; a dash if it is not finite.

    `digits` are the significant digits of the number in per cent. It has `most_decimals` at most, unless more are
    needed to tell it from 0.

    Examples
    --------
    >>> percent(-0.1234), percent(0.05, signed=False), percent(0.00046), percent(1.2e-5)
    ('−12.3 %', '5.00 %', '+0.05 %', '+0.0012 %')
    """
    if not math.isfinite(ratio):
        return NOTHING
    value = 100 * ratio
    if abs(value) <= _ROUNDING:
        text = _fixed(0.0, most_decimals)
    elif round(value, most_decimals) == 0:
        text = number(value, 2)
    else:
        small = most_decimals < digits - 1 - _exponent(value, digits)
        text = _fixed(value, most_decimals) if small else number(value, digits)
    return f"{'+' if signed and ratio > 0 else ''}{text} %"


def span_digits(low: float, high: float) -> tuple[int, int]:
    """Significant digits, 1 to 10 for each end, that show an interval to a hundredth of its width.

    The ends are `low` and `high`. 4 and 4 if an end is not finite, or the width is not above 0.
    """
    largest = max(abs(low), abs(high))
    if not (math.isfinite(largest) and high > low):
        return 4, 4
    last = math.floor(math.log10(high - low)) - 2
    first, second = (math.floor(math.log10(abs(end))) - last + 1 if end else 1 for end in (low, high))
    return min(max(first, 1), 10), min(max(second, 1), 10)


def span_text(low: float, high: float, unit: str = "") -> str:
    """The interval from `low` to `high` as text with its unit, its ends to a hundredth of its width: ``1.2 to 1.4 kg``.

    An infinite end is put in words, as in ``below 3 kg, no lower limit``; a dash if an end is NaN.
    """
    if math.isnan(low) or math.isnan(high):
        return NOTHING
    if not math.isfinite(low):
        return f"below {with_unit(number(high), unit)}, no lower limit" if math.isfinite(high) else "no limits"
    if not math.isfinite(high):
        return f"above {with_unit(number(low), unit)}, no upper limit"
    first, second = span_digits(low, high)
    return with_unit(f"{number(low, first)} to {number(high, second)}", unit)


def unit_text(unit: str) -> str:
    """`unit` with raised powers; empty for a number without unit.

    Examples
    --------
    >>> unit_text("(m/s^2)/N"), unit_text("1")
    ('(m/s²)/N', '')
    """
    return "" if unit == "1" else _POWER.sub(lambda found: _superscript(int(found[1])), unit)


def prefixed(unit: str, *values: float) -> tuple[float, str]:
    """Divisor of `values` and the unit with its prefix (k, M, G), so that the largest of them has few digits.

    Only units that begin with N or Pa (forces, pressures, stiffnesses and the like) get a prefix, if the largest value
    is 1000 or more; otherwise the divisor is 1. Values that are not finite do not count.

    Examples
    --------
    >>> prefixed("N m^2", 2.5e7, 3.0e5), prefixed("N/m", 900.0), prefixed("kg", 2e6)
    ((1000000.0, 'MN m²'), (1.0, 'N/m'), (1.0, 'kg'))
    """
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    if not _FORCES.match(unit) or largest < 1e3:
        return 1.0, unit_text(unit)
    power = min(_exponent(largest, 4) // 3, 3)
    return 1000.0**power, _PREFIXES[power] + unit_text(unit)


def with_unit(text: str, unit: str) -> str:
    """`text` followed by the unit, if there is one."""
    return f"{text} {unit_text(unit)}".strip()


def _exponent(value: float, digits: int) -> int:
    """Exponent of ten of `value` after rounding to `digits` significant digits."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def _fixed(value: float, decimals: int) -> str:
    rounded = round(value, decimals)
    return f"{rounded + 0.0:.{max(decimals, 0)}f}".replace("-", MINUS)


def _superscript(exponent: int) -> str:
    return str(exponent).translate(_SUPERSCRIPT)
