"""What a study with a wrong model or record says: the verdict, the cause first, and a study that is right."""

import json
from dataclasses import replace
from types import SimpleNamespace as Parts

import numpy as np
import pytest
from frame_cases import BASE, STUDY, of_histories, off, shaken, written, written_histories, written_modes
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.dof import parse_dof
from structid.core.errors import InputError
from structid.diagnose.causes import LoadGain, OutlyingLines, SensorGain
from structid.diagnose.checks.initial_comparison import ChannelWarnings
from structid.diagnose.data_rows import scaled_misfit
from structid.diagnose.model_edits import AimSensor
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel
from structid.diagnose.screening import _exchanged, _faulty
from structid.diagnose.search import _begun
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.verdict import Cause, ParameterShift, are_causes, judged
from structid.records.formats import read_record, write_record
from structid.study.run.diagnosis import diagnose_study, suggestion_text
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

RUN = CliRunner()

#: What is otherwise in truth, what the study has, kind and place of the cause.


def _with(part: str, text: str = STUDY) -> str:
    return text.replace("[[unknown]]", f"[[structure.{part}\n\n[[unknown]]", 1)


_FOOTING = 'spring]]\nname = "footing"\nfirst = "6RZ"\nstiffness = 900.0'
_FORGOTTEN = 'point_mass]]\nname = "forgotten"\nnodes = [4]\nmass = 0.4'
SOFT = _with(_FOOTING, STUDY.replace('"6RZ"]', "]"))
HEAVY = _with(_FORGOTTEN)
DISC = _with('rotary_inertia]]\nname = "disc"\nnodes = [4]\ndirection = "RZ"\nrotary_inertia = 0.05')
DAMPED = _with('dashpot]]\nname = "damper"\nfirst = "3X"\nviscous_damping = 1500.0')
LOOSE = _with('joint]]\nname = "bolt"\nelement = "girder:1"\nat = "3RZ"\nstiffness = 2500.0')
WEAK = STUDY.replace("bending_stiffness = 800.0", "bending_stiffness = [800.0, 350.0]")
#: The right foot hangs on the table by a spring.
LIFTED = _with('spring]]\nname = "pad"\nfirst = "7X"\nsecond = "6X"\nstiffness = 4e4', shaken(STUDY)).replace(
    '"6X", "6Y"', '"7X", "6Y"'
)
LIFTED = LIFTED.replace('["1X", "6X"]', '["1X", "7X"]').replace("6 = [1.2, 0.0]", "6 = [1.2, 0.0]\n7 = [1.2, 0.0]")
FAULTS = {
    "support": (SOFT, "support", "6RZ"),
    "mass": (HEAVY, "mass", "4"),
    "inertia": (DISC, "inertia", "4RZ"),
    "dashpot": (DAMPED, "dashpot", "3X"),
    "joint": (LOOSE, "joint", "girder:1/3RZ"),
    "untied": (WEAK, "untied", "girder:2"),
    "support, shaken": (shaken(SOFT), "support", "6RZ"),
    "mass, shaken": (shaken(HEAVY), "mass", "4"),
    "foot, shaken": (LIFTED, "support", "6X"),
}


def answered(path, explain=None):
    ready = prepare_study(load_study(path))
    return diagnose_study(ready, run_prepared(ready), explain)


