"""Maximum likelihood of free decays: slopes, dense covariance, coverage, close pairs and coloured noise."""

import numpy as np
import pytest
from modal_cases import HEAVY_DAMPING, HEAVY_FREQUENCY, beam_decay, damped_decay, decay, nearest
from scipy.signal import lfilter

from structid import TimeRecord
from structid.modal import ModalOptions, modal_identification
from structid.modal.correlations import outputs
from structid.modal.subspace.decay_fit import _normal, _project_records, decay_fit, decay_shapes
from structid.reproduce.chapter_5 import beam_omega

POLES = np.array([-0.05 + 2j, -0.1 + 3.1j])
SHAPES = np.array([[1.0, 1.0], [0.6 + 0.1j, -0.8], [0.2, 0.4 - 0.1j]])


def record(noise=0.02, seed=0, amplitudes=((1.0, 0.7),), n=400):
    rng = np.random.default_rng(seed)
    time = np.arange(n)[:, None] * 0.1
    found = []
    for given in amplitudes:
        motion = (np.exp(POLES * time) * given @ SHAPES.T).real
        values = motion + noise * rng.standard_normal(motion.shape) * [1.0, 2.0, 0.5]
        found.append(TimeRecord(10.0, values, ("1Z", "2Z", "3Z"), ("displacement",) * 3))
    return found


def misfit(data, poles):
    return [p.residual for p in _project_records(data, poles)]


def test_gradient_and_normal_matrix_against_differences():
    sigma = np.array([1.0, 2.0, 0.5])
    data = outputs(record(0.0, amplitudes=((1.0, 0.7), (0.3j, -1.0))))
    off = POLES * 1.01
    theta = np.concatenate([off.real, off.imag])

    def cost(at):
        return sum(np.sum((r / sigma) ** 2) for r in misfit(data, at[:2] + 1j * at[2:]))

    _, gradient, value = _normal(_project_records(data, off), sigma)
    assert value == pytest.approx(cost(theta), rel=1e-12)
    step = 1e-6 * np.eye(4)
    numeric = [(cost(theta + h) - cost(theta - h)) / 4e-6 for h in step]
    np.testing.assert_allclose(gradient, numeric, rtol=0, atol=1e-6 * np.abs(gradient).max())

    theta = np.concatenate([POLES.real, POLES.imag])  # where the residual vanishes, Kaufman's Jacobian is exact

    def whitened(at):
        return np.concatenate([(r / sigma).ravel() for r in misfit(data, at[:2] + 1j * at[2:])])

    slope = np.array([(whitened(theta + h) - whitened(theta - h)) / 2e-6 for h in step])
    matrix = _normal(_project_records(data, POLES), sigma).matrix
    np.testing.assert_allclose(matrix, slope @ slope.T, rtol=0, atol=1e-7 * np.abs(matrix).max())


