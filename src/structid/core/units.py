"""Unit texts of channels and frequency response functions, read as a quantity and a factor to SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from structid.core.errors import InputError

Quantity = Literal["displacement", "velocity", "acceleration", "force", "support_acceleration"]
FrfKind = Literal["receptance", "mobility", "accelerance", "transmissibility"]
#: Kinds of FRFs whose sensors are accelerometers.
ACCELERATION_KINDS: tuple[FrfKind, ...] = ("accelerance", "transmissibility")

#: Standard acceleration of free fall in m/s^2.
STANDARD_GRAVITY = 9.80665
_POUND = 0.45359237 * STANDARD_GRAVITY
#: Lengths in m, by the one spelling that stands for all of `_SPELLINGS`.
LENGTHS = {
    "m": 1.0, "km": 1e3, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "mil": 2.54e-5, "ft": 0.3048,
}  # fmt: skip
#: Angles in rad.
ANGLES = {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180}
#: Forces in N.
FORCES = {
    "N": 1.0, "mN": 1e-3, "daN": 10.0, "kN": 1e3, "MN": 1e6, "dyn": 1e-5, "lbf": _POUND, "kip": 1e3 * _POUND,
    "kgf": STANDARD_GRAVITY,
}  # fmt: skip
#: Accelerations with a name of their own, in m/s^2.
ACCELERATIONS = {
    "g": STANDARD_GRAVITY,
    "mg": STANDARD_GRAVITY * 1e-3,
    "ug": STANDARD_GRAVITY * 1e-6,
    "gal": 1e-2,
    "mgal": 1e-5,
}
#: Frequencies in Hz.
FREQUENCIES = {"Hz": 1.0, "mHz": 1e-3, "kHz": 1e3, "MHz": 1e6, "rad/s": 1 / (2 * math.pi), "rpm": 1 / 60}
#: Times in s.
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
_VOLTAGES = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
#: How people write them, in small letters.
_SPELLINGS = {
    "m": "meter meters metre metres", "km": "kilometer kilometers kilometre kilometres",
    "cm": "centimeter centimeters centimetre centimetres", "mm": "millimeter millimeters millimetre millimetres",
    "um": "micron microns micrometer micrometers micrometre micrometres", "in": "inch inches", "mil": "mils thou",
    "ft": "foot feet", "rad": "radian radians", "mrad": "milliradian milliradians", "deg": "degree degrees \u00b0",
    "N": "newton newtons", "kN": "kilonewton kilonewtons", "dyn": "dyne dynes", "kip": "kips klbf",
    "lbf": "lb lbs lbsf lb_f pound pounds poundforce pound-force", "kgf": "kp kilopond kilogramforce kilogram-force kg_f",
    "g": "gn g_n g0 g's gs g-force", "mg": "milli-g millig", "ug": "micro-g microg", "gal": "gals", "mgal": "milligal",
    "Hz": "hertz cps cycles/s cycle/s c/s", "kHz": "kilohertz", "rad/s": "r/s radians/s rads/s rad*s^-1",
    "rpm": "r/min rev/min revs/min 1/min cpm u/min min^-1",
    "s": "sec secs second seconds sek", "ms": "msec msecs millis millisec millisecs millisecond milliseconds",
    "us": "usec usecs micros microsec microsecs microsecond microseconds", "ns": "nsec nanosecond nanoseconds nanos",
    "min": "mins minute minutes", "h": "hr hrs hour hours", "day": "days", "V": "volt volts", "mV": "millivolt millivolts",
}  # fmt: skip
_NAMES = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
_UNITS = {**LENGTHS, **ANGLES, **FORCES, **ACCELERATIONS, **FREQUENCIES, **TIMES, **_VOLTAGES}
#: In capitals these may stand for two: mN or MN, mHz or MHz, a mass or an acceleration; M alone is no unit.
_CASED = ("mn", "mhz", "mg", "mgal", "mv", "h", "m")
_NAMES |= {unit.lower(): unit for unit in _UNITS if unit.lower() not in (*_CASED, "g", "v")} | {"g": "g", "v": "V"}
#: Words that people find where a unit should be, and why they are none.
_NO_UNITS = {
    "eu": "EU are engineering units of whoever set up the test",
    "kg": "kg is a mass, and a force in kgf or N",
    "db": "dB is a level: its reference is not said, and phases are lost",
    "%": "a percentage says no unit",
    "counts": "counts of a converter are no unit", "count": "counts of a converter are no unit",
}  # fmt: skip
_VOLTAGE_REMEDY = "give it with the sensitivity of the sensor, as in V at 100 mV/g or mV at 10.2 mV/(m/s^2)"
#: What a sensor shows too much of, with the unit that it is in and the one that it is read as.
_MISTAKEN = ((STANDARD_GRAVITY, "m/s^2", "g"), (1e3, "mm", "m"), (1e2, "cm", "m"), (1 / 0.0254, "in", "m"))
_MISTAKEN_TURNS = ((180 / math.pi, "deg", "rad"), (1e3, "mrad", "rad"))
#: What a force is more than its reading says, likewise.
MISTAKEN_FORCES = tuple((FORCES[unit], unit, "N") for unit in ("lbf", "kgf", "kN"))
_BY_POWER: tuple[Quantity, ...] = ("displacement", "velocity", "acceleration")
_KINDS: dict[str, FrfKind] = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
}
_TIME_WORD = r"(?:s|sec|secs|second|seconds)"
_PER_TIME = re.compile(
    rf"(?P<base>[^/*^\s]+?)(?:(?P<once>/{_TIME_WORD})(?P<twice>/{_TIME_WORD}|\^?2)?|/\({_TIME_WORD}(?P<square>\^?2|\*{_TIME_WORD})\)"
    rf"|[ .*]?{_TIME_WORD}\^?-(?P<power>[12]))?",
    re.IGNORECASE,
)
_VOLTAGE = re.compile(
    r"(?P<read>[mu]?V) ?(?:at|@) ?(?P<number>\d+\.?\d*(?:e[+-]?\d+)?) ?(?P<sensed>[mu]?V)/(?P<unit>.+)", re.IGNORECASE
)
_ACCEPTED = (
    "lengths m mm um cm km in mil ft and angles rad deg, alone or per s or s^2 (as in mm/s^2 or deg/s), g or gal as an"
    " acceleration, forces N kN mN lbf kip kgf, moments such as N m, or a voltage with a sensitivity as in V at 100 mV/g"
)
_ACCEPTED_FRF = (
    "motion per force, as in (m/s^2)/N, g/lbf, mm/N or (mm/s)/kN, or motion per the same motion of a support, as in g/g,"
    " where motion and force are of: "
)


def mistaken_motions(is_rotation: bool, is_acceleration: bool = True) -> tuple[tuple[float, str, str], ...]:
    """Pairs of units often confused for a sensor: (factor by which it reads too high, true unit, unit assumed)."""
    return _MISTAKEN_TURNS if is_rotation else _MISTAKEN if is_acceleration else _MISTAKEN[1:]


def mistaken_unit(size: float, units: Sequence[tuple[float, str, str]], near: float) -> str:
    """The confused units that explain a factor exp(`size`), as ``in g and read as m/s^2``; "" if none does.

    `units` are (factor above 1, first unit, second unit); the one whose logarithm is nearest to abs(`size`) counts, if
    they differ by at most `near`. Values in the first unit were read as the second for a positive `size`, and the other
    way round else.
    """
    distance, (_, first, second) = min((abs(abs(size) - math.log(unit[0])), unit) for unit in units)
    if distance > near:
        return ""
    return f"in {first} and read as {second}" if size > 0 else f"in {second} and read as {first}"


class Unit(NamedTuple):
    """Unit of a channel: its quantity, the factor to SI, and whether it belongs to a rotation."""

    quantity: Quantity
    factor: float
    rotation: bool


class FrfUnit(NamedTuple):
    """Unit of a frequency response function: its kind, the factor to SI, rotations out and in."""

    kind: FrfKind
    factor: float
    output_rotation: bool
    input_rotation: bool


#: Letters of a unit at most: where a force and a length part is tried letter by letter.
_LONGEST = 100


def _normalize_unit(text: str) -> str:
    """`text` of a unit in one spelling: ``^`` for powers, ``*`` for products, ``/`` for per, no blanks around signs.

    Other blanks are single. A text that is far too long for a unit is returned as it is.
    """
    if len(text) > 10 * _LONGEST:  # no unit, whatever is made of it
        return text
    for old, new in (("**", "^"), ("²", "^2"), ("\u207b", "^-"), ("\u00b9", "1"), ("^-^2", "^-2"), ("µ", "u"), ("μ", "u"),
                     ("·", "*"), ("⋅", "*"), ("\u2019", "'")):  # fmt: skip
        text = text.replace(old, new)
    text = " ".join(text.split()).replace(" per ", "/")
    return re.sub(r" ?([/*^()]) ?", r"\1", text)


def _unit_name(text: str, among: Mapping[str, float]) -> str | None:
    """The key of the table `among` (unit: SI factor) that `text` spells, in any common spelling; None if none."""
    if text in among:
        return text
    unit = _NAMES.get(text.lower())
    return unit if unit in among else None


def _without_brackets(text: str) -> str:
    """`text` without round brackets that enclose the whole of it, however many; a very long text as it is."""
    while text.startswith("(") and text.endswith(")") and len(text) <= 2 * _LONGEST:
        depths = np.cumsum([(letter == "(") - (letter == ")") for letter in text])
        if (depths[:-1] == 0).any():
            break
        text = text[1:-1]
    return text


def _read_unit(text: str) -> Unit | None:
    """The `Unit` (quantity, factor to SI, rotation) that a normalized text names; None if it names none."""
    if len(text) > _LONGEST:
        return None
    text = _without_brackets(text)
    force, acceleration = _unit_name(text, FORCES), _unit_name(text, ACCELERATIONS)
    if force is not None:
        return Unit("force", FORCES[force], False)
    if acceleration is not None:
        return Unit("acceleration", ACCELERATIONS[acceleration], False)
    motion = _PER_TIME.fullmatch(text)
    if motion:
        power = 2 if motion["twice"] or motion["square"] else 1 if motion["once"] else int(motion["power"] or 0)
        base = "m" if motion["base"] == "M" and power else motion["base"]
        for is_rotation, table in enumerate((LENGTHS, ANGLES)):
            name = _unit_name(base, table)
            if name is not None:
                return Unit(_BY_POWER[power], table[name], bool(is_rotation))
    if text.lower() == "ips":
        return Unit("velocity", LENGTHS["in"], False)
    return _read_moment_unit(text) or _read_voltage_unit(text)


def _read_moment_unit(text: str) -> Unit | None:
    """The unit of a moment, a force times a length in either order (N m, kN*mm, ft-lbf).

    None if `text` is no such unit.
    """
    for match in _factor_pairs(text):
        for force, length in (match, match[::-1]):
            force_name, length_name = _unit_name(force, FORCES), _unit_name(length, LENGTHS)
            if force_name is not None and length_name is not None:
                return Unit("force", FORCES[force_name] * LENGTHS[length_name], True)
    return None


def _factor_pairs(text: str) -> list[tuple[str, str]]:
    """Ways to split `text` into two factors: at its only ``*``, ``-``, point or blank, or within one word.

    A word is split between two units of force and length as they are spelled in the tables. Empty if there is no way.
    """
    words = re.split(r"[*\- .]", text)
    if len(words) == 2:
        return [(words[0], words[1])]
    cuts = range(1, len(text)) if len(words) == 1 else ()
    known = {*FORCES, *LENGTHS}  # as they are spelled there: nm is no moment
    return [(text[:cut], text[cut:]) for cut in cuts if {text[:cut], text[cut:]} <= known]


def _read_voltage_unit(text: str) -> Unit | None:
    """The unit of a voltage with the sensitivity of its sensor (V at 100 mV/g); None if `text` is no such unit.

    Its factor turns volts into SI units of the motion or force.
    """
    match = _VOLTAGE.fullmatch(text)
    unit = _read_unit(match["unit"]) if match else None
    if match is None or unit is None or float(match["number"]) == 0:
        return None
    names = [_unit_name(match[part], _VOLTAGES) for part in ("read", "sensed")]
    read, sensed = (_VOLTAGES[name] if name else math.nan for name in names)
    return unit._replace(factor=unit.factor * read / (float(match["number"]) * sensed))


def _unreadable_unit_error(text: str, kind: str, accepted: str) -> InputError:
    """The error for a `text` that is no unit of `kind`, with the reason and the `accepted` forms."""
    text = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    parts = [part for part in re.split(r"[/()]", _normalize_unit(text)) if part]
    reasons = [_NO_UNITS[part.lower()] for part in parts if part.lower() in _NO_UNITS]
    if not reasons and any(_unit_name(part, _VOLTAGES) for part in parts):
        reasons = [f"a voltage says nothing without its sensor: {_VOLTAGE_REMEDY}"]
    because = f" ({reasons[0]})" if reasons else ""
    return InputError(f"cannot read {text!r} as the unit of {kind}{because}; write {accepted}")


def parse_unit(text: str) -> Unit:
    """The quantity of a channel whose unit is `text`, the factor from its numbers to SI, and whether it is a rotation.

    Parameters
    ----------
    text : str
        Such as ``m/s^2``, ``m/s2``, ``m/s/s``, ``in/sec^2``, ``mm``, ``mils``, ``deg/s``, ``g``, ``G`` or ``gn`` (an
        acceleration), ``kN``, ``lbs``, ``N m``, and ``V at 100 mV/g``, a voltage with the sensitivity of its sensor.

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
    unit = _read_unit(_normalize_unit(text))
    if unit is None:
        raise _unreadable_unit_error(text, "a channel", _ACCEPTED)
    return unit


