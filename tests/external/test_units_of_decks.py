"""Units of a deck: mass is force by acceleration, and shapes of unit mass go with its root."""

import numpy as np
import pytest

from structid.external.modes_model import _shapes_in_si
from structid.external.outputs import RunModes
from structid.external.solved import Units


@pytest.mark.parametrize(
    "force, length, mass",
    [("N", "m", 1.0), ("N", "mm", 1000.0), ("kN", "m", 1000.0), ("lbf", "in", 0.45359237 * 9.80665 / 0.0254)],
)
def test_the_unit_of_mass_is_that_of_force_by_acceleration(force, length, mass):
    """A tonne in N and mm, a slinch of 175.1 kg in pounds and inches."""
    assert Units(length, force).mass == pytest.approx(mass, rel=1e-12)


def test_shapes_of_unit_mass_come_to_metres_radians_and_kilograms():
    """A shape of t^-1/2 is one of (1000 kg)^-1/2; its rotations are rad per mm and come to rad per m."""
    shapes = RunModes(np.array([1.0]), np.array([[7, 1], [7, 5]]), np.array([[2.0], [0.3]]), has_mass=True)
    found = _shapes_in_si(shapes, Units("mm", "N")).values
    np.testing.assert_allclose(found[:, 0], [2.0 / np.sqrt(1000.0), 0.3 * 1000.0 / np.sqrt(1000.0)], rtol=1e-12)
