"""Several searches: which are made, which of their answers are distinct, and which fit."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from structid import LevenbergMarquardt, Status, estimate
from structid.core.errors import SingularModelError
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.search.least_squares import LEFT, minimize
from structid.inversion.search.multistart import (
    Search,
    _is_determined_somewhere,
    distinct_answers,
    searched_minima,
    staged,
)
from structid.inversion.search.work import SerialExecutor, restored_minimum, stored_minimum


@dataclass
class TwoWells(Problem):
    """Data that p = 1 and p = 2 explain: (p - 1) (p - 2) = 0 twice over, the second time missed by `miss` at 2."""

    miss: float = 0.0
    start: tuple = (1.4,)
    weight: float = 100.0
    searches: list = field(default_factory=list)

    @property
    def unknowns(self):
        return FreeUnknowns(("p", "q")[: len(self.start)], np.array(self.start))

    rows = DataRows(np.arange(2), np.zeros(2, int))

    def residual(self, theta):
        p = theta[0]
        return np.array([self.weight * (p - 1) * (p - 2), self.miss * (p - 1)])

    def linearize(self, theta):
        return Linearization(
            self.residual(theta), np.array([[self.weight * (2 * theta[0] - 3)], [self.miss]], dtype=float)
        )


@dataclass
class Unseen(TwoWells):
    """Two wells whose derivative cannot be had at p = 1.4."""

    def linearize(self, theta):
        if theta[0] == 1.4:
            raise SingularModelError("no response")
        return super().linearize(theta)


@pytest.mark.parametrize(("kind", "answer"), [(TwoWells, True), (Unseen, False)])
def test_an_end_between_two_answers_is_judged_by_the_start_where_the_model_can_be_evaluated_there(kind, answer):
    """The derivative is 0 at p = 1.5, between the two answers."""
    problem, between, start = kind(), np.array([1.5]), np.array([1.4])
    end = replace(
        minimize(problem, LevenbergMarquardt(), np.array([1.3])),
        theta=between,
        linearization=problem.linearize(between),
    )
    assert _is_determined_somewhere(problem, end, start) is answer


def test_two_exact_fits_are_found_and_refused():
    found = estimate(TwoWells(), search=Search(uniqueness_starts=8))
    assert found.search.n_starts == 9
    assert found.search.n_fitting == len(found.search.answers) == 2
    assert sorted(float(answer.values[0]) for answer in found.search.answers) == pytest.approx([1.0, 2.0])
    assert sum(answer.n_searches for answer in found.search.answers) == 9
    assert found.status is Status.NOT_IDENTIFIABLE


def test_distance_is_counted_in_posterior_standard_deviations():
    """The derivative is 100 at both answers, hence a standard deviation of 0.01: they are 100 of them apart."""
    found = estimate(TwoWells(), search=Search(uniqueness_starts=8))
    assert [answer.distance for answer in found.search.answers] == pytest.approx([0.0, 100.0])
    near = estimate(TwoWells(weight=2.0), search=Search(uniqueness_starts=8))
    assert len(near.search.answers) == 1


@pytest.mark.parametrize(("miss", "fits"), [(2.0, 2), (5.0, 1)])
def test_an_answer_that_the_noise_does_not_allow_does_not_count(miss, fits):
    """At p = 2 chi-square is miss^2: 4 and 25 against 10.8, the 0.1 % point of one degree of freedom."""
    found = estimate(TwoWells(miss), search=Search(uniqueness_starts=8))
    assert len(found.search.answers) == 2
    assert found.search.n_fitting == fits
    assert found.values == pytest.approx([1.0])
    assert found.status is (Status.CONVERGED if fits == 1 else Status.NOT_IDENTIFIABLE)


@pytest.mark.parametrize(("least", "fits"), [(lambda minimum: 0.0, 2), (lambda minimum: float(minimum.costs[-1]), 1)])
def test_an_answer_that_tolerances_of_held_values_allow_counts(least, fits):
    """At p = 2 chi-square is 25 by noise alone, which a likelihood ratio rules out, and what the tolerances leave is not."""
    problem, method = TwoWells(5.0), LevenbergMarquardt()
    minima = [minimize(problem, method, np.array([start])) for start in (0.9, 2.1)]
    answers = distinct_answers(problem, minima, lambda minimum: True, least, 1e-3)
    assert [answer.fits for answer in answers] == [True, fits == 2]


def test_wide_starts_end_when_no_more_minima_are_to_be_expected():
    """Two wells: Boender's rule wants 16 random searches that fit, of which 24 make as many; four more follow the answers."""
    found = estimate(TwoWells(), search=Search(wide_starts=200))
    assert found.search.n_fitting == 2
    assert found.search.is_exhaustive
    assert found.search.n_starts == 1 + 24 + 4
    assert not estimate(TwoWells(), search=Search(wide_starts=10)).search.is_exhaustive


