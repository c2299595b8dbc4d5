"""Measured and fitted responses of results, as the page overlays them."""

import base64
import json

import h5py
import numpy as np

from structid.study.results.folder import write_results
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from structid.workbench.work.answer import fitted_responses
from structid.workbench.work.functions import answer_json
from study_cases import write_chain


def row(text: str, kind=np.float32) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def test_channels_come_the_worst_first_with_what_was_measured_and_fitted(tmp_path):
    result = run_study(load_study(write_chain(tmp_path)))
    (tmp_path / "out").mkdir()
    write_results(result, tmp_path / "out")
    found = json.loads(answer_json("fits", str(tmp_path), {"results": "out"}))
    fit = result.identification.fits[0]
    modelled = json.loads(answer_json("modelled", str(tmp_path), {"study": "chain.toml"}))
    assert [one["name"] for one in modelled["channels"]] == [
        f"{output} / {load}" for output in fit.problem.record.outputs for load in fit.problem.record.inputs
    ]
    absent = json.loads(answer_json("modelled", str(tmp_path), {"study": "chain.toml", "number": 1}))
    assert absent == {"error": "the study has 1 record and none of number 2; it was changed since"}
    initial = np.abs(fit.predicted_initial).reshape(len(fit.predicted_initial), -1)
    for k, one in enumerate(modelled["channels"]):
        np.testing.assert_allclose(row(one["magnitude"]), initial[:, k], rtol=1e-6)
    errors = [one["error"] for one in found["channels"]]
    assert errors == sorted(errors, reverse=True)
    worst = result.view.ranked_channels[0]
    first = found["channels"][0]
    assert first["name"] == worst.name
    assert first["error"] == np.median(fit.relative_error.reshape(len(fit.evaluation.frequency), -1)[:, worst.index])
    np.testing.assert_array_equal(row(found["frequency"], np.float64), fit.problem.record.frequency)
    of_fit = np.abs(fit.predicted).reshape(len(fit.predicted), -1)[:, worst.index]
    np.testing.assert_allclose(row(first["fitted"]), of_fit, rtol=1e-6)


def test_results_without_responses_or_of_another_program_are_told(tmp_path):
    assert fitted_responses(tmp_path) == {"channels": []}
    with h5py.File(tmp_path / "estimate.h5", "w") as file:
        file["modes/frequency"] = np.arange(3.0)
    assert fitted_responses(tmp_path) == {"channels": []}
    (tmp_path / "out").mkdir()
    with h5py.File(tmp_path / "out" / "estimate.h5", "w") as file:
        file["frf/frequency"] = np.arange(3.0)
        file["frf/measured"] = np.ones(7)
    assert "its responses cannot be used" in json.loads(answer_json("fits", str(tmp_path), {"results": "out"}))["error"]