@pytest.mark.parametrize(
    "fault", [pytest.param(one, marks=() if one == "support" else pytest.mark.long) for one in FAULTS]
)
def test_the_cause_is_named_first_and_its_study_is_right(tmp_path, fault):
    truth, kind, where = FAULTS[fault]
    study = shaken(off()) if BASE in truth else off()
    result, fits = answered(written(tmp_path, study, truth))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    alike = [cause for cause in result.diagnosis.causes if cause.is_alike]
    assert len({cause.words for cause in result.diagnosis.causes}) == len(result.diagnosis.causes)
    assert (kind, (where,)) in [(cause.kind, cause.where) for cause in alike]
    assert result.diagnosis.causes[0].is_alike
    assert result.diagnosis.causes[0].kind == "support" or kind != "support"  # not the joint there, which is the same
    assert result.diagnosis.causes[0].chi_square_per_dof < 1.2
    text, lines = suggestion_text(result.study, fits[0].modified.changes)
    assert "# how the test was made" in text  # comments stay
    assert all(line[0] in "+-" for line in lines)
    again = tmp_path / "again.toml"
    again.write_text(text, encoding="utf-8")
    better, _ = answered(again)
    assert better.diagnosis.judgement.verdict == "sound"
    # each weighed by what its own model has of noise that goes with size
    assert better.identification.estimate.goodness.chi_square == pytest.approx(fits[0].chi_square, rel=3e-3)
    right, wide = (by_name(one.identification) for one in (better, result))
    for one in result.diagnosis.causes[0].moved:
        assert one.interval == pytest.approx(right[one.name], rel=1e-3)
        assert wide[one.name][0] <= one.interval[0] < one.interval[1] <= wide[one.name][1]
        assert abs(one.after - one.before) < 3 * result.identification.estimate[one.name][1]
    assert "would explain the misfit about as well" in result.identification.intervals.notes[-1]
    assert "not all" not in result.diagnosis.judgement.words
    assert not any(cause.is_second for cause in result.diagnosis.causes)


def by_name(found):
    """95 % intervals of an identification."""
    return dict(zip(found.estimate.names, found.intervals.ends.tolist(), strict=True))


@pytest.mark.parametrize(
    ("column", "gain", "kind", "where"),
    [(2, 0.85, "sensor_gain", "3X"), (4, 1 / 9.80665, "unit", "5Y")],
)
@pytest.mark.long
def test_a_gain_or_unit_in_histories_is_named_first_and_its_study_is_right(tmp_path, column, gain, kind, where):
    result, fits = answered(written_histories(tmp_path, of_histories(off()), gains={column: gain}))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == (kind, (where,))
    assert not [cause for cause in result.diagnosis.causes[1:] if cause.is_alike]
    text, _ = suggestion_text(result.study, fits[0].modified.changes)
    again = tmp_path / "again.toml"
    again.write_text(text, encoding="utf-8")
    better, _ = answered(again)
    assert better.diagnosis.judgement.verdict == "sound"
    value, std = better.identification.estimate[f"gain[{where}+]"]
    assert value == pytest.approx(gain, abs=4 * std)


@pytest.mark.long
def test_mains_in_histories_are_named_first_and_their_study_is_right(tmp_path):
    result, fits = answered(written_histories(tmp_path, of_histories(off()), hum=0.3))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first, *others = result.diagnosis.causes
    assert first.kind == "outlying_lines"
    assert [float(one.removesuffix(" Hz")) for one in first.where] == pytest.approx([25.0065, 50.013], abs=1e-3)
    assert not [cause for cause in others if cause.is_alike]
    text, _ = suggestion_text(result.study, fits[0].modified.changes)
    again = tmp_path / "again.toml"
    again.write_text(text, encoding="utf-8")
    assert "tones = [" in text
    assert answered(again)[0].diagnosis.judgement.verdict == "sound"


@pytest.mark.long
def test_a_gain_in_modes_is_named_first_and_its_study_is_right(tmp_path):
    result, fits = answered(written_modes(tmp_path, gains={"4Y": 0.8}))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("sensor_gain", ("4Y",))
    text, _ = suggestion_text(result.study, fits[0].modified.changes)
    again = tmp_path / "again.toml"
    again.write_text(text, encoding="utf-8")
    better, _ = answered(again)
    assert better.diagnosis.judgement.verdict == "sound"
    value, std = better.identification.estimate["gain[4Y+]"]
    assert value == pytest.approx(0.8, abs=4 * std)


