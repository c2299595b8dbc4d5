"""Weak form: test functions, covariance of the equation error, exact recovery, drift, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate
from time_cases import all_of, chain, everything, off, record_of, undamped_free

from structid import InputError, Status, TimeRecord
from structid.forward import TimeOptions, identify_motion, simulated_time_record
from structid.forward.time.identify_time import identify_time
from structid.forward.time.weak_form import _filters, modulating_function, weak_form

WEAK = TimeOptions(method="weak", window=1.0)


def smooth_record(structure, unknown, sensors, n=1000, noise=0.02, rng=None, seed=0, initial=None):
    """Motion at 100 Hz under a force of a few slow oscillations, which the samples show well."""
    time, draw = np.arange(n) / 100.0, np.random.default_rng(seed)
    force = sum(np.cos(w * time + draw.uniform(0, 6)) for w in (2.0, 5.0, 7.0, 9.0, 12.0))
    dofs, kinds = (*[s for s, _ in sensors], "1X"), (*[q for _, q in sensors], "force")
    blank = TimeRecord(100.0, np.column_stack([np.zeros((n, len(sensors))), force]), dofs, kinds)
    clean = simulated_time_record(structure, unknown, blank, TimeOptions(initial="unknown"), initial=initial)
    variance = (noise * np.sqrt((clean.values**2).mean(axis=0))) ** 2
    values = clean.values if rng is None else clean.values + np.sqrt(variance) * rng.standard_normal(clean.values.shape)
    return replace(clean, values=values, variance=variance)


def test_test_functions_are_derivatives_of_a_bump():
    x = np.linspace(-0.7, 0.7, 1401)
    assert modulating_function(x, 0) == pytest.approx(np.where(np.abs(x) < 0.5, np.cos(np.pi * x) ** 16, 0), abs=1e-14)
    for order in range(5):
        slope = (modulating_function(x + 1e-5, order) - modulating_function(x - 1e-5, order)) / 2e-5
        expected = modulating_function(x, order + 1)
        assert slope == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
        assert np.abs(modulating_function(np.array([0.4999999]), order)).max() < 1e-9


STATE = np.array([0.1, 0.0, -0.1, 1.0, 0.5, 0.0])
MIXED = [("1X", "acceleration"), ("2X-", "velocity"), ("3X", "displacement")]


@pytest.mark.parametrize("kinds", ["acceleration", "velocity", "displacement", "mixed"])
@pytest.mark.parametrize("drift", [0, 2])
def test_exact_motion_gives_back_the_parameters_from_any_start_of_motion(kinds, drift):
    """Mass, damping and stiffness, from one quantity of each degree of freedom and an unknown state at the start.

    The force is taken as straight between samples, which is 1e-4 of it at 12 rad/s and 100 Hz.
    """
    structure = chain()
    unknown = everything(structure)
    sensors = MIXED if kinds == "mixed" else all_of(structure, kinds)
    record = smooth_record(structure, unknown, sensors, initial=STATE, noise=1e-3)
    found = identify_time(structure, off(unknown, 0.5), record, replace(WEAK, drift=drift))
    assert found.status is Status.CONVERGED
    assert found.values == pytest.approx(unknown.start, rel=2e-3)


def test_drift_and_offset_drop_out():
    structure = undamped_free()
    unknown = everything(structure)
    record = smooth_record(structure, unknown, all_of(structure, "acceleration"), noise=1e-3)
    values = np.array(record.values)
    values[:, :3] += np.outer(np.arange(1000) / 100.0, [1.0, -2.0, 0.5])
    values[:, :3] += np.array([3.0, 0.0, 1.0])
    drifting = replace(record, values=values)
    blind = identify_time(structure, unknown, drifting, replace(WEAK, drift=2))
    assert blind.values == pytest.approx(unknown.start, rel=2e-3)
    offset = identify_time(structure, unknown, drifting, WEAK)
    assert np.abs(offset.values / unknown.start - 1).max() > 0.05


def test_fields_equal_integrals_of_the_motion():
    structure = chain()
    unknown = everything(structure)
    record = smooth_record(structure, unknown, all_of(structure, "acceleration", "displacement", "velocity"))
    only = TimeOptions(method="weak", window=4.0, windows=3, quantities=("acceleration",))
    form = weak_form(structure, unknown, record, only)
    for i, middle in enumerate((2.0, 4.995, 7.99)):
        test = modulating_function((record.time - middle) / 4.0, 2) / 16
        for rows, first in ((slice(0, 3), 0), (slice(3, 6), 6), (slice(6, 9), 3)):
            expected = integrate.simpson(test[:, None] * record.values[:, first : first + 3], x=record.time, axis=0)
            assert form.fields[rows, i] == pytest.approx(expected, abs=1e-4 * np.abs(form.fields[rows]).max())


def test_covariance_of_the_rows_equals_that_of_draws():
    """Rows are linear in the noise: propagated through every channel and sample by brute force."""
    structure = chain()
    unknown = everything(structure)
    record = smooth_record(structure, unknown, MIXED, n=32)
    options = TimeOptions(method="weak", window=0.2, windows=2, drift=1)
    form = weak_form(structure, unknown, record, options)

    laws = [structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness")]
    fields, columns = [], []
    for t in range(32):
        for channel in range(4):
            unit = np.zeros((32, 4))
            unit[t, channel] = np.sqrt(record.variance[channel])
            parts = weak_form(structure, unknown, replace(record, values=unit), options).fields
            fields.append(parts.ravel())
            moved = sum(matrix @ parts[3 * i : 3 * i + 3] for i, matrix in enumerate(laws))
            columns.append((moved - parts[9:]).T.ravel())
    brute = np.array(columns).T @ np.array(columns)
    assert form.covariance(unknown.start) == pytest.approx(brute, rel=1e-9, abs=1e-12 * np.abs(brute).max())
    weighted = np.random.default_rng(0).standard_normal((2, 3))
    expected = np.array(fields).T @ (np.array(columns) @ weighted.ravel())
    assert form.noise(unknown.start, weighted).ravel() == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_covariance_is_that_of_repeats_and_the_noisy_regressors_leave_no_bias():
    structure, rng = undamped_free(), np.random.default_rng(1)
    unknown, scores, chi = everything(structure), [], []
    for _ in range(40):
        record = smooth_record(structure, unknown, all_of(structure, "acceleration"), n=400, noise=0.1, rng=rng)
        found = identify_time(structure, unknown, record, WEAK)
        scores.append((found.values - unknown.start) / found.std)
        chi.append(found.chi_square_per_dof)
    scores = np.array(scores)
    assert 0.7 < (scores**2).mean() < 1.4
    assert np.abs(scores.mean(axis=0)).max() < 4 / np.sqrt(40)
    assert np.mean(chi) == pytest.approx(1, abs=0.05)


def test_solution_minimizes_the_residual_weighted_by_its_own_covariance():
    """R' C^-1 R, both functions of the parameters, is stationary: the likelihood of noisy regressors at its maximum."""
    structure = chain()
    unknown = everything(structure)
    record = smooth_record(
        structure, unknown, all_of(structure, "acceleration"), noise=0.05, rng=np.random.default_rng(6)
    )
    form = weak_form(structure, unknown, record, WEAK)
    found = identify_time(structure, unknown, record, WEAK)

    def cost(values):
        return float((form.rows(values).residual(values) ** 2).sum())

    steps = np.diag(0.02 * found.std_noise)
    slope = [(cost(found.values + d) - cost(found.values - d)) / 0.04 for d in steps]
    assert np.abs(slope).max() < 2e-3  # in standard deviations; without the noise of the regressors it is far more


