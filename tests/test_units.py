"""Unit texts: factors by their definition, and a clear word on anything else."""

import math

import pytest

from structid.core.errors import InputError
from structid.core.units import parse_frequency_unit, parse_frf_unit, parse_time_unit, parse_unit

CHANNELS = [
    ("m", "displacement", 1, False), ("mm", "displacement", 1e-3, False), ("um", "displacement", 1e-6, False),
    ("µm", "displacement", 1e-6, False), ("cm", "displacement", 1e-2, False), ("km", "displacement", 1e3, False),
    ("in", "displacement", 0.0254, False), ("ft", "displacement", 0.3048, False), ("m/s", "velocity", 1, False),
    ("in/s", "velocity", 0.0254, False), ("mm / s", "velocity", 1e-3, False), ("m/s^2", "acceleration", 1, False),
    ("m/s2", "acceleration", 1, False), ("m/s**2", "acceleration", 1, False), ("m/s²", "acceleration", 1, False),
    ("(mm/s^2)", "acceleration", 1e-3, False), ("in/s^2", "acceleration", 0.0254, False),
    ("g", "acceleration", 9.80665, False), ("rad", "displacement", 1, True), ("deg", "displacement", math.pi / 180, True),
    ("rad/s", "velocity", 1, True), ("deg/s", "velocity", math.pi / 180, True), ("rad/s^2", "acceleration", 1, True),
    ("N", "force", 1, False), ("kN", "force", 1e3, False), ("mN", "force", 1e-3, False),
    ("lbf", "force", 0.45359237 * 9.80665, False), ("kgf", "force", 9.80665, False), ("N m", "force", 1, True),
    ("N*m", "force", 1, True), ("Nm", "force", 1, True), ("N·m", "force", 1, True), ("kN mm", "force", 1, True),
    ("lbf in", "force", 0.45359237 * 9.80665 * 0.0254, True), ("in-lbs", "force", 0.45359237 * 9.80665 * 0.0254, True),
    ("ft-lb", "force", 0.45359237 * 9.80665 * 0.3048, True), ("N.m", "force", 1, True), ("Nmm", "force", 1e-3, True),
    ("G", "acceleration", 9.80665, False), ("gn", "acceleration", 9.80665, False), ("g's", "acceleration", 9.80665, False),
    ("gs", "acceleration", 9.80665, False), ("gal", "acceleration", 0.01, False), ("Gal", "acceleration", 0.01, False),
    ("in/sec^2", "acceleration", 0.0254, False), ("IN/S**2", "acceleration", 0.0254, False), ("M/S2", "acceleration", 1, False),
    ("m/s/s", "acceleration", 1, False), ("m/sec/sec", "acceleration", 1, False), ("m/(s^2)", "acceleration", 1, False),
    ("m s^-2", "acceleration", 1, False), ("ms-2", "acceleration", 1, False), ("m·s⁻²", "acceleration", 1, False),
    ("meters/second^2", "acceleration", 1, False), ("mm/(s*s)", "acceleration", 1e-3, False), ("MM", "displacement", 1e-3, False),
    ("mil", "displacement", 25.4e-6, False), ("mils", "displacement", 25.4e-6, False), ("microns", "displacement", 1e-6, False),
    ("inches", "displacement", 0.0254, False), ("ips", "velocity", 0.0254, False), ("m s-1", "velocity", 1, False),
    ("lbs", "force", 0.45359237 * 9.80665, False), ("LB", "force", 0.45359237 * 9.80665, False),
    ("Lbf", "force", 0.45359237 * 9.80665, False), ("kips", "force", 453.59237 * 9.80665, False), ("daN", "force", 10, False),
    ("Newton", "force", 1, False), ("KN", "force", 1e3, False), ("n", "force", 1, False), ("°/s", "velocity", math.pi / 180, True),
    ("V at 100 mV/g", "acceleration", 98.0665, False), ("mV @ 10.2 mV/(m/s^2)", "acceleration", 1 / 10.2, False),
    ("V at 2.5mV/N", "force", 400, False),
]  # fmt: skip