@pytest.mark.long
@pytest.mark.parametrize("search", ["brief", "whole"])
def test_errors_of_modes_that_are_stated_too_small_are_no_mode_of_another_structure(tmp_path, request, search):
    if search == "brief":
        request.getfixturevalue("brief")
    result, _ = answered(written_modes(tmp_path, error=6.0))
    assert result.diagnosis.judgement.verdict == "approximate"
    assert [cause.kind for cause in result.diagnosis.causes] == ["noise_level"]


@pytest.mark.long
def test_a_right_model_of_histories_is_sound_and_has_no_cause(tmp_path):
    result, _ = answered(written_histories(tmp_path, of_histories(off())), explain=True)
    assert result.diagnosis.judgement.verdict == "sound"
    assert result.diagnosis.causes == ()


@pytest.mark.long
def test_a_right_model_is_sound_and_has_no_cause(tmp_path):
    result, _ = answered(written(tmp_path, off()), explain=True)
    assert result.diagnosis.judgement.verdict == "sound"
    assert result.diagnosis.causes == ()
    assert result.diagnosis.n_tried > 200


def test_noise_stated_too_small_is_said_and_is_no_wrong_model(tmp_path):
    text = off().replace("relative = 0.01", "relative = 0.002").replace("absolute = 1e-6", "absolute = 2e-7")
    result, _ = answered(written(tmp_path, text))
    assert result.diagnosis.judgement.verdict == "approximate"
    [cause] = result.diagnosis.causes
    assert cause.kind == "noise_level"
    assert "5.0" in cause.words or "4.9" in cause.words


@pytest.mark.parametrize("is_exchanged", [True, False])
def test_exchanged_cables_show_beside_a_start_that_is_far_off(tmp_path, is_exchanged):
    """Whatever the fit, which bends to them, shows; a right record shows none."""
    far = STUDY.replace("= 600.0", "= 790.0").replace("= 800.0", "= 620.0")
    path = written(tmp_path, far)
    record = read_record(tmp_path / "frf.npz")
    order = [2, 1, 0, 3] if is_exchanged else [0, 1, 2, 3]
    write_record(tmp_path / "frf.npz", replace(record, values=record.values[:, order]))
    ready = prepare_study(load_study(path))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    told = _exchanged(FittedModel(trial, np.asarray(trial.target.theta_start), 1.0), ())
    assert ((("swap", ("2X", "4Y")), 0) in told) == is_exchanged
    assert bool(told) == is_exchanged


@pytest.mark.long
def test_elements_that_are_too_long_are_named_where_beams_are_cut_already(tmp_path):
    """The fit with 10 % of model error does not see them; that as the study asks does."""
    study = off().replace("subdivide = 1", "subdivide = 2", 1).replace("relative = 0.01", "relative = 0.0005")
    truth = STUDY.replace("subdivide = 1", "subdivide = 6", 1).replace("relative = 0.01", "relative = 0.0005")
    path = written(tmp_path, study, truth, seed=None)
    record = read_record(tmp_path / "frf.npz")
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(record.values.shape) + 1j * rng.standard_normal(record.values.shape)
    values = record.values + noise / np.sqrt(2) * np.hypot(0.0005 * np.abs(record.values), 1e-6)
    write_record(tmp_path / "frf.npz", replace(record, values=values))
    result, _ = answered(path)
    assert "mesh" in [cause.kind for cause in result.diagnosis.named]


@pytest.mark.long
def test_two_faults_are_both_named_and_the_first_is_not_told_as_all_of_it(tmp_path):
    both = _with(_FORGOTTEN, SOFT)
    result, _ = answered(written(tmp_path, off(), both))
    named = {(cause.kind, cause.where) for cause in result.diagnosis.causes}
    assert ("mass", ("4",)) in named
    assert {("support", ("6RZ",)), ("joint", ("right:1/6RZ",))} & named
    words = result.diagnosis.judgement.words
    left = np.sqrt(result.diagnosis.causes[0].chi_square_per_dof)
    assert left > 2
    assert (
        f"It is not all: it leaves {left:.2g} times the noise. With a second change, noise explains the rest: " in words
    )
    second = next(cause for cause in result.diagnosis.causes if cause.is_second)
    assert second.line == f"beside the first, {second.words}"
    assert second.share_text.endswith(" % of what is left")
    assert words.endswith(f"{second.words}.")
    assert result.diagnosis.causes[0].line == result.diagnosis.causes[0].words


