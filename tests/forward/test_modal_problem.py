"""Parameters from modes: derivatives against differences, close and crossing modes, uncertainty, ratios, joint fits."""

from dataclasses import replace

import numpy as np
import pytest
from modal_problem_cases import gains, gradient_errors, require_exact_slope

from structid import (
    Beam,
    ChannelUnknown,
    Constraint,
    Dashpot,
    FrfRecord,
    InputError,
    ModalRecord,
    PointMass,
    Prior,
    Spring,
    Status,
    Structure,
    Unknown,
    estimate,
    parameters,
    simulated_record,
)
from structid.dynamics.normal_modes import modes
from structid.forward import FrfProblem, ModalProblem, ModalSettings
from structid.forward.modal.measured import GroupData
from structid.forward.modal.output import _frequencies_of_group, pairing
from structid.forward.modal.problem import influence_by_kind, of_form, shape_residual
from structid.inversion import JointProblem
from structid.modal.modal_record import ModalChanges


def chain(n=5):
    """Masses in a row, grounded at one end."""
    nodes = {i: float(i) for i in range(n + 1)}
    here, back = [f"{i}X" for i in range(1, n + 1)], [f"{i}X" for i in range(n)]
    elements = [
        PointMass("m", list(range(1, n + 1)), 2.0),
        Spring("k", here, back, stiffness=1000.0, loss_factor=0.01),
        Dashpot("c", here, back, viscous_damping=0.7),
    ]
    return Structure(nodes, elements, fixed=["0X"], active=["X"])


def tower(ratio=1.0):
    """Two floors that sway along x and y on columns of stiffness 1 and `ratio`: pairs of equal modes for 1."""
    nodes = {i: (0.0, 0.0, float(i)) for i in range(3)}
    first, second = ["1X", "2X", "1Y", "2Y"], ["0X", "1X", "0Y", "1Y"]
    elements = [
        PointMass("m", [1, 2], 3.0),
        Spring("k", first, second, stiffness=[800.0, 700.0, 800.0 * ratio, 700.0 * ratio]),
        Spring("link", "2X", "2Y", stiffness=0.5),
    ]
    return Structure(nodes, elements, fixed=["0X", "0Y"], active=["X", "Y"])


def beam(n=8):
    nodes = {i: 0.25 * i for i in range(n + 1)}
    elements = [Beam("beam", [[i, i + 1] for i in range(n)], mass=2.0, bending_stiffness=5.0)]
    return Structure(nodes, elements, fixed=["0Y", "0RZ"])


def measured(structure, values, channels, count, rng=None, frequency_error=1e-3, shape_error=1e-2):
    """The first modes of the model at `channels`, with noise where `rng` is given."""
    kinds = ("mass", "stiffness", "damping", "structural_damping")
    found = modes(*(structure.matrix(kind, values) for kind in kinds))
    from structid.core.dof import parse_dofs

    shapes = structure.selection(parse_dofs(channels)).T @ found.mode_shapes[:, :count]
    shapes = shapes / np.abs(shapes).max(axis=0)
    frequency, ratio = found.frequency[:count], found.damping_ratio[:count]
    std = frequency_error * frequency
    if rng is not None:
        frequency = frequency + std * rng.standard_normal(count)
        shapes = shapes + shape_error * rng.standard_normal(shapes.shape)
    covariance = np.diag(np.concatenate([std**2, (0.05 * ratio + 1e-5) ** 2]))
    order = np.argsort(frequency)
    both = np.concatenate([order, count + order])
    return ModalRecord(
        frequency[order],
        ratio[order],
        shapes[:, order],
        channels,
        covariance[np.ix_(both, both)],
        np.full(shapes.shape, shape_error),
    )


def stiffnesses(structure, element="k"):
    return parameters(structure, [Unknown("stiffness", element, each=True)])


