"""Sensitivity to fixed values: properties that the model fixes, and what a record says of them. Matrices are the tests' own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from structid.diagnose.explain import fixed_value_sensitivities, widened
from structid.diagnose.fixed_value_influence import doubted, influences, resting_words
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel
from structid.diagnose.search import with_freed
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.verdict import is_sound
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.modal.modal_record import independent_errors
from structid.study.results.folder import estimate_summary
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

BUILDING = """
[structure]
active = ["X"]
tolerance = 0

[structure.nodes]
1 = 1.0
2 = 2.0
3 = 3.0
4 = 4.0
5 = 5.0

[[structure.point_mass]]
name = "floors"
nodes = [1, 2, 3, 4]
mass = 5.0

[[structure.point_mass]]
name = "roof"
nodes = [5]
mass = 3.0

[[structure.spring]]
name = "ground"
first = "1X"
stiffness = 8000.0

[[structure.spring]]
name = "lower"
first = ["1X", "2X"]
second = ["2X", "3X"]
stiffness = 7000.0

[[structure.spring]]
name = "upper"
first = ["3X", "4X"]
second = ["4X", "5X"]
stiffness = {upper}

[[unknown]]
property = "stiffness"
elements = "ground"

[[unknown]]
property = "stiffness"
elements = "lower"

[record]
path = "modes.json"

[record.modes]

