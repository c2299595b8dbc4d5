"""Polynomials in the parameters: found, verified, and refused where there are none."""

from __future__ import annotations

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.external.deck import Deck, DeckParameter
from structid.external.expansion import expansion

NAMES = ("E", "t", "r")


def deck(**values: float) -> Deck:
    own = [DeckParameter(name, value, step=None if value else 0.1) for name, value in values.items()]
    return Deck({"d": " ".join("{{" + name + "}}" for name in values)}, own)


class Counted:
    """Numbers of three rows by a function of the values, and how many different points were asked for."""

    def __init__(self, function):
        self.function, self.points = function, set()

    def __call__(self, points):
        self.points |= {tuple(sorted(point.items())) for point in points}
        rows = np.array([self.function(**point) for point in points])
        return rows, np.abs(rows).max(axis=0) + 1e-300


def shell(E, t, r):
    return np.array([3.0 + E * (2 * t + 5 * t**3), r * t, 7.0])


def test_an_affine_dependence_takes_two_points_a_parameter_and_one_of_all():
    evaluate = Counted(lambda E, r: np.array([3.0 + 2e-11 * E, 5 * r - 1e-11 * E, 4.0]))
    found = expansion(evaluate, deck(E=2.1e11, r=7800.0))
    assert found.orders == {"E": 1, "r": 1}
    assert found.crossed == ()
    assert found.error < 1e-14
    assert len(evaluate.points) == found.n_points == 6
    np.testing.assert_allclose(found.at({"E": 1e10, "r": 1.0}), [3.2, 4.9, 4.0], rtol=1e-12)
    assert set(found.coefficients) == {(), (("E", 1),), (("r", 1),)}
    assert not found.coefficients[()][1]  # nothing constant where all goes with parameters


def test_powers_and_products_are_found_and_hold_far_away():
    found = expansion(Counted(shell), deck(E=2.0, t=0.5, r=7.8))
    assert found.orders == {"E": 1, "t": 3, "r": 1}
    assert set(found.crossed) == {("E", "t"), ("t", "r")}
    far = {"E": 5.0, "t": 2.0, "r": 1.0}
    np.testing.assert_allclose(found.at(far), shell(**far), rtol=1e-9)


def test_a_parameter_may_be_nothing_at_first():
    found = expansion(Counted(lambda E, r: np.array([1.0 + r, E, E + r**2])), deck(E=2.0, r=0.0))
    np.testing.assert_allclose(found.at({"E": 3.0, "r": 0.5}), [1.5, 3.0, 3.25], rtol=1e-10)


@pytest.mark.parametrize(
    "function, message",
    [
        (lambda E, t: np.array([E, np.exp(5 * t), 1.0]), "no polynomial in 't' up to order 4"),
        (lambda E, t: np.array([E, E / t, 1.0]), "no polynomial in 't' up to order 4"),
        (lambda E, t: np.array([E, 1.0, 2.0]), "parameter 't' has no effect"),
    ],
)
def test_what_is_no_polynomial_or_has_no_effect_is_refused(function, message):
    with pytest.raises(InputError, match=message):
        expansion(Counted(function), deck(E=2.0, t=0.5))


def test_three_parameters_multiplied_are_refused():
    with pytest.raises(InputError, match="no polynomial in E, t, r together"):
        expansion(Counted(lambda E, t, r: np.array([E * t * r, 1.0, 2.0])), deck(E=2.0, t=0.5, r=3.0))


def test_rounding_of_the_files_leaves_no_trace_in_what_a_parameter_does_not_change():
    rng = np.random.default_rng(1)

    def noisy(E, r):
        return np.array([E, 5.0, r]) * (1 + 1e-14 * rng.standard_normal(3))

    found = expansion(Counted(noisy), deck(E=2.0, r=3.0))
    assert [int(np.count_nonzero(row)) for row in found.coefficients.values()] == [1, 1, 1]


def test_numbers_that_further_points_add_stand_at_the_end():
    """As of matrices whose entries cancel to exact zeros in some runs: those come with the points where they do not."""
    rounding = 1e-15

    def evaluate(points):
        rows = np.array(
            [[E, t, E * t, rounding if E != 2.0 and t != 0.5 else 0.0] for E, t in (p.values() for p in points)]
        )
        rows = rows if rows[:, 3].any() else rows[:, :3]
        return rows, np.full(rows.shape[1], 5.0)

    found = expansion(evaluate, deck(E=2.0, t=0.5))
    np.testing.assert_allclose(found.at({"E": 3.0, "t": 0.2}), [3.0, 0.2, 0.6, 0.0], atol=1e-13)