@pytest.mark.parametrize("damping", [False, True])
def test_modal_jacobian_of_single_modes_agrees_with_differences(damping):
    structure = chain()
    unknown = parameters(
        structure,
        [
            Unknown("mass", "m", each=True),
            Unknown("stiffness", "k", each=True),
            Unknown("loss_factor", "k"),
            Unknown("viscous_damping", "c", prior=Prior(0.5, 0.2)),
        ],
    )
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X-", "5X"], 4, np.random.default_rng(0))
    problem = ModalProblem(structure, unknown, record, ModalSettings(use_damping=damping))
    theta = problem.theta_start + 0.1 * np.random.default_rng(1).standard_normal(12)
    assert problem.linearize(theta).jacobian.shape == (problem.n_data + 1, 12)
    require_exact_slope(problem, theta)


def test_slopes_of_weights_are_the_same_for_models_of_any_size(monkeypatch):
    """Full arrays for a few elements, sparse ones for many."""
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X-", "5X"], 4, np.random.default_rng(0))
    problem = ModalProblem(structure, unknown, record)
    jacobian = problem.linearize(problem.theta_start).jacobian
    monkeypatch.setattr("structid.forward.modal.model._SMALL", 0)
    again = ModalProblem(structure, unknown, record)
    assert again.linearize(again.theta_start).jacobian == pytest.approx(jacobian, rel=1e-12, abs=1e-12)


def test_modes_in_their_order_are_paired_by_it_whatever_their_shapes():
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X-", "5X"], 4)
    shuffled = replace(record, mode_shapes=record.mode_shapes[:, [1, 0, 3, 2]])
    by_shape, by_order = (ModalProblem(structure, unknown, shuffled, in_order=flag) for flag in (False, True))
    state = by_shape.model.state(unknown.start)
    assert pairing(by_shape.data, state, False).tolist() == [1, 0, 3, 2]
    assert pairing(by_order.data, state, True).tolist() == [0, 1, 2, 3]
    require_exact_slope(
        by_order, by_order.theta_start + 0.1 * np.random.default_rng(1).standard_normal(unknown.n_params)
    )


@pytest.mark.parametrize(("structure", "channels", "count"), [
    (chain(), ["1X", "3X-", "5X"], 3), (tower(1.001), ["1X", "2X", "1Y", "2Y"], 4),
])  # fmt: skip
@pytest.mark.parametrize("damping", [False, True])
def test_modal_jacobian_with_gains_of_sensors_agrees_with_differences(structure, channels, count, damping):
    unknown = parameters(structure, [Unknown("mass", "m", each=True), Unknown("stiffness", "k", each=True)])
    record = measured(structure, unknown.values(unknown.start), channels, count, np.random.default_rng(0))
    errors = gains(record, ChannelUnknown("gain", channels[1:], each=True))
    damping = damping and count == 3
    problem = ModalProblem(structure, unknown, record, ModalSettings(use_damping=damping), channels=errors)
    theta = problem.theta_start + 0.1 * np.random.default_rng(1).standard_normal(len(problem.theta_start))
    assert len(theta) == unknown.n_params + len(channels) - 1
    assert np.abs(problem.linearize(theta).jacobian[:, unknown.n_params :]).max(axis=0).min() > 0.1
    require_exact_slope(problem, theta)


def test_a_sensor_that_reads_too_much_in_modes_is_found_with_its_deviation():
    structure = chain()
    unknown = stiffnesses(structure)
    channels, off = [f"{i}X" for i in range(1, 6)], []
    for seed in range(60):
        record = measured(structure, unknown.values(unknown.start), channels, 4, np.random.default_rng(seed))
        reading = np.array([1.0, 1.0, 1.3, 1.0, 1.0])[:, None]
        record = replace(record, mode_shapes=reading * record.mode_shapes, shape_std=reading * record.shape_std)
        errors = gains(record, ChannelUnknown("gain", "3X"))
        found = estimate(ModalProblem(structure, unknown, record, channels=errors))
        assert found.names[-1] == "gain[3X+]"
        off.append((found.values[-1] - 1.3) / found.std[-1])
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.2)


