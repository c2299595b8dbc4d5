"""The results view: what console, files and pages say alike."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from structid.cli.summaries import identification_summary
from structid.core.display import as_sentence
from structid.core.json_types import json_text
from structid.diagnose.verdict import NOT_TRIED, Cause, Diagnosis, Judgement, _far_outside_words
from structid.report.identification import report_page
from structid.study.results.folder import estimate_summary
from structid.study.results.view import MOST_ADVICE, ParameterResult, parameter_states, results_view
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from study_cases import RIGID, rigid_record, write_chain


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return run_study(load_study(write_chain(tmp_path_factory.mktemp("study"))))


@pytest.fixture(scope="module")
def rigid(tmp_path_factory):
    """A chain of which only the sum of two masses is determined."""
    return run_study(load_study(write_chain(tmp_path_factory.mktemp("rigid"), RIGID, rigid_record())))


def texts(parts) -> str:
    return "\n".join(getattr(part, "plain", "") for part in parts)


def test_console_json_and_page_say_the_same(result):
    view, summary = result.view, json.loads(json_text(estimate_summary(result)))
    page = report_page(result.identification, diagnosis=view.diagnosis).text
    assert summary["headline"] == view.headline
    assert summary["next_step"] == view.next_step
    assert view.headline in page
    assert view.next_step in page
    assert view.headline in texts(identification_summary(result))
    for told, parameter in zip(summary["parameters"], view.parameters, strict=True):
        assert told["state"] == parameter.state
        assert told["value"] == parameter.value
        assert parameter.value_text in page
        assert told["text"].startswith(parameter.value_text)


def test_values_have_their_unit_with_a_prefix_and_no_digit_beyond_their_deviation():
    nothing = float("nan")
    stiff = ParameterResult(
        "k", "stiffness", "N/m", 1e5, 123456.0, 2345.0, (118859.0, 128052.0), 1.0, 1.0, 0.0, "", True
    )
    assert (stiff.value_text, stiff.interval_text, stiff.unit_text) == ("123.5 ± 2.3", "118.86 to 128.05", "kN/m")
    light = replace(stiff, unit="kg", initial=0.1, value=0.125, std=nothing, interval=(0.1, np.inf))
    assert (light.value_text, light.interval_text) == ("0.1250 ± not determined", "above 0.1000, no upper limit")


@pytest.mark.parametrize("interval", [(2e-149, 8e165), (0.0, np.inf), (8.6e-295, np.inf)])
def test_an_interval_that_limits_nothing_is_told_in_words(interval):
    wild = ParameterResult(
        "k", "stiffness", "N/m", 1e8, 4e8, 6e10, interval, 1.0, 1.0, 0.0, "not determined", identified=False
    )
    assert (wild.value_text, wild.interval_text) == ("400.0 ± not determined", "not determined")
    assert wild.interval_with_unit == "not determined"
    told = replace(wild, interval=(1e8, interval[1]))
    assert told.interval_text != "not determined"
    assert told.value_text == "0 ± 60000"


def test_states_say_how_each_parameter_is_determined(result, rigid):
    assert set(parameter_states(result.identification)) == {"determined"}
    states = dict(zip(rigid.estimate.names, parameter_states(rigid.identification), strict=True))
    lost = {name for name, known in zip(rigid.estimate.names, rigid.estimate.identified, strict=True) if not known}
    assert lost
    assert {name for name, state in states.items() if state == "not determined"} == lost
    away = replace(result.identification, ran_away=(1,))
    assert parameter_states(away)[1] == "ran away"


def test_what_is_not_determined_is_advised_on_once(rigid):
    told = [words for words in rigid.view.advice if "not determined" in words]
    assert len(told) == 1
    assert told[0].endswith("fix, tie, give a prior, or measure where they act.")
    assert sum(words.startswith("The data determine") for words in rigid.view.advice) == 1


def judged(result, words, verdict="wrong_model", **named):
    return results_view(result.identification, Diagnosis(Judgement(verdict, words), **named))


def test_a_verdict_has_one_sentence_or_the_second_that_says_why(result):
    view = judged(result, "Wrong model: do not use the values. The misfit is 3.4 times the noise. It is not all.")
    assert view.headline == "Wrong model: do not use the values. The misfit is 3.4 times the noise."
    assert view.advice[0] == "It is not all."
    long = "Approximate: the misfit is 2.1 times the assumed noise (10 % of each value); the intervals include it."
    assert judged(result, f"{long} Do not rely on k.", "approximate").headline == long


def test_a_change_does_not_warn_of_a_value_that_is_not_determined(rigid):
    estimate = rigid.identification.estimate
    lost = next(name for name, known in zip(estimate.names, estimate.identified, strict=True) if not known)
    for name, distance, is_told in ((lost, 9.0, False), ("mass[other]", 9.0, True), ("mass[other]", 1.0, False)):
        change = SimpleNamespace(moves=distance, moved=(SimpleNamespace(name=name),))
        words = _far_outside_words(rigid.identification, change)
        assert (words == f"; do not rely on {name}, which would then be far outside its interval") == is_told
        assert bool(words) == is_told


def test_what_the_verdict_says_of_the_record_is_not_said_again_as_a_warning(result):
    fault = "channel 3X+ acceleration is clipped"
    warned = replace(result.identification, warnings=(fault, "sensor 2X+ reads with the opposite sense"))
    words = f"Wrong model: do not use the values. Why. The record itself shows: {fault}."
    advice = results_view(warned, Diagnosis(Judgement("wrong_model", words))).advice
    assert [line for line in advice if "clipped" in line] == [f"The record itself shows: {fault}."]
    assert any(line.startswith("Sensor 2X+ reads") for line in advice)


def test_the_next_step_names_the_first_cause_and_its_study(result):
    cause = Cause("support", ("9Y",), "the support 9Y is flexible", 0.99, 1.0, study="suggestions/1-support-9Y.toml")
    other = replace(cause, words="the support 8Y is flexible", is_alike=True, study="suggestions/2-support-8Y.toml")
    view = judged(result, "Wrong model: do not use the values. Why.", causes=(cause, other))
    assert view.next_step == (
        "Check on the structure and in the test log whether the support 9Y is flexible, and run"
        " `structid identify suggestions/1-support-9Y.toml`."
    )
    assert "The data cannot distinguish the first change from this one: the support 8Y is flexible" in view.advice[0]
    meshed = replace(cause, kind="mesh", words="the mesh is too coarse")
    told = judged(result, "Wrong model: do not use the values. Why.", causes=(meshed,))
    assert told.next_step.startswith("Run `structid identify suggestions/")
    shown = SimpleNamespace(view=told, solver=None)
    assert "Run `structid identify out/suggestions/" in texts(identification_summary(shown, False, "out"))


def test_the_next_step_does_not_send_to_changes_that_nobody_tried(result):
    judgement = Judgement("wrong_model", "Wrong model: do not use the values.")
    searched = results_view(result.identification, Diagnosis(judgement, n_tried=9)).next_step
    stopped = results_view(result.identification, Diagnosis(replace(judgement, reasons=(NOT_TRIED,)))).next_step
    assert "changes that were tried" in searched
    assert "`structid explain` tries" in stopped
    assert "changes that were tried" not in stopped


def test_changes_that_explain_nothing_do_not_stand_under_cause(result):
    change = Cause("appendage", ("3X",), "a local resonance acts at 3X", 0.2, 3.0, study="suggestions/1.toml")
    words = (
        "Approximate: the misfit is twice the noise that the record states for all its channels. A change would help."
    )
    diagnosis = Diagnosis(Judgement("approximate", words), suggestions=(change,), n_tried=40)
    page = report_page(result.identification, diagnosis=diagnosis).text
    assert "<h2>Cause</h2>" not in page
    assert "Changes that lower the misfit without explaining it" in page
    caused = report_page(result.identification, diagnosis=replace(diagnosis, causes=(change,), suggestions=())).text
    assert "<h2>Cause</h2>" in caused


def test_no_more_advice_is_printed_than_a_reader_takes_in(result):
    words = " ".join(["Undetermined: the data do not determine every parameter of this long model.", *["Act."] * 9])
    noted = replace(result.identification, warnings=tuple(f"note {i}" for i in range(9)))
    view = results_view(noted, Diagnosis(Judgement("undetermined", words)))
    assert len(view.advice) > MOST_ADVICE
    printed = texts(identification_summary(SimpleNamespace(view=view, solver=None)))
    assert printed.count("\n- ") == MOST_ADVICE


def test_clauses_become_sentences_but_names_keep_their_letters():
    assert as_sentence("the mesh is coarse") == "The mesh is coarse."
    assert as_sentence("mass[a] ran away") == "mass[a] ran away."
