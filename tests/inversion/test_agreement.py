"""Whether what several records repeat asks for the same values everywhere: the test's level, what it finds, and what follows."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import linalg, stats

import structid as sid
from structid.diagnose.verdict import judged
from structid.forward import ModalProblem
from structid.identification.warning_words import estimate_warnings
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.covariance import larger_covariance, left_out_covariance, repeated_quantities
from structid.inversion.diagnostics.residual_tests import agreement


@dataclass(frozen=True, eq=False)
class Repeated(Problem):
    """design @ p = data, each row another quantity: what one record of several has."""

    design: np.ndarray
    data: np.ndarray
    numbers: tuple = (0, 1, 2, 3, 4)
    prior: float = 0.0

    unknowns = FreeUnknowns(("a", "b", "c"), np.zeros(3))

    @property
    def rows(self):
        n_data = len(self.data)
        return DataRows(np.arange(n_data), np.zeros(n_data, int), quantities=np.array(self.numbers))

    def residual(self, theta):
        return self.linearize(theta).residual

    def linearize(self, theta):
        rows = np.concatenate([self.design, [[self.prior, 0.0, 0.0]] if self.prior else np.zeros((0, 3))])
        return Linearization(rows @ theta - np.concatenate([self.data, np.zeros(int(bool(self.prior)))]), rows)


def records(seed, size=1.0, apart=0.0, n=8, prior=0.0):
    """Records of five quantities, whose own parameters are `apart`; noise of `size` times what is stated."""
    rng = np.random.default_rng(seed)
    own = apart * rng.standard_normal((5, 3))
    made = []
    for _ in range(n):
        design = rng.standard_normal((5, 3))
        data = np.sum(design * (1.0 + own), axis=1) + size * rng.standard_normal(5)
        made.append(Repeated(design, data, prior=prior))
    return sid.JointProblem(tuple(made))


def test_right_models_are_doubted_as_often_as_the_level_says_whatever_the_noise():
    """500 seeds: probabilities are uniform, one in twenty below 0.05, and the same where the noise is thirty times as large."""
    found = []
    for seed in range(500):
        problem = records(seed)
        design = problem.linearize(np.zeros(3))
        at = problem.linearize(-np.linalg.lstsq(design.jacobian, design.residual, rcond=None)[0])
        found.append(agreement(problem, at).probability)
        if seed < 10:
            louder = replace(at, residual=30 * at.residual)
            assert agreement(problem, louder).probability == pytest.approx(found[-1], rel=1e-6)
    assert stats.kstest(found, "uniform").pvalue > 0.01
    assert 0.02 <= np.mean(np.array(found) < 0.05) <= 0.08


def test_between_and_within_are_those_of_fits_to_each_quantity():
    problem = records(3, apart=0.5)
    found = sid.estimate(problem)
    at = problem.linearize(found.theta)
    own = 0.0
    for k in range(5):
        rows = np.tile(np.arange(5), 8) == k
        own += np.linalg.lstsq(at.jacobian[rows], at.residual[rows], rcond=None)[1][0]
    test = agreement(problem, at)
    assert (test.between, test.within) == (12, 25)
    assert test.ratio == pytest.approx((found.goodness.chi_square - own) / 12 / (own / 25), rel=1e-9)
    assert test.probability == pytest.approx(stats.f.sf(test.ratio, 12, 25), rel=1e-9)


@pytest.mark.parametrize("prior", [0.0, 2.0])
def test_quantities_left_out_are_fits_without_them(prior):
    problem = records(4, apart=0.4, prior=prior)
    found = sid.estimate(problem)
    at = problem.linearize(found.theta)
    moved = []
    for k in range(5):
        kept = [np.arange(5) != k] * 8
        rest = [
            replace(p, design=p.design[i], data=p.data[i], numbers=(0, 1, 2, 3))
            for p, i in zip(problem.problems, kept, strict=True)
        ]
        moved.append(sid.estimate(sid.JointProblem(tuple(rest))).values - found.values)
    expected = 0.8 * np.array(moved).T @ np.array(moved)
    assert left_out_covariance(at, repeated_quantities(problem)) == pytest.approx(expected, rel=1e-6)
    widest = np.linalg.eigvalsh(found.spread.covariance_model_error - expected)
    assert widest.min() > -1e-9 * np.abs(expected).max()


def test_disagreement_makes_the_deviations_where_chi_square_shows_nothing():
    """The noise is stated so large that chi-square is below one a degree of freedom."""
    problem = records(5, size=0.05, apart=0.4)
    found = sid.estimate(problem)
    assert found.goodness.chi_square_probability > 0.5
    assert found.covariance_basis == "model_error"
    assert found.spread.disagreement.probability < 1e-3
    assert (
        found.std
        >= np.sqrt(np.diag(left_out_covariance(problem.linearize(found.theta), np.tile(np.arange(5), 8)))) * 0.999
    ).all()
    warnings = estimate_warnings(found)
    assert sum("gives other values" in one for one in warnings) == 1
    assert not any("does not fit to within the noise" in one for one in warnings)
    right = sid.estimate(records(5, size=0.05))
    assert right.covariance_basis == "noise"
    assert right.spread.disagreement is None


def test_only_what_several_records_repeat_is_tested():
    alone = Repeated(np.eye(5, 3), np.zeros(5))
    assert repeated_quantities(alone) is None
    pair = sid.JointProblem((alone, alone))
    assert np.array_equal(repeated_quantities(pair), np.tile(np.arange(5), 2))
    other = replace(alone, numbers=(0, 1, 2, 3, 7))
    assert repeated_quantities(sid.JointProblem((alone, other))) is None  # the third may be another in each
    few = replace(alone, numbers=(0, 0, 1, 1, 2))
    assert repeated_quantities(sid.JointProblem((few, few))) is None
    part = replace(alone, numbers=(4, -1, 6, 8, 9))
    assert np.array_equal(repeated_quantities(sid.JointProblem((part, part)))[:5], [0, -1, 1, 2, 3])
    assert agreement(pair, pair.linearize(np.zeros(3))) is None  # no quantity has rows beyond what it fits


def test_larger_covariance_is_below_neither():
    rng = np.random.default_rng(6)
    first, second = (one.T @ one for one in rng.standard_normal((2, 6, 4)))
    second[:, :1] *= 0.0
    second[:1] *= 0.0
    found = larger_covariance(first, second)
    for combination in rng.standard_normal((100, 4)):
        least = max(combination @ first @ combination, combination @ second @ combination)
        assert combination @ found @ combination >= least * (1 - 1e-9)
    assert larger_covariance(first, first) == pytest.approx(first)
    second[2] = second[:, 2] = np.nan
    assert larger_covariance(first, second)[2] == pytest.approx(first[2], rel=1.0)
    assert np.isfinite(larger_covariance(first, second)).all()


MASSES, SPRINGS = np.array([2.0, 1.5, 1.0, 1.2]), np.array([4e4, 3e4, 2e4, 2.5e4])


def chain(added, rng, bias):
    """Frequencies of a chain with a known mass more at one of its four, with noise of 0.1 % and errors of each mode."""
    stiffness = np.diag(SPRINGS + np.append(SPRINGS[1:], 0.0)) - np.diag(SPRINGS[1:], 1) - np.diag(SPRINGS[1:], -1)
    more = np.where(np.arange(4) == added, 0.8, 0.0)
    frequency = np.sqrt(linalg.eigh(stiffness, np.diag(MASSES + more), eigvals_only=True)) / (2 * np.pi)
    seen = frequency * np.exp(bias + 1e-3 * rng.standard_normal(4))
    elements = [sid.PointMass(f"m{k}", [k + 1], m, directions=["X"]) for k, m in enumerate(MASSES + more)]
    elements += [sid.Spring(f"k{k}", [f"{k}X"], [f"{k + 1}X"], stiffness=3e4) for k in range(4)]
    structure = sid.Structure({k: float(k) for k in range(5)}, elements, ["0X"])
    unknown = [sid.Unknown("stiffness", f"k{k}") for k in range(4)]
    record = sid.ModalRecord(seen, np.full(4, np.nan), np.full((1, 4), np.nan), ["1X"])
    settings = sid.ModalSettings(frequency_error=4e-3)
    return sid.ModalSetup(structure, sid.parameters(structure, unknown), record, settings=settings)


@pytest.mark.parametrize("size", [pytest.param(0.0, marks=pytest.mark.long), 3e-3])
def test_modes_that_are_each_off_in_all_records_make_an_answer_approximate(size):
    """The error of a frequency is stated four times too large, so that chi-square is small either way."""
    rng = np.random.default_rng(7)
    bias = size * np.array([1.0, -1.0, 1.0, -1.0])
    setups = [chain(k % 4, rng, bias * (1 if k % 4 < 2 else -1)) for k in range(8)]
    found = sid.identify_together(setups, sid.IdentifyOptions(restarts=0))
    assert isinstance(found.problems[0], ModalProblem)
    assert np.array_equal(np.unique(found.problems[0].rows.quantities), np.arange(4))
    verdict = judged(found)
    if size:
        assert found.estimate.covariance_basis == "model_error"
        assert verdict.verdict == "approximate"
        assert "gives other values" in verdict.words
        assert any("gives other values" in one for one in found.warnings)
    else:
        assert found.estimate.spread.disagreement is None
        assert not any("gives other values" in one for one in found.warnings)
