"""Causes where the fit has been bent so far that no linear look at it says anything."""

import numpy as np
from wrong_models.faults import Fault
from wrong_models.study_files import Case, written

from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel, fit_near
from structid.diagnose.screening import shortlist_candidates
from structid.diagnose.tested_model import TestedModel
from structid.inversion.search.work import SERIAL
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study


def test_exchanged_loads_are_fitted_whatever_a_model_bent_to_them_shows(tmp_path):
    written(Case("mast-frf2-exchanged", "mast", "frf2", (Fault("load_swap", "any"),), "near"), tmp_path)
    ready = prepare_study(load_study(tmp_path / "study.toml"))
    problems = tuple(setup.prepared(ready.study.options).problem for setup in ready.setups)
    [problem] = problems
    away = problem.theta_start + np.log([0.005, 1e-4, 1e-6, 0.05, 1e6, 1e4])  # where the search ran to
    trial = base_model(TestedModel(ready.setups, ready.study.options), problems, away)
    base = FittedModel(trial, away, float(np.sum(problem.residual(away) ** 2)))
    found = shortlist_candidates(base, SERIAL, "causes").rows
    [swap] = [one for one in found if one.candidate.kind == "load_swap"]
    end = fit_near(base, (swap.candidate, swap.strength, ()), SERIAL)
    assert end["chi_square"] < 1e-2 * base.chi_square
    assert end["chi_square"] < 1.5 * problem.n_data


def test_sensors_that_look_exchanged_are_fitted_so_whatever_a_model_bent_to_them_shows(tmp_path):
    written(Case("crane-time-exchanged", "crane", "time", (Fault("swap", "6Y", "8Y"),), "near"), tmp_path)
    ready = prepare_study(load_study(tmp_path / "study.toml"))
    problems = tuple(setup.prepared(ready.study.options).problem for setup in ready.setups)
    [problem] = problems
    away = problem.theta_start + np.log([0.12, 27.0, 1e-6, 6.6, 660.0, 1e-6])  # where the search ran to
    trial = base_model(TestedModel(ready.setups, ready.study.options), problems, away)
    base = FittedModel(trial, away, float(np.sum(problem.residual(away) ** 2)))
    first = shortlist_candidates(base, SERIAL, "causes").rows[0]
    assert (first.candidate.kind, first.candidate.where) == ("swap", ("6Y", "8Y"))
