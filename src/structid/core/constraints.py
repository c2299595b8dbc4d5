"""Declared constraints of fields and arguments: limits and choices in annotations, words in docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from numbers import Real
from types import MappingProxyType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin, get_type_hints

from structid.core.errors import InputError


@dataclass(frozen=True)
class Limits:
    """Limits of a number; `least` and `most` themselves are allowed, `above` and `below` are not."""

    least: float | None = None
    above: float | None = None
    most: float | None = None
    below: float | None = None

    @property
    def is_open(self) -> bool:
        """True if both ends are open."""
        return self.above is not None and self.below is not None

    @property
    def words(self) -> str:
        """The limits in words: ``at least 0``, ``above 0 and at most 1``, ``greater than 0`` or ``between -1 and 0.5``.

        The last has both ends excluded; "" without limits.
        """
        if self.is_open:
            return f"between {self.above:g} and {self.below:g}"
        alone = self.most is None and self.below is None
        low = "" if self.least is None else f"at least {self.least:g}"
        low = low if self.above is None else f"{'greater than' if alone else 'above'} {self.above:g}"
        high = "" if self.most is None else f"at most {self.most:g}"
        high = high if self.below is None else f"less than {self.below:g}"
        return " and ".join(part for part in (low, high) if part)

    def hold(self, value: float) -> bool:
        """True if `value` lies within the limits."""
        return (
            (self.least is None or value >= self.least)
            and (self.above is None or value > self.above)
            and (self.most is None or value <= self.most)
            and (self.below is None or value < self.below)
        )


Positive = Annotated[float, Limits(above=0)]
NotNegative = Annotated[float, Limits(least=0)]
Count = Annotated[int, Limits(least=1)]
#: A whole number of at least 0.
Number = Annotated[int, Limits(least=0)]


def _types(owner: Callable[..., object]) -> Mapping[str, object]:
    return MappingProxyType(get_type_hints(owner, include_extras=True))


#: Annotation of every field of a dataclass, or argument of a function, by its name.
declared_types: Callable[[Callable[..., object]], Mapping[str, object]] = cache(_types)


def parameter_descriptions(owner: Callable[..., object]) -> dict[str, str]:
    """Description of each parameter or attribute, by name, in the numpydoc docstring of `owner`, a function or class.

    Those of a class come after, and replace, those of its bases; "" for names without description. Lines are joined by
    blanks.
    """
    descriptions: dict[str, str] = {}
    for part in reversed(owner.__mro__) if isinstance(owner, type) else (owner,):
        text = inspect.cleandoc(part.__doc__ or "")
        for section in re.findall(r"^(?:Parameters|Attributes)\n-+\n((?:.+\n?)*)", text, re.MULTILINE):
            names: list[str] = []
            for line in section.splitlines():
                if line.startswith(" "):
                    descriptions.update({name: f"{descriptions[name]} {line.strip()}".strip() for name in names})
                else:
                    names = line.partition(" : ")[0].split(", ")
                    descriptions.update(dict.fromkeys(names, ""))
    return descriptions


def alternatives(annotation: object) -> tuple[object, ...]:
    """The parts of a union without None; the annotation itself where it is none."""
    if get_origin(annotation) in (Union, UnionType):
        return tuple(part for part in get_args(annotation) if part is not type(None))
    return (annotation,)


def describe_type(annotation: object) -> str:
    """An annotation in the words of a docstring: ``float``, ``int or str``, ``{"a", "b"}``.

    A text in an `Annotated` stands for its type; None is left out.
    """
    if get_origin(annotation) is Annotated:
        inner, *marks = get_args(annotation)
        return next((mark for mark in marks if isinstance(mark, str)), describe_type(inner))
    if get_origin(annotation) is Literal:
        return "{" + ", ".join(f'"{name}"' for name in get_args(annotation)) + "}"
    parts = [getattr(part, "__name__", str(part)) for part in alternatives(annotation)]
    return " or ".join(parts)


def constraint_violation(annotation: object, value: object) -> str:
    """The choice, limit or type in `annotation` that `value` breaks, as ``must be ..., got ...``; "" if it breaks none.

    Limits are those of an `Annotated`, choices those of a `Literal`; a text where only numbers are allowed is wrong.
    None breaks none.
    """
    if value is None:
        return ""
    choices: list[object] = []
    others: list[type] = []
    for part in alternatives(annotation):
        inner, *marks = get_args(part) if get_origin(part) is Annotated else (part,)
        limits = next((mark for mark in marks if isinstance(mark, Limits)), None)
        if limits is not None and isinstance(value, Real) and not limits.hold(float(value)):
            return f"must {'lie' if limits.is_open else 'be'} {limits.words}, got {float(value):g}"
        if get_origin(inner) is Literal:
            choices += get_args(inner)
        elif isinstance(inner, type):
            others.append(Real if inner in (int, float) else inner)
    if isinstance(value, str) and not choices and others and all(kind is Real for kind in others):
        return f"must be a number, got {value!r}"
    if choices and value not in choices and not isinstance(value, tuple(others)):
        named = [
            *map(str, choices),
            *("a number" if choice_type is Real else choice_type.__name__ for choice_type in others),
        ]
        return f"must be one of {', '.join(named)}, got {value!r}"
    return ""


def require_declared(thing: object) -> None:
    """Raise `InputError` for the first field of a dataclass instance whose value its annotation does not allow.

    Limits, choices and text in place of numbers are checked in `thing`; None is always allowed.
    """
    for name, annotation in declared_types(type(thing)).items():
        problem = constraint_violation(annotation, getattr(thing, name))
        if problem:
            raise InputError(f"`{name}` {problem}")


def require_band(
    name: str,
    band: Sequence[float],
    *,
    is_zero_allowed: bool = True,
    is_line_allowed: bool = False,
    is_open_allowed: bool = True,
) -> None:
    """Raise `InputError` about the option `name` unless `band`, two frequencies in Hz, rises from 0 Hz or more.

    Without `is_zero_allowed` it must begin above 0 Hz; with `is_line_allowed` both ends may be one frequency; without
    `is_open_allowed` the upper end must be finite.
    """
    ends = tuple(band) if isinstance(band, Iterable) else ()
    if len(ends) != 2 or not all(isinstance(end, Real) for end in ends):
        raise InputError(
            f"`{name}` must have two frequencies in Hz for each range, such as (5.0, 20.0), got {band!r}", name
        )
    low, high = ends
    begins_right = low >= 0 if is_zero_allowed else low > 0
    if not (begins_right and (low < high or (is_line_allowed and low == high))):
        least = "0 Hz or more" if is_zero_allowed else "more than 0 Hz"
        most = "the same or a higher frequency" if is_line_allowed else "a higher frequency"
        raise InputError(f"`{name}` must run from {least} to {most}, got {low:g} to {high:g} Hz", name)
    if high == float("inf") and not is_open_allowed:
        raise InputError(
            f"`{name}` must end at a finite frequency, got inf Hz; give the highest that is wanted, for all lines of a"
            " record its last or any above it",
            name,
        )


def split_commas(text: str) -> tuple[str, ...]:
    """The parts of a text between its commas, without blanks around them; empty ones are left out."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def part_of_one(value: float | str) -> float:
    """`value` as a fraction, from a number or a text such as ``0.01`` or ``1 %``; NaN for any other text."""
    text = str(value).strip()
    try:
        return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        return float("nan")
