"""Causes that several candidates share: sensors of one card, a foot that lets go of all rotations, a mass on the other side."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from frame_cases import FREQUENCY, STUDY, off, written, written_modes
from test_each_cause import begun
from test_explain import answered

from structid.diagnose.causes import (
    FaultyChannel,
    FixedValue,
    LoadGain,
    Mass,
    MassOffset,
    SensorDelay,
    SensorPolarity,
    candidates,
)
from structid.diagnose.causes.separate_element import DifferingElement, DifferingProperty
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel, fit_fully, fit_near, restore_fit
from structid.diagnose.score_test import Screened
from structid.diagnose.screening import _feet, _misplaced, _of_one_card, _of_whole_sets, _off_otherwise, _turned
from structid.diagnose.search import _weighed
from structid.diagnose.tested_model import TestedModel
from structid.inversion.search.work import PLAIN_CONTEXT
from structid.records import FrfRecord
from structid.records.formats import read_record, write_record
from structid.study.run.diagnosis import suggestion_text
from structid.study.run.start import prepare_study, study_problems
from structid.study.schema.study import load_study

SPACE = """\
title = "Portal in space"

[structure]
fixed = ["1", "5"]

[structure.nodes]
1 = [0.0, 0.0, 0.0]
2 = [0.0, 0.0, 1.0]
3 = [0.4, 0.0, 1.1]
4 = [0.8, 0.0, 1.0]
5 = [0.8, 0.3, 0.0]

[[structure.space_beam]]
name = "legs"
nodes = [[1, 2], [5, 4]]
mass = 1.2
polar_inertia = 1e-4
bending_stiffness_y = 300.0
bending_stiffness_z = 300.0
axial_stiffness = 2e5
torsional_stiffness = 230.0
loss_factor = 0.02

[[structure.space_beam]]
name = "girder"
nodes = [[2, 3], [3, 4]]
mass = 2.0
polar_inertia = 2e-4
bending_stiffness_y = 500.0
bending_stiffness_z = 400.0
axial_stiffness = 3e5
torsional_stiffness = 300.0
loss_factor = 0.02

[[unknown]]
property = "mass"
elements = "legs"

[[unknown]]
property = "mass"
elements = "girder"

[record]
path = "frf.npz"

[record.noise]
relative = 0.01
absolute = 1e-7

