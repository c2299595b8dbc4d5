"""Channels of universal files: quantity, degree of freedom and factor to SI of a function.

Sensors and loads that are named along the axes of their nodes are turned into global axes.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError, InputError
from structid.core.units import FrfUnit, Unit, frf_unit_sides, parse_frf_unit, parse_unit
from structid.files.uff.datasets import UnitFactors
from structid.files.uff.geometry import UniversalNodes
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
#: Part of a direction along another axis that rounding of a file explains.
_ROUNDED = 1e-5
_COUNTS = {2: "two", 3: "three"}


def dof_of(path: Path, node_and_direction: tuple[int, int], role: str, function: int) -> Dof:
    """Degree of freedom of a node and direction of a universal file (1 to 3 translations, 4 to 6 rotations, signed).

    `node_and_direction` are both numbers as the file has them; `role` and `function` (its number) are for errors.

    Raises
    ------
    FileError
        If the direction is 0 (a scalar) or above 6 in size, or the node is negative.
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
    path: Path, side: Characteristics, dof: Dof, factors: UnitFactors | None, option: str, by_labels: str = ""
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
    by_labels : str
        What that option is if the labels are right, named in errors; "" if they do not say it.

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
        words = option_words(**{option: by_labels or None})
        raise FileError(
            f"{path}: the data of {dof} have unit {side.label!r} (factor {unit.factor:g} to SI), but dataset 164 "
            f"says {factor:g}; tell which is right: give {words}"
            f"{' if the labels are, else that of dataset 164' if by_labels else ''}"
        )
    return quantity, factor


def _remedy(option: str) -> str:
    example = "g/N" if option == "unit" else "g"
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


class GlobalAxes(NamedTuple):
    """Channels in global axes.

    Attributes
    ----------
    dofs : tuple of Dof
    matrix : (n_channels, n_channels) float array, optional
        Matrix that turns the values of the channels of the file, in their order, into those of `dofs`; None where the values
        stay as they are.
    words : str
        What was done.
    """

    dofs: tuple[Dof, ...]
    matrix: FloatArray | None
    words: str


def in_global_axes(
    path: Path,
    nodes: UniversalNodes,
    dofs: Sequence[Dof],
    groups: Sequence[Hashable] | None = None,
    is_load: bool = False,
) -> GlobalAxes:
    """Channels along the local axes of their nodes, transformed to global axes.

    A channel along a global axis is only renamed. The others of a node are transformed together if there are as many of them as
    global axes that they span: all three, or the radial and the tangential one of a cylinder. Returns new channels, the
    transformation matrix (n_channels, n_channels), None if values stay, and words on it.

    Parameters
    ----------
    path : Path
        File, named in errors.
    nodes : UniversalNodes
        Nodes with their axes; nodes that the file does not define have global axes.
    dofs : sequence of Dof
        Degree of freedom of each channel in local axes.
    groups : sequence, optional
        Kind of each channel, such as its quantity: only channels of the same kind are transformed together.
    is_load : bool
        True if the channels are loads, for messages.

    Raises
    ------
    FileError
        If a channel lies along no global axis, and the other channels of its node that are needed are missing.
    """
    named = option_words(axes="named")
    kinds: Sequence[Hashable] = [""] * len(dofs) if groups is None else groups
    matrix, renamed, words, is_turned = np.eye(len(dofs)), list(dofs), [], False
    skewed: dict[Hashable, list[int]] = {}
    for j, dof in enumerate(dofs):
        axes = nodes.axes(dof.node, f"export the coordinate systems too, or take directions as they are named: {named}")
        if axes is None:
            continue
        direction = dof.sign * axes[dof.axis % 3]
        along = int(np.argmax(np.abs(direction)))
        if np.abs(np.delete(direction, along)).max() <= _ROUNDED:
            renamed[j] = _global(dof, along, 1 if direction[along] > 0 else -1)
            words.append(f"{dof} is {renamed[j]} in global axes")
        else:
            skewed.setdefault((dof.node, dof.is_rotation, kinds[j]), []).append(j)
    for columns in skewed.values():
        local = [dofs[j] for j in columns]
        node = local[0].node
        axes = nodes.axes(node)
        assert axes is not None
        parts = axes[[dof.axis % 3 for dof in local]]
        spanned = np.flatnonzero((np.abs(parts) > _ROUNDED).any(axis=0)).tolist()
        if len(spanned) != len(columns) or len({dof.axis for dof in local}) < len(local):
            raise FileError(f"{path}: {_describe_skewed(local[0], axes, is_load)}; {named}")
        signs = np.array([dof.sign for dof in local])
        for j, axis in zip(columns, spanned, strict=True):
            matrix[j, columns] = signs * parts[:, axis]
            renamed[j] = _global(local[0], axis, 1)
        is_turned = True
        words.append(f"the {_COUNTS[len(columns)]} of node {node} are turned into global axes")
    return GlobalAxes(tuple(renamed), matrix if is_turned else None, ", ".join(words))


def _global(dof: Dof, axis: int, sign: int) -> Dof:
    return Dof(dof.node, DIRECTIONS[axis + 3 * dof.is_rotation], sign)


def _describe_skewed(dof: Dof, axes: FloatArray, is_load: bool) -> str:
    """Text of the error on a channel along no global axis, which says how to state its direction in a study.

    `axes` (3, 3) holds the local axes of its node as rows, in global coordinates. `dof` is in local axes; `is_load` is
    true of a load.
    """
    way = ", ".join(f"{part:.5g}" for part in axes[dof.axis % 3])
    name = f"{'load ' if is_load else ''}{dof.place}"
    if dof.is_rotation:
        return (
            f"{dof} turns about ({way}) in global axes and the other two rotations of node {dof.node} are not there to turn it"
            " with; export all three, or leave it out; or take directions as they are named"
        )
    return (
        f"{dof} {'acts' if is_load else 'reads'} along ({way}) in global axes and the other two of node {dof.node} are not there to"
        f' turn it with; say its direction in a study, [record.sensors] "{name}" = {{ direction = [{way}] }}, and take directions'
        " as they are named"
    )
