"""Poles, hard criteria, orders by one decomposition, and the limits of the pencil."""

import numpy as np
import pytest
from modal_cases import ambient_chain, beam_decay, decay

from structid import InputError
from structid.modal import HardCriteria, Poles, stationary_values
from structid.modal.correlations import outputs, pieces, window_hankels
from structid.modal.poles.poles import state_poles
from structid.modal.subspace.kernel import poles_of_orders
from structid.modal.subspace.methods import pencil, ssi_cov, ssi_data


def test_state_pair_gives_the_poles_it_was_made_of():
    """Two modes of 2 and 5 rad/s, 3 % and 1 %, and a real pole, in random coordinates."""
    rng = np.random.default_rng(0)
    s = np.array([-0.06 + 2j * np.sqrt(1 - 9e-4), -0.05 + 5j * np.sqrt(1 - 1e-4)])
    shapes = rng.standard_normal((3, 2)) + 1j * rng.standard_normal((3, 2))
    basis = rng.standard_normal((5, 5))
    z = np.exp(s / 10)
    blocks = np.zeros((5, 5))
    output = np.zeros((3, 5))
    for k in range(2):
        blocks[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[z[k].real, z[k].imag], [-z[k].imag, z[k].real]]
        output[:, 2 * k], output[:, 2 * k + 1] = shapes[:, k].real, shapes[:, k].imag
    blocks[4, 4] = 0.5
    found = state_poles(basis @ blocks @ np.linalg.inv(basis), output @ np.linalg.inv(basis), 10.0)
    assert found.omega == pytest.approx([2.0, 5.0], rel=1e-12)
    assert found.damping_ratio == pytest.approx([0.03, 0.01], rel=1e-10)
    assert found.frequency == pytest.approx(np.array([2.0, 5.0]) / (2 * np.pi))
    ratio = found.shapes / shapes
    assert np.abs(ratio / ratio[0] - 1).max() <= 1e-10
    assert found.order == 5


def test_mpc_is_one_for_a_real_shape_in_any_phase():
    x = np.array([1.0, -2.0, 0.5])
    shapes = np.stack([x * np.exp(0.7j), np.array([1.0, 1j, 0.0])], axis=1)
    assert Poles(np.array([1j, 2j]), shapes, 4).mpc == pytest.approx([1.0, 0.0], abs=1e-12)


def test_hard_criteria_keep_what_meets_them_all():
    s = 2 * np.pi * np.array([1.0, 2.0, 3.0, 4.0]) * (np.array([0.02, -0.05, 0.3, 0.01]) * -1 + 1j)
    poles = Poles(s, np.ones((2, 4)), 8)
    assert HardCriteria().indices(poles).tolist() == [0, 3]
    assert HardCriteria(frequency=(0.5, 3.5)).indices(poles).tolist() == [0]
    assert HardCriteria(damping_ratio=(-0.1, 0.5)).indices(poles).tolist() == [0, 1, 2, 3]
    assert "damping_ratio=(-0.01, 0.2)" in repr(HardCriteria())
    with pytest.raises(InputError, match="one column a pole"):
        Poles(s, np.ones((2, 3)), 8)


def test_fast_orders_equal_the_pseudo_inverse_of_each():
    subspace = pencil(outputs(ambient_chain(0, 100.0)), 8, 20)
    for order in (3, 8, 20):
        u = subspace.left[:, :order]
        dense = np.linalg.pinv(u[:-4]) @ u[4:]
        np.testing.assert_allclose(subspace.transition(order), dense, rtol=0, atol=1e-10)
    with pytest.raises(InputError, match="`orders` must lie from 1 to 20, got 21"):
        poles_of_orders(subspace, [21])


def test_scale_of_channels_does_not_change_poles_and_returns_in_shapes():
    record = decay(np.array([2.0, 5.0]), np.array([[1.0, 1.0], [1e6, -1e6]]), 20.0, 0.05, velocity=np.ones(2))
    found = poles_of_orders(pencil(outputs(record), 6, 4), [4])[0]
    assert found.omega == pytest.approx([2.0, 5.0], rel=1e-10)
    assert np.abs(found.shapes[1] / found.shapes[0]) == pytest.approx([1e6, 1e6], rel=1e-8)


