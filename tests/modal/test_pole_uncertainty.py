"""Covariance of poles and shapes: its derivatives against differences, its size against repeated simulation."""

import numpy as np
import pytest
from modal_cases import ambient_chain, beam_decay, chain_modes, nearest
from scipy import special
from scipy.signal import lfilter

from structid.modal import identify_modes
from structid.modal.correlations import displacement_rows, outputs
from structid.modal.poles.poles import frequency_damping_slope
from structid.modal.subspace.kernel import poles_of_orders, shift_invariant
from structid.modal.subspace.methods import pencil, ssi_cov, ssi_data
from structid.modal.subspace.pole_uncertainty import (
    _decay_fraction,
    free_decay,
    frequency_widening,
    overlapping_batches,
    piece_deviations,
    pole_deviations,
)
from structid.records import TimeRecord
from structid.reproduce.chapter_5 import beam_omega


@pytest.mark.parametrize("method", [pencil, ssi_cov, ssi_data])
@pytest.mark.parametrize("order", [8, 13])
def test_first_order_change_agrees_with_differences(method, order):
    """Central differences of step 1e-5 of the matrix itself: 1e-6 of the largest change."""
    subspace = method(outputs(ambient_chain(1, 200.0)), 6, 20, n_pieces=5)
    poles = poles_of_orders(subspace, [order])[0]
    chosen = range(len(poles.poles))
    ds, dshape = pole_deviations(subspace, piece_deviations(subspace, order), order, chosen)
    parts = list(subspace.parts(subspace.data, subspace.windows))
    matrix = np.sum(parts, axis=0)
    for b, (window, part) in enumerate(zip(subspace.windows, parts, strict=True)):
        change = np.sqrt(5 / 4) * (part - window.part * matrix)
        ahead, behind = (
            poles_of_orders(shift_invariant(matrix + h * change, subspace.data, "", 20), [order])[0]
            for h in (1e-5, -1e-5)
        )
        difference = (ahead.poles - behind.poles) / 2e-5
        assert np.abs(difference - ds[b]).max() <= 1e-6 * np.abs(difference).max()
        unit = [p.shapes / p.shapes[0] for p in (ahead, behind)]
        difference = (unit[0] - unit[1]) / 2e-5
        ratio = poles.shapes / poles.shapes[0]
        expected = (dshape[b] - ratio * dshape[b][0]) / poles.shapes[0]
        assert np.abs(difference - expected).max() <= 1e-6 * np.abs(difference).max()


def test_covariance_has_every_part_and_no_more_than_the_pieces_tell():
    many = identify_modes(ambient_chain(2), orders=[8], block_rows=20, n_pieces=20)
    assert many.covariance.shape == (8, 8)
    assert np.linalg.eigvalsh(many.covariance).min() > 0
    assert many.shape_std.shape == (4, 4)
    assert (many.shape_std[np.abs(many.mode_shapes - 1) < 1e-12] < 1e-12).all()
    few = identify_modes(ambient_chain(2), orders=[8], block_rows=20, n_pieces=6)
    assert few.covariance[0, 1] == 0
    assert few.covariance[0, 4] != 0
    assert any("6 pieces cannot tell how 8 numbers vary together" in note for note in few.warnings)


def test_covariance_of_frequency_and_damping_follows_that_of_poles():
    """Differences of step 1e-7 of f = |s| / 2 pi and zeta = -Re s / |s|, at heavy damping: 1e-6 relative."""
    rng = np.random.default_rng(0)
    s = np.array([2.0, 5.0]) * (-np.array([0.3, 0.5]) + 1j)
    ds = rng.standard_normal((7, 2)) + 1j * rng.standard_normal((7, 2))

    def numbers(s):
        return np.concatenate([np.abs(s) / (2 * np.pi), -s.real / np.abs(s)], axis=-1)

    change = (numbers(s + 1e-7 * ds) - numbers(s - 1e-7 * ds)) / 2e-7
    found = np.concatenate([ds.real, ds.imag], axis=1) @ frequency_damping_slope(s).T
    assert np.abs(found - change).max() <= 1e-6 * np.abs(change).max()


