"""Local reduction and the solution of many blocks against dense least squares; NumPy against compiled kernels."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import sparse

from structid import InputError
from structid.inversion.regression import no_rows
from structid.inversion.regression.block_least_squares import WIDEST_BAND, band_layout, block_solution
from structid.inversion.regression.local_reduction import FoldingKernels, has_numba, shared_out

ENGINES = [
    FoldingKernels("numpy"),
    pytest.param(
        FoldingKernels("numba") if has_numba() else None, marks=pytest.mark.skipif(not has_numba(), reason="no numba")
    ),
]
SIZES = np.array([1.0, 1e3, 1e-4])


def chain(n, rng, span=3, shuffled=False):
    """Columns of n blocks along a line, each of two neighbouring elements with `span` parameters; numbers shuffled."""
    element = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
    columns = (element[:, :, None] * span + np.arange(span)).reshape(n, -1)
    return rng.permutation(span * (n + 1))[columns] if shuffled else columns


def grid(n_across, n_along):
    """Columns of the nodes of a rectangle of elements with one parameter each, up to four a node."""
    index = np.full((n_along + 2, n_across + 2), -1)
    index[1:-1, 1:-1] = np.arange(n_along * n_across).reshape(n_along, n_across)
    around = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]], axis=-1).reshape(-1, 4)
    return np.sort(around, axis=1)[:, ::-1]


def problem(columns, n_times=25, noise=0.05, seed=0):
    """Operator, fields, dense rows and right-hand side of blocks with columns of unlike size."""
    rng = np.random.default_rng(seed)
    n_blocks, width = columns.shape
    n_params = int(columns.max()) + 1
    side, n_fields = width + 1, 3 * n_blocks
    dense = np.where(rng.random((n_blocks, side, n_fields)) < 6 / n_fields, 1.0, 0.0) * rng.standard_normal(n_fields)
    dense[:, :-1][columns < 0] = 0.0
    dense[:, :-1] *= np.where(columns >= 0, SIZES[columns % 3], 0.0)[..., None]
    dense[np.arange(n_blocks), -1, np.arange(n_blocks)] += 1.0
    for slot in range(width):
        dense[np.arange(n_blocks), slot, n_blocks + np.arange(n_blocks)] += np.where(
            columns[:, slot] >= 0, SIZES[columns[:, slot] % 3] * (1 + slot), 0.0
        )
    operator = sparse.csr_array(dense.reshape(n_blocks * side, n_fields))
    fields = rng.standard_normal((n_fields, n_times))
    rows = np.einsum("bsf,ft->bts", dense, fields)
    wide = np.zeros((n_blocks, n_times, n_params + 1))
    for slot in range(width):
        used = np.flatnonzero(columns[:, slot] >= 0)
        wide[used, :, columns[used, slot]] += rows[used, :, slot]
    return operator, fields, wide[..., :n_params].reshape(-1, n_params), rows[..., -1].ravel()


def reduced(columns, operator, fields, work):
    return no_rows(columns, int(columns.max()) + 1).reduced(operator, fields, work)


def dense_answer(matrix, right):
    scale = np.linalg.norm(matrix, axis=0)
    values = np.linalg.lstsq(matrix / scale, right, rcond=None)[0] / scale
    rest = right - matrix @ values
    covariance = np.linalg.inv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
    freedom = len(right) - matrix.shape[1]
    return values, covariance * (rest @ rest) / freedom, rest @ rest, np.linalg.cond(matrix / scale)


@pytest.mark.parametrize("work", ENGINES)
@pytest.mark.parametrize(
    "shape", ["chain", "shuffled chain", "long chain", "short rows", "grid", "one column", "five columns"]
)
def test_solution_equals_dense_least_squares(work, shape):
    """Values to 1e-10 of each, the deviations to 1e-9; conditions reach 1e3."""
    rng = np.random.default_rng(1)
    columns = {
        "chain": chain(12, rng),
        "shuffled chain": chain(12, rng, shuffled=True),
        "long chain": chain(60, rng, shuffled=True),
        "short rows": np.concatenate([chain(9, rng), np.full((9, 2), -1)], axis=1),
        "grid": grid(4, 5),
        "one column": chain(7, rng, 1)[:, :1],
        "five columns": chain(7, rng, 3)[:, :5],
    }[shape]
    operator, fields, matrix, right = problem(columns)
    found = block_solution(reduced(columns, operator, fields, work))
    values, covariance, rest, condition = dense_answer(matrix, right)
    assert found.values == pytest.approx(values, rel=1e-10)
    assert found.residual_sum == pytest.approx(rest, rel=1e-11)
    assert found.degrees_of_freedom == len(right) - matrix.shape[1]
    assert found.standard_deviations() == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-9)
    some = [0, matrix.shape[1] - 1]
    assert found.covariance(some) == pytest.approx(covariance[np.ix_(some, some)], rel=1e-8)
    assert 0.8 * condition <= found.condition <= condition * (1 + 1e-9)
    assert found.method.startswith("banded")


@pytest.mark.parametrize("work", ENGINES)
@pytest.mark.parametrize("n_times", [1, 7, 300, 1500])
def test_reduction_keeps_every_product_of_the_rows(work, n_times):
    """R'R = B'B block by block, whatever the stretches that the samples are cut into."""
    columns = chain(6, np.random.default_rng(0))
    operator, fields, *_ = problem(columns, n_times)
    state = reduced(columns, operator, fields, work)
    rows = (operator @ fields).reshape(6, 7, -1)
    expected = rows @ np.swapaxes(rows, 1, 2)
    size = np.sqrt(np.einsum("bii->bi", expected))
    found = np.swapaxes(state.triangles, 1, 2) @ state.triangles
    assert (np.abs(found - expected) <= 1e-12 * size[:, :, None] * size[:, None, :]).all()
    assert (np.tril(state.triangles, -1) == 0).all()
    assert state.n_rows == 6 * n_times


@pytest.mark.skipif(not has_numba(), reason="no numba")
@pytest.mark.parametrize("seed", range(3))
def test_numpy_and_compiled_kernels_agree_on_any_number_of_threads(seed):
    columns = chain(11, np.random.default_rng(seed), shuffled=True)
    operator, fields, *_ = problem(columns, 40, seed=seed)
    plain, single, double = (
        reduced(columns, operator, fields, w)
        for w in (FoldingKernels("numpy"), FoldingKernels("numba"), FoldingKernels("numba", 2))
    )
    assert np.array_equal(single.triangles, double.triangles)
    answers = [block_solution(state) for state in (plain, single)]
    for found in answers[1:]:
        assert found.values == pytest.approx(answers[0].values, rel=1e-12)
        assert found.standard_deviations() == pytest.approx(answers[0].standard_deviations(), rel=1e-11)


@pytest.mark.parametrize("work", ENGINES)
def test_cuts_and_merging_do_not_matter(work):
    """Thirty seeded cuts into two to four parts, reduced apart and merged in any order: 1e-12 of one pass."""
    columns = chain(8, np.random.default_rng(3))
    operator, fields, *_ = problem(columns, 60)
    whole = block_solution(reduced(columns, operator, fields, work))
    rng = np.random.default_rng(4)
    for _ in range(30):
        edges = [0, *sorted(rng.integers(0, 61, rng.integers(1, 4)).tolist()), 60]
        parts = [reduced(columns, operator, fields[:, a:b], work) for a, b in pairwise(edges)]
        rng.shuffle(parts)
        merged = parts[0]
        for part in parts[1:]:
            merged = merged.merged(part)
        found = block_solution(merged)
        assert found.values == pytest.approx(whole.values, rel=1e-12)
        assert found.residual_sum == pytest.approx(whole.residual_sum, rel=1e-12)


@pytest.mark.parametrize("span", [2, 9, 30])
def test_bands_narrower_and_wider_than_a_window(span):
    columns = chain(200 // span, np.random.default_rng(2), span, shuffled=True)
    n_params = int(columns.max()) + 1
    rows = np.random.default_rng(3).standard_normal((len(columns), 3 * span, 2 * span + 1))
    found = block_solution(no_rows(columns, n_params).updated(rows))
    wide = np.zeros((len(columns), 3 * span, n_params))
    wide[np.arange(len(columns))[:, None], :, columns] = np.swapaxes(rows[..., :-1], 1, 2)
    values, covariance, rest, _ = dense_answer(wide.reshape(-1, n_params), rows[..., -1].ravel())
    assert found.method == f"banded orthogonal sweep, {2 * span} wide"
    assert found.values == pytest.approx(values, rel=1e-9, abs=1e-11)
    assert found.residual_sum == pytest.approx(rest, rel=1e-11)
    assert found.standard_deviations() == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-10)


def test_wide_meshes_go_through_sparse_normal_equations():
    columns = grid(WIDEST_BAND + 4, WIDEST_BAND + 4)
    state = no_rows(columns, int(columns.max()) + 1)
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((len(columns), 6, 5)) * [1, 1, 1, 1, 0.1]
    rows[..., :4] *= np.where(columns >= 0, SIZES[columns % 3], 0.0)[:, None, :]
    actual = rng.uniform(1, 2, state.n_params) / SIZES[np.arange(state.n_params) % 3]
    rows[..., 4] += np.einsum("btk,bk->bt", rows[..., :4], np.where(columns >= 0, actual[columns], 0.0))
    state = state.updated(rows)
    found = block_solution(state)
    assert found.method.startswith("sparse normal equations")
    block, slot = np.nonzero(columns >= 0)
    data = np.swapaxes(rows[..., :4], 1, 2)[block, slot]
    place = (block[:, None] * 6 + np.arange(6), np.broadcast_to(columns[block, slot][:, None], data.shape))
    matrix = sparse.csr_array((data.ravel(), (place[0].ravel(), place[1].ravel())), (6 * len(columns), state.n_params))
    gradient = matrix.T @ (matrix @ found.values - rows[..., 4].ravel())
    norm = np.sqrt((matrix**2).sum(axis=0))
    assert np.abs(gradient / norm).max() <= 1e-12 * np.linalg.norm(rows[..., 4])
    some = np.array([0, 5000, 17000])
    unit = sparse.linalg.spsolve(sparse.csc_array(matrix.T @ matrix), np.eye(1, state.n_params, 5000)[0])
    assert found.covariance(some)[:, 1] == pytest.approx(found.residual_variance * unit[some], rel=1e-6, abs=1e-18)


@pytest.mark.parametrize("work", ENGINES)
def test_directions_that_the_rows_do_not_determine_are_nan_and_the_others_exact(work):
    """Parameters 4 and 7 of a chain always in one ratio, 11 in no row at all."""
    columns = chain(10, np.random.default_rng(0), 3)
    operator, fields, matrix, right = problem(columns, noise=0)
    state = reduced(columns, operator, fields, work)
    change = np.eye(state.n_params)
    change[:, 7] = change[:, 4] * 2
    change[:, 11] = 0.0
    changed = matrix @ change
    triangles = state.triangles.copy()
    block, slot = np.nonzero(columns == 7)
    for b, s in zip(block, slot, strict=True):
        other = np.flatnonzero(columns[b] == 4)
        triangles[b, :, s] = 2 * triangles[b, :, other[0]] if len(other) else 0.0
    block, slot = np.nonzero(columns == 4)
    for b, s in zip(block, slot, strict=True):
        if 7 not in columns[b]:
            triangles[b, :, s] = 0.0
            changed[b * 25 : (b + 1) * 25, 4] = 0.0
    block, slot = np.nonzero(columns == 11)
    triangles[block, :, slot] = 0.0
    triangles = np.linalg.qr(triangles, mode="r")
    found = block_solution(replace(state, triangles=triangles))
    assert np.flatnonzero(np.isnan(found.values)).tolist() == [4, 7, 11]
    assert (found.rank, found.condition) == (state.n_params - 2, np.inf)
    assert np.flatnonzero(~found.seen).tolist() == [11]
    keep = np.setdiff1d(np.arange(state.n_params), [7, 11])
    expected = dense_answer(changed[:, keep], right)
    known = np.setdiff1d(np.arange(state.n_params), [4, 7, 11])
    assert found.values[known] == pytest.approx(expected[0][np.isin(keep, known)], rel=1e-9)
    assert found.residual_sum == pytest.approx(expected[2], rel=1e-9)
    assert np.isnan(found.standard_deviations()[[4, 7, 11]]).all()
    assert np.isnan(found.covariance([0, 4])[1]).all()


def test_chain_order_is_found_from_any_numbering():
    rng = np.random.default_rng(5)
    assert band_layout(chain(200, rng, shuffled=True), 603).width <= 9
    assert band_layout(chain(200, rng), 603).width <= 9


def test_threads_share_out_everything_once():
    seen = []
    shared_out(7, 3, lambda a, b: seen.extend(range(a, b)))
    assert sorted(seen) == list(range(7))
    shared_out(0, 2, lambda a, b: seen.append(-1))
    assert -1 not in seen


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda: FoldingKernels("fortran"), "`engine` must be"),
        (lambda: FoldingKernels("numpy", 0), "`threads` must be 1 or more"),
        (
            lambda: no_rows(np.array([[0]]), 1).reduced(sparse.csr_array((3, 2)), np.ones((2, 1))),
            "`operator` must have",
        ),
        pytest.param(
            lambda: no_rows(np.array([[-1, 0]]), 1).reduced(
                sparse.csr_array((3, 2)), np.ones((2, 1)), FoldingKernels("numba")
            ),
            "must come last",
            marks=pytest.mark.skipif(not has_numba(), reason="no numba"),
        ),
    ],
)
def test_bad_input_is_refused(act, words):
    with pytest.raises(InputError, match=words):
        act()