def test_few_values_are_said_to_test_little(tmp_path):
    path = written_modes(tmp_path)
    found = answered(path)[0].identification
    estimate = found.estimate
    for freedom, hardly in ((40, False), (5, True)):
        goodness = replace(estimate.goodness, degrees_of_freedom=freedom)
        other = replace(found, estimate=replace(estimate, goodness=goodness))
        assert ("hardly test" in judged(other).words) == hardly
    assert judged(other).verdict == "sound"


def test_of_many_lines_some_are_named():
    spans = tuple(f"{k} to {k + 0.5} Hz" for k in range(20))
    words = OutlyingLines(where=spans).sentence(None)
    assert words == "lines at 0 to 0.5 Hz, 1 to 1.5 Hz, 2 to 2.5 Hz and 17 more stretches do not go with the others"
    assert "more" not in OutlyingLines(where=spans[:4]).sentence(None)


@pytest.mark.parametrize(
    "kind, place, gain, words",
    [
        ("sensor_gain", "3X", 9.80665, "in m/s^2 and read as g"),
        ("sensor_gain", "3X", 0.00101, "in m and read as mm"),
        ("sensor_gain", "3RZ", 57.3, "in deg and read as rad"),
        ("load_gain", "3X", 1 / 4.448, "in lbf and read as N"),  # fewer of the record's newtons than act
        ("load_gain", "3X", 1000, "in N and read as kN"),
    ],
)
def test_a_gain_that_is_that_of_a_unit_says_which(kind: str, place: str, gain: float, words: str) -> None:
    candidate = {"sensor_gain": SensorGain, "load_gain": LoadGain}[kind](where=(place,))
    assert words in candidate.sentence(gain)
    assert candidate.named_kind(gain) == "unit"


@pytest.mark.parametrize("kind, place, gain", [("sensor_gain", "3RZ", 9.80665), ("load_gain", "3X", 39.37)])
def test_a_gain_that_is_of_no_unit_of_the_channel_is_a_calibration(kind: str, place: str, gain: float) -> None:
    candidate = {"sensor_gain": SensorGain, "load_gain": LoadGain}[kind](where=(place,))
    assert "calibration" in candidate.sentence(gain)
    assert candidate.named_kind(gain) == kind


@pytest.mark.long
def test_what_turns_that_the_model_has_too_much_of_is_named_first(tmp_path):
    both = DISC.replace("nodes = [4]\ndirection", "nodes = [2, 4]\ndirection")
    truth = both.replace("rotary_inertia = 0.05", "rotary_inertia = [0.05, 0.01]")
    result, _ = answered(written(tmp_path, off(both), truth))
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("inertia", ("4RZ",))
    assert first.words == "a rotary inertia at 4RZ is too much in the model"
    assert first.found[0][1] == pytest.approx(-0.04, rel=0.1)


@pytest.mark.long
def test_sensors_that_weigh_something_are_named_together_with_what_each_weighs(tmp_path):
    truth = _with('point_mass]]\nname = "accelerometers"\nnodes = [2, 3, 4, 5]\nmass = 0.3')
    result, _ = answered(written(tmp_path, off(), truth))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("sensor_mass", ("2", "3", "4", "5"))
    [(name, value, unit)] = first.found
    assert (name, value, unit) == ("mass[mass of each sensor]", pytest.approx(0.3, rel=0.1), "kg")
    assert first.chi_square_per_dof < 1.2
    assert "+ nodes = [2, 3, 4, 5]" in first.lines