[method]
restarts = 0
"""


def written_in_space(folder, truth, loads=((1.0, 0.0), (0.0, 1.0))):
    """The study, and its record from a true one; `loads` are what the two loads are along X and Y, a row each."""
    outputs, frequency = ["2X", "2Y", "3Z", "4X", "4Y"], np.linspace(2.0, 80.0, 150)
    record = partial(FrfRecord, frequency, outputs=outputs, inputs=["3X", "3Y"], kind="receptance")
    write_record(folder / "frf.npz", record(np.ones((150, 5, 2), complex)))
    path = folder / "study.toml"
    path.write_text(truth, encoding="utf-8")
    [problem] = study_problems(load_study(path))
    values, rng = problem.predicted(problem.theta_start) @ np.transpose(loads), np.random.default_rng(2)
    noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    write_record(folder / "frf.npz", record(values + noise / np.sqrt(2) * np.hypot(0.01 * np.abs(values), 1e-7)))
    path.write_text(SPACE, encoding="utf-8")
    return path


@pytest.mark.long
@pytest.mark.parametrize("late", [["2X", "5Y"], ["2X", "3X", "5Y"]])
def test_sensors_of_one_late_card_are_named_together(tmp_path, late):
    path = written(tmp_path, off())
    record = read_record(tmp_path / "frf.npz")
    is_late = np.array([f"{dof}".rstrip("+") in late for dof in record.outputs])
    values = record.values * np.exp(-2j * np.pi * record.frequency[:, None, None] * 2e-3 * is_late[:, None])
    write_record(tmp_path / "frf.npz", replace(record, values=values))
    result, _ = answered(path)
    first = result.diagnosis.causes[0]
    assert (first.kind, sorted(first.where)) == ("delay", late)
    assert first.chi_square_per_dof < 1.2
    [(_, value, unit)] = first.found
    assert unit == "s"
    assert value == pytest.approx(2e-3, rel=0.05)
    assert "+ [[record.channel_error]]" in first.lines


@pytest.mark.long
def test_a_foot_that_lets_go_of_all_rotations_is_named_whole(tmp_path):
    path = written_in_space(tmp_path, SPACE.replace('fixed = ["1", "5"]', 'fixed = ["1 X Y Z", "5"]'))
    result, _ = answered(path)
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("support", ("1RX", "1RY", "1RZ"))
    assert first.chi_square_per_dof < 1.2
    assert "the supports 1RX, 1RY, 1RZ are flexible" in first.words
    assert '+ first = ["1RX", "1RY", "1RZ"]' in first.lines
    assert any(line.startswith("+ fixed") and '"1 X Y Z"' in line for line in first.lines)


def test_a_fixed_value_of_a_set_is_tried_where_one_of_its_elements_looks_different(tmp_path):
    base = begun(written_in_space(tmp_path, SPACE))

    def differing(element, prop):
        return DifferingElement(where=(element,), properties=(DifferingProperty(element, prop),))

    screened = [("girder:2", "axial_stiffness"), ("girder:1", "axial_stiffness"), ("girder:1", "mass")]
    rows = [Screened(differing(*what), 0.4, float(rank)) for rank, what in enumerate(screened)]
    assert [(row.candidate.where, row.left) for row in _of_whole_sets(base, rows)] == [
        (("axial_stiffness[girder]",), 0.0)
    ]
    assert _of_whole_sets(base, rows[2:]) == []  # the mass is an unknown already


def test_a_foot_lets_go_of_all_rotations_at_once(tmp_path):
    path = written_in_space(tmp_path, SPACE)
    right = begun(path).modified
    feet = _feet(candidates(right.point_at(right.shown_problems, right.target.theta_start).records), 10.0)
    groups = [row.candidate.where for row in feet]
    assert groups[:3] == [("1RX", "5RX"), ("1RY", "5RY"), ("1RZ", "5RZ")]
    assert sorted(groups[3]) == ["1RX", "1RY", "1RZ", "5RX", "5RY", "5RZ"]
    assert groups[4:] == [("1RX", "1RY", "1RZ"), ("5RX", "5RY", "5RZ")]
    foot = feet[4]
    pinned = foot.candidate
    written_in_space(tmp_path, SPACE.replace('fixed = ["1", "5"]', 'fixed = ["1 X Y Z", "5"]'))
    base = begun(path)
    near = fit_near(base, (pinned, foot.strength, ()), PLAIN_CONTEXT)
    fitted = restore_fit(base, pinned, fit_fully(base, (pinned, foot.strength, near["theta"]), PLAIN_CONTEXT))
    assert fitted.chi_square < 1.2 * base.modified.target.n_data < 0.01 * base.chi_square
    assert pinned.sentence(None) == "the supports 1RX, 1RY, 1RZ are flexible"
    _, lines = suggestion_text(load_study(path), fitted.modified.changes)
    assert '+ first = ["1RX", "1RY", "1RZ"]' in lines


def test_sensors_that_are_better_left_out_may_be_elsewhere_or_turned_and_loads_elsewhere(tmp_path):
    """At the nearest nodes that move along and have no channel of that direction yet."""
    base = begun(written(tmp_path))
    lost = [Screened(FaultyChannel(where=(place,), record=0), 1.0, 10.0) for place in ("2X", "4Y")]
    misplaced = [(row.candidate.kind, row.candidate.where) for row in _misplaced(base, lost)]
    assert sorted(misplaced) == [
        ("load_place", ("4Y", "2Y")), ("load_place", ("4Y", "3Y")), ("load_place", ("4Y", "5Y")),
        ("place", ("2X", "4X")), ("place", ("2X", "5X")), ("place", ("4Y", "2Y")), ("place", ("4Y", "3Y")),
    ]  # fmt: skip
    known = [Screened(SensorPolarity(where=("2X",), record=0), 1.0, 10.0)]
    assert [(row.candidate.kind, row.candidate.where) for row in _turned(known, lost)] == [("polarity", ("4Y",))]


def test_a_mass_off_its_node_is_looked_at_on_both_sides_and_nearer():
    row = Screened(MassOffset(where=("box:1", "Z")), -0.08, 10.0)
    other = Screened(Mass(where=("3",)), 1.0, 5.0)
    assert [one.strength for one in _off_otherwise([other, row])] == pytest.approx([0.08, -0.02, 0.02])


def test_only_delays_of_one_record_and_about_one_time_go_together():
    def late(where, strength, record=0):
        return Screened(SensorDelay(where=(where,), record=record), strength, 1.0)

    rows = [late("1X", 2e-3), late("2X", -2e-3), late("3X", 1.8e-3), late("4X", 9e-3), late("5X", 2e-3, record=1)]
    [found] = _of_one_card(rows)
    assert (found.candidate.where, found.strength) == (("1X", "3X"), pytest.approx(1.9e-3))
    assert _of_one_card(rows[:2]) == []
    sentence = found.candidate.sentence
    assert sentence(None) == "sensors 1X, 3X are late or early by one time, as of one card"
    assert sentence(1e-3) == "sensors 1X, 3X are late by one time, as of one card"
    assert sentence(-1e-3) == "sensors 1X, 3X are early by one time, as of one card"


@pytest.mark.long
@pytest.mark.parametrize(("kind", "where"), [("place", ("2X", "3X")), ("load_place", ("4Y", "5Y"))])
def test_a_sensor_or_a_load_at_another_node_is_named(tmp_path, kind, where):
    """The record says 2X for the sensor at 3X, or 4Y for the load at 5Y."""
    outputs, inputs = ["2X", "4Y", "5Y"], ["4Y"]
    seen = [where[1] if kind == "place" and one == where[0] else one for one in outputs]
    driven = [where[1] if kind == "load_place" else one for one in inputs]
    path, rng = written(tmp_path), np.random.default_rng(3)
    blank = np.ones((len(FREQUENCY), 3, 1), complex)
    write_record(tmp_path / "frf.npz", FrfRecord(FREQUENCY, blank, seen, driven, "receptance"))
    [problem] = study_problems(load_study(path))
    values = problem.predicted(problem.theta_start)
    noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    values = values + noise / np.sqrt(2) * np.hypot(0.01 * np.abs(values), 1e-6)
    write_record(tmp_path / "frf.npz", FrfRecord(FREQUENCY, values, outputs, inputs, "receptance"))
    path.write_text(off(), encoding="utf-8")
    result, _ = answered(path)
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == (kind, where)
    assert first.chi_square_per_dof < 1.2
    assert "relabel" in " ".join(first.lines)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["place", "load_place"])
def test_a_sensor_or_a_load_between_two_nodes_is_named_with_where_it_is(tmp_path, kind):
    """The record says 4Y for what is at a third of the way to node 3: the girder's cubic, by Hermite's polynomials from node 3."""
    x, length = 2 / 3, 0.6
    cubic = [1 - 3 * x**2 + 2 * x**3, length * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, length * (x**3 - x**2)]
    follows = [[dof, weight] for dof, weight in zip(["3Y", "3RZ", "4Y", "4RZ"], cubic, strict=True)]
    at = f'[[structure.constraint]]\nname = "at"\ndependent = "7Y"\ndepends_on = {follows}\n'
    truth = STUDY.replace("\n6 = ", "\n7 = [0.4, 1.0]\n6 = ").replace("fixed = [", 'fixed = ["7X", "7RZ", ') + at
    outputs, seen = ["2X", "3X", "4Y", "5Y"], ["2X", "3X", "7Y" if kind == "place" else "4Y", "5Y"]
    path, rng = written(tmp_path, truth, truth), np.random.default_rng(4)
    blank = np.ones((len(FREQUENCY), 4, 1), complex)
    driven = ["7Y" if kind == "load_place" else "4Y"]
    write_record(tmp_path / "frf.npz", FrfRecord(FREQUENCY, blank, seen, driven, "receptance"))
    [problem] = study_problems(load_study(path))
    values = problem.predicted(problem.theta_start)
    noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    values = values + noise / np.sqrt(2) * np.hypot(0.01 * np.abs(values), 1e-6)
    write_record(tmp_path / "frf.npz", FrfRecord(FREQUENCY, values, outputs, ["4Y"], "receptance"))
    path.write_text(off(), encoding="utf-8")
    result, fits = answered(path)
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == (kind, ("4Y", "3Y"))
    assert first.chi_square_per_dof < 1.2
    assert "between its node and that of 3Y" in first.words
    assert fits[0].modified.changes[0][1] == pytest.approx(1 / 3, abs=0.01)


@pytest.mark.long
def test_a_sensor_of_the_wrong_sense_in_modes_is_named_as_that(tmp_path):
    result, _ = answered(written_modes(tmp_path, {"4X": -1.0}))
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("polarity", ("4X",))
    assert first.chi_square_per_dof < 1.2


@pytest.mark.long
def test_a_material_that_is_wrong_in_all_sets_is_named_as_one(tmp_path):
    """All beams are 12 % heavier than the study says, which holds their masses; each alone explains a part."""
    mass = STUDY[STUDY.rindex("[[unknown]]") : STUDY.index("# how the test")]
    truth = STUDY.replace("mass = 4.0", "mass = 4.48").replace("mass = 3.0", "mass = 3.36")
    result, _ = answered(written(tmp_path, off(STUDY.replace(mass, "")), truth))
    first = result.diagnosis.causes[0]
    assert (first.kind, set(first.where)) == ("untied", {"mass[left]", "mass[girder]", "mass[right]"})
    [(_, factor, unit)] = first.found
    assert (factor, unit) == (pytest.approx(1.12, rel=0.01), "1")
    assert "are off by one factor" in first.words


@pytest.mark.long
def test_a_sensor_that_is_dead_is_not_said_to_be_off_by_a_factor(tmp_path):
    """It reads noise alone: a gain near 0 would leave it out as well."""
    path = written(tmp_path, off())
    record = read_record(tmp_path / "frf.npz")
    values, rng = np.array(record.values), np.random.default_rng(5)
    values[:, 1] = 0.3 * np.abs(values[:, 1]).max() * rng.standard_normal(values[:, 1].shape)
    write_record(tmp_path / "frf.npz", replace(record, values=values))
    result, _ = answered(path)
    assert (result.diagnosis.causes[0].kind, result.diagnosis.causes[0].where) == ("channel", ("3X",))
    assert "sensor_gain" not in {one.kind for one in result.diagnosis.causes}


@pytest.mark.long
def test_a_drive_that_is_turned_is_named_with_its_direction(tmp_path):
    """A shaker 12 degrees off its axis; no place and no calibration of it says the same."""
    angle = np.radians(12.0)
    path = written_in_space(tmp_path, SPACE, ((np.cos(angle), np.sin(angle)), (0.0, 1.0)))
    result, _ = answered(path)
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("direction", ("3X", "3Y"))
    assert first.words == "the force at 3X is turned towards 3Y"
    assert first.chi_square_per_dof < 1.2
    [aimed] = [line for line in first.lines if line.startswith("+ depends_on")]
    cosine, sine = (float(text) for text in re.findall(r", (-?[\d.]+)\]", aimed))
    assert np.degrees(np.arctan2(sine, cosine)) == pytest.approx(12.0, abs=0.3)
    assert '+ relabel = { "load 3X" = "6X" }' in first.lines


def test_all_held_masses_give_way_to_the_calibration_of_the_load_that_says_the_same(tmp_path):
    """Where the masses of all sets are held, a factor on them is one on the load: the fits have one misfit, to rounding."""
    mass = STUDY[STUDY.rindex("[[unknown]]") : STUDY.index("# how the test")]
    free = "".join(
        f'[[unknown]]\nproperty = "{prop}"\nelements = "{name}"\n\n'
        for prop, name in (("bending_stiffness", "right"), ("stiffness", "brace"))
    )
    path = written(tmp_path, STUDY.replace(mass, free))
    ready = prepare_study(load_study(path))
    theta = ready.problems[0].theta_start
    base = FittedModel(base_model(TestedModel(ready.setups, ready.study.options), ready.problems, theta), theta, 1e4)
    sets = FixedValue(where=("mass[left]", "mass[girder]", "mass[right]"))
    fits = [
        FittedModel(trial, trial.target.theta_start, 500.0 + rounding)
        for one, rounding in ((sets, 0.0), (LoadGain(where=("4Y",)), 1e-5))
        for trial in [base.modified.changed(one, 1.0)]
    ]
    assert [one.cause.kind for one in _weighed(base, fits, 100).causes] == ["load_gain", "held"]
