"""Forces that run straight between samples, as simulations take them: spectra are those of sampled motions, aliases included."""

from dataclasses import replace

import numpy as np
import pytest

from short_record_cases import chain, unknowns
from structid import TimeRecord, simulated_time_record
from structid.forward import SpectraProblem, damped_stages
from structid.forward.time.spectra import spectra_problem
from structid.records.spectra import finite_spectra

RATE = 50.0


def simulated(quantity, force_noise=0.0):
    """Two sensors of the chain under white samples, straight between them; motions are exact there."""
    structure = chain()
    unknown = unknowns(structure)
    force = np.random.default_rng(3).standard_normal(1500)
    blank = np.column_stack([force, np.zeros((1500, 2))])
    record = TimeRecord(RATE, blank, ("1X", "2X", "4X"), ("force", quantity, quantity))
    record = simulated_time_record(structure, unknown, record)
    power = (record.values**2).mean(axis=0)
    return structure, unknown, replace(record, variance=power * [force_noise**2, 1.0, 1.0])


@pytest.mark.parametrize(("quantity", "share"), [("displacement", 1e-4), ("velocity", 3e-4), ("acceleration", 3e-4)])
def test_the_motion_of_forces_that_run_straight_is_predicted(quantity, share):
    structure, unknown, record = simulated(quantity)
    missed = []
    for straight in (True, False):
        problem = spectra_problem(structure, unknown, record, band=(0.1, 12.0), straight=straight)
        missed.append(np.sqrt(np.mean(problem.residual(problem.theta_start) ** 2)))
    assert missed[0] < share
    assert missed[1] > 30 * missed[0]


def test_signals_that_are_faded_out_show_forces_that_run_straight_too():
    structure, unknown, record = simulated("acceleration")
    spectra = finite_spectra(record, band=(0.1, 12.0), decay=0.5, straight=True)
    problem = SpectraProblem(structure, unknown, spectra, record=record)
    assert np.sqrt(np.mean(problem.residual(problem.theta_start) ** 2)) < 3e-4
    assert all(stage.spectra.straight == 1 / RATE for way in damped_stages(problem, record) for _, stage in way)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_the_gradient_is_that_of_forces_that_run_straight(quantity):
    structure, unknown, record = simulated(quantity, force_noise=0.05)
    problem = spectra_problem(structure, unknown, record, band=(0.1, 20.0), straight=True)
    rng = np.random.default_rng(1)
    theta = problem.theta_start + 0.05 * rng.standard_normal(len(problem.theta_start))
    at = problem.linearize(theta)
    gradient, step = 2 * at.jacobian.T @ at.residual, 1e-5
    sides = [[np.sum(problem.residual(theta + sign * step * e) ** 2) for sign in (1, -1)] for e in np.eye(len(theta))]
    difference = np.array([(ahead - behind) / (2 * step) for ahead, behind in sides])
    np.testing.assert_allclose(gradient, difference, atol=1e-6 * np.abs(gradient).max())
