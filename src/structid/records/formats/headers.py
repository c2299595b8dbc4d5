"""Headers of columns and names of channels: the units that they say, whether they are of times, frequencies or levels."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import TypeVar

from structid.core.errors import InputError
from structid.core.units import FrfUnit, Unit, parse_frequency_unit, parse_time_unit
from structid.records.formats.options import option_words

T = TypeVar("T")

_HEAD = re.compile(r"^(?P<name>.*?)\s*[\[({<](?P<unit>[^\[\]()]+|[^\[\]]*\([^\[\]]*\)[^\[\]]*)[\])}>]$")
#: Letters of a header at most that is taken apart.
_LONGEST_HEAD = 200
_TIME = re.compile(r"^(time|times|t|zeit|temps|tiempo|tempo|timestamp|date|datetime|x)$|^(time|zeit)\b", re.IGNORECASE)
#: A word for times with their unit behind it, as in ``Time ms``, ``t_us`` or ``time, sec``.
_TIME_AND_UNIT = re.compile(
    r"^(?:time|times|t|zeit|temps|tiempo|tempo|timestamp|elapsed)(?:[ _.,/-]+(?:in |since start )?)(?P<unit>[^\W\d_]+)\.?$",
    re.IGNORECASE,
)
#: Units that are names of columns of times too, as loggers of hobbyists call them.
_TIMES_BY_UNIT = ("millis", "micros", "milliseconds", "microseconds", "seconds", "msec", "usec", "secs")
_FREQUENCY = re.compile(
    r"(?P<name>frequency|frequencies|freq|frequenz|fréquence|frequence|frecuencia|frequenza|f|omega|ω)\.?"
    r"(?P<unit>(_|\s*[,/]\s*|\s+in\s+|\s+(?=[\[(])|(?=[\[(])|\s+)[\[(]?(?P<of>[^\[\]]+?)[\])]?)?",
    re.IGNORECASE,
)
#: Letters of a name that is taken apart, at most: the patterns take time with the square of them.
LONGEST_NAME = 120
#: A unit within brackets, wherever it stands.
_BRACKETED = re.compile(r"\[([^\[\]]+)\]|\(([^()]*(?:\([^()]*\)[^()]*)*)\)|\{([^{}]+)\}|<([^<>]+)>")
#: The last word of a name, which may be a unit without brackets, as in ``Acc_g``, ``a / m/s^2`` and ``a in m/s^2``.
_LAST_WORDS = (re.compile(r"[\s_,;:]([^\s_,;:]+)$"), re.compile(r"(?:\s/\s*|\sin\s+)(.+)$"))
#: Last words that are no units: channel G, the direction normal to a surface, the side where a force goes in.
_NO_BARE_UNITS = {"G", "N", "in"}
#: Words for what is no history and no response, but a level, a mean or a density of one.
_LEVEL = re.compile(
    r"(?<![a-z])(dB|g?rms|pk(?:-pk)?|p-p|psd|asd|csd|cpsd|apsd|log ?mag(?:nitude)?|(?:20 ?)?log10|20 ?log)(?![a-z])"
    r"|/ ?(\u221a|sqrt ?\(?|rt ?)?hz",
    re.IGNORECASE,
)

#: The last word of a name, by which loggers call a statistic of each interval; and the mark of a column that is one for certain.
_STATISTIC, _MARKED = re.compile(r"[\s_](avg|max|min|std)$", re.IGNORECASE), re.compile(r" statistic (\S+)$")


def name_and_unit(text: str) -> tuple[str, str]:
    """Name in the header `text` and the unit in brackets after it, which is "" without brackets."""
    text = text.strip()
    match = _HEAD.match(text) if len(text) <= _LONGEST_HEAD else None
    return (match["name"], match["unit"].strip()) if match else (text, "")


def is_time(text: str) -> bool:
    """True if a header is that of a column of times, by its name or by a unit of time."""
    name = name_and_unit(text)[0]
    return _TIME.match(name) is not None or time_factor(name) is not None


def time_factor(name: str, unit: str = "") -> float | None:
    """Factor from a column of times to s, by its header; None if neither `name` nor `unit` states the unit.

    Parameters
    ----------
    name : str
        Header, such as ``Time [ms]``, ``Time ms``, ``t_us``, ``time_s`` or ``millis``.
    unit : str
        Unit beside or below the name, "" if absent; it must be a unit of time.

    Raises
    ------
    InputError
        If the stated unit is not one of time, or two different units are stated.
    """
    bare, bracketed = name_and_unit(name)
    match = _TIME_AND_UNIT.match(bare)
    word = match["unit"] if match else bare if bare.lower() in _TIMES_BY_UNIT else ""
    stated = [parse_time_unit(unit or bracketed)] if unit or bracketed else []
    stated += _parse_unit(parse_time_unit, word) + _parse_unit(
        parse_time_unit, bracketed
    )  # a word may be "stamp" of a time stamp
    _require_one(stated, f"{name!r} above {unit!r}" if unit else repr(name))
    return stated[0] if stated else None


def _parse_unit(parse: Callable[[str], T], text: str) -> list[T]:
    """List with the unit parsed from `text` as its only entry; empty if `parse` does not read it."""
    try:
        return [parse(text)] if text else []
    except InputError:
        return []


def _require_one(factors: Sequence[float], where: str) -> None:
    """Raise `InputError` if the same header states two units by their factors."""
    if any(abs(factor / factors[0] - 1) > 1e-9 for factor in factors):
        raise InputError(f"{where} states two units; correct one of them")


def frequency_factor(name: str, unit: str = "") -> float | None:
    """Factor from a column of frequencies to Hz, by its header; NaN without a unit, None for a column of anything else.

    Parameters
    ----------
    name : str
        Header, such as ``Frequency [Hz]``, ``freq_hz``, ``f [kHz]`` or ``omega [rad/s]``.
    unit : str
        Unit from a second header line, "" if absent.

    Raises
    ------
    InputError
        If both state a unit, and these differ.
    """
    text = name.strip()
    match = _FREQUENCY.fullmatch(text) if len(text) <= LONGEST_NAME else None
    if match is None:
        return None
    is_word = match["name"].lower() not in ("f", "omega", "ω")  # which a force may be called too
    try:
        factor = parse_frequency_unit((match["of"] or unit).strip())
    except InputError:
        return float("nan") if is_word and (not match["of"] or match["unit"].strip()[0] in "[(,/_") else None
    _require_one([factor, *_parse_unit(parse_frequency_unit, unit)], f"{name!r} above {unit!r}")
    return factor


def factors_in_header(name: str, unit: str, parse: Callable[[str], float]) -> dict[str, float]:
    """Units stated anywhere in a header or in the line of units below it, each with its factor, by their texts.

    `parse` returns the factor of a unit's text, or raises `InputError`.
    """
    stated = {text: factor for text, factor, _ in units_in_name(name, parse)}
    return stated | {text: factor for text in (name.strip(), unit) for factor in _parse_unit(parse, text)}


def require_axis_unit(
    described: str,
    name: str,
    unit: str,
    known: float | None,
    axis_unit: str,
    factor: float,
    parse: Callable[[str], float],
) -> None:
    """Raise `InputError` if the header of a column states another unit than the option `axis_unit`.

    Parameters
    ----------
    described : str
        Begins the message, as in ``table.csv: column 1 (f) says the unit of its frequencies``.
    name, unit : str
        The header, and the unit in the line below it ("" if absent).
    known : float or None
        Factor of the unit that the header states; None or NaN if it states none of the column's kind.
    axis_unit : str
        The option, for the message.
    factor : float
        Factor of `axis_unit` to Hz or s.
    parse : callable
        Returns the factor of a unit's text, or raises `InputError`.
    """
    stated = factors_in_header(name, unit, parse) if known is None or math.isnan(known) else {"": known}
    for text, other in stated.items():
        if abs(other / factor - 1) > 1e-9:
            remedy = f"give {option_words(axis_unit=text)}" if text else "leave it out"
            raise InputError(f"{described}, but `axis_unit` {axis_unit} was given; {remedy}", "axis_unit")


def bare_unit(cell: str) -> str:
    """A unit without the brackets around it."""
    text = cell.strip()
    return text[1:-1].strip() if re.fullmatch(r"\[[^\[\]]*\]|\([^()]*\)|\{[^{}]*\}|<[^<>]*>", text) else text


def units_in_name(name: str, parse: Callable[[str], T]) -> list[tuple[str, T, bool]]:
    """Units that occur anywhere in a header, as (text, parsed unit, True if brackets show that it is meant as a unit).

    The list is empty for a header of extreme length.

    Parameters
    ----------
    name : str
        The header.
    parse : callable
        Returns the unit of a text, or raises `InputError`, in which case the text is skipped.
    """
    if len(name) > _LONGEST_HEAD:
        return []
    texts = [(next(filter(None, match.groups()), ""), True) for match in _BRACKETED.finditer(name)]
    texts += [(match[1], False) for pattern in _LAST_WORDS if (match := pattern.search(name.strip()))]
    return [
        (text, unit, is_bracketed and text not in _NO_BARE_UNITS)  # a direction or a side may stand in brackets too
        for text, is_bracketed in texts
        if is_bracketed or text not in _NO_BARE_UNITS
        for unit in _parse_unit(parse, text)
    ]


def other_unit_in_name(name: str, parse: Callable[[str], Unit | FrfUnit], kind: str, factor: float) -> str:
    """The unit in the header `name` that differs from the one in which a channel is read; "" if there is none.

    `kind` is the quantity (or kind of FRF) that the channel is read as, and `factor` that to SI. A unit without brackets
    counts only if it is a unit of this kind. `parse` turns the text of a unit into the unit, and raises `InputError` for others.
    """
    for text, stated, is_bracketed in units_in_name(name, parse):
        is_same = stated[0] == kind
        if (is_bracketed and not is_same) or (is_same and abs(stated.factor / factor - 1) > 1e-9):
            return text
    return ""


def is_read_by(text: str, parse: Callable[[str], object]) -> bool:
    """True if a text names a unit for the function `parse`."""
    return bool(_parse_unit(parse, text))


def states_unit(text: str, unit: str, parse: Callable[[str], object]) -> bool:
    """True if a text names the same unit as `unit` does, both read by `parse`."""
    return parse(unit) in _parse_unit(parse, text)


def level_word(text: str) -> str:
    """The word by which a header or a unit says that a column holds levels, means or densities, such as ``dB``; "" for none."""
    match = _LEVEL.search(text[:_LONGEST_HEAD])
    return match[0].strip("/ ") if match else ""


def ending_statistic(name: str) -> str:
    """The statistic of an interval that the last word of a header may stand for, such as ``Max``; "" for none."""
    match = _STATISTIC.search(name_and_unit(name)[0][-_LONGEST_HEAD:])
    return match[1] if match else ""


def marked_statistic(name: str, statistic: str) -> str:
    """The header `name` of a column that holds a statistic of intervals for certain, such as ``Tot``, with that word behind it."""
    return f"{name} statistic {statistic}"


def statistic_word(name: str, names: Sequence[str]) -> str:
    """The word by which the header `name` calls each row a statistic of an interval, such as ``Avg``; "" for none.

    ``Max``, ``Min`` and ``Std`` at the end count only if a second header of the file, of all its `names`, ends with
    such a word: a single ``Pos max`` is a sensor.
    """
    marked = _MARKED.search(name[-_LONGEST_HEAD:])
    if marked:
        return marked[1]
    word = ending_statistic(name)
    if not word:
        return ""
    return word if word.lower() == "avg" or sum(map(bool, map(ending_statistic, names))) > 1 else ""
