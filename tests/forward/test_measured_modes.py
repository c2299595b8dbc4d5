"""Errors of measured modes by their formula, and the slopes of a group whose modes are far apart."""

import numpy as np
from modal_problem_cases import require_exact_slope

from structid import ModalRecord, PointMass, Spring, Structure, Unknown, parameters
from structid.dynamics.normal_modes import modes
from structid.forward import ModalProblem, ModalSettings

STIFFNESS = [1000.0, 700.0, 400.0]


def chain():
    here, back = ["1X", "2X", "3X"], ["0X", "1X", "2X"]
    masses, springs = (
        PointMass("m", [1, 2, 3], [2.0, 3.0, 1.0]),
        Spring("k", here, back, stiffness=STIFFNESS, loss_factor=0.02),
    )
    return Structure({i: float(i) for i in range(4)}, [masses, springs], fixed=["0X"], active=["X"])


def problem(change=1.0, **settings):
    structure = chain()
    model = modes(*(structure.matrix(kind) for kind in ("mass", "stiffness", "damping", "structural_damping")))
    std = np.concatenate([0.01 * model.frequency, 0.1 * model.damping_ratio])
    shapes = model.mode_shapes / np.abs(model.mode_shapes).max(axis=0)
    record = ModalRecord(
        change * model.frequency,
        model.damping_ratio,
        shapes + 0.01 * np.random.default_rng(0).standard_normal(shapes.shape),
        ["1X", "2X", "3X"],
        np.diag(std**2),
        np.full(shapes.shape, 0.02),
    )
    unknown = parameters(structure, [Unknown("stiffness", "k", each=True), Unknown("mass", "m", each=True)])
    return ModalProblem(structure, unknown, record, ModalSettings(**settings)), model, std


def test_stated_errors_are_added_to_those_of_the_record_as_squares():
    made, model, std = problem(1.02, frequency_error=0.02, damping_error=0.3, use_damping=True)
    frequency = 1.02 * model.frequency
    total = np.hypot(std, np.concatenate([0.02 * frequency, 0.3 * model.damping_ratio]))
    np.testing.assert_allclose(made.data.covariance, np.diag(total**2), rtol=1e-12)
    residual = made.residual(made.theta_start)[: made.n_data]
    np.testing.assert_allclose(residual[-6:-3], -0.02 * model.frequency / total[:3], rtol=1e-8)


def test_the_slopes_of_a_group_of_modes_far_apart_are_differences():
    """Rows of mixing hold the means of two eigenvalues, which differ by a factor of ten here."""
    made, _, _ = problem(closeness=3.0)
    assert [len(group.members) for group in made.data.groups] == [3]
    require_exact_slope(made, made.theta_start + 0.1, 1e-7)
