"""Fast paths of the subspace kernel give the poles of the plain ones."""

import numpy as np
import pytest
from modal_cases import ambient_chain
from scipy.signal import lfilter

from structid import TimeRecord
from structid.modal import ModalOptions, modal_identification
from structid.modal.subspace import kernel as subspace
from structid.modal.subspace import methods

RECORD = ambient_chain(3)
OPTIONS = ModalOptions(orders=[8, 12], block_rows=20, n_pieces=0)


def poles(method, options=OPTIONS):
    return [p.poles for p in modal_identification(RECORD, method, options).sweep]


def test_data_driven_projection_by_cholesky_is_that_by_qr(monkeypatch):
    fast = poles("ssi_data")
    monkeypatch.setattr(methods, "_REGULAR", 1.0)
    calls = []
    plain = methods.delayed_triangle
    monkeypatch.setattr(methods, "delayed_triangle", lambda *given: calls.append(1) or plain(*given))
    slow = poles("ssi_data")
    assert calls == [1]
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)


@pytest.mark.parametrize("method", ["pencil", "ssi_cov", "ssi_data"])
def test_leading_singular_vectors_are_those_of_the_complete_decomposition(method, monkeypatch):
    complete = poles(method)
    monkeypatch.setattr(subspace, "_LARGE", 10)
    found = subspace._singular_vectors(np.diag(np.arange(80.0)), 5, complete=False)
    assert len(found[1]) == 5
    np.testing.assert_allclose(found[1], [79.0, 78.0, 77.0, 76.0, 75.0], rtol=1e-12)
    for a, b in zip(poles(method), complete, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)


def ambient_record(frequency, damping_ratio, n_points, n_times, noise):
    """Velocities at 50 Hz of modes of random shapes under white noise; noise of the sensors is a part of each channel."""
    rng = np.random.default_rng(5)
    shapes = rng.standard_normal((len(frequency), n_points))
    steps = np.exp(2 * np.pi * frequency / 50.0 * (-damping_ratio + 1j))
    forces = (rng.standard_normal(n_times + 1000) for _ in steps)
    motion = np.array([lfilter([1.0], [1.0, -z], f)[1000:].real for z, f in zip(steps, forces, strict=True)]).T @ shapes
    motion += noise * motion.std(axis=0) * rng.standard_normal(motion.shape)
    return TimeRecord(50.0, motion, [f"{i + 1}Z" for i in range(n_points)], ("velocity",) * n_points)


def test_a_record_of_many_modes_is_given_more_states():
    """Twenty modes at eight points: 60 states leave too few beside noise, which merges modes and bends their damping."""
    frequency = np.linspace(2.0, 21.0, 20)
    record = ambient_record(frequency, 0.004, 8, 8000, 0.05)
    result = modal_identification(record, "ssi_cov", ModalOptions(n_pieces=0))
    assert result.orders == tuple(range(2, 121, 2))
    assert np.abs(result.modes.frequency[:, None] / frequency - 1).min(axis=0).max() < 0.005
    assert modal_identification(RECORD, "ssi_cov", ModalOptions(n_pieces=0)).orders[-1] == 60


def test_modes_that_crowd_out_one_another_are_given_more_states():
    """Of 32 modes 15 are stable in models of 60 states: those found alone do not tell that states are few."""
    frequency = np.linspace(2.0, 22.0, 32)
    record = ambient_record(frequency, 0.002, 20, 20000, 0.02)
    result = modal_identification(record, "ssi_cov", ModalOptions(n_pieces=0))
    assert result.orders == tuple(range(4, 241, 4))
    np.testing.assert_allclose(result.modes.frequency, frequency, rtol=0.005)


def test_a_short_record_of_many_modes_keeps_the_states_that_it_has_room_for():
    """Of 160 samples 119 instants remain beside the delays: too few for 120 states, enough for 60."""
    rng = np.random.default_rng(0)
    poles = 2 * np.pi * np.linspace(2.0, 23.0, 18) * (-0.004 + 1j)
    motion = (np.exp(np.outer(np.arange(160) / 50.0, poles)) @ rng.standard_normal((18, 10))).real
    motion += 1e-4 * motion.std(axis=0) * rng.standard_normal(motion.shape)
    record = TimeRecord(50.0, motion, [f"{i + 1}X" for i in range(10)], ("velocity",) * 10)
    result = modal_identification(record, "pencil", ModalOptions(n_pieces=0))
    assert (result.orders[-1], result.modes.n_modes) == (60, 18)
