"""Estimators on problems without a finite element: a straight line, and certified nonlinear fits."""

from dataclasses import dataclass

import numpy as np
import pytest

from structid import GaussNewton, LevenbergMarquardt, Status, estimate
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem, minimize
from structid.inversion.covariance import correlation_length, inverse_information
from structid.inversion.diagnostics.identifiability import direction_words, identifiability


@dataclass
class Fit(Problem):
    """y = f(x, p) with unit noise, parameters as they are."""

    model: object
    derivative: object
    x: np.ndarray
    y: np.ndarray
    start: np.ndarray
    labels: tuple
    sigma: float = 1.0

    @property
    def unknowns(self):
        return FreeUnknowns(self.labels, self.start)

    @property
    def rows(self):
        return DataRows(np.arange(len(self.x)), np.zeros(len(self.x), int))

    def residual(self, theta):
        return (self.model(self.x, theta) - self.y) / self.sigma

    def linearize(self, theta):
        return Linearization(self.residual(theta), self.derivative(self.x, theta) / self.sigma)


# NIST StRD, Misra1a (Misra 1978): y = b1 (1 - exp(-b2 x)); certified values and standard errors.
MISRA_X = np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0])
MISRA_Y = np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78])
MISRA_VALUES = [2.3894212918e2, 5.5015643181e-4]
MISRA_STD = [2.7070075241, 7.2668688436e-6]
MISRA_SSQ = 1.2455138894e-1


def misra(start):
    return Fit(
        lambda x, p: p[0] * (1 - np.exp(-p[1] * x)),
        lambda x, p: np.stack([1 - np.exp(-p[1] * x), p[0] * x * np.exp(-p[1] * x)], axis=1),
        MISRA_X,
        MISRA_Y,
        np.array(start),
        ("b1", "b2"),
        sigma=np.sqrt(MISRA_SSQ / 12),
    )


FAR, NEAR = (500.0, 1e-4), (250.0, 5e-4)
FREE_STEPS = LevenbergMarquardt(largest_step=np.inf, max_iterations=300, gain_tolerance=1e-16)


@pytest.mark.parametrize(("start", "method"), [(FAR, FREE_STEPS), (NEAR, FREE_STEPS), (NEAR, GaussNewton())])
def test_certified_values_and_standard_errors(start, method):
    found = estimate(misra(start), method)
    assert found.status is Status.CONVERGED
    assert found.values == pytest.approx(MISRA_VALUES, rel=1e-8)
    assert found.std_noise == pytest.approx(MISRA_STD, rel=1e-8)
    assert found.goodness.chi_square * MISRA_SSQ / 12 == pytest.approx(MISRA_SSQ, rel=1e-9)


def line(noise, n=400, names=("a", "b")):
    x = np.linspace(-1, 1, n)
    y = 2.0 + 3.0 * x + noise
    design = np.stack([np.ones(n), x], axis=1)
    return Fit(lambda x, p: design @ p, lambda x, p: design, x, y, np.array([1.0, 1.0]), names)


def test_straight_line_interval_covers_as_often_as_it_says():
    """400 repeats, seeds 0 to 399: coverage of 95 % intervals within three binomial standard deviations, 3.3 %."""
    hits = np.zeros(2)
    for seed in range(400):
        found = estimate(line(np.random.default_rng(seed).standard_normal(400)))
        hits += np.abs(found.values - [2.0, 3.0]) <= 1.959964 * found.std_noise
    assert np.abs(hits / 400 - 0.95).max() <= 0.033


def test_model_error_covariance_covers_correlated_error_and_noise_covariance_does_not():
    """A random walk-like error, correlated over 35 lines, 400 repeats: 91 % or more (95 % less four binomial deviations)."""
    kernel = np.exp(-0.5 * (np.arange(-60, 61) / 10) ** 2)
    hits_model, hits_noise = 0, 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        error = np.convolve(rng.standard_normal(1000 + 120), kernel, mode="valid")
        found = estimate(line(error / np.linalg.norm(kernel), 1000))
        hits_model += abs(found.values[0] - 2.0) <= 1.96 * found.spread.std_model_error[0]
        hits_noise += abs(found.values[0] - 2.0) <= 1.96 * found.std_noise[0]
    assert hits_model / 400 >= 0.91
    assert hits_noise / 400 <= 0.60


def test_misfit_switches_to_the_covariance_that_carries_model_error():
    rng = np.random.default_rng(5)
    good, bad = rng.standard_normal(400), 2 * rng.standard_normal(400)
    assert estimate(line(good)).covariance_basis == "noise"
    assert estimate(line(bad)).covariance_basis == "model_error"


