"""One damping ratio in all modes, known or sought, as FRFs, histories, spectra and modes show it."""

import numpy as np
import pytest
from scipy import linalg
from test_modal_problem import measured, require_exact_slope

from structid import (
    Bar,
    FrfRecord,
    InputError,
    PointMass,
    Prior,
    Spring,
    Structure,
    TimeRecord,
    Unknown,
    estimate,
    identify_time,
    parameters,
    simulated_record,
    simulated_time_record,
)
from structid.forward import FrfProblem, ModalProblem, ModalSettings, TimeOptions, output_error_problem, response
from structid.forward.time.spectra import spectra_problem

RATIO = 0.03


def chain(ratio=RATIO, n=4, stiffness=2000.0):
    """Masses on springs, the last held as well."""
    ends = [f"{k}X" for k in range(1, n + 1)]
    sets = [
        PointMass("m", list(range(1, n + 1)), [1.0, 2.0, 1.5, 1.2][:n], directions=["X"]),
        Spring("k", ends, [*ends[1:], "0X"], stiffness=[stiffness * (1 + 0.2 * k) for k in range(n)]),
        Spring("ground", "1X", stiffness=0.4 * stiffness),
    ]
    return Structure({k: float(k) for k in range(n + 1)}, sets, ["0X"], active=["X"], damping_ratio=ratio)


def sought(structure, **damping):
    return parameters(
        structure,
        [
            Unknown("mass", "m:2"),
            Unknown("stiffness", "k", each=True),
            Unknown("damping_ratio", "all modes", **damping),
        ],
    )


def dense_receptance(structure, values, frequency):
    """By modes, one after another, (n_lines, n_dofs, n_dofs)."""
    mass, stiffness = (structure.matrix(law, values).toarray() for law in ("mass", "stiffness"))
    squares, shapes = linalg.eigh(stiffness, mass)
    omega = 2 * np.pi * frequency[:, None]
    gain = 1 / (squares - omega**2 + 2j * values[-1] * omega * np.sqrt(squares))
    return np.einsum("ik,lk,jk->lij", shapes, gain, shapes)


def test_frfs_are_sums_over_modes_of_that_ratio_at_any_values():
    structure = chain()
    made, frequency = sought(structure), np.linspace(0.5, 20, 60)
    channels = [f"{k}X" for k in range(1, 5)]
    blank = FrfRecord(frequency, np.ones((60, 4, 4)), channels, channels, "receptance")
    physical = made.start * np.random.default_rng(1).uniform(0.7, 1.4, made.n_params)
    found = response(structure, made, blank).values_at(physical)
    expected = dense_receptance(structure, made.values(physical), frequency)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


def rod(n):
    """A rod of n bars in three sets, whose masses and stiffnesses are known by sets."""
    sets, third = [], n // 3
    for k, name in enumerate("abc"):
        first, last = k * third, n if k == 2 else (k + 1) * third
        sets.append(Bar(name, [[i, i + 1] for i in range(first, last)], mass=2.0, axial_stiffness=1e4))
    return Structure({i: i / n for i in range(n + 1)}, sets, ["0X"], active=["X"], damping_ratio=RATIO)