def test_integrated_noise_does_not_grow_with_the_record():
    """From accelerations alone, where least squares on twice integrated motion is far off."""
    structure = undamped_free()
    unknown = everything(structure)
    record = smooth_record(
        structure, unknown, all_of(structure, "acceleration"), noise=0.05, rng=np.random.default_rng(2)
    )
    found = identify_time(structure, off(unknown, 0.2), record, WEAK)
    plain = identify_motion(structure, unknown, record, rule="trapezoid")
    error = np.abs(found.values / unknown.start - 1).max()
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()
    assert error < 0.2 * np.abs(plain.values / unknown.start - 1).max()


def test_default_windows_pass_the_motion():
    structure = chain()
    unknown = everything(structure)
    record = smooth_record(structure, unknown, all_of(structure, "acceleration"), rng=np.random.default_rng(3))
    found = identify_time(structure, off(unknown, 0.2), record, TimeOptions(method="weak"))
    assert found.status is Status.CONVERGED
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()


def test_too_few_windows_are_not_identifiable():
    structure = chain()
    unknown = everything(structure)
    record = smooth_record(structure, unknown, all_of(structure, "acceleration"))
    found = identify_time(structure, unknown, record, replace(WEAK, windows=2))
    assert found.status is Status.NOT_IDENTIFIABLE
    assert np.isnan(found.values).all()


def test_what_is_missing_is_said():
    structure = chain()
    unknown = everything(structure)
    record = smooth_record(structure, unknown, all_of(structure, "acceleration"))
    quiet = replace(record, variance=np.zeros(4))
    cases = {
        "measured as displacement or velocity or acceleration .* at 2X": (
            record_of(structure, unknown, [("1X", "acceleration"), ("3X", "velocity")], n=100),
            WEAK,
        ),
        "no noise level": (replace(record, variance=None), WEAK),
        "force channels": (
            TimeRecord(100.0, record.values[:, :3], record.channels[:3], record.quantities[:3], np.ones(3)),
            WEAK,
        ),
        "`window` must be from": (record, replace(WEAK, window=100.0)),
        "`windows` must be at most 1000": (record, replace(WEAK, windows=1001)),
        "test functions must be independent": (quiet, WEAK),
    }
    for words, (given, options) in cases.items():
        with pytest.raises(InputError, match=words):
            identify_time(structure, unknown, given, options)


def test_test_functions_are_sampled_inside_their_windows_alone():
    n_times, step, length = 400, 0.02, 0.5
    filters = _filters(n_times, step, 2, length, None, {0, 2})
    count = filters[0].shape[0]
    middle = np.linspace(length / 2, (n_times - 1) * step - length / 2, count)
    place = (np.arange(n_times) * step - middle[:, None]) / length
    cosine, sine = np.cos(np.pi * place), np.sin(np.pi * place)
    bump = {0: cosine**16, 2: np.pi**2 * (240 * cosine**14 * sine**2 - 16 * cosine**16)}
    for order, rows in filters.items():
        expected = step * np.where(np.abs(place) < 0.5, bump[order], 0.0) / length**order
        assert rows.toarray() == pytest.approx(expected, abs=1e-9)
        assert rows.nnz <= count * 26
