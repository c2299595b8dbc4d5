"""An exponential window moves every pole by its decay: taken off again, with the covariance that belongs to it."""

from dataclasses import replace

import numpy as np
import pytest
from modal_cases import decay

from structid import InputError
from structid.modal import ModalRecord, identify_modes, without_window_damping

OMEGA = 2 * np.pi * np.array([1.1, 2.3, 3.7])
SHAPES = np.array([[1.0, 1, 1], [0.6, -1, 0.2], [0.3, 0.4, -1]])


def record():
    """Covariance of a positive definite kind, correlated between modes and between frequency and damping."""
    root = np.random.default_rng(1).standard_normal((6, 6)) * np.repeat([[1e-3], [4e-3]], 3, axis=0)
    return ModalRecord(
        OMEGA / (2 * np.pi), [0.01, 0.02, 0.015], SHAPES, ("1Z", "2Z", "3Z"), root @ root.T, np.full((3, 3), 0.1)
    )


def test_window_of_a_decay_is_taken_off():
    """Exact: 0.5 % and 1.3 % damping under a window of 0.3 1/s, to round-off."""
    clean = decay(OMEGA, SHAPES, 20.0, 0.05, velocity=np.ones(3), damping_ratio=np.array([0.005, 0.013, 0.005]))
    windowed = replace(clean, values=clean.values * np.exp(-0.3 * clean.time)[:, None])
    modes = identify_modes(windowed, orders=[6], n_pieces=0)
    assert (modes.damping_ratio > 0.015).all()
    found = without_window_damping(modes, 0.3)
    assert np.abs(found.omega / OMEGA - 1).max() < 1e-9
    assert found.damping_ratio == pytest.approx([0.005, 0.013, 0.005], rel=1e-7)
    assert "window decay of 0.3 1/s taken off" in found.source


def test_covariance_is_carried_by_the_exact_slope():
    """Against central differences of the map itself, 1e-7 relative."""
    modes, step = record(), 1e-6
    values = np.concatenate([modes.frequency, modes.damping_ratio])
    slope = np.empty((6, 6))
    for k in range(6):
        ends = []
        for sign in (1, -1):
            moved = values + sign * step * (np.arange(6) == k)
            found = without_window_damping(replace(modes, frequency=moved[:3], damping_ratio=moved[3:]), 0.08)
            ends.append(np.concatenate([found.frequency, found.damping_ratio]))
        slope[:, k] = (ends[0] - ends[1]) / (2 * step)
    expected = slope @ modes.covariance @ slope.T
    found = without_window_damping(modes, 0.08).covariance
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 1e-6


def test_window_there_and_back():
    """No window leaves all as it was; two windows one after another are one of both decays."""
    modes = record()
    same = without_window_damping(modes, 0.0)
    assert np.allclose(same.frequency, modes.frequency, rtol=1e-15)
    assert np.allclose(same.covariance, modes.covariance, rtol=1e-12)
    twice, once = without_window_damping(without_window_damping(modes, 0.03), 0.05), without_window_damping(modes, 0.08)
    assert np.allclose(twice.frequency, once.frequency, rtol=1e-14)
    assert np.allclose(twice.damping_ratio, once.damping_ratio, rtol=1e-12)
    assert np.allclose(twice.covariance, once.covariance, rtol=1e-10)


def test_order_follows_the_new_frequencies():
    """A heavily damped mode falls below its neighbour; shapes, deviations and covariance go with it."""
    variance = np.diag([1.0, 2, 3, 4]) * 1e-8
    modes = ModalRecord([1.0, 1.001], [0.0, 0.15], [[1, 0], [0, 1.0]], ("1Z", "2Z"), variance, [[0.1, 0.2], [0.3, 0.4]])
    found = without_window_damping(modes, 0.15 * 2 * np.pi)
    assert found.mode_shapes.tolist() == [[0, 1.0], [1, 0]]
    assert found.shape_std.tolist() == [[0.2, 0.1], [0.4, 0.3]]
    alone = without_window_damping(
        ModalRecord([1.001], [0.15], [[1.0]], ("2Z",), variance[1::2, 1::2]), 0.15 * 2 * np.pi
    )
    assert np.allclose(found.covariance[::2, ::2], alone.covariance, rtol=1e-12)


def test_unknown_damping_and_rigid_modes_stay():
    modes = ModalRecord([0.0, 1.0, 2.0], [0.0, np.nan, 0.02], np.eye(3), ("1Z", "2Z", "3Z"))
    found = without_window_damping(modes, 0.05)
    assert found.frequency[:2].tolist() == [0.0, 1.0]
    assert found.damping_ratio[0] == 0
    assert np.isnan(found.damping_ratio[1])
    assert found.damping_ratio[2] < 0.02


def test_unknown_covariance_stays_unknown():
    modes = record()
    covariance = np.array(modes.covariance)
    covariance[1, :] = covariance[:, 1] = np.nan
    found = without_window_damping(replace(modes, covariance=covariance), 0.05).covariance
    lost = np.zeros(6, dtype=bool)
    lost[[1, 4]] = True
    assert np.isnan(found[lost]).all()
    assert np.isfinite(found[np.ix_(~lost, ~lost)]).all()


def test_doubtful_damping_is_said():
    modes = replace(record(), covariance=None)
    assert without_window_damping(modes, 0.05).warnings == ()
    assert "mode 1 is left with negative damping" in without_window_damping(modes, 0.1).warnings[0]
    assert any("uncertain by more than half" in text for text in without_window_damping(record(), 0.05).warnings)
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(InputError, match="`decay` must be a finite rate"):
            without_window_damping(modes, wrong)