def parse_frequency_unit(text: str) -> float:
    """Factor from a frequency in the unit `text` (Hz, kHz, rad/s, rpm in any common spelling) to Hz.

    Raises
    ------
    InputError
        If `text` is none of these; orders need the speed of rotation.

    Examples
    --------
    >>> parse_frequency_unit("kHz")
    1000.0
    """
    plain = _without_brackets(_normalize_unit(text))
    plain = re.sub(rf"(/|[ .*](?=\w+\^?-1$)){_TIME_WORD}(\^?-1)?$", "/s", plain, flags=re.IGNORECASE)
    name = _unit_name(plain, FREQUENCIES)
    if name is None:
        is_order = text.strip().lower() in ("order", "orders", "ord", "x rpm")
        because = " (orders are multiples of a speed of rotation: export frequencies)" if is_order else ""
        raise InputError(f"cannot read {text!r} as the unit of a frequency{because}; write Hz, kHz, rad/s or rpm")
    return FREQUENCIES[name]


def parse_time_unit(text: str) -> float:
    """Factor from a time in the unit `text` (s, ms, us, ns, min, h, day in any common spelling) to s.

    Raises
    ------
    InputError
        If `text` is none of these.

    Examples
    --------
    >>> parse_time_unit("msec")
    0.001
    """
    name = _unit_name(_without_brackets(_normalize_unit(text)), TIMES)
    if name is None:
        raise InputError(f"cannot read {text!r} as the unit of a time; write s, ms, us, min or day")
    return TIMES[name]


