"""Parameters from modes whose shapes have unknown entries: derivatives, what counts, pairing, repeated measurements."""

from dataclasses import replace

import numpy as np
import pytest
from modal_problem_cases import gains, gradient_errors, require_exact_slope

from structid import (
    ChannelUnknown,
    InputError,
    ModalRecord,
    PointMass,
    Spring,
    Status,
    Structure,
    Unknown,
    estimate,
    parameters,
)
from structid.diagnose.modified_model import modal_view
from structid.forward import ModalProblem, ModalSettings
from structid.forward.modal.problem import influence_by_kind, of_form
from structid.identification.identify import identify_together
from structid.identification.modal_fit import paired_modes
from structid.identification.setups.modal import ModalSetup
from structid.modal.modal_record import ModalChanges

MASS, STIFFNESS = 2000.0, np.array([3.0e6, 2.8e6, 2.5e6, 2.2e6, 2.0e6])


def storeys():
    """A shear building of five storeys."""
    n = len(STIFFNESS)
    here, back = [f"{i}X" for i in range(1, n + 1)], [f"{i}X" for i in range(n)]
    elements = [PointMass("floors", list(range(1, n + 1)), MASS), Spring("storeys", here, back, stiffness=2.5e6)]
    return Structure({i: float(i) for i in range(n + 1)}, elements, fixed=["0X"], active=["X"])


def textbook_modes():
    """Frequencies (Hz) and shapes of the building with `STIFFNESS`, largest entry 1, by its matrices as textbooks have them."""
    n = len(STIFFNESS)
    k = np.diag(STIFFNESS + np.append(STIFFNESS[1:], 0.0)) - np.diag(STIFFNESS[1:], 1) - np.diag(STIFFNESS[1:], -1)
    values, shapes = np.linalg.eigh(k / MASS)
    return np.sqrt(values[: n - 1]) / (2 * np.pi), (shapes / np.abs(shapes).max(axis=0))[:, : n - 1]


def measured(seed=0, lost=1 / 3, noise=0.02, spread=2e-3):
    """Four modes with noise, and each shape entry unknown with the probability `lost`."""
    rng = np.random.default_rng(seed)
    frequency, shapes = textbook_modes()
    std = spread * frequency
    shapes = shapes + noise * rng.standard_normal(shapes.shape)
    shapes[rng.random(shapes.shape) < lost] = np.nan
    return ModalRecord(
        frequency + std * rng.standard_normal(4), [0.01] * 4, shapes, [f"{i}X" for i in range(1, 6)],
        np.diag(np.concatenate([std, [0.001] * 4]) ** 2), np.full(shapes.shape, noise),
    )  # fmt: skip


def problem_of(record, channels=None, **options):
    structure = storeys()
    unknown = parameters(structure, [Unknown("stiffness", "storeys", each=True)])
    return ModalProblem(structure, unknown, record, ModalSettings(**options), channels)


def without(record, *entries, mode=None):
    """`record` with entries (channel, mode), or all of `mode`, unknown."""
    shapes = np.array(record.mode_shapes)
    for entry in entries:
        shapes[entry] = np.nan
    if mode is not None:
        shapes[:, mode] = np.nan
    return replace(record, mode_shapes=shapes)


@pytest.mark.parametrize("closeness", [0.02, 0.5])
@pytest.mark.parametrize("has_gain", [False, True])
def test_the_jacobian_agrees_with_differences(closeness, has_gain):
    """Of single modes, one without a shape, and of two groups whose members know other channels."""
    record = without(measured(lost=0), (0, 0), (3, 0), (2, 1), (4, 3), mode=None if closeness > 0.1 else 2)
    errors = gains(record, ChannelUnknown("gain", "4X")) if has_gain else None
    problem = problem_of(record, closeness=closeness, use_damping=closeness < 0.1, channels=errors)
    assert [len(group.members) for group in problem.data.groups] == ([1] * 4 if closeness < 0.1 else [1, 3])
    theta = problem.theta_start + 0.1 * np.random.default_rng(1).standard_normal(len(problem.theta_start))
    assert np.isfinite(problem.residual(theta)).all()
    require_exact_slope(problem, theta)


