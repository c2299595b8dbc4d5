"""The abscissa of functions: of frequencies in Hz, or of times in s, by what their headers say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from structid.core.errors import FileError, InputError
from structid.core.units import parse_frequency_unit, parse_time_unit
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.uff.functions import Dataset58

AxisKind = Literal["frequencies", "times"]


class _Axis(NamedTuple):
    """Rules to read an axis: its unit's reader, the meaning of a type without a label, and types that a label can explain."""

    parse: Callable[[str], float]
    units: dict[int, str]
    unsaid: tuple[int, ...]


_AXES: dict[AxisKind, _Axis] = {
    "frequencies": _Axis(parse_frequency_unit, {18: "Hz", 19: "rpm"}, (0, 1)),
    "times": _Axis(parse_time_unit, {17: "s"}, (0, 1)),
}
_TYPES = {17: "time", 18: "frequency", 19: "rpm", 20: "order"}


def axis_unit(path: Path, function: Dataset58, kind: AxisKind, options: ReadOptions) -> tuple[float, str]:
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


def one_axis_unit(path: Path, functions: list[Dataset58], kind: AxisKind, options: ReadOptions) -> tuple[float, str]:
    """Factor to Hz or s and note, as from `axis_unit`, that all functions share; `FileError` if their factors differ."""
    units = [axis_unit(path, function, kind, options) for function in functions]
    for function, unit in zip(functions, units, strict=True):
        if unit[0] != units[0][0]:
            raise FileError(
                f"{path}: functions {functions[0].ordinal} and {function.ordinal} have {kind} in different units; export all alike"
            )
    return units[0]