def _last_division(text: str) -> int:
    """Index in `text` of the last `/` outside of brackets, or -1."""
    depth, index = 0, -1
    for i, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if letter == "/" and depth == 0:
            index = i
    return index


def frf_unit_sides(text: str) -> tuple[Unit | None, Unit | None]:
    """The units before and after the last division in `text` (output, input); None for a side that is no unit.

    Both are None if there is no division outside of brackets.
    """
    whole = _without_brackets(_normalize_unit(text))
    cut = _last_division(whole)
    return (_read_unit(whole[:cut]), _read_unit(whole[cut + 1 :])) if cut > 0 else (None, None)


def parse_frf_unit(text: str) -> FrfUnit:
    """The kind of a frequency response function whose unit is `text`, the factor to SI, and which sides are rotations.

    Parameters
    ----------
    text : str
        Motion per force, such as ``(m/s^2)/N``, ``m/s^2/N``, ``g/lbf``, ``mm/N``, ``rad/(N m)``, or motion per motion,
        such as ``g/g``.

    Returns
    -------
    FrfUnit
        ``(kind, factor, output_rotation, input_rotation)``: kind is ``receptance``, ``mobility``, ``accelerance`` or
        ``transmissibility``, and values times `factor` are in SI.

    Raises
    ------
    InputError
        If `text` is not a motion divided by a force, a moment or the same kind of motion.

    Examples
    --------
    >>> parse_frf_unit("(mm/s)/kN")[:2]
    ('mobility', 1e-06)
    """
    above, below = frf_unit_sides(text)
    if above is not None and below is not None and above.quantity == below.quantity != "force":
        return FrfUnit("transmissibility", above.factor / below.factor, above.rotation, below.rotation)
    if above is None or below is None or above.quantity == "force" or below.quantity != "force":
        raise _unreadable_unit_error(text, "a frequency response function", _ACCEPTED_FRF + _ACCEPTED)
    return FrfUnit(_KINDS[above.quantity], above.factor / below.factor, above.rotation, below.rotation)