[method]
restarts = 0
"""
TRUTH = {"stiffness[ground]": 8300.0, "stiffness[lower]": 7300.0}
UPPER, CHANNELS, FREQUENCY_ERROR, SHAPE_ERROR = 6000.0, ["1X", "3X", "4X", "5X"], 2e-3, 0.02


def building(folder, seed, upper=UPPER, held=UPPER, clock=1.0):
    """The study of a building whose upper storeys have another stiffness than it holds, with three modes.

    All frequencies are read `clock` times as high as they are.
    """
    k = np.array([8300.0, 7300.0, 7300.0, upper, upper])
    stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    squares, shapes = eigh(stiffness, np.diag([5.0, 5.0, 5.0, 5.0, 3.0]))
    frequency, shapes = clock * np.sqrt(squares[:3]) / (2 * np.pi), shapes[[0, 2, 3, 4], :3]
    shapes = shapes / np.abs(shapes).max(axis=0)
    rng = np.random.default_rng(seed)
    std = FREQUENCY_ERROR * frequency
    frequency = frequency + std * rng.standard_normal(3)
    shapes = shapes + SHAPE_ERROR * rng.standard_normal(shapes.shape)
    errors = independent_errors(np.concatenate([std, np.full(3, 1e-3)]))
    record = ModalRecord(frequency, np.full(3, 0.01), shapes, CHANNELS, errors, np.full(shapes.shape, SHAPE_ERROR))
    write_modes(folder / "modes.json", record)
    (folder / "study.toml").write_text(BUILDING.format(upper=held), encoding="utf-8")
    ready = prepare_study(load_study(folder / "study.toml"))
    return ready, run_prepared(ready)


def test_influence_and_pull_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    jacobian, residual, scale = rng.standard_normal((30, 4)), rng.standard_normal(30), 1.3
    held = influences(jacobian, residual, ["a", "b"], ["c", "d"], np.array([0.1, 0.02]), scale)
    own = jacobian[:, :2]
    for column, one in zip(jacobian[:, 2:].T, held, strict=True):
        follow = -np.linalg.lstsq(own, column, rcond=None)[0]
        np.testing.assert_allclose(one.influence, follow, rtol=1e-10)
        np.testing.assert_allclose(one.distance, 0.01 * follow / [0.1, 0.02], rtol=1e-10)
        both = np.column_stack([own, column])
        step = -np.linalg.lstsq(both, residual, rcond=None)[0]
        assert one.pull == pytest.approx(step[2], rel=1e-10)
        assert one.pull_std == pytest.approx(scale * np.sqrt(np.linalg.inv(both.T @ both)[2, 2]), rel=1e-10)


def test_a_held_value_that_the_parameters_can_follow_has_no_pull():
    jacobian = np.random.default_rng(2).standard_normal((20, 3))
    jacobian[:, 2] = jacobian[:, :2] @ [0.5, -2.0]
    [one] = influences(jacobian, np.ones(20), ["a", "b"], ["c"], np.ones(2), 1.0)
    assert np.isnan(one.pull)
    np.testing.assert_allclose(one.influence, [-0.5, 2.0])
    assert not one.is_doubted(1)


def test_influences_are_those_of_fits_with_another_held_value(tmp_path):
    ready, result = building(tmp_path, 1)
    held = {
        one.name: one
        for one in fixed_value_sensitivities(TestedModel(ready.setups, ready.study.options), result.identification)
    }
    assert set(held) == {"mass[floors]", "mass[roof]", "stiffness[upper]"}
    (tmp_path / "more").mkdir()
    _, other = building(tmp_path / "more", 1, held=1.002 * UPPER)
    changes = np.log(other.estimate.values / result.estimate.values) / np.log(1.002)
    np.testing.assert_allclose(held["stiffness[upper]"].influence, changes, rtol=0.02)


@pytest.mark.long
def test_pulls_of_right_models_are_as_large_as_stated(tmp_path):
    z, n_doubted = [], 0
    for seed in range(60):
        folder = tmp_path / str(seed)
        folder.mkdir()
        ready, result = building(folder, seed)
        held = fixed_value_sensitivities(TestedModel(ready.setups, ready.study.options), result.identification)
        z += [one.pull / one.pull_std for one in held]
        n_doubted += bool(doubted(held))
    assert 0.8 < np.mean(np.square(z)) < 1.25  # 180 correlated values
    assert n_doubted <= 7  # 3 are expected of 60


def test_a_sound_answer_whose_record_would_have_another_held_value_is_approximate(tmp_path):
    ready, result = building(tmp_path, 1, upper=0.97 * UPPER)
    assert is_sound(result.identification)
    found, fits = diagnose_study(ready, result, explain=False)
    judgement = found.diagnosis.judgement
    assert judgement.verdict == "approximate"
    assert "the record prefers stiffness[upper], fixed in the model" in judgement.words
    assert "smaller" in judgement.words
    assert [one.where for one in found.diagnosis.suggestions] == [("stiffness[upper]",), ("mass[floors]",)]
    assert len(fits) == 2
    assert not found.diagnosis.causes
    ends = dict(zip(found.estimate.names, found.identification.intervals.ends, strict=True))
    narrow = dict(zip(found.estimate.names, result.identification.intervals.ends, strict=True))
    assert any(not low < TRUTH[name] < high for name, (low, high) in narrow.items())
    assert all(low < TRUTH[name] < high for name, (low, high) in ends.items())


def test_a_fixed_stiffness_that_the_record_would_have_otherwise_may_be_a_clock(tmp_path):
    """Frequencies that are all read 1.25 % too high: the stiffnesses are not to be used, though the model explains the record."""
    ready, result = building(tmp_path, 1, clock=1.0125)
    assert is_sound(result.identification)
    found, _ = diagnose_study(ready, result, explain=False)
    first = doubted(found.diagnosis.sensitivities)[0]
    assert first.name == "stiffness[upper]"
    assert first.clock_pull == pytest.approx(1.0125**2 - 1, abs=3 * first.pull_std)
    assert found.diagnosis.judgement.verdict == "approximate"
    assert "do not rely on the stiffnesses before both are checked." in found.diagnosis.judgement.words
    assert found.view.next_step.startswith(
        "Check the clock or sampling rate and stiffness[upper] before you use a stiffness"
    )
    assert not replace(first, clock_pull=0.02, tolerance=0.01).is_like_clock


def test_a_clear_pull_is_looked_into_and_named(tmp_path):
    ready, result = building(tmp_path, 2, upper=0.97 * UPPER)
    assert is_sound(result.identification)
    found, _ = diagnose_study(ready, result)
    assert found.diagnosis.judgement.verdict == "wrong_model"
    assert found.diagnosis.causes[0].where == ("stiffness[upper]",)


def test_what_the_values_rest_on_is_in_the_results(tmp_path):
    ready, result = building(tmp_path, 1)
    found, _ = diagnose_study(ready, result)
    assert found.diagnosis.judgement.verdict == "sound"
    summary = estimate_summary(found)["fixed_values"]
    assert [one["name"] for one in summary] == ["mass[floors]", "mass[roof]", "stiffness[upper]"]
    assert set(summary[0]["percent_per_percent"]) == set(TRUTH)
    assert resting_words(found.diagnosis.sensitivities).startswith("fixed values matter: with mass[floors] 1 %")


def test_what_likely_models_disagree_about_by_more_than_its_value_is_not_identified(tmp_path):
    ready, result = building(tmp_path, 1)
    found = result.identification
    theta = found.estimate.theta
    base = FittedModel(
        base_model(TestedModel(ready.setups, ready.study.options), found.problems, theta),
        theta,
        found.estimate.goodness.chi_square,
    )
    [one] = with_freed(base, ["stiffness[upper]"], 3).near
    assert widened(found, [one], None).estimate.identified.all()
    names = list(one.modified.target.names)
    far = one.theta + 0.8 * (np.arange(len(names)) == names.index("stiffness[lower]"))
    wider = widened(found, [replace(one, theta=far)], None)
    assert found.estimate.identified.all()
    assert not wider.estimate.identified[found.estimate.names.index("stiffness[lower]")]
    assert wider.intervals.notes[-1].startswith("these disagree by more than the value about ")
    assert "stiffness[lower]" in wider.intervals.notes[-1]
    assert "stiffness[lower] is not identified: its standard deviation is larger than its value" in wider.warnings
    assert wider.estimate.status_words.startswith("the search converged; models that are about as likely leave ")
    assert found.estimate.status_words == "the search converged and the data determine every parameter"


def test_what_a_wrong_model_pulls_at_has_no_deviation(tmp_path):
    ready, result = building(tmp_path, 1, upper=0.85 * UPPER)
    assert not is_sound(result.identification)
    held = fixed_value_sensitivities(TestedModel(ready.setups, ready.study.options), result.identification)
    assert len(held) == 3
    assert all(np.isnan(one.pull_std) and np.isfinite(one.influence).all() for one in held)
    assert not doubted(held)
