"""Functions of a universal file: datasets 58 and 58b with all that their headers say, their abscissa, and the weightings of 1858.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, datasets 58 and 58b.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import plural
from structid.core.errors import FileError, InputError
from structid.core.units import parse_frequency_unit, parse_time_unit
from structid.files.uff.datasets import HEADER_LINES, ORDINATES, UffDataset, integers, read_reals, real_number
from structid.records.formats.options import ReadOptions, option_words

_TITLES = 5
_DOF_COLUMNS = (5, 10, 5, 10, 11, 10, 4, 11, 10, 4)
_FORM_COLUMNS = (10, 10, 10, 13, 13, 13)
_LONGEST_LINE = 6
_NO_TEXT = ("", "NONE", "NULL", "UNKNOWN")
_LITTLE, _BIG = 1, 2
_IEEE = 2
_FLOATING = {1: "DEC VMS (VAX)", 3: "IBM 5/370"}
_AxisKind = Literal["frequencies", "times"]
_WEIGHTINGS = {1: "A", 2: "B", 3: "C", 4: "D"}
_EXPONENTIAL = (4, 6)
#: Decades between the numbers of one function that are not believed: bytes in the wrong order give any exponent.
_WIDEST = 40.0
#: Different numbers of one function at least that tell its byte order: fewer are of one size by chance.
_FEWEST_TELLING = 8


@dataclass(frozen=True)
class Characteristics:
    """Header fields of the abscissa, or of one side of the ordinate.

    Attributes
    ----------
    number : int
        Specific data type.
    exponents : (int, int)
        Exponents of length and of force in the unit; they count where the type is general (1).
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
        Number of the dataset among the functions of the file, from 1.
    kind : int
        Function type.
    titles : str
        The five lines of text that head the dataset.
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
        Names, of a component or of a channel, that stand beside the nodes of response and reference; "" where there is none.
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
    """Raise `FileError` if a node number of `functions` is in several components, by names stored beside the nodes.

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
    """Data type, exponents of length and force, and unit label ("" if none) in a line of records 8 to 10 of dataset 58.

    Blank columns count as 0; `ValueError` if a column of numbers holds none.
    """
    numbers = [int(line[column : column + width] or 0) for column, width in ((0, 10), (10, 5), (15, 5))]
    label = line[47:67].strip()
    if line[25:26].strip() or line[46:47].strip():  # a long axis label pushed the unit out of its columns
        parts = [part.strip() for part in line[25:].split("  ") if part.strip()]
        label = parts[1] if len(parts) == 2 else line[25:].strip()
    return Characteristics(numbers[0], (numbers[1], numbers[2]), "" if label.upper() in _NO_TEXT else label)


def _text_values(where: str, block: UffDataset, points: int, columns: int) -> FloatArray:
    """Values of the ASCII dataset `block`, (`points`, `columns`); zeros that fill up the last line are dropped.

    `points` and `columns` are their numbers as the header says, `where` names the dataset in errors. Raises `FileError`
    if numbers are missing or left over.
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
    """Abscissa (`points`,) and values (`points`, `per_value`) of `block`, a binary dataset 58b.

    The abscissa is None if evenly spaced; each value has `per_value` numbers (2 if complex) of `item` bytes. `where`
    names the dataset in errors. Raises `FileError` if the form of its numbers, or their byte order, is not as its first
    line says.
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
    swapped = table["value"].byteswap()
    is_swapped = _decades(table["value"]) > _WIDEST and _decades(swapped) < _WIDEST / 2
    if is_swapped and np.unique(swapped).size >= _FEWEST_TELLING:
        raise FileError(
            f"{where} says byte order {order} in its first line, but its numbers are of one size in the other order only; write"
            f" {3 - order} there, or export it again"
        )
    return (table["axis"].astype(float) if width else None), table["value"].astype(float)


def _decades(values: FloatArray) -> float:
    """Decades between the smallest and the largest size of the finite `values` other than 0; 0 if there are none."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0)]).astype(float)
    return float(np.ptp(np.log10(sizes))) if sizes.size else 0.0


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


class _Axis(NamedTuple):
    """Rules to read an axis: its unit's reader, the meaning of a type without a label, and types that a label can explain."""

    parse: Callable[[str], float]
    units: dict[int, str]
    unsaid: tuple[int, ...]


_AXES: dict[_AxisKind, _Axis] = {
    "frequencies": _Axis(parse_frequency_unit, {18: "Hz", 19: "rpm"}, (0, 1)),
    "times": _Axis(parse_time_unit, {17: "s"}, (0, 1)),
}


_TYPES = {17: "time", 18: "frequency", 19: "rpm", 20: "order"}


