"""Replication in Nastran bulk data: `=`, `==`, `*n`, `=n` and `=(n)`, written out as whole cards."""

from __future__ import annotations

import re
from collections.abc import Callable

from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import as_real

_STEP = re.compile(rb"\*\(?\s*([-+]?[\d.][\d.eEdD+-]*)\s*\)?$")
_REPEAT = re.compile(rb"=\s*\(?\s*(\d+)\s*\)?$")
_WHOLE = re.compile(rb"[-+]?\d+$")
_MOST_CARDS = 5_000_000
_REMEDY = "write the cards out"


def expand_replication(lines: list[bytes], locate: Callable[[int], str]) -> tuple[list[bytes], list[int]]:
    """The lines with replicated cards written out in free field, and the index of the line that each comes from.

    Parameters
    ----------
    lines : list of bytes
    locate : function
        Returns file and line, in words, of an index in `lines`, for messages.

    Raises
    ------
    FileError
        If a replicated line has nothing before it, what it repeats has continuation lines or is no number, or cards are too
        many.
    """
    if not any(_may_replicate(line) for line in lines):
        return lines, list(range(len(lines)))
    expanded: list[bytes] = []
    numbers: list[int] = []
    previous: list[bytes] = []
    steps: list[bytes] = []
    continued, n_repeated = False, 0
    for number, line in enumerate(lines):
        text = line.split(b"$")[0].rstrip()
        head = text[:8].strip()
        repeat = _REPEAT.match(text.strip().rstrip(b", \t"))
        if not text.strip() or (head[:1].isalpha() and not _may_replicate(line)):
            if text.strip():
                previous, steps, continued = _card_fields(text), [], False
            expanded.append(line)
            numbers.append(number)
            continue
        is_replicated = head[:1] == b"=" or head[:1].isalpha()
        if not is_replicated:  # a continuation line
            continued = True
            expanded.append(line)
            numbers.append(number)
            continue
        if not previous or continued:
            problem = "goes on over several lines" if continued else "is not there"
            raise FileError(f"{locate(number)}: {text.decode('latin-1')!r} repeats a card that {problem}; {_REMEDY}")
        if repeat is not None and not steps:
            raise FileError(f"{locate(number)}: {text.decode('latin-1')!r} has no card with steps before it; {_REMEDY}")
        count = int(repeat[1]) if repeat is not None else 1
        n_repeated += count
        if n_repeated > _MOST_CARDS:
            raise FileError(f"{locate(number)}: {n_repeated} cards are repeated up to here; at most {_MOST_CARDS} are")
        steps = steps if repeat is not None else _card_fields(text)
        for _ in range(count):
            previous = _next_card(previous, steps, locate(number))
            expanded.append(b",".join(previous))
            numbers.append(number)
    return expanded, numbers


def _may_replicate(line: bytes) -> bool:
    """True if a line of bulk data may stand for other cards: it begins with `=`, or has a field `=` or `*n`."""
    text = line.split(b"$")[0].strip()
    if text.startswith(b"="):
        return True
    if b"=" not in text and b",*" not in text.replace(b" ", b""):
        return False
    if not text[:1].isalpha() or b"," not in text:
        return False
    return any(field == b"=" or field == b"==" or _STEP.match(field) for field in _card_fields(text)[1:])


def _card_fields(text: bytes) -> list[bytes]:
    """The fields of the card line `text` in free, small or large format, stripped."""
    if b"," in text:
        return [field.strip() for field in text.split(b",")]
    text = text.expandtabs(8)
    if b"*" in text[:8]:
        return [text[:8].strip().rstrip(b"*"), *(text[i : i + 16].strip() for i in range(8, min(len(text), 72), 16))]
    return [text[i : i + 8].strip() for i in range(0, min(len(text), 72), 8)]


def _next_card(previous: list[bytes], steps: list[bytes], where: str) -> list[bytes]:
    """The fields of the card that replication `steps` make of the `previous` one.

    A step is `=` (same field), `==` (all further fields the same), `*n` (field plus n), or a new field. `where` is for
    errors.
    """
    card: list[bytes] = []
    for index, word in enumerate(steps):
        before = previous[index] if index < len(previous) else b""
        if word == b"==":
            return card + previous[index:]
        step = _STEP.match(word)
        if step is not None and index > 0:
            card.append(_add_step(before, step[1], where))
        else:
            card.append(before if word == b"=" else word)
    return card


def _add_step(before: bytes, step: bytes, where: str) -> bytes:
    """The number `before` plus `step`, as text; `where` is for errors."""
    if _WHOLE.match(before or b"0") and _WHOLE.match(step):
        return b"%d" % (int(before or b"0") + int(step))
    try:
        value = as_real(before) + as_real(step)
    except ValueError as error:
        raise FileError(
            f"{where}: a step of {step.decode('latin-1')} on {before.decode('latin-1')!r}, which is no number;"
            f" {_REMEDY}"
        ) from error
    return repr(value).encode()
