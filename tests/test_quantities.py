"""Numbers and units in the report."""
# ruff: noqa: RUF001

from __future__ import annotations

import numpy as np
import pytest

from structid.core.display import exact, number, percent, unit_text, with_std


@pytest.mark.parametrize(
    "value, std, text",
    [
        (8.31234, 0.0457, "8.312 ± 0.046"),
        (8.31234, 0.0996, "8.31 ± 0.10"),
        (1234.5, 67.8, "1234 ± 68"),
        (45678.9, 1234.0, "45700 ± 1200"),
        (2.1e6, 3.1e4, "(2.100 ± 0.031)×10⁶"),
        (-3.2e-5, 4e-7, "(−3.200 ± 0.040)×10⁻⁵"),
        (0.0, 0.5, "0.00 ± 0.50"),
        (9.9996, 0.5, "10.00 ± 0.50"),
        (2.0, float("nan"), "2.000 ± not determined"),
        (2.0, float("inf"), "2.000 ± not determined"),
        (2.0, 0.0, "2.000 ± 0"),
        (2.0, 3e9, "2.000 ± 3.0×10⁹"),
        (1.0, 2e-12, "1.000000000 ± 2.0×10⁻¹²"),
        (float("nan"), 1.0, "–"),
    ],
)
def test_value_and_std_have_matching_digits(value: float, std: float, text: str) -> None:
    assert with_std(value, std) == text


def test_value_and_std_read_back_to_half_a_unit_of_the_last_digit_of_the_std() -> None:
    random = np.random.default_rng(3)
    for _ in range(500):
        value = float(random.standard_normal() * 10.0 ** random.uniform(-8, 8))
        std = abs(value) * float(10.0 ** random.uniform(-6, 1))
        text = with_std(value, std).replace("−", "-")
        scale = 1.0
        if text.startswith("("):
            text, _, power = text[1:].partition(")×10")
            scale = 10.0 ** int(power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")))
        shown, shown_std = (float(part) * scale for part in text.split(" ± "))
        # two significant digits of std: at most 5 % of it is lost, in either number
        assert abs(shown_std - std) <= 0.0501 * std
        assert abs(shown - value) <= 0.0501 * std


def test_numbers_keep_their_significant_digits() -> None:
    assert [number(x) for x in (0.0123456, 123456.0, 12345.0, 0.0, -1.5)] == [
        "0.01235",
        "1.235×10⁵",
        "12340",
        "0",
        "−1.500",
    ]
    assert [exact(x) for x in (80.0, 0.02, 1200.0, 2.1e6)] == ["80", "0.02", "1200", "2.1×10⁶"]


def test_percentages_and_units() -> None:
    assert [percent(x) for x in (-0.1234, 0.00046, 0.0, 1.95)] == ["−12.3 %", "+0.05 %", "0.00 %", "+195 %"]
    assert [percent(x) for x in (4.9e-5, -1.2e-5, 1e-8, 1e-15)] == ["+0.0049 %", "−0.0012 %", "+1.0×10⁻⁶ %", "+0.00 %"]
    assert percent(1.2e-8, 2, signed=False, most_decimals=6) == "0.000001 %"
    assert [unit_text(u) for u in ("(m/s^2)/N", "N m^2 s", "1")] == ["(m/s²)/N", "N m² s", ""]