def test_without_more_starts_the_first_fit_ends_the_search():
    found = estimate(TwoWells(), search=Search(restarts=5))
    assert (found.search.n_starts, found.search.n_agreeing, len(found.search.answers)) == (1, 1, 1)
    assert found.status is Status.CONVERGED


def test_a_likelihood_ratio_rules_out_what_chi_square_alone_allows():
    """200 more residuals at their expected size: chi-square of the second answer is unremarkable, its excess of 25 is not."""

    class Many(TwoWells):
        rows = DataRows(np.arange(202), np.zeros(202, int))

        def residual(self, theta):
            return np.concatenate([super().residual(theta), np.ones(200)])

        def linearize(self, theta):
            at = super().linearize(theta)
            return Linearization(self.residual(theta), np.concatenate([at.jacobian, np.zeros((200, 1))]))

    problem = Many(5.0)
    found = estimate(problem, search=Search(uniqueness_starts=8))
    assert len(found.search.answers) == 2
    assert found.search.answers[1].cost == pytest.approx(225.0, rel=1e-3)
    assert found.search.n_fitting == 1


def test_an_undetermined_direction_is_one_answer_and_not_many():
    """Only p + q is seen: every search ends somewhere else on the same line, which is no second fit."""

    class Sum(TwoWells):
        def residual(self, theta):
            return np.array([100 * (theta.sum() - 3), 0.0])

        def linearize(self, theta):
            return Linearization(self.residual(theta), np.array([[100.0, 100.0], [0.0, 0.0]]))

    problem = Sum(start=(1.0, 1.0))
    found = estimate(problem, search=Search(uniqueness_starts=4))
    assert len(found.search.answers) == 1
    assert found.search.answers[0].n_searches == 5


def test_distance_is_the_larger_of_those_seen_from_either_end():
    """The derivative of p (p - 1) (p - 2) is -1 at 1 and 2 at 2, times the weight of 100."""

    class Uneven(TwoWells):
        def residual(self, theta):
            return super().residual(theta) * theta[0]

        def linearize(self, theta):
            slope = self.weight * (3 * theta[0] ** 2 - 6 * theta[0] + 2)
            return Linearization(self.residual(theta), np.array([[slope], [0.0]]))

    found = estimate(Uneven(), search=Search(uniqueness_starts=8))
    assert found.search.answers[1].distance == pytest.approx(200.0)


def test_ways_that_are_functions_get_the_start_of_each_search():
    """Two ways from the given start, then random starts; uniqueness starts take the first way."""
    seen = []

    def way(number):
        return lambda theta: seen.append((number, float(theta[0]))) or ()

    problem = TwoWells(miss=50.0, start=(1.9,))
    method = LevenbergMarquardt(max_iterations=0)
    estimate(problem, method, plans=(way(1), way(2)), search=Search(restarts=3, uniqueness_starts=2))
    assert [number for number, _ in seen] == [1, 2, 1, 2, 1, 1]
    starts = [start for _, start in seen]
    assert starts[:2] == [1.9, 1.9]
    assert len(set(starts)) == 5


