"""Quantity and degree of freedom of a function, and the factor of its values to SI."""

from __future__ import annotations

import math
from pathlib import Path

from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError, InputError
from structid.core.units import FrfUnit, Unit, frf_unit_sides, parse_frf_unit, parse_unit
from structid.files.uff.datasets import UnitFactors
from structid.records.formats.options import option_words
from structid.records.formats.uff.functions import Characteristics
from structid.records.record import QUANTITY_UNITS

#: Specific data types of dataset 58 that structid reads, and the one it writes for each quantity.
QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration", 13: "force"}
DATA_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13, "support_acceleration": 12}
UNKNOWN = (0, 1)
#: Labels of which nothing needs to be said.
SI_UNITS = {"", *(unit for pair in QUANTITY_UNITS.values() for unit in pair)}
_FORCE_EXPONENTS = ((0, 1), (1, 1))
_OTHERS = {2: "stress", 3: "strain", 5: "temperature", 6: "heat flux", 9: "reaction force", 15: "pressure", 16: "mass"}


def dof_of(path: Path, node_and_direction: tuple[int, int], role: str, function: int) -> Dof:
    """The degree of freedom of a node and direction of a universal file (1 to 3 translations, 4 to 6 rotations, signed).

    `role` and `function` (its number) are for errors.

    Raises
    ------
    FileError
        If the direction is 0 (a scalar) or larger than 6.
    """
    node, direction = node_and_direction
    if not 1 <= abs(direction) <= 6 or node < 0:
        raise FileError(
            f"{path}: the {role} of function {function}, at node {node}, has direction {direction}; it must be 1 to 6 or -1 to -6:"
            " set it in the export, choose others with `channels` (`outputs` and `inputs` of FRFs), or choose functions by their"
            " numbers with `columns` and say by `channels` what they are"
        )
    return Dof(node, DIRECTIONS[abs(direction) - 1], 1 if direction > 0 else -1)


def direction_of(dof: Dof) -> int:
    """UFF direction of `dof`: 1 to 6, negative for a negative sense."""
    return dof.sign * (dof.axis + 1)


def _file_factor(factors: UnitFactors, quantity: str, dof: Dof) -> float:
    """Factor to SI of a `quantity` at `dof` in the units of dataset 164, whose factors convert from SI."""
    if quantity == "force":
        return 1 / (factors.force * (factors.length if dof.is_rotation else 1.0))
    return 1.0 if dof.is_rotation else 1 / factors.length


def channel_scale(
    path: Path, side: Characteristics, dof: Dof, factors: UnitFactors | None, option: str
) -> tuple[str, float]:
    """Quantity and factor to SI of the ordinate or denominator of a function.

    Parameters
    ----------
    path : Path
        File, named in errors.
    side : Characteristics
        Data type, exponents and unit label of that side.
    dof : Dof
        Degree of freedom that it belongs to.
    factors : UnitFactors, optional
        Unit factors of dataset 164; None if the file has none.
    option : str
        Option that states the unit if the file does not: ``unit`` for FRFs, ``units`` for time histories.

    Raises
    ------
    FileError
        If neither data type nor label states the quantity, nothing states the unit, or label, type and dataset 164
        contradict each other.
    """
    remedy = _remedy(option)
    unit = _label_unit(path, side, dof, remedy)
    if side.number in QUANTITIES:
        quantity = QUANTITIES[side.number]
    elif side.number in UNKNOWN and unit is not None:
        quantity = unit.quantity
    elif side.number == 1 and side.exponents in _FORCE_EXPONENTS:
        quantity = "force"
    else:
        name = _OTHERS.get(side.number, "")
        raise FileError(
            f"{path}: the data of {dof} are of type {side.number}{f' ({name})' if name else ''} and not of displacement (8),"
            f" velocity (11), acceleration (12) or force (13); set the type in the export, or say what they are: {remedy}"
        )
    if unit is not None and unit.quantity != quantity:
        raise FileError(
            f"{path}: the data of {dof} are of {quantity} by their type but {unit.quantity} by their unit {side.label!r}"
        )
    if factors is None:
        if unit is None:
            raise FileError(
                f"{path}: nothing says the unit of the {quantity} at {dof}: it has no unit label and the file no dataset 164;"
                f" {remedy}"
            )
        return quantity, unit.factor
    factor = _file_factor(factors, quantity, dof)
    if unit is not None and not math.isclose(unit.factor, factor, rel_tol=1e-4):
        raise FileError(
            f"{path}: the data of {dof} have unit {side.label!r} (factor {unit.factor:g} to SI), but dataset 164 "
            f"says {factor:g}; tell which is right: {remedy}"
        )
    return quantity, factor


def _remedy(option: str) -> str:
    example = '"g/N"' if option == "unit" else '"g"'
    return f"give {option_words(**{option: example})}"


def _label_unit(path: Path, side: Characteristics, dof: Dof, remedy: str) -> Unit | None:
    """The unit that the label of one `side` of a function states; None without a label.

    Raises `FileError`, which `remedy` ends, if it is no unit, or one of a translation where `dof` is a rotation or the reverse.
    """
    if not side.label:
        return None
    try:
        unit = parse_unit(side.label)
    except InputError as error:
        raise FileError(
            f"{path}: the unit label of {dof} cannot be used: {error}; or say the unit: {remedy}"
        ) from error
    if unit.rotation != dof.is_rotation:
        words = ("translation", "rotation")
        raise FileError(
            f"{path}: {dof} is a {words[dof.is_rotation]} but its unit {side.label!r} belongs to a {words[unit.rotation]}; correct"
            f" one of them: {remedy}"
        )
    return unit


def whole_unit(path: Path, numerator: Characteristics, denominator: Characteristics) -> FrfUnit | None:
    """Unit of the whole FRF, such as `(m/s^2)/N`, if the label of the numerator states it; else None.

    Raises
    ------
    FileError
        If the label of the denominator contradicts it.
    """
    try:
        unit = parse_frf_unit(numerator.label)
    except InputError:
        return None
    _, below = frf_unit_sides(numerator.label)
    try:
        other = parse_unit(denominator.label) if denominator.label else below
    except InputError:
        other = None
    if (
        other is None
        or below is None
        or other[:1] != below[:1]
        or not math.isclose(other.factor, below.factor, rel_tol=1e-4)
    ):
        raise FileError(
            f"{path}: an FRF is in {numerator.label!r} by its ordinate and per {denominator.label!r} by its denominator;"
            f" {_remedy('unit')}"
        )
    return unit
