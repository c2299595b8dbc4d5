"""Causes in models whose dynamic stiffness is not inverted line by line: modes and a static rest take its place."""

import numpy as np
import pytest

import structid as sid
from structid.diagnose import receptances
from structid.diagnose.causes import candidates
from structid.diagnose.causes.candidate import has_places
from structid.diagnose.receptances import modal_flexibility, receptances_at
from structid.forward import FrfProblem

NODES = {i: (0.1 * i, 0.0, 0.0) for i in range(13)}
SENSORS = ("3Z+", "5Z+", "8Z+", "12Z+")


def beam(fixed):
    cells = sid.SpaceBeam(
        "beam", [[i, i + 1] for i in range(12)], mass=2.7, polar_inertia=1e-3, axial_stiffness=7e7, bending_stiffness_y=600.0,
        bending_stiffness_z=4000.0, torsional_stiffness=500.0, loss_factor=0.02,
    )  # fmt: skip
    return sid.Structure(NODES, [cells, sid.PointMass("tip", [12], 0.4)], fixed=fixed)


def problem_of(structure, n_lines=6):
    unknown = sid.parameters(structure, [sid.Unknown("bending_stiffness_y", "beam")])
    frequency = np.linspace(5.0, 120.0, n_lines)
    values = np.ones((n_lines, 4, 1), complex)
    record = sid.FrfRecord(frequency, values, SENSORS, ("5Z+",), "receptance", variance=1e-4 * np.abs(values) ** 2)
    return FrfProblem(structure, unknown, record)


CLAMPED = [f"0{direction}" for direction in ("X", "Y", "Z", "RX", "RY", "RZ")]


@pytest.mark.parametrize("fixed", [CLAMPED, []], ids=["clamped", "free"])
def test_modes_and_a_static_rest_are_the_inverse(fixed):
    """Of a free body too, whose stiffness alone has no inverse."""
    structure = beam(fixed)
    problem = problem_of(structure)
    whole = receptances_at(problem, problem.theta_start)
    exact = np.linalg.inv(whole.stiffness_of(structure))
    condensed = modal_flexibility(structure, whole.values, whole.laplace)
    bending = np.array([structure.numbering.free.index(6 * i + 2) for i in (3, 5, 8, 12)])
    block = exact[:, bending[:, None], bending]
    assert condensed.shapes.shape[1] < structure.n_dofs
    np.testing.assert_allclose(condensed.block(bending), block, atol=1e-3 * np.abs(block).max())
    forces = np.eye(structure.n_dofs)[:, bending]
    np.testing.assert_allclose(condensed.motion(forces)[:, bending], condensed.block(bending), rtol=1e-9, atol=1e-20)


def test_effects_of_changes_are_those_of_the_inverse(monkeypatch):
    problem = problem_of(beam(CLAMPED))
    exact = receptances_at(problem, problem.theta_start)
    assert exact.under_loads.shape == (6, 72, 1)
    assert exact.under_sensors.shape == (6, 72, 4)
    monkeypatch.setattr(receptances, "MOST_DENSE_DOFS", 10)
    condensed = receptances_at(problem, problem.theta_start)
    size = np.abs(exact.frf).max()
    compared = set()
    for candidate in candidates([exact]):
        if candidate.kind not in ("mass", "spring", "dashpot", "support", "joint", "inertia"):
            continue
        strengths = np.sort(np.abs(candidate.strengths))[:1]
        ours, true = candidate.effect(condensed, strengths), candidate.effect(exact, strengths)
        np.testing.assert_allclose(ours, true, atol=2e-3 * max(np.abs(true).max(), 0.01 * size), err_msg=str(candidate))
        compared.add(candidate.kind)
    assert compared >= {"mass", "spring", "dashpot", "support", "inertia"}


def test_nodes_of_sensors_are_among_those_of_a_large_model(monkeypatch):
    monkeypatch.setattr("structid.diagnose.causes.candidate.MOST_NODES", 3)
    problem = problem_of(beam(CLAMPED))
    masses = {one.where[0] for one in candidates([receptances_at(problem, problem.theta_start)]) if one.kind == "mass"}
    assert {"3", "5", "8", "12"} <= masses


def test_models_beyond_the_limit_are_searched_in_their_records_alone(monkeypatch):
    problem = problem_of(beam(CLAMPED))
    assert has_places(problem)
    monkeypatch.setattr("structid.diagnose.causes.candidate.MOST_SCREENED_DOFS", 50)
    assert not has_places(problem)
    kinds = {one.kind for one in candidates([receptances_at(problem, problem.theta_start)])}
    assert kinds
    assert not kinds & {"mass", "spring", "support"}
