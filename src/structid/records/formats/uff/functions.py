"""Functions of a universal file: datasets 58 and 58b, with all that their headers say.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, datasets 58 and 58b.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.errors import FileError
from structid.files.uff.blocks import HEADER_LINES, ORDINATES, UffDataset
from structid.files.uff.fields import integers, read_reals, real_number

_TITLES = 5
_DOF_COLUMNS = (5, 10, 5, 10, 11, 10, 4, 11, 10, 4)
_FORM_COLUMNS = (10, 10, 10, 13, 13, 13)
_LONGEST_LINE = 6
_NO_TEXT = ("", "NONE", "NULL", "UNKNOWN")
_LITTLE, _BIG = 1, 2
_IEEE = 2
_FLOATING = {1: "DEC VMS (VAX)", 3: "IBM 5/370"}


@dataclass(frozen=True)
class Characteristics:
    """Header fields of the abscissa, or of one side of the ordinate.

    Attributes
    ----------
    number : int
        Specific data type.
    exponents : (int, int)
        Of length and force; they count where the type is general (1).
    label : str
        Unit, "" where none is said.
    """

    number: int
    exponents: tuple[int, int]
    label: str


@dataclass(frozen=True, eq=False)
class Dataset58:
    """One dataset 58.

    Attributes
    ----------
    ordinal : int
        Its number among the functions of the file, from 1.
    kind : int
        Function type.
    titles : str
        Its five lines of text.
    response, reference : (int, int)
        Node and direction.
    is_even : bool
        Whether the abscissa is a start and a step.
    abscissa, ordinate, denominator : Characteristics
    axis : (n_points,) float array
        Abscissa, as the file has it.
    digits : (n_points,) float array
        Size of the last digit of each abscissa as it was written.
    values : (n_points,) float or complex array
        Ordinate, as the file has it.
    entities : (str, str)
        Names beside the nodes of response and reference, "" where there is none: of a component, or of a channel.
    """

    ordinal: int
    kind: int
    titles: str
    response: tuple[int, int]
    reference: tuple[int, int]
    is_even: bool
    abscissa: Characteristics
    ordinate: Characteristics
    denominator: Characteristics
    axis: FloatArray
    digits: FloatArray
    values: FloatArray | ComplexArray
    entities: tuple[str, str] = ("", "")


def require_one_component(path: Path, functions: Sequence[Dataset58]) -> None:
    """Raise `FileError` if a node number belongs to several components, by the names stored beside the nodes.

    A name beside several different nodes counts as a component; a name beside a single node is a channel label.
    """
    nodes_of: dict[str, set[int]] = {}
    for function in functions:
        for name, (node, _) in zip(function.entities, (function.response, function.reference), strict=True):
            if name:
                nodes_of.setdefault(name, set()).add(node)
    components = {name: nodes for name, nodes in nodes_of.items() if len(nodes) > 1}
    for first, nodes in components.items():
        for other, others in nodes_of.items():
            if other != first and nodes & others:
                raise FileError(
                    f"{path}: node {min(nodes & others)} stands beside the names {first} and {other}, as of two components, which"
                    " structid does not tell apart; give their nodes numbers of their own in the export, or choose functions by"
                    " their numbers with `columns` and say by `channels` (`outputs` and `inputs`) what they are"
                )


def read_function(path: Path, block: UffDataset, ordinal: int) -> Dataset58:
    """The function stored in a block of dataset 58 or 58b; `ordinal` is its number among the functions of the file, from 1.

    Raises
    ------
    FileError
        If the header is damaged, the number format is not readable (VAX, IBM mainframe), points are missing, or values are
        not finite; only samples of time responses may be NaN or infinite.
    """
    where = f"{path}: dataset {block.ordinal} (58)"
    lines = block.lines
    if len(lines) < HEADER_LINES - 1 + (not block.values_at):
        raise FileError(f"{where} ends within its header; the file is truncated, export it again")
    try:
        dof = _parse_record_6(lines[_TITLES])
        form = lines[_TITLES + 1]
        ordinate, points, even = (
            integers(form, _FORM_COLUMNS[:3]) if len(form.split()) < 6 else map(int, form.split()[:3])
        )
        start, step = (real_number(text) if text else 0.0 for text in _form_reals(form))
        item, per_value = ORDINATES[ordinate]
        heads = [_parse_characteristics(line) for line in lines[_TITLES + 2 : _TITLES + 5]]
    except (ValueError, KeyError, IndexError) as error:
        raise FileError(f"{where} has a damaged header ({error}); export it again") from error
    if points < 1 or even not in (0, 1):
        raise FileError(f"{where} has {points} points and spacing {even} (0 or 1) in record 7; export it again")
    columns = per_value + (0 if even else 1)
    if block.values_at:
        abscissa, table = _binary_values(where, block, points, per_value, item)
    else:
        table = _text_values(where, block, points, columns)
        abscissa, table = (None, table) if even else (table[:, 0], table[:, 1:])
    values = table[:, 0] + 1j * table[:, 1] if per_value == 2 else table[:, 0]
    axis = start + step * np.arange(points) if abscissa is None else abscissa
    if not np.isfinite(axis).all() or not (dof.kind == 1 or np.isfinite(values).all()):
        raise FileError(f"{where} holds NaN or infinite values; repair or export it again")
    return Dataset58(
        ordinal=ordinal,
        kind=dof.kind,
        titles=" ".join(line.strip() for line in lines[:_TITLES]),
        response=dof.response,
        reference=dof.reference,
        is_even=even == 1,
        abscissa=heads[0],
        ordinate=heads[1],
        denominator=heads[2],
        axis=axis,
        digits=_last_digits(axis, _axis_bytes(block, points, per_value * item)),
        values=values,
        entities=dof.entities,
    )


@dataclass(frozen=True)
class _Dof:
    kind: int
    response: tuple[int, int]
    reference: tuple[int, int]
    entities: tuple[str, str]


def _parse_record_6(line: str) -> _Dof:
    """Function type, (node, direction) of response and of reference, and both entity names, from record 6 of dataset 58.

    Raises `ValueError` if the text `line` is out of its columns.
    """
    words = line.split()
    if len(words) != len(_DOF_COLUMNS):  # a name is blank, or has blanks in it
        words, column = [], 0
        for width in _DOF_COLUMNS:
            words.append(line[column : column + width].strip())
            column += width
            if line[column - 1 : column].strip() and line[column : column + 1].strip() and width not in (5, 10):
                raise ValueError(f"record 6 is out of its columns: {line.rstrip()!r}")
    numbers = [int(words[i]) if words[i] else 0 for i in (0, 5, 6, 8, 9)]
    response, reference = ("" if words[i].upper() in _NO_TEXT else words[i] for i in (4, 7))
    return _Dof(numbers[0], (numbers[1], numbers[2]), (numbers[3], numbers[4]), (response, reference))


def _form_reals(line: str) -> list[str]:
    """Texts of start and step of the abscissa in a line of record 7; "" if blank."""
    words = line.split()
    return words[3:5] if len(words) == len(_FORM_COLUMNS) else [line[30:43].strip(), line[43:56].strip()]


def _parse_characteristics(line: str) -> Characteristics:
    """Data type, unit exponents and unit label ("" if none) in a line of record 8, 9 or 10 of dataset 58."""
    numbers = [int(line[column : column + width] or 0) for column, width in ((0, 10), (10, 5), (15, 5))]
    label = line[47:67].strip()
    if line[25:26].strip() or line[46:47].strip():  # a long axis label pushed the unit out of its columns
        parts = [part.strip() for part in line[25:].split("  ") if part.strip()]
        label = parts[1] if len(parts) == 2 else line[25:].strip()
    return Characteristics(numbers[0], (numbers[1], numbers[2]), "" if label.upper() in _NO_TEXT else label)


def _text_values(where: str, block: UffDataset, points: int, columns: int) -> FloatArray:
    """Values of an ASCII dataset, (`points`, `columns`); zeros that fill up the last line are dropped.

    `where` names the dataset in errors. Raises `FileError` if numbers are missing or left over.
    """
    body = block.content.split(b"\n", HEADER_LINES - 1)[HEADER_LINES - 1]
    try:
        numbers = read_reals(body)
    except ValueError as error:
        raise FileError(
            f"{where} has something other than numbers among its values ({error}); export it again"
        ) from error
    wanted = points * columns
    filling = numbers[wanted:]
    if numbers.size < wanted or len(filling) >= _LONGEST_LINE or np.any(filling != 0):
        raise FileError(
            f"{where} has {numbers.size // columns} of its {points} points; the file is truncated or damaged"
        )
    return numbers[:wanted].reshape(points, columns)


def _binary_values(
    where: str, block: UffDataset, points: int, per_value: int, item: int
) -> tuple[FloatArray | None, FloatArray]:
    """Abscissa (`points`,) and values (`points`, `per_value`) of a binary dataset 58b; the abscissa is None if evenly spaced.

    `where` names the dataset in errors; each value has `per_value` numbers (2 if complex) of `item` bytes. Raises `FileError` if
    the form of its numbers is not read.
    """
    words = block.head.split()
    try:
        order, floating, n_lines = (int(word) for word in words[1:4])
    except ValueError as error:
        raise FileError(f"{where} does not say how its bytes are to be read ({error}); export it again") from error
    if floating != _IEEE:
        kind = _FLOATING.get(floating, f"code {floating}")
        raise FileError(
            f"{where} has binary numbers of {kind}, which are not read; export it as ASCII, or as IEEE 754 (code 2)"
        )
    if order not in (_LITTLE, _BIG) or n_lines != HEADER_LINES - 1:
        raise FileError(
            f"{where} has byte order {order} (1 or 2) and {n_lines} header lines (11) in its first line; export it again"
        )
    sign, body = "<" if order == _LITTLE else ">", block.content[block.values_at :]
    width = _axis_bytes(block, points, per_value * item)
    fields = [("value", f"{sign}f{item}", (per_value,))]
    table = np.frombuffer(body, np.dtype([("axis", f"{sign}f{width}"), *fields] if width else fields))
    return (table["axis"].astype(float) if width else None), table["value"].astype(float)


def _axis_bytes(block: UffDataset, points: int, value_bytes: int) -> int:
    """Bytes of each abscissa value in a binary dataset; 0 for ASCII, and for an even abscissa, of which none are stored.

    `value_bytes` are those of an ordinate value.
    """
    return (len(block.content) - block.values_at) // points - value_bytes if block.values_at else 0


def _last_digits(axis: FloatArray, item: int) -> FloatArray:
    """Resolution of each number of an axis, (n_points,): that of a float of `item` bytes, or the sixth digit if `item` is 0."""
    if item:
        return np.spacing(np.abs(axis).astype(f"f{item}")).astype(float)
    size = np.abs(axis)
    power = np.floor(np.log10(np.where(size > 0, size, 1.0)))
    return np.where(size > 0, 10.0 ** (power - 5), 0.0)
