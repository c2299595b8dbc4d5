"""Covariance of poles and shapes: its derivatives against differences, its size against repeated simulation."""

import numpy as np
import pytest
from modal_cases import ambient_chain, beam_decay, chain_modes, decay, nearest
from scipy import special
from scipy.signal import lfilter

from structid.modal import identify_modes
from structid.modal.correlations import displacement_rows, outputs
from structid.modal.modal_record import ModalChanges
from structid.modal.subspace.era import era
from structid.modal.subspace.itd import itd
from structid.modal.subspace.kernel import poles_of_orders, shift_invariant
from structid.modal.subspace.modes import frequency_damping_changes, frequency_damping_covariance
from structid.modal.subspace.pencil import pencil
from structid.modal.subspace.pole_uncertainty import (
    delayed_product,
    free_decay_fit,
    overlapping_batches,
    piece_deviations,
    pole_deviations,
    sample_deviations,
)
from structid.modal.subspace.ssi import ssi_cov, ssi_data
from structid.reproduce.chapter_5.simple_beam import beam_omega


@pytest.mark.parametrize("method", [pencil, ssi_cov, ssi_data])
@pytest.mark.parametrize("order", [8, 13])
def test_first_order_change_agrees_with_differences(method, order):
    """Central differences of step 1e-5 of the matrix itself: 1e-6 of the largest change."""
    subspace = method(ambient_chain(1, 200.0), 6, 20, n_pieces=5)
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
    expected = change.T @ change
    changes = ModalChanges(*frequency_damping_changes(s, ds), np.zeros((7, 1, 2)))
    assert np.abs(frequency_damping_covariance(changes, []) - expected).max() <= 1e-6 * np.abs(expected).max()


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


def textbook_poles(method, y, rows, order, rate):
    """ERA and ITD of one record with dense Hankel matrices, as Juang and Pappa (1985) and Ibrahim (1977) have them."""
    delayed = np.stack([y[t : t + rows + 1].ravel() for t in range(len(y) - rows)], axis=1)
    m = y.shape[1]
    if method == "era":
        delayed = np.stack([y[t : t + rows].ravel() for t in range(len(y) - rows + 1)], axis=1)
        u = np.linalg.svd(delayed, full_matrices=False)[0][:, :order]
        a, c = np.linalg.lstsq(u[:-m], u[m:], rcond=None)[0], u[:m]
    else:
        before, after = delayed[:-m], delayed[m:]
        u, s = (part[..., :order] for part in np.linalg.svd(before, full_matrices=False)[:2])
        a, c = u.T @ after @ before.T @ u / s**2, u[:m]
    values, vectors = np.linalg.eig(a)
    kept = np.flatnonzero(values.imag > 0)
    kept = kept[np.argsort(np.abs(np.log(values[kept])), kind="stable")]
    return np.log(values[kept]) * rate, c @ vectors[:, kept]


@pytest.mark.parametrize(("method", "named"), [(era, "era"), (itd, "itd")])
@pytest.mark.parametrize("order", [8, 13])
def test_first_order_change_of_samples_agrees_with_differences(method, named, order):
    """A short chain in noise: central differences of the dense textbook form, 1e-6 of the largest change."""
    omega, shapes = chain_modes()
    record = decay(omega, shapes, 20.0, 0.1, noise=0.05, velocity=np.ones(4), damping_ratio=0.01)
    subspace = method(record, 6, 20, n_pieces=4)
    data = subspace.data
    noise = [np.random.default_rng(8).standard_normal(data.series[0].shape)]
    spread = sample_deviations(subspace, 20, noise, 3)
    poles = poles_of_orders(subspace, [order])[0]
    ds, dshape = pole_deviations(subspace, spread, order, range(len(poles.poles)))
    for k in range(3):
        change = np.roll(noise[0], round((k + 0.5) * len(noise[0]) / 3), axis=0) / np.sqrt(3)
        (ahead, over), (behind, under) = (
            textbook_poles(named, data.series[0] + h * change, 6, order, 10.0) for h in (1e-6, -1e-6)
        )
        difference = (ahead - behind) / 2e-6
        assert np.abs(0.5 * (ahead + behind) - poles.poles).max() <= 1e-7 * np.abs(poles.poles).max()
        assert np.abs(difference - ds[k]).max() <= 1e-6 * np.abs(difference).max()
        scale = data.scale[:, None] / data.scale[0]
        difference = scale * (over / over[0] - under / under[0]) / 2e-6
        expected = (dshape[k] - poles.shapes / poles.shapes[0] * dshape[k][0]) / poles.shapes[0]
        assert np.abs(difference - expected).max() <= 1e-6 * np.abs(difference).max()


def test_delayed_product_is_that_of_delayed_samples():
    rng = np.random.default_rng(0)
    y, e = rng.standard_normal((2, 40, 3))
    rows = 5
    stacked = [np.stack([x[t : t + rows].ravel() for t in range(len(x) - rows + 1)]) for x in (y, e)]
    np.testing.assert_allclose(delayed_product(y, e, rows), stacked[0].T @ stacked[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["era", "itd"])
def test_samples_in_noise_give_their_standard_deviations(method):
    """Eight seeds, four modes in 1 % noise at the true order: errors over standard deviations are near 1.

    At greater orders a pole of noise may come near a mode, whose standard deviation is then wider.
    """
    omega, shapes = chain_modes()
    scores = []
    for seed in range(8):
        record = decay(omega, shapes, 60.0, 0.1, noise=0.01, seed=seed, velocity=np.ones(4), damping_ratio=0.01)
        found = identify_modes(record, method, orders=[8], block_rows=12)
        near, std = nearest(found.omega, omega), np.sqrt(np.diag(found.covariance))
        scores.append((found.frequency[near] - omega / (2 * np.pi)) / std[: found.n_modes][near])
        scores.append((found.damping_ratio[near] - 0.01) / std[found.n_modes :][near])
    assert 0.75 <= np.sqrt(np.mean(np.square(scores))) <= 1.25
    assert np.mean(np.abs(scores) <= 1.96) >= 0.9


def test_no_pieces_give_no_covariance():
    for given in ({"n_pieces": 0}, {"method": "era", "n_pieces": 0}, {"method": "itd", "n_pieces": 1}):
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
    fitted, rest = free_decay_fit(data, poles)
    assert rest[0].std(axis=0) == pytest.approx(np.full(20, 0.01), rel=0.1)
    n = len(fitted[0])
    np.testing.assert_allclose(fitted[0] + rest[0] / np.sqrt(n / (n - 20)), data.series[0], atol=1e-12)
    omega = chain_modes()[0]
    _, rest = free_decay_fit(outputs(ambient_chain(0)), omega * (-0.01 + 1j))
    assert np.mean(rest[0] ** 2) >= 0.8


def test_intervals_cover_what_they_say():
    """40 simulated records of 4 modes: 320 intervals of 95 %; less than 90 % or more than 98 % is unlikely."""
    omega, shapes = chain_modes()
    inside, inside_shapes = [], []
    for seed in range(40):
        found = identify_modes(ambient_chain(seed), "ssi_cov", [8], 20, n_pieces=20)
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
