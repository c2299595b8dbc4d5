"""The deviation of a deck's value that several sought parameters make together."""

from types import SimpleNamespace as Parts

import numpy as np
import pytest
from scipy import sparse

from structid.study.run.solver import _move, deck_std


def fit(covariance, design):
    """A solver's model of two values, E and t, that three parameters a, b, c make; the estimate has them in another order."""
    properties = [
        Parts(element="deck", term=Parts(property=name), values=slice(i, i + 1)) for i, name in enumerate("Et")
    ]
    parameters = Parts(names=("a", "b", "c"), offset=np.array([7.0, -2.0]), design=sparse.csc_array(design))
    order = [2, 0, 1]
    covariance = covariance[np.ix_(order, order)]
    estimate = Parts(
        names=("c", "a", "b"),
        std=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        uncertainty=Parts(has_matrix=True),
    )
    solved = Parts(model=Parts(name="deck"), at={"E": 1.0, "t": 1.0})
    return solved, Parts(
        problems=[Parts(parameters=parameters, structure=Parts(properties=properties))], estimate=estimate
    )


def test_it_is_that_of_the_weighted_sum_correlations_included():
    root = np.random.default_rng(4).standard_normal((3, 3))
    covariance, design = root @ root.T, np.array([[1.0, -1.0, 0.5], [0.0, 2.0, 3.0]])
    std = deck_std(*fit(covariance, design))
    draws = np.random.default_rng(5).multivariate_normal(np.zeros(3), covariance, 400_000) @ design.T
    assert [std["E"], std["t"]] == pytest.approx(draws.std(axis=0), rel=0.01)


def test_what_the_data_do_not_determine_adds_nothing():
    covariance = np.diag([4.0, np.nan, 1.0])
    assert deck_std(*fit(covariance, np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]))) == {"E": 2.0, "t": 0.0}


def test_a_move_is_told_in_standard_deviations_only_where_they_set_the_limit():
    """1 % of a standard deviation, or 1e-6 of the value, counts as no move."""
    assert _move("E", 200.0, 203.0, 2.0) == (pytest.approx(150.0), "E", "by 1.5 standard deviations")
    assert _move("E", 200.0, 200.003, 0.0) == (pytest.approx(15.0), "E", "from 200 to 200.003")
    assert _move("E", 200.0, 200.003, 1e-3) == (pytest.approx(15.0), "E", "from 200 to 200.003")
    assert _move("E", 0.0, 0.5, 0.0).words == "from 0 to 0.5"