@pytest.mark.long
def test_a_mass_that_sits_off_its_node_is_named_first_with_the_length_that_it_is_off(tmp_path):
    pump = _with('point_mass]]\nname = "pump"\nnodes = [4]\nmass = 1.5')
    arm = '[[structure.rigid_link]]\nname = "arm"\nmain = 4\ndependents = [7]\n\n[[unknown]]'
    truth = pump.replace("nodes = [4]", "nodes = [7]").replace("[[unknown]]", arm, 1)
    foot = (
        '[[structure.rigid_link]]\nname = "pump"\nmain = 6\ndependents = [8]\n\n'  # a tie of the same name, before it
    )
    pump = pump.replace("[[structure.beam]]", f"{foot}[[structure.beam]]", 1).replace(
        "6 = [1.2, 0.0]", "6 = [1.2, 0.0]\n8 = [1.3, 0.0]"
    )
    truth = truth.replace("6 = [1.2, 0.0]", "6 = [1.2, 0.0]\n7 = [0.7, 1.0]")
    result, fits = answered(written(tmp_path, off(pump), truth))
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("offset", ("pump:1", "X"))
    assert first.words == "the mass pump:1 sits off its node along X"
    assert fits[0].modified.changes[-1][1] == pytest.approx(0.1, rel=0.02)
    assert first.chi_square_per_dof < 1.2


@pytest.mark.long
def test_a_second_cause_tells_its_own_value(tmp_path):
    """Not that of the first: a spring's stiffness, a mass, is no gain."""
    path = written(tmp_path, off(), SOFT)
    record = read_record(tmp_path / "frf.npz")
    values = np.array(record.values)
    values[:, record.outputs.index(parse_dof("3X"))] *= 1.2
    write_record(tmp_path / "frf.npz", replace(record, values=values))
    result, _ = answered(path)
    [gain] = [one for one in result.diagnosis.causes if one.kind == "sensor_gain"]
    assert gain.where == ("3X",)
    assert dict(one[:2] for one in gain.found)["gain[3X+]"] == pytest.approx(1.2, abs=0.01)
    assert "by a factor of 1.2" in gain.words


def test_command_tells_the_verdict_first_and_ends_with_3(tmp_path, brief):
    path = written(tmp_path, off(), SOFT)
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 3, done.output
    assert "Wrong model: do not use the values." in done.stdout.splitlines()[0]
    assert "support 6RZ is flexible" in done.stdout
    answer = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert answer["verdict"] == "wrong_model"
    assert answer["causes"][0]["kind"] in ("support", "joint")
    assert len([line for line in done.stdout.splitlines() if line.startswith("warning: ")]) <= 4
    study = tmp_path / "out" / answer["causes"][0]["study"]
    assert load_study(study).title == f"{load_study(path).title}, if {answer['causes'][0]['words']}"
    right = RUN.invoke(cli.app, ["identify", str(study), "--out", str(tmp_path / "right"), "--no-report"])
    assert right.exit_code == 0, right.output
    assert json.loads((tmp_path / "right" / "estimate.json").read_text())["verdict"] == "sound"


def test_causes_may_be_left_alone(tmp_path):
    path = written(tmp_path, off(), SOFT)
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out"), "--no-report", "--no-explain"])
    answer = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert answer["causes"] == []
    assert answer["verdict"] in ("wrong_model", "approximate")
    assert done.exit_code == (3 if answer["verdict"] == "wrong_model" else 0)
    assert not (tmp_path / "out" / "suggestions").exists()
    assert answer["verdict_text"].endswith(
        "No change of model or record was tried that might explain it: `structid explain` does."
    )