def test_modal_problem_refuses_errors_of_channels_that_shapes_do_not_show():
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X"], 3)
    for wrong in ("delay", "polarity"):
        with pytest.raises(InputError, match="modes show gains of sensors only"):
            ModalProblem(structure, unknown, record, channels=gains(record, ChannelUnknown(wrong, "1X")))
    with pytest.raises(InputError, match="form 'dynamic' takes no errors of channels"):
        ModalProblem(
            structure,
            unknown,
            record,
            ModalSettings(form="dynamic"),
            channels=gains(record, ChannelUnknown("gain", "1X")),
        )


def test_modal_problem_says_where_its_settings_went():
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X"], 3)
    with pytest.raises(InputError, match=r"write settings=ModalSettings\(shape_error=0\.01\)"):
        ModalProblem(structure, unknown, record, shape_error=0.01)
    with pytest.raises(InputError, match=r"write settings=ModalSettings\(form"):
        ModalProblem(structure, unknown, record, "dynamic")


def test_modal_dynamic_slope_gives_the_gradient():
    structure = beam()
    unknown = parameters(structure, [Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")])
    record = measured(structure, unknown.values(unknown.start), ["3Y", "5Y", "8Y"], 4, np.random.default_rng(2))
    problem = ModalProblem(structure, unknown, record, ModalSettings(form="dynamic"))
    theta = problem.theta_start + 0.1 * np.random.default_rng(3).standard_normal(16)
    gradient, difference = gradient_errors(problem, theta)
    np.testing.assert_allclose(gradient, difference, atol=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("ratio", [1.0, 1.0 + 1e-7, 1.01])
def test_modal_jacobian_stays_finite_and_exact_at_close_modes(ratio):
    # The pairs are 4e-6 to 0.5 % apart in the model; one eigenvector's own derivative is of the size of 1 / gap.
    structure = tower(ratio)
    unknown = parameters(structure, [Unknown("stiffness", "k", each=True), Unknown("mass", "m", each=True)])
    channels = ["1X", "2X", "1Y", "2Y"]
    record = measured(structure, unknown.values(unknown.start), channels, 4, np.random.default_rng(4))
    problem = ModalProblem(structure, unknown, record, ModalSettings(closeness=0.05))
    assert [len(group.members) for group in problem.data.groups] == [2, 2]
    require_exact_slope(problem, problem.theta_start, 1e-5)
    at = problem.linearize(problem.theta_start)
    assert np.abs(at.jacobian).max() < 1e4  # one over the frequency error is 1e3


def test_modal_residual_of_a_group_does_not_depend_on_how_the_model_turns_its_shapes():
    # Two equal models whose links differ in sign at 1e-13 have shapes turned by a quarter in each pair.
    residuals = []
    for sign in (1, -1):
        structure = tower()
        unknown = stiffnesses(structure)
        record = measured(structure, unknown.values(unknown.start), ["1X", "2X", "1Y", "2Y"], 4)
        values = np.array(unknown.start)
        values[:2] *= 1 + sign * 1e-13
        problem = ModalProblem(structure, unknown.started_at(values), record)
        residuals.append(problem.residual(problem.theta_start))
    np.testing.assert_allclose(residuals[0], residuals[1], atol=1e-6)


def test_modal_fit_recovers_parameters_of_clean_modes_from_a_poor_start_with_few_sensors():
    structure = chain()
    truth = stiffnesses(structure)
    rng = np.random.default_rng(5)
    true = truth.start * np.exp(0.2 * rng.standard_normal(5))
    record = measured(structure, truth.values(true), ["2X", "5X"], 3)
    problem = ModalProblem(structure, truth.started_at(1000.0 * np.exp(0.5 * rng.standard_normal(5))), record)
    found = estimate(problem, plans=problem.schedules())
    np.testing.assert_allclose(found.values, true, rtol=1e-7)


def test_modes_that_few_sensors_tell_apart_are_fitted_without_the_way_of_wide_errors():
    """Three modes 4 % apart and two sensors: errors of 2 % would leave them one group, which two sensors cannot span."""
    springs = [Spring(f"k{i}", [f"{i}X"], stiffness=k) for i, k in ((1, 1000.0), (2, 1080.0), (3, 1166.0))]
    links = Spring("links", ["1X", "2X"], ["2X", "3X"], stiffness=5.0)
    structure = Structure(
        {i: float(i) for i in range(1, 4)}, [PointMass("m", [1, 2, 3], 1.0), *springs, links], active=["X"]
    )
    truth = parameters(structure, [Unknown("stiffness", spring.name) for spring in springs])
    record = measured(structure, truth.values(truth.start), ["1X", "3X"], 3, np.random.default_rng(2))
    problem = ModalProblem(structure, truth.started_at(truth.start * np.array([1.02, 0.98, 1.01])), record)
    assert [name for way in problem.schedules() for name, _ in way] == ["modal dynamic residual"]
    with pytest.raises(
        InputError, match=r"modes 1, 2, 3 cannot be distinguished .* 2 sensors; lower `closeness` or the errors"
    ):
        replace(problem, settings=ModalSettings(frequency_error=0.02))


def followed_chain():
    """Three masses, and three nodes more that follow them: six sensors can be put on three degrees of freedom."""
    nodes = {i: float(i) for i in range(7)}
    here, back = ["1X", "2X", "3X"], ["0X", "1X", "2X"]
    elements = [PointMass("m", [1, 2, 3], 2.0), Spring("k", here, back, stiffness=1000.0)]
    half = Constraint("c", "6X", [("1X", 0.5), ("3X", 0.5)])
    ties = [Constraint("a", "4X", [("1X", 1.0)]), Constraint("b", "5X", [("2X", -1.0)]), half]
    return Structure(nodes, elements, fixed=["0X"], active=["X"], ties=ties)


@pytest.mark.parametrize("channels", [["1X", "2X", "3X", "4X", "5X", "6X"], ["3X", "2X", "5X"]])
def test_modal_fit_takes_more_sensors_than_degrees_of_freedom(channels):
    """The search begins with the dynamic residual, whose forces cannot meet every sensor then."""
    structure, rng = followed_chain(), np.random.default_rng(8)
    truth = stiffnesses(structure)
    true = truth.start * np.exp(0.2 * rng.standard_normal(3))
    record = measured(structure, truth.values(true), channels, 3, rng, 1e-7, 1e-7)
    problem = ModalProblem(structure, truth.started_at(1000.0 * np.exp(0.3 * rng.standard_normal(3))), record)
    found = estimate(problem, plans=problem.schedules())
    np.testing.assert_allclose(found.values, true, rtol=1e-5)
    force = of_form(problem, "dynamic")
    gradient, difference = gradient_errors(force, force.theta_start)
    np.testing.assert_allclose(gradient, difference, atol=1e-5 * np.abs(gradient).max())


def test_modal_fit_follows_modes_that_cross():
    # The start has the y modes below the x modes, the truth above: by order the shapes would be those of others.
    structure = tower(1.3)
    truth = stiffnesses(structure)
    record = measured(structure, truth.values(truth.start), ["1X", "2X", "1Y", "2Y"], 4)
    start = truth.started_at(truth.start * np.array([1.0, 1.0, 0.6, 0.6]))
    problem = ModalProblem(structure, start, record)
    found = estimate(problem, plans=problem.schedules())
    np.testing.assert_allclose(found.values, truth.start, rtol=1e-7)


def test_modal_standard_deviations_are_those_of_repeated_measurements():
    structure = chain()
    truth = parameters(structure, [Unknown("stiffness", "k", each=True), Unknown("mass", "m:1-2", name="low")])
    scores, chi = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        record = measured(structure, truth.values(truth.start), ["1X", "2X", "3X", "4X", "5X"], 4, rng)
        found = estimate(ModalProblem(structure, truth, record))
        scores.append((found.values - truth.start) / found.std_noise)
        chi.append(found.goodness.chi_square)
    freedom = found.goodness.degrees_of_freedom
    assert freedom == 4 * 5 - 6  # four frequencies and four shapes of five entries, less scale, less unknowns
    assert np.mean(chi) == pytest.approx(freedom, rel=0.15)  # standard deviation of the mean is 5 %
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize(("frequency_error", "expected"), [(1e-5, 12), (1e-3, 8)])
def test_modal_group_data_are_weighted_right(frequency_error, expected):
    # Pairs 0.4 % apart. With sharp frequencies all 12 degrees of freedom show in chi-square; with frequencies known to
    # 0.1 % only, the four of the mixing are held back on purpose, and the answer is as sure as it says.
    structure = tower(1.008)
    truth = stiffnesses(structure)
    channels = ["1X", "2X", "1Y", "2Y"]
    scores, chi = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        record = measured(structure, truth.values(truth.start), channels, 4, rng, frequency_error)
        found = estimate(ModalProblem(structure, truth, record))
        scores.append((found.values - truth.start) / found.std_noise)
        chi.append(found.goodness.chi_square)
    assert found.goodness.degrees_of_freedom == 4 * 4 - 4
    assert np.mean(chi) == pytest.approx(expected, rel=0.16)  # standard deviation of the mean is 5 to 6 %
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.35)


def test_modes_alone_give_ratios_and_say_so():
    structure = chain()
    unknown = parameters(structure, [Unknown("mass", "m", each=True), Unknown("stiffness", "k", each=True)])
    channels = ["1X", "2X", "3X", "4X", "5X"]
    record = measured(structure, unknown.values(unknown.start), channels, 5, np.random.default_rng(6))
    found = estimate(ModalProblem(structure, unknown, record))
    assert found.status is Status.NOT_IDENTIFIABLE
    assert found.identifiability.rank == 9
    assert "only as ratios: their common scale is free" in found.identifiability.directions[0].words


def test_modes_and_receptances_of_two_tests_fit_together():
    structure = chain()
    unknown = parameters(structure, [Unknown("mass", "m", each=True), Unknown("stiffness", "k", each=True)])
    rng = np.random.default_rng(7)
    record = measured(structure, unknown.values(unknown.start), ["1X", "2X", "3X", "4X", "5X"], 5, rng)
    like = FrfRecord(np.linspace(0.5, 6.0, 40), np.zeros((40, 1, 1)), ("5X",), ("5X",), "receptance")
    frf = simulated_record(structure, unknown, like, 0.01, rng)
    apart = [ModalProblem(structure, unknown, record), FrfProblem(structure, unknown, frf)]
    together = estimate(JointProblem(tuple(apart)))
    assert together.status is Status.CONVERGED
    assert (np.abs(together.values - unknown.start) < 4 * together.std).all()
    alone = estimate(apart[1])
    assert (together.std_noise < alone.std_noise).all()


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ({"covariance": None}, {}, "or `frequency_error`, such as 0.005"),
        ({"shape_std": None}, {}, "or `shape_error`, such as 0.02"),
        ({"channels": ("1X", "9X"), "mode_shapes": np.ones((2, 3)), "shape_std": None}, {"shape_error": 0.1}, "node 9"),
        ({"frequency": np.zeros(3)}, {}, "no mode above 0 Hz"),
        ({"frequency": np.array([1.0, 1.001, 1.002])}, {}, "lower `closeness`"),
        (
            {"damping_ratio": np.full(3, np.nan), "covariance": None},
            {"frequency_error": 0.01, "use_damping": True},
            "damping",
        ),
    ],
)
def test_modal_problem_names_what_is_missing(change, options, words):
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "5X"], 3)
    with pytest.raises(InputError, match=words):
        ModalProblem(structure, unknown, replace(record, **change), ModalSettings(**options))


