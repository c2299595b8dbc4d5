"""Factors of element matrices have the slopes of differences away from the nominal values too, and links turn the right way."""

import numpy as np
import pytest

from structid.core.dof import DIRECTIONS
from structid.fem.contribution import LengthFactor, Monomial, ShearFactor
from structid.fem.elements.element import dof_code
from structid.fem.node_positions import LengthDependence
from structid.fem.supports import RigidLink

NOMINAL = np.array([2.0, 3.0, 5.0, 7.0])
PLACES = (slice(0, 2), slice(2, 4))
LENGTH_DEPENDENCE = LengthDependence(
    np.array([4.0, 6.0]),
    (np.array([0, 1]), np.array([2, 3])),
    (np.array([1.0, 0.0]), np.array([-1.0, 1.0])),
    (NOMINAL[:2], NOMINAL[2:]),
)
FACTORS = [
    *(ShearFactor(*PLACES, np.array([0.3, 0.9]), np.array([0.6, 0.4]), power) for power in (1, 2)),
    *(Monomial(PLACES, (NOMINAL[:2], NOMINAL[2:]), (power, 1)) for power in (1, 3)),
    *(LengthFactor(LENGTH_DEPENDENCE, power) for power in (-3, 1, 2)),
]


@pytest.mark.parametrize("factor", FACTORS, ids=lambda factor: type(factor).__name__)
@pytest.mark.parametrize("change", [1.0, 1.3])
def test_the_slope_of_a_factor_is_its_difference(factor, change):
    values = change * NOMINAL
    for number, place in enumerate(factor.value_indices):
        step = np.zeros(4)
        step[place] = 1e-6
        difference = (factor.of(values + step) - factor.of(values - step)) / 2e-6
        np.testing.assert_allclose(factor.slope(values, number), difference, rtol=1e-7, atol=1e-9)


def test_a_rigid_link_in_space_moves_by_the_cross_product_of_rotation_and_arm():
    arm, motion, turn = np.array([0.3, -0.7, 1.1]), np.array([1.0, 2.0, -0.5]), np.array([0.2, -0.4, 0.9])
    main = dict(zip(DIRECTIONS, (*motion, *turn), strict=True))
    equations = RigidLink("link", 1, 2).equations({1: np.zeros(3), 2: arm}, DIRECTIONS)
    for direction, expected in zip(DIRECTIONS, (*(motion + np.cross(turn, arm)), *turn), strict=True):
        terms = equations[dof_code(2, direction)]
        assert sum(terms.get(dof_code(1, d), 0.0) * main[d] for d in DIRECTIONS) == pytest.approx(expected, rel=1e-14)