def test_a_sound_answer_drops_what_sensors_looked_like_beside_its_start(tmp_path):
    """Beside a start far off, a right sensor looked wrong; once the model explains it, nothing is said of it."""
    ready = prepare_study(load_study(written(tmp_path, off())))
    doubts = ChannelWarnings((), ("sensor 3X fits the model far worse than the others",), ("reciprocity: as it is",))
    ready = replace(ready, comparisons=tuple(replace(one, warnings=doubts) for one in ready.comparisons))
    result = run_prepared(ready)
    assert any("sensor 3X" in one for one in result.identification.warnings)
    answer, _ = diagnose_study(ready, result)
    assert answer.diagnosis.judgement.verdict == "sound"
    assert not any("sensor 3X" in one for one in answer.identification.warnings)
    assert any("reciprocity" in one for one in answer.identification.warnings)


def test_explain_looks_for_causes_of_a_sound_answer_too(tmp_path, brief):
    path = written(tmp_path, off())
    done = RUN.invoke(cli.app, ["explain", str(path), "--out", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "out" / "estimate.json").read_text())["n_changes_tried"] > 200


def test_rows_whose_errors_are_larger_by_a_factor_cost_what_their_likelihood_says():
    assert scaled_misfit(50.0, 100) == 50.0
    for ratio in (2.0, 30.0):
        factor = np.linspace(0.5, 2 * ratio, 200_001)
        brute = np.min(100 * ratio / factor + 100 * np.log(factor))
        assert scaled_misfit(100 * ratio, 100) == pytest.approx(brute, rel=1e-6)


@pytest.mark.parametrize(
    "share, left, distance, shift, is_cause",
    [
        (0.13, 0.99, 6.0, 0.002, False),  # all that goes beyond the noise, and a value moves by 0.2 %
        (0.13, 0.99, 6.0, 0.02, True),
        (0.13, 0.99, 1.5, 0.02, False),
        (0.08, 1.05, 6.0, 0.02, False),
        (0.9, 1.05, 0.5, 0.001, True),
    ],
)
def test_of_small_misfits_only_what_matters_is_a_cause(share, left, distance, shift, is_cause):
    moved = (
        ParameterShift("a", "N/m", 5.0, 5.0, (4.9, 5.1), 0.0),
        ParameterShift("b", "N/m", 2.0, 2.0 * (1 + shift), (1.9, 2.1), distance),
    )
    misfit = 1.14 if share < 0.5 else 12.0
    assert are_causes([Cause("mass", ("7",), "a mass is missing", share, left, moved=moved)], misfit) is is_cause


@pytest.mark.parametrize(
    "found, shift, is_cause",
    [
        (("mass[posts:1]", 0.989, "1"), 0.002, False),  # elements of one group differ by a hundredth
        (("mass[posts:1]", 0.96, "1"), 0.002, True),
        (("mass[posts:1]", 0.989, "1"), 0.05, True),
        (("mass[posts:1]", 0.989, "kg"), 0.002, True),  # a value that was held, not a ratio
    ],
)
def test_an_element_that_differs_by_scatter_and_moves_nothing_is_no_cause(found, shift, is_cause):
    moved = (ParameterShift("b", "N/m", 2.0, 2.0 * (1 + shift), (1.9, 2.1), 3.0),)
    first = Cause("untied", ("posts:1",), "", 0.83, 1.25, (found,), moved)
    assert are_causes([first], 7.5) is is_cause
    completing = Cause("joint", ("posts:10/12RZ",), "", 0.17, 1.04, moved=moved, is_second=True)
    assert are_causes([first, completing], 7.5) is is_cause


@pytest.mark.parametrize("misfit, left, is_cause", [(7.5, 1.04, True), (7.5, 1.4, False), (3.9, 1.04, False)])
def test_two_changes_that_leave_noise_alone_are_causes_whatever_each_removes(misfit, left, is_cause):
    first = Cause("mass", ("7",), "", 0.3, 0.7 * misfit)
    second = Cause("joint", ("a:1/2RZ",), "an end turns", 0.8, left, is_second=True)
    assert second.line == "beside the first, an end turns"
    assert are_causes([first, second], misfit) is is_cause