def test_unseen_direction_gives_nan_not_zero_and_words():
    design = np.outer(np.linspace(1, 2, 30), [1.0, 1.0])
    noise = np.random.default_rng(1).standard_normal(30)
    y = design @ [4.0, 4.0] + noise
    fit = Fit(lambda x, p: design @ p, lambda x, p: design, np.arange(30), y, np.array([3.0, 3.0]), ("k[a]", "k[b]"))
    found = estimate(fit)
    assert found.status is Status.NOT_IDENTIFIABLE
    assert found.identifiability.rank == 1
    assert np.isnan(found.std).all()
    assert found.identifiability.directions[0].words == "k[a] and k[b] only as a sum"
    assert not found.identified.any()


@pytest.mark.parametrize(
    ("kind", "values", "vector", "words"),
    [
        ("stiffness", [2.0, 2.0], [1.0, -1.0], "together: as their sum, or in series"),
        ("stiffness", [1.0, 3.0], [1.0, -3.0], "in series, as the sum of their reciprocals"),
        ("stiffness", [1.0, 3.0], [3.0, -1.0], "as a sum"),
        ("mass", [1.0, 3.0], [1.0, 1.0], "as ratios"),
        ("mass", [1.0, 3.0], [1.0, -3.0], "in combination"),
    ],
)
def test_directions_are_told_by_what_they_leave_unchanged(kind, values, vector, words):
    """A relative change n leaves sum(v) alone where sum(n v) = 0 and sum(1/v) where sum(n / v) = 0."""
    text = direction_words(np.array(vector), np.array(values), (f"{kind}[a]", f"{kind}[b]"))
    assert text.startswith(f"{kind}[a] and {kind}[b] only {words}")


def test_a_parameter_that_nothing_sees_leaves_the_others_their_standard_deviations():
    x = np.linspace(0, 1, 50)
    design = np.stack([np.ones(50), x, np.zeros(50)], axis=1)
    y = design @ [1.0, 2.0, 3.0] + 0.5 * np.random.default_rng(8).standard_normal(50)
    fit = Fit(lambda x, p: design @ p, lambda x, p: design, x, y, np.ones(3), ("a", "b", "c"))
    found = estimate(fit)
    assert np.isfinite(found.std_noise[:2]).all()
    assert np.isfinite(found.spread.std_model_error[:2]).all()
    assert np.isnan([found.std_noise[2], found.spread.std_model_error[2]]).all()


def test_weakly_seen_direction_has_its_true_standard_deviation():
    jacobian = np.diag([10.0, 0.5])
    found = identifiability(jacobian, np.array([1.0, 1.0]), ("a", "b"))
    assert (found.rank, found.condition) == (1, 20.0)
    assert found.directions[0].relative_std == pytest.approx(2.0)
    assert found.directions[0].words == "b not at all"
    assert inverse_information(jacobian) == pytest.approx(np.diag([0.01, 4.0]))


def test_correlation_length_of_white_noise_is_one_and_of_a_moving_mean_its_width():
    rng = np.random.default_rng(2)
    white = rng.standard_normal(20000)
    assert correlation_length(white, np.arange(20000), np.zeros(20000, int)) == pytest.approx(1.0, abs=0.1)
    mean = np.convolve(white, np.ones(8) / 8, mode="valid")
    assert correlation_length(mean, np.arange(len(mean)), np.zeros(len(mean), int)) == pytest.approx(8.0, rel=0.1)


def test_priors_enter_the_covariance():
    """One datum and one prior of equal weight: the mean of both, half the variance."""

    class WithPrior(Fit):
        rows = DataRows(np.zeros(1, int), np.zeros(1, int))

        def residual(self, theta):
            return np.array([theta[0] - 2.0, theta[0] - 1.0])

        def linearize(self, theta):
            return Linearization(self.residual(theta), np.ones((2, 1)))

    found = estimate(WithPrior(None, None, np.zeros(1), np.zeros(1), np.zeros(1), ("a",)))
    assert found.values == pytest.approx([1.5])
    assert found.spread.covariance_noise == pytest.approx(np.array([[0.5]]))


def test_search_that_runs_out_of_iterations_says_so():
    found = estimate(misra((500.0, 1e-4)), LevenbergMarquardt(max_iterations=2))
    assert found.status is Status.NOT_CONVERGED
    assert "2 iterations" in found.message
    assert minimize(misra((250.0, 5e-4)), LevenbergMarquardt()).converged
