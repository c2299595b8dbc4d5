"""Histories fitted in time carry the tolerances of fixed values: derivatives against fits with changed models, and the misfit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import structid as sid
from structid.forward import TimeOptions, identify_time, simulated_time_record
from structid.forward.fixed_values import with_fixed_values
from structid.forward.time.output_error import output_error_problem
from structid.unknowns.tolerances import EXACT, Tolerances

MASS, SPRING, DASHPOT = (2.0, 1.5), (300.0, 200.0), (1.2, 0.8)
TOLERANCES = Tolerances(mass=0.01, stiffness=0.01, damping=0.2, calibration=0.01)
STEP = 0.02


def chain(mass=MASS, spring=SPRING, dashpot=DASHPOT) -> sid.Structure:
    parts: list = [sid.PointMass(f"m{i + 1}", [i + 1], mass=mass[i]) for i in range(2)]
    for i in range(2):
        below = f"{i}X" if i else None
        parts.append(sid.Spring(f"k{i + 1}", f"{i + 1}X", second=below, stiffness=spring[i]))
        parts.append(sid.Dashpot(f"c{i + 1}", f"{i + 1}X", second=below, viscous_damping=dashpot[i]))
    return sid.Structure({1: 0.0, 2: 1.0}, parts, active=["X"])


def motion(mass, spring, dashpot, force) -> dict[str, np.ndarray]:
    """Motion (n, 2) of both masses from rest under a force at the second that runs straight between its samples."""

    def matrix(pair):
        return np.array([[pair[0] + pair[1], -pair[1]], [-pair[1], pair[1]]])

    inverse = np.diag(1 / np.asarray(mass))
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ matrix(spring), -inverse @ matrix(dashpot)]])
    b = np.array([0.0, 0.0, 0.0, 1 / mass[1]])
    wide = np.zeros((6, 6))
    wide[:4, :4], wide[:4, 4], wide[4, 5] = a * STEP, b * STEP, 1.0
    step = expm(wide)
    state = np.zeros((len(force), 4))
    for i in range(len(force) - 1):
        state[i + 1] = step[:4, :4] @ state[i] + step[:4, 4] * force[i] + step[:4, 5] * (force[i + 1] - force[i])
    acceleration = state @ a[2:].T + np.outer(force, b[2:])
    return {"acceleration": acceleration, "velocity": state[:, 2:], "displacement": state[:, :2]}


def recorded(method: str, values=(MASS, SPRING, DASHPOT), gain=1.0, noise=1e-3, seed=0) -> sid.TimeRecord:
    rng = np.random.default_rng(seed)
    force = np.convolve(rng.standard_normal(200), np.hanning(7), "same")
    force[0] = 0.0
    kinds = ("acceleration", "velocity", "displacement") if method == "instrumental" else ("acceleration",)
    clean = motion(*values, force)
    columns = [gain * clean[kind] for kind in kinds]
    rms = np.sqrt((np.hstack(columns) ** 2).mean(axis=0))
    read = np.hstack(columns) + noise * rms * rng.standard_normal((len(force), len(rms)))
    return sid.TimeRecord(
        1 / STEP,
        np.column_stack([read, force]),
        (*["1X", "2X"] * len(kinds), "2X"),
        (*[kind for kind in kinds for _ in range(2)], "force"),
        np.append((noise * rms) ** 2, 0.0),
    )


def fitted(method: str, structure: sid.Structure, record: sid.TimeRecord, tolerances=TOLERANCES):
    sought = sid.parameters(structure, [sid.Unknown("stiffness", "k1"), sid.Unknown("viscous_damping", "c2")])
    return identify_time(structure, sought, record, TimeOptions(method=method, restarts=0, tolerances=tolerances))


@pytest.mark.parametrize("method", ["output_error", "instrumental", "weak"])
def test_changes_with_fixed_values_are_those_of_fits_with_changed_models(method):
    record, h = recorded(method, noise=0.01 if method == "output_error" else 1e-3), 1e-3
    estimate = fitted(method, chain(), record)
    assert estimate.fixed is not None
    slopes = dict(zip(estimate.fixed.names, estimate.fixed.slope.T, strict=True))
    assert len(slopes) == 5  # two masses, a spring, a dashpot, the calibration
    for name, mass, spring, gain in (
        ("mass[m2]", (MASS[0], MASS[1] * (1 + h)), SPRING, 1.0),
        ("stiffness[k2]", MASS, (SPRING[0], SPRING[1] * (1 + h)), 1.0),
        ("calibration", MASS, SPRING, 1 + h),
    ):
        # sensors that the model takes to read more are sensors whose readings are less of the truth
        scaled = replace(record, values=np.column_stack([record.values[:, :-1] / gain, record.values[:, -1]]))
        moved = fitted(method, chain(mass, spring), scaled)
        [slope] = [slopes[key] for key in slopes if key.startswith(name)]
        change = (moved.values - estimate.values) / h
        np.testing.assert_allclose(slope, change, atol=0.02 * np.abs(change).max(), rtol=0.02)
    added = (estimate.fixed.slope * estimate.fixed.tolerance) ** 2
    exact = fitted(method, chain(), record, EXACT)
    assert exact.fixed is None
    np.testing.assert_allclose(estimate.std**2, exact.std**2 + added.sum(axis=1), rtol=1e-6)


@pytest.mark.parametrize("method", ["output_error", "instrumental"])
def test_a_model_wrong_by_its_tolerances_is_not_called_wrong_by_them(method):
    mass, gain = (MASS[0] * 1.01, MASS[1] * 0.992), 1.008
    record = recorded(method, (mass, SPRING, DASHPOT), gain)
    exact, allowed = (fitted(method, chain(), record, tolerances) for tolerances in (EXACT, TOLERANCES))
    assert exact.covariance_basis == "model_error"
    assert allowed.covariance_basis == "noise"
    assert allowed.fixed is not None
    assert not allowed.fixed.beyond
    assert allowed.goodness.least_chi_square < 1.3 * allowed.goodness.n_data < exact.goodness.chi_square
    assert (np.abs(allowed.values - [SPRING[0], DASHPOT[1]]) < 2.5 * allowed.std).all()
    far = recorded(method, ((MASS[0] * 1.1, MASS[1]), SPRING, DASHPOT))
    assert fitted(method, chain(), far).covariance_basis == "model_error"


def test_gain_of_the_calibration_has_the_derivative_of_output_error():
    structure = chain()
    sought = sid.parameters(structure, [sid.Unknown("stiffness", "k1")])
    record = replace(recorded("output_error"), variance=np.array([1e-6, 2e-6, 1e-4]))  # a noisy force besides
    problem = with_fixed_values(
        output_error_problem(structure, sought, replace(record, values=record.values[:60])), TOLERANCES
    )
    theta = np.array(problem.theta_start) + 0.003
    linearization, h = problem.linearize(theta), 1e-6
    np.testing.assert_allclose(linearization.residual, problem.residual(theta))
    number = problem.names.index("fixed calibration[record]")
    for index in (0, number):
        step = h * np.eye(len(theta))[index]
        change = (problem.residual(theta + step) - problem.residual(theta - step)) / (2 * h)
        # Kaufman's Jacobian leaves out a part that is orthogonal to its columns
        np.testing.assert_allclose(
            linearization.jacobian.T @ change,
            linearization.jacobian.T @ linearization.jacobian[:, index],
            rtol=1e-3,
            atol=1e-3 * np.linalg.norm(change) * np.linalg.norm(linearization.jacobian, axis=0).max(),
        )


def test_a_search_that_stops_at_a_negative_mass_says_so_and_does_not_fail():
    """One iteration from ten noisy samples ends at a mass with which no motion can be simulated; tolerances need none there."""
    parts = [
        sid.PointMass("m", [1], mass=2.0),
        sid.Spring("k", "1X", stiffness=50.0),
        sid.Dashpot("c", "1X", viscous_damping=1.0),
    ]
    structure = sid.Structure({1: 0.0}, parts, active=["X"])
    kinds = [("mass", "m"), ("stiffness", "k"), ("viscous_damping", "c")]
    sought = sid.parameters(structure, [sid.Unknown(*kind) for kind in kinds])
    options = TimeOptions(method="instrumental", max_iterations=1, tolerances=Tolerances(calibration=0.01))
    quantities = ("acceleration", "velocity", "displacement", "force")
    for seed in range(3):
        rng = np.random.default_rng(seed)
        values = np.column_stack([np.zeros((10, 3)), rng.standard_normal(10)])
        blank = sid.TimeRecord(10.0, values, ("1X",) * 4, quantities, variance=[4.0, 0.5, 0.1, 1e-6])
        found = identify_time(structure, sought, simulated_time_record(structure, sought, blank, rng=rng), options)
        assert found.status is sid.Status.NOT_CONVERGED
        assert found.values[0] < 0
        assert found.fixed is not None
        assert np.isfinite(found.fixed.std).all()