def test_a_mode_that_is_listed_twice_is_named():
    structure = chain()
    unknown = stiffnesses(structure)
    record = replace(measured(structure, unknown.values(unknown.start), ["1X", "5X"], 3), source="m.csv")
    twice = replace(
        record, frequency=record.frequency[[0, 0, 2]], mode_shapes=record.mode_shapes[:, [0, 0, 2]], covariance=None
    )
    with pytest.raises(
        InputError, match=r"modes 1 \(.* Hz\), 2 \(.* Hz\) of m.csv cannot be distinguished .* listed twice"
    ):
        ModalProblem(structure, unknown, twice, ModalSettings(frequency_error=0.01))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"covariance": 1}, "uncertainty of its frequencies, or one of zero, at mode 2: .*`frequency_error`"),
        ({"shape_std": np.array([[0.1, 0.0, 0.0], [0.1, 0.1, 0.0]])}, "of its shapes, or one of zero, at mode 3: "),
        ({"shape_std": np.array([[0.1, 0.1, 0.1], [0.1, np.nan, 0.1]])}, "uncertainty of its shapes"),
    ],
)
def test_deviations_of_zero_are_named_by_their_modes(change, words):
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "5X"], 3)
    if "covariance" in change:
        covariance = record.covariance.copy()
        covariance[1, 1] = 0.0
        change = {"covariance": covariance}
    with pytest.raises(InputError, match=words):
        ModalProblem(structure, unknown, replace(record, **change))
    ModalProblem(structure, unknown, replace(record, **change), ModalSettings(frequency_error=0.01, shape_error=0.01))