def test_the_gradient_of_the_dynamic_residual_agrees_with_differences():
    record = without(measured(lost=0), (0, 0), (3, 0), (2, 1), (4, 3), mode=2)
    problem = problem_of(record, form="dynamic")
    assert problem.n_data == 5 * 3 - 4
    assert sorted(set(problem.rows.lines.tolist())) == [0, 1, 3]
    theta = problem.theta_start + 0.1
    gradient, difference = gradient_errors(problem, theta)
    assert gradient == pytest.approx(difference, abs=1e-5 * np.abs(difference).max())


def test_rows_are_those_of_known_entries_and_what_is_unknown_has_no_part():
    record = without(measured(lost=0), (1, 0), (3, 2), (4, 2))
    problem = problem_of(record)
    shapes = problem.rows.series < 2 * 5
    pairs = {
        (int(mode), int(series) // 2)
        for mode, series in zip(problem.rows.lines[shapes], problem.rows.series[shapes], strict=True)
    }
    assert pairs == {(m, c) for m in range(4) for c in range(5)} - {(0, 1), (2, 3), (2, 4)}
    assert influence_by_kind(problem, problem.theta_start)["shapes"][0] == 17
    freedom = estimate(problem).goodness.degrees_of_freedom
    assert freedom == 4 + 17 - 4 - 5  # frequencies and entries, less scales, less unknowns
    noisy = problem_of(replace(record, shape_std=np.where(record.known, record.shape_std, 7.0)))
    assert np.array_equal(noisy.residual(problem.theta_start), problem.residual(problem.theta_start))


@pytest.mark.parametrize("form", ["output", "dynamic"])
@pytest.mark.parametrize("options", [{}, {"closeness": 0.5}, {"shape_form": "mac", "shape_error": 0.05}])
def test_a_channel_that_is_unknown_throughout_is_one_that_is_not_there(form, options):
    """Also where `identify` tests the residual of each channel by its name."""
    record = measured(lost=0)
    dead = without(record, *((2, mode) for mode in range(4)))
    less = record.some_channels([0, 1, 3, 4])
    theta = problem_of(record).theta_start + 0.1
    one, other = (problem_of(each, form=form, **options) for each in (dead, less))
    assert one.residual(theta) == pytest.approx(other.residual(theta), rel=1e-9, abs=1e-9)
    assert one.linearize(theta).n_eliminated == other.linearize(theta).n_eliminated
    settings = ModalSettings(form=form, **options)
    setups = [ModalSetup(storeys(), one.parameters, each, settings) for each in (dead, less)]
    answers = [identify_together([setup]).estimate for setup in setups]
    names = [[test.name for test in answer.goodness.residual_tests.series] for answer in answers]
    assert names[0] == names[1]
    assert not any("3X" in name for name in names[0])
    assert answers[0].values == pytest.approx(answers[1].values, rel=1e-6)


def test_a_channel_that_no_group_of_modes_has_whole_has_no_row():
    record = without(measured(lost=0), (2, 0), (2, 2))
    problem = problem_of(record, closeness=0.5)
    assert [len(group.members) for group in problem.data.groups] == [1, 3]
    found = identify_together([ModalSetup(storeys(), problem.parameters, record, ModalSettings(closeness=0.5))])
    named = [test.name for test in found.estimate.goodness.residual_tests.series]
    assert named == [*(f"shape at {c}X+" for c in (1, 2, 4, 5)), "mixing of close modes", "frequency"]
    assert influence_by_kind(problem, problem.theta_start)["shapes"][0] == 4 * 4


def test_the_scale_and_its_error_are_those_of_known_entries():
    """The largest entry of 1, by which a file scales, has no error of its own; where it is unknown nothing is held."""
    record = replace(measured(lost=0), shape_std=np.full((5, 4), 0.02))
    held = np.abs(np.asarray(record.mode_shapes)).argmax(axis=0)
    std = np.array(record.shape_std)
    std[held, range(4)] = 0.0
    whole = problem_of(replace(record, shape_std=std))
    assert (whole.data.shape_std > 0).all()
    lost = without(replace(record, shape_std=std), *zip(held.tolist(), range(4), strict=True))
    assert np.nanmax(np.abs(problem_of(lost).data.shapes), axis=0) == pytest.approx(np.ones(4))
    one = without(record, *((c, 0) for c in range(4)))
    alone = replace(one, shape_std=np.where(np.arange(4) == 0, 0.0, one.shape_std))
    assert problem_of(alone).data.shape_std[4, 0] == 1.0  # one entry always fits


def test_a_mode_without_a_shape_is_paired_by_its_frequency_and_counts_by_it():
    record = without(measured(lost=0), mode=2)
    problem = problem_of(record)
    assert [len(group.members) for group in problem_of(record, closeness=0.9).data.groups] == [3, 1]
    pairs = paired_modes(problem, problem.theta_start)
    assert pairs.number.tolist() == [0, 1, 2, 3]
    assert np.isnan(pairs.mac).tolist() == np.isnan(pairs.angle).tolist() == [False, False, True, False]
    assert (problem.rows.series < 2 * 5).sum() == 15
    found = estimate(problem)
    assert found.status is Status.CONVERGED
    assert found.goodness.degrees_of_freedom == 4 + 15 - 3 - 5
    both = (problem, problem_of(record.some_modes([0, 1, 3])))
    more, less = (one.linearize(problem.theta_start).jacobian for one in both)
    gain = np.linalg.eigvalsh(more.T @ more - less.T @ less)
    assert gain[-1] > 1e4
    assert gain[:-1] == pytest.approx(np.zeros(4), abs=1e-6 * gain[-1])  # one frequency, and no more


def test_close_modes_are_one_group_past_a_mode_without_a_shape():
    """Frequencies, damping ratios and their changes then come in the order of the modes, not of the groups."""
    frequency, shapes = textbook_modes()
    whole = replace(measured(lost=0), frequency=frequency, mode_shapes=shapes)
    record = without(whole, (4, 3), mode=2)
    problem = problem_of(record, closeness=0.9)
    assert [group.members.tolist() for group in problem.data.groups] == [[0, 1, 3], [2]]
    assert problem.data.is_alone.tolist() == [False, False, True, False]
    truth = problem.unknowns.transforms.free(STIFFNESS)
    assert problem.residual(truth) == pytest.approx(np.zeros(len(problem.residual(truth))), abs=1e-8)
    require_exact_slope(replace(problem, settings=replace(problem.settings, use_damping=True)), truth + 0.05)
    rng = np.random.default_rng(0)
    own = ModalChanges(*1e-3 * rng.standard_normal((2, 30, 4)), 0.01 * rng.standard_normal((30, 5, 4)))
    told = problem_of(replace(record, changes=own), closeness=0.9)
    rows = told.noise_law(truth).factor[:, -4:] * told.data.frequency_std
    assert rows[:, 2] == pytest.approx(-own.frequency[:, 2], rel=1e-9)


def test_a_mode_without_a_shape_may_be_one_that_no_sensor_sees():
    nodes = {i: (0.0, 0.0, float(i)) for i in range(3)}
    first, second = ["1X", "2X", "1Y", "2Y"], ["0X", "1X", "0Y", "1Y"]
    elements = [PointMass("m", [1, 2], 3.0), Spring("k", first, second, stiffness=[800.0, 700.0, 1100.0, 1000.0])]
    structure = Structure(nodes, elements, fixed=["0X", "0Y"], active=["X", "Y"])
    unknown = parameters(structure, [Unknown("stiffness", "k", each=True)])
    frequency = np.array([1.53, 1.82, 4.0, 4.78])  # X, Y, X, Y
    shapes = [[0.62, np.nan, 1.0, np.nan], [1.0, np.nan, -0.63, np.nan]]
    record = ModalRecord(frequency, [np.nan] * 4, shapes, ["1X", "2X"])
    problem = ModalProblem(structure, unknown, record, ModalSettings(frequency_error=0.005, shape_error=0.02))
    found = estimate(problem)
    model = paired_modes(problem, problem.unknowns.transforms.free(found.values))
    assert model.number.tolist() == [0, 1, 2, 3]
    assert model.frequency == pytest.approx(frequency, rel=0.01)
    assert np.isfinite(modal_view(problem, problem.theta_start).problem.record.values).all()


def test_frequencies_alone_give_what_they_determine():
    """With a file of no shape column, or shapes that are all unknown; masses are known."""
    record = measured(lost=0)
    bare = replace(record, mode_shapes=np.zeros((0, 4)), channels=(), shape_std=None)
    unknown = replace(record, mode_shapes=np.full((5, 4), np.nan))
    theta = problem_of(bare, shape_error=0.02).theta_start
    require_exact_slope(problem_of(bare), theta)
    assert problem_of(bare).residual(theta) == pytest.approx(problem_of(unknown).residual(theta))


def test_what_cannot_do_without_more_entries_says_so():
    record = measured(lost=0)
    bare = replace(record, mode_shapes=np.full((5, 4), np.nan))
    with pytest.raises(InputError, match="MACs are of shapes"):
        problem_of(bare, shape_form="mac", shape_error=0.05)
    with pytest.raises(InputError, match="form 'dynamic' needs a known shape entry"):
        of_form(problem_of(bare), "dynamic")
    few = without(record, (0, 1), (1, 2), (2, 3))
    with pytest.raises(
        InputError, match=r"modes 2, 3, 4 cannot be distinguished .* 2 sensors at which the shapes of all are known"
    ):
        problem_of(few, closeness=0.5)
    with pytest.raises(InputError, match="and there are 2 sensors; lower `closeness`"):
        problem_of(record.some_channels([0, 1]), closeness=0.5)


def test_changes_of_the_data_leave_out_what_is_unknown():
    """How errors of entries vary together is taken over for those that are known: the same as of a record without the channel."""
    record, rng = measured(lost=0), np.random.default_rng(0)
    changes = [1e-3 * rng.standard_normal((30, 4)) for _ in range(2)]
    changes = ModalChanges(*changes, 0.01 * rng.standard_normal((30, 5, 4)))
    std = np.sqrt((np.abs(changes.mode_shapes) ** 2).sum(axis=0))
    record = replace(record, changes=changes, shape_std=std)
    dead = without(record, *((2, mode) for mode in range(4)))
    theta = problem_of(record).theta_start
    for options in ({}, {"shape_error": 0.01}):
        own = problem_of(dead, **options).noise_law(theta).factor
        other = problem_of(record.some_channels([0, 1, 3, 4]), **options).noise_law(theta).factor
        assert own.T @ own == pytest.approx(other.T @ other, rel=1e-9, abs=1e-9)
        assert np.isfinite(estimate(problem_of(without(dead, (0, 0)), **options)).std).all()


def test_deviations_are_those_of_repeated_measurements_with_a_third_of_the_entries_unknown():
    scores, inside = [], []
    for seed in range(40):
        found = estimate(problem_of(measured(seed)))
        scores.append((found.values - STIFFNESS) / found.std)
        low, high = found.interval(0.95).T
        inside.append((low <= STIFFNESS) & (high >= STIFFNESS))
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.12)
    assert 0.90 <= np.mean(inside) <= 0.99
