"""Decks: marks, numbers in fields, and what is wrong with either."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from structid.core.errors import InputError
from structid.external.deck import Deck, DeckParameter, deck_texts, number_text

E = DeckParameter("E", 2.1e11)


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e90, max_value=1e90), st.integers(8, 24))
def test_a_number_fits_its_field_and_keeps_the_digits_that_fit(value, width):
    text = number_text(value, width)
    assert len(text) <= width
    assert "." in text
    digits = width - 8  # sign, point, and an exponent such as E-100
    assert math.isclose(float(text), value, rel_tol=10.0 ** (-digits + 1) if digits else 1.0, abs_tol=0.0)


@pytest.mark.parametrize(
    "value, width, text",
    [
        (2.1e11, 8, "2.1E11"),
        (210e9, 16, "2.1E11"),
        (0.1, 16, "0.1"),
        (1 / 3, 8, "0.333333"),
        (-1 / 3, 8, "-.333333"),
        (7800.0, 8, "7800."),
        (1.9e11 / 7, 8, "2.714E10"),
        (math.pi, 24, "3.1415926535897931"),
        (0.0, 8, "0."),
    ],
)
def test_numbers_are_short_and_have_a_point(value, width, text):
    assert number_text(value, width) == text


@pytest.mark.parametrize("value, width", [(math.nan, 16), (math.inf, 16), (1e300, 4)])
def test_what_is_no_number_of_a_deck_is_refused(value, width):
    with pytest.raises(InputError):
        number_text(value, width)


def test_marks_become_numbers_and_fields_keep_their_width():
    deck = Deck({"a.bdf": "MAT1    1       {{E:8}}        0.3\n", "b.inc": "E={{ E }}\n"}, [E])
    text = deck.written({"E": 1.9e11 / 7})
    assert text == {"a.bdf": "MAT1    1       2.714E10        0.3\n", "b.inc": "E=2.714E10\n"}
    assert deck.shown({"E": 1.9e11 / 7}) == {"E": 2.714e10}  # the same in all files: what the narrowest field shows


@pytest.mark.parametrize(
    "text, message",
    [
        ("nothing", r"nothing is marked \{\{E\}\}"),
        ("{{E}} {{F}}", r"line 1: \{\{F\}\} has no parameter"),
        ("\n{{E}} {{E!}}", r"line 2: '\{\{E!\}\}' is no mark"),
        ("{{E:3}}", "too narrow"),
    ],
)
def test_a_deck_whose_marks_are_wrong_is_refused_with_the_line(text, message):
    with pytest.raises(InputError, match=message):
        Deck({"m.inp": text}, [E])


def test_values_beyond_bounds_and_binary_decks_are_refused(tmp_path):
    with pytest.raises(InputError, match="`at` of 'E' must lie within `bounds`, 1 to 3, got 4"):
        DeckParameter("E", 2.0, bounds=(1.0, 3.0), at=4.0)
    with pytest.raises(InputError, match="letters, digits and _, as in E_left, got 'E-left'"):
        DeckParameter("E-left", 2.0)
    path = tmp_path / "m.inp"
    path.write_bytes(b"{{E}}\0\1")
    with pytest.raises(InputError, match="binary"):
        deck_texts([path])