def test_shapes_by_their_mac_make_the_objective_of_published_work():
    structure = chain()
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X-", "5X"], 4, np.random.default_rng(3))
    record = replace(record, shape_std=np.full(record.mode_shapes.shape, 7.0))  # which then does not count
    problem = ModalProblem(structure, unknown, record, ModalSettings(shape_error=0.04, shape_form="mac"))
    theta = problem.theta_start + 0.2 * np.random.default_rng(1).standard_normal(5)
    require_exact_slope(problem, theta)
    values = unknown.values(problem.physical(theta))
    model = measured(structure, values, ["1X", "3X-", "5X"], 4)
    assurance = np.array(
        [(a @ b) ** 2 / ((a @ a) * (b @ b)) for a, b in zip(record.mode_shapes.T, model.mode_shapes.T, strict=True)]
    )
    own = shape_residual(problem, theta)
    assert own @ own == pytest.approx(np.sum(1 - assurance) / 0.04**2, rel=1e-9)
    std = np.sqrt(np.diag(record.covariance)[:4])
    whole = np.sum(1 - assurance) / 0.04**2 + np.sum(((model.frequency - record.frequency) / std) ** 2)
    assert np.sum(problem.residual(theta) ** 2) == pytest.approx(
        whole, rel=1e-3
    )  # the stated error widens none of these
    assert problem.data.changes is None
    with pytest.raises(InputError, match=r"weighed by `shape_error`, the standard deviation of sqrt\(1 - MAC\)"):
        ModalProblem(structure, unknown, record, ModalSettings(shape_form="mac"))


