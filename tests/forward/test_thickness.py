"""A thickness as an unknown: FRF derivatives in the dense and the large way, and what linear methods say."""

from dataclasses import replace

import numpy as np
import pytest

from structid import (
    FrfRecord,
    InputError,
    Plate,
    Structure,
    TimeRecord,
    Unknown,
    parameters,
    simulated_time_record,
)
from structid.dynamics.receptance import DENSE_UP_TO
from structid.forward import output_error_problem
from structid.forward.frf.response import response
from structid.forward.sensitivity import require_linear_weights


def strip(n):
    """A cantilever of n by 2 plates in two sets, the second with every thickness of its own."""
    grid = np.stack(np.meshgrid(np.linspace(0, 0.4, n + 1), [0.0, 0.05, 0.1], indexing="ij"), axis=-1).reshape(-1, 2)
    corner = np.arange(3 * n).reshape(n, 3)[:, :2].ravel()
    table = corner[:, None] + np.array([0, 3, 4, 1])
    half = len(table) // 2
    common = {"density": 2700.0, "poisson": 0.3, "loss_factor": 0.02}
    thick = np.linspace(0.003, 0.004, len(table) - half)
    sets = [
        Plate("a", table[:half], 70e9, thickness=0.003, **common),
        Plate("b", table[half:], 70e9, thickness=thick, **common),
    ]
    held = [f"{node}{d}" for node in range(3) for d in ("Z", "RX", "RY")]
    return Structure(dict(enumerate(grid)), sets, held)


@pytest.mark.parametrize("n", [3, 20])
def test_derivatives_to_thickness_are_differences_in_every_way(n):
    structure = strip(n)
    assert (structure.n_dofs > DENSE_UP_TO) == (n == 20)
    unknown = parameters(
        structure,
        [
            Unknown("thickness", "b"),
            Unknown("thickness", "a", name="plain"),
            Unknown("youngs_modulus", ["a", "b"]),
            Unknown("loss_factor", ["a", "b"]),
            Unknown("density", "b"),
        ],
    )
    frequency, last = np.linspace(5, 120, 6), 3 * n
    sensors = [f"{last}Z", f"{last + 2}RX", f"{last - 3}Z"]
    like = FrfRecord(frequency, np.ones((6, 3, 1)), sensors, [f"{last}Z"], "accelerance")
    model = response(structure, unknown, like)
    start = np.array(unknown.start)
    _, slopes = model.derivatives_at(start)
    for k, step in enumerate(2e-5 * start):
        move = step * np.eye(len(start))[k]
        near, far = (model.values_at(start + n * move) - model.values_at(start - n * move) for n in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(slopes[..., k] - difference).max() <= 1e-6 * np.abs(difference).max()


def test_derivatives_of_histories_to_thickness_are_differences():
    drawn = strip(2)
    undamped = [replace(one, loss_factor=0.0, stiffness_damping=1e6) for one in drawn.elements]
    structure = Structure(drawn.nodes, undamped, drawn.fixed)
    sought = [Unknown("thickness", "b"), Unknown("youngs_modulus", ["a", "b"]), Unknown("density", "a")]
    unknown = parameters(structure, sought)
    blank = np.zeros((60, 2))
    blank[:, 0] = np.random.default_rng(0).standard_normal(60)
    like = TimeRecord(2000.0, blank, ("6Z", "7Z"), ("force", "acceleration"), variance=[0.0, 1.0])
    record = simulated_time_record(structure, unknown, like)
    problem = output_error_problem(structure, unknown.started_at(1.05 * unknown.start), record)
    at, step = problem.linearize(problem.theta_start), 1e-5
    for k, unit in enumerate(np.eye(3)):
        sides = [problem.residual(problem.theta_start + sign * step * unit) for sign in (1, -1)]
        difference = (sides[0] - sides[1]) / (2 * step)
        assert np.abs(at.jacobian[:, k] - difference).max() <= 1e-6 * np.abs(difference).max()


def test_methods_that_are_linear_in_the_parameters_refuse_an_unknown_thickness():
    structure = strip(2)
    with pytest.raises(InputError, match=r"thickness\[a\] must be known here"):
        require_linear_weights(structure, parameters(structure, [Unknown("thickness", "a")]))
    with pytest.raises(InputError, match=r"thickness\[a\] must be known here"):
        require_linear_weights(structure, parameters(structure, [Unknown("thickness", "a", start=0.1, fixed=True)]))
    require_linear_weights(structure, parameters(structure, [Unknown("youngs_modulus", "a")]))
