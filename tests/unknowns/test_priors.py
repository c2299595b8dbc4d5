"""Priors: their rows against what they mean, and every derivative against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from structid import Beam, FrfProblem, FrfRecord, InputError, Prior, Structure, Unknown, parameters, parse_dof
from structid.unknowns import Coupling, Smoothness, Sparsity, joint_prior, penalty

BEAM = Structure(
    {i: float(i) for i in range(5)},
    [Beam("beam", [[i, i + 1] for i in range(4)], [1.0, 2.0, 3.0, 2.0], 5.0, loss_factor=0.02)],
    ["0Y", "0RZ"],
)


def differences(function, at, step=1e-6):
    columns = [
        (function(at * (1 + step * e)) - function(at * (1 - step * e))) / (2 * step * a)
        for e, a in zip(np.eye(len(at)), at, strict=True)
    ]
    return np.stack(columns, axis=1)


def test_lognormal_prior_is_the_distribution_of_its_mean_and_std():
    made = parameters(BEAM, [Unknown("mass", "beam", prior=Prior(3.0, 1.2, "lognormal"))])

    def density(p):
        residual, slope = made.prior_rows(np.array([p]))
        return np.exp(-0.5 * residual[0] ** 2) / np.sqrt(2 * np.pi) * slope[0, 0]

    moments = [integrate.quad(lambda p, k=k: p**k * density(p), 0, 60, limit=200)[0] for k in range(3)]
    assert moments[0] == pytest.approx(1, rel=1e-7)
    assert moments[1] == pytest.approx(3.0, rel=1e-6)
    assert np.sqrt(moments[2] - moments[1] ** 2) == pytest.approx(1.2, rel=1e-5)


def test_rows_of_all_priors_have_the_derivative_that_differences_show():
    made = parameters(
        BEAM,
        [
            Unknown("mass", "beam:1", prior=Prior(1.5, 0.4)),
            Unknown("mass", "beam:2", prior=Prior(1.5, 0.4, "lognormal")),
            Unknown("bending_stiffness", "beam", each=True),
        ],
    )
    rng = np.random.default_rng(0)
    root = rng.standard_normal((3, 3))
    made = made.coupled(
        joint_prior("baseline", made.names, made.names[2:5], np.array([4.0, 5.0, 6.0]), root @ root.T + np.eye(3)),
        penalty(BEAM, made, Smoothness("bending_stiffness", "beam")).scaled(40.0),
        penalty(BEAM, made, Sparsity("mass", "beam:1-2")).scaled(np.array([9.0, 16.0])),
    )
    at = np.array([1.1, 2.3, 4.4, 5.5, 6.6, 4.9])
    residual, jacobian = made.prior_rows(at)
    assert residual.shape == (2 + 3 + 3 + 2,)
    assert jacobian == pytest.approx(differences(lambda p: made.prior_rows(p)[0], at), rel=1e-7, abs=1e-7)
    sparse_rows = residual[-2:]
    assert sparse_rows == pytest.approx([3 * np.log(1.1), 4 * np.log(2.3 / 2.0)])


@pytest.mark.parametrize("logarithmic", [False, True])
def test_joint_prior_is_the_gaussian_of_its_covariance(logarithmic):
    mean = np.array([2.0, 5.0, 0.5])
    scale = np.diag(mean) * 0.1
    covariance = scale @ np.array([[1.0, 0.6, -0.3], [0.6, 2.0, 0.1], [-0.3, 0.1, 1.5]]) @ scale
    made = joint_prior("baseline", ("a", "b", "c", "d"), ("c", "a", "d"), mean, covariance, logarithmic)
    p = np.array([5.3, 9.0, 2.1, 0.47])
    moved, spread = p[[2, 0, 3]] - mean, covariance
    if logarithmic:
        moved, spread = np.log(p[[2, 0, 3]] / mean), covariance / np.outer(mean, mean)
    residual, jacobian = made.rows(p)
    assert residual @ residual == pytest.approx(moved @ np.linalg.solve(spread, moved), rel=1e-12)
    assert (jacobian[:, 1] == 0).all()
    assert jacobian == pytest.approx(differences(lambda q: made.rows(q)[0], p), rel=1e-7, abs=1e-7)
    if not logarithmic:
        density = stats.multivariate_normal(mean, covariance)
        assert 0.5 * residual @ residual == pytest.approx(density.logpdf(mean) - density.logpdf(p[[2, 0, 3]]))


def test_a_problem_takes_all_rows_with_the_right_derivative():
    record = FrfRecord(
        np.linspace(0.05, 0.6, 12), np.full((12, 1, 1), 0.1 + 0.05j), (parse_dof("4Y"),), (parse_dof("4Y"),),
        "receptance", variance=np.full((12, 1, 1), 1e-4),
    )  # fmt: skip
    made = parameters(BEAM, [Unknown("mass", "beam", prior=Prior(1.1, 0.1, "lognormal")),
                             Unknown("bending_stiffness", "beam", each=True)])  # fmt: skip
    made = made.coupled(penalty(BEAM, made, Smoothness("bending_stiffness", "beam")).scaled(25.0))
    problem = FrfProblem(BEAM, replace(made, start=np.array([1.05, 4.0, 5.0, 6.0, 4.5])), record)
    theta = problem.theta_start
    at = problem.linearize(theta)
    assert len(at.residual) == problem.n_data + 1 + 3
    step = 1e-6
    found = np.stack(
        [(problem.residual(theta + step * e) - problem.residual(theta - step * e)) / (2 * step) for e in np.eye(5)], 1
    )
    assert at.jacobian == pytest.approx(found, rel=1e-6, abs=1e-6 * np.abs(found).max())


def test_smoothness_joins_elements_that_share_a_node_across_sets():
    second = Beam("arm", [[3, 9], [9, 10]], 1.0, 5.0)
    structure = Structure({**{i: float(i) for i in range(5)}, 9: 6.0, 10: 7.0}, [*BEAM.elements, second], ["0Y", "0RZ"])
    made = parameters(structure, [Unknown("mass", "beam", each=True),
                                  Unknown("bending_stiffness", ("beam", "arm"), each=True)])  # fmt: skip
    rows = penalty(structure, made, Smoothness("bending_stiffness", ("beam", "arm")))
    pairs = {frozenset(made.names[j].split("[")[1][:-1] for j in np.flatnonzero(row)) for row in rows.matrix}
    assert pairs == {
        frozenset(pair)
        for pair in (("beam:1", "beam:2"), ("beam:2", "beam:3"), ("beam:3", "beam:4"), ("beam:3", "arm:1"),
                     ("beam:4", "arm:1"), ("arm:1", "arm:2"))
    }  # fmt: skip
    assert (np.sort(rows.matrix[:, 4:], axis=1)[:, [0, -1]] == [-1, 1]).all()
    residual, _ = rows.rows(np.arange(1.0, 11.0))
    assert np.abs(residual).max() > 0
    assert rows.rows(np.full(10, 7.0))[0] == pytest.approx(np.zeros(6), abs=1e-15)


def test_what_was_known_can_be_forgotten():
    made = parameters(BEAM, [Unknown("mass", "beam", each=True, prior=Prior(1.0, 0.1))])
    assert made.has_priors
    assert made.coupled(penalty(BEAM, made, Sparsity("mass", "beam"))).without_priors().has_priors is False
    free = parameters(BEAM, [Unknown("mass", "beam", each=True)])
    assert not free.has_priors
    assert free.coupled(penalty(BEAM, free, Sparsity("mass", "beam"))).has_priors


@pytest.mark.parametrize(
    ("make", "fragment"),
    [
        (lambda p: penalty(BEAM, p, Smoothness("mass", "beam", -1.0)), "must be greater than 0, got -1"),
        (lambda p: penalty(BEAM, p, Smoothness("mass", "beam", "l_curv")), "got 'l_curv'"),
        (lambda p: penalty(BEAM, p, Sparsity("mass", "beam", "l_curve")), "marginal_likelihood"),
        (lambda p: penalty(BEAM, p, Smoothness("bending_stiffness", "beam")), "share a node"),
        (lambda p: penalty(BEAM, p, Smoothness("mass", "beem")), "nearest is 'beam'"),
        (lambda p: penalty(BEAM, p, Sparsity("mass_damping", "beam")), "no parameter to hold"),
        (lambda p: penalty(BEAM, p, Smoothness("loss_factor", "beam")), "must be kept positive"),
        (lambda p: p.coupled(Coupling("odd", np.ones((1, 3)), np.zeros(1))), "must have 9 columns"),
        (lambda p: joint_prior("b", p.names, ("mass[x]",), np.ones(1), np.eye(1)), "must name parameters"),
        (lambda p: joint_prior("b", p.names, p.names[:2], np.ones(2), np.ones((2, 2))), "positive definite"),
        (lambda p: joint_prior("b", p.names, p.names[:2], np.ones(2), np.full((2, 2), np.nan)), "not determined"),
        (lambda p: joint_prior("b", p.names, p.names[:1], -np.ones(1), np.eye(1), True), "must be positive"),
    ],
)
def test_unusable_knowledge_is_refused(make, fragment):
    unknowns = [
        Unknown("mass", "beam", each=True),
        Unknown("bending_stiffness", "beam"),
        Unknown("loss_factor", "beam", each=True, positive=False),
    ]
    with pytest.raises(InputError, match=fragment):
        make(parameters(BEAM, unknowns))


@pytest.mark.parametrize(
    ("prior", "positive", "fragment"),
    [
        (Prior(-1.0, 0.5, "lognormal"), True, "positive mean"),
        (Prior(1.0, 0.5, "lognormal"), False, "declare it `positive`"),
        (Prior(1.0, 0.5, "uniform"), True, "of kind 'normal' or 'lognormal'"),
        (Prior(1.0, np.inf), True, "finite mean and a positive std"),
    ],
)
def test_unusable_priors_are_refused(prior, positive, fragment):
    with pytest.raises(InputError, match=fragment):
        parameters(BEAM, [Unknown("mass", "beam", prior=prior, positive=positive)])