def test_what_pulls_sums_to_the_number_of_parameters():
    structure = chain()
    prior = Prior(1000.0, 10.0)
    unknown = parameters(structure, [Unknown("stiffness", "k", each=True, prior=prior)])
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X", "5X"], 4, np.random.default_rng(3))
    problem = ModalProblem(structure, unknown, record, ModalSettings(use_damping=True))
    theta = problem.theta_start
    found = influence_by_kind(problem, theta)
    assert list(found) == ["shapes", "frequencies", "damping ratios"]  # nothing mixes where no modes are close
    assert [rows for rows, _, _ in found.values()] == [12, 4, 4]
    at = problem.linearize(theta)
    left, priors = np.linalg.inv(at.jacobian.T @ at.jacobian), at.jacobian[problem.n_data :]
    whole = sum(own for _, own, _ in found.values())
    assert whole + np.trace(left @ priors.T @ priors) == pytest.approx(5, rel=1e-9)
    rows = at.jacobian[: problem.n_data][problem.rows.series == 8]  # frequencies of three channels: 2 * 3 + 2
    assert found["frequencies"][1] == pytest.approx(np.trace(left @ rows.T @ rows), rel=1e-9)
    assert sum(part for _, _, part in found.values()) == pytest.approx(1)
    fewer = replace(problem, record=record.some_modes(np.array([0])), parameters=stiffnesses(structure))
    assert influence_by_kind(fewer, theta) == {}


def test_modal_problem_refuses_more_modes_than_the_model_has():
    structure = chain(2)
    unknown = stiffnesses(structure)
    record = measured(chain(), chain().values, ["1X", "2X"], 3)
    problem = ModalProblem(structure, unknown, record)
    with pytest.raises(InputError, match="the model has 2 modes"):
        problem.residual(problem.theta_start)


