"""Causes are the same wherever their fits run, and those that are kept are not fitted again."""

import numpy as np
import pytest
from frame_cases import STUDY, off, written

from structid.criticism.candidate import Candidate
from structid.explanation import explain, refits, screening
from structid.explanation.answer import criticized, unlooked
from structid.explanation.explain import Explanation, explained
from structid.explanation.refits import Fitted, approached, likewise
from structid.explanation.trial import base_trial
from structid.inversion.search.work import ALONE, PLAIN_TOOLS
from structid.study.run.checkpoint import Checkpoint, fingerprint
from structid.study.run.long_run import LongRun
from structid.study.run.run import run_started
from structid.study.run.start import started
from structid.study.run.workers import Processes
from structid.study.schema.study import load_study

TRUTH = STUDY.replace(
    "[[unknown]]", '[[structure.point_mass]]\nname = "forgotten"\nnodes = [4]\nmass = 0.4\n\n[[unknown]]', 1
)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return load_study(written(tmp_path_factory.mktemp("frame"), off(), TRUTH))


@pytest.fixture(scope="module")
def base(study):
    ready = started(study)
    estimate = run_started(ready).identification.estimate
    problems = tuple(problem.decided(problem.theta_start) for problem in ready.problems)
    return Fitted(base_trial(study, ready.setups, problems, estimate.theta), estimate.theta, estimate.chi_square)


def causes(study, run):
    ready = started(study)
    result, fits = criticized(ready, run_started(ready, None, run), True, run)
    return result.criticism, fits


def same(one, other):
    (own, fits), (others, other_fits) = one, other
    assert own == others
    assert len(fits) == len(other_fits) > 0
    for first, second in zip(fits, other_fits, strict=True):
        assert np.array_equal(first.theta, second.theta)
        assert (first.cost, first.aside) == (second.cost, second.aside)
        assert first.trial.study.root.table == second.trial.study.root.table


def test_causes_on_processes_and_from_a_checkpoint_have_the_bits_of_one_run(study, tmp_path, monkeypatch, brief):
    kept = Checkpoint(tmp_path / "c", fingerprint(study), seconds=0.0)
    whole = causes(study, LongRun(checkpoint=kept))
    pool = Processes(2)
    same(causes(study, LongRun(pool)), whole)
    pool.close()

    def again(*arguments):
        raise AssertionError("fitted again")

    monkeypatch.setattr(refits, "_finally", again)
    kept = Checkpoint(tmp_path / "c", fingerprint(study), resume=True, seconds=0.0)
    same(causes(study, LongRun(checkpoint=kept)), whole)


def test_a_change_takes_the_answer_of_another_only_where_its_misfit_is_the_same(base):
    first = approached(base, (Candidate("mass", ("4",)), 0.3, np.inf), PLAIN_TOOLS)

    def own(*arguments):
        return {"theta": "own"}

    taken = likewise(base, (own, (Candidate("mass", ("4",)), 0.3, np.inf), first), PLAIN_TOOLS)
    assert taken["theta"] is first["theta"]
    assert likewise(base, (own, (Candidate("mass", ("3",)), 0.3, np.inf), first), PLAIN_TOOLS) == {"theta": "own"}
    assert likewise(base, (own, (Candidate("mass", ("4",)), 0.3, np.inf), {}), PLAIN_TOOLS) == {"theta": "own"}


def test_a_near_fit_ends_early_only_where_it_would_end_above_what_is_of_use(base):
    forgotten, other = (Candidate("mass", ("4",)), 0.3), (Candidate("mass", ("5",)), 0.1)
    best = approached(base, (*forgotten, np.inf), PLAIN_TOOLS)
    whole = approached(base, (*other, np.inf), PLAIN_TOOLS)
    assert whole["cost"] > 2 * best["cost"]
    short = approached(base, (*other, best["cost"]), PLAIN_TOOLS)
    assert short["seconds"] < whole["seconds"]
    assert short["cost"] > best["cost"]
    same = approached(base, (*forgotten, whole["cost"]), PLAIN_TOOLS)
    assert np.array_equal(same["theta"], best["theta"])
    assert same["cost"] == best["cost"]


def test_fits_of_causes_keep_to_their_room_and_say_what_they_left_out(base, monkeypatch):
    monkeypatch.setattr(screening, "_REFITTED", 20)
    whole = explained(base)
    assert (whole.left_out, whole.is_single, unlooked(whole)) == (0, False, ())
    few = explained(base, ALONE, whole.spent)  # half of it for first causes
    assert few.left_out > 10
    assert few.spent < 0.7 * whole.spent
    assert few.causes[0].trial.changes[-1][0].where == whole.causes[0].trial.changes[-1][0].where == ("4",)
    assert unlooked(few) == (
        f"{few.left_out} changes that a linear look promises something of were not fitted: the search for causes takes about ten"
        " identifications, or 40 seconds of a processor, at most",
    )


@pytest.mark.parametrize(("room", "n_more", "is_single"), [(np.inf, 3, False), (35.0, 2, True), (15.0, 0, True)])
def test_other_pairs_are_looked_for_as_long_as_there_is_room_for_one_more(base, monkeypatch, room, n_more, is_single):
    """Each pair takes 10 s, one of them that of the second cause; noise is never all that is left, and nothing is better."""
    first = Explanation(base, (base, base, base), (0.0, 0.0, 0.0), 3)
    second, rooms = Explanation(base, (base,), (0.0,), 3, spent=10.0), []
    monkeypatch.setattr(explain, "is_misfit", lambda one: True)
    monkeypatch.setattr(explain, "_is_far", lambda one: False)
    monkeypatch.setattr(explain, "_beside", lambda *arguments: second)
    monkeypatch.setattr(explain, "_from_second", lambda *arguments: rooms.append(arguments[-1]))
    monkeypatch.setattr(explain, "_from_next", lambda *arguments: rooms.append(arguments[-1]))
    pair = explain._paired(first, ALONE, room)
    assert (len(rooms), pair.is_single) == (n_more, is_single)
    assert rooms == [room - 10.0 * (k + 1) for k in range(n_more)]
