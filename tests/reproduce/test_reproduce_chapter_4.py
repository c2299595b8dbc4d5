"""Chapter 4 against its printed numbers and against an independent reproduction; four seeds for the random studies."""

import numpy as np
import pytest

from structid import FrfProblem, GaussNewton
from structid.inversion import minimize
from structid.reproduce.chapter_4 import (
    ALL_AT_ALL,
    ALL_AT_HALF,
    CASE_1,
    CASE_2,
    GRID,
    STUDIES_1,
    STUDIES_2,
    TIP,
    TIP_IN_HZ,
    TIP_NODE,
    TIP_PRINTED,
    Noise,
    Reading,
    cantilever,
    classical_errors,
    classical_values,
    cramer_rao,
    errors_of,
    exact_record,
    hertz_of,
    items,
    noisy_errors,
    noisy_record,
    quantiles,
    relative_jacobian,
    rms,
    unknowns,
)
from structid.reproduce.reproduction import ReproducedItem, Verdict

N_SEEDS = 4


@pytest.fixture(scope="module")
def made() -> dict[str, ReproducedItem]:
    seen: list[tuple[str, float]] = []
    found = items(lambda name, part: seen.append((name, part)), N_SEEDS)
    parts = [part for _, part in seen]
    assert parts == sorted(parts)
    assert (parts[0], parts[-1]) == (0.0, 1.0)
    assert {name for name, _ in seen} <= {item.name for item in found}
    return {item.name: item for item in found}


def test_every_table_and_figure_is_there_with_its_verdict(made):
    assert {name: item.verdict for name, item in made.items()} == {
        "Table 4.1": Verdict.READING,
        "Figure 4.1": Verdict.AGREES,
        "Figure 4.2": Verdict.READING,
        "Figure 4.3": Verdict.READING,
        "Figure 4.4": Verdict.REFUTED,
        "Figure 4.5": Verdict.READING,
    }


def test_table_4_1_comes_back_from_the_postulated_parameters(made):
    table = made["Table 4.1"].tables[0]
    assert table.printed[:, 0].tolist() == [0.92, 1.28, 1.17, 0.63, 1.11, 0.98, 1.38, 0.68, 1.24, 0.56, 0.76, 1.12]
    assert table.printed[:6, 2].tolist() == [0.899, 1.052, 1.149, 0.452, 1.004, 0.901]
    assert table.printed[6:, 2].tolist() == [1.042, 0.748, 1.198, 0.552, 1.101, 0.901]
    assert np.abs(table.difference).max() <= 1e-11  # a condition number of 3e4 times rounding
    assert "kg/m" in made["Table 4.1"].note


def test_initial_errors_are_those_printed_if_relative_to_postulated(made):
    assert rms(CASE_1.relative_error) == pytest.approx(0.1110, abs=5e-5)
    assert rms(CASE_2.relative_error) == pytest.approx(0.0297, abs=5e-5)
    assert rms(CASE_1.error_of_actual) == pytest.approx(0.1210, abs=5e-5)
    assert rms(CASE_2.error_of_actual) == pytest.approx(0.0309, abs=5e-5)
    for name, start in (("Figure 4.2", [np.nan, 12, 5]), ("Figure 4.3", [np.nan, 3, 5])):
        assert made[name].tables[0].printed[0].tolist() == pytest.approx(start, nan_ok=True)
        assert np.round(made[name].tables[0].computed[0, 1:]).tolist() == start[1:]


def test_figure_4_2_has_the_history_of_the_independent_reproduction(made):
    history = made["Figure 4.2"].tables[1].computed
    assert history[:5, 0] == pytest.approx([1.11e-1, 2.98e-2, 3.58e-3, 1.66e-5, 1.7e-10], rel=2e-2)
    assert history[5, 0] <= 1e-12
    assert history[1, 1] <= 1e-11
    others = made["Figure 4.2"].tables[2]
    zero = dict(zip(others.columns, (others.computed < 1e-12).any(axis=0), strict=True))
    assert zero == {
        "1 rad/s": True, "2 rad/s": True, "6 rad/s": True, "3 rad/s": False, "0.5 Hz": False, ALL_AT_ALL.label: False
    }  # fmt: skip
    assert others.computed[1:4, 5] == pytest.approx([0.115, 0.168, 0.234], abs=1e-3)


def test_figure_4_3_converges_under_each_reading_but_the_printed_one(made):
    assert errors_of(CASE_2, TIP_IN_HZ)[:5] == pytest.approx([2.97e-2, 8.7e-3, 3.3e-4, 9.4e-7, 6.5e-12], rel=2e-2)
    assert errors_of(CASE_2, TIP_NODE)[:4] == pytest.approx([2.97e-2, 1.8e-3, 1.6e-5, 3.4e-9], rel=2e-2)
    assert errors_of(CASE_2, TIP_PRINTED)[-1] == np.inf
    assert np.linalg.cond(relative_jacobian(CASE_2, TIP_PRINTED)) == pytest.approx(2.2e7, rel=0.02)
    singles, pairs = made["Figure 4.3"].tables[2:]
    assert singles.computed[:, 1] == pytest.approx([383, 10.7, 648, 0.958, 6.00, 52.4], rel=5e-3)
    assert np.isnan(singles.computed[:, 2]).all()
    assert np.isfinite(singles.computed[:, 5]).tolist() == [False, False, False, True, True, True]
    assert len(pairs.rows) == 15
    assert (pairs.computed[:, 2] <= 5).all()