def test_modal_groups_hold_modes_that_their_standard_deviations_do_not_tell_apart():
    structure = chain(3)
    unknown = parameters(structure, [Unknown("stiffness", "k", each=True)])
    shapes, channels = np.eye(3), ("1X", "2X", "3X")
    frequency = np.array([1.0, 1.05, 2.0])
    sizes = {}
    for std in (0.01, 0.02):  # the gap of 0.05 Hz is 3.5 or 1.8 standard deviations
        covariance = np.diag(np.concatenate([np.full(3, std**2), np.full(3, 1e-6)]))
        record = ModalRecord(frequency, np.full(3, 0.01), shapes, channels, covariance)
        problem = ModalProblem(structure, unknown, record, ModalSettings(shape_error=0.01))
        sizes[std] = [len(group.members) for group in problem.data.groups]
    assert sizes == {0.01: [1, 1, 1], 0.02: [2, 1]}


def test_modal_dynamic_residual_does_not_depend_on_a_common_scale():
    structure = chain()
    unknown = parameters(structure, [Unknown("mass", "m", each=True), Unknown("stiffness", "k", each=True)])
    record = measured(structure, unknown.values(unknown.start), ["1X", "3X", "5X"], 3, np.random.default_rng(4))
    problem = ModalProblem(structure, unknown, record, ModalSettings(form="dynamic"))
    theta = problem.theta_start + 0.1 * np.random.default_rng(5).standard_normal(unknown.n_params)
    at = problem.linearize(theta)
    np.testing.assert_allclose(problem.residual(theta + np.log(7.0)), at.residual, rtol=1e-8, atol=1e-8)
    slope = at.residual @ at.jacobian
    assert abs(slope.sum()) < 1e-8 * np.abs(slope).sum()  # the gradient along it is 0


def with_changes(record, rng, count=30):
    """`record` with changes that make frequencies and shapes vary together."""
    n = record.n_modes
    common = 3 * rng.standard_normal((count, 1)) / np.sqrt(count)
    frequency = record.frequency * 1e-3 * (common + rng.standard_normal((count, n)) / np.sqrt(count))
    ratio = 1e-3 * (common + rng.standard_normal((count, n)) / np.sqrt(count))
    shapes = 0.01 * (common[:, :, None] + rng.standard_normal((count, *record.mode_shapes.shape)) / np.sqrt(count))
    both = np.concatenate([frequency, ratio], axis=1)
    std = np.sqrt(np.sum(shapes**2, axis=0))
    return replace(record, covariance=both.T @ both, shape_std=std, changes=ModalChanges(frequency, ratio, shapes))


@pytest.mark.parametrize("close", [False, True])
@pytest.mark.parametrize("damping", [False, True])
def test_changes_of_the_data_rows_agree_with_differences(close, damping):
    structure = tower(1.01) if close else chain()
    unknown = stiffnesses(structure)
    channels = ("1X", "2X", "1Y", "2Y") if close else ("1X", "3X", "5X")
    record = measured(structure, structure.values, channels, 4 if close else 3)
    record = with_changes(record, np.random.default_rng(0))
    problem = ModalProblem(structure, unknown, record, ModalSettings(use_damping=damping and not close, closeness=0.02))
    theta = problem.theta_start * 1.02
    found, changes = problem.noise_law(theta).factor, record.changes
    step = 1e-4
    for number in (0, 7, 29):
        sides = []
        for sign in (step, -step):
            # the record's own spread stays, so that weights do
            moved = replace(
                record,
                frequency=record.frequency + sign * changes.frequency[number],
                damping_ratio=record.damping_ratio + sign * changes.damping_ratio[number],
                mode_shapes=record.mode_shapes + sign * changes.mode_shapes[number].real,
            )
            twin = replace(problem, record=moved)
            for name in ("shape_std", "covariance"):
                twin.data.__dict__[name] = getattr(problem.data, name)
            sides.append(twin.residual(theta)[: problem.n_data])
        difference = (sides[0] - sides[1]) / (2 * step)
        # groups scale their rows by measured eigenvalues, and shapes by their largest entry: of second order in the misfit
        assert np.abs(found[number] - difference).max() < 0.02 * np.abs(difference).max()


