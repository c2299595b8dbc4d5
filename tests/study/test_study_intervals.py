"""Intervals and residual tests on their way from the study file to estimate.json and the page."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from structid import identify
from structid.core.display import span_text
from structid.core.errors import InputError
from structid.core.json_types import json_text
from structid.report.identification import report_page
from structid.study.results.folder import estimate_summary
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from study_cases import chain_record, replaced, write_chain

PROFILED = replaced("[method]", '[method]\nintervals = "profile"')


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return run_study(load_study(write_chain(tmp_path_factory.mktemp("study"), PROFILED)))


def test_profile_intervals_reach_the_summary(result):
    summary = json.loads(json_text(estimate_summary(result)))
    found = result.identification.estimate
    assert (summary["intervals"]["kind"], summary["intervals"]["level"]) == ("profile", 0.95)
    for i, entry in enumerate(summary["parameters"]):
        low, high = entry["interval_95"]
        assert low < entry["value"] < high
        assert (low, high) == pytest.approx(found.interval()[i], rel=0.002)
        assert low != found.interval()[i, 0]
    assert summary["provenance"]["settings"]["intervals"] == "profile"


def test_residual_tests_reach_summary_and_page_with_the_names_of_the_sensors(result):
    tests = json.loads(json_text(estimate_summary(result)))["residual_tests"]
    assert [test["name"] for test in tests["series"]] == ["1X+", "1X+", "3X+", "3X+"]
    assert tests["whiteness_probability"] > 1e-3
    identification = result.identification
    text = report_page(identification).text
    assert "No test speaks against it." in text
    assert "from the profile likelihood" in text
    assert "95\u00a0% interval" in text


def test_a_channel_with_model_error_is_named_in_the_warnings(result):
    """A 3 % error of sensor 3 that varies slowly over the lines."""
    record = chain_record()
    bad = record.values.copy()
    bad[:, 1] *= 1 + 0.03 * np.sin(np.linspace(0, 12, len(bad)))[:, None]
    study = result.study
    found = identify(study.structure, study.parameters, replace(study_record(record), values=bad))
    [words] = [w for w in found.warnings if "an order that noise has not" in w]
    assert "3X" in words


def study_record(record):
    return replace(record, variance=(0.01 * np.abs(record.values)) ** 2, noise_source="declared")


def test_an_unknown_kind_of_interval_is_told_with_its_place(tmp_path):
    text = replaced('"profile"', '"profiles"', PROFILED)
    with pytest.raises(InputError, match=r'\[method\] intervals: must be one of "laplace", "profile"'):
        load_study(write_chain(tmp_path, text))


def test_an_interval_without_a_limit_is_told_in_words():
    assert span_text(2.0, np.inf) == "above 2.000, no upper limit"
    assert span_text(-np.inf, 2.0) == "below 2.000, no lower limit"
    assert span_text(-np.inf, np.inf, "MN/m") == "no limits"
    assert span_text(2.0, np.inf, "MN/m") == "above 2.000 MN/m, no upper limit"
    assert span_text(1.0, 2.5, "N/m^2") == "1.00 to 2.50 N/m²"
    assert span_text(1.0, 2.5) == "1.00 to 2.50"
    assert span_text(999.62, 1001.18) == "999.62 to 1001.18"
    assert span_text(np.nan, 1.0) == "\u2013"