@pytest.mark.parametrize(("n", "n_lines"), [(12, 6), (12, 300), (90, 6), (90, 150), (280, 6)])
def test_derivatives_of_frfs_are_differences(n, n_lines):
    """Small, medium and large models, line by line and by poles."""
    structure = rod(n)
    damping = Unknown("damping_ratio", "all modes", prior=Prior(0.02, 0.01))
    made = parameters(structure, [Unknown("axial_stiffness", "a"), Unknown("mass", ["b", "c"]), damping])
    frequency = np.linspace(5, 150, n_lines)
    blank = FrfRecord(frequency, np.ones((n_lines, 2, 1)), [f"{n}X", f"{n // 2}X"], [f"{n}X"], "accelerance")
    model = response(structure, made, blank)
    start = np.array(made.start) * [1.1, 0.9, 1.3]
    _, slopes = model.derivatives_at(start)
    for k, step in enumerate(2e-4 * start):
        move = step * np.eye(len(start))[k]
        near, far = (model.values_at(start + m * move) - model.values_at(start - m * move) for m in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(slopes[..., k] - difference).max() <= 1e-6 * np.abs(difference).max(), made.names[k]


def excited(structure, made, n=400, rate=60.0, noise=0.0, seed=0):
    """A record under random forces that run straight between samples."""
    rng = np.random.default_rng(seed)
    values = np.column_stack([rng.standard_normal((n, 1)), np.zeros((n, 2))])
    blank = TimeRecord(rate, values, ("1X", "2X", "4X"), ("force", "acceleration", "displacement"))
    clean = simulated_time_record(structure, made, blank, TimeOptions(force="first"))
    std = noise * np.sqrt((clean.values**2).mean(axis=0)) * [0, 1, 1]
    noisy = clean.values + std * rng.standard_normal(clean.values.shape)
    return TimeRecord(
        rate, noisy, clean.channels, clean.quantities, variance=np.where(std > 0, std, 1e-3) ** 2 * [0, 1, 1]
    )


def test_histories_are_sums_over_modes_and_their_derivatives_differences():
    structure = chain()
    made = sought(structure)
    record = excited(structure, made)
    mass, stiffness = (structure.matrix(law).toarray() for law in ("mass", "stiffness"))
    squares, shapes = linalg.eigh(stiffness, mass)
    moved = np.zeros(len(record.values))
    for square, shape in zip(squares, shapes.T, strict=True):
        omega = np.sqrt(square)
        rate = np.zeros((4, 4))  # displacement, velocity, force, and how it changes
        rate[0, 1], rate[1], rate[2, 3] = 1, [-square, -2 * RATIO * omega, shape[0], 0], 1
        step, state = linalg.expm(rate / 60.0), np.zeros(2)
        for k, force in enumerate(record.values[:-1, 0]):
            slope = (record.values[k + 1, 0] - force) * 60.0
            state = (step @ [*state, force, slope])[:2]
            moved[k + 1] += shape[3] * state[0]
    assert record.values[:, 2] == pytest.approx(moved, abs=1e-10 * np.abs(moved).max())
    problem = output_error_problem(structure, made.started_at(1.1 * made.start), record, TimeOptions(force="first"))
    require_exact_slope_of(problem)


def require_exact_slope_of(problem):
    at, step = problem.linearize(problem.theta_start), 1e-5
    for j, unit in enumerate(np.eye(len(problem.theta_start))):
        sides = [problem.residual(problem.theta_start + sign * step * unit) for sign in (1, -1)]
        change = (sides[0] - sides[1]) / (2 * step)
        assert np.abs(at.jacobian[:, j] - change).max() < 1e-6 * np.abs(change).max()


def test_the_gradient_of_spectra_is_that_of_differences():
    structure = chain()
    made = sought(structure)
    problem = spectra_problem(structure, made, excited(structure, made, noise=0.05), band=(1, 15), straight=True)
    theta = problem.theta_start + 0.05 * np.random.default_rng(2).standard_normal(made.n_params)
    at, step = problem.linearize(theta), 1e-5
    gradient = 2 * at.jacobian.T @ at.residual
    sides = [[np.sum(problem.residual(theta + sign * step * e) ** 2) for sign in (1, -1)] for e in np.eye(len(theta))]
    difference = np.array([(ahead - behind) / (2 * step) for ahead, behind in sides])
    np.testing.assert_allclose(gradient, difference, atol=1e-6 * np.abs(gradient).max())


def test_damping_ratios_of_modes_are_the_parameter():
    structure = chain()
    made = sought(structure)
    record = measured(structure, made.values(made.start), ["1X", "2X", "4X"], 3, np.random.default_rng(0))
    problem = ModalProblem(structure, made, record, ModalSettings(use_damping=True))
    require_exact_slope(problem, problem.theta_start + 0.1 * np.random.default_rng(1).standard_normal(made.n_params))
    found = estimate(
        ModalProblem(structure, made.started_at(1.3 * made.start), record, ModalSettings(use_damping=True))
    )
    assert found.values[-1] == pytest.approx(RATIO, rel=1e-6)  # measured without noise, and the same in all modes


@pytest.mark.parametrize("kind", ["frf", "output error", "spectra"])
def test_a_ratio_far_off_is_found(kind):
    structure = chain()
    made = sought(structure)
    off = made.started_at(made.start * [1, 1.1, 0.9, 1.05, 1, 3])
    if kind == "frf":
        frequency = np.linspace(0.5, 20, 80)
        blank = FrfRecord(frequency, np.ones((80, 2, 1)), ["1X", "3X"], ["1X"], "accelerance")
        record = simulated_record(structure, made, blank, 1e-6, np.random.default_rng(0))
        found = estimate(FrfProblem(structure, off, record))
    elif kind == "spectra":
        found = estimate(spectra_problem(structure, off, excited(structure, made), band=(1, 15), straight=True))
    else:
        found = identify_time(structure, off, excited(structure, made), TimeOptions(force="first"))
    assert found.values == pytest.approx(made.start, rel=5e-3 if kind == "spectra" else 1e-6)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """60 records of seeds 0 to 59, six parameters each; binomial limits widened for what is correlated in a record."""
    structure = chain(ratio=0.06)
    made = sought(structure)
    frequency = np.linspace(1, 16, 60)
    blank = FrfRecord(frequency, np.ones((60, 2, 1)), ["1X", "3X"], ["1X"], "accelerance")
    inside, scores = [], []
    for seed in range(60):
        record = simulated_record(structure, made, blank, 0.05, rng=np.random.default_rng(seed))
        found = estimate(FrfProblem(structure, made, record))
        score = (found.values - made.start) / found.std
        scores.append(score)
        inside.append(np.abs(score) < 1.96)
    assert 0.91 < np.mean(inside) < 0.985
    assert np.std(np.array(scores)[:, -1]) == pytest.approx(1.0, abs=0.25)


def test_equations_that_are_linear_in_the_parameters_refuse_it():
    structure = chain()
    made = sought(structure)
    record = excited(structure, made)
    for method in ("weak", "instrumental"):
        with pytest.raises(InputError, match=r"modal damping .* is not linear in masses and stiffnesses"):
            identify_time(structure, made, record, TimeOptions(method=method))