def test_steps_are_those_of_the_gauss_newton_method():
    for case, reading in ((CASE_1, ALL_AT_HALF), (CASE_2, TIP_IN_HZ)):
        record = exact_record(case.actual, reading)
        structure = cantilever(case.postulated)
        problem = FrfProblem(structure, unknowns(structure), record, "equation")
        found = minimize(problem, GaussNewton(step_control=False, max_iterations=4, step_tolerance=0.0))
        assert np.array_equal(classical_values(case, record, 4), found.history)


def test_an_iteration_that_fails_stays_infinite():
    errors = classical_errors(CASE_2, exact_record(CASE_2.actual, TIP_PRINTED), 8)
    assert np.isfinite(errors[:3]).all()
    assert np.isposinf(errors[3:]).all()


@pytest.mark.parametrize(
    "case, reading, noise, bound",
    [
        (CASE_1, ALL_AT_HALF, Noise(1e-2), 12.07),
        (CASE_1, ALL_AT_ALL, Noise(1e-2), 0.00196),
        (CASE_2, TIP_PRINTED, Noise(1e-4), 26.0),
        (CASE_2, TIP_IN_HZ, Noise(1e-4), 0.001127),
        (CASE_2, TIP_NODE, Noise(1e-4), 0.004566),
        # amplitude: every parameter by 0.005; frequency: masses by twice 0.005; independent
        (CASE_1, ALL_AT_HALF, Noise(amplitude=5e-3), 0.005),
        (CASE_1, ALL_AT_HALF, Noise(amplitude=5e-3, frequency=5e-3), np.sqrt(0.005**2 + 0.01**2 / 2)),
    ],
)
def test_cramer_rao_bounds(case, reading, noise, bound):
    assert cramer_rao(case, reading, noise) == pytest.approx(bound, rel=2e-3)


def test_cramer_rao_bound_of_square_and_of_whitened_data_agree():
    """Twelve readings by solving, or as 24 readings (each one twice, with twice the variance) by whitening."""
    noise = Noise(1e-4, 5e-6, 5e-6)
    twice = Reading("", tuple(np.sort(np.concatenate([GRID, np.multiply(GRID, 1 + 1e-9)]))), (TIP,))
    doubled = Noise(*(np.sqrt(2) * np.array([noise.sensors, noise.amplitude, noise.frequency])))
    assert cramer_rao(CASE_2, twice, doubled) == pytest.approx(cramer_rao(CASE_2, TIP_IN_HZ, noise), rel=1e-4)


def test_noise_does_what_it_says():
    reading = Reading("", hertz_of(0.5, 1.0), ("3Y+", TIP))
    exact = exact_record(CASE_1.actual, reading)

    def ratios(noise):
        seeds = range(100)
        found = [noisy_record(CASE_1, reading, noise, np.random.default_rng(seed)).values for seed in seeds]
        return np.array(found).real[..., 0] / exact.values.real[..., 0] - 1

    sensors = ratios(Noise(sensors=1e-2)).reshape(-1, 4)
    assert sensors.std(axis=0) == pytest.approx(1e-2, rel=0.3)  # four deviations of 100 draws
    assert np.abs(np.corrcoef(sensors.T) - np.eye(4)).max() < 0.4
    amplitude = ratios(Noise(amplitude=1e-2))
    assert np.ptp(amplitude, axis=2).max() < 1e-12  # common to the sensors
    assert np.ptp(amplitude, axis=1).min() > 0  # but not to the frequencies
    gain = ratios(Noise(gain=1e-2)).reshape(-1, 4)
    assert np.ptp(gain, axis=1).max() < 1e-12
    assert np.array_equal(
        noisy_record(CASE_1, reading, Noise(frequency=1e-3), np.random.default_rng(0)).frequency, exact.frequency
    )
    frequency = ratios(Noise(frequency=1e-3))
    shifted = exact_record(CASE_1.actual, Reading("", hertz_of(0.5005, 1.001), ("3Y+", TIP))).values.real[..., 0]
    slope = (shifted / exact.values.real[..., 0] - 1) / 1e-3
    assert frequency.std(axis=0) == pytest.approx(np.abs(slope) * 1e-3, rel=0.3)


def test_random_studies_repeat_and_count_diverged_runs_as_the_largest():
    study = STUDIES_2[0]
    errors = noisy_errors(study.case, study.reading, study.noise, range(3), 3)
    assert np.array_equal(errors, noisy_errors(study.case, study.reading, study.noise, range(3), 3))
    low, middle, high = quantiles(np.array([[1.0, 2.0], [3.0, np.inf], [2.0, np.inf]]))
    assert middle.tolist() == [2.0, np.inf]
    assert low.tolist() == [1.0, 2.0]
    assert high.tolist() == [3.0, np.inf]


def test_noisy_figures_say_which_reading_improves(made):
    first, second = (made[name].tables[0] for name in ("Figure 4.4", "Figure 4.5"))
    assert first.rows == tuple(study.label for study in STUDIES_1)
    improved = {
        row: cells[8] for table in (first, second) for row, cells in zip(table.rows, table.computed, strict=True)
    }
    assert improved["as printed: sensors 1 %, independent"] == 0
    assert improved["excitation noise only"] == 100
    assert improved["one gain error of 1 % common to all sensors"] == 100
    assert improved["as printed: tip deflection, rad/s"] == 0
    assert improved["tip deflection, Hz"] == 100
    assert improved["tip deflection and rotation, rad/s"] == 100
    assert f"Seeds 0 to {N_SEEDS - 1}" in made["Figure 4.4"].note
    for item in (made["Figure 4.4"], made["Figure 4.5"]):
        for panel in item.panels:
            for curve in panel.curves:
                assert (curve.low <= curve.y).all()
                assert (curve.y <= curve.high).all()
