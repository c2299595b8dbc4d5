"""No cause is asked to explain what the tolerances of fixed values explain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from frame_cases import STUDY, off, written
from test_each_cause import begun

from structid.diagnose import refits
from structid.diagnose.causes import candidates
from structid.diagnose.causes.fixed_value import FixedValue
from structid.diagnose.score_test import Point, damped_basis, tolerance_directions
from structid.diagnose.screening import LinearizedFit, _screen_change, linearize_fit, screen_changes, screen_sets
from structid.diagnose.search_budget import UNLIMITED
from structid.inversion.search.work import PLAIN_CONTEXT, SERIAL
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

TOLERANT = STUDY.replace("tolerance = 0", "tolerance = 0.025")
#: The stiffness of a column, which the study fixes, is 5 % off: two of its tolerances.
TWO_TOLERANCES_OFF = STUDY.replace("bending_stiffness = 550.0", "bending_stiffness = 577.5")
FORGOTTEN = '[[structure.point_mass]]\nname = "forgotten"\nnodes = [4]\nmass = 0.05\n\n[[unknown]]'


@pytest.fixture(scope="module")
def drawn():
    """A Jacobian, changes by one tolerance, a residual, and the least sum of squares with priors on the latter."""
    rng = np.random.default_rng(0)
    jacobian, columns, residual = rng.normal(size=(60, 4)), rng.normal(size=(60, 5)), 10 * rng.normal(size=60)
    return jacobian, columns, residual


def least(jacobian, columns, residual):
    n_fixed = columns.shape[1]
    rows = np.block([[jacobian, columns], [np.zeros((n_fixed, jacobian.shape[1])), np.eye(n_fixed)]])
    right = np.append(residual, np.zeros(n_fixed))
    rest = right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]
    return rest @ rest


def test_what_is_off_the_damped_basis_is_the_least_misfit_with_fixed_values_within_tolerances(drawn):
    jacobian, columns, residual = drawn
    basis, weights = damped_basis(np.linalg.qr(jacobian)[0], tolerance_directions(jacobian, columns))
    point = Point((), residual, basis, weights)
    assert point.left == pytest.approx(least(jacobian, columns, residual), rel=1e-12)
    assert point.without(np.zeros(60, dtype=bool)) == pytest.approx(point.left, rel=1e-12)
    out = np.arange(60) < 7
    kept = least(jacobian[~out], columns[~out], residual[~out])
    held = Point((), np.where(out, 0.0, residual), basis, weights)
    assert held.without(out) >= kept  # rows that are left out weigh by their logarithm, and add to what is kept
    rows = np.concatenate([basis[~out], np.diag((1 - weights) / np.sqrt(1 - (1 - weights) ** 2))])
    step = np.linalg.lstsq(rows, np.append(residual[~out], np.zeros(len(weights))), rcond=None)[0]
    rest = np.append(residual[~out], np.zeros(len(weights))) - rows @ step
    assert rest @ rest == pytest.approx(kept, rel=1e-12)


@pytest.mark.parametrize("n_rows", [9, 13, 60])
def test_a_linearized_fit_leaves_the_least_misfit_of_few_rows_as_of_many(drawn, n_rows):
    """Three of the fixed values are freed from their tolerances by one factor; 9 rows are fewer than the 15 columns."""
    jacobian, columns, residual = (part[:n_rows] for part in drawn)
    directions = tolerance_directions(jacobian, columns)
    triangle = np.linalg.qr(np.column_stack([jacobian, directions, columns, residual]), mode="r")
    linearized = LinearizedFit(None, residual, directions, tuple("abcde"), triangle)
    assert linearized.misfit == pytest.approx(least(jacobian, columns, residual), rel=1e-9)
    freed = np.column_stack([jacobian, columns[:, [0, 2, 4]].sum(axis=1)])
    assert linearized.misfit_with_freed("ace") == pytest.approx(least(freed, columns, residual), rel=1e-9)


def test_data_that_a_change_leaves_out_do_not_say_how_far_a_refit_within_tolerances_begins(monkeypatch):
    """They are no rows of the refit's problem, whose sum of squares it compares with its number of rows.

    The refit begins on half of the data, whose sum of squares is half as large.
    """
    asked = []

    def refit(names, theta, chi_square, progress=None, start=None):
        asked.append(chi_square)
        return SimpleNamespace(chi_square=5.0, misfits=lambda probability: False, theta=theta)

    monkeypatch.setattr(refits, "is_beyond_noise", lambda fitted: True)
    monkeypatch.setattr(refits, "count_effort", lambda problem: None)
    model = SimpleNamespace(
        is_large=False,
        target=SimpleNamespace(names=("p",), n_data=20),
        fixed_values=SimpleNamespace(refit=refit, problem=None),
        coarse=SimpleNamespace(
            target=SimpleNamespace(n_data=10), fixed_values=SimpleNamespace(refit=refit, problem=None)
        ),
    )
    fitted = refits.fitted_at(model, np.zeros(1), 100.0, left_out=60.0)
    assert fitted.tolerance_test.chi_square == 65.0
    untested = replace(fitted, tolerance_test=refits.ToleranceTest(65.0, False))
    untested._within_tolerances(model.fixed_values)
    assert asked == [20.0, 40.0, 40.0]


def test_changes_that_noise_hides_are_no_directions(drawn):
    jacobian, columns, _ = drawn
    assert tolerance_directions(jacobian, 1e-3 * columns).shape == (60, 0)
    followed = np.column_stack([columns, jacobian @ np.ones(4)])
    assert tolerance_directions(jacobian, followed).shape == (60, 5)


def test_a_fixed_value_is_screened_by_its_column_as_by_its_changed_model(tmp_path):
    base = begun(written(tmp_path, TOLERANT, TWO_TOLERANCES_OFF))
    linearized = linearize_fit(base)
    assert linearized.directions.shape[1] > 0
    for names in (
        ("bending_stiffness[right]",),
        ("mass[right]",),
        ("axial_stiffness[left]", "axial_stiffness[girder]"),
    ):
        change = (FixedValue(where=names), 1.0)
        [left] = screen_changes(linearized, [change], SERIAL, "steps", UNLIMITED)
        assert left == pytest.approx(_screen_change(linearized, change, PLAIN_CONTEXT)["left"], rel=1e-6)
        assert left < linearized.misfit


@pytest.mark.parametrize("mass", [pytest.param("", marks=pytest.mark.long), FORGOTTEN])
def test_a_fixed_value_two_tolerances_off_is_less_of_a_candidate_and_hides_none(tmp_path, mass):
    truth = TWO_TOLERANCES_OFF.replace("[[unknown]]", mass, 1) if mass else TWO_TOLERANCES_OFF
    gains, sets, first = {}, {}, None
    for text in (STUDY, TOLERANT):
        base = begun(written(tmp_path, text, truth))
        point = base.modified.point_at(base.modified.shown_problems, base.theta)
        rows = sorted(point.screened(candidates(point.records)), key=lambda row: row.left)
        first, gains[text] = rows[0].candidate, point.left - rows[0].left
        sets[text] = [
            one.candidate.where for one in screen_sets(base, SERIAL, "sets")[0] if one.candidate.kind == "held"
        ]
    assert gains[TOLERANT] < 0.7 * gains[STUDY]
    assert ("bending_stiffness[right]",) in sets[STUDY]
    assert not sets[TOLERANT]
    if mass:
        assert (first.kind, first.where) == ("mass", ("4",))


@pytest.mark.long
@pytest.mark.parametrize("mass", ["", FORGOTTEN.replace("0.05", "0.2")])
def test_a_fixed_value_two_tolerances_off_is_no_cause_and_a_fault_beside_it_is_the_first(tmp_path, mass):
    truth = TWO_TOLERANCES_OFF.replace("[[unknown]]", mass, 1) if mass else TWO_TOLERANCES_OFF
    ready = prepare_study(load_study(written(tmp_path, off(TOLERANT), truth)))
    found, _ = diagnose_study(ready, run_prepared(ready), explain=True)
    causes = [(one.kind, one.where) for one in found.diagnosis.causes]
    assert not [kind for kind, where in causes if "right" in str(where)]
    assert causes[:1] == ([("mass", ("4",))] if mass else [])
