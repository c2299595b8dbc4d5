"""The smoother against a batch estimate with whole covariance matrices, and its words."""

import numpy as np
import pytest
from scipy import linalg

import structid as sid
from structid.core.errors import InputError, NoAnswerError
from structid.prediction.identified_model import identified_model

RATE, CORRELATION, FORCE = 50.0, 0.1, 20.0


def make_model(std=0.0, free=False):
    sets = [
        sid.PointMass("m", [1, 2], mass=[2.0, 1.0]),
        sid.Spring("k", ["2X"], ["1X"], stiffness=[900.0]),
        sid.Dashpot("c", ["2X"], ["1X"], viscous_damping=[4.0]),
    ]
    if not free:
        sets += [sid.Spring("foot", "1X", stiffness=2e3), sid.Dashpot("air", "1X", viscous_damping=6.0)]
    structure = sid.Structure({1: 0.0, 2: 1.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    return identified_model(structure, parameters, parameters.start, np.array([[(900.0 * std) ** 2]]))


def system():
    """Continuous matrices of the two masses with the force at mass 2 as a fifth state."""
    k, c, m = np.array([[2900.0, -900], [-900, 900]]), np.array([[10.0, -4], [-4, 4]]), np.diag([2.0, 1.0])
    a = np.zeros((5, 5))
    a[:2, 2:4] = np.eye(2)
    a[2:4, :2], a[2:4, 2:4], a[3, 4] = -np.linalg.solve(m, k), -np.linalg.solve(m, c), 1.0
    a[4, 4] = -1 / CORRELATION
    q = np.zeros((5, 5))
    q[4, 4] = 2 * FORCE**2 / CORRELATION
    return a, q


def simulate(n, seed):
    """A stationary record of the motions and the force, by the exact covariance between samples."""
    a, q = system()
    stationary = linalg.solve_continuous_lyapunov(a, -q)
    step = linalg.expm(a / RATE)
    noise = stationary - step @ stationary @ step.T
    rng = np.random.default_rng(seed)
    root, first = (linalg.cholesky(s + 1e-14 * np.trace(s) * np.eye(5), lower=True) for s in (noise, stationary))
    states = [first @ rng.standard_normal(5)]
    for _ in range(n - 1):
        states.append(step @ states[-1] + root @ rng.standard_normal(5))
    return np.array(states), step, stationary, rng


def measured(states, rng, std):
    a, _ = system()
    acceleration = states @ a[2:4].T
    return acceleration[:, [0]] + std * rng.standard_normal((len(states), 1))


def test_smoothed_motion_is_that_of_a_batch_estimate():
    """Gaussian conditioning of all samples at once: E[x | y] = C_xy C_yy^-1 y, away from the ends of the record."""
    n, std = 360, 0.3
    states, step, stationary, rng = simulate(n, 1)
    y = measured(states, rng, std)
    record = sid.TimeRecord(RATE, y, ["1X"], ["acceleration"], variance=np.array([std**2]))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    found = sid.sense(make_model(), record, ["2X"], "displacement", unknown, n_draws=0)
    powers = [np.eye(5)]
    for _ in range(n - 1):
        powers.append(step @ powers[-1])
    lag = [power @ stationary for power in powers]
    whole = np.block([[lag[i - j] if i >= j else lag[j - i].T for j in range(n)] for i in range(n)])
    a, _ = system()
    read = np.kron(np.eye(n), a[2:3])
    cross = whole @ read.T
    batch = cross @ np.linalg.solve(read @ cross + std**2 * np.eye(n), y[:, 0])
    left = whole - cross @ np.linalg.solve(read @ cross + std**2 * np.eye(n), cross.T)
    inner = slice(170, 190)
    for value, deviation, state in ((found.values, found.std, 1), (found.forces, found.force_std, 4)):
        exact = batch.reshape(n, 5)[inner, state]
        assert value[inner, 0] == pytest.approx(exact, abs=0.01 * np.abs(exact).max())
        spread = np.sqrt(np.diag(left).reshape(n, 5)[inner, state])
        assert deviation[inner, 0] == pytest.approx(spread, rel=0.01)


def test_deviations_are_those_of_the_errors_and_the_sensor_left_out_agrees():
    states, _, _, rng = simulate(4000, 2)
    y = np.hstack([measured(states, rng, 0.3), states[:, [1]] + 1e-4 * rng.standard_normal((4000, 1))])
    record = sid.TimeRecord(RATE, y, ["1X", "2X"], ["acceleration", "displacement"], variance=np.array([0.09, 1e-8]))
    unknown = sid.UnknownForces(["2X"], CORRELATION)
    found = sid.sense(make_model(), record, ["1X"], "velocity", unknown, ["2X"], n_draws=0)
    assert found.prior_std == pytest.approx(FORCE, rel=0.15)
    z = (found.values[:, 0] - states[:, 2]) / found.std[:, 0]
    assert np.sqrt((z[200:] ** 2).mean()) == pytest.approx(1.0, abs=0.12)
    assert found.checks[0][1] == pytest.approx(1.0, abs=0.12)


def test_known_forces_leave_nothing_but_noise():
    rng = np.random.default_rng(3)
    force = rng.standard_normal((600, 1)).cumsum(axis=0)
    model = make_model()
    history = sid.History(["1X", "2X"], ["2X"], force, RATE, "displacement")
    motion = sid.predict(model, history, n_draws=50).values
    record = sid.TimeRecord(RATE, np.hstack([force, motion[:, [0]]]), ["2X", "1X"], ["force", "displacement"],
                            variance=np.array([0.0, 1e-12]))  # fmt: skip
    found = sid.sense(model, record, ["2X"], n_draws=0)
    assert found.values[:, 0] == pytest.approx(motion[:, 1], abs=1e-4 * np.abs(motion).max())


def test_uncertain_models_widen_the_deviation():
    states, _, _, rng = simulate(500, 4)
    record = sid.TimeRecord(RATE, measured(states, rng, 0.3), ["1X"], ["acceleration"], variance=np.array([0.09]))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    sure, unsure = (sid.sense(make_model(std), record, ["2X"], unknown=unknown) for std in (0.0, 0.3))
    assert np.median(unsure.std) > 1.2 * np.median(sure.std)


def test_what_cannot_be_told_is_named():
    record = sid.TimeRecord(RATE, np.ones((50, 1)), ["1X"], ["acceleration"], variance=np.array([1.0]))
    with pytest.raises(InputError, match="2 unknown forces cannot be told by 1 sensors"):
        sid.sense(make_model(), record, ["2X"], unknown=sid.UnknownForces(["1X", "2X"], 0.1))
    with pytest.raises(NoAnswerError, match="nothing holds the structure"):
        sid.sense(make_model(free=True), record, ["2X"], unknown=sid.UnknownForces(["2X"], 0.1, 1.0))
    with pytest.raises(InputError, match="`leave_out` names 2X"):
        sid.sense(make_model(), record, ["2X"], leave_out=["2X"])
    with pytest.raises(InputError, match="`correlation_time` must be greater than 0"):
        sid.UnknownForces(["2X"], 0.0)