@pytest.mark.parametrize("leaves_noise", [True, False])
def test_of_few_values_a_pair_may_leave_what_chance_makes_of_noise(leaves_noise):
    second = Cause("joint", ("a:1/2RZ",), "", 0.8, 1.4, is_second=True, leaves_noise=leaves_noise)
    assert are_causes([Cause("polarity", ("9X",), "", 0.3, 20.0), second], 30.0) is leaves_noise


@pytest.mark.parametrize(
    ("kind", "left", "is_cause"), [("channel", 1.2, True), ("channel", 29.0, False), ("mass", 29.0, False)]
)
def test_a_change_is_no_cause_where_what_it_leaves_is_more_than_noise(kind, left, is_cause):
    assert (
        are_causes([Cause(kind, ("4Y",), "", 0.7, 30.0, rest_per_dof=left, leaves_data_out=kind == "channel")], 100.0)
        is is_cause
    )


def test_what_few_averages_leave_is_no_misfit_that_a_cause_would_have_to_remove():
    moved = (ParameterShift("a", "1", 1.0, 0.95, (0.94, 0.96), 3.0),)
    cause = Cause("window", ("all channels",), "resonances leak", 0.23, 1.065, moved=moved)
    assert not are_causes([cause], 1.39)
    assert are_causes([cause], 1.39, 30 / 28)


def test_a_comparison_says_which_state_has_no_sound_answer(tmp_path, brief):
    for name, truth in (("before", STUDY), ("after", SOFT)):
        (tmp_path / name).mkdir()
        written(tmp_path / name, off(), truth)
    words = ["compare", str(tmp_path / "before" / "study.toml"), str(tmp_path / "after" / "study.toml")]
    done = RUN.invoke(cli.app, [*words, "--out", str(tmp_path / "out"), "--no-report"])
    assert "the answer of the later state is not sound" in done.stdout
    assert "the answer of the baseline" not in done.stdout