def second_difference_omega(record, offset=0):
    """y(t+1) + y(t-1) = 2 cos(omega h) y(t) in the covariances of the pencil's window, without delays, rad/s."""
    data = outputs(record)
    windows = pieces(data, max(0, 1 - offset), offset + 1)
    matrix = sum(window_hankels(data, windows, 3, 1, offset - 1))
    m = data.n_channels
    left = np.linalg.svd(matrix, full_matrices=False)[0]
    shift = np.linalg.lstsq(left[m : 2 * m], left[:m] + left[2 * m :], rcond=None)[0]
    return np.sort(np.arccos(np.linalg.eigvals(shift).real / 2)) * data.sampling_rate


@pytest.mark.parametrize("kinds", [(0,), (2,)])
def test_smallest_pencil_is_the_quotient_of_second_differences(kinds):
    """i = j = 1, no offset: eigenvalues (4/h^2) sin^2(w h/2) of -<d2u u'><uu'>^-1 / h^2, in noise as without."""
    for noise in (0.0, 1e-3):
        record = decay(np.array([2.0, 3.1, 4.5]), np.random.default_rng(3).standard_normal((3, 3)), 12.0, 0.1,
                       kinds=kinds, noise=noise, velocity=np.ones(3))  # fmt: skip
        quotient = stationary_values(record, ("displacement", "", "acceleration")[kinds[0]], "second_difference")
        omega = second_difference_omega(record)
        np.testing.assert_allclose((2 / 0.1 * np.sin(omega * 0.05)) ** 2, quotient.eigenvalues, rtol=1e-9)


def test_second_differences_at_later_lags_keep_noise_out():
    """1 % white noise, 3 modes: lag 2 in the middle against lag 0, ten times nearer."""
    omega = np.array([2.0, 3.1, 4.5])
    record = decay(omega, np.random.default_rng(3).standard_normal((3, 3)), 200.0, 0.1, noise=0.01, velocity=np.ones(3))
    early, late = (np.abs(second_difference_omega(record, k) / omega - 1).max() for k in (0, 2))
    assert late <= 0.1 * early


def test_data_correlations_are_the_pencil_in_another_order():
    """The Hankel matrices of Juang, Cooper and Wright written out: H(i) H(0)'."""
    record, i = beam_decay(0.01, 0.005, kinds=(1,)), 12
    y = outputs(record).series[0]
    n = len(y) - 2 * i + 1
    first, later = (np.concatenate([y[k + r : k + r + n].T for r in range(i)]) for k in (0, i))
    left = np.linalg.svd(later @ first.T)[0][:, :20]
    transition = np.linalg.pinv(left[:-10]) @ left[10:]
    expected = state_poles(transition, left[:10], 20.0).omega
    assert poles_of_orders(pencil(outputs(record), i, 20), [20])[0].omega == pytest.approx(expected, rel=1e-8)


def test_data_driven_projection_is_the_future_on_the_past():
    """P = Yf Yp' (Yp Yp')^-1 Yp written out: its column space gives the same poles."""
    record, i = ambient_chain(0, 60.0), 5
    y = outputs(record).series[0]
    n = len(y) - 2 * i + 1
    past, future = (np.concatenate([y[k + r : k + r + n].T for r in range(i)]) for k in (0, i))
    left = np.linalg.svd(future @ np.linalg.pinv(past) @ past, full_matrices=False)[0][:, :8]
    expected = state_poles(np.linalg.pinv(left[:-4]) @ left[4:], left[:4], 10.0).omega
    subspace = ssi_data(outputs(record), i, 8, n_pieces=4)
    assert poles_of_orders(subspace, [8])[0].omega == pytest.approx(expected, rel=1e-8)
    whole = sum(subspace.parts(subspace.data, subspace.windows))
    rebuilt = (subspace.left * subspace.singular) @ subspace.right.T
    np.testing.assert_allclose(np.abs(whole), np.abs(rebuilt), rtol=0, atol=1e-9 * subspace.singular[0])


def test_changing_windows_bias_a_decay_and_one_window_does_not():
    record = beam_decay(damping_ratio=0.005)
    biased, exact = (poles_of_orders(f(outputs(record), 20, 20), [20])[0] for f in (ssi_cov, pencil))
    assert np.median(np.abs(exact.damping_ratio - 0.005)) <= 1e-10
    assert np.median(np.abs(biased.damping_ratio - 0.005)) >= 1e-3
