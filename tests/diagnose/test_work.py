"""Causes are the same wherever their fits run, and those that are kept are not fitted again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frame_cases import STUDY, off, written

from structid.diagnose import modified_model, refits, search, search_budget
from structid.diagnose.causes import DryFriction, Mass
from structid.diagnose.explain import unfinished_words
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel, fit_fully, fit_mirrored, fit_near, n_parameters, restore_fit
from structid.diagnose.search import Explanation, search_causes
from structid.diagnose.search_budget import (
    METER,
    UNLIMITED,
    Expense,
    FitLimits,
    SearchBudget,
    SearchEndedError,
    TaskWithEffort,
    iteration_effort,
    map_within_budget,
)
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.thresholds import (
    FAR_BEHIND,
    FINALISTS,
    FIRST_CAUSE_TIME,
    IDENTIFICATIONS,
    RESERVED_PLACES,
    SEARCH_EFFORT,
)
from structid.forward.record_problem import decide_polarities
from structid.inversion.search.least_squares import minimize
from structid.inversion.search.work import PLAIN_CONTEXT, SERIAL
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.long_run import Checkpoint, LongRun, fingerprint
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.run.workers import Processes
from structid.study.schema.study import load_study

ROOT = Path(__file__).parents[2]
TRUTH = STUDY.replace(
    "[[unknown]]", '[[structure.point_mass]]\nname = "forgotten"\nnodes = [4]\nmass = 0.4\n\n[[unknown]]', 1
)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return load_study(written(tmp_path_factory.mktemp("frame"), off(), TRUTH))


@pytest.fixture(scope="module")
def base(study):
    ready = prepare_study(study)
    estimate = run_prepared(ready).identification.estimate
    problems = tuple(decide_polarities(problem, problem.theta_start) for problem in ready.problems)
    return FittedModel(
        base_model(TestedModel(ready.setups, study.options), problems, estimate.theta),
        estimate.theta,
        estimate.goodness.chi_square,
    )


def causes(study, run):
    ready = prepare_study(study)
    result, fits = diagnose_study(ready, run_prepared(ready, None, run), True, run)
    return result.diagnosis, fits


def same(one, other):
    (own, fits), (others, other_fits) = one, other
    assert own == others
    assert len(fits) == len(other_fits) > 0
    for first, second in zip(fits, other_fits, strict=True):
        assert np.array_equal(first.theta, second.theta)
        assert (first.chi_square, first.left_out) == (second.chi_square, second.left_out)
        assert [change.edits for change in first.modified.changes] == [
            change.edits for change in second.modified.changes
        ]


@pytest.mark.long
def test_causes_on_processes_and_from_a_checkpoint_have_the_bits_of_one_run(study, tmp_path, monkeypatch, brief):
    kept = Checkpoint(tmp_path / "c", fingerprint(study), seconds=0.0)
    whole = causes(study, LongRun(checkpoint=kept))
    pool = Processes(2)
    same(causes(study, LongRun(pool)), whole)
    pool.close()

    def again(*arguments):
        raise AssertionError("fitted again")

    monkeypatch.setattr(refits, "_fit_to_the_end", again)
    kept = Checkpoint(tmp_path / "c", fingerprint(study), resume=True, seconds=0.0)
    same(causes(study, LongRun(checkpoint=kept)), whole)


def test_a_change_takes_the_answer_of_another_only_where_its_misfit_is_the_same(base):
    first = fit_near(base, (Mass(where=("4",)), 0.3, ()), PLAIN_CONTEXT)

    def own(*arguments):
        return {"theta": "own"}

    taken = fit_mirrored(base, (own, (Mass(where=("4",)), 0.3, ()), first), PLAIN_CONTEXT)
    assert taken["theta"] is first["theta"]
    assert fit_mirrored(base, (own, (Mass(where=("3",)), 0.3, ()), first), PLAIN_CONTEXT) == {"theta": "own"}
    assert fit_mirrored(base, (own, (Mass(where=("4",)), 0.3, ()), {}), PLAIN_CONTEXT) == {"theta": "own"}
    fewer = {**first, "theta": first["theta"][:-1]}  # of a change that adds other parameters
    assert fit_mirrored(base, (own, (Mass(where=("4",)), 0.3, ()), fewer), PLAIN_CONTEXT) == {"theta": "own"}


def test_a_near_fit_ends_early_only_where_it_would_end_above_what_is_of_use(base, monkeypatch):
    forgotten, other = (Mass(where=("4",)), 0.3), (Mass(where=("5",)), 0.1)
    best = fit_near(base, (*forgotten, ()), PLAIN_CONTEXT)
    iterations = []

    def counted(*arguments):
        minimum = minimize(*arguments)
        iterations.append(len(minimum.inner))
        return minimum

    monkeypatch.setattr(modified_model, "minimize", counted)
    whole = fit_near(base, (*other, ()), PLAIN_CONTEXT)
    n_whole = sum(iterations)
    assert whole["chi_square"] > 2 * best["chi_square"]
    iterations.clear()
    short = fit_near(base, (*other, (best["chi_square"],)), PLAIN_CONTEXT)
    assert sum(iterations) < n_whole
    assert short["chi_square"] > best["chi_square"]
    same = fit_near(base, (*forgotten, (whole["chi_square"],)), PLAIN_CONTEXT)
    assert np.array_equal(same["theta"], best["theta"])
    assert same["chi_square"] == best["chi_square"]
    far_behind = (0.5 * whole["costs"][0], *whole["costs"][1:])
    assert fit_near(base, (*other, far_behind), PLAIN_CONTEXT) == {}
    assert fit_near(base, (*other, (1.01 * whole["costs"][0], *[np.inf] * (len(far_behind) - 1))), PLAIN_CONTEXT)


class Ticking:
    """Every task in this process; each takes an effort of 1 whatever it is, and `seconds` count all that ran."""

    def __init__(self, n_workers=1):
        self.n_workers, self.seconds = n_workers, 0.0

    def map(self, name, task, shared, items, progress=None, first=0):
        self.seconds += len(items)
        return [{**answer, "effort": 1.0} for answer in SERIAL.map(name, task, shared, items)]


@pytest.fixture
def still(monkeypatch):
    """What this process evaluates takes no effort of its own."""

    def spend(clock, effort):
        clock.reading += effort == 1.0

    monkeypatch.setattr(search_budget.EffortMeter, "add", spend)


def test_the_search_for_causes_ends_in_its_limit_names_the_cause_and_says_what_was_left_out(base, still):
    work = Ticking()
    few = search_causes(base, work, SearchBudget(70.0))
    assert few.spent.effort <= FIRST_CAUSE_TIME * 70 + 1
    assert work.seconds <= 71
    assert few.left_out > 10
    assert few.causes[0].modified.changes[-1][0].where == ("4",)
    assert unfinished_words(few) == (
        f"the search for causes ended at its limit, {few.left_out} likely changes not tried: `structid explain` goes on",
    )


@pytest.mark.long
def test_a_search_without_a_limit_leaves_nothing_out(base, still):
    whole = search_causes(base, Ticking())
    assert (whole.left_out, whole.is_single, unfinished_words(whole)) == (0, False, ())
    assert whole.spent.effort > 60


def test_a_search_that_may_take_nothing_still_fits_the_two_likeliest_changes(base, still):
    none = search_causes(base, Ticking(), SearchBudget(0.0))
    assert none.left_out > 20
    assert none.causes


def test_a_fit_that_takes_too_much_is_given_up(base):
    for limits in (FitLimits(effort=0.0), FitLimits(seconds=-1.0)):
        hurried = replace(base, modified=replace(base.modified, fit_limits=limits))
        with pytest.raises(SearchEndedError, match="the fit was ended after 1 iterations"):
            hurried.modified.fit_near()
        assert fit_near(hurried, (Mass(where=("4",)), 0.3, ()), PLAIN_CONTEXT) == {}


def square(shared, item, tools):
    return shared * item**2


@pytest.mark.parametrize("n_workers", [1, 2, 3])
def test_tasks_stop_when_the_effort_is_spent_however_many_run_at_once(n_workers, still):
    work = Ticking(n_workers)
    assert map_within_budget(SearchBudget(3.0), work, "squares", square, 2, [1, 2, 3, 4, 5]) == [2, 8, 18, None, None]
    assert map_within_budget(SearchBudget(0.0), work, "squares", square, 2, [1, 2, 3], least=1) == [2, None, None]
    assert map_within_budget(UNLIMITED, work, "squares", square, 2, [1, 2, 3]) == [2, 8, 18]


def test_effort_is_counted_from_sizes_and_is_the_same_each_time(base):
    """A near fit takes what its iterations take on its lines; with twice the lines an iteration takes more."""

    def effort_of(task, *arguments):
        return TaskWithEffort(task)(*arguments)["effort"]

    item = (Mass(where=("4",)), 0.3, ())
    assert base.near_path  # the quick fit without the change is made once, before all others
    first = effort_of(fit_near, base, item, PLAIN_CONTEXT)
    assert first == effort_of(fit_near, base, item, PLAIN_CONTEXT) > 0
    [problem] = base.modified.problems
    half = problem.with_lines(np.arange(0, len(problem.frequency), 2))
    assert 1 < iteration_effort(problem) / iteration_effort(half) < 2


@pytest.mark.parametrize(("effort", "n_more", "is_single"), [(np.inf, 3, False), (35.0, 2, True), (15.0, 0, True)])
def test_other_pairs_are_looked_for_as_long_as_the_budget_allows_one_more(base, monkeypatch, effort, n_more, is_single):
    """Each pair takes an effort of 10, one of them that of the second cause; none leaves noise alone or is better."""
    first, efforts = Explanation(base, (base, base, base), (0.0, 0.0, 0.0), 3), []
    second = Explanation(base, (base,), (0.0,), 3, spent=Expense(10.0, 0.0))
    budget = SearchBudget(effort)

    def take(*arguments):
        efforts.append(arguments[-1].spent.effort)
        METER.add(10.0)

    def beside(*arguments):
        METER.add(10.0)
        return second

    monkeypatch.setattr(FittedModel, "is_misfit", True)
    monkeypatch.setattr(search, "_is_far", lambda one: False)
    monkeypatch.setattr(search, "_on_finer_mesh", lambda first, work: None)
    monkeypatch.setattr(search, "_beside", beside)
    monkeypatch.setattr(search, "_from_second", take)
    monkeypatch.setattr(search, "_from_next", take)
    pair = search._paired(first, SERIAL, budget)
    assert (len(efforts), pair.is_single) == (n_more, is_single)
    assert efforts == pytest.approx([10.0 * (k + 1) for k in range(n_more)])


def test_a_finer_mesh_is_tried_before_all_other_second_causes(tmp_path, monkeypatch):
    """The record is that of lines in three pieces; the study draws one."""
    finer = load_study(written(tmp_path, off(), TRUTH.replace("subdivide = 1", "subdivide = 3")))
    ready = prepare_study(finer)
    estimate = run_prepared(ready).identification.estimate
    problems = tuple(decide_polarities(problem, problem.theta_start) for problem in ready.problems)
    model = base_model(TestedModel(ready.setups, finer.options), problems, estimate.theta)
    coarse = FittedModel(model, estimate.theta, estimate.goodness.chi_square)
    forgotten, other = Mass(where=("4",)), Mass(where=("2",))

    def refit(mass):
        near = fit_near(coarse, (mass, 0.3, ()), PLAIN_CONTEXT)
        return restore_fit(coarse, mass, fit_fully(coarse, (mass, 0.3, near["theta"]), PLAIN_CONTEXT))

    first = refit(forgotten)
    assert first.is_misfit

    def search_all(*arguments):
        raise AssertionError("all second causes are searched")

    monkeypatch.setattr(search, "_beside", search_all)
    pair = search._paired(Explanation(coarse, (first,), (0.0,), 1), SERIAL, UNLIMITED)
    assert [one.cause.kind for one in pair.further.causes] == ["mesh"]
    assert not pair.further.causes[0].is_misfit
    assert pair.causes == (first,)
    assert search._on_finer_mesh(refit(other), SERIAL) is None


def test_near_fits_far_behind_the_best_are_not_refitted(base):
    several = [(Mass(where=("4",)), 0.3), (Mass(where=("5",)), 0.3), (DryFriction(where=("4X",)), 0.1)]
    least = np.array(base.near.costs) / 100
    room = FAR_BEHIND * (least + n_parameters(base.modified))
    near = [{"costs": costs, "chi_square": costs[-1]} for costs in (least, 1.01 * room, 1.01 * room)]
    assert search._within_reach(base, [0, 1, 2], several, near) == [0, 2]
    near[1] = {"costs": 0.99 * room, "chi_square": 0.99 * room[-1]}
    assert search._within_reach(base, [0, 1, 2], several, near) == [0, 1, 2]


@pytest.mark.parametrize("page", ["CHANGELOG.md", "docs/explain.md", "src/structid/workbench/static/steps/run.js"])
def test_pages_say_how_long_the_search_takes(page):
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    assert (IDENTIFICATIONS, SEARCH_EFFORT) == (3.0, 8.0)
    assert "three identifications and about eight seconds" in text


def test_best_near_fits_are_refitted_before_those_that_smoothed_data_do_not_show():
    rubs = [DryFriction(where=(f"{k}X",)) for k in range(1, 6)]
    masses = [Mass(where=(str(k),)) for k in range(1, 11)]
    order = [0, 5, 1, 6, 2, 7, 3, 8, 4, *range(9, 15)]  # of the near fits: friction is the best of all
    finalists = search._finalists(order, [*rubs, *masses])
    assert len(finalists) == FINALISTS
    assert finalists[:2] == [5, 6]
    assert finalists[-RESERVED_PLACES:] == [0, 1, 2]
