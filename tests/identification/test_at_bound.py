"""A parameter that ends at its bound: which, how hard the data push it, and what is told of the others."""

import numpy as np
import pytest
from chain_cases import bounded, chain, found, record

from structid import FrfProblem, Status
from structid.diagnose.verdict import judged
from structid.inversion import LevenbergMarquardt
from structid.inversion.composed_problems import FixedVariables
from structid.inversion.search.least_squares import minimize


def profiled(value, answer):
    """Half chi-square with the second stiffness held at a value, from bounds that leave it alone, with the answer's weights."""
    problem = FrfProblem(chain(), bounded((100.0, 2000.0)), answer.problem.record)
    theta = problem.unknowns.transforms.free(np.array([1000.0, value, 1200.0, 900.0]))
    return (
        minimize(FixedVariables(problem, np.array([1]), theta[[1]]), LevenbergMarquardt(), np.delete(theta, 1)).costs[
            -1
        ]
        / 2
    )


@pytest.mark.parametrize(
    ("bounds", "side", "limit"), [((805.0, 1200.0), "lower", 805.0), ((100.0, 798.0), "upper", 798.0)]
)
def test_a_bound_that_excludes_the_truth_is_named_with_its_multiplier(bounds, side, limit):
    answer = found(bounds)
    (one,) = answer.estimate.spread.at_bound
    assert (one.name, one.side, one.limit, one.index) == ("stiffness[k:2]", side, limit, 1)
    assert answer.estimate.values[1] == pytest.approx(limit, rel=1e-12)
    outward = -1.0 if side == "lower" else 1.0
    slope = (profiled(limit - 0.05, answer) - profiled(limit + 0.05, answer)) / 0.1
    assert one.multiplier == pytest.approx(outward * slope, rel=1e-3)
    step = one.std
    assert one.gain_per_std == pytest.approx(
        2 * (profiled(limit, answer) - profiled(limit + outward * step, answer)), rel=0.05
    )


def test_the_others_are_determined_and_rank_counts_the_free_ones():
    answer = found((805.0, 1200.0))
    estimate = answer.estimate
    assert estimate.status is Status.CONVERGED
    assert (estimate.identifiability.rank, estimate.identifiability.n_free) == (3, 3)
    assert estimate.identifiability.directions == ()
    assert estimate.identified.tolist() == estimate.spread.is_free.tolist() == [True, False, True, True]
    assert np.isnan(estimate.std[1])
    assert np.isfinite(np.delete(estimate.std, 1)).all()
    assert estimate.status_words == (
        "the search converged with stiffness[k:2] at a bound, and the data determine every other parameter"
    )
    told = [words for words in answer.warnings if "at its lower bound 805 N/m; the data push below it" in words]
    assert len(told) == 1
    assert told[0].endswith("widen the bound or doubt the model")
    assert not any("not identified" in words for words in answer.warnings)


def test_deviations_of_the_others_are_those_with_it_held():
    """With half the information of a full fit gone, they are smaller than those of all four."""
    whole = found((805.0, 1200.0))
    answer, jacobian = whole.estimate, FrfProblem(chain(), bounded((100.0, 2000.0)), whole.problem.record).linearize
    theta = bounded((100.0, 2000.0)).transforms.free(answer.values)
    others = np.delete(jacobian(theta).jacobian, 1, axis=1) / np.delete(answer.values, 1)
    expected = np.sqrt(np.diag(np.linalg.inv(others.T @ others)))
    assert np.delete(answer.std_noise, 1) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("bounds", [(100.0, 2000.0), (799.0, 1e12), (1.0, 800.5)])
def test_a_bound_that_holds_nothing_changes_nothing(bounds):
    answer = found(bounds, 790.0 if bounds[1] < 1000 else 820.0)
    assert answer.estimate.spread.at_bound == ()
    assert answer.estimate.identified.all()
    assert answer.estimate.values[1] == pytest.approx(799.948, abs=0.002)
    assert answer.estimate.std_noise[1] == pytest.approx(0.109, rel=0.02)
    assert judged(answer).verdict == "sound"


def test_a_truth_at_the_bound_is_sound_and_one_beyond_it_is_not():
    at = found((799.952, 1200.0), 850.0)
    assert len(at.estimate.spread.at_bound) == 1
    assert not at.estimate.spread.at_bound[0].is_pushed
    judgement = judged(at)
    assert judgement.verdict == "sound"
    assert "is at its lower bound 799.952 N/m" in judgement.words
    beyond = judged(found((800.6, 1200.0), 850.0))
    assert beyond.verdict == "wrong_model"
    assert "the data push below it" in beyond.words


def test_what_the_data_leave_open_over_its_whole_range_is_not_at_a_bound():
    """No force reaches beyond a joint that carries none: a spring between two masses that the record does not see."""
    from structid import identify, parameters
    from structid.fem import PointMass, Spring, Structure
    from structid.unknowns import Unknown

    base = chain()
    more = [
        PointMass("far", [5, 6], 1.0),
        Spring("unseen", "5X", "6X", stiffness=50.0),
        Spring("hold", "5X", stiffness=5.0),
    ]
    nodes = {i: float(i) for i in range(7)}
    structure = Structure(nodes, [*base.elements, *more], fixed=["0X"], active=["X"])
    own = [Unknown("stiffness", "k", each=True), Unknown("stiffness", "unseen", bounds=(49.0, 60.0), start=49.05)]
    answer = identify(structure, parameters(structure, own), record(chain())).estimate
    assert answer.spread.at_bound == ()
    assert answer.status is Status.NOT_IDENTIFIABLE
    assert [direction.words for direction in answer.identifiability.directions] == ["stiffness[unseen] not at all"]