def test_where_causes_cannot_be_looked_for_the_verdict_stands_and_says_so(tmp_path, monkeypatch):
    def failing(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("structid.diagnose.explain.search_causes", failing)
    result, fits = answered(written(tmp_path, off(), SOFT))
    assert fits == ()
    assert result.diagnosis.judgement.verdict in ("wrong_model", "approximate")
    assert "causes could not be looked for: Singular matrix" in result.diagnosis.judgement.reasons


def test_a_change_with_which_the_model_cannot_be_computed_leaves_the_others(tmp_path):
    base = Parts(
        changed=lambda candidate, strength: Parts(theta_of=lambda known: np.linalg.inv(np.full((1, 1), strength))[0])
    )
    assert _begun(base, [("singular", 0.0), ("regular", 2.0)], {}) == [("regular", 2.0, [0.5])]


def test_a_sensor_of_a_model_that_only_turns_is_not_aimed():
    draft = Parts(structure_of=lambda record: Parts(original=Parts(active=("RX",))))
    with pytest.raises(InputError, match=r"1RX\+ cannot be aimed: nodes of this model only turn"):
        AimSensor(0, parse_dof("1RX"), (1.0, 0.0, 0.0), 9).apply(draft)


def test_of_a_large_model_the_records_alone_are_searched_for_causes(tmp_path, monkeypatch):
    monkeypatch.setattr("structid.diagnose.modified_model.MOST_DOFS", 10)
    monkeypatch.setattr("structid.diagnose.causes.candidate.MOST_SCREENED_DOFS", 10)
    path = written(tmp_path, off())
    record = read_record(tmp_path / "frf.npz")
    crossed = np.array(record.values)
    crossed[:, [0, 3]] = crossed[:, [3, 0]]
    write_record(tmp_path / "frf.npz", replace(record, values=crossed))
    result, fits = answered(path)
    first, *others = result.diagnosis.causes
    assert (first.kind, first.where) == ("swap", ("2X", "5Y"))
    assert len(fits) <= 4
    assert not {one.kind for one in others} & {"support", "mass", "joint", "untied", "spring", "dashpot"}
    assert "causes are looked for in the records alone" in " ".join(result.diagnosis.judgement.reasons)


@pytest.mark.long
@pytest.mark.parametrize("channel", [0, 1])
def test_a_wrong_sense_beside_another_fault_is_not_called_a_noisy_sensor(tmp_path, channel):
    """Nor outlying lines: alone they explain more than the wrong sense does, beside the other fault it explains all."""
    path = written(tmp_path, off(), HEAVY)
    record = read_record(tmp_path / "frf.npz")
    sense = np.where(np.arange(4) == channel, -1.0, 1.0)
    write_record(tmp_path / "frf.npz", replace(record, values=record.values * sense[:, None]))
    result, _ = answered(path)
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first, second, *_ = result.diagnosis.causes
    where = f"{record.outputs[channel]}".rstrip("+")
    assert (first.is_second, second.is_second) == (False, True)
    assert {(one.kind, one.where) for one in (first, second)} == {("polarity", (where,)), ("mass", ("4",))}
    assert second.chi_square_per_dof < 1.1
    assert "polarity" in second.study
    assert "mass" in second.study


def written_clipped(folder):
    """Histories of which that of 4Y is clipped."""
    path = written_histories(folder, of_histories(off()))
    record = read_record(folder / "time.npz")
    values = np.array(record.values)
    limit = 0.4 * np.abs(values[:, 3]).max()
    values[:, 3] = np.clip(values[:, 3], -limit, limit)
    write_record(folder / "time.npz", replace(record, values=values))
    return path


def written_drifting(folder):
    """Histories of which that of 3X drifts."""
    path = written_histories(folder, of_histories(off()))
    record = read_record(folder / "time.npz")
    values, n = np.array(record.values), len(record.values)
    walk = np.cumsum(np.random.default_rng(7).standard_normal(n)) / np.sqrt(n)
    values[:, 2] += 0.3 * values[:, 2].std() * (4 * np.linspace(0.0, 1.0, n) + 2 * walk)
    write_record(folder / "time.npz", replace(record, values=values))
    return path


@pytest.mark.parametrize(
    ("made", "places"), [(written_clipped, {"4Y"}), (written_drifting, {"3X"}), (written_histories, set())]
)
def test_channels_that_did_not_measure_their_motion_are_fitted_without_whatever_a_look_says(tmp_path, made, places):
    ready = prepare_study(load_study(made(tmp_path)))
    found = run_prepared(ready).identification
    trial = base_model(TestedModel(ready.setups, ready.study.options), found.problems, found.estimate.theta)
    faulty = _faulty(FittedModel(trial, found.estimate.theta, found.estimate.goodness.chi_square))
    assert faulty == {(("channel", (place,)), 0) for place in places}


@pytest.mark.long
def test_a_channel_that_its_history_shows_to_be_clipped_is_said_and_named(tmp_path):
    """A linear look does not promise much of leaving it out: the model has bent to it."""
    result, _ = answered(written_clipped(tmp_path))
    assert "channel 4Y+ acceleration is clipped" in result.identification.warnings[0]
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("channel", ("4Y",))
    assert first.share > 0.9


@pytest.mark.long
def test_a_channel_that_drifts_is_named_though_averaged_responses_hide_it(tmp_path):
    result, _ = answered(written_drifting(tmp_path))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    first = result.diagnosis.causes[0]
    assert (first.kind, first.where) == ("channel", ("3X",))


@pytest.mark.parametrize(
    ("gain", "cause"),
    [
        (LoadGain(where=("3X",)), "the force at 3X is in another unit than stated: in N and read as kgf"),
        (
            LoadGain(where=("3X",), is_motion=True, is_alone=True),
            "the motion of support 3X is in another unit than stated: in m/s^2 and read as g, or all sensors are off the other way"
            " round",
        ),
    ],
)
def test_a_load_that_reads_by_g_too_much_is_told_in_units_of_what_it_is(gain, cause):
    assert gain.sentence(9.81) == cause
