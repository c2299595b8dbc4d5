"""Each kind of cause on one small frame that has it: ranked first, its fit alone explains all, its study is the right one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from frame_cases import STUDY, written, written_shaken

from structid.diagnose.causes import CAUSES, DERIVED, candidates, data_candidates, rows_left_out, set_candidates
from structid.diagnose.causes.delay import SensorDelay
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel, fit_fully, restore_fit
from structid.diagnose.screening import screen_sets
from structid.diagnose.tested_model import TestedModel
from structid.inversion.search.work import PLAIN_CONTEXT, SERIAL
from structid.records.formats import read_record, write_record
from structid.study.run.diagnosis import suggestion_text
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

PUMPED = STUDY.replace(
    "[[unknown]]", '[[structure.point_mass]]\nname = "pump"\nnodes = [4]\nmass = 0.8\n\n[[unknown]]', 1
)
#: Kind, place, strength of the fault, what the fit of it adds, and its words.
FAULTS = [
    ("support", ("6RZ",), 1 / 900, [900.0], "the support 6RZ is flexible"),
    ("spring", ("2X",), 3000.0, [3000.0], "something holds 2X: a spring to the ground"),
    ("dashpot", ("3X",), 60.0, [60.0], "a damper acts at 3X"),
    ("dashpot", ("2X", "4X"), 90.0, [90.0], "a damper acts between 2X and 4X"),
    ("friction", ("2X",), 0.05, [0.05], "something rubs at 2X"),
    ("mass", ("4",), 0.07, [0.07], "a mass at node 4 is missing in the model"),
    ("mass", ("4",), -0.05, [-0.05], "a mass at node 4 is too much in the model"),
    (
        "sensor_mass",
        ("2", "3", "4", "5"),
        0.02,
        [0.02],
        "each sensor has a mass that is missing in the model: at nodes 2, 3, 4 and 1 more",
    ),
    ("inertia", ("4RZ",), 0.05, [0.05], "a rotary inertia at 4RZ is missing in the model"),
    ("offset", ("pump:1", "X"), 0.1, [], "the mass pump:1 sits off its node along X"),
    (
        "appendage",
        ("4Y",),
        0.1,
        None,
        "a loose part or a cable resonates at 4Y",
    ),
    ("joint", ("girder:1", "3RZ"), 1 / 20000, [20000.0], "the end of girder:1 at 3RZ turns against its node"),
    ("untied stiffness", ("left:1",), -0.3, [0.7], "the stiffness of left:1 is not that of its group"),
    ("untied mass", ("girder:2",), 0.4, [1.4], "the mass of girder:2 is not that of its group"),
    ("untied set", ("left",), 0.05, [1.05], "the mass of all of left is not that of its group"),
    ("sensor_gain", ("3X",), np.log(1.5), [1.5], "the calibration of sensor 3X is off by a factor of 1.5"),
    ("load_gain", ("4Y",), np.log(0.8), [1.25], "the calibration of the force at 4Y is off by a factor of 1.25"),
    ("delay", ("5Y",), 1e-3, [1e-3], "sensor 5Y is late"),
    ("load_delay", ("4Y",), 1e-3, [-1e-3], "the force at 4Y is early"),
    ("polarity", ("3X",), 1.0, [], "sensor 3X reads with the opposite sense"),
    ("swap", ("2X", "5Y"), 1.0, [], "the cables of 2X and 5Y are exchanged"),
    ("direction", ("3X", "3Y"), 0.2, [], "sensor 3X is turned towards 3Y"),
    ("load_direction", ("4Y", "4X"), 0.2, [], "the force at 4Y is turned towards 4X"),
    ("place", ("2X", "4X"), 1.0, [], "sensor 2X sits at 4X"),
    ("load_place", ("4Y", "5Y"), 1.0, [], "the force at 4Y acts at 5Y"),
    ("between", ("4Y", "3Y"), 0.3, [], "sensor 4Y sits between its node and that of 3Y"),
    ("load_between", ("4Y", "3Y"), 0.3, [], "the force at 4Y acts between its node and that of 3Y"),
]


#: Changes of sets and records, with how much less noise shows each, and words.
OF_SETS = [
    ("mesh", ("all lines",), 0.02, "the mesh is too coarse for the highest frequencies"),
    ("shear", ("girder",), 0.1, "girder shears: it is no slender beam"),
    ("damping_law", ("right", "viscous"), 0.1, "damping of right is viscous"),
    ("held", ("bending_stiffness[right]",), 0.3, "bending_stiffness[right], fixed in the study, differs from its stated value"),
    ("axial_force", ("girder",), 0.1, "girder carries an axial force that the model lacks"),
    ("node_place", ("2",), 0.3, "node 2 is elsewhere along its line than drawn: a length is wrong"),
    ("window", ("all channels",), 1.0, "the records were windowed, which adds damping"),
    ("leakage", ("all channels",), 1.0, "resonances leak into the lines beside them: averages of segments of random motion"
        " under a Hann window"),
]  # fmt: skip
#: Kinds that no look is taken at: they follow from the look at another kind.
NOT_LOOKED_AT = tuple(kind.kind for kind in DERIVED)
#: Kinds whose strength is no parameter but a number in the study.
NUMBERS = ("offset", "direction", "load_direction", "between", "load_between")


#: Kinds whose faults have tests of their own: of several loads, records or modes, of histories, of left out data, of clocks,
#: of beams in space.
ELSEWHERE = {
    "load_polarity", "load_swap", "channel", "record", "outlying_lines", "tone", "extra_mode", "varies", "clock",
    "turned_section", "record_gain",
}  # fmt: skip


def test_every_kind_of_cause_has_a_fault():
    here = {kind.split()[0] if kind != "untied set" else kind for kind, *_ in (*FAULTS, *OF_SETS)}
    assert here | ELSEWHERE == {kind.kind for kind in CAUSES}
    assert not here & ELSEWHERE


def begun(path):
    """The study that stands there, with its record, at its starts: the fit without a cause."""
    ready = prepare_study(load_study(path))
    theta = ready.problems[0].theta_start
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, theta)
    residual = trial.target.residual(theta)
    return FittedModel(trial, theta, float(residual @ residual))


def written_like(folder, changed, noise=1.0):
    """The record of a changed study, with so much of the stated noise."""
    [view] = changed.views
    values, rng = view.problem.predicted(view.problem.theta_start), np.random.default_rng(1)
    errors = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    values = values + noise * errors / np.sqrt(2) * np.hypot(0.01 * np.abs(values), 1e-6)
    write_record(folder / "frf.npz", replace(read_record(folder / "frf.npz"), values=values))


def require_first(base, kind, where):
    """Among all changes that are looked at, beside the right values, this one leaves least; at a clamped foot a joint as much."""
    point = base.modified.point_at(base.modified.shown_problems, base.theta + 0.002)
    rows = point.screened(candidates(point.records))
    first = min(rows, key=lambda row: row.left * (1 + 1e-9 * (row.candidate.place[0] != kind)))
    assert (first.candidate.place[0], first.candidate.where) == (kind, where)


def require_explained(base, candidate, strength, folder):
    """The fit of a cause alone, which explains all; its study as text is the one that was fitted."""
    theta = base.modified.changed(candidate, strength).theta_of(base.values)
    fitted = restore_fit(base, candidate, fit_fully(base, (candidate, strength, theta), PLAIN_CONTEXT))
    if fitted.cause.where == candidate.where:  # its model is the cached one
        assert fitted.modified is base.modified.changed(candidate, fitted.modified.changes[-1].strength)
    n_data = base.modified.target.n_data
    assert fitted.chi_square - fitted.left_out == pytest.approx(
        fitted.modified.target.n_data, abs=4 * np.sqrt(2 * n_data)
    )
    std = dict(zip(fitted.modified.target.names, np.sqrt(np.diag(fitted.covariance)), strict=True))
    for name, value in base.values.items():
        if name in std:
            assert fitted.values[name] == pytest.approx(value, abs=4 * std[name]), name
    text, lines = suggestion_text(load_study(folder / "study.toml"), fitted.modified.changes)
    (folder / "again.toml").write_text(text, encoding="utf-8")
    again = prepare_study(load_study(folder / "again.toml"))
    [problem] = again.problems
    assert problem.names == fitted.modified.target.names
    residual = problem.residual(fitted.theta)
    assert residual @ residual == pytest.approx(fitted.chi_square - fitted.left_out, rel=1e-6)
    assert lines
    return fitted, std


@pytest.mark.parametrize(("kind", "where", "strength", "added", "words"), FAULTS)
def test_a_fault_ranks_first_and_its_fit_alone_explains_all(tmp_path, kind, where, strength, added, words):
    right = begun(written(tmp_path, PUMPED, PUMPED, seed=None)).modified
    offered = candidates(right.point_at(right.shown_problems, right.target.theta_start).records)
    offered += [kind(where=where, record=0) for kind in DERIVED]
    one = next(one for one in offered if (one.place[0], one.where) == (kind, where))
    if kind == "appendage":
        one = replace(one, frequency=25.0)
    written_like(tmp_path, right.changed(one, strength))
    base = begun(tmp_path / "study.toml")
    if kind not in NOT_LOOKED_AT:
        require_first(base, kind, where)
    begin = strength if len(one.strengths) == 1 else 0.85 * strength
    fitted, std = require_explained(base, one, begin, tmp_path)
    found = [(name, value) for name, value in fitted.values.items() if name not in base.values]
    if added is not None:
        for (name, value), expected in zip(found, added, strict=True):
            assert value == pytest.approx(expected, abs=4 * std[name])
            assert std[name] < 0.6 * abs(expected)
    if kind in NUMBERS:
        assert fitted.modified.changes[-1].strength == pytest.approx(strength, rel=0.03)
    assert one.sentence(added[0] if added else None) == words


@pytest.mark.parametrize(
    ("kind", "where", "strength", "added"),
    [("support", ("6RZ",), 1 / 40000, 40000.0), ("support", ("6X",), 1e-7, 1e7), ("mass", ("4",), 0.02, 0.02)],
)
def test_a_fault_of_a_frame_on_a_table_ranks_first_and_explains_all(tmp_path, kind, where, strength, added):
    """The table moves both feet; one of them hangs on it by a spring, or a mass is missing."""
    right = begun(written_shaken(tmp_path, seed=None)).modified
    offered = candidates(right.point_at(right.shown_problems, right.target.theta_start).records)
    one = next(one for one in offered if (one.place[0], one.where) == (kind, where))
    written_like(tmp_path, right.changed(one, strength))
    base = begun(tmp_path / "study.toml")
    require_first(base, kind, where)
    fitted, std = require_explained(base, one, 0.85 * strength, tmp_path)
    [(name, value)] = [pair for pair in fitted.values.items() if pair[0] not in base.values]
    assert value == pytest.approx(added, abs=4 * std[name])
    assert std[name] < 0.5 * added


@pytest.mark.parametrize(("kind", "where", "noise", "words"), OF_SETS)
def test_a_change_of_sets_ranks_first_by_one_step_and_its_fit_alone_explains_all(tmp_path, kind, where, noise, words):
    text = STUDY.replace("relative = 0.01\nabsolute = 1e-6", f"relative = {0.01 * noise}\nabsolute = {1e-6 * noise}")
    right = begun(written(tmp_path, text, text, seed=None)).modified
    one = next(one for one in set_candidates(right.model, right.problems) if (one.kind, one.where) == (kind, where))
    if kind == "held":
        truth = text.replace("bending_stiffness = 550.0", "bending_stiffness = 555.0")
        written_like(tmp_path, begun(written(tmp_path, truth, truth, seed=None)).modified, noise)
        (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    elif kind == "node_place":  # node 2 is 10 mm higher
        truth = text.replace("2 = [0.0, 0.5]", "2 = [0.0, 0.51]")
        written_like(tmp_path, begun(written(tmp_path, truth, truth, seed=None)).modified, noise)
        (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    else:
        written_like(tmp_path, right.changed(one, float(one.strengths[0])), noise)
    base = begun(tmp_path / "study.toml")
    first = min(screen_sets(base, SERIAL, "changes of the study")[0], key=lambda row: row.left)
    assert (first.candidate.place[0], first.candidate.where) == (kind, where)
    require_explained(base, one, first.strength, tmp_path)
    assert one.sentence(None) == words


def test_sensors_that_are_late_together_and_a_dead_one_explain_all_alone(tmp_path):
    right = begun(written(tmp_path, seed=None)).modified
    card = SensorDelay(where=("2X", "5Y"), record=0)
    written_like(tmp_path, right.changed(card, 2e-3))
    fitted, std = require_explained(begun(tmp_path / "study.toml"), card, 1.5e-3, tmp_path)
    [(name, late)] = [pair for pair in fitted.values.items() if pair[0].startswith("delay")]
    assert late == pytest.approx(2e-3, abs=4 * std[name])
    assert card.sentence(late) == "sensors 2X, 5Y are late by one time, as of one card"
    written_like(tmp_path, right)
    record = read_record(tmp_path / "frf.npz")
    values, rng = np.array(record.values), np.random.default_rng(5)
    values[:, 1] = 0.3 * np.abs(values[:, 1]).max() * rng.standard_normal(values[:, 1].shape)
    write_record(tmp_path / "frf.npz", replace(record, values=values))
    base = begun(tmp_path / "study.toml")
    point = base.modified.point_at(base.modified.shown_problems, base.theta)
    problems = [fields.problem for fields in point.records]
    left = {one.where: point.without(rows_left_out(one, problems)) for one in data_candidates(problems, [""])}
    assert min(left, key=left.__getitem__) == ("3X",)
    assert left["3X",] < 0.5 * min(row.left for row in point.screened(candidates(point.records)))
    [dead] = [one for one in data_candidates(problems, [""]) if one.where == ("3X",)]
    require_explained(base, dead, 1.0, tmp_path)
