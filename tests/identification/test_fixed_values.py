"""Fixed values that are wrong by their tolerance: derivatives, intervals, verdicts and changes between two states.

Records are simulated by the matrices of this file, a chain of four masses on springs and dashpots.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import eigh

import structid as sid
from structid.core.dof import parse_dof, parse_dofs
from structid.diagnose.verdict import judged
from structid.fem.elements.matrix_group import MatrixGroup, ModelParameter, SolverFrfs, SolverModel
from structid.forward.fixed_values import append_fixed_factors, tolerances_of, with_fixed_values
from structid.identification.joint_problem import taken_as_exact, tolerances_clause
from structid.inversion.estimate import estimate
from structid.inversion.fixed_values import FIXED, tolerance_words
from structid.inversion.search.within_tolerances import FixedValues
from structid.modal import ModalRecord
from structid.modal.modal_record import independent_errors
from structid.prediction.identified_model import model_of
from structid.unknowns.tolerances import EXACT, Tolerances, fixed_properties

MASS, SPRING, DASHPOT = (2.0, 2.2, 2.4, 1.8), (4e4, 3.6e4, 3.2e4, 2.8e4), (9.0, 8.0, 7.0, 6.0)
N = len(MASS)
SENSORS, LOAD = ("1X", "3X", "4X"), "4X"
TOLERANCES = Tolerances(mass=0.01, stiffness=0.01, damping=0.1, calibration=0.01)
SOUGHT = [sid.Unknown("stiffness", "k1"), sid.Unknown("stiffness", "k3"), sid.Unknown("viscous_damping", "c1")]
STEEL = ModelParameter("E", "Pa", 2.1e11, 2.1e11)


def chain(mass=MASS, spring=SPRING, dashpot=DASHPOT) -> sid.Structure:
    parts: list = [sid.PointMass(f"m{i + 1}", [i + 1], mass=mass[i]) for i in range(N)]
    for i in range(N):
        below = f"{i}X" if i else None
        parts.append(sid.Spring(f"k{i + 1}", f"{i + 1}X", second=below, stiffness=spring[i]))
        parts.append(sid.Dashpot(f"c{i + 1}", f"{i + 1}X", second=below, viscous_damping=dashpot[i]))
    return sid.Structure({i + 1: float(i + 1) for i in range(N)}, parts, active=["X"])


def tridiagonal(values) -> np.ndarray:
    values = np.asarray(values)
    return np.diag(values + np.append(values[1:], 0.0)) - np.diag(values[1:], 1) - np.diag(values[1:], -1)


def accelerance(mass, spring, dashpot, frequency) -> np.ndarray:
    s = 2j * np.pi * frequency[:, None, None]
    z = s**2 * np.diag(mass) + s * tridiagonal(dashpot) + tridiagonal(spring)
    return (s**2 * np.linalg.inv(z))[:, [0, 2, 3]][:, :, [3]]


def measured(values, gain: float, rng, noise=0.01, n_lines=120) -> sid.FrfRecord:
    frequency = np.linspace(3.0, 42.0, n_lines)
    clean = gain * accelerance(*values, frequency)
    sigma = noise * (np.abs(clean) + np.sqrt((np.abs(clean) ** 2).mean()))
    error = sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape)) / np.sqrt(2)
    return sid.FrfRecord(frequency, clean + error, SENSORS, [LOAD], "accelerance", variance=sigma**2)


def modes(spring=SPRING, noise=1e-3) -> ModalRecord:
    squares, shapes = eigh(tridiagonal(spring), np.diag(MASS))
    frequency, shapes = np.sqrt(squares) / (2 * np.pi), shapes[[0, 2, 3]] / np.abs(shapes[[0, 2, 3]]).max(axis=0)
    none = np.full(N, np.nan)
    errors = independent_errors(np.concatenate([noise * frequency, none]))
    dofs = sid.FrfRecord(np.ones(1), np.ones((1, 3, 1)), SENSORS, [LOAD], "accelerance").outputs
    return ModalRecord(frequency, none, shapes, dofs, errors, np.full(shapes.shape, 10 * noise))


def histories(n_steps=160, rate=160.0) -> sid.TimeRecord:
    """Noise with the channels of a test: derivatives do not ask where the record comes from."""
    rng = np.random.default_rng(5)
    kinds = ("force", *["acceleration"] * 3)
    return sid.TimeRecord(rate, rng.standard_normal((n_steps, 4)), (LOAD, *SENSORS), kinds, variance=np.full(4, 1e-2))


def setups(rng):
    structure, record = chain(), measured((MASS, SPRING, DASHPOT), 1.0, rng)
    unknown = sid.parameters(structure, SOUGHT)
    return {
        "output": sid.Setup(structure, unknown, record),
        "log": sid.Setup(structure, unknown, record, [sid.ChannelUnknown("gain", "1X")]),
        "spectra": sid.TimeSetup(structure, unknown, histories()),
        "modes": sid.ModalSetup(structure, sid.parameters(structure, SOUGHT[:2]), modes()),
    }


@pytest.mark.parametrize("kind", ["output", "log", "spectra", "modes"])
def test_columns_of_held_values_are_those_of_differences(kind):
    setup = setups(np.random.default_rng(0))[kind]
    options = sid.IdentifyOptions(residual="log") if kind == "log" else sid.IdentifyOptions()
    problem = with_fixed_values(setup.prepared(options).problem, TOLERANCES, record="test")
    held = [i for i, name in enumerate(problem.names) if name.startswith(FIXED)]
    assert len(held) == {"output": 10, "log": 10, "spectra": 10, "modes": 10}[kind]
    theta = problem.theta_start + 0.01 * np.random.default_rng(1).standard_normal(len(problem.names))
    jacobian, step = problem.linearize(theta).jacobian[: problem.n_data], 1e-6
    plain = 1.0
    if kind == "spectra":  # whose Jacobian gives the exact gradient, not each entry: variable projection after Kaufman
        residual = problem.residual(theta)[: problem.n_data]
        jacobian, plain = (residual @ jacobian)[None], residual
    for i in held:
        ends = [problem.residual(theta + sign * step * np.eye(len(theta))[i])[: problem.n_data] for sign in (1, -1)]
        change = (ends[0] - ends[1]) / (2 * step)
        change = np.atleast_1d(plain @ change) if kind == "spectra" else change
        assert np.linalg.norm(jacobian[:, i] - change) <= 1e-5 * np.linalg.norm(change) + 1e-7


def test_the_answer_follows_a_held_value_as_it_is_told():
    record = measured((MASS, SPRING, DASHPOT), 1.0, np.random.default_rng(2), noise=1e-4)
    options = sid.IdentifyOptions(tolerances=TOLERANCES)
    found, heavier = (
        sid.identify(structure, sid.parameters(structure, SOUGHT), record, options).estimate
        for structure in (chain(), chain(mass=(MASS[0], MASS[1] * 1.00003, *MASS[2:])))
    )
    column = found.fixed.names.index("mass[m2]")
    assert heavier.values - found.values == pytest.approx(3e-5 * found.fixed.slope[:, column], rel=0.02)
    changes = found.fixed.changes
    assert changes[:, :-1].tolist() == (found.fixed.slope * found.fixed.tolerance).tolist()
    assert found.covariance == pytest.approx(found.spread.of_data.matrix + changes @ changes.T)
    assert found.spread.covariance_noise == pytest.approx(found.spread.of_data.matrix)
    low, high = found.interval().T
    assert np.log(high / low) == pytest.approx(
        2 * 1.95996 * np.sqrt(np.diag(found.covariance)) / found.values, rel=1e-4
    )


def test_an_identified_model_has_the_covariance_of_its_answer_with_what_is_of_second_order():
    (values, gain) = drawn(np.random.default_rng(0), 0.02)
    structure, record = chain(), measured(values, gain, np.random.default_rng(1))
    found = sid.identify(
        structure, sid.parameters(structure, SOUGHT), record, sid.IdentifyOptions(tolerances=TOLERANCES)
    )
    estimate, model = found.estimate, model_of(found)
    assert (estimate.fixed.second_order != 0).all()
    slope = model.parameters.slope(model.parameters.transforms.free(model.physical))
    factor = model.factor * slope[:, None]
    n = len(estimate.names)
    np.testing.assert_allclose((factor @ factor.T)[:n, :n], estimate.covariance, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(factor[n:], axis=1), estimate.fixed.tolerance[:-1], rtol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_a_matrix_free_search_carries_them_as_one_with_a_jacobian(size):
    """With `size` tolerances of error in every fixed value, which must not count as model error."""
    values, gain = drawn(np.random.default_rng(0), 0.01 * size)
    structure, record = chain(), measured(values, gain, np.random.default_rng(1))
    dense, free = (
        sid.identify(
            structure,
            sid.parameters(structure, SOUGHT),
            record,
            sid.IdentifyOptions(tolerances=TOLERANCES, matrix_free=is_free),
        ).estimate
        for is_free in (False, True)
    )
    assert not free.uncertainty.has_matrix
    assert free.covariance_basis == dense.covariance_basis == "noise"
    np.testing.assert_allclose(
        free.fixed.slope, dense.fixed.slope, rtol=2e-3, atol=2e-3 * np.abs(dense.fixed.slope).max()
    )
    if size:  # fixed values are fitted only where the misfit asks for it, by a matrix-free search later than by another
        np.testing.assert_allclose(free.fixed.asked, dense.fixed.asked, atol=0.02)
    tolerances_alone = np.linalg.norm(free.fixed.changes, axis=1)
    np.testing.assert_allclose(free.std, np.hypot(free.std_noise, tolerances_alone), rtol=1e-9)
    np.testing.assert_allclose(free.uncertainty.draws.std(axis=0), free.std, rtol=0.4)
    both = np.array([[1.0, -1.0, 0.0]])
    drawn_std, true_std = (np.sqrt(found.uncertainty.variance(both)) for found in (free, dense))
    np.testing.assert_allclose(drawn_std, true_std, rtol=0.3)


def test_products_without_a_jacobian_have_the_errors_of_channels():
    setup = setups(np.random.default_rng(0))["log"]
    unknowns = [sid.ChannelUnknown("gain", "1X"), sid.ChannelUnknown("delay", "3X")]
    for residual in ("output", "log", "pole_free"):
        problem = replace(setup, channel_unknowns=unknowns).prepared(sid.IdentifyOptions(residual=residual)).problem
        theta = problem.theta_start + 0.01 * np.random.default_rng(1).standard_normal(len(problem.names))
        dense = problem.linearize(theta)
        u, v = (np.random.default_rng(2).standard_normal(n) for n in dense.jacobian.shape)
        for stored in (0.0, 1e9):
            at = problem.linearize_operator(theta, stored)
            np.testing.assert_allclose(at.residual, dense.residual, rtol=1e-9)
            np.testing.assert_allclose(at.product(v), dense.jacobian @ v, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(at.transposed(u), dense.jacobian.T @ u, rtol=1e-8, atol=1e-6)
            np.testing.assert_allclose(at.squares, (dense.jacobian**2).sum(axis=0), rtol=1e-9)


def test_what_is_exact_widens_nothing():
    structure, record = chain(), measured((MASS, SPRING, DASHPOT), 1.0, np.random.default_rng(3))
    found = sid.identify(structure, sid.parameters(structure, SOUGHT), record, sid.IdentifyOptions(tolerances=EXACT))
    assert found.estimate.fixed is None
    assert found.freed == ()
    assert found.estimate.std.tolist() == found.estimate.std_noise.tolist()
    assert found.assumption == "± takes what the model holds as exact"


def drawn(rng, size: float):
    """Truth about what the model holds, with the unknowns 10 % off, and the gain of the record."""
    mass = np.array(MASS) * (1 + size * rng.standard_normal(N))
    spring = np.array(SPRING) * (1 + size * rng.standard_normal(N))
    dashpot = np.array(DASHPOT) * np.exp(0.1 * rng.standard_normal(N))
    spring[[0, 2]] = SPRING[0] * rng.uniform(0.9, 1.1), SPRING[2] * rng.uniform(0.9, 1.1)
    dashpot[0] = DASHPOT[0] * rng.uniform(0.9, 1.1)
    return (mass, spring, dashpot), 1 + size * rng.standard_normal()


def test_right_models_are_right_and_intervals_hold_where_held_values_are_wrong_by_their_tolerance():
    """12 repeats of two states, seeds 0 on: the second state has its third spring 5 % lower."""
    structure, options = chain(), sid.IdentifyOptions(tolerances=TOLERANCES)
    unknown = sid.parameters(structure, SOUGHT)
    held, of_noise, wrong, inside, declared, beyond = [], [], 0, [], 0, []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        values, gain = drawn(rng, 0.01)
        later = values[0], values[1] * np.array([1.0, 1.0, 0.95, 1.0]), values[2]
        states = [
            sid.identify(structure, unknown, measured(own, gain, rng, n_lines=80), options) for own in (values, later)
        ]
        truths = [np.array([own[1][0], own[1][2], own[2][0]]) for own in (values, later)]
        for found, truth in zip(states, truths, strict=True):
            low, high = found.estimate.interval().T
            held.append((low <= truth) & (truth <= high))
            of_noise.append(np.abs(found.estimate.values - truth) < 1.96 * found.estimate.std_noise)
            wrong += judged(found).verdict not in ("sound",)
            beyond.append(found.estimate.chi_square_per_dof)
        compared = sid.compare_states(states[0].estimate, states[1].estimate)
        error = np.abs(compared.change - (truths[1] - truths[0]))
        inside.append(error <= 1.96 * compared.std)
        declared += int(compared.changed[[0, 2]].any())
        assert compared.changed[1]
    assert np.median(beyond) > 2.0  # noise alone explains none of them
    assert wrong == 0
    assert 0.88 <= np.mean(held) <= 1.0
    assert np.mean(of_noise) < 0.6
    assert np.mean(inside) >= 0.85
    assert declared <= 2


def test_a_held_value_far_beyond_its_tolerance_is_a_misfit():
    structure = chain()
    record = measured(((2.0, 2.2 * 1.15, 2.4, 1.8), SPRING, DASHPOT), 1.0, np.random.default_rng(4))
    found = sid.identify(
        structure, sid.parameters(structure, SOUGHT), record, sid.IdentifyOptions(tolerances=TOLERANCES)
    )
    fixed = found.estimate.fixed
    assert fixed.asked[fixed.names.index("mass[m2]")] > 6
    assert found.estimate.covariance_basis == "model_error"
    judgement = judged(found)
    assert judgement.verdict != "sound"
    loose = replace(TOLERANCES, mass=0.15)
    found = sid.identify(structure, sid.parameters(structure, SOUGHT), record, sid.IdentifyOptions(tolerances=loose))
    assert judged(found).verdict == "sound"


def test_a_held_value_beyond_its_tolerance_widens_by_what_it_explains():
    """The second mass 30 % heavier than it is held: its error is what the data ask for, as it explains the misfit."""
    record = measured(((2.0, 2.2 * 1.3, 2.4, 1.8), SPRING, DASHPOT), 1.0, np.random.default_rng(4))
    options = sid.IdentifyOptions(tolerances=TOLERANCES)
    estimate = sid.identify(chain(), sid.parameters(chain(), SOUGHT), record, options).estimate
    fixed = estimate.fixed
    column = fixed.names.index("mass[m2]")
    data, left = estimate.goodness.chi_square, estimate.goodness.least_chi_square
    explained = (data - left) / (data - (estimate.goodness.n_data - len(SOUGHT)))
    assert 0.5 < explained < 1
    assert fixed.error[column] == pytest.approx(0.01 * explained * abs(fixed.asked[column]), rel=1e-6)
    assert f"(mass[m2]: {100 * fixed.error[column]:.3g} %" in fixed.words
    assert fixed.words.endswith(", as the data ask)")
    near = [i for i in range(len(fixed.names)) if i not in fixed.beyond]
    assert fixed.error[near].tolist() == fixed.tolerance[near].tolist()
    low, high = estimate.interval().T
    truth = np.array([SPRING[0], SPRING[2], DASHPOT[0]])
    assert ((low < truth) & (truth < high))[:2].all()


def test_a_value_that_is_widened_in_one_state_is_as_wide_in_the_other():
    """The second mass is 6 % heavier than it is held; less noise in one state shows that, and the mass is one and the same."""
    values = (MASS[0], 1.06 * MASS[1], *MASS[2:]), SPRING, DASHPOT
    estimates = []
    for seed, noise in ((1, 0.003), (2, 0.02)):
        record = measured(values, 1.0, np.random.default_rng(seed), noise=noise)
        options = sid.IdentifyOptions(tolerances=TOLERANCES)
        estimates.append(sid.identify(chain(), sid.parameters(chain(), SOUGHT), record, options).estimate)
    first, second = (one.fixed for one in estimates)
    column = first.names.index("mass[m2]")
    assert first.error[column] > 1.1 * second.error[column]
    wider = np.maximum(first.error, second.error)
    by_fixed = first.slope * wider - second.slope * wider
    orders = first.second_order - second.second_order
    covariance = sum(one.covariance_of_data for one in estimates) + by_fixed @ by_fixed.T + np.outer(orders, orders)
    assert sid.compare_states(*estimates).covariance == pytest.approx(covariance, rel=1e-9)


def test_fixed_values_that_are_left_out_leave_a_linear_influence():
    record = measured((np.array(MASS) * [1.0, 1.25, 1.0, 1.0], SPRING, DASHPOT), 1.0, np.random.default_rng(8))
    problem = sid.Setup(chain(), sid.parameters(chain(), SOUGHT), record).prepared(sid.IdentifyOptions()).problem
    freed = with_fixed_values(problem, TOLERANCES, record="test")
    fixed = FixedValues(freed, tolerances_of([freed]))
    answer = estimate(problem)
    columns = fixed.sensitivities_at(problem.names, answer.theta, fixed.refit(problem.names, answer.theta, 1e4))
    kept = [i for i, name in enumerate(columns.names) if name != "mass[m2]"]
    point = answer.theta, problem.linearize(answer.theta), problem.slope(answer.theta)
    whole, part = (columns.only(some).influence(*point) for some in (range(len(columns.names)), kept))
    assert whole.second_order.all()
    assert part.second_order.tolist() == [0.0] * len(SOUGHT)
    assert part.slope == pytest.approx(whole.slope[:, kept], rel=1e-9)


def test_a_search_on_a_sample_tests_the_residual_of_all_data():
    """A mass 0.75 % too heavy: the answer on a third of the lines is within three deviations of that on all of them."""
    values = (MASS[0], 1.0075 * MASS[1], *MASS[2:]), SPRING, DASHPOT
    record = measured(values, 1.0, np.random.default_rng(4), n_lines=360)
    structure = chain()
    setup = sid.Setup(structure, sid.parameters(structure, SOUGHT), record)
    problem = setup.prepared(sid.IdentifyOptions()).problem
    freed, lines = with_fixed_values(problem, TOLERANCES, record="test"), np.arange(0, 360, 3)
    fixed = FixedValues(freed, tolerances_of([freed]), freed.with_lines(lines))
    on_sample = estimate(problem, sample=problem.with_lines(lines), fixed=fixed).goodness
    on_all = estimate(problem, fixed=fixed).goodness
    assert on_sample.least_chi_square == pytest.approx(on_all.least_chi_square, rel=1e-3)
    assert on_sample.least_chi_square == pytest.approx(on_all.n_data, rel=0.1)


def test_records_share_what_is_held_and_have_a_calibration_each():
    structure = chain()
    unknown = sid.parameters(structure, SOUGHT)
    records = [measured((MASS, SPRING, DASHPOT), 1.0, np.random.default_rng(seed)) for seed in (5, 6)]
    pair = [sid.Setup(structure, unknown, record, calibration=0.02 * k) for k, record in enumerate(records)]
    found = sid.identify_together(
        [*pair, sid.ModalSetup(structure, unknown, modes())], sid.IdentifyOptions(tolerances=TOLERANCES)
    )
    fixed = found.estimate.fixed
    assert [name for name in fixed.names if name.startswith("cal")] == ["calibration[record 2]"]
    assert fixed.names.count("mass[m1]") == 1
    assert fixed.tolerance[fixed.names.index("calibration[record 2]")] == 0.02
    assert (
        found.assumption
        == "± includes 1 % of fixed masses and stiffnesses, 10 % of fixed dampings, 2 % of the calibration"
    )


def test_values_that_a_method_does_not_carry_are_named():
    """Fits that are linear in time leave the thickness of a plate out: whatever is not carried is named once."""
    structure = chain()
    unknown = sid.parameters(structure, SOUGHT)
    record = measured((MASS, SPRING, DASHPOT), 1.0, np.random.default_rng(5))
    found = sid.identify_together([sid.Setup(structure, unknown, record)], sid.IdentifyOptions(tolerances=TOLERANCES))
    names = found.estimate.fixed.names
    left_out = tuple(name for name in names if name not in ("mass[m2]", "stiffness[k4]"))
    twice = found.problems * 2
    assert taken_as_exact(twice, TOLERANCES, names) == taken_as_exact(twice, EXACT, left_out) == ""
    assert taken_as_exact(twice, TOLERANCES, left_out) == (
        "fixed mass[m2], stiffness[k4] taken as exact, without the tolerance"
    )
    index = [names.index(name) for name in left_out]
    fixed = found.estimate.fixed
    part = replace(
        fixed,
        names=left_out,
        kinds=tuple(fixed.kinds[i] for i in index),
        tolerance=fixed.tolerance[index],
        slope=fixed.slope[:, index],
    )
    assert tolerances_clause(fixed, twice, TOLERANCES) == f"± includes {fixed.words}" == found.assumption
    assert tolerances_clause(part, twice, None) == f"± includes {part.words}"
    assert tolerances_clause(part, twice, TOLERANCES) == (
        f"± includes {part.words}; fixed mass[m2], stiffness[k4] taken as exact, without the tolerance"
    )


def test_a_set_and_a_property_state_tolerances_of_their_own():
    stated = [replace(one, tolerance={"mass": 0.05}) if one.name == "m1" else one for one in chain().elements]
    stated = [replace(one, tolerance=0.0) if one.name == "k2" else one for one in stated]
    structure = replace(chain(), elements=tuple(stated))
    held = fixed_properties(structure, sid.parameters(structure, SOUGHT), Tolerances())
    known = {one.label: one.tolerance for one in held}
    assert known == {
        "mass[m1]": 0.05, "mass[m2]": 0.01, "mass[m3]": 0.01, "mass[m4]": 0.01, "stiffness[k4]": 0.01,
        "viscous_damping[c2]": 0.3, "viscous_damping[c3]": 0.3, "viscous_damping[c4]": 0.3,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("mass", "labels"),
    [
        ([1.0, 2.0, 1.0], {"mass[m]": [0, 2]}),
        ([1.0, 2.0, 3.0], {"mass[m]": [0, 2], "mass[m:1]": [0], "mass[m:3]": [2]}),
    ],
)
def test_elements_of_a_set_that_are_not_sought_are_held_together_and_different_ones_each_besides(mass, labels):
    masses = sid.PointMass("m", [1, 2, 3], mass=mass)
    ground = sid.Spring("k", ["1X", "2X", "3X"], stiffness=5.0)
    structure = sid.Structure({1: 0.0, 2: 1.0, 3: 2.0}, [masses, ground], active=["X"])
    unknown = sid.parameters(structure, [sid.Unknown("mass", "m:2"), sid.Unknown("stiffness", "k")])
    held = fixed_properties(structure, unknown, Tolerances())
    assert {item.label: item.indices.tolist() for item in held} == labels
    freed = append_fixed_factors(unknown, held)
    assert freed.values(freed.start).tolist() == unknown.values(unknown.start).tolist()


def test_different_values_of_a_set_are_known_as_if_they_erred_together_or_each_alone_whichever_is_worse():
    structure = weighed_chain()
    held = [
        item
        for item in fixed_properties(structure, sid.parameters(structure, SOUGHT), Tolerances(mass=0.02))
        if item.kind == "mass"
    ]
    masses = np.zeros((len(structure.values), len(held)))
    for column, item in enumerate(held):
        masses[item.indices, column] = item.tolerance
    rows = masses[masses.any(axis=1)]
    covariance = rows @ rows.T
    together, alone = np.full((N, N), 0.02**2), 0.02**2 * np.eye(N)
    for case in (together, alone):
        assert np.linalg.eigvalsh(covariance - case).min() > -1e-15
    assert np.ones(N) @ covariance @ np.ones(N) == pytest.approx(np.ones(N) @ together @ np.ones(N))
    difference = np.array([1.0, -1.0, 0.0, 0.0])
    assert difference @ covariance @ difference == pytest.approx(difference @ alone @ difference)
    words = tolerance_words(*zip(*((item.label, item.kind, item.tolerance) for item in held), strict=True))
    assert words == "2 % of fixed masses"


def weighed_chain() -> sid.Structure:
    """The chain with its masses in one set."""
    others = [part for part in chain().elements if not isinstance(part, sid.PointMass)]
    return replace(chain(), elements=(sid.PointMass("m", list(range(1, N + 1)), mass=list(MASS)), *others))


def test_masses_of_one_set_that_err_in_opposite_senses_leave_the_model_right():
    errors = np.exp([0.012, -0.012, 0.0, 0.0])
    record = measured((MASS * errors, SPRING, DASHPOT), 1.0, np.random.default_rng(3))
    structure, sought = weighed_chain(), [*(sid.Unknown("stiffness", f"k{i + 1}") for i in range(N)), SOUGHT[2]]
    answer = sid.identify(structure, sid.parameters(structure, sought), record)
    assert judged(answer).verdict == "sound"
    low, high = answer.estimate.interval()[:N].T
    assert ((low < SPRING) & (high > SPRING)).all()


@pytest.mark.parametrize(
    ("tolerance", "words"),
    [
        (-0.01, r"`tolerance` of 'm1' must be at least 0 and at most 1, got -0.01; 0.01 is 1 %"),
        ({"mass": 1.5}, "`tolerance` of 'm1' of mass must be at least 0 and at most 1, got 1.5"),
        ({"stiffness": 0.1}, "`tolerance` of 'm1' must name its properties, got 'stiffness'; they are mass"),
    ],
)
def test_bad_tolerances_are_named(tolerance, words):
    with pytest.raises(sid.InputError, match=words):
        sid.PointMass("m1", [1], mass=1.0, tolerance=tolerance)


def _frf_table(**more):
    return SolverFrfs("beam", table=SimpleNamespace(outputs=(parse_dof("1X"),), inputs=()), **more)


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (partial(MatrixGroup, "skin", dofs=["1X"], stiffness=[[5.0]]), "stiffness, loss_factor"),
        (
            partial(SolverModel, "shell", dofs=parse_dofs(["1X"]), parts=(), parameters=(STEEL,)),
            "mass, damping, stiffness, E, loss_factor",
        ),
        (partial(_frf_table, parameters=(STEEL,)), "E"),
    ],
)
def test_sets_whose_properties_come_with_their_matrices_take_tolerances_of_these_alone(make, names):
    for name in names.split(", "):
        assert make(tolerance={name: 0.02}).tolerance == {name: 0.02}
    with pytest.raises(sid.InputError, match=f"must name its properties, got 'thicknes'; they are {names}$"):
        make(tolerance={"thicknes": 0.02})


def test_a_tolerance_of_an_unknown_is_refused():
    parts = [replace(one, tolerance=0.02) if one.name == "k1" else one for one in chain().elements]
    structure = replace(chain(), elements=tuple(parts))
    with pytest.raises(
        sid.InputError, match=r"`tolerance` of 'k1' is of stiffness, which is an unknown; .* the `prior`"
    ):
        sid.parameters(structure, SOUGHT)


def test_as_many_values_as_parameters_test_nothing():
    structure = chain()
    alone = replace(modes(), mode_shapes=np.full((3, N), np.nan), shape_std=None)
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", f"k{i}") for i in (1, 2, 3, 4)])
    setup = sid.ModalSetup(structure, unknown, alone)
    assert judged(sid.identify_together([setup])).verdict == "undetermined"  # other springs have the same frequencies
    found = sid.identify_together([setup], sid.IdentifyOptions(wide_starts=0))
    judgement = judged(found)
    assert judgement.verdict == "untested"
    assert judgement.words.startswith("Untested: the data are 4 values for 4 parameters, and a wrong model fits")
    assert found.estimate.goodness.misfit_words == "no degree of freedom is left to test the model"


def test_what_priors_know_is_told_from_what_the_data_say():
    structure = chain()
    known = sid.Unknown("stiffness", "k4", prior=sid.Prior(SPRING[3], 0.002 * SPRING[3]))
    rng, exact = np.random.default_rng(7), modes()
    one = replace(
        exact,
        frequency=exact.frequency * (1 + 1e-3 * rng.standard_normal(N)),
        mode_shapes=exact.mode_shapes + 1e-2 * rng.standard_normal((3, N)),
    )
    found = sid.identify_together([sid.ModalSetup(structure, sid.parameters(structure, [*SOUGHT[:2], known]), one)])
    judgement = judged(found)
    assert found.priors.variance_fraction[2] > 0.5 > found.priors.variance_fraction[:2].max()
    assert judgement.verdict == "approximate"
    assert "priors, not the data, determine stiffness[k4]:" in judgement.words


def test_combinations_that_priors_alone_determine_are_told_from_what_the_data_say():
    """Two frequencies of four springs whose priors are alike: the data determine two combinations, and priors all four values."""
    structure, exact = chain(), modes()
    unknown = [sid.Unknown("stiffness", f"k{i + 1}", prior=sid.Prior(SPRING[i], 0.05 * SPRING[i])) for i in range(4)]
    two = exact.some_modes([0, 1])
    frequency = two.frequency + [1.0, -1.0] * two.std[:2]
    alone = replace(two, frequency=frequency, mode_shapes=np.full((3, 2), np.nan), shape_std=None)
    found = sid.identify_together([sid.ModalSetup(structure, sid.parameters(structure, unknown), alone)])
    assert found.estimate.identifiability.rank == 2
    judgement = judged(found)
    assert judgement.verdict == "untested"
    assert "priors, not the data, determine" in judgement.words
    assert "(the data determine 2 of 4 combinations)" in judgement.words


def test_profiles_have_the_tolerances_added():
    structure, record = chain(), measured((MASS, SPRING, DASHPOT), 1.0, np.random.default_rng(3), n_lines=40)
    unknown = sid.parameters(structure, SOUGHT[:2])
    profiled, exact, laplace = (
        sid.identify(structure, unknown, record, sid.IdentifyOptions(intervals=kind, tolerances=tolerances))
        for kind, tolerances in (("profile", TOLERANCES), ("profile", EXACT), ("laplace", TOLERANCES))
    )
    assert profiled.intervals.ends == pytest.approx(laplace.intervals.ends, rel=1e-3)
    assert np.ptp(profiled.intervals.ends, axis=1).min() > 5 * np.ptp(exact.intervals.ends, axis=1).max()


def test_squares_of_held_values_are_a_part_of_what_the_residual_is_tested_by():
    """Without them a fit within tolerances looks better than noise, and the answer was held to miss the resonances."""
    squares, shapes = eigh(tridiagonal(SPRING), np.diag(np.array(MASS) * [1.02, 0.97, 1.0, 1.03]))
    shapes = shapes[[0, 2, 3]] / np.abs(shapes[[0, 2, 3]]).max(axis=0)
    record = replace(modes(noise=1e-3), frequency=np.sqrt(squares) / (2 * np.pi), mode_shapes=shapes)
    setup = sid.ModalSetup(chain(), sid.parameters(chain(), SOUGHT[:2]), record)
    found = sid.identify_together([setup], sid.IdentifyOptions(tolerances=TOLERANCES))
    goodness = found.estimate.goodness
    assert goodness.residual_tests.chi_square_per_dof == pytest.approx(goodness.least_per_dof)
    assert goodness.chi_square_per_dof > 2 * goodness.least_per_dof
    assert judged(found).verdict == "sound"


def few_modes(n_modes: int, prior_std: float | None) -> sid.ModalSetup:
    """Frequencies alone of the first modes, with all four springs unknown and, where it is stated, a prior of the first."""
    alone = replace(
        modes(), frequency=modes().frequency[:n_modes], damping_ratio=np.full(n_modes, np.nan),
        mode_shapes=np.full((3, n_modes), np.nan), shape_std=None,
        covariance=independent_errors(np.concatenate([1e-3 * modes().frequency[:n_modes], np.full(n_modes, np.nan)])),
    )  # fmt: skip
    prior = None if prior_std is None else sid.Prior(SPRING[0], prior_std * SPRING[0])
    sought = [sid.Unknown("stiffness", f"k{i}", prior=prior if i == 1 else None) for i in range(1, N + 1)]
    return sid.ModalSetup(chain(), sid.parameters(chain(), sought), alone)


@pytest.mark.long
def test_where_priors_choose_among_sets_of_values_the_answer_is_untested_and_all_are_listed():
    free, chosen = (sid.identify_together([few_modes(N, std)]) for std in (None, 0.02))
    assert judged(free).verdict == "undetermined"
    judgement = judged(chosen)
    assert judgement.verdict == "untested"
    assert "of which priors choose the first" in judgement.words
    assert chosen.alternatives.values[0] == pytest.approx(SPRING, rel=0.01)
    rest, listed = (np.sort(one.alternatives.values[:, 0]) for one in (free, chosen))
    assert listed == pytest.approx(rest, rel=0.02)  # those that priors rule out as well


@pytest.mark.long
def test_three_frequencies_and_a_prior_test_nothing_of_four_springs():
    judgement = judged(sid.identify_together([few_modes(3, 0.1)]))
    assert judgement.verdict in ("untested", "undetermined")


def test_a_prior_counts_as_data_by_what_it_determines():
    """Four frequencies of four springs: a spring that its prior knows leaves one value more than is sought."""
    goodness = sid.identify_together([few_modes(N, 1e-4)]).estimate.goodness
    assert goodness.n_values == N
    assert goodness.test_freedom == pytest.approx(
        1.0, abs=0.02
    )  # all but known: the data test three springs by four values


@pytest.mark.long
def test_a_prior_that_says_nothing_counts_for_nothing():
    assert sid.identify_together([few_modes(N, 10.0)]).estimate.goodness.test_freedom < 0.05


def test_a_second_order_effect_is_that_of_tolerances_and_not_of_other_errors():
    """A mass that is 25 % too light asks for held values far beyond their tolerances: their way is no effect of these.

    The model that has the held values a likely part of that way off has the parameters that slope and second order say.
    """
    heavy = (np.array(MASS) * [1.0, 1.25, 1.0, 1.0], SPRING, DASHPOT)
    record = measured(heavy, 1.0, np.random.default_rng(8))
    options = sid.IdentifyOptions(tolerances=TOLERANCES)
    estimate = sid.identify(chain(), sid.parameters(chain(), SOUGHT), record, options).estimate
    fixed = estimate.fixed
    way = float(np.sqrt(fixed.asked @ fixed.asked / len(fixed.asked)))
    assert way > 2
    factor = dict(zip(fixed.names, np.exp(fixed.asked / way * fixed.tolerance), strict=True))
    parts = [("mass[m", MASS), ("stiffness[k", SPRING), ("viscous_damping[c", DASHPOT)]
    moved = chain(*([v * factor.get(f"{name}{i}]", 1.0) for i, v in enumerate(held, 1)] for name, held in parts))
    gain = factor["calibration[record 1]"]
    weaker = replace(record, values=record.values / gain, variance=record.variance / gain**2)
    followed = sid.identify(
        moved, sid.parameters(moved, SOUGHT), weaker, sid.IdentifyOptions(tolerances=EXACT)
    ).estimate
    first = fixed.slope @ (fixed.asked / way * fixed.tolerance)
    left = estimate.values * np.log(estimate.values / followed.values) + first
    assert (np.abs(fixed.second_order - left) < estimate.std_noise).all()
    assert (np.abs(left[1:]) > 4 * estimate.std_noise[1:]).all()