@pytest.mark.parametrize("n_workers", [1, 3])
@pytest.mark.parametrize("good", [1, 2, 3, 4])
def test_random_points_are_drawn_in_the_order_of_the_searches_that_count(good, n_workers):
    """Two ways, up to three restarts of which the one numbered `good` fits, two uniqueness starts: draws written out."""
    made = []

    class Several(SerialExecutor):
        def map(self, name, task, shared, items, progress=None, first=0):
            made.append([(name, float(theta[0])) for _, _, theta in items])
            return super().map(name, task, shared, items, progress, first)

    problem, method = TwoWells(), LevenbergMarquardt(max_iterations=0)
    verdicts = iter([False] * (good - 1) + [True] + [False] * 9)
    search = Search(restarts=3, uniqueness_starts=2, seed=5)
    ways = [(), ()]
    found = searched_minima(problem, method, ways, search, lambda _: next(verdicts), None, Several(n_workers)).minima
    random = np.random.default_rng(5)
    starts = [1.4, 1.4][:good] + [1.4 + 0.2 * 1.4 * random.standard_normal() for _ in range(good - 2)]
    starts += [1.4 + 0.2 * 1.4 * random.standard_normal() for _ in range(2)]
    assert [float(minimum.history[0][0]) for minimum, _ in found] == pytest.approx(starts, rel=1e-14)
    assert [name for name, _ in made[-1]] == ["uniqueness starts"] * 2
    assert {name for call in made[:-1] for name, _ in call} == (set() if good == 1 else {"restarts"})


def test_restarts_take_the_ways_in_turn_and_then_random_starts():
    stage = TwoWells(start=(1.4,))
    seen = []
    estimate(
        TwoWells(miss=50.0, start=(1.9,)),
        LevenbergMarquardt(max_iterations=0),
        plans=((("first", stage),), (("second", stage),)),
        search=Search(restarts=3),
        progress=lambda name, iteration, cost: seen.append(name) if iteration == 1 else None,
    )
    assert seen == ["first", "search 2, second", "search 3, first", "search 4, second"]


def test_the_same_seed_gives_the_same_answers():
    first, second = (estimate(TwoWells(), search=Search(uniqueness_starts=5, seed=3)) for _ in range(2))
    assert [a.n_searches for a in first.search.answers] == [a.n_searches for a in second.search.answers]
    assert first.values == second.values


@dataclass
class MissedWells(TwoWells):
    """The same with a third datum that nothing explains."""

    miss: float = 30.0
    rows = DataRows(np.arange(3), np.zeros(3, int))

    def residual(self, theta):
        return np.append(super().residual(theta), 100.0)

    def linearize(self, theta):
        first = super().linearize(theta)
        return Linearization(first.residual, np.vstack([first.jacobian, [[0.0]]]))


def test_searches_that_miss_the_noise_and_are_not_the_best_are_left_early():
    """Each search by itself goes on to its minimum; of several only the best does, to the same place."""
    problem, method = MissedWells(start=(1.6,)), LevenbergMarquardt()
    search = Search(restarts=7, seed=2)
    begun = []

    class Counting(SerialExecutor):
        def minimize(self, *arguments):
            begun.append(arguments[2])
            return super().minimize(*arguments)

    found = searched_minima(problem, method, (), search, lambda minimum: False, work=Counting()).minima
    cost = np.array([minimum.costs[-1] for minimum, _ in found])
    best = cost < 1.001 * cost.min()
    assert 1 < best.sum() < len(found)
    assert len(begun) == 2  # the first search, and the best end, which is completed once for all that lead there
    for (minimum, iterations), is_best in zip(found, best, strict=True):
        alone = minimize(problem, method, minimum.history[0])
        assert iterations == len(minimum.inner) == len(minimum.costs) - 1 == len(minimum.history) - 1
        assert minimum.converged == is_best
        if is_best:
            assert minimum.theta == minimum.history[-1]
            assert minimum.theta == pytest.approx(alone.theta, rel=1e-6)
        else:
            assert minimum.message == LEFT
            assert iterations < len(alone.inner)
            assert minimum.costs[-1] == pytest.approx(alone.costs[-1], rel=1e-4)


