"""What annotations and docstrings declare: limits in words, texts by name, values that are refused."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pytest

from structid.core.constraints import (
    Count,
    Limits,
    NotNegative,
    Positive,
    describe_type,
    parameter_descriptions,
    require_band,
    require_declared,
)
from structid.core.errors import InputError


@pytest.mark.parametrize(
    ("limits", "words", "inside", "outside"),
    [
        (Limits(least=0), "at least 0", [0, 1e9], [-1e-9]),
        (Limits(above=0), "greater than 0", [1e-9], [0, -1]),
        (Limits(most=1), "at most 1", [1, -5], [1.001]),
        (Limits(above=0, most=0.01), "above 0 and at most 0.01", [0.01], [0, 0.011]),
        (Limits(least=0, below=1), "at least 0 and less than 1", [0, 0.99], [1, -0.1]),
        (Limits(above=-1, below=0.5), "between -1 and 0.5", [0.49], [-1, 0.5]),
        (Limits(least=0), "at least 0", [], [float("nan")]),
    ],
)
def test_limits_say_and_hold_the_same(limits, words, inside, outside):
    assert limits.words == words
    assert all(limits.hold(value) for value in inside)
    assert not any(limits.hold(value) for value in outside)


def test_text_is_no_number():
    @dataclass(frozen=True)
    class Sizes:
        part: NotNegative | None = None
        name: str = ""

    require_declared(Sizes(0.1, "1 %"))
    with pytest.raises(InputError, match="`part` must be a number, got '1 %'"):
        require_declared(Sizes("1 %"))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Base:
    """A base: with a colon.

    Parameters
    ----------
    width, height : float
        Of the box,
        m.
    """

    width: Positive
    height: NotNegative = 0.0


@dataclass(frozen=True)
class Box(Base):
    """A box.

    - ``open``: of a list
      that is no parameter

    Parameters
    ----------
    kind : {"open", "closed"}
        What it is
    height : float
        Its own words.
    count : int, optional

    Notes
    -----
    height : is not meant here
    """

    kind: Literal["open", "closed"] = "open"
    count: Count | None = None


def test_words_are_those_of_the_docstring_and_of_its_bases():
    words = parameter_descriptions(Box)
    assert words["width"] == "Of the box, m."
    assert words["height"] == "Its own words."
    assert words["kind"] == "What it is"
    assert words["count"] == ""
    assert set(words) == {"width", "height", "kind", "count"}
    assert parameter_descriptions(Base)["height"] == "Of the box, m."


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Box(0.0), "`width` must be greater than 0, got 0"),
        (lambda: Box(1.0, -1), "`height` must be at least 0, got -1"),
        (lambda: Box(1.0, kind="shut"), "`kind` must be one of open, closed, got 'shut'"),
        (lambda: Box(1.0, count=0), "`count` must be at least 1, got 0"),
    ],
)
def test_a_value_that_is_not_allowed_is_told_by_its_field(made, words):
    with pytest.raises(InputError) as error:
        require_declared(made())
    assert str(error.value) == words
    require_declared(Box(1.0))


def test_types_are_said_as_docstrings_do():
    assert describe_type(Literal["a", "b"]) == '{"a", "b"}'
    assert describe_type(Annotated[float, Limits(least=0)]) == "float"
    assert describe_type(Annotated[list, "(n,) array"]) == "(n,) array"
    assert describe_type(float | None) == "float"


@pytest.mark.parametrize(
    ("band", "allowed", "words"),
    [
        (5.0, {}, r"^`bands` must have two frequencies in Hz for each range, such as \(5.0, 20.0\), got 5.0$"),
        ((5.0,), {}, r"got \(5.0,\)$"),
        ("25", {}, "got '25'$"),
        (("2", "5"), {}, "must have two frequencies"),
        ((5.0, 5.0), {}, "from 0 Hz or more to a higher frequency, got 5 to 5 Hz"),
        ((5.0, 4.0), {"is_line_allowed": True}, "to the same or a higher frequency, got 5 to 4 Hz"),
        ((0.0, 4.0), {"is_zero_allowed": False}, "from more than 0 Hz to a higher"),
        ((5.0, float("inf")), {"is_open_allowed": False}, "must end at a finite frequency, got inf Hz"),
    ],
)
def test_a_band_that_is_none_is_refused_with_its_name(band, allowed, words):
    with pytest.raises(InputError, match=words) as told:
        require_band("bands", band, **allowed)
    assert told.value.option == "bands"


def test_a_band_may_be_an_array_and_open_or_a_line_where_that_is_allowed():
    require_band("band", np.array([5.0, np.inf]))
    require_band("band", [5, 5], is_line_allowed=True)
