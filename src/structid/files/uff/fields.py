"""Numbers in the fixed columns of Fortran, as universal files have them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from structid.core.arrays import FloatArray

_NUMBER = re.compile(
    rb"[ \t\r\n]*([+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d{1,3}|[+-]\d{3}(?![\d.]))?|[+-]?(?:nan|inf)(?:inity)?)",
    re.IGNORECASE,
)
_PLAIN = re.compile(rb"[0-9+\-.eE \t\r\n]*")
_SHORT_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")


def real_number(text: str) -> float:
    """The number in `text`, one field of a Fortran file: ``1.5E+01``, ``1.5D+01`` or ``1.5-100``.

    Raises
    ------
    ValueError
        If the field is blank or holds something else.
    """
    plain = text.strip().replace("D", "E").replace("d", "e")
    if "e" not in plain.lower():
        plain = _SHORT_EXPONENT.sub(r"E\1", plain)
    return float(plain)


def split_fields(line: str, widths: Sequence[int]) -> list[str]:
    """The fields of a line as texts: its words if there are as many as `widths`, else its columns of these widths.

    Words come first because some writers make a column wider than the format has it, so that the others do not line up.
    """
    words = line.split()
    if len(words) == len(widths):
        return words
    fields, at = [], 0
    for width in widths:
        fields.append(line[at : at + width].strip())
        at += width
    return fields


def integers(line: str, widths: Sequence[int]) -> list[int]:
    """The whole numbers of a line, see `split_fields`; a blank field is 0.

    Raises
    ------
    ValueError
        If a field holds something else.
    """
    return [int(field) if field else 0 for field in split_fields(line, widths)]


def reals(line: str, widths: Sequence[int]) -> list[float]:
    """The numbers of a line, see `split_fields`.

    Raises
    ------
    ValueError
        If a field is blank or holds something else.
    """
    return [real_number(field) for field in split_fields(line, widths)]


def read_reals(text: bytes) -> FloatArray:
    """All numbers in `text`, (n,), also if Fortran left no blank between them or no letter before the exponent.

    Raises
    ------
    ValueError
        If something else stands among them; with the text.
    """
    if _PLAIN.fullmatch(text):
        try:
            return np.array(text.split(), dtype=np.float64)
        except ValueError:
            pass  # numbers without a blank between them, separated below
    numbers, at = [], 0
    end = len(text.rstrip())
    while at < end:
        match = _NUMBER.match(text, at)
        if match is None:
            raise ValueError(f"{text[at : at + 20].decode('ascii', errors='replace').strip()!r} is no number")
        numbers.append(real_number(match[1].decode("ascii")))
        at = match.end()
    return np.array(numbers, dtype=np.float64)
