"""Files of modes told from others by their first bytes."""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

from structid.files import read_start
from structid.modal.formats.csv import is_modes_table
from structid.modal.formats.options import (
    CSV_SUFFIXES,
    F06_SUFFIXES,
    FRD_SUFFIXES,
    JSON_SUFFIXES,
    OP2_SUFFIXES,
    PUNCH_SUFFIXES,
    UFF_SUFFIXES,
)

#: Texts and numbers at most before the frequencies.
_MODES_BEGIN = re.compile(
    rb'\s*\{\s*(?:"(?:title|method|n_modes)":\s*(?:"(?:[^"\\]|\\.)*"|\d+|null),\s*)*"frequency_hz"'
)
#: Datasets of modes or of functions in a universal file, by the line of their number behind a -1; and bytes that are looked at.
_UFF_SETS, _OF_UFF = re.compile(rb"\n  (?:  55|  58|2414)b?[ \r\d]*\n"), 1_000_000
_MOST_SETS = 1000


def holds_modes(path: Path) -> bool:
    """True if the file at `path` holds modes and no responses, judged by its suffix and first bytes.

    False if it cannot be read, except for listings and binary results, which count by their suffix alone.
    """
    suffix = path.suffix.lower()
    if suffix in CSV_SUFFIXES:
        return is_modes_table(path)
    if suffix in PUNCH_SUFFIXES:
        return b"$EIGENVALUE" in _begin(path)
    if suffix in UFF_SUFFIXES:
        begin = b"\n" + _begin(path, _OF_UFF)
        sets = {
            match[0].strip()
            for match in islice(_UFF_SETS.finditer(begin), _MOST_SETS)
            if begin[max(0, match.start() - 80) : match.start()].rstrip(b" \r").endswith(b" -1")
        }
        return bool(sets & {b"55", b"2414"}) and not any(name.startswith(b"58") for name in sets)
    return suffix in (*F06_SUFFIXES, *OP2_SUFFIXES, *FRD_SUFFIXES) or (
        suffix in JSON_SUFFIXES and _MODES_BEGIN.match(_begin(path)) is not None
    )


def _begin(path: Path, count: int = 4096) -> bytes:
    try:
        return read_start(path, count)
    except OSError:
        return b""
