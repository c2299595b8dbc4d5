"""What is made of words of a file takes time with their length, not with its square."""

from __future__ import annotations

import time
from contextlib import suppress

import pytest

from structid.core.dof import parse_dof
from structid.core.errors import InputError
from structid.core.units import parse_unit
from structid.external.marks import _NUMBER
from structid.fem.meshes.nastran import _REGION
from structid.records.formats.csv.recognition import complex_parts, is_number
from structid.records.formats.headers import frequency_factor, level_word, name_and_unit, units_in_name

READERS = (
    parse_dof,
    parse_unit,
    is_number,
    complex_parts,
    frequency_factor,
    name_and_unit,
    level_word,
    _NUMBER.fullmatch,
)
WORDS = ("1" + " " * 50_000 + "!", "1" * 50_000 + "x", "(" * 50_000, "a [" * 20_000, "f " + " " * 50_000, "1 +" * 20_000 + "j",
         "m" + " /" * 20_000, " " * 50_000 + "[m", "1." * 20_000)  # fmt: skip


@pytest.mark.parametrize("read", READERS, ids=lambda read: getattr(read, "__name__", "pattern"))
@pytest.mark.parametrize("word", WORDS, ids=range(len(WORDS)))
def test_long_words_are_read_or_refused_at_once(read, word):
    begun = time.process_time()
    with suppress(InputError):
        read(word)
        units_in_name(word, parse_unit)
    assert time.process_time() - begun < 0.05


def test_comments_of_bulk_data_are_read_at_once():
    line = b"$ Elements and Element Properties for region : a" + b" " * 100_000 + b"x" + b" " * 100_000
    begun = time.process_time()
    assert _REGION.match(line)[1].endswith(b"x")
    assert _REGION.match(b"$ Elements and Element Properties for region :" + b" " * 100_000) is None
    assert time.process_time() - begun < 0.05


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("12 : + RZ ", "12RZ+"),
        ("12_z", "12Z+"),
        ("3 X -", "3X-"),
        (" 7.04 - ", "7RX-"),
        ("12:-Z", "12Z-"),
        ("1 2X", None),
    ],
)
def test_degrees_of_freedom_are_read_as_before(text, told):
    if told is None:
        with pytest.raises(InputError, match="cannot read"):
            parse_dof(text)
    else:
        assert str(parse_dof(text)) == told
