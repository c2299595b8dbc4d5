"""Factorizers against dense solutions, their choice, and what they say where they cannot work."""

import pickle

import numpy as np
import pytest
from scipy import sparse

from structid.core.errors import InputError, SingularModelError
from structid.dynamics import factorization
from structid.dynamics.factorization import (
    FACTORIZERS,
    SingularMatrixError,
    factorizer,
    installed_factorizers,
    usable_threads,
)
from structid.dynamics.receptance import DynamicStiffness

needs_mkl = pytest.mark.skipif(bool(factorization.mkl_problem()), reason=f"no MKL here: {factorization.mkl_problem()}")
MARKS = {"pardiso": needs_mkl, "superlu": ()}
AVAILABLE = [pytest.param(name, marks=MARKS[name]) for name in FACTORIZERS]
HELD = [pytest.param(name, marks=MARKS[name]) for name in ("pardiso",)]


def pattern(n=90, seed=3):
    """A symmetric pattern with a full diagonal, and random symmetric entries, indefinite."""
    rng = np.random.default_rng(seed)
    upper = sparse.random_array((n, n), density=0.06, rng=rng, format="csc")
    matrix = sparse.csc_array(upper + upper.T + sparse.diags_array(rng.standard_normal(n)))
    matrix.sort_indices()
    return matrix


@pytest.mark.parametrize("name", AVAILABLE)
@pytest.mark.parametrize("is_complex", [False, True])
def test_solution_equals_the_dense_one_for_matrix_after_matrix(name, is_complex):
    matrix = pattern()
    analysis = factorizer(name).analyse(matrix.indices, matrix.indptr)
    rng = np.random.default_rng(0)
    for turn in range(3):
        a = sparse.csc_array(matrix + (0.3 * turn + 0.1) * sparse.eye_array(len(matrix.indptr) - 1))
        a = a + 0.2j * a @ sparse.eye_array(a.shape[0]) * (turn + 1) if is_complex else a
        a.sort_indices()
        assert np.array_equal(a.indices, matrix.indices)
        right = rng.standard_normal((a.shape[0], 7))
        factor = analysis.factor(a.data)
        for given in (right, right[:, :1], right + 1j * right[:, ::-1]):
            exact = np.linalg.solve(a.toarray(), given)
            assert factor.solve(given) == pytest.approx(exact, rel=1e-9, abs=1e-9 * np.abs(exact).max())
        assert np.iscomplexobj(factor.solve(right)) == is_complex


@needs_mkl
def test_an_analysis_serves_whoever_allows_fewer_threads_later(monkeypatch):
    """The library reads beyond its memory where it factorizes with fewer threads than it analysed with."""
    line = sparse.diags_array([2 * np.ones(13), -np.ones(12), -np.ones(12)], offsets=[0, 1, -1])
    whole = sparse.kron(sparse.kron(line, sparse.eye_array(13)), np.ones((4, 4)) + 4 * np.eye(4))
    whole = whole + sparse.kron(sparse.kron(sparse.eye_array(13), line), np.ones((4, 4)) + 4 * np.eye(4))
    matrix = sparse.csc_array(sparse.kron(whole, line) * (1 + 0.02j))
    matrix.sort_indices()
    right = np.random.default_rng(2).standard_normal((matrix.shape[0], 3))
    monkeypatch.setenv("STRUCTID_THREADS", "2")
    analysis = factorizer("pardiso").analyse(matrix.indices, matrix.indptr)
    first = analysis.factor(matrix.data).solve(right)
    for threads in ("1", "4"):
        monkeypatch.setenv("STRUCTID_THREADS", threads)
        again = analysis.factor(matrix.data).solve(right)
        assert again == pytest.approx(first, rel=1e-9, abs=1e-9 * np.abs(first).max())


@pytest.mark.parametrize("name", AVAILABLE)
def test_singular_matrix_is_named(name):
    chain = sparse.diags_array([-np.ones(79), 2 * np.ones(80), -np.ones(79)], offsets=[-1, 0, 1]).tolil()
    chain[0, 0] = chain[-1, -1] = 1.0  # free at both ends
    matrix = sparse.csc_array(chain)
    analysis = factorizer(name).analyse(matrix.indices, matrix.indptr)
    right = np.zeros((80, 1))
    right[3] = 1.0
    with pytest.raises(SingularMatrixError):
        analysis.factor(matrix.data).solve(right)
    with pytest.raises(SingularMatrixError, match="finite"):
        analysis.factor(np.full(matrix.nnz, np.nan))
    stiffness = DynamicStiffness(analysis, matrix.data[None], np.ones((1, 1), complex), np.zeros(1))
    with pytest.raises(SingularModelError, match="at 0 Hz: the structure has a mechanism"):
        stiffness.solver(0).solve(right)


