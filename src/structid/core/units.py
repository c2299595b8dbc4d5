"""Unit texts of channels and frequency response functions, read as a quantity and a factor to SI."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from structid.core.errors import InputError

Quantity = Literal["displacement", "velocity", "acceleration", "force", "support_acceleration"]
FrfKind = Literal["receptance", "mobility", "accelerance", "transmissibility"]

#: Standard acceleration of free fall in m/s^2.
STANDARD_GRAVITY = 9.80665
_LENGTHS = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180}
_FORCES = {
    "N": 1.0, "mN": 1e-3, "kN": 1e3, "MN": 1e6,
    "lbf": 4.4482216152605, "kip": 4448.2216152605, "kgf": STANDARD_GRAVITY,
}  # fmt: skip
_ACCELERATIONS = {"g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3}
#: What a sensor shows too much of, with the unit that it is in and the one that it is read as.
_MISTAKEN = ((STANDARD_GRAVITY, "m/s^2", "g"), (1e3, "mm", "m"), (1e2, "cm", "m"), (1 / 0.0254, "in", "m"))
_MISTAKEN_TURNS = ((180 / math.pi, "deg", "rad"), (1e3, "mrad", "rad"))
#: What a force is more than its reading says, likewise.
MISTAKEN_FORCES = tuple((_FORCES[unit], unit, "N") for unit in ("lbf", "kgf", "kN"))
_PER_TIME: dict[str, Quantity] = {
    "": "displacement",
    "/s": "velocity",
    "/s^2": "acceleration",
    "/s2": "acceleration",
    "/s/s": "acceleration",
}
_KINDS: dict[str, FrfKind] = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
}
_MOTION = re.compile(r"^(?P<base>[A-Za-z]+)(?P<time>/.*)?$")
_MOMENT = re.compile(r"^(?P<force>[A-Za-z]+?)[*\- ]?(?P<length>km|cm|mm|um|m|in|ft)$")
_ACCEPTED = (
    "lengths m mm um cm km in ft and angles rad deg, alone or per s or s^2 (as in mm/s^2 or deg/s), "
    "g as an acceleration, forces N kN mN lbf kip kgf, moments such as N m"
)
_ACCEPTED_FRF = (
    "motion per force, as in (m/s^2)/N, g/lbf, mm/N or (mm/s)/kN, or motion per the same motion of a support, as in g/g,"
    " where motion and force are of: "
)


def mistaken_motions(is_rotation: bool, is_acceleration: bool = True) -> tuple[tuple[float, str, str], ...]:
    """Units that sensors are read in by mistake: by what factor they then show too much, the true unit and the one read."""
    return _MISTAKEN_TURNS if is_rotation else _MISTAKEN if is_acceleration else _MISTAKEN[1:]


def mistaken_unit(size: float, units: Sequence[tuple[float, str, str]], near: float) -> str:
    """The units of a factor whose logarithm is `size`, as ``in g and read as m/s^2``; "" where none is as near as `near`."""
    distance, (_, smaller, larger) = min((abs(abs(size) - math.log(unit[0])), unit) for unit in units)
    if distance > near:
        return ""
    return f"in {smaller} and read as {larger}" if size > 0 else f"in {larger} and read as {smaller}"


class Unit(NamedTuple):
    """What a channel holds: its quantity, the factor to SI, and whether it belongs to a rotation."""

    quantity: Quantity
    factor: float
    rotation: bool


class FrfUnit(NamedTuple):
    """What a frequency response function holds: its kind, the factor to SI, rotations out and in."""

    kind: FrfKind
    factor: float
    output_rotation: bool
    input_rotation: bool


def _normalized(text: str) -> str:
    for old, new in (("**", "^"), ("²", "^2"), ("µ", "u"), ("μ", "u"), ("·", "*"), ("⋅", "*")):
        text = text.replace(old, new)
    return re.sub(r" ?([/*^()]) ?", r"\1", " ".join(text.split()))


def _without_brackets(text: str) -> str:
    """`text` without the brackets around the whole of it."""
    while text.startswith("(") and text.endswith(")"):
        depths = np.cumsum([(letter == "(") - (letter == ")") for letter in text])
        if (depths[:-1] == 0).any():
            break
        text = text[1:-1]
    return text


def _unit(text: str) -> Unit | None:
    text = _without_brackets(text)
    if text in _FORCES:
        return Unit("force", _FORCES[text], False)
    if text in _ACCELERATIONS:
        return Unit("acceleration", _ACCELERATIONS[text], False)
    motion = _MOTION.match(text)
    if motion and (motion["time"] or "") in _PER_TIME:
        quantity = _PER_TIME[motion["time"] or ""]
        if motion["base"] in _LENGTHS:
            return Unit(quantity, _LENGTHS[motion["base"]], False)
        if motion["base"] in _ANGLES:
            return Unit(quantity, _ANGLES[motion["base"]], True)
    moment = _MOMENT.match(text)
    if moment and moment["force"] in _FORCES:
        return Unit("force", _FORCES[moment["force"]] * _LENGTHS[moment["length"]], True)
    return None


def parse_unit(text: str) -> Unit:
    """The quantity of a channel with unit `text`, and the factor that turns its numbers into SI.

    Parameters
    ----------
    text : str
        Such as ``m/s^2``, ``m/s2``, ``m/s**2``, ``mm``, ``deg/s``, ``g`` (an acceleration), ``kN``, ``N m``.

    Returns
    -------
    Unit
        ``(quantity, factor, rotation)``: the number times `factor` is in m, m/s, m/s^2, N for
        translations, in rad, rad/s, rad/s^2, N m for rotations.

    Raises
    ------
    InputError
        If `text` is none of these.

    Examples
    --------
    >>> parse_unit("mm/s^2")
    Unit(quantity='acceleration', factor=0.001, rotation=False)
    """
    unit = _unit(_normalized(text))
    if unit is None:
        raise InputError(f"cannot read {text!r} as the unit of a channel; write {_ACCEPTED}")
    return unit


def _last_division(text: str) -> int:
    """Position of the last `/` outside of brackets, or -1."""
    depth, found = 0, -1
    for i, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if letter == "/" and depth == 0:
            found = i
    return found


def parse_frf_unit(text: str) -> FrfUnit:
    """The kind of a frequency response function with unit `text`, and the factor to SI.

    Parameters
    ----------
    text : str
        Motion per force, such as ``(m/s^2)/N``, ``m/s^2/N``, ``g/lbf``, ``mm/N``, ``rad/(N m)``, or motion per motion,
        such as ``g/g``.

    Returns
    -------
    FrfUnit
        ``(kind, factor, output_rotation, input_rotation)``.

    Raises
    ------
    InputError
        If `text` is not a motion divided by a force, a moment or the same kind of motion.

    Examples
    --------
    >>> parse_frf_unit("(mm/s)/kN")[:2]
    ('mobility', 1e-06)
    """
    whole = _without_brackets(_normalized(text))
    cut = _last_division(whole)
    above = _unit(whole[:cut]) if cut > 0 else None
    below = _unit(whole[cut + 1 :]) if cut > 0 else None
    if above is not None and below is not None and above.quantity == below.quantity != "force":
        return FrfUnit("transmissibility", above.factor / below.factor, above.rotation, below.rotation)
    if above is None or below is None or above.quantity == "force" or below.quantity != "force":
        raise InputError(
            f"cannot read {text!r} as the unit of a frequency response function; write {_ACCEPTED_FRF}{_ACCEPTED}"
        )
    return FrfUnit(_KINDS[above.quantity], above.factor / below.factor, above.rotation, below.rotation)
