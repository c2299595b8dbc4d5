"""Optimal design against the textbook: dense determinants and traces, exhaustive search, Kammer's iteration."""

from itertools import combinations

import numpy as np
import pytest

from structid import InputError
from structid.inversion.diagnostics.design import (
    effective_independence,
    exchanged,
    gains,
    greedy,
    ignorance,
    information_root,
    merit,
    optimal,
    relative_std,
)

N_PARAMS = 4


@pytest.fixture
def candidates():
    """Nine blocks of two rows on four parameters of very different visibility."""
    rng = np.random.default_rng(3)
    return rng.standard_normal((9, 2, N_PARAMS)) * np.array([1.0, 10.0, 0.1, 3.0])


def covariance(*blocks):
    """(J'J)^-1 of all rows, by plain inversion."""
    rows = np.vstack(blocks)
    return np.linalg.inv(rows.T @ rows)


def value(rows, criterion, wanted):
    """Criterion that is to be made large, written out."""
    part = covariance(rows)[np.ix_(wanted, wanted)]
    return -np.log(np.linalg.det(part)) if criterion == "d" else -np.trace(part)


@pytest.mark.parametrize("criterion", ["d", "a"])
@pytest.mark.parametrize("wanted", [[True] * 4, [True, False, True, False], [False, False, False, True]])
def test_gains_are_the_change_of_the_criterion(candidates, criterion, wanted):
    known = np.vstack([ignorance(N_PARAMS), candidates[0]])
    wanted = np.array(wanted)
    before = value(known, criterion, wanted)
    assert merit(known, criterion, wanted) == pytest.approx(before, rel=1e-9)
    expected = [value(np.vstack([known, block]), criterion, wanted) - before for block in candidates]
    assert gains(candidates, known, criterion, wanted) == pytest.approx(expected, rel=1e-9)


def test_gains_do_not_depend_on_how_rows_are_blocked(candidates, monkeypatch):
    whole = gains(candidates, ignorance(N_PARAMS))
    monkeypatch.setattr("structid.inversion.diagnostics.design._BLOCK_ENTRIES", 1)
    assert gains(candidates, ignorance(N_PARAMS)) == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("criterion", ["d", "a"])
def test_greedy_takes_the_largest_gain_each_time(candidates, criterion):
    everything = np.ones(N_PARAMS, bool)
    order = greedy(candidates, ignorance(N_PARAMS), 3, criterion)
    chosen = []
    for place in order:
        rest = [i for i in range(9) if i not in chosen]
        scores = {
            i: value(np.vstack([ignorance(N_PARAMS), *candidates[[*chosen, i]]]), criterion, everything) for i in rest
        }
        assert place == max(scores, key=scores.get)
        chosen.append(place)


@pytest.mark.parametrize("criterion", ["d", "a"])
@pytest.mark.parametrize("count", [2, 4])
def test_optimal_reaches_the_best_of_all_sets(candidates, criterion, count):
    everything, known = np.ones(N_PARAMS, bool), ignorance(N_PARAMS)

    def score(members):
        return value(np.vstack([known, *candidates[list(members)]]), criterion, everything)

    best = max(combinations(range(9), count), key=score)
    assert score(optimal(candidates, known, count, criterion)) == pytest.approx(score(best), rel=1e-10)


def test_exchange_leaves_a_poor_choice(candidates):
    known = ignorance(N_PARAMS)
    best = set(optimal(candidates, known, 3))
    worst = tuple(sorted(set(range(9)) - best)[:3])
    assert set(exchanged(candidates, known, worst)) == best


def test_exchange_repeats_nothing(candidates):
    assert len(set(exchanged(candidates, ignorance(N_PARAMS), (0, 1, 2, 3, 4)))) == 5


def test_greedy_ends_where_it_is_enough(candidates):
    order = greedy(candidates, ignorance(N_PARAMS), 9, enough=lambda chosen: len(chosen) == 2)
    assert order == greedy(candidates, ignorance(N_PARAMS), 9)[:2]


def test_relative_std_is_the_bound_and_nan_where_nothing_is_seen(candidates):
    rows = candidates.reshape(-1, N_PARAMS)
    assert relative_std(rows) == pytest.approx(np.sqrt(np.diag(covariance(rows))), rel=1e-10)
    blind = rows.copy()
    blind[:, 2] = 0.0
    assert np.isnan(relative_std(blind)).tolist() == [False, False, True, False]
    assert np.isnan(relative_std(rows[:0])).all()


def test_relative_std_survives_what_squaring_loses():
    rows = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-9]])
    assert relative_std(rows)[0] == pytest.approx(np.sqrt(2) * 1e9, rel=1e-5)


def test_information_root_has_the_same_information():
    rows = np.random.default_rng(0).standard_normal((3, 7, 4))
    root = information_root(rows)
    assert root.shape == (3, 4, 4)
    assert np.swapaxes(root, 1, 2) @ root == pytest.approx(np.swapaxes(rows, 1, 2) @ rows, rel=1e-12, abs=1e-12)


def test_effective_independence_is_kammers_iteration():
    shapes = np.random.default_rng(1).standard_normal((12, 3))
    kept = list(range(12))
    while len(kept) > 4:
        part = shapes[kept]
        score = np.diag(part @ np.linalg.inv(part.T @ part) @ part.T)
        assert score.sum() == pytest.approx(3)
        kept.pop(int(np.argmin(score)))
    assert effective_independence(shapes, 4) == tuple(kept)


def test_effective_independence_drops_a_node_of_all_modes_first():
    shapes = np.array([[1.0, 0.5], [0.0, 0.0], [0.3, -1.0]])
    assert effective_independence(shapes, 2) == (0, 2)


def test_counts_that_cannot_be_are_told(candidates):
    with pytest.raises(InputError, match="from 0 to the number of candidates, 9, got 10"):
        greedy(candidates, ignorance(N_PARAMS), 10)
    with pytest.raises(InputError, match="at least the number of modes, got 1 for 2"):
        effective_independence(np.ones((3, 2)), 1)


def test_blind_candidates_are_taken_once_at_most():
    blind = np.zeros((3, 1, N_PARAMS))
    assert sorted(greedy(blind, ignorance(N_PARAMS), 3)) == [0, 1, 2]
    assert len(set(optimal(blind, ignorance(N_PARAMS), 2))) == 2