def test_quantities_at_one_place_merge_by_least_squares():
    """Displacement, velocity and acceleration that do not quite fit, weighed by the rms of their channels."""
    record = beam_decay(0.3, kinds=(0, 1, 2))
    data, s = outputs(record), np.array([-0.4 + 2.0j])
    dofs, merge = displacement_rows(data, s)
    y = np.random.default_rng(0).standard_normal(30) * (1 + 0.5j)
    for d in (0, 7):
        rows = [d, d + 10, d + 20]
        basis = np.array([1.0, s[0], s[0] ** 2]) / data.scale[rows]
        expected = np.linalg.lstsq(basis[:, None], y[rows] / data.scale[rows], rcond=None)[0][0]
        assert (merge[:, :, 0] @ y)[d] == pytest.approx(expected, rel=1e-10)
    assert len(dofs) == 10


def test_no_pieces_give_no_covariance():
    for given in ({"n_pieces": 0}, {"method": "ssi_cov", "n_pieces": 1}):
        found = identify_modes(beam_decay(0.01, 0.005), **{"orders": [24], "block_rows": 20, **given})
        assert found.covariance is None
        assert found.shape_std is None


def test_std_without_noise_is_rounding():
    found = identify_modes(beam_decay(damping_ratio=0.005), orders=[24], block_rows=20)
    assert np.sqrt(np.diag(found.covariance)).max() <= 1e-9


def test_noise_of_a_free_decay_gives_its_standard_deviations():
    """Six seeds, ten modes: errors over standard deviations have a root mean square near 1."""
    scores = []
    for seed in range(6):
        found = identify_modes(beam_decay(0.02, 0.005, seed), orders=[24], block_rows=12)
        near, std = nearest(found.omega, beam_omega(10)), np.sqrt(np.diag(found.covariance))
        n = found.n_modes
        scores.append((found.omega[near] - beam_omega(10)) / (2 * np.pi) / std[:n][near])
        scores.append((found.damping_ratio[near] - 0.005) / std[n:][near])
        assert not any("pieces" in note for note in found.warnings)
    assert 0.7 <= np.sqrt(np.mean(np.square(scores))) <= 1.25
    assert 0.90 <= np.mean(np.abs(scores) <= 1.96) <= 0.99


def test_free_decay_and_rest_add_up_to_the_record():
    """What is left of a decay in 1 % noise is that noise; ambient motion is no decay."""
    record = beam_decay(0.01, 0.005)
    poles = beam_omega(10) * (-0.005 + 1j * np.sqrt(1 - 0.005**2))
    data = outputs(record)
    motion = free_decay(data, poles)
    fitted, rest = motion.decay, motion.rest
    assert motion.explains_most
    assert motion.explains_all
    assert rest[0].std(axis=0) == pytest.approx(np.full(20, 0.01), rel=0.1)
    n = len(fitted[0])
    np.testing.assert_allclose(fitted[0] + rest[0] / np.sqrt(n / (n - 20)), data.series[0], atol=1e-12)
    omega = chain_modes()[0]
    motion = free_decay(outputs(ambient_chain(0)), omega * (-0.01 + 1j))
    assert not motion.explains_most
    assert not motion.explains_all


@pytest.mark.parametrize("growth", [-0.05, 0.02])
def test_the_share_of_a_decay_at_a_glance_is_that_of_the_fit(growth):
    """By normal equations over chunks, growing poles counted back from the end, against least squares on all samples."""
    poles, t = np.array([growth + 2.0j, -0.3 + 5.0j]), np.arange(3000) * 0.05
    rng = np.random.default_rng(3)
    weight = rng.standard_normal((2, 3)) * np.exp(-np.maximum(poles.real, 0.0) * t[-1])[:, None]
    values = (np.exp(poles * t[:, None]) @ weight).real
    values = values / values.std(axis=0) + 0.5 * rng.standard_normal(values.shape)
    data = outputs(TimeRecord(20.0, values, ("1X", "2X", "3X"), ("displacement",) * 3))
    basis = np.exp(poles * (t[:, None] - np.where(poles.real > 0, t[-1], 0.0)))
    basis = np.concatenate([basis.real, basis.imag], axis=1)
    sums = data.series[0] @ np.random.default_rng(0).choice([-1.0, 1.0], (3, 4))
    fitted = basis @ np.linalg.lstsq(basis, sums, rcond=None)[0]
    assert _decay_fraction(data, poles) == pytest.approx(np.sum(fitted**2) / np.sum(sums**2), rel=1e-9)


