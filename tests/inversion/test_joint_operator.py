"""Several linearizations without Jacobians as one, against the joint problem with its Jacobian."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import sparse
from test_matrix_free import field

from structid.core.errors import InputError
from structid.inversion import JointProblem, MatrixFree, Problem
from structid.inversion.composed_problems import Wrapped
from structid.inversion.estimate import estimate


@dataclass(frozen=True, eq=False)
class WithPrior(Wrapped):
    """A field with a prior of its first parameter."""

    width: float = 0.1

    def linearize(self, theta):
        at = self.problem.linearize(theta)
        row = np.zeros((1, len(theta)))
        row[0, 0] = 1 / self.width
        residual = np.append(at.residual, theta[0] / self.width)
        return replace(at, residual=residual, jacobian=np.concatenate([at.jacobian, row]))

    def residual(self, theta):
        return self.linearize(theta).residual

    def prior_rows(self, theta):
        dense = self.linearize(theta)
        return dense.residual[self.n_data :], sparse.csr_array(dense.jacobian[self.n_data :])

    def linearize_operator(self, theta):
        residual, prior = self.prior_rows(theta)
        at = self.problem.linearize_operator(theta)
        return replace(at, residual=np.concatenate([at.residual[: at.n_data], residual]), prior=prior)


def pair(stored=False, width=0.1):
    """Two records of one field; the second knows its parameters in another order, and one of its own."""
    first, _ = field(stored, seed=1)
    second, _ = field(stored, seed=2)
    labels = tuple(f"p{i}" for i in range(60))
    other = (*labels[:1], *reversed(labels[2:]), "own")
    return JointProblem((WithPrior(first), WithPrior(second, width)), labels=(labels, other))


@pytest.mark.parametrize("stored", [False, True])
def test_products_are_those_of_the_joint_jacobian(stored):
    joint = pair(stored)
    rng = np.random.default_rng(0)
    theta = 0.1 * rng.standard_normal(61)
    dense, at = joint.linearize(theta), joint.linearize_operator(theta)
    n = joint.n_data
    np.testing.assert_allclose(at.residual, dense.residual, rtol=1e-12)
    v, u = rng.standard_normal(61), rng.standard_normal(len(dense.residual))
    np.testing.assert_allclose(at.product(v), dense.jacobian @ v, atol=1e-9)
    np.testing.assert_allclose(at.transposed(u), dense.jacobian.T @ u, atol=1e-9)
    np.testing.assert_allclose(at.data_squares, (dense.jacobian[:n] ** 2).sum(axis=0))
    assert (at.jacobian is not None) == stored
    if stored:
        np.testing.assert_allclose(at.jacobian, dense.jacobian[:n])


def test_prior_that_both_state_counts_once():
    joint = pair()
    at = joint.linearize_operator(joint.theta_start)
    single = (abs(at.prior) > 0).sum(axis=1) == 1
    assert int(single.sum()) == 1
    assert at.prior.shape[0] == 59 + 1 + 59  # two chains of differences in different orders, one prior


def test_different_priors_of_one_parameter_are_refused():
    joint = pair(width=0.3)
    with pytest.raises(InputError, match="prior of p0 must be the same"):
        joint.linearize_operator(joint.theta_start)


def test_standard_deviations_of_two_records_are_those_of_the_dense_covariance():
    joint = JointProblem((field(True, seed=1)[0], field(True, seed=2)[0]))
    found = estimate(joint, MatrixFree(draws=400))
    jacobian = joint.linearize(found.theta).jacobian
    exact = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * found.values
    assert np.abs(found.std / exact - 1).max() < 4.5 / np.sqrt(800)
    assert found.goodness.n_data == 50


def test_problem_without_such_a_form_is_named():
    class Dense(type(field(True)[0])):
        linearize_operator = Problem.linearize_operator

    joint = JointProblem((field(True, seed=1)[0], Dense(**vars(field(True)[0]))))
    with pytest.raises(InputError, match="products with their Jacobian"):
        joint.linearize_operator(np.zeros(60))


def test_words_on_the_parameters_are_gathered_once():
    """Gathered again for every parameter, they would cost the square of their number."""
    joint = pair()
    assert joint.unknowns.units is joint.unknowns.units
    assert joint.unknowns.kinds is joint.unknowns.kinds
    assert joint.names is joint.names
