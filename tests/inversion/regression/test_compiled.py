"""Compiled rows and triangles of blocks against dense rows: groups, products where they hold, reflections elsewhere."""

import numpy as np
import pytest
from scipy import sparse

from structid.inversion.regression import no_rows
from structid.inversion.regression.local_reduction import FoldingKernels, has_numba, row_maker

pytestmark = pytest.mark.skipif(not has_numba(), reason="no numba")
ONE, NUMPY = FoldingKernels("numba"), FoldingKernels("numpy")


def nodes(n=5, together=3, span=5, seed=0):
    """Columns and operator of a line of nodes with some degrees of freedom each, elements of `span` parameters.

    Rows of one column at one node are of the same fields, but for the first of each element, of its own field only.
    """
    rng = np.random.default_rng(seed)
    side, n_blocks = 2 * span + 1, n * together
    columns = np.repeat((np.arange(n)[:, None] * span + np.arange(2 * span)), together, axis=0)
    rows = []
    for block in range(n_blocks):
        node, dof = divmod(block, together)
        for slot in range(2 * span):
            first = (node + slot // span) * together  # fields of two nodes of the element
            own = [first + dof] if slot % span == 0 else list(range(first, first + 2 * together))
            rows += [(block * side + slot, field, rng.uniform(0.5, 1.5)) for field in own]
        rows.append((block * side + side - 1, (n + 2) * together + block, 1.0))
    row, field, value = zip(*rows, strict=True)
    shape = (n_blocks * side, (n + 2) * together + n_blocks)
    return columns, sparse.csr_array(sparse.coo_array((value, (row, field)), shape))


def reduced(columns, operator, fields, work=ONE):
    return no_rows(columns, int(columns.max()) + 1).reduced(operator, fields, work)


def gram_error(state, operator, fields):
    """Largest error of R'R of any block, in parts of what the norms of its columns would be if nothing cancelled."""
    rows = (operator @ fields).reshape(*state.triangles.shape[:2], -1)
    expected = rows @ np.swapaxes(rows, 1, 2)
    size = np.linalg.norm(abs(operator) @ np.abs(fields), axis=1).reshape(rows.shape[:2])
    found = np.swapaxes(state.triangles, 1, 2) @ state.triangles
    return float(np.abs((found - expected) / (size[:, :, None] * size[:, None, :])).max())


@pytest.mark.parametrize(("together", "span"), [(1, 5), (2, 5), (3, 5), (4, 5), (1, 1), (2, 2), (2, 3), (3, 4)])
@pytest.mark.parametrize("n_times", [1, 4, 39, 40, 131, 700, 4500])
def test_every_product_of_the_rows_is_kept(together, span, n_times):
    """Groups of one to four blocks, stretches with and without remainders of vectors, in one call and in two."""
    columns, operator = nodes(together=together, span=span)
    fields = np.random.default_rng(1).standard_normal((operator.shape[1], n_times))
    state = reduced(columns, operator, fields)
    rounding = 1e-14 + np.finfo(float).eps * n_times / 8  # of sums in so many parts at least
    assert gram_error(state, operator, fields) <= rounding
    assert (np.tril(state.triangles, -1) == 0).all()
    both = reduced(columns, operator, fields[:, : n_times // 2]).reduced(operator, fields[:, n_times // 2 :], ONE)
    assert gram_error(both, operator, fields) <= rounding


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_a_bit(threads):
    columns, operator = nodes(n=7)
    fields = np.random.default_rng(2).standard_normal((operator.shape[1], 900))
    single = reduced(columns, operator, fields)
    assert np.array_equal(
        single.triangles, reduced(columns, operator, fields, FoldingKernels("numba", threads)).triangles
    )


def values_of(triangle):
    return np.linalg.solve(triangle[:-1, :-1], triangle[:-1, -1])


def exact_values(matrix, right):
    """Least squares of these numbers, refined with residuals in extended precision."""
    wide, target = matrix.astype(np.longdouble), right.astype(np.longdouble)
    triangle = np.linalg.qr(matrix, mode="r")
    found = np.zeros(matrix.shape[1], dtype=np.longdouble)
    for _ in range(12):
        slope = (wide.T @ (target - wide @ found)).astype(np.float64)
        found = found + np.linalg.solve(triangle, np.linalg.solve(triangle.T, slope))
    return found.astype(np.float64)


@pytest.mark.parametrize(("n", "products"), [(2, 1e-14), (3, 1e-14), (6, 1e-14), (8, 1e-14), (12, 1e-13)])
@pytest.mark.parametrize("condition", [1.0, 10.0, 30.0, 1e3, 1e6, 1e10])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_values_have_the_digits_of_a_qr(n, products, condition, noise):
    """Columns with one weak direction: errors at most those of a QR, or so little where products are taken.

    Medians of seven draws: what rounding does to one of a condition of 1e10 is chance, a hundredth or ten times as much.
    """
    rng = np.random.default_rng(int(condition))
    columns, operator = np.arange(n)[None], sparse.csr_array(sparse.eye_array(n + 1))
    errors, sizes = [], []
    for _ in range(7):
        matrix = rng.standard_normal((600, n))
        weak = rng.standard_normal(n) / np.sqrt(n)
        matrix = matrix - np.outer(matrix @ weak, weak / (weak @ weak)) * (1 - 1 / condition)
        right = matrix @ rng.uniform(1, 2, n) + noise * rng.standard_normal(600)
        fields = np.column_stack([matrix, right]).T
        expected = exact_values(matrix, right)
        found = [values_of(reduced(columns, operator, fields, work).triangles[0]) for work in (ONE, NUMPY)]
        errors.append([np.linalg.norm(values - expected) for values in found])
        sizes.append(np.linalg.norm(expected))
    of_compiled, of_qr = np.median(errors, axis=0)
    assert of_compiled <= 10 * of_qr + products * np.median(sizes)


@pytest.mark.parametrize("n", [3, 6, 8, 12])
def test_residual_of_exact_data_is_of_rounding(n):
    """Taken as a difference of sums of squares it would stop at 1e-8 of the right-hand side."""
    rng = np.random.default_rng(5)
    matrix = rng.standard_normal((800, n))
    right = matrix @ rng.uniform(1, 2, n)
    fields, operator = np.column_stack([matrix, right]).T, sparse.csr_array(sparse.eye_array(n + 1))
    state = reduced(np.arange(n)[None], operator, fields)
    again = state.reduced(operator, fields, ONE)
    for found in (state, again):
        assert abs(found.triangles[0, -1, -1]) <= 1e-13 * np.linalg.norm(right)


@pytest.mark.parametrize("n", [3, 6, 8, 12])
def test_a_weak_direction_that_shows_late_is_taken_by_reflections(n):
    """A calm, well-conditioned start; then all columns move as one, ten million times as far."""
    rng = np.random.default_rng(6)
    calm = rng.standard_normal((400, n))
    loud = np.outer(rng.standard_normal(400), np.ones(n)) * 1e7 + rng.standard_normal((400, n))
    matrix = np.concatenate([calm, loud])
    right = matrix @ rng.uniform(1, 2, n) + rng.standard_normal(800)
    operator, columns = sparse.csr_array(sparse.eye_array(n + 1)), np.arange(n)[None]
    fields = np.column_stack([matrix, right]).T
    expected = exact_values(matrix, right)
    whole = reduced(columns, operator, fields)
    parts = reduced(columns, operator, fields[:, :400]).reduced(operator, fields[:, 400:], ONE)
    for state in (whole, parts):
        assert values_of(state.triangles[0]) == pytest.approx(expected, rel=1e-7)
    plain = reduced(columns, operator, fields, NUMPY)
    assert np.abs(whole.triangles) == pytest.approx(np.abs(plain.triangles), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("n", [7, 12])
def test_silent_and_repeated_columns_stay_what_they_are(n):
    rng = np.random.default_rng(7)
    matrix = rng.standard_normal((500, n))
    matrix[:, 2] = 0.0
    matrix[:, n - 1] = 2 * matrix[:, 4]
    fields = np.column_stack([matrix, rng.standard_normal(500)]).T
    operator, columns = sparse.csr_array(sparse.eye_array(n + 1)), np.arange(n)[None]
    triangle = reduced(columns, operator, fields).triangles[0]
    assert (triangle[:, 2] == 0).all()
    assert abs(triangle[n - 1, n - 1]) <= 1e-12 * np.linalg.norm(matrix[:, n - 1])
    gram = fields @ fields.T
    assert triangle.T @ triangle == pytest.approx(gram, abs=1e-12 * gram.max())


def two_stretches(first, second, noises, seed):
    """Triangles by compiled kernels and by NumPy of right-hand sides with noise, one stretch after the other."""
    rng = np.random.default_rng(seed)
    values, columns = rng.uniform(1, 2, first.shape[1]), np.arange(first.shape[1])[None]
    operator, found = sparse.csr_array(sparse.eye_array(first.shape[1] + 1)), []
    right = [
        part @ values + noise * rng.standard_normal(len(part))
        for part, noise in zip((first, second), noises, strict=True)
    ]
    for work in (ONE, NUMPY):
        state = reduced(columns, operator, np.column_stack([first, right[0]]).T, work)
        state = state.reduced(operator, np.column_stack([second, right[1]]).T, work)
        found.append(np.abs(state.triangles[0]))
    return found


@pytest.mark.parametrize("n", [6, 12, 24])
@pytest.mark.parametrize("noise", [1e-6, 1e-3])
def test_a_small_residual_keeps_its_digits(n, noise):
    """As the root of a difference of sums of squares it would have ten digits, or four."""
    rng = np.random.default_rng(11)
    matrix = rng.standard_normal((800, n))
    right = matrix @ rng.uniform(1, 2, n) + noise * rng.standard_normal(800)
    fields, operator = np.column_stack([matrix, right]).T, sparse.csr_array(sparse.eye_array(n + 1))
    compiled, plain = (reduced(np.arange(n)[None], operator, fields, work).triangles[0] for work in (ONE, NUMPY))
    assert abs(compiled[-1, -1]) == pytest.approx(abs(plain[-1, -1]), rel=1e-14 / noise)


@pytest.mark.parametrize("n", [2, 4, 6, 8])
def test_a_direction_that_outgrows_the_others_keeps_their_digits(n):
    """Products over a triangle of equal columns would leave half of them."""
    rng = np.random.default_rng(8)
    loud = 1e5 * np.outer(rng.standard_normal(600), rng.uniform(1, 2, n)) + rng.standard_normal((600, n))
    compiled, plain = two_stretches(rng.standard_normal((600, n)), loud, (1e-6, 0.1), 1)
    assert compiled == pytest.approx(plain, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("n", [2, 4, 6, 8])
def test_a_residual_far_below_the_first_guess_keeps_its_digits(n):
    """First the noise of instruments, which gives values of no worth; then motion a billion times as large."""
    rng = np.random.default_rng(8)
    compiled, plain = two_stretches(1e-9 * rng.standard_normal((600, n)), rng.standard_normal((600, n)), (1e-7,) * 2, 1)
    assert compiled[-1, -1] == pytest.approx(plain[-1, -1], rel=1e-7)


def test_a_column_that_was_silent_at_first_does_not_make_the_triangle_empty():
    rng = np.random.default_rng(9)
    fields, operator, columns = rng.standard_normal((7, 900)), sparse.csr_array(sparse.eye_array(7)), np.arange(6)[None]
    fields[0, :400] = 0.0
    state = reduced(columns, operator, fields[:, :400]).reduced(operator, fields[:, 400:], ONE)
    assert state.triangles[0].T @ state.triangles[0] == pytest.approx(fields @ fields.T, rel=1e-12, abs=1e-10)


@pytest.mark.parametrize("n", [6, 12])
def test_a_force_that_was_silent_at_first_keeps_what_came_before(n):
    """Its parameters are zero then, as they are of an empty triangle, and all of the force is explained later on."""
    rng = np.random.default_rng(12)
    matrix, operator = rng.standard_normal((1200, n)), sparse.csr_array(sparse.eye_array(n + 1))
    right = np.where(np.arange(1200) < 500, 0.0, 1e3 * (matrix @ rng.uniform(1, 2, n)))
    right[500:] += 1e-3 * rng.standard_normal(700)
    matrix[:500] *= 1e-6
    fields, columns = np.column_stack([matrix, right]).T, np.arange(n)[None]
    state = reduced(columns, operator, fields[:, :500]).reduced(operator, fields[:, 500:], ONE)
    products = state.triangles[0].T @ state.triangles[0]
    size = np.linalg.norm(fields, axis=1)
    assert np.abs(products - fields @ fields.T).max() <= 1e-13 * size.max() ** 2
    once = reduced(columns, operator, fields).triangles[0]
    assert np.abs(once) == pytest.approx(np.abs(state.triangles[0]), rel=1e-9)
    loud = reduced(columns, operator, 1e6 * fields[:, :500]).reduced(operator, fields[:, 500:], ONE).triangles[0]
    expected = np.linalg.qr(np.concatenate([1e6 * fields[:, :500].T, fields[:, 500:].T]), mode="r")
    assert np.abs(loud) == pytest.approx(np.abs(expected), rel=1e-9)


def test_what_is_not_a_number_arrives():
    columns, operator = nodes()
    fields = np.random.default_rng(3).standard_normal((operator.shape[1], 300))
    fields[4, 200] = np.nan
    touched = np.isnan(operator @ fields).any(axis=1).reshape(len(columns), -1).any(axis=1)
    found = np.isnan(reduced(columns, operator, fields).triangles).any(axis=(1, 2))
    assert touched.any()
    assert found[touched].all()
    assert not found[~touched].any()


@pytest.mark.parametrize("together", [1, 2, 3, 4, 7])
def test_groups_are_those_of_a_plain_count(together):
    columns, operator = nodes(n=4, together=together)
    sizes = np.diff(row_maker(operator, columns).blocks.heads)
    assert sizes.tolist() == ([3] * (together // 3) + [together % 3] * (together % 3 > 0)) * 4