def _axis_unit(path: Path, function: Dataset58, kind: _AxisKind, options: ReadOptions) -> tuple[float, str]:
    """Factor from the abscissa of a function to Hz or s, and a note on its unit ("" for Hz or s by the label).

    The unit is that of the option `axis_unit` or of the label; frequencies (type 18) and times (17) without either are in
    Hz and s, as the format defines. `kind` is "frequencies" or "times".

    Raises
    ------
    FileError
        If the abscissa is of another type, or nothing states the unit.
    InputError
        If the option contradicts the file.
    """
    axis, head = _AXES[kind], function.abscissa
    where = f"{path}: function {function.ordinal}"
    if head.number not in (*axis.units, *axis.unsaid):
        words = _TYPES.get(head.number, f"type {head.number}")
        hint = " (orders are multiples of a speed of rotation)" if head.number == 20 else ""
        raise FileError(f"{where} has an abscissa of {words}{hint}, not of {kind}; export it over {kind}")
    try:
        by_label = axis.parse(head.label) if head.label else None
    except InputError as error:
        raise FileError(f"{where} has an abscissa of {kind} whose unit label cannot be used: {error}; or export it in one of"
                        " these") from error  # fmt: skip
    if head.number == 19 and by_label not in (None, parse_frequency_unit("rpm")):
        raise FileError(
            f"{where} has an abscissa of rpm by its type and {head.label!r} by its label; correct one of them"
        )
    if options.axis_unit:
        by_user = axis.parse(options.axis_unit)
        if by_label is not None and not np.isclose(by_label, by_user, rtol=1e-9):
            raise InputError(
                f"{where} says that its {kind} are in {head.label}, but `axis_unit` {options.axis_unit} was given; leave it out",
                "axis_unit",
            )
        return by_user, f"{kind} in {options.axis_unit} as given"
    if by_label is not None:
        return by_label, "" if by_label == 1 else f"{kind} in {head.label}"
    if head.number in axis.units:
        unit = axis.units[head.number]
        return axis.parse(unit), f"{kind} in {unit}, as the format has them"
    example = "Hz" if kind == "frequencies" else "s"
    raise FileError(f"{where} does not say the unit of its {kind}; give {option_words(axis_unit=example)}")


def one_axis_unit(path: Path, functions: list[Dataset58], kind: _AxisKind, options: ReadOptions) -> tuple[float, str]:
    """Factor from the common abscissa of `functions` to Hz or s, and a note on its unit ("" for Hz or s by the label).

    `kind` is "frequencies" or "times"; the option `axis_unit` gives a unit that labels do not state.

    Raises
    ------
    FileError
        If the functions have different units, or one has another abscissa or states no unit.
    InputError
        If the option contradicts the file.
    """
    units = [_axis_unit(path, function, kind, options) for function in functions]
    for function, unit in zip(functions, units, strict=True):
        if unit[0] != units[0][0]:
            raise FileError(
                f"{path}: functions {functions[0].ordinal} and {function.ordinal} have {kind} in different units; export all alike"
            )
    return units[0]


def qualifier_words(path: Path, blocks: Sequence[UffDataset], ordinals: Collection[int]) -> str:
    """Note on exponential windows that dataset 1858 states for the functions `ordinals`; "" if there are none.

    `ordinals` count the functions of the file from 1. `blocks` are all datasets of the file; one of number 1858 belongs
    to the function before it, or behind it where the first one stands before all functions.

    Raises
    ------
    FileError
        If one of these functions has an acoustic weighting or is in octaves, or its dataset 1858 is damaged.
    """
    numbers = [block.number for block in blocks if block.number in (58, 1858)]
    ordinal, windowed = int(numbers[:1] == [1858]), 0
    for block in blocks:
        ordinal += block.number == 58
        if block.number != 1858 or ordinal not in ordinals or len(block.lines) < 2:
            continue
        try:
            octave = ([int(word) for word in block.lines[0].split()] + [0, 0])[1]
            weighting, window = integers(block.lines[1], (6,) * 12)[:2]
        except ValueError as error:
            raise FileError(f"{path}: dataset {block.ordinal} (1858) is damaged ({error}); export it again") from error
        if octave:
            raise FileError(
                f"{path}: function {ordinal} is in 1/{octave} octaves (dataset 1858); export it line by line"
            )
        if weighting in _WEIGHTINGS:
            raise FileError(
                f"{path}: function {ordinal} has {_WEIGHTINGS[weighting]} weighting (dataset 1858), as sound levels have; export it"
                " without weighting"
            )
        windowed += window in _EXPONENTIAL
    if not windowed:
        return ""
    return (
        f"an exponential window lies on {plural(windowed, 'function')} (dataset 1858), whose damping is in them: state it"
        " (`window_decay` of a study, `structid modes --window`)"
    )
