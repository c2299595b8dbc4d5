"""Records of more channels than samples: covariance, shared motions, and modes at every channel."""

import numpy as np
import pytest

from structid import InputError
from structid.dof import Dof
from structid.modal import ModalOptions, full_field_modes
from structid.modal import full_field as full_field_module
from structid.modal.full_field import covariance, shared_motions

PLACES = np.linspace(0.0, np.pi, 1500)
SHAPES = np.stack([np.sin(PLACES), np.sin(2 * PLACES), np.cos(3 * PLACES)])
OMEGA = np.array([2.0, 5.0, 9.0])


def field(noise=0.0, n=400):
    time = np.arange(n)[:, None] * 0.05
    motion = np.exp(-0.02 * time) * np.cos(OMEGA * time + [0.1, 0.5, 1.0])
    return motion @ SHAPES + noise * np.random.default_rng(0).standard_normal((n, len(PLACES)))


@pytest.mark.parametrize("at_once", [50, 1 << 22])
@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-14), (np.float32, 1e-6)])
def test_covariance_by_blocks_is_the_plain_one(at_once, kind, tolerance, monkeypatch):
    monkeypatch.setattr(full_field_module, "_AT_ONCE", at_once)
    y = np.random.default_rng(1).standard_normal((777, 12))
    expected = y.T @ y / 777
    found = covariance(y.astype(kind))
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("wide", [True, False])
def test_shared_motions_are_the_leading_singular_vectors(wide):
    values = field(1e-3) if wide else field(1e-3, n=2000)[:, ::10]
    found = shared_motions(values, 3)
    _, singular, right = np.linalg.svd(values, full_matrices=False)
    np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(3), atol=1e-12)
    assert np.linalg.svd(right[:3] @ found.basis, compute_uv=False).min() > 1 - 1e-4
    np.testing.assert_allclose(np.linalg.norm(found.motions, axis=0), singular[:3], rtol=1e-4)
    assert shared_motions(values, 40).basis.shape == (values.shape[1], 3)  # noise is left out
    rest = 1 - np.sum(singular[:3] ** 2) / np.sum(singular**2)
    assert rest * (1 - 1e-6) <= found.left_out <= (2 if wide else 1.001) * rest  # a sketch's basis is not the best one


def test_modes_without_noise_are_exact_at_every_channel():
    options = ModalOptions(orders=[6], n_pieces=0)
    found = full_field_modes(field(), 20.0, [f"{i}Z" for i in range(len(PLACES))], options=options).modes
    np.testing.assert_allclose(found.frequency * 2 * np.pi, np.hypot(OMEGA, 0.02), rtol=1e-10)
    np.testing.assert_allclose(found.damping_ratio, 0.02 / np.hypot(OMEGA, 0.02), rtol=1e-7)
    for shape, true in zip(found.mode_shapes.T, SHAPES, strict=True):
        np.testing.assert_allclose(shape, true / true[np.abs(shape).argmax()], atol=1e-8)
    assert found.channels[7] == Dof(7, "Z")


def test_single_precision_memory_map_gives_the_same_modes(tmp_path):
    path = tmp_path / "field.npy"
    np.save(path, field(0.01).astype(np.float32))
    values = np.load(path, mmap_mode="r")
    names = [f"{i}Z" for i in range(len(PLACES))]
    found = full_field_modes(values, 20.0, names).modes
    truth = np.hypot(OMEGA, 0.02) / (2 * np.pi)
    std = np.sqrt(np.diag(found.covariance))[:3]
    assert found.n_modes == 3
    assert (np.abs(found.frequency - truth) < 4 * std).all()
    assert (std / truth < 1e-4).all()


@pytest.mark.parametrize(
    ("values", "rank", "words"),
    [
        (np.zeros((5, 9)), 2, "only zeros"),
        (np.full((5, 9), np.nan), 2, "NaN"),
        (np.ones((5, 9)), 6, "`rank`"),
        (np.ones(5), 1, "n_times, n_channels"),
        (np.ones((5, 9), dtype=complex), 2, "real samples"),
    ],
)
def test_unusable_fields_are_named(values, rank, words):
    with pytest.raises(InputError, match=words):
        shared_motions(values, rank)


def test_names_and_channels_must_agree():
    with pytest.raises(InputError, match="1500 channels, got 1 names"):
        full_field_modes(field(), 20.0, ["1Z"], rank=3)
