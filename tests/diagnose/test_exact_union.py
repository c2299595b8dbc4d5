"""What likely models add to an answer, and what a cause costs, by their formulas on numbers chosen here."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from structid import FrfRecord, IdentifyOptions, identify, parameters, with_declared_noise
from structid.diagnose.explain import intervals_of, widened
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel
from structid.diagnose.search import _criterion
from structid.diagnose.tested_model import TestedModel
from structid.fem import PointMass, Spring, Structure
from structid.inversion.estimate import ParameterValues
from structid.unknowns import Unknown
from structid.unknowns.tolerances import EXACT, Tolerances


def oscillator(tolerances=EXACT):
    """Two springs in a row under two masses, identified from the response of both."""
    springs = Spring("k", ["1X", "2X"], ["0X", "1X"], stiffness=[1000.0, 800.0], loss_factor=0.03)
    masses = PointMass("m", [1, 2], [2.0, 1.5])
    structure = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [masses, springs], fixed=["0X"], active=["X"])
    frequency = np.linspace(1.0, 6.0, 30)
    s = (2 * np.pi * frequency)[:, None, None]
    stiffness = np.array([[1800.0, -800.0], [-800.0, 800.0]]) * (1 + 0.03j)
    exact = np.linalg.inv(stiffness - s**2 * np.diag([2.0, 1.5]))[:, :, :1]
    noise = np.random.default_rng(0).standard_normal((2, *exact.shape)) / np.sqrt(2)
    values = exact * (1 + 0.01 * (noise[0] + 1j * noise[1]))
    record = with_declared_noise(FrfRecord(frequency, values, ["1X", "2X"], ["1X"], "receptance"), 0.01)
    return identify(
        structure,
        parameters(structure, [Unknown("stiffness", "k", each=True)]),
        record,
        IdentifyOptions(tolerances=tolerances),
    )


def model(names, theta, covariance):
    """A fitted model with logarithms of its parameters as free variables."""
    target = SimpleNamespace(names=names)
    values = dict(zip(names, np.exp(theta), strict=True))
    size, ones = np.exp(theta), np.ones(len(names))
    parameters = ParameterValues(
        names=names, kinds=names, units=names, initial=size, values=size, theta=np.array(theta), slope=size,
        to_physical=np.exp, scale=ones,
    )  # fmt: skip
    return SimpleNamespace(
        modified=SimpleNamespace(target=target),
        parameters=parameters,
        identified=ones > 0,
        theta=np.array(theta),
        covariance_of_data=np.array(covariance),
        values=values,
        covariance=np.array(covariance),
    )


def test_interval_of_a_likely_model_is_normal_in_its_free_variables():
    theta, std = np.log([3.0, 50.0]), np.array([0.1, 0.3])
    fitted = model(("a", "b"), theta, np.diag((std * np.exp(theta)) ** 2))
    found = intervals_of(fitted, 0.9)
    for k, name in enumerate(("a", "b")):
        expected = np.exp(stats.norm.interval(0.9, theta[k], std[k]))
        np.testing.assert_allclose(found[name], expected, rtol=1e-12)


def test_interval_of_a_likely_model_begins_at_0_where_the_value_is_not_told_from_it():
    """As that of an answer: a deviation of 0.9 of the value leaves it nothing but an upper limit, p + 1.96 s."""
    fitted = model(("a",), np.log([0.01]), [[0.009**2]])
    np.testing.assert_allclose(intervals_of(fitted, 0.95)["a"], [0.0, 0.01 + stats.norm.ppf(0.975) * 0.009], rtol=1e-12)


def test_covariance_over_likely_models_is_their_mean_with_the_squares_of_their_distances():
    answer = oscillator()
    estimate = answer.estimate
    values, own = estimate.values, estimate.covariance
    away = np.log(values) + np.array([0.05, -0.02])
    other = model(estimate.names, away, 2.0 * own)
    wider = widened(answer, [other], None).estimate.covariance
    distance = np.exp(away) - values
    np.testing.assert_allclose(wider, (own + 2.0 * own + np.outer(distance, distance)) / 2, rtol=1e-12)


def test_likely_models_count_the_tolerances_of_held_values_once():
    """A likely model that is the answer itself, as the data alone have it, leaves deviations as they are."""
    answer = oscillator(Tolerances(mass=0.02))
    estimate = answer.estimate
    tested = TestedModel(answer.setups, answer.options)
    same = FittedModel(
        base_model(tested, answer.problems, estimate.theta), estimate.theta, estimate.goodness.chi_square
    )
    wider = widened(answer, [same], None)
    assert np.diag(estimate.fixed.covariance).min() > np.diag(estimate.covariance_of_data).max()
    np.testing.assert_allclose(wider.estimate.covariance, estimate.covariance, rtol=1e-9)
    np.testing.assert_allclose(wider.intervals.ends, estimate.interval(), rtol=1e-9)
    np.testing.assert_allclose(list(intervals_of(same, 0.9).values()), estimate.interval(0.9), rtol=1e-9)
    in_common = 3.5**2 * (1 - 1 / 2)  # of two values that may err together or each alone
    assert wider.mass.std == pytest.approx(0.02 * np.sqrt(in_common + 2.0**2 + 1.5**2), rel=1e-9)


@pytest.mark.parametrize("n_data, scale", [(200, 1.0), (5000, 3.0)])
def test_a_cause_costs_the_logarithm_of_the_data_for_each_parameter(n_data, scale):
    """Schwarz (1978): -2 log likelihood + k log n, errors larger by one factor."""
    base = SimpleNamespace(modified=SimpleNamespace(target=SimpleNamespace(names=("a",), n_data=n_data)))
    target = SimpleNamespace(names=("a", "b"), n_data=n_data)
    one = SimpleNamespace(modified=SimpleNamespace(target=target, changes=()), misfit=240.0)
    assert _criterion(base, one, scale) == pytest.approx(240.0 / scale + 2 * np.log(n_data), rel=1e-12)
