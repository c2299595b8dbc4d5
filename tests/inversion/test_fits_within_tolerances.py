"""Refits with fixed values free, and the triangular systems of searches, on problems that are written out."""

import numpy as np
import pytest

from structid.core.errors import SingularModelError
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


def test_a_refit_begins_at_the_end_of_one_to_a_part_only_if_it_fits_all_data_better():
    held, theta = FixedValues(Valley(), {f"{FIXED}mass[floor]": 1.0}), np.array([1.1])
    far, near = np.array([-60.0, 3.0]), np.array([1.0, 0.0])
    from_theta = held.refit(("p",), theta, 4.42)
    assert held.refit(("p",), theta, 4.42, start=far).theta.tolist() == from_theta.theta.tolist()
    assert held.refit(("p",), theta, 4.42, start=near).theta == pytest.approx(near, abs=1e-12)


class Plateau(Problem):
    """A stiffness exp(k), least (0) at 1, that nothing feels where it is small, and a fixed value whose error is a third row."""

    unknowns = FreeUnknowns(("k", f"{FIXED}mass[floor]"), np.array([0.3, 0.0]))
    rows = DataRows(np.arange(2), np.zeros(2, int))

    def residual(self, theta):
        stiffness = np.exp(theta[0])
        return np.array([10 * (stiffness**2 - 1), 20 * (stiffness**2 - 1) * (1 + theta[1]), theta[1]])

    def linearize(self, theta):
        slope, error = 2 * np.exp(2 * theta[0]), theta[1]
        rows = [[10 * slope, 0.0], [20 * slope * (1 + error), 20 * (np.exp(2 * theta[0]) - 1)], [0.0, 1.0]]
        return Linearization(self.residual(theta), np.array(rows), 2)


def test_a_value_that_ran_away_goes_back_to_its_start_where_the_refit_does_not_find_the_way():
    """From exp(-8) of a stiffness no step leads back; the sum of squares there is 500 on 2 data."""
    held = FixedValues(Plateau(), {f"{FIXED}mass[floor]": 1.0})
    end = held.refit(("k",), np.array([-8.0]), 500.0)
    assert end.theta == pytest.approx([0.0, 0.0], abs=1e-3)
    assert end.chi_square == pytest.approx(0.0, abs=1e-5)


class Line(Problem):
    """Two parameters, and a fixed value that the data put almost 10 tolerances off; `is_broken` leaves no model between."""

    unknowns = FreeUnknowns(("a", f"{FIXED}mass[floor]", "b"), np.zeros(3))
    rows = DataRows(np.arange(3), np.zeros(3, int))

    def __init__(self, is_broken=False):
        self.is_broken = is_broken

    def residual(self, theta):
        a, error, b = theta
        if self.is_broken and 0 < error < 10:
            raise SingularModelError("no such model")
        return np.array([10 * (a - 1 - 0.2 * error), 10 * (b - 2 - 0.1 * error**2), 5 * (error - 10), error])

    def linearize(self, theta):
        rows = [[10, -2, 0], [0, -2 * theta[1], 10], [0, 5, 0], [0, 1, 0]]
        return Linearization(self.residual(theta), np.array(rows, dtype=float))


@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")])
def test_what_follows_a_likely_move_is_told_in_the_order_of_the_names(names):
    """A likely move is one tolerance: a = 1.2 and b = 2.1 fit best there."""
    theta = np.array([{"a": 1.0, "b": 2.0}[name] for name in names])
    held = FixedValues(Line(), {f"{FIXED}mass[floor]": 1.0})
    within = held.followed(held.refit(names, theta, 2500.0), names, theta)
    assert dict(zip(names, within.followed, strict=True)) == pytest.approx({"a": 1.2, "b": 2.1}, rel=1e-3)
    assert within.chi_square == pytest.approx(2500 / 26, rel=1e-3)
    assert within.explained == pytest.approx(
        (2500 - within.chi_square) / (2500 - 1), rel=1e-9
    )  # a fourth row tells noise


def test_where_a_likely_move_cannot_be_followed_it_is_on_the_straight_line_to_the_fit():
    theta = np.array([1.0, 2.0])
    end = np.array([3.0, 10.0, 12.0])
    held = FixedValues(Line(is_broken=True), {f"{FIXED}mass[floor]": 1.0})
    within = held.followed(held.fit_at(end, ("a", "b")), ("a", "b"), theta)
    assert within.likely == pytest.approx([1.0])
    assert within.followed == pytest.approx([1.2, 3.0])


def test_triangular_systems_of_no_unknown_or_no_side_have_empty_solutions(capfd):
    for shape in ((0, 0), (3, 0)):
        right = np.zeros(shape)
        assert solve_upper(np.eye(shape[0]), right).shape == shape
    assert solve_upper(np.zeros((0, 0)), np.zeros(0)).shape == (0,)
    assert capfd.readouterr().err == ""


def test_a_singular_triangle_is_refused():
    with pytest.raises(np.linalg.LinAlgError, match="diagonal entry 2"):
        solve_upper(np.diag([1.0, 0.0]), np.ones(2))
