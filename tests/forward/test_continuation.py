"""Continuation from the right half-plane, and the response at complex s."""

from dataclasses import replace

import numpy as np
import pytest

import structid as sid
from structid.core.dof import parse_dofs
from structid.forward.frf import continuation
from structid.forward.frf.continuation import START_ERROR, smoothed_records, start_deviation, thinned_lines
from structid.forward.frf.problem import decay_continuation, tightened
from structid.forward.frf.response import response

MASS, STIFFNESS = np.array([0.9, 1.3, 1.2]), np.array([1.4, 0.7, 1.2])


def cantilever(loss_factor: float = 0.0) -> tuple[sid.Structure, sid.Parameters]:
    """Three beam elements clamped at one end, every mass, stiffness and damping unknown."""
    beam = sid.Beam(
        "beam",
        [[0, 1], [1, 2], [2, 3]],
        MASS,
        STIFFNESS,
        loss_factor=loss_factor,
        mass_damping=0.01 * MASS,
        stiffness_damping=0.002 * STIFFNESS,
    )
    structure = sid.Structure({i: float(i) for i in range(4)}, [beam], ["0Y", "0RZ"])
    names = ("mass", "bending_stiffness", "stiffness_damping")
    return structure, sid.parameters(structure, [sid.Unknown(n, "beam", each=True, factor=False) for n in names])


def record(omega: np.ndarray, noise: float = 0.0, seed: int = 0, kind: str = "receptance") -> sid.FrfRecord:
    structure, truth = cantilever()
    blank = np.ones((len(omega), 1, 1), dtype=complex)
    like = sid.FrfRecord(omega / (2 * np.pi), blank, ("3Y+",), ("3Y+",), kind)
    return sid.simulated_record(structure, truth, like, noise, np.random.default_rng(seed))


FINE = np.arange(1, 4501) * 0.008


def started(rms: float, seed: int) -> sid.Parameters:
    """Masses and stiffnesses off by `rms` in the logarithm, damping by a factor of e."""
    _, truth = cantilever()
    off = np.random.default_rng(seed).standard_normal(9)
    off[:6] *= rms / np.sqrt(np.mean(off[:6] ** 2))
    off[6:] = np.sign(off[6:])
    return truth.started_at(truth.start * np.exp(off))


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_response_at_complex_s_equals_the_dense_inverse(kind):
    structure, truth = cantilever(0.02)
    decay = np.array([0.3, 0.05, 2.0])
    here = replace(record(np.array([0.5, 1.0, 7.0]), kind=kind), decay=decay)
    found = response(structure, truth, here).values_at(truth.start)[:, 0, 0]
    matrices = [structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness", "structural_damping")]
    tip = structure.selection(parse_dofs(["3Y+"])).toarray()[:, 0]
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]
    for value, s in zip(found, decay + 1j * np.array([0.5, 1.0, 7.0]), strict=True):
        dense = s**2 * matrices[0] + s * matrices[1] + matrices[2] + 1j * matrices[3]
        assert value == pytest.approx(s**power * tip @ np.linalg.solve(dense, tip), rel=1e-10)


@pytest.mark.parametrize("form", ["output", "log", "pole_free"])
def test_jacobian_at_complex_s_and_of_the_held_start_equals_differences(form):
    structure, truth = cantilever(0.02)
    omega = np.array([0.4, 1.1, 3.0, 9.0])
    here = replace(record(omega), decay=0.2 * omega, variance=None)
    prior = (truth.theta_start + 0.1, np.where(np.arange(9) == 4, np.inf, 0.5))
    problem = sid.FrfProblem(structure, started(0.2, 1), here, form, model_error=0.1).with_free_prior(*prior)
    theta = problem.theta_start
    at = problem.linearize(theta)
    assert len(at.residual) == problem.n_data + 8
    steps = 1e-6 * np.eye(9)
    differences = np.column_stack([(problem.residual(theta + h) - problem.residual(theta - h)) / 2e-6 for h in steps])
    np.testing.assert_allclose(at.jacobian, differences, rtol=1e-6, atol=1e-6 * np.abs(differences).max())


def test_smoothed_records_are_the_model_right_of_the_axis():
    structure, truth = cantilever()
    found = smoothed_records(record(FINE, 0.01))
    assert [level for level, _ in found][-1] == 0.015
    for level, smooth in found:
        exact = response(structure, truth, smooth).values_at(truth.start)
        error = np.abs(smooth.values - exact) / np.sqrt(smooth.variance)
        np.testing.assert_allclose(smooth.decay, level * smooth.omega, rtol=1e-12)
        assert np.sqrt(np.mean(error**2)) < 1.0


