"""Clusters of poles over orders, made by hand."""

import numpy as np
import pytest

from structid.modal.poles.poles import Poles
from structid.modal.poles.stabilization import _two_means_boundary, clusters, pole_distance


def sweep_of(seed=0, modes=(2.0, 2.01, 5.0), spread=1e-3, n_spurious=6, n_orders=15, same_shapes=False):
    """`modes` (rad/s) that scatter by `spread`, and as many poles anywhere, in every order."""
    rng = np.random.default_rng(seed)
    shapes = np.ones((4, len(modes))) if same_shapes else rng.standard_normal((4, len(modes)))
    sweep = []
    for k in range(n_orders):
        s = np.array(modes) * (1 + spread * rng.standard_normal(len(modes))) * (-0.01 + 1j)
        other = rng.uniform(0.5, 8.0, n_spurious) * (-rng.uniform(0.0, 0.2, n_spurious) + 1j)
        noisy = shapes + spread * rng.standard_normal(shapes.shape)
        sweep.append(
            Poles(np.append(s, other), np.concatenate([noisy, rng.standard_normal((4, n_spurious))], axis=1), 2 * k + 8)
        )
    return sweep


@pytest.mark.parametrize("spread", [1e-12, 1e-4, 1e-3, 1e-2])
def test_modes_are_told_from_scattered_poles(spread):
    found = clusters(sweep_of(spread=spread), np.ones(4))
    frequency = np.array([c.frequency.mean() for c in found]) * 2 * np.pi
    assert frequency == pytest.approx([2.0, 2.01, 5.0], rel=2 * spread + 1e-4)
    assert min(c.size for c in found) >= 13
    assert found[0].damping_ratio == pytest.approx(np.full(found[0].size, 0.01), rel=1e-3)
    assert found[2].frequency_spread == pytest.approx(spread * 5 / (2 * np.pi), rel=0.6, abs=1e-12)


def test_poles_of_one_order_are_never_one_mode():
    """Two modes 0.5 % apart with one shape at the sensors."""
    found = clusters(sweep_of(modes=(2.0, 2.01, 5.0), spread=1e-6, same_shapes=True), np.ones(4))
    assert [len(set(c.number.tolist())) == c.size for c in found] == [True] * 3


def test_small_clusters_are_kept_on_demand():
    assert len(clusters(sweep_of(), np.ones(4), keep_all=True)) >= len(clusters(sweep_of(), np.ones(4))) == 3


def test_distance_adds_poles_and_shapes():
    one, other = np.array([1j, 2j]), np.array([1.1j])
    shapes = np.array([[1.0, 0.0], [0.0, 1.0]])
    found = pole_distance(one, shapes, other, shapes[:, :1] * 3j)
    assert found[:, 0] == pytest.approx([0.1 / 1.1, 0.45 + 1.0])


def test_two_means_halve_what_is_apart():
    assert _two_means_boundary(np.array([5.0, 0.0, 0.2, 5.2])) == pytest.approx(2.6)
    assert _two_means_boundary(np.array([3.0, 3.0])) == 3.0
    assert _two_means_boundary(np.zeros(0)) == -np.inf


def test_a_mode_whose_poles_move_once_over_the_orders_is_one_cluster():
    """From the tenth order on its pole lies 4 % higher, forty times its scatter; its neighbour of another shape stays apart."""
    rng = np.random.default_rng(1)
    shapes, sweep = np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 1.0], [1.0, -1.0]]), []
    for k in range(20):
        both = np.array([2.0 if k < 10 else 2.08, 2.01]) * (1 + 1e-3 * rng.standard_normal(2)) * (-0.01 + 1j)
        other = rng.uniform(0.5, 8.0, 4) * (-rng.uniform(0.0, 0.2, 4) + 1j)
        sweep.append(
            Poles(np.append(both, other), np.concatenate([shapes, rng.standard_normal((4, 4))], axis=1), 2 * k + 8)
        )
    assert sorted(c.size for c in clusters(sweep, np.ones(4))) == [18, 19]  # the first pole after the step is near none
