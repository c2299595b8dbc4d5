"""Numbers in the fixed columns of a text file, many at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray

Bytes = NDArray[np.uint8]

_BLANK, _PLUS, _MINUS, _POINT, _E = (ord(c) for c in " +-.E")
_CHUNK = 200_000
_LARGEST = 2**59  # ten times it, and a digit, is still a 64-bit integer


class FieldError(ValueError):
    """A field is no number; `index` counts the fields from 0."""

    def __init__(self, index: int, text: str) -> None:
        super().__init__(text)
        self.index = index
        self.text = text


def fields_at(buffer: Bytes, start: IntArray, end: IntArray, width: int) -> Bytes:
    """Table (n, width) of `width` characters from each byte `start` (n,) of `buffer`; blanks from `end` (n,) on."""
    if not len(buffer):
        return np.full((len(start), width), _BLANK, dtype=np.uint8)
    offsets = start[:, None] + np.arange(width)
    inside = offsets < np.minimum(end, len(buffer))[:, None]
    return np.where(inside, buffer[np.minimum(offsets, len(buffer) - 1)], np.uint8(_BLANK))


def chunks(n: int) -> Iterator[slice]:
    """Slices of at most 200,000 that divide 0 to `n`, so that no field table becomes large; none if `n` is 0."""
    for start in range(0, n, _CHUNK):
        yield slice(start, min(start + _CHUNK, n))


def is_blank(fields: Bytes) -> NDArray[np.bool_]:
    """True for each field that holds only blanks, tabs and line ends, (n,)."""
    return np.asarray((fields <= _BLANK).all(axis=1))


def real_numbers(fields: Bytes, must_be_finite: bool = True) -> FloatArray:
    """Real numbers from text fields (n, width) of bytes, (n,): 1.5, 1.5E+03, 1.5D+03 or Nastran's 1.5+3; 0 where blank.

    Raises
    ------
    FieldError
        At the first field that is no number, or no finite one if it `must_be_finite`, with its index and text.
    """
    if not len(fields):
        return np.zeros(0)
    if (fields == ord("_")).any():  # Python reads 1_000
        raise _field_error(fields, int(np.argmax((fields == ord("_")).any(axis=1))))
    upper = np.where((fields == ord("D")) | (fields == ord("d")) | (fields == ord("e")), np.uint8(_E), fields)
    before = upper[:, :-1]
    signed = (upper[:, 1:] == _PLUS) | (upper[:, 1:] == _MINUS)
    short = signed & (((before >= ord("0")) & (before <= ord("9"))) | (before == _POINT))
    rows = np.flatnonzero(short.any(axis=1))
    width = fields.shape[1]
    if rows.size:
        widened = np.full((len(upper), width + 1), _BLANK, dtype=np.uint8)
        widened[:, :width] = upper
        sign_column = 1 + np.argmax(short[rows], axis=1)[:, None]
        column = np.arange(width + 1)
        shifted = widened[rows][:, np.maximum(column - 1, 0)]
        widened[rows] = np.where(
            column < sign_column, widened[rows], np.where(column == sign_column, np.uint8(_E), shifted)
        )
        upper, width = widened, width + 1
    upper[is_blank(upper), 0] = ord("0")
    text = np.ascontiguousarray(upper).view(f"S{width}").ravel()
    try:
        numbers = text.astype(np.float64)
    except ValueError:
        raise _first_bad(text, fields) from None
    if must_be_finite and not np.isfinite(numbers).all():
        raise _field_error(fields, int(np.argmin(np.isfinite(numbers))))
    return numbers


def as_real(word: bytes) -> float:
    """Real number in one field; raises `FieldError` if it holds none."""
    fields = np.frombuffer(word.strip().ljust(1), dtype=np.uint8)[None, :]
    return float(real_numbers(fields)[0])


def _first_bad(text: NDArray[np.bytes_], fields: Bytes) -> FieldError:
    return _field_error(fields, next(i for i, word in enumerate(text.tolist()) if not _is_real(word)))


def _field_error(fields: Bytes, index: int) -> FieldError:
    return FieldError(index, bytes(fields[index]).decode("latin-1").strip())


def _is_real(word: bytes) -> bool:
    """True if Python reads `word` as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def whole_numbers(fields: Bytes) -> IntArray:
    """Whole numbers from text fields (n, width) of bytes, (n,); 0 where blank.

    Raises
    ------
    FieldError
        At the first field that is no whole number, or too large a one, with its index and text.
    """
    value = np.zeros(len(fields), dtype=np.int64)
    negative = np.zeros(len(fields), dtype=bool)
    state = np.zeros(len(fields), dtype=np.int8)  # 0 before the number, 1 in it, 2 behind it
    bad = np.zeros(len(fields), dtype=bool)
    has_digit = np.zeros(len(fields), dtype=bool)
    for column in fields.T:
        digit = (column >= ord("0")) & (column <= ord("9"))
        blank = column <= _BLANK
        sign = (column == _PLUS) | (column == _MINUS)
        bad |= (digit & (state == 2)) | (sign & (state > 0)) | ~(digit | blank | sign)
        negative |= column == _MINUS
        has_digit |= digit
        bad |= digit & (value > _LARGEST)
        value = np.where(digit & ~bad, 10 * value + (column - ord("0")), value)
        state = np.where(digit | sign, np.int8(1), np.where(blank & (state == 1), np.int8(2), state))
    bad |= (state > 0) & ~has_digit  # a sign alone
    if bad.any():
        raise _field_error(fields, int(np.argmax(bad)))
    return np.where(negative, -value, value)