@pytest.mark.parametrize("amplitudes", [((1.0, 0.7),), ((1.0, 0.7), (0.3j, -1.0))])
def test_covariance_is_that_of_the_problem_with_all_amplitudes(amplitudes):
    data = outputs(record(amplitudes=amplitudes))
    fit = decay_fit(data, POLES)
    local = fit.noise[0] / fit.noise[0, 0]
    n_records, n = len(data.series), len(data.series[0])
    packed = np.concatenate([fit.poles.real, fit.poles.imag])
    given = np.array([[a.real, a.imag] for a in fit.amplitudes])  # (records, 2, modes, channels)
    theta = np.concatenate([packed, given.ravel()])

    def model(at):
        motion = np.exp((at[:2] + 1j * at[2:4]) * np.arange(n)[:, None] / 10.0)
        a = at[4:].reshape(n_records, 2, 2, 3)
        parts = [(motion @ (re + 1j * im)).real / level for re, im in a]
        return np.concatenate([p.ravel() for p in parts])

    level = np.sqrt(sum(np.sum(r**2, axis=0) for r in misfit(data, fit.poles)) / (n_records * (n - 4)))
    slope = np.array([(model(theta + h) - model(theta - h)) / 2e-6 for h in 1e-6 * np.eye(len(theta))])
    dense = np.linalg.inv(slope @ slope.T)
    factor = fit.noise.mean(axis=0) / level.mean()
    np.testing.assert_allclose(
        fit.pole_covariance, dense[:4, :4] * np.outer(np.tile(factor, 2), np.tile(factor, 2)), rtol=1e-5
    )
    assert local == pytest.approx(factor / factor[0])
    slopes = np.array([[part.real, part.imag] for part in fit.slopes])  # (records, 2, parameters, modes, channels)
    plain = fit.pole_covariance / np.outer(np.tile(factor, 2), np.tile(factor, 2))
    cross = np.einsum("ij,rpjkc->irpkc", plain, slopes).reshape(4, -1)
    np.testing.assert_allclose(cross, dense[:4, 4:], rtol=0, atol=1e-4 * np.abs(dense[:4, 4:]).max())
    own = dense[4:, 4:].reshape(n_records, 2, 2, 3, n_records, 2, 2, 3)
    for r in range(n_records):
        for mode in range(2):
            for channel in range(3):
                j = slopes[r, :, :, mode, channel]
                expected = fit.amplitude_covariance[r][mode] * level[channel] ** 2 + j @ plain @ j.T
                block = own[r, :, mode, channel, r, :, mode, channel]
                np.testing.assert_allclose(block, expected, rtol=0, atol=1e-4 * np.abs(block).max())
    if n_records == 1:  # shape entries by the delta method on all of the dense covariance, mode by mode
        shapes, std = decay_shapes(fit, np.ones(3), np.repeat(np.eye(3)[:, :, None], 2, axis=2).astype(complex))
        for mode in range(2):

            def real_shape(at, mode=mode):
                a = at[4:].reshape(2, 2, 3)
                column = a[0, mode] + 1j * a[1, mode]
                return (column / column[np.abs(shapes[:, mode]).argmax()]).real

            d = np.array([(real_shape(theta + h) - real_shape(theta - h)) / 2e-6 for h in 1e-6 * np.eye(len(theta))])
            # amplitudes are weighted with the noise at their own mode, poles with that of both
            scale = np.concatenate([np.tile(factor, 2), np.tile(factor[mode], 12)])
            expected = np.sqrt(np.diag(d.T @ (dense * np.outer(scale, scale)) @ d))
            np.testing.assert_allclose(std[:, mode], expected, rtol=0.03, atol=1e-9)


def test_intervals_hold_the_truth_and_errors_are_those_predicted():
    z = []
    for seed in range(60):
        fit = decay_fit(outputs(record(seed=seed)), POLES * 1.003)
        std = np.sqrt(np.diag(fit.pole_covariance))
        z.append(np.concatenate([(fit.poles - POLES).real, (fit.poles - POLES).imag]) / std)
    assert 0.90 <= np.mean(np.abs(z) <= 1.96) <= 0.985
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.13)


def test_shape_intervals_hold_the_truth_with_several_records():
    merge = np.repeat(np.eye(3)[:, :, None], 2, axis=2).astype(complex)
    z = []
    for seed in range(40):
        data = outputs(record(0.05, seed, ((1.0, 0.7), (0.3j, -1.0))))
        shapes, std = decay_shapes(decay_fit(data, POLES), data.scale, merge)
        z.append(((shapes - SHAPES).real / np.where(std > 0, std, np.inf))[1:])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)


def test_coloured_noise_widens_the_intervals_of_the_modes_it_meets():
    clean = outputs(record(0.0))
    z, factor = [], []
    for seed in range(40):
        e = lfilter([1.0], [1.0, -1.8 * np.cos(0.2), 0.9**2], np.random.default_rng(seed).standard_normal((400, 3)), 0)
        noisy = TimeRecord(10.0, clean.series[0] * clean.scale + 0.01 * e, ("1Z", "2Z", "3Z"), ("displacement",) * 3)
        fit = decay_fit(outputs(noisy), POLES)
        std = np.sqrt(np.diag(fit.pole_covariance))
        z.append(np.concatenate([(fit.poles - POLES).real, (fit.poles - POLES).imag]) / std)
        factor.append(fit.noise[0] / fit.noise[0, 1])
    z_inverse = np.exp(-1j * POLES.imag / 10.0)
    level = 1 / np.abs(1 - 1.8 * np.cos(0.2) * z_inverse + 0.81 * z_inverse**2)
    assert np.mean(factor, axis=0)[0] == pytest.approx(
        level[0] / level[1], rel=0.25
    )  # smoothed over a segment; 1 if white
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.25)


