"""Unit texts: factors by their definition, and a clear word on anything else."""

import math

import pytest

from structid.core.errors import InputError
from structid.core.units import parse_frf_unit, parse_unit

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
    ("lbf in", "force", 0.45359237 * 9.80665 * 0.0254, True),
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
        ("m/N", "receptance", 1), ("(m/s)/(N*m)", "mobility", 1),
    ],
)  # fmt: skip
def test_parse_frf_unit_factor(text, kind, factor):
    unit = parse_frf_unit(text)
    assert unit.kind == kind
    assert unit.factor == pytest.approx(factor, rel=1e-14)


def test_parse_frf_unit_tells_rotations():
    assert parse_frf_unit("rad/N")[2:] == (True, False)
    assert parse_frf_unit("m/(N m)")[2:] == (False, True)


@pytest.mark.parametrize("text", ["", "V", "m/s^3", "M", "G", "m//s", "s", "N/m", "kg", "m s", "g/s", "Pa", "rad m"])
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
