"""Instrumental variables: exact recovery, no bias where least squares has one, covariance, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from time_cases import all_of, chain, everything, off, record_of, undamped_free

from structid import InputError, Status, TimeRecord
from structid.forward import Oscillation, TimeOptions, identify_motion, simulated_time_record
from structid.forward.time.estimate import dense_rows
from structid.forward.time.identify_time import identify_time
from structid.forward.time.instrumental import instrumental_fit

KINDS = ("acceleration", "velocity", "displacement")
BY_INSTRUMENTS = TimeOptions(method="instrumental")


def test_exact_motion_gives_back_the_parameters():
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, all_of(structure, *KINDS), n=40, noise=1e-3)
    found = identify_time(structure, off(unknown, 0.5), record, BY_INSTRUMENTS)
    assert found.status is Status.CONVERGED
    assert found.values == pytest.approx(unknown.start, rel=1e-9)


def test_rows_equal_the_textbook():
    """B, the instruments and the weight, written out: dM a + dC v + dK w, and M S M' + C S C' + K S K'."""
    structure = chain()
    unknown = off(everything(structure))
    sensors = all_of(structure, *KINDS)
    record = record_of(structure, everything(structure), sensors, n=12, rng=np.random.default_rng(0))
    record = replace(record, variance=np.append(record.variance[:9], 0.01))
    fit = instrumental_fit(structure, unknown, record, BY_INSTRUMENTS)
    regressors, right = dense_rows(fit.equations, fit.equations.fields(fit.motion))
    parts = [record.values[:, 3 * i : 3 * i + 3] for i in range(3)]
    kinds = ("mass", "damping", "stiffness")
    for j in range(9):
        column = unknown.design[:, [j]].toarray()[:, 0]
        expected = sum(x @ structure.matrix(kind, column).toarray() for kind, x in zip(kinds, parts, strict=True))
        assert regressors[:, :, j] == pytest.approx(expected, abs=1e-12)
    assert right[:, 0] == pytest.approx(record.values[:, 9])
    total = np.diag([record.variance[9], 0, 0])
    for i, kind in enumerate(kinds):
        matrix = structure.matrix(kind, unknown.values(unknown.start)).toarray()
        total = total + matrix @ np.diag(record.variance[3 * i : 3 * i + 3]) @ matrix.T
    rows = fit.rows(unknown.start)
    whitened = rows.regressors.reshape(12, 3, 9)
    gram = np.einsum("tij,tik->jk", regressors, np.linalg.solve(total, regressors))
    assert np.einsum("tij,tik->jk", whitened, whitened) == pytest.approx(gram, rel=1e-9)
    clean = record_of(structure, unknown, sensors, n=12)
    exact = dense_rows(
        fit.equations, fit.equations.fields(instrumental_fit(structure, unknown, clean, BY_INSTRUMENTS).motion)
    )
    factor = np.linalg.inv(np.linalg.cholesky(total))
    assert rows.instruments.reshape(12, 3, 9) == pytest.approx(factor @ exact[0], abs=1e-8 * np.abs(whitened).max())


def test_estimate_is_consistent_where_least_squares_is_not():
    """10 % noise in every channel, 1000 samples: least squares is many standard deviations off, instruments are not."""
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, all_of(structure, *KINDS), n=1000, noise=0.1, rng=np.random.default_rng(1))
    found = identify_time(structure, off(unknown, 0.1), record, BY_INSTRUMENTS)
    plain = identify_motion(structure, unknown, record)
    assert found.status is Status.CONVERGED
    assert found.chi_square_per_dof == pytest.approx(1, abs=0.05)
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()
    assert np.abs(found.values / unknown.start - 1).max() < 0.3 * np.abs(plain.values / unknown.start - 1).max()