def test_motion_without_noise_is_left_to_the_subspace():
    assert decay_fit(outputs(record(0.0)), POLES) is None


def test_pencil_of_a_noisy_decay_is_refined_to_several_times_less_error():
    omega = beam_omega(10)
    errors = {}
    for refine in (False, True):
        options = ModalOptions(orders=[24], block_rows=20, n_pieces=0, refine=refine)
        found = [modal_identification(beam_decay(0.01, 0.005, seed), "pencil", options).modes for seed in range(4)]
        errors[refine] = np.array([f.omega[nearest(f.omega, omega)] / omega - 1 for f in found])
    before, after = (np.sqrt(np.mean(errors[k] ** 2)) for k in (False, True))
    assert after < before / 3
    assert after < 2e-5


def test_two_modes_a_tenth_of_a_beat_apart():
    omega = 2 * np.pi * np.array([0.7, 1.3, 2.0, 2.002, 2.9, 3.7])
    shapes = np.linalg.qr(np.random.default_rng(7).standard_normal((6, 6)))[0]
    gaps = []
    for seed in range(10):
        given = decay(omega, shapes, 50.0, 0.05, noise=0.01, seed=seed, velocity=omega)
        found = modal_identification(given, "pencil", ModalOptions(orders=[12], block_rows=150, n_pieces=0)).modes
        pair = np.sort(np.abs(found.frequency - 2.001).argsort()[:2])
        gaps.append(np.diff(found.frequency[pair])[0] / 0.002)
    # the Cramer-Rao bound of the gap is 3.2 %
    assert np.sqrt(np.mean((np.array(gaps) - 1) ** 2)) < 0.05


@pytest.mark.parametrize("n_channels", [1, 3])
def test_stable_poles_of_the_noise_are_left_out_of_a_decay_and_named(n_channels):
    time = np.arange(3000)[:, None] / 100.0
    for seed in range(3):
        noise = 0.01 * np.random.default_rng(seed).standard_normal((3000, n_channels))
        values = np.exp(-0.1 * time) * np.cos(20.0 * time) + noise
        names = tuple(f"{i + 1}X" for i in range(n_channels))
        found = modal_identification(TimeRecord(100.0, values, names, ("velocity",) * n_channels))
        assert found.modes.n_modes == len(found.clusters) == 1
        std = np.sqrt(found.modes.covariance[0, 0])
        assert abs(found.modes.frequency[0] - np.hypot(20.0, 0.1) / (2 * np.pi)) < 4 * std


@pytest.mark.parametrize("duration", [3.0, 20.0])
def test_decays_of_high_damping_show_all_modes_whatever_noise_follows(duration):
    """Six seeds, 60 intervals: 91 to 96 % hold the truth over many. Before, a third of the modes was missing without a word."""
    z = []
    for seed in range(6):
        record, _ = damped_decay(seed, duration)
        found = modal_identification(record).modes
        assert found.n_modes == 5
        assert "maximum likelihood" in found.source
        assert any("lost in the noise" in words for words in found.warnings) == (duration > 3)
        error = np.concatenate([found.frequency - HEAVY_FREQUENCY, found.damping_ratio - HEAVY_DAMPING])
        z.append(error / found.std)
    assert np.mean(np.abs(z) <= 1.96) >= 0.85
    assert np.abs(z).max() < 4


def test_a_decay_that_is_more_than_its_modes_is_told():
    """Noise that is not white leaves what no mode explains."""
    record, _ = damped_decay(0, 20.0, noise=0.0)
    noise = lfilter([0.4], [1.0, -0.9], np.random.default_rng(0).standard_normal(record.values.shape), axis=0)
    values = record.values + 0.1 * record.values.std() * noise
    found = modal_identification(TimeRecord(50.0, values, record.channels, record.quantities)).modes
    assert any("holds more than these modes" in words and "`stop`" in words for words in found.warnings)