@pytest.mark.parametrize("text, quantity, factor, rotation", CHANNELS)
def test_parse_unit_factor(text, quantity, factor, rotation):
    unit = parse_unit(text)
    assert (unit.quantity, unit.rotation) == (quantity, rotation)
    assert unit.factor == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(
    "text, kind, factor",
    [
        ("(m/s^2)/N", "accelerance", 1), ("m/s^2/N", "accelerance", 1), ("m/s2/N", "accelerance", 1),
        ("g/lbf", "accelerance", 9.80665 / (0.45359237 * 9.80665)), ("mm/N", "receptance", 1e-3),
        ("(mm/s)/kN", "mobility", 1e-6), ("((m/s^2)/N)", "accelerance", 1), ("rad/(N m)", "receptance", 1),
        ("m/N", "receptance", 1), ("(m/s)/(N*m)", "mobility", 1), ("G/LB", "accelerance", 1 / 0.45359237),
        ("in/sec^2/lbs", "accelerance", 0.0254 / (0.45359237 * 9.80665)),
        ("(V at 100 mV/g)/(V at 10 mV/N)", "accelerance", 9.80665 / 0.1 * 0.01),
    ],
)  # fmt: skip
def test_parse_frf_unit_factor(text, kind, factor):
    unit = parse_frf_unit(text)
    assert unit.kind == kind
    assert unit.factor == pytest.approx(factor, rel=1e-14)


def test_parse_frf_unit_tells_rotations():
    assert parse_frf_unit("rad/N")[2:] == (True, False)
    assert parse_frf_unit("m/(N m)")[2:] == (False, True)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "V",
        "m/s^3",
        "M",
        "EU",
        "m//s",
        "s",
        "N/m",
        "kg",
        "m s",
        "g/s",
        "Pa",
        "rad m",
        "nm",
        "MG",
        "Mn",
        "tons",
        "dB",
    ],
)
def test_parse_unit_refuses(text):
    with pytest.raises(InputError, match="mm/s") as caught:
        parse_unit(text)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize("text", ["", "N", "m/s^2", "N/N", "N/m", "m/g", "V/N", "/N", "m/", "m/s^2//N"])
def test_parse_frf_unit_refuses(text):
    with pytest.raises(InputError, match=r"\(m/s\^2\)/N") as caught:
        parse_frf_unit(text)
    assert repr(text) in str(caught.value)


def test_motion_per_the_same_motion_is_transmissibility():
    assert parse_frf_unit("g/(m/s^2)") == ("transmissibility", 9.80665, False, False)
    assert parse_frf_unit("(rad/s^2)/(m/s^2)") == ("transmissibility", 1.0, True, False)


@pytest.mark.parametrize("text, words", [
    ("V", "V at 100 mV/g"), ("EU", "engineering units"), ("kg", "kg is a mass"), ("dB", "dB is a level"),
])  # fmt: skip
def test_what_is_no_unit_is_told_why(text, words):
    with pytest.raises(InputError, match=words):
        parse_unit(text)
    with pytest.raises(InputError, match=words):
        parse_frf_unit(f"{text}/N")


FREQUENCIES = [
    ("Hz", 1), ("HZ", 1), ("hertz", 1), ("kHz", 1e3), ("KHz", 1e3), ("rad/s", 1 / (2 * math.pi)),
    ("rad/sec", 1 / (2 * math.pi)), ("Rad/Sec", 1 / (2 * math.pi)), ("rad s-1", 1 / (2 * math.pi)),
    ("rad s^-1", 1 / (2 * math.pi)), ("(rad/s)", 1 / (2 * math.pi)), ("rpm", 1 / 60), ("RPM", 1 / 60), ("1/min", 1 / 60),
    ("rev/min", 1 / 60), ("cps", 1),
]  # fmt: skip
TIMES = [
    ("s", 1), ("sec", 1), ("Seconds", 1), ("S", 1), ("ms", 1e-3), ("msec", 1e-3), ("millis", 1e-3), ("MS", 1e-3), ("us", 1e-6),
    ("µs", 1e-6), ("usec", 1e-6), ("min", 60), ("minutes", 60), ("ns", 1e-9), ("h", 3600),
]  # fmt: skip


@pytest.mark.parametrize("parse, text, factor", [
    *((parse_frequency_unit, *case) for case in FREQUENCIES), *((parse_time_unit, *case) for case in TIMES),
])  # fmt: skip
def test_units_of_axes(parse, text, factor):
    assert parse(text) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("parse, text, words", [
    (parse_frequency_unit, "orders", "multiples of a speed"), (parse_frequency_unit, "1/s", "Hz, kHz, rad/s or rpm"),
    (parse_frequency_unit, "s", "rad/s"), (parse_frequency_unit, "MHZ", "kHz"), (parse_frequency_unit, "", "kHz"),
    (parse_time_unit, "m", "s, ms, us, min or day"), (parse_time_unit, "Hz", "ms"), (parse_time_unit, "samples", "ms"),
])  # fmt: skip
def test_units_of_axes_refused(parse, text, words):
    with pytest.raises(InputError, match=words):
        parse(text)
