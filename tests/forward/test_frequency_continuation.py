"""Frequency continuation on chapter 4's cantilever: undamped, noise-free, twelve lines (Norris 1986, Table 4.1, case 2)."""

from dataclasses import replace

import numpy as np
import pytest

import structid as sid
from structid.forward import frequency_continuation
from structid.identification.options import IdentifyOptions
from structid.reproduce.chapter_4 import (
    CASE_2,
    DEFLECTIONS,
    GRID,
    TIP,
    Reading,
    cantilever,
    exact_record,
    hertz_of,
    rms,
)

NOISE = 1e-10  # stands for rounding
PRINTED = hertz_of(*GRID)
UNKNOWNS = [sid.Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")]


def record_of(outputs, frequency=PRINTED):
    clean = exact_record(CASE_2.actual, Reading("", frequency, outputs))
    return replace(clean, variance=(NOISE * np.abs(clean.values)) ** 2)


def start_of(error, seed):
    direction = np.random.default_rng(seed).standard_normal(12)
    return CASE_2.actual * np.exp(direction * error / rms(direction))


def identified(start, record, **options):
    structure = cantilever(start)
    return sid.identify(structure, sid.parameters(structure, UNKNOWNS), record, IdentifyOptions(**options))


def problem_of(record, form="output"):
    structure = cantilever(CASE_2.postulated)
    return sid.FrfProblem(structure, sid.parameters(structure, UNKNOWNS), record, form)


def test_stages_add_lines_from_the_lowest_and_the_last_is_free():
    problem = problem_of(record_of((TIP,)))
    stages = [stage for _, stage in frequency_continuation(problem)]
    assert [len(stage.record.frequency) for stage in stages] == [*range(1, 13), 12]
    for stage in stages[:-1]:
        assert stage.record.frequency == pytest.approx(problem.record.frequency[: len(stage.record.frequency)])
        assert stage.model_error == 0.1
        assert stage.unknowns.free_prior[0] == pytest.approx(problem.theta_start)
        assert stage.unknowns.free_prior[1] == pytest.approx(0.3 * np.ones(12))
    assert stages[-1].unknowns.free_prior is None
    assert stages[-1].model_error == 0.0
    assert {stage.form for stage in stages} == {"pole_free"}


def test_many_lines_are_added_in_twelve_stages():
    stages = frequency_continuation(problem_of(record_of((TIP,), tuple(np.linspace(0.05, 1.0, 50)))))
    counts = [len(stage.record.frequency) for _, stage in stages]
    assert len(counts) == 13
    assert counts[0] == 5
    assert counts[-2:] == [50, 50]


def test_it_comes_first_for_few_lines_and_not_at_all_for_many():
    few, many = problem_of(record_of((TIP,))), problem_of(record_of((TIP,), tuple(np.linspace(0.05, 1.0, 61))))
    theta = few.theta_start + 0.1
    plans = few.continuation_paths()
    assert len(plans) == 1 + len(few.schedules())
    assert plans[0](theta)[0][1].unknowns.free_prior[0] == pytest.approx(theta)
    assert not any(callable(way) for way in many.continuation_paths())
    assert len(many.continuation_paths()) == len(many.schedules())


def test_equation_form_has_no_stages():
    assert frequency_continuation(problem_of(record_of((TIP,)), "equation")) == ()


def test_one_sensor_finds_the_actual_parameters_from_the_printed_start():
    """RMS error below 1e-7; the condition is 2e7 and each value is good to 1e-16, hence 1e-8 is the limit of rounding."""
    found = identified(CASE_2.postulated, record_of((TIP,))).estimate
    assert rms(found.values / CASE_2.actual - 1) <= 1e-7
    assert found.status is sid.Status.CONVERGED


@pytest.mark.parametrize(
    ("outputs", "error", "seeds"),
    [((TIP,), 0.03, 1), ((TIP,), 0.10, 1), ((TIP, "6RZ+"), 0.30, 2), (DEFLECTIONS, 0.30, 2)],
)
def test_random_starts_end_at_the_actual_parameters(outputs, error, seeds):
    """A small part of benchmarks/accuracy/chapter_4_basins.py: RMS error below 1e-6 from every start."""
    record = record_of(outputs)
    for seed in range(seeds):
        found = identified(start_of(error, seed), record).estimate
        assert rms(found.values / CASE_2.actual - 1) <= 1e-6


def test_an_alias_is_told():
    """Twelve lines in Hz from one sensor have several exact answers: from seed 0 at 20 % the search ends at another."""
    record = record_of((TIP,), GRID)
    told = identified(start_of(0.20, 0), record, uniqueness_starts=3)
    assert told.estimate.status is sid.Status.NOT_IDENTIFIABLE
    assert told.estimate.search.n_fitting > 1
    assert max(rms(a.values / CASE_2.actual - 1) for a in told.estimate.search.answers if a.fits) > 0.1
    assert min(a.distance for a in told.estimate.search.answers[1:]) > 1e6
    assert any("sets of values fit the data equally well" in w for w in told.warnings)
