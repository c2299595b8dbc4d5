"""Prefixes of units: the factor and the letter say the same power of a thousand."""

import pytest

from structid.core.display import prefixed

LETTERS = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


@pytest.mark.parametrize(
    "value, prefix", [(999.0, ""), (1e3, "k"), (4.2e5, "k"), (2.5e7, "M"), (7e10, "G"), (7e13, "G")]
)
@pytest.mark.parametrize("unit, shown", [("N/m", "N/m"), ("N m^2", "N m²"), ("Pa", "Pa")])
def test_the_largest_value_has_few_digits_and_its_size_is_kept(value, prefix, unit, shown):
    assert prefixed(unit, -value, 0.1 * value, float("nan")) == (LETTERS[prefix], prefix + shown)


def test_units_without_force_stay():
    assert prefixed("kg", 2e6) == (1.0, "kg")