def test_too_few_lines_make_no_plan():
    structure, truth = cantilever()
    few = record(np.array([0.5, 2.0, 5.0, 9.0, 14.0, 20.0]), 0.01)
    problem = sid.FrfProblem(structure, truth, few, start_error=0.5)
    assert decay_continuation(problem) == ()
    assert len(problem.schedules()) == 2


def test_plans_come_from_far_first_where_the_start_error_is_given():
    structure, truth = cantilever()
    problem = sid.FrfProblem(structure, truth, record(FINE[::5], 0.01))
    near = problem.schedules()
    far = replace(problem, start_error=0.4).schedules()
    assert near[0][0][0].startswith("bounded residual")
    assert near[-1][0][0].startswith("smoothed FRFs")
    assert far[0][0][0].startswith("smoothed FRFs")
    first, second = far[0][0][1].unknowns.free_prior, far[1][0][1].unknowns.free_prior
    np.testing.assert_allclose(second[1], 0.5 * first[1])
    # log parameters: masses and stiffnesses 0.4, damping at least 1
    np.testing.assert_allclose(first[1], [0.4] * 6 + [1.0] * 3)
    assert tightened(far[0], 2.0)[0][1].unknowns.free_prior[1][0] == pytest.approx(0.8)


def test_held_start_leaves_parameters_with_a_prior_of_their_own():
    structure, _ = cantilever()
    names = [
        sid.Unknown("mass", "beam", prior=sid.Prior(1.0, 0.1), factor=True),
        sid.Unknown("bending_stiffness", "beam"),
    ]
    problem = sid.FrfProblem(structure, sid.parameters(structure, names), record(FINE[::9], 0.01))
    assert start_deviation(problem.unknowns, START_ERROR).tolist() == [np.inf, START_ERROR]


@pytest.mark.parametrize("seed", range(2))
def test_continuation_converges_from_half_of_every_value(seed):
    structure, truth = cantilever()
    measured = record(FINE[::2], 0.01, seed)
    problem = sid.FrfProblem(structure, started(0.5, seed), measured, start_error=START_ERROR)
    found = sid.estimate(problem, plans=problem.schedules()[:1], sample=problem.subsampled())
    assert found.status is sid.Status.CONVERGED
    assert found.covariance_basis == "noise"
    assert (np.abs(found.values / truth.start - 1) < 5 * found.std / truth.start).all()


def test_plain_search_from_half_of_every_value_fails_and_says_so():
    structure, _ = cantilever()
    problem = sid.FrfProblem(structure, started(0.5, 0), record(FINE[::4], 0.01, 0))
    found = sid.estimate(problem, sid.LevenbergMarquardt(max_iterations=40, acceleration=0))
    assert found.covariance_basis == "model_error"


def test_search_on_a_part_of_the_lines_ends_where_all_lines_lead(monkeypatch):
    structure, _ = cantilever()
    monkeypatch.setattr(continuation, "_THINNED_LINES", 400)
    problem = sid.FrfProblem(structure, started(0.05, 0), record(FINE, 0.01, 3))
    assert len(problem.subsampled().record.frequency) <= 401
    part = sid.estimate(problem, plans=problem.schedules()[:1], sample=problem.subsampled())
    whole = sid.estimate(problem, plans=problem.schedules()[:1])
    np.testing.assert_allclose(part.values, whole.values, atol=1e-3 * whole.std.min(), rtol=1e-6)
    np.testing.assert_allclose(part.std, whole.std, rtol=1e-6)
    assert part.goodness.degrees_of_freedom == whole.goodness.degrees_of_freedom


def test_thinned_lines_are_spread_in_the_logarithm():
    omega = np.arange(1, 85001) * 1e-3
    keep = thinned_lines(omega)
    assert 1900 <= len(keep) <= 2001
    steps = np.diff(np.log(omega[keep]))
    assert steps[-200:].max() < 1.5 * steps[-200:].min()
    assert thinned_lines(omega[:500]).tolist() == list(range(500))


def test_identify_comes_by_continuation_where_asked():
    structure, truth = cantilever()
    stages = []
    found = sid.identify(
        structure,
        started(0.5, 0),
        record(FINE[::3], 0.01, 0),
        sid.IdentifyOptions(start="continuation", start_error=0.4),
        lambda name, iteration, cost: stages.append(name),
    ).estimate
    assert stages[0].startswith("smoothed FRFs")
    assert found.search.n_starts == 1
    assert (np.abs(found.values - truth.start) < 5 * found.std).all()
