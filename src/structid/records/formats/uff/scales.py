"""What a dataset 58 measures, where, and the factor of its values to SI."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError, InputError
from structid.core.units import FrfUnit, parse_frf_unit, parse_unit
from structid.records.formats.options import option_words
from structid.records.formats.uff.blocks import Dataset

#: Specific data types of dataset 58 that structid reads, and the one it writes for each quantity.
QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration", 13: "force", 9: "force"}
DATA_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13, "support_acceleration": 12}
UNKNOWN = (0, 1)


class Factors(NamedTuple):
    """Units of a universal file by dataset 164: numbers are divided by these to become m and N."""

    length: float
    force: float


def unit_factors(path: Path, datasets: list[Dataset]) -> Factors | None:
    """The unit factors of the file, or None where it has no dataset 164.

    Raises
    ------
    FileError
        If a factor is not positive, or two datasets 164 differ.
    """
    found = {Factors(float(d["length"]), float(d["force"])) for d in datasets if d["type"] == 164}
    for factors in found:
        if not all(math.isfinite(factor) and factor > 0 for factor in factors):
            raise FileError(f"{path}: dataset 164 has unit factors {tuple(factors)}; they must be positive")
    if len(found) > 1:
        raise FileError(
            f"{path}: has several datasets 164 with different units; export the parts to files of their own"
        )
    return found.pop() if found else None


def dof_of(path: Path, node: int, direction: int, role: str) -> Dof:
    """The degree of freedom of UFF direction `direction` (1 to 3 translations, 4 to 6 rotations, signed).

    Raises
    ------
    FileError
        If the direction is 0 (a scalar) or larger than 6.
    """
    if not 1 <= abs(direction) <= 6:
        raise FileError(
            f"{path}: the {role} at node {node} has direction {direction}; it must be 1 to 6 or -1 to -6, "
            "set it in the export"
        )
    return Dof(node, DIRECTIONS[abs(direction) - 1], 1 if direction > 0 else -1)


def direction_of(dof: Dof) -> int:
    """UFF direction of `dof`: 1 to 6, negative for a negative sense."""
    return dof.sign * (dof.axis + 1)


class Side(NamedTuple):
    """What a dataset 58 says of its ordinate's numerator or denominator: specific data type, and label of the unit or ""."""

    number: int
    label: str


def sides(dataset: Dataset) -> tuple[Side, Side]:
    """Numerator and denominator of a dataset 58."""
    return (
        _side(dataset.get("ordinate_spec_data_type"), dataset.get("ordinate_axis_units_lab")),
        _side(dataset.get("orddenom_spec_data_type"), dataset.get("orddenom_axis_units_lab")),
    )


def _side(number: int | None, label: str | None) -> Side:
    text = str(label or "").strip()
    return Side(int(number or 0), "" if text.upper() in ("NONE", "NULL", "UNKNOWN") else text)


def _label_unit(text: str) -> tuple[str, float] | None:
    """Quantity and factor of a unit label, or None where it cannot be read."""
    try:
        unit = parse_unit(text)
    except InputError:
        return None
    return unit.quantity, unit.factor


def _file_factor(factors: Factors, quantity: str, dof: Dof) -> float:
    """Factor to SI of a `quantity` at `dof` by the units of the file."""
    if quantity == "force":
        return 1 / (factors.force * (factors.length if dof.is_rotation else 1.0))
    return 1.0 if dof.is_rotation else 1 / factors.length


def channel_scale(path: Path, side: Side, dof: Dof, factors: Factors | None) -> tuple[str, float]:
    """Quantity and factor to SI of one side of a dataset 58.

    Parameters
    ----------
    side : Side
    dof : Dof
    factors : Factors, optional
        Units by dataset 164; without them the label decides, and without a label SI is meant.

    Raises
    ------
    FileError
        If neither data type nor label says the quantity, or label and dataset 164 contradict each other.
    """
    number, text = side
    label = _label_unit(text)
    if number in QUANTITIES:
        quantity = QUANTITIES[number]
    elif number in UNKNOWN and label is not None:
        quantity = label[0]
    else:
        raise FileError(
            f"{path}: the data of {dof} are of type {number} and not of displacement (8), velocity (11), "
            "acceleration (12) or force (13); set the type in the export, or say what they are with `unit`, as in"
            ' unit = "g/N", of frequency responses, with `units` of time histories'
        )
    if label is not None and label[0] != quantity:
        raise FileError(
            f"{path}: the data of {dof} are of {quantity} by their type but {label[0]} by their unit {text!r}"
        )
    if factors is None:
        return quantity, label[1] if label is not None else 1.0
    factor = _file_factor(factors, quantity, dof)
    if label is not None and not math.isclose(label[1], factor, rel_tol=1e-4):
        raise FileError(
            f"{path}: the data of {dof} have unit {text!r} (factor {label[1]:g} to SI), but dataset 164 "
            f"says {factor:g}; tell which is right: for FRFs with {option_words(unit=None)}, for time histories with"
            f" {option_words(units=None)}"
        )
    return quantity, factor


def whole_unit(numerator: Side) -> FrfUnit | None:
    """The unit of a whole FRF, such as `(m/s^2)/N`, where the numerator's label is of that."""
    try:
        return parse_frf_unit(numerator.label)
    except InputError:
        return None