@pytest.mark.parametrize("declared", [True, False])
def test_covariance_is_that_of_repeats(declared):
    """40 repeats; without declared noise the standard deviations come from the residual (Student's t, wider)."""
    structure, rng = chain(), np.random.default_rng(2)
    unknown = everything(structure)
    sensors, scores = all_of(structure, *KINDS), []
    for _ in range(40):
        record = record_of(structure, unknown, sensors, n=100, rng=rng, force_noise=0.02)
        record = record if declared else replace(record, variance=None)
        found = identify_time(structure, unknown, record, replace(BY_INSTRUMENTS, first_samples=100))
        assert bool(np.isnan(found.goodness.chi_square)) is not declared
        scores.append((found.values - unknown.start) / found.std)
    scores = np.array(scores)
    assert (0.75 if declared else 0.4) < (scores**2).mean() < 1.3
    assert 0.92 < (np.abs(scores) < 1.96).mean() <= (0.98 if declared else 1.0)


def test_unknown_start_is_taken_from_the_first_sample():
    structure = chain()
    unknown = everything(structure)
    start = np.array([0.1, 0.0, -0.1, 1.0, 0.5, 0.0])
    free = TimeOptions(method="instrumental", initial="unknown")
    record = record_of(structure, unknown, all_of(structure, *KINDS), n=60, rng=np.random.default_rng(3),
                       options=free, initial=start)  # fmt: skip
    rows = instrumental_fit(structure, unknown, record, free).rows(unknown.start)
    assert not rows.instruments[:3].any()  # its own noise is in the simulation that starts there
    assert rows.instruments[3:].any()
    found = identify_time(structure, unknown, record, free)
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()
    sensors = all_of(undamped_free(), "acceleration", "displacement")
    other = record_of(undamped_free(), everything(undamped_free()), sensors, n=60)
    with pytest.raises(InputError, match="velocity at the first sample"):
        identify_time(undamped_free(), everything(undamped_free()), other, free)


def test_oscillation_from_noisy_force_samples():
    structure = undamped_free()
    unknown = everything(structure)
    options = TimeOptions(method="instrumental", force=Oscillation(5.0))
    force = 2 * np.cos(5 * np.arange(200) / 20)
    sensors = all_of(structure, "acceleration", "displacement")
    like = record_of(structure, unknown, sensors, n=200)
    values = np.array(like.values)
    values[:, -1] = force
    noisy = simulated_time_record(
        structure, unknown, replace(like, values=values), replace(options, method="output_error"), None
    )
    variance = (0.02 * noisy.values.std(axis=0)) ** 2
    rng = np.random.default_rng(4)
    record = replace(
        noisy, values=noisy.values + np.sqrt(variance) * rng.standard_normal(values.shape), variance=variance
    )
    found = identify_time(structure, off(unknown, 0.1), record, options)
    assert found.status is Status.CONVERGED
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()
    assert found.chi_square_per_dof == pytest.approx(1, abs=0.2)


def test_too_few_samples_are_not_identifiable():
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, all_of(structure, *KINDS), n=2, rng=np.random.default_rng(5))
    found = identify_time(structure, unknown, record, BY_INSTRUMENTS)
    assert found.status is Status.NOT_IDENTIFIABLE
    assert np.isnan(found.values).all()
    assert np.isnan(found.std).any()


def test_what_is_missing_is_said():
    structure = chain()
    unknown = everything(structure)
    sensors = all_of(structure, *KINDS)
    record = record_of(structure, unknown, sensors, n=20)
    quiet = np.array(record.variance)
    quiet[:3] = 0
    quiet[6:] = 0
    cases = {
        "not measured at 3X": record_of(structure, unknown, sensors[:2] + sensors[3:], n=20),
        "velocity is missing": record_of(structure, unknown, all_of(structure, KINDS[0], KINDS[2]), n=20),
        "no force": TimeRecord(20.0, record.values[:, :9], record.channels[:9], record.quantities[:9]),
        "equation of motion exact": replace(record, variance=0 * quiet),
    }
    for words, given in cases.items():
        with pytest.raises(InputError, match=words):
            identify_time(structure, unknown, given, BY_INSTRUMENTS)