def test_covariance_counts_how_modes_vary_together():
    structure = chain()
    unknown, rng = stiffnesses(structure), np.random.default_rng(3)
    clean = with_changes(measured(structure, structure.values, ("1X", "2X", "4X", "5X"), 4), rng)
    changes = clean.changes
    answers, predicted = [], []
    for _ in range(80):
        weights = rng.standard_normal(len(changes.frequency))
        drawn = replace(
            clean,
            frequency=clean.frequency + weights @ changes.frequency,
            mode_shapes=clean.mode_shapes + np.einsum("b,bcm->cm", weights, changes.mode_shapes.real),
        )
        found = estimate(ModalProblem(structure, unknown, drawn))
        assert found.covariance_basis == "noise"
        answers.append(found.values)
        predicted.append(np.diag(found.spread.covariance_noise))
    ratio = np.std(answers, axis=0) / np.sqrt(np.mean(predicted, axis=0))
    assert ratio == pytest.approx(np.ones(5), abs=0.25)  # three standard errors of 80 repeats
    independent = estimate(ModalProblem(structure, unknown, replace(clean, changes=None)))
    assert np.abs(np.log(np.diag(independent.spread.covariance_noise) / np.mean(predicted, axis=0))).max() > 0.5


def test_joint_problem_counts_each_record_by_its_own_errors():
    structure = chain()
    unknown, rng = stiffnesses(structure), np.random.default_rng(4)
    record = with_changes(measured(structure, structure.values, ("1X", "2X", "4X", "5X"), 4), rng)
    alone = ModalProblem(structure, unknown, record)
    twice = JointProblem((alone, ModalProblem(structure, unknown, record)))
    one, two = (estimate(problem).spread.covariance_noise for problem in (alone, twice))
    np.testing.assert_allclose(two, one / 2, rtol=1e-6)


def test_close_modes_of_nearly_one_measured_shape_have_finite_slopes():
    """A^-1 Lambda A of eigenvalues 1 and 9 has the diagonal (-3, 13): the first counts as its floor, with no slope."""
    eigenvalues, a = np.array([1.0, 9.0]), np.array([[3.0, 1.0], [-1.0, -1.0]])
    turned = np.linalg.inv(a) @ (eigenvalues[:, None] * a)
    group = GroupData(np.arange(2), np.arange(2), eigenvalues, a, np.ones(2), np.ones((2, 2)))
    slope = np.random.default_rng(0).standard_normal((2, 2, 3))
    frequency, d_frequency, _, _ = _frequencies_of_group(eigenvalues, slope, a, np.zeros((2, 2, 3)), group)
    clipped = np.diagonal(turned) < 0
    assert clipped.sum() == 1
    np.testing.assert_array_equal(d_frequency[clipped], 0.0)
    assert (2 * np.pi * frequency[clipped])[0] == pytest.approx(1e-3)
    assert (2 * np.pi * frequency[~clipped])[0] == pytest.approx(np.sqrt(np.diagonal(turned)[~clipped][0]))


def test_modes_that_sensors_see_by_rounding_alone_are_not_paired():
    """Along X a tower has two modes; the other two move its sensors by 1e-12 of these, in shapes like those measured."""
    structure = tower(1.3)
    unknown = stiffnesses(structure)
    record = measured(structure, unknown.values(unknown.start), ["1X", "2X"], 2)
    problem = ModalProblem(structure, unknown, record)
    state = problem.model.state(problem.physical(problem.theta_start))
    motion = np.abs(state.seen).max(axis=0)
    along = np.flatnonzero(motion > 0.1 * motion.max())
    assert len(along) == 2
    shapes = state.modes.mode_shapes.copy()
    moved = np.flatnonzero(state.sensors.any(axis=1))
    shapes[np.ix_(moved, np.setdiff1d(np.arange(4), along))] = 1e-12 * shapes[np.ix_(moved, along)]
    blurred = replace(state, modes=replace(state.modes, mode_shapes=shapes))
    assert set(pairing(problem.data, blurred, False)) == set(along)
