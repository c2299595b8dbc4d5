"""What averages of Hann-windowed segments read, beside segments of a simulated random motion and beside a quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, interpolate, signal

from structid import (
    Dashpot,
    FrfProblem,
    FrfRecord,
    Friction,
    InputError,
    PointMass,
    Spring,
    Structure,
    Unknown,
    identify,
    parameters,
    with_coherence_noise,
    with_declared_noise,
)
from structid.forward.frf.observed import PARTS, RATES

MASS, DAMPING, STIFFNESS = 2.0, 0.8, 8000.0
SEGMENT = 2.0


def hann_correlation(lag):
    """Correlation of a Hann window of duration 1 with itself, 1 at no lag, by quadrature of the textbook's integral."""

    def window(t):
        return np.sin(np.pi * t) ** 2

    return integrate.quad(lambda t: window(t) * window(t + lag), 0.0, 1 - lag)[0] / (3 / 8)


def test_the_sum_of_oscillations_is_the_correlation_of_the_window():
    lags = np.linspace(0, 1, 41)
    exact = np.array([hann_correlation(lag) for lag in lags])
    found = PARTS @ np.exp(-np.outer(RATES, lags))
    assert np.abs(found.imag).max() < 1e-12
    assert np.abs(found.real - exact).max() < 1.1e-4
    beyond = PARTS @ np.exp(-np.outer(RATES, np.linspace(1, 5, 200)))
    assert np.abs(beyond).max() < 1.1e-4
    assert PARTS.sum() == pytest.approx(1.0, abs=1e-9)


def oscillator():
    ground, damper = Spring("ground", "1X", stiffness=STIFFNESS), Dashpot("damper", "1X", viscous_damping=DAMPING)
    return Structure({1: 0.0}, [PointMass("m", [1], MASS), ground, damper], active=["X"])


UNKNOWNS = [Unknown("mass", "m"), Unknown("stiffness", "ground"), Unknown("viscous_damping", "damper")]


def record_of(values, frequency, noise=1e-3, segment=SEGMENT, kind="receptance"):
    plain = FrfRecord(frequency, values[:, None, None], ["1X"], ["1X"], kind, segment=segment)
    return with_declared_noise(plain, relative=noise)


def problem_of(record, **others):
    structure = oscillator()
    return FrfProblem(structure, parameters(structure, UNKNOWNS), record, **others)


def leaked(frequency):
    """Integral over lags of impulse response times correlation of the window, (n_lines,), by the trapezoidal rule."""
    lag = np.linspace(0, SEGMENT, 40001)
    decay, omega = DAMPING / (2 * MASS), np.sqrt(STIFFNESS / MASS - (DAMPING / (2 * MASS)) ** 2)
    knots = np.linspace(0, 1, 801)
    correlation = interpolate.CubicSpline(knots, [hann_correlation(one) for one in knots])(lag / SEGMENT)
    impulse = np.exp(-decay * lag) * np.sin(omega * lag) / (MASS * omega) * correlation
    return np.array([integrate.trapezoid(impulse * np.exp(-2j * np.pi * f * lag), lag) for f in frequency])


def test_predicted_lines_are_those_of_the_integral_over_lags():
    frequency = np.arange(2.0, 25.0, 1 / SEGMENT)
    exact = leaked(frequency)
    problem = problem_of(record_of(exact, frequency))
    found = problem.predicted(problem.theta_start)[:, 0, 0]
    assert np.abs(found - exact).max() < 2e-4 * np.abs(exact).max()
    plain = problem_of(record_of(exact, frequency, segment=None))
    assert np.abs(plain.predicted(plain.theta_start)[:, 0, 0] - exact).max() > 0.3 * np.abs(exact).max()


def test_derivatives_are_those_of_differences():
    frequency = np.arange(2.0, 25.0, 1 / SEGMENT)
    problem = problem_of(record_of(leaked(frequency), frequency))
    theta, step = np.array([0.1, -0.05, 0.2]) + problem.theta_start, 1e-6
    differences = [
        (problem.residual(theta + step * way) - problem.residual(theta - step * way)) / (2 * step) for way in np.eye(3)
    ]
    jacobian = problem.linearize(theta).jacobian
    assert np.abs(jacobian - np.transpose(differences)).max() < 1e-6 * np.abs(jacobian).max()


def test_stiffness_and_damping_of_averaged_segments_are_right():
    """Random motion sampled 100 times a second, 600 segments that overlap by half, by SciPy."""
    rate, rng = 100.0, np.random.default_rng(5)
    force = rng.standard_normal(int(300 * SEGMENT * rate))
    fine = signal.resample_poly(force, 8, 1)
    system = signal.StateSpace([[0, 1], [-STIFFNESS / MASS, -DAMPING / MASS]], [[0], [1 / MASS]], [[1, 0]], [[0]])
    _, motion, _ = signal.lsim(system, fine, np.arange(len(fine)) / (8 * rate))
    length = int(SEGMENT * rate)
    kept = {"fs": rate, "window": "hann", "nperseg": length, "detrend": False}
    frequency, cross = signal.csd(force, motion[::8], **kept)
    _, own = signal.welch(force, **kept)
    _, coherence = signal.coherence(force, motion[::8], **kept)
    used = (frequency >= 4) & (frequency <= 20)
    values = cross[used] / own[used]
    plain = FrfRecord(
        frequency[used], values[:, None, None], ["1X"], ["1X"], "receptance", coherence=coherence[used][:, None, None],
        averages=400,
    )  # fmt: skip
    record = with_coherence_noise(plain)
    true = np.array([MASS, STIFFNESS, DAMPING])
    found = identify(oscillator(), parameters(oscillator(), UNKNOWNS), replace(record, segment=SEGMENT)).estimate
    assert np.abs(found.values / true - 1).max() < 0.05
    blind = identify(oscillator(), parameters(oscillator(), UNKNOWNS), record).estimate
    assert blind.values[2] > 1.5 * DAMPING


@pytest.mark.parametrize(
    ("change", "others", "words"),
    [
        ({"frequency": np.arange(0.5, 23.5, 0.5)}, {}, "begin the band there"),
        ({}, {"form": "equation"}, "takes no leakage"),
        ({"segment": 0.0}, {}, "must be a duration above 0"),
    ],
)
def test_what_leakage_cannot_have_is_refused(change, others, words):
    record = record_of(np.ones(46), np.arange(2.0, 25.0, 0.5))
    with pytest.raises(InputError, match=words):
        problem_of(replace(record, **change), **others)


def test_friction_beside_leakage_is_refused():
    structure = Structure({1: 0.0}, [*oscillator().elements, Friction("rub", "1X", friction_force=0.1)], active=["X"])
    with pytest.raises(InputError, match="without friction"):
        FrfProblem(structure, parameters(structure, UNKNOWNS), record_of(np.ones(46), np.arange(2.0, 25.0, 0.5)))