def test_intervals_cover_what_they_say():
    """40 simulated records of 4 modes: 320 intervals of 95 %; less than 90 % or more than 98 % is unlikely."""
    omega, shapes = chain_modes()
    inside, inside_shapes = [], []
    for seed in range(40):
        found = identify_modes(ambient_chain(seed), "ssi_cov", orders=[8], block_rows=20, n_pieces=20)
        near, std = nearest(found.omega, omega), np.sqrt(np.diag(found.covariance))
        error = np.concatenate([found.omega[near] - omega, 2 * np.pi * (found.damping_ratio[near] - 0.01)]) / (
            2 * np.pi
        )
        inside.append(np.abs(error) <= 1.96 * np.concatenate([std[:4][near], std[4:][near]]))
        largest = np.abs(found.mode_shapes).argmax(axis=0)
        truth = shapes[:, range(4)] / shapes[largest[near], range(4)]
        free = found.shape_std[:, near] > 1e-12
        inside_shapes.append(
            np.abs(found.mode_shapes[:, near].real - truth)[free] <= 1.96 * found.shape_std[:, near][free]
        )
    assert 0.90 <= np.mean(inside) <= 0.98
    assert 0.90 <= np.mean(np.concatenate(inside_shapes)) <= 0.98


@pytest.mark.parametrize("memory", [0.0, 2.0, 10.0])
def test_batches_of_independent_changes_keep_their_variance(memory):
    draws = np.random.default_rng(0).standard_normal((48, 2000))
    changes = (draws - draws.mean(axis=0)) * np.sqrt(48 / 47) + 0j
    size = min(max(1, int(np.ceil(2 * memory))), 6)
    student = special.stdtrit(1.5 * 48 / size, 0.975) / special.ndtri(0.975) if size > 1 else 1.0
    found, shapes = overlapping_batches(changes, changes[:, None, :], 1.0, memory)
    assert found.shape == (48 - size + 1, 2000)
    np.testing.assert_array_equal(shapes[:, 0], found)
    # of a sum of 48 draws of variance 1
    assert np.sum(np.abs(found) ** 2, axis=0).mean() / student**2 == pytest.approx(48.0, rel=0.03)


def test_batches_count_how_neighbouring_pieces_vary_together():
    rng = np.random.default_rng(1)
    e = rng.standard_normal((48, 4000))
    changes = lfilter([1.0], [1.0, -0.5], e, axis=0)
    truth = np.var(changes.sum(axis=0))
    centred = (changes - changes.mean(axis=0)) * np.sqrt(48 / 47)
    plain = np.mean(np.sum(centred**2, axis=0))
    batched = overlapping_batches(centred + 0j, centred[:, None, :] + 0j, 1.0, 3.0)[0]
    student = special.stdtrit(1.5 * 48 / 6, 0.975) / special.ndtri(0.975)
    assert plain < 0.5 * truth
    assert np.mean(np.sum(np.abs(batched) ** 2, axis=0)) / student**2 == pytest.approx(truth, rel=0.25)


def test_a_frequency_has_no_more_degrees_of_freedom_than_its_damping_leaves_it():
    """40 pieces of 1 s in batches of 5: 12 degrees of freedom; decays of 0.1, 1 and 0.01 per s: 8, 80 and at least 4."""
    poles = np.array([-0.1, -1.0, -0.01]) + 5j
    table = {4: 2.776, 8: 2.306, 12: 2.179}  # 97.5 % points of Student's t, as printed in any book
    expected = [table[8] / table[12], 1.0, table[4] / table[12]]
    np.testing.assert_allclose(frequency_widening(poles, 40.0, 40, 10.0), expected, rtol=5e-4)
