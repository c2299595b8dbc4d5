"""Refits with fixed values free, and the triangular systems of searches, on problems that are written out."""

import numpy as np
import pytest

from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.fixed_values import FIXED
from structid.inversion.linearization import solve_upper
from structid.inversion.search.within_tolerances import FixedValues


class Valley(Problem):
    """Rosenbrock's curved valley, least (0) at p = 1 and a fixed value of factor 1, whose error counts as a third row."""

    unknowns = FreeUnknowns(("p", f"{FIXED}mass[floor]"), np.array([-1.2, 0.0]))
    rows = DataRows(np.arange(2), np.zeros(2, int))

    def residual(self, theta):
        p, error = theta
        return np.array([10 * (1 + error - p**2), 1 - p, error])

    def linearize(self, theta):
        return Linearization(self.residual(theta), np.array([[-20 * theta[0], 10.0], [-1.0, 0.0], [0.0, 1.0]]), 2)


def test_a_refit_that_begins_far_off_and_comes_near_goes_on_to_its_minimum():
    """It begins at 24.2 on 2 data, where short steps are taken, and is near long before it ends."""
    held = FixedValues(Valley(), {f"{FIXED}mass[floor]": 1.0})
    end = held.refit(("p",), np.array([-1.2]), 24.2)
    assert end.theta == pytest.approx([1.0, 0.0], abs=1e-3)
    assert end.chi_square == pytest.approx(0.0, abs=1e-5)


def test_triangular_systems_of_no_unknown_or_no_side_have_empty_solutions(capfd):
    for shape in ((0, 0), (3, 0)):
        right = np.zeros(shape)
        assert solve_upper(np.eye(shape[0]), right).shape == shape
    assert solve_upper(np.zeros((0, 0)), np.zeros(0)).shape == (0,)
    assert capfd.readouterr().err == ""


def test_a_singular_triangle_is_refused():
    with pytest.raises(np.linalg.LinAlgError, match="diagonal entry 2"):
        solve_upper(np.diag([1.0, 0.0]), np.ones(2))
