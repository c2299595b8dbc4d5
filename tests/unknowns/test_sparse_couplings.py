"""Knowledge of very many parameters as sparse rows, against the dense ones."""

import numpy as np
import pytest
from scipy import sparse

from structid.core.errors import InputError
from structid.fem import Beam, Structure
from structid.unknowns import Coupling, Smoothness, Unknown, penalties, penalty
from structid.unknowns.parameters import parameters


def chain(prior=None):
    beam = Beam("beam", [[i, i + 1] for i in range(6)], mass=2.0, bending_stiffness=5.0)
    structure = Structure({i: float(i) for i in range(7)}, [beam], fixed=["0Y", "0RZ"])
    return structure, parameters(structure, [Unknown("bending_stiffness", "beam", each=True, prior=prior)])


@pytest.mark.parametrize("logarithmic", [True, False])
def test_sparse_coupling_equals_the_dense_one(logarithmic):
    rng = np.random.default_rng(0)
    dense = np.round(rng.standard_normal((4, 6)) * (rng.random((4, 6)) < 0.5), 2)
    dense[:, 2] = 0.0
    target, p = rng.standard_normal(4), np.array([1.0, 2.0, -3.0, 0.5, 1.5, 4.0])
    one = Coupling("c", dense, target, logarithmic).scaled(9.0)
    other = Coupling("c", sparse.csr_array(dense), target, logarithmic).scaled(9.0)
    assert np.array_equal(one.used, other.used)
    for a, b in zip(one.rows(p), other.rows(p), strict=True):
        assert b == pytest.approx(a)
    residual, jacobian = one.sparse_rows(p)
    assert residual == pytest.approx(one.rows(p)[0])
    assert jacobian.toarray() == pytest.approx(one.rows(p)[1])
    assert one.residual(p) == pytest.approx(other.residual(p))


def test_smoothness_of_many_is_kept_sparse(monkeypatch):
    structure, made = chain()
    term = Smoothness("bending_stiffness", "beam", 10.0)
    small = penalty(structure, made, term)
    monkeypatch.setattr(penalties, "_DENSE_UP_TO", 10)
    large = penalty(structure, made, term)
    assert isinstance(small.matrix, np.ndarray)
    assert sparse.issparse(large.matrix)
    assert np.array_equal(large.matrix.toarray(), small.matrix)
    both = made.coupled(large.scaled(4.0))
    p = made.start * np.linspace(0.8, 1.3, 6)
    residual, jacobian = both.sparse_prior_rows(p)
    assert residual == pytest.approx(made.coupled(small.scaled(4.0)).prior_rows(p)[0])
    assert jacobian.toarray() == pytest.approx(both.prior_rows(p)[1])
    assert both.prior_residual(p) == pytest.approx(residual)


def test_sparse_coupling_must_be_finite_and_fit():
    with pytest.raises(InputError, match="must be finite"):
        Coupling("c", sparse.csr_array(np.array([[np.nan, 1.0]])), np.zeros(1))
    with pytest.raises(InputError, match="`target` must have shape"):
        Coupling("c", sparse.csr_array(np.eye(2)), np.zeros(3))