def test_the_course_of_every_stage_is_kept_and_stored():
    """Each stage begins where the one before ended; an estimate has them in physical values, the last one included."""
    problem, method = TwoWells(start=(1.4,)), LevenbergMarquardt()
    stages = (("mild", TwoWells(weight=1.0)), ("steep", TwoWells(weight=10.0)))
    minimum, iterations = staged(problem, method, stages, np.array([1.4]), None)
    assert [stage.name for stage in minimum.stages] == ["mild", "steep"]
    courses = [*(stage.history for stage in minimum.stages), minimum.history]
    for before, after in itertools.pairwise(courses):
        assert after[0] == before[-1]
    assert iterations == sum(len(course) - 1 for course in courses)
    assert minimum.stages[0].costs[0] == pytest.approx((0.4 * 0.6) ** 2)
    restored = restored_minimum(problem, method, stored_minimum(minimum))
    for kept, stored in zip(minimum.stages, restored.stages, strict=True):
        assert kept.name == stored.name
        np.testing.assert_array_equal(kept.history, stored.history)
        np.testing.assert_array_equal(kept.costs, stored.costs)
        assert kept.n_rows == stored.n_rows == 2 * (len(kept.costs) - 1)
    search = estimate(problem, plans=(stages,)).search
    assert [stage.name for stage in search.stages] == ["mild", "steep", "final"]
    np.testing.assert_array_equal(search.stages[-1].history, search.history)
    assert search.n_rows == 2 * search.n_iterations  # of one search, two data each


def test_a_stage_is_left_where_it_hardly_gains_any_more_and_the_search_itself_is_not(monkeypatch):
    racing = LevenbergMarquardt().raced(np.inf)
    stage, crawl = racing.for_stages(), 0.999 ** np.arange(16)
    assert stage.has_stalled(crawl)
    assert not stage.has_stalled(crawl[:15])
    assert not stage.has_stalled(0.99 ** np.arange(16))
    for never in (racing, racing.patient().for_stages(), LevenbergMarquardt().for_stages()):
        assert not never.has_stalled(crawl)
    monkeypatch.setattr(type(stage), "has_stalled", lambda self, costs: len(costs) > 2)
    left = minimize(TwoWells(), stage)
    assert len(left.inner) == 2
    assert left.message == "the search hardly gains any more"


@pytest.mark.parametrize(("is_good", "expected"), [(True, 1), (False, 4)])
def test_stages_that_were_left_are_searched_to_their_end_where_no_minimum_fits(monkeypatch, is_good, expected):
    """Two restarts, then the first search again: its end is no better, so that the others are not made again."""
    kind = type(LevenbergMarquardt().raced(np.inf).for_stages())
    monkeypatch.setattr(kind, "has_stalled", lambda self, costs: len(costs) > 2)
    paths = ((("easier", TwoWells(start=(0.7,))),),)
    found = searched_minima(TwoWells(), LevenbergMarquardt(), paths, Search(restarts=2), lambda minimum: is_good)
    lengths = [len(minimum.stages[0].costs) - 1 for minimum, _ in found.minima]
    assert len(lengths) == expected
    assert lengths[0] == 2
    assert is_good or lengths[3] > 2


def test_a_stage_that_gains_goes_on_to_its_end():
    stage = minimize(TwoWells(), LevenbergMarquardt().for_stages())
    assert stage.converged
    assert stage.costs[-1] < 1e-6
