"""Norris (1986), chapter 4: the parameters of a cantilever from all motions at one frequency, or from some of them."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from arrow_system import ArrowSystem
from structid import Beam, FrfProblem, FrfRecord, GaussNewton, Structure, Unknown, parameters
from structid.forward import one_step_values
from structid.forward.frf.response import response
from structid.inversion import minimize

ACTUAL = np.array([0.92, 1.28, 1.17, 0.63, 1.11, 0.98, 1.38, 0.68, 1.24, 0.56, 0.76, 1.12])  # Table 4.1
POSTULATED = np.array([0.90, 1.15, 1.20, 0.50, 1.20, 0.90, 1.30, 0.60, 1.10, 0.50, 0.90, 1.20])
HISTORY = [1.11e-1, 2.98e-2, 3.58e-3, 1.66e-5, 1.7e-10]  # of an independent reproduction
GRID = np.arange(1, 13) * 0.5 / (2 * np.pi)  # the twelve printed frequencies, Hz
UNKNOWNS = [Unknown(p, "beam", each=True, positive=False) for p in ("mass", "bending_stiffness")]


def cantilever(values, **damping):
    beam = Beam("beam", [[i, i + 1] for i in range(6)], values[:6], values[6:], **damping)
    return Structure({i: float(i) for i in range(7)}, [beam], ["0Y", "0RZ"])


def all_motions(**damping):
    actual = cantilever(ACTUAL, **damping)
    known = parameters(actual, UNKNOWNS)
    record = FrfRecord(GRID[:1], np.ones((1, 12, 1)), actual.dofs, ("6Y+",), "receptance")
    return replace(record, values=response(actual, known, record).values_at(known.start))


@pytest.mark.parametrize("damping", [{}, {"stiffness_damping": 0.01, "mass_damping": 0.02}, {"loss_factor": 0.02}])
def test_one_step_solve_is_exact_from_any_start(damping):
    record = all_motions(**damping)
    rng = np.random.default_rng(41)
    starts = [POSTULATED, *(ACTUAL * np.exp(rng.uniform(-1.5, 1.5, (5, 12))))]
    for start in starts:
        structure = cantilever(start, **damping)
        found = one_step_values(structure, parameters(structure, UNKNOWNS), record)
        assert np.abs(found / ACTUAL - 1).max() <= 1e-11


def test_classical_iteration_has_the_published_history():
    """RMS of relative errors, two significant digits; Eqs. (4.15)-(4.18) with the postulated motion in B."""
    structure = cantilever(POSTULATED)
    problem = FrfProblem(structure, parameters(structure, UNKNOWNS), all_motions(), "equation")
    found = minimize(problem, GaussNewton(step_control=False, max_iterations=5))
    error = np.sqrt(np.mean((found.history / ACTUAL - 1) ** 2, axis=1))
    assert error[:5] == pytest.approx(HISTORY, rel=2e-2)
    assert error[5] <= 1e-12


def record_of(values, frequency, sensors):
    """Noise-free receptances at some of the twelve degrees of freedom; `values` may hold dampings last."""
    actual = cantilever(values[:12], **damped(values[12:]))
    known = parameters(actual, UNKNOWNS)
    blank = np.ones((len(frequency), len(sensors), 1))
    record = FrfRecord(frequency, blank, tuple(actual.dofs[i] for i in sensors), ("6Y+",), "receptance")
    return replace(record, values=response(actual, known, record).values_at(known.start))


def damped(values):
    """Damping of `cantilever` from six mass-like and six stiffness-like ones; none from none."""
    return {"mass_damping": values[:6], "stiffness_damping": values[6:]} if len(values) else {}


def eliminated_step(structure, made, record):
    found = minimize(FrfProblem(structure, made, record, "equation"), GaussNewton(step_control=False, max_iterations=1))
    return found.history[1] - found.history[0]


@pytest.mark.parametrize("sensors", [[10], [10, 11], [0, 4, 7, 10], list(range(12))])
def test_eliminated_form_gives_the_step_of_the_arrow_system(sensors):
    """Eq. (4.24) as printed (with A = [B, -E], 4.22a corrected), dense, against the weighted step on the sensors."""
    structure = cantilever(POSTULATED)
    made = parameters(structure, UNKNOWNS)
    record = record_of(ACTUAL, GRID, sensors)
    step = ArrowSystem(structure, made, record).step()
    problem = FrfProblem(structure, made, record, "equation")
    rounding = 1e-11 + 10 * np.finfo(float).eps * np.linalg.cond(problem.linearize(problem.theta_start).jacobian)
    assert rounding < 1e-7  # the worst, one sensor: a condition of 1.4e7
    assert np.abs(eliminated_step(structure, made, record) - step).max() <= rounding * np.abs(step).max()


@pytest.mark.parametrize("sensors", [[10, 11], [0, 4, 7, 10], list(range(12))])
@pytest.mark.parametrize("unknown_damping", [True, False])
def test_eliminated_form_gives_the_step_of_the_arrow_system_with_damping(sensors, unknown_damping):
    """The same with complex B and E and real parameters: real and imaginary parts stacked, dampings unknown or known."""
    rng = np.random.default_rng(5)
    damping = np.concatenate([0.05 * np.ones(6), 0.02 * np.ones(6)])
    values = np.concatenate([ACTUAL, damping * np.exp(0.2 * rng.standard_normal(12))])
    structure = cantilever(POSTULATED, **damped(damping))
    names = ("mass_damping", "stiffness_damping") if unknown_damping else ()
    made = parameters(structure, [*UNKNOWNS, *(Unknown(p, "beam", each=True, positive=False) for p in names)])
    record = record_of(values, GRID, sensors)
    step = ArrowSystem(structure, made, record).step()
    assert len(step) == (24 if unknown_damping else 12)
    assert np.abs(eliminated_step(structure, made, record) - step).max() <= 1e-9 * np.abs(step).max()


def test_hermitian_pseudo_inverse_alone_would_give_complex_parameters():
    """Eqs. (4.18) and (4.26) with damping: B^T B is not what least squares needs, and B^H B gives complex steps."""
    damping = np.concatenate([0.05 * np.ones(6), 0.02 * np.ones(6)])
    structure = cantilever(POSTULATED, **damped(damping))
    made = parameters(structure, UNKNOWNS)
    record = record_of(np.concatenate([ACTUAL, 1.5 * damping]), GRID, [0, 4, 7, 10])
    matrix, right = ArrowSystem(structure, made, record).system()
    hermitian = np.linalg.lstsq(matrix, right, rcond=None)[0][:12]
    transposed = np.linalg.solve(matrix.T @ matrix, matrix.T @ right)[:12]
    stacked = ArrowSystem(structure, made, record).step()
    for printed in (hermitian, transposed):
        assert np.abs(printed.imag).max() > 1e-3
        assert np.abs(printed.real - stacked).max() > 1e-3
    assert eliminated_step(structure, made, record) == pytest.approx(stacked, abs=1e-9)


def test_memory_of_a_step_grows_with_the_number_of_frequencies_as_it_does():
    """Four times the frequencies, four times the memory (to 15 %); the arrow system would need sixteen times."""
    structure = cantilever(POSTULATED)
    made = parameters(structure, UNKNOWNS)

    def peak(n_frequencies):
        record = record_of(ACTUAL, np.linspace(0.1, 1.0, n_frequencies), [10, 11])
        problem = FrfProblem(structure, made, record, "equation")
        problem.linearize(problem.theta_start)
        tracemalloc.start()
        problem.linearize(problem.theta_start)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    assert peak(1600) <= 1.15 * 4 * peak(400)
