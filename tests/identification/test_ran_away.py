"""Parameters that run away: how far a search goes, when an answer is said to have run away, and what is none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from chain_cases import STIFFNESS, chain, record

import structid as sid
from structid import FrfProblem, Prior, Status, identify, parameters
from structid.diagnose.verdict import judged
from structid.identification.warning_words import is_gone
from structid.inversion import LevenbergMarquardt
from structid.inversion.estimate import estimate
from structid.unknowns import Unknown

RIGID = (1000.0, 800.0, 1e12, 900.0)


def searched(truth, mass=(2.0,) * 4, **more):
    """All stiffnesses from starts of 900 N/m, the masses taken as 2 kg."""
    start = chain((900.0,) * 4)
    unknown = parameters(start, [Unknown("stiffness", f"k:{i}", **(more if i == 3 else {})) for i in range(1, 5)])
    return identify(start, unknown, record(chain(truth, mass)))


def test_a_rigid_connection_runs_away_no_farther_than_the_reach_and_is_no_answer():
    answer = searched(RIGID)
    found = answer.estimate
    assert found.search.history.max() <= 1e6 * 900.0 * (1 + 1e-12)
    assert answer.ran_away == (2,)
    assert np.delete(found.values, 2) == pytest.approx([1000.0, 800.0, 900.0], rel=1e-3)
    assert found.status is Status.NOT_IDENTIFIABLE
    judgement = judged(answer)
    assert judgement.verdict == "undetermined"
    assert judgement.words.startswith("Undetermined: stiffness[k:3] ran away (from 900 to 9e+08 N/m): not an answer")
    assert any(words.startswith("stiffness[k:3] ran away") for words in answer.warnings)
    view = sid.results_view(answer)
    assert view.headline.endswith(f"{found.status_words}.")
    assert "stiffness[k:3]: check what holds it, give it bounds or a prior, or fix it." in view.advice
    assert not any("ran away" in words for words in view.advice)


def test_what_runs_away_in_a_fit_that_misses_is_never_part_of_an_answer():
    """Determined to 1 % and converged, but a thousand times its start in a model that misses the record."""
    answer = searched(STIFFNESS, mass=(2.0, 2.0, 2.0, 3.0))
    found = answer.estimate
    assert found.covariance_basis == "model_error"
    assert answer.ran_away == ()
    away = replace(answer, ran_away=(2,), estimate=replace(found, status=Status.CONVERGED))
    judgement = judged(away)
    assert judgement.verdict == "wrong_model"
    assert "stiffness[k:3] ran away" in judgement.words
    assert judgement.reasons[0].startswith("stiffness[k:3] ran away")


@pytest.mark.parametrize("factor", [50.0, 1 / 50.0])
def test_a_truth_fifty_times_its_start_is_found(factor):
    truth = (1000.0, 900.0 * factor, 1200.0, 900.0)
    answer = searched(truth)
    assert answer.estimate.values == pytest.approx(truth, rel=0.02)
    assert answer.ran_away == ()
    assert judged(answer).verdict == "sound"


def test_a_prior_says_where_a_parameter_may_be():
    assert searched(RIGID, prior=Prior(900.0, 1e7)).ran_away == ()


def test_a_damping_that_goes_to_nothing_is_absent_and_has_not_run_away():
    """Springs without loss, in a model that misses the record for another reason."""
    truth, start = chain(mass=(2.0, 2.0, 2.0, 2.2), loss=0.0), chain()
    unknown = parameters(start, [Unknown("stiffness", "k", each=True), Unknown("loss_factor", "k")])
    answer = identify(start, unknown, record(truth))
    assert answer.estimate.values[-1] < 1e-3 * 0.03
    assert answer.ran_away == ()


def test_a_parameter_at_the_end_of_its_reach_does_not_hold_up_the_others():
    """They end where they end with that one held there."""
    near = (1050.0, 780.0, 2e4, 920.0)
    free = estimate(_alone(near, range(1, 5)), LevenbergMarquardt())
    assert free.values[2] == pytest.approx(2e4 * 1e6, rel=0.01)  # nothing is left to gain just before it
    fixed = estimate(_alone((*near[:2], 2e4 * 1e6, near[3]), (1, 2, 4)), LevenbergMarquardt())
    assert np.delete(free.values, 2) == pytest.approx(fixed.values, rel=1e-7)


def _alone(start, free):
    """The record of the rigid chain, fitted with no stages before."""
    structure = chain(start)
    return FrfProblem(
        structure, parameters(structure, [Unknown("stiffness", f"k:{i}") for i in free]), record(chain(RIGID))
    )


def test_a_spring_that_is_not_there_goes_to_zero_and_is_to_be_taken_out():
    truth = chain(STIFFNESS)
    drawn = sid.Structure(
        truth.nodes, [*truth.elements, sid.Spring("foot", "1X", stiffness=1e3)], truth.fixed, active=truth.active
    )
    answer = identify(
        drawn, parameters(drawn, [Unknown("stiffness", "k"), Unknown("stiffness", "foot")]), record(truth)
    )
    assert [answer.estimate.names[index] for index in answer.ran_away] == ["stiffness[foot]"]
    view = sid.results_view(answer)
    assert view.headline.startswith("Undetermined: stiffness[foot] went to zero (from 1e+03 to")
    assert view.headline.endswith("no stiffness there; the data do not determine every parameter.")  # one remedy, below
    assert (
        view.next_step
        == "Take stiffness[foot] out of the model, where the record shows no stiffness, and identify again."
    )
    assert not any("stiffness[foot]" in words for words in view.advice)


def test_a_factor_of_a_substructure_is_no_spring_that_is_gone():
    """Matrices of another program have a factor of 1; only a stiffness with a unit is that of a spring, support or joint."""
    small = SimpleNamespace(
        names=("stiffness[a]", "stiffness[shell]"),
        units=("N/m", "1"),
        values=[1e-9] * 2,
        initial=[1.0] * 2,
        std=[1.0] * 2,
        fixed=None,
    )
    assert [is_gone(small, 0), is_gone(small, 1)] == [True, False]


@pytest.mark.parametrize("within, expected", [(1e-9, True), (0.5, False)])
def test_a_spring_that_comes_back_within_tolerances_is_not_gone(within, expected):
    """Errors of fixed values drive it to 0; with these free within their tolerances it is half of its start."""
    foot = SimpleNamespace(
        names=("stiffness[foot]",),
        units=("N/m",),
        values=[1e-9],
        initial=[1.0],
        std=[1.0],
        theta=np.log([1e-9]),
        fixed=SimpleNamespace(theta=np.log([within])),
    )
    assert is_gone(foot, 0) is expected


def test_a_spring_that_is_known_well_after_a_start_far_too_high_is_not_gone():
    """1201 ± 14 N/m from 3e6, in a model that misses the record by a mass that is 2.5 % too small."""
    start = chain((900.0, 900.0, 3e6, 900.0))
    unknown = parameters(start, [Unknown("stiffness", f"k:{i}") for i in range(1, 5)])
    answer = identify(start, unknown, record(chain((1000.0, 800.0, 1200.0, 900.0), (2.0, 2.0, 2.0, 2.05))))
    assert answer.estimate.values[2] == pytest.approx(1200.0, abs=3 * answer.estimate.std[2])
    assert answer.ran_away == (2,)
    assert not is_gone(answer.estimate, 2)
    assert answer.warnings[0].startswith("stiffness[k:3] ran away (from 3e+06 to 1.2e+03 N/m): not an answer; check ")
