"""Deviations of modes hold exact laws: a factor of a per cent in one of them shows without a simulation."""

import numpy as np
import pytest
from scipy import special, stats

from structid import TimeRecord
from structid.modal.correlations import outputs
from structid.modal.merging import _frequency_agreement
from structid.modal.subspace.decay_fit import decay_fit, schwarz, strength
from structid.modal.subspace.pole_uncertainty import overlapping_batches

RATE, N_TIMES = 10.0, 320
POLES = np.array([-0.05 + 2j, -0.1 + 3.1j])
SHAPES = np.array([[1.0, 1.0], [0.6 + 0.1j, -0.8], [0.2, 0.4 - 0.1j]])


def noisy_decay(seed=0):
    motion = (np.exp(POLES * np.arange(N_TIMES)[:, None] / RATE) @ SHAPES.T).real
    noise = np.random.default_rng(seed).standard_normal(motion.shape) * [0.02, 0.04, 0.01]
    return outputs(TimeRecord(RATE, motion + noise, ("1Z", "2Z", "3Z"), ("displacement",) * 3))


def left_by(poles, data):
    """Residual of the best amplitudes, (n_times, n_channels), and the projection that leaves it."""
    motion = np.exp(poles * np.arange(N_TIMES)[:, None] / RATE)
    basis = np.concatenate([motion.real, motion.imag], axis=1)
    rest = np.eye(N_TIMES) - basis @ np.linalg.pinv(basis)
    return rest @ data.series[0], rest


def test_noise_of_a_decay_is_its_residual_over_what_white_noise_would_leave():
    """Level by N - 2 n degrees of freedom; around a mode by windowed transforms over their mean for projected white noise."""
    data = noisy_decay()
    fit = decay_fit(data, POLES)
    residual, rest = left_by(fit.poles, data)
    level = np.sqrt(np.sum(residual**2, axis=0) / (N_TIMES - 4))
    length = N_TIMES // 8  # 24 / 3 channels
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length)
    for mode, pole in enumerate(fit.poles):
        power = expected = 0.0
        for start in range(0, N_TIMES - length + 1, length // 2):
            row = np.zeros(N_TIMES, complex)
            row[start : start + length] = window * np.exp(-1j * pole.imag * np.arange(length) / RATE)
            power += np.mean(np.abs(row @ residual / level) ** 2)
            expected += np.linalg.norm(row @ rest) ** 2
        np.testing.assert_allclose(fit.noise[:, mode], level * np.sqrt(power / expected), rtol=1e-9)


def test_covariance_of_poles_is_that_of_all_unknowns_in_that_noise():
    """(J'J)^-1 of poles and amplitudes of all channels, by closed derivatives, times the noise around each mode."""
    data = noisy_decay(1)
    fit = decay_fit(data, POLES)
    residual, _ = left_by(fit.poles, data)
    level = np.sqrt(np.sum(residual**2, axis=0) / (N_TIMES - 4))
    time = np.arange(N_TIMES)[:, None] / RATE
    motion = np.exp(fit.poles * time)
    rows = []
    for channel in range(3):
        by_pole = time * motion * fit.amplitudes[0][:, channel]
        own = np.zeros((N_TIMES, 3, 4))
        own[:, channel] = np.concatenate([motion.real, -motion.imag], axis=1)
        columns = np.concatenate([by_pole.real, -by_pole.imag, own.reshape(N_TIMES, -1)], axis=1)
        rows.append(columns / level[channel])
    jacobian = np.concatenate(rows)
    dense = np.linalg.inv(jacobian.T @ jacobian)[:4, :4]
    local = np.tile(fit.noise[0] / level[0], 2)
    scale = np.sqrt(np.diag(dense))
    np.testing.assert_allclose(
        fit.pole_covariance / np.outer(scale * local, scale * local), dense / np.outer(scale, scale), rtol=0, atol=1e-8
    )


def test_strength_of_a_mode_is_the_f_statistic_of_leaving_it_out():
    """What the residual grows by without the mode, over 2 m amplitudes and the variance by N - 2 n degrees of freedom."""
    data = noisy_decay(2)
    left, _ = left_by(POLES, data)
    variance = np.sum(left**2, axis=0) / (N_TIMES - 4)
    found = strength(data, POLES)
    for mode in range(2):
        without, _ = left_by(np.delete(POLES, mode), data)
        grown = np.sum((np.sum(without**2, axis=0) - np.sum(left**2, axis=0)) / variance)
        assert found[mode] == pytest.approx(grown / (2 * 3), rel=1e-9)
    likelihood = N_TIMES * np.sum(np.log(variance))
    assert schwarz(data, POLES) == pytest.approx(likelihood + (4 + 12) * np.log(3 * N_TIMES), rel=1e-12)


@pytest.mark.parametrize("memory", [0.5, 1.0, 3.0])
def test_batches_of_independent_pieces_sum_to_their_variance_exactly(memory):
    """Every column of the centring matrix is one piece that differs: squares of batches sum to n, less Student's factor."""
    n = 48
    pieces = (np.eye(n) - 1 / n) * np.sqrt(n / (n - 1)) + 0j
    batches, _ = overlapping_batches(pieces, pieces[:, None, :], 1.0, memory)
    size = n + 1 - len(batches)
    student = special.stdtrit(1.5 * n / size, 0.975) / special.ndtri(0.975) if size > 1 else 1.0
    assert np.sum(np.abs(batches) ** 2) / student**2 == pytest.approx(n, rel=1e-12)


def test_agreement_of_set_ups_is_chi_square_of_one_less_than_their_number():
    frequency = np.array([[2.0, 3.0], [2.02, 3.0], [1.99, np.nan]])
    variance = np.array([[1e-4, 1e-4], [4e-4, 1e-4], [1e-4, np.nan]])
    chi_square, probability = _frequency_agreement(frequency, variance)
    mean = (2.0 / 1e-4 + 2.02 / 4e-4 + 1.99 / 1e-4) / (1 / 1e-4 + 1 / 4e-4 + 1 / 1e-4)
    first = ((2.0 - mean) ** 2 + (2.02 - mean) ** 2 / 4 + (1.99 - mean) ** 2) / 1e-4
    np.testing.assert_allclose(chi_square, [first, 0.0], atol=1e-9)
    np.testing.assert_allclose(probability, [stats.chi2.sf(first, 2), 1.0], rtol=1e-9)
