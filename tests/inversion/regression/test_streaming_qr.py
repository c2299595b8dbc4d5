"""Streaming QR against dense least squares, on problems without a finite element."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structid import InputError
from structid.inversion.regression import no_rows
from structid.inversion.regression.streaming_qr import folded_triangle

COLUMNS = np.array([[0, 1, -1], [1, 2, 3], [3, 4, -1], [4, 0, 2]])
N_PARAMS = 5
ACTUAL = np.array([2.0, -3e-3, 5e4, 0.7, 1e-3])


def problem(seed, n_rows=12, noise=0.1):
    """Rows of every block (n_blocks, n_rows, n_columns + 1) with columns of very unlike size, and the dense B and c."""
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 1e3, 1e-4, 1.0, 1e3])
    rows = rng.standard_normal((4, n_rows, 4))
    dense = np.zeros((4, n_rows, N_PARAMS))
    for block, own in enumerate(COLUMNS):
        used = own >= 0
        rows[block][:, :3][:, ~used] = 0.0
        rows[block][:, :3][:, used] *= size[own[used]]
        dense[block][:, own[used]] = rows[block][:, :3][:, used]
    rows[..., 3] = dense @ ACTUAL + noise * rng.standard_normal(dense.shape[:2])
    return rows, dense.reshape(-1, N_PARAMS), rows[..., 3].ravel()


def test_solution_and_covariance_equal_those_of_dense_least_squares():
    """To 1e-12 of each value: the columns are well conditioned once scaled."""
    rows, matrix, right = problem(1)
    found = no_rows(COLUMNS, N_PARAMS).updated(rows).solution()
    expected = np.linalg.lstsq(matrix / np.linalg.norm(matrix, axis=0), right, rcond=None)[0]
    expected /= np.linalg.norm(matrix, axis=0)
    residual = right - matrix @ expected
    scale = np.linalg.norm(matrix, axis=0)
    inverse = np.linalg.inv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
    assert found.values == pytest.approx(expected, rel=1e-12)
    assert (found.rank, found.degrees_of_freedom) == (5, 43)
    assert found.residual_variance == pytest.approx(residual @ residual / 43, rel=1e-11)
    assert found.covariance == pytest.approx(inverse * (residual @ residual) / 43, rel=1e-9, abs=0)
    assert found.condition == pytest.approx(np.linalg.cond(matrix / scale), rel=1e-10)
    assert found.triangle.T @ found.triangle == pytest.approx(matrix.T @ matrix, rel=1e-9, abs=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.lists(st.integers(0, 12), max_size=6), st.booleans())
def test_any_cut_and_any_order_of_merging_give_the_same_answer(seed, cuts, backwards):
    rows, _, _ = problem(seed)
    start = no_rows(COLUMNS, N_PARAMS)
    whole = start.updated(rows).solution()
    edges = [0, *sorted(cuts), 12]
    parts = [start.updated(rows[:, a:b]) for a, b in pairwise(edges)]
    parts = parts[::-1] if backwards else parts
    merged = parts[0]
    for part in parts[1:]:
        merged = merged.merged(part)
    one_by_one = start
    for k in range(12):
        one_by_one = one_by_one.updated(rows[:, k : k + 1])
    for found in (merged.solution(), one_by_one.solution()):
        assert found.values == pytest.approx(whole.values, rel=1e-12)
        assert found.residual_sum == pytest.approx(whole.residual_sum, rel=1e-11)
        assert found.degrees_of_freedom == whole.degrees_of_freedom == 43


def test_merging_is_associative():
    rows, _, _ = problem(4)
    a, b, c = (no_rows(COLUMNS, N_PARAMS).updated(rows[:, k : k + 4]) for k in (0, 4, 8))
    left, right = a.merged(b).merged(c).solution(), a.merged(b.merged(c)).solution()
    assert left.values == pytest.approx(right.values, rel=1e-13)


def test_unseen_directions_are_nan_and_the_others_exact():
    """Columns 3 and 4 always in one ratio: neither is known, the other three are."""
    actual = np.array([2.0, -3.0, 0.5, 0.7, 1.0])
    a, b, c = np.random.default_rng(3).standard_normal((3, 30))
    columns = np.array([[0, 1, 2, 3, 4]])
    data = np.stack([a, b, a * b, c, 2 * c], axis=1)
    found = no_rows(columns, 5).updated(np.column_stack([data, data @ actual])[None]).solution()
    assert (found.rank, found.condition) == (4, np.inf)
    assert np.isnan(found.values).tolist() == [False, False, False, True, True]
    assert found.values[:3] == pytest.approx(actual[:3], rel=1e-12)
    assert np.isnan(found.covariance[3:]).all()
    assert np.isfinite(found.covariance[:3, :3]).all()
    assert found.seen.all()


def test_residual_below_full_rank_is_that_of_dense_least_squares():
    rng = np.random.default_rng(8)
    data = rng.standard_normal((30, 2)) @ np.array([[1.0, 0, 1], [0, 1, 1]])
    right = rng.standard_normal(30)
    found = no_rows(np.array([[0, 1, 2]]), 3).updated(np.column_stack([data, right])[None]).solution()
    residual = right - data @ np.linalg.lstsq(data, right, rcond=None)[0]
    assert found.residual_sum == pytest.approx(residual @ residual, rel=1e-12)
    assert (found.rank, found.degrees_of_freedom) == (2, 28)


def test_a_column_of_rounding_counts_as_zero_though_scaling_would_hide_it():
    rng = np.random.default_rng(5)
    data = rng.standard_normal((40, 2)) * [1.0, 1e-15]
    rows = np.column_stack([data, 3 * data[:, 0] + 0.01 * rng.standard_normal(40)])[None]
    state = no_rows(np.array([[0, 1]]), 2).updated(rows)
    assert state.solution().rank == 2
    found = state.solution(size=np.array([6.0, 6.0]))
    assert found.rank == 1
    assert found.seen.tolist() == [True, False]
    assert np.isnan(found.values[1])
    assert found.values[0] == pytest.approx(3.0, abs=0.02)


def test_no_degrees_of_freedom_give_values_without_covariance():
    found = no_rows(np.array([[0, 1]]), 2).updated(np.array([[[1.0, 0, 2], [0, 1, 3]]])).solution()
    assert found.values == pytest.approx([2.0, 3.0])
    assert found.degrees_of_freedom == 0
    assert np.isnan(found.covariance).all()


def test_many_problems_fold_at_once():
    states = [no_rows(COLUMNS, N_PARAMS).updated(problem(seed)[0]) for seed in range(3)]
    together = folded_triangle(np.stack([s.triangles for s in states]), COLUMNS, N_PARAMS)
    for state, triangle in zip(states, together, strict=True):
        assert np.abs(triangle) == pytest.approx(np.abs(state.triangle()), rel=1e-9, abs=1e-9)


def test_state_does_not_grow_and_never_changes():
    rows, _, _ = problem(6)
    state = no_rows(COLUMNS, N_PARAMS).updated(rows)
    kept = state.triangles.copy()
    later = state.updated(rows).updated(rows)
    assert later.triangles.shape == state.triangles.shape == (4, 4, 4)
    assert np.array_equal(state.triangles, kept)
    assert (state.n_rows, later.n_rows) == (48, 144)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (np.zeros((3, 2, 4)), "`rows` must have shape"),
        (np.zeros((4, 2, 3)), "`rows` must have shape"),
        (np.full((4, 2, 4), np.nan), "`rows` must be finite"),
    ],
)
def test_rows_that_do_not_fit_are_refused(rows, words):
    with pytest.raises(InputError, match=words):
        no_rows(COLUMNS, N_PARAMS).updated(rows)


def test_states_of_other_problems_are_refused():
    with pytest.raises(InputError, match="cannot be merged"):
        no_rows(COLUMNS, N_PARAMS).merged(no_rows(COLUMNS[::-1], N_PARAMS))
    with pytest.raises(InputError, match="from -1 to 4"):
        no_rows(np.array([[0, 5]]), N_PARAMS)
