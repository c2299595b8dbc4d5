"""Changes far below the noise of any line that the record of a sound answer asks for all the same."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from wrong_models.faults import Fault
from wrong_models.study_files import Case, written

from structid.diagnose.causes import candidates
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.verdict import is_sound
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study


def answered(folder, *faults):
    """A study of a rail with these faults that is exact but for them, its answer, and the true values."""
    truth = written(Case("rail-frf-asked", "rail", "frf", faults), folder)
    path = folder / "study.toml"
    text = path.read_text(encoding="utf-8").replace("[structure]\n", "[structure]\ntolerance = 0\n", 1)
    path.write_text(text.replace("[record]\n", "[record]\ncalibration = 0\n", 1), encoding="utf-8")
    ready = prepare_study(load_study(path))
    result = run_prepared(ready)
    assert is_sound(result.identification)
    return ready, result, truth["parameters"]


def held(found, truth):
    """Of each value whether its interval holds the truth."""
    ends = dict(zip(found.estimate.names, found.intervals.ends, strict=True))
    return [bool(ends[name][0] <= value <= ends[name][1]) for name, value in truth.items()]


def test_a_mass_that_chi_square_does_not_show_is_named_and_intervals_reach_over_it(tmp_path):
    """5 g are missing at a node: chi-square is within its 25 %, and values are up to three of their deviations off."""
    ready, result, truth = answered(tmp_path, Fault("mass", "8", "0.005"))
    assert not all(held(result.identification, truth))
    found, fits = diagnose_study(ready, result)
    judgement = found.diagnosis.judgement
    assert judgement.verdict == "approximate"
    assert "the record asks for a change: a mass at node 8 is missing in the model" in judgement.words
    assert found.diagnosis.suggestions[0].found[0][1] == pytest.approx(0.005, rel=0.2)
    assert not found.diagnosis.causes
    assert len(fits) == len(found.diagnosis.suggestions)
    assert all(held(found.identification, truth))
    unasked, _ = diagnose_study(ready, result, explain=False)
    assert unasked.diagnosis.judgement.verdict == "sound"


def test_a_right_model_is_asked_for_nothing(tmp_path):
    ready, result, _ = answered(tmp_path)
    found, fits = diagnose_study(ready, result)
    assert found.diagnosis.judgement.verdict == "sound"
    assert not fits
    assert np.array_equal(found.identification.intervals.ends, result.identification.intervals.ends)


def test_scores_are_those_of_normal_noise_and_steps_those_of_a_column_more(tmp_path):
    ready, result, _ = answered(tmp_path)
    estimate = result.identification.estimate
    trial = base_model(TestedModel(ready.setups, ready.study.options), result.identification.problems, estimate.theta)
    base = FittedModel(trial, estimate.theta, estimate.goodness.chi_square)
    point = trial.point_at(trial.shown_problems, base.theta, np.inf)
    assert len(point.residual) == estimate.goodness.n_data  # all lines, unlike the screen of a misfit
    masses = [one for one in candidates(point.records, ["rail"]) if one.kind == "mass"]
    found = point.requested(masses)
    assert len(found) > 5
    assert stats.kstest([one.score for one in found], "halfnorm").pvalue > 1e-3
    [fields] = point.records
    for one in found[:3]:
        small = 1e-4 * np.abs(one.candidate.strengths).min()
        changed = fields.frf + one.candidate.effect(fields, np.array([small]))[0]
        column = (fields.problem.data_rows(changed) - fields.problem.data_rows(fields.frf)) / small
        step = -np.linalg.lstsq(np.column_stack([point.basis, column]), point.residual, rcond=None)[0][-1]
        assert one.strength == pytest.approx(step, rel=1e-3)
    bounded = [replace(one, bounds=(0.0, np.inf)) for one in masses]
    assert {one.candidate.where for one in point.requested(bounded)} == {
        one.candidate.where for one in found if one.strength > 0
    }
