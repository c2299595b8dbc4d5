"""Transient motion against closed forms of one mass and against a general integrator."""

import numpy as np
import pytest
from scipy import sparse
from scipy.integrate import solve_ivp

from structid import Beam, InputError, Structure
from structid.core.errors import SingularModelError
from structid.dynamics import harmonic_transient, sampled_transient

TIME = np.linspace(0.1, 6.0, 23)


def one(value):
    return np.array([[value]])


@pytest.mark.parametrize(
    ("stiffness", "omega", "expected"),
    [
        (9.0, 2.0, (np.cos(2 * TIME) - np.cos(3 * TIME)) / (9 - 4)),
        (9.0, 3.0, TIME * np.sin(3 * TIME) / 6),  # resonance
        (0.0, 2.0, (1 - np.cos(2 * TIME)) / 4),  # rigid body
        (0.0, 0.0, TIME**2 / 2),  # a constant force on a free mass
        (9.0, 0.0, (1 - np.cos(3 * TIME)) / 9),
    ],
)
@pytest.mark.parametrize("damping", [None, 0.0])
def test_one_mass_has_its_closed_form(stiffness, omega, expected, damping):
    """Both paths; rounding grows over the 23 steps of the matrix exponential."""
    mass = 2.5
    given = None if damping is None else one(damping)
    found = harmonic_transient(one(mass), one(mass * stiffness), [mass], omega, TIME, given)
    assert found.displacement[:, 0] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert found.acceleration[:, 0] == pytest.approx(np.cos(omega * TIME) - stiffness * expected, abs=1e-11)


def test_damped_mass_has_its_closed_form():
    """x'' + 2 z w x' + w^2 x = cos(b t) from rest: steady state plus decaying free motion."""
    w, z, b = 3.0, 0.1, 2.0
    found = harmonic_transient(one(1.0), one(w**2), [1.0], b, TIME, one(2 * z * w))
    steady = 1 / (w**2 - b**2 + 2j * z * w * b)
    wd = w * np.sqrt(1 - z**2)
    c1, c2 = -steady.real, (b * steady.imag - z * w * steady.real) / wd
    expected = (steady * np.exp(1j * b * TIME)).real
    expected += np.exp(-z * w * TIME) * (c1 * np.cos(wd * TIME) + c2 * np.sin(wd * TIME))
    assert found.displacement[:, 0] == pytest.approx(expected, abs=1e-12)


def free_beam():
    beam = Beam("beam", [[0, 1], [1, 2]], [2.0, 1.0], [3.0, 5.0], mass_damping=[0.3, 0.1], stiffness_damping=[0.0, 0.2])
    structure = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam])
    return [structure.matrix(kind) for kind in ("mass", "stiffness", "damping")]


def integrated(mass, stiffness, damping, force, time):
    """The same by an eighth-order Runge-Kutta method, tolerance 1e-12."""
    m, k, c = (matrix.toarray() for matrix in (mass, stiffness, damping))
    n = len(m)

    def rate(t, y):
        return np.concatenate([y[n:], np.linalg.solve(m, force(t) - c @ y[n:] - k @ y[:n])])

    found = solve_ivp(rate, (0, time[-1]), np.zeros(2 * n), "DOP853", time, rtol=1e-12, atol=1e-13)
    return found.y[:n].T, found.y[n:].T


@pytest.mark.parametrize("damped", [True, False])
def test_free_beam_moves_as_a_general_integrator_says(damped):
    """Nonproportional damping, rigid-body motion; unequal instants."""
    mass, stiffness, damping = free_beam()
    damping = damping if damped else sparse.csc_array(damping.shape)
    load = np.array([1.0, 0, 0, 0.5, -0.2, 0])
    time = np.array([0.2, 0.3, 0.7, 1.9, 2.0])
    found = harmonic_transient(mass, stiffness, load, 1.7, time, damping if damped else None)
    w, v = integrated(mass, stiffness, damping, lambda t: load * np.cos(1.7 * t), time)
    assert found.displacement == pytest.approx(w, abs=1e-10)
    assert found.velocity == pytest.approx(v, abs=1e-10)


def test_sampled_loads_are_exact_between_samples_in_straight_lines():
    mass, stiffness, damping = free_beam()
    rng = np.random.default_rng(3)
    rate = 5.0
    signals, loads = rng.standard_normal((9, 2)), np.eye(6)[:, [1, 4]]
    found = sampled_transient(mass, stiffness, loads, signals, rate, damping)
    time = np.arange(9) / rate
    w, v = np.zeros((9, 6)), np.zeros((9, 6))
    m, k, c = (matrix.toarray() for matrix in (mass, stiffness, damping))
    for step in range(8):  # piece by piece, since the integrator must not step across a kink

        def rate_of(t, y, at=step):
            force = loads @ (signals[at] + t * rate * (signals[at + 1] - signals[at]))
            return np.concatenate([y[6:], np.linalg.solve(m, force - c @ y[6:] - k @ y[:6])])

        start = np.concatenate([w[step], v[step]])
        end = solve_ivp(rate_of, (0, 1 / rate), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        w[step + 1], v[step + 1] = end[:6], end[6:]
    assert found.time == pytest.approx(time)
    assert found.displacement == pytest.approx(w, abs=1e-10)
    assert found.velocity == pytest.approx(v, abs=1e-10)
    residual = found.acceleration @ mass + found.velocity @ damping + found.displacement @ stiffness - signals @ loads.T
    assert np.abs(residual).max() <= 1e-12


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"time": [0.0, 0.5, 0.5]}, InputError, "increase"),
        ({"time": [-1.0]}, InputError, "negative"),
        ({"load": [1.0, 2.0]}, InputError, "`load` must have shape"),
        ({"mass": one(0.0)}, SingularModelError, "not positive definite"),
        ({"damping": np.eye(2)}, InputError, "`damping` must have shape"),
    ],
)
def test_bad_input_is_refused_by_name(change, error, words):
    given = {"mass": one(1.0), "stiffness": one(1.0), "load": [1.0], "omega": 1.0, "time": [1.0]}
    with pytest.raises(error, match=words):
        harmonic_transient(**(given | change))


def test_bad_signals_are_refused():
    with pytest.raises(InputError, match="`signals` must have shape"):
        sampled_transient(one(1.0), one(1.0), one(1.0), np.zeros((3, 2)), 10.0)
    with pytest.raises(InputError, match="`sampling_rate` must be positive"):
        sampled_transient(one(1.0), one(1.0), one(1.0), np.zeros((3, 1)), 0.0)