def test_entries_are_real_where_nothing_damps():
    matrix = pattern()
    data = np.stack([matrix.data, np.zeros(matrix.nnz), 2 * matrix.data, 0.1 * matrix.data])
    coefficients = np.array([[-9.0, 3j, 1.0, 0.0], [-9.0, 3j, 1.0, 1j]])
    stiffness = DynamicStiffness(
        factorizer("superlu").analyse(matrix.indices, matrix.indptr), data, coefficients, np.ones(2)
    )
    real, damped = stiffness.entries(0), stiffness.entries(1)
    assert real.dtype == np.float64
    assert real == pytest.approx(-7 * matrix.data)
    assert damped == pytest.approx((-7 + 0.1j) * matrix.data)


def test_rows_that_are_multiples_of_each_other_are_merged():
    matrix = pattern()
    rng = np.random.default_rng(6)
    data = np.stack(
        [rng.standard_normal(matrix.nnz), 0 * matrix.data, matrix.data, 0.02 * matrix.data, 1e-3 + matrix.data]
    )
    coefficients = rng.standard_normal((4, 5)) + 1j * rng.standard_normal((4, 5))
    stiffness = DynamicStiffness(
        factorizer("superlu").analyse(matrix.indices, matrix.indptr), data, coefficients, np.ones(4)
    )
    assert len(stiffness.merged) == 3
    for line in range(4):
        assert stiffness.entries(line) == pytest.approx(coefficients[line] @ data, rel=1e-12)


@pytest.mark.parametrize("name", AVAILABLE)
@pytest.mark.parametrize("is_complex", [False, True])
def test_right_hand_sides_on_few_unknowns_and_on_all_are_solved_alike(name, is_complex):
    matrix = pattern()
    n = matrix.shape[0]
    loaded = np.zeros(n, dtype=bool)
    loaded[[3, 40, 88]] = True
    analysis = factorizer(name).analyse(matrix.indices, matrix.indptr, loaded)
    data = matrix.data * (1 + 0.3j) if is_complex else matrix.data
    factor, whole = analysis.factor(data), np.random.default_rng(1).standard_normal((n, 4))
    for right in (whole * loaded[:, None], whole, whole * ~loaded[:, None], (1 + 2j) * whole * loaded[:, None]):
        exact = np.linalg.solve(matrix.toarray() * (data / matrix.data)[0], right)
        assert factor.solve(right) == pytest.approx(exact, rel=1e-9, abs=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("name", HELD)
def test_factor_held_by_a_library_ends_with_the_next_and_its_analysis_travels(name):
    matrix = pattern()
    analysis = factorizer(name).analyse(matrix.indices, matrix.indptr)
    first = analysis.factor(matrix.data)
    right = np.ones((matrix.shape[0], 2))
    before = first.solve(right)
    copied = pickle.loads(pickle.dumps(analysis))
    second = analysis.factor(2 * matrix.data)
    assert second.solve(right) == pytest.approx(before / 2)
    with pytest.raises(RuntimeError, match="another one of the same analysis"):
        first.solve(right)
    assert copied.factor(matrix.data).solve(right) == pytest.approx(before)


def test_choice_by_name_by_variable_and_by_what_is_installed(monkeypatch):
    monkeypatch.delenv(factorization.VARIABLE, raising=False)
    assert factorizer().name == installed_factorizers()[0]
    assert factorizer("superlu").words.startswith("SuperLU (SciPy ")
    monkeypatch.setenv(factorization.VARIABLE, "superlu")
    assert factorizer().name == "superlu"
    monkeypatch.setenv(factorization.VARIABLE, "umfpack")
    with pytest.raises(InputError, match="STRUCTID_FACTORIZER must be one of pardiso, superlu, got 'umfpack'"):
        factorizer()
    with pytest.raises(InputError, match="`factorizer` must be one of"):
        factorizer("cholmod")


def test_missing_library_is_named_with_the_way_to_install_it(monkeypatch):
    monkeypatch.delenv(factorization.VARIABLE, raising=False)
    monkeypatch.setattr(factorization, "_load_library", lambda: "the library was not found")
    assert installed_factorizers() == ("superlu",)
    assert factorizer().name == "superlu"
    with pytest.raises(
        InputError, match=r"the library was not found; install it with `pip install structid\[pardiso\]`"
    ):
        factorizer("pardiso")


@needs_mkl
def test_pardiso_is_used_where_it_is_installed(monkeypatch):
    monkeypatch.delenv(factorization.VARIABLE, raising=False)
    assert factorizer().name == "pardiso"


def test_threads_are_capped(monkeypatch):
    monkeypatch.delenv(factorization.THREADS_VARIABLE, raising=False)
    assert usable_threads(1000) == 1
    monkeypatch.setenv(factorization.THREADS_VARIABLE, "3")
    assert usable_threads(1000) == 3
    monkeypatch.setenv(factorization.THREADS_VARIABLE, "none")
    with pytest.raises(InputError, match="positive whole number, got 'none'"):
        usable_threads(1000)
