"""Meaning of the rows of a matrix, from a file: names, Nastran sets, Ansys mappings, or node and component."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from structid.core.arrays import IntArray
from structid.core.dof import Dof, is_whole_number, parse_dof
from structid.core.errors import FileError, InputError
from structid.fem.importers.bulk_lines import BulkLines, bulk_lines
from structid.fem.importers.imported import dofs_of
from structid.files import atomic_write, damage_told

_SETS = ("ASET", "ASET1", "BSET", "BSET1", "CSET", "CSET1", "QSET", "QSET1", "OMIT")
_CARD = re.compile(r"^(EXTRN|[ABCQ]SET1?)[*,\s]", re.IGNORECASE | re.MULTILINE)
_MAPPING = re.compile(r"^\s*\d+\s+(\d+)\s+(UX|UY|UZ|ROTX|ROTY|ROTZ)\s*$", re.IGNORECASE)
_ANSYS = {"UX": "X", "UY": "Y", "UZ": "Z", "ROTX": "RX", "ROTY": "RY", "ROTZ": "RZ"}
_MOST_MEMBERS = 5_000_000
_PAIR = re.compile(r"^\s*(\d+)[\s,;]+([0-6])\s*$")


def read_numbering(path: Path) -> tuple[Dof, ...]:
    """The degrees of freedom of the rows, in order, from the file at `path`.

    Four kinds of text files, recognized by their content:

    - Nastran bulk data or punch file with ``EXTRN`` (their order is that of the rows) or ``ASET``, ``ASET1``, ``BSET``,
      ``CSET``, ``QSET`` (rows follow grid points, then components, as long as the model is not resequenced);
    - Ansys mapping file of ``HBMAT``: lines of equation, node and ``UX`` to ``ROTZ``;
    - two columns, node and component: ``12 3``;
    - names such as ``12Z``, between blanks, commas or line ends. ``#`` begins a comment here and in the two above.

    Raises
    ------
    FileError
        If the file is no text, or a name cannot be read; with the line.
    """
    with damage_told(path, "a numbering in text", "write one degree of freedom a line"):
        text = path.read_text(encoding="utf-8")
        if _CARD.search(text):
            return _read_nastran_sets(path)
        lines = [(number, line.split("#")[0]) for number, line in enumerate(text.splitlines(), 1)]
        filled = [(number, line) for number, line in lines if line.strip()]
        if any(_MAPPING.match(line) for _, line in filled):
            return _read_mapping(path, filled)
        if filled and all(_PAIR.match(line) for _, line in filled):
            return dofs_of(np.array([[int(word) for word in re.findall(r"\d+", line)] for _, line in filled]))
        return _read_names(path, filled)


def write_numbering(path: Path, table: IntArray) -> None:
    """Write node and component of each row (n_rows, 2) as `read_numbering` reads them, one line a row."""
    with atomic_write(path) as temporary:
        temporary.write_text("".join(f"{node} {component}\n" for node, component in table.tolist()), encoding="ascii")


def _read_names(path: Path, lines: list[tuple[int, str]]) -> tuple[Dof, ...]:
    """Degrees of freedom named by the words of `lines` (number, text), in order; `FileError` for another word.

    Words are such as ``12Z``, between blanks or commas. `path` is for errors.
    """
    dofs = []
    for number, line in lines:
        for word in line.replace(",", " ").split():
            try:
                dofs.append(parse_dof(word))
            except InputError as error:
                raise FileError(f"{path}, line {number}: {error}") from error
    return tuple(dofs)


def _read_mapping(path: Path, lines: list[tuple[int, str]]) -> tuple[Dof, ...]:
    """Degrees of freedom in `lines` (number, text) of an Ansys mapping file; lines before the first are passed over.

    A line is equation, node and UX to ROTZ; raises `FileError`, which names `path`, for another one after the first.
    """
    dofs = []
    for number, line in lines:
        match = _MAPPING.match(line)
        if match:
            dofs.append(Dof(int(match[1]), _ANSYS[match[2].upper()]))
        elif dofs:
            raise FileError(
                f"{path}, line {number}: must be equation, node and UX to ROTZ, got {line.strip()[:40]!r}; other degrees "
                "of freedom cannot be used"
            )
    return tuple(dofs)


def _read_nastran_sets(path: Path) -> tuple[Dof, ...]:
    """Degrees of freedom on EXTRN cards of the file at `path`, in their order.

    Without such cards those of ASET, BSET, CSET, QSET and their lists, sorted by node and component, each once. Raises
    `FileError` for a card that cannot be read.
    """
    ordered = _read_pairs(bulk_lines(path, ("EXTRN",)))
    if ordered:
        return dofs_of(np.array(_single(ordered)))
    pairs = _read_pairs(bulk_lines(path, tuple(name for name in _SETS if not name.endswith("1"))))
    pairs += _read_lists(bulk_lines(path, tuple(name for name in _SETS if name.endswith("1"))))
    return dofs_of(np.array(sorted(set(_single(pairs)))))


def _single(pairs: list[tuple[int, str]]) -> list[tuple[int, int]]:
    """One component each: grid point 3 with 123 becomes three."""
    return [(node, int(digit)) for node, digits in pairs for digit in digits or "0"]


def _card_fields(lines: BulkLines) -> list[list[str]]:
    """Fields of each card in `lines` as texts, without its name and with its continuations; blank fields are ""."""
    cards: list[list[str]] = []
    for i, card in enumerate(lines.card.tolist()):
        width = int(lines.width[i])
        count, last = (8, 72) if width == 8 else (4, 8 + 4 * width)
        text = bytes(lines.buffer[lines.start[i] : min(lines.end[i], lines.start[i] + last)]).decode("latin-1")
        if card == i:
            cards.append([])
        cards[-1].extend(text[8 + width * k : 8 + width * (k + 1)].strip() for k in range(count))
    return cards


def _read_pairs(lines: BulkLines) -> list[tuple[int, str]]:
    """Pairs of grid point and components, such as (12, "123"), from cards in `lines` that alternate them.

    Components are "" if there are none. Raises `FileError` for a grid point or components that cannot be read.
    """
    pairs = []
    for fields in _card_fields(lines):
        for node, components in zip(fields[::2], fields[1::2], strict=False):
            if node:
                pairs.append((_whole(lines, node), _components(lines, components)))
    return pairs


def _read_lists(lines: BulkLines) -> list[tuple[int, str]]:
    """Pairs of grid point and components, such as (12, "123"), from cards of components and then grid points.

    Grid points may be a THRU range. Raises `FileError` for a grid point or components that cannot be read, or a range
    that is empty or too long.
    """
    pairs: list[tuple[int, str]] = []
    for fields in _card_fields(lines):
        components, nodes = _components(lines, fields[0]), [field for field in fields[1:] if field]
        if len(nodes) == 3 and nodes[1] == "THRU":
            first, last = _whole(lines, nodes[0]), _whole(lines, nodes[2])
            if not 0 <= last - first <= _MOST_MEMBERS:
                problem = "too long" if last > first else "empty"
                raise FileError(f"{lines.path}: a set from {first} to {last} is {problem}; correct the card")
            labels = list(range(first, last + 1))
        else:
            labels = [_whole(lines, node) for node in nodes]
        pairs.extend((label, components) for label in labels)
    return pairs


def _whole(lines: BulkLines, text: str) -> int:
    """Label of the grid point `text`; `FileError` if it is no whole number."""
    if not is_whole_number(text):
        raise FileError(f"{lines.path}: must have a grid point's number in its set, got {text!r}; correct the card")
    return int(text)


def _components(lines: BulkLines, text: str) -> str:
    """The digits `text` of components; `FileError` if one is not from 0 to 6."""
    if text.strip("0123456"):
        raise FileError(f"{lines.path}: components must be digits from 0 to 6, got {text!r}; correct the card")
    return text
