"""Records of more channels than samples: covariance, shared motions, and modes at every channel."""

import numpy as np
import pytest

from structid import InputError
from structid.core.dof import Dof
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


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-13), (np.float32, 3e-6)])
@pytest.mark.parametrize("shape", [(333, 2111), (16, 40_003), (1, 5), (241, 7)])
def test_small_products_add_up_to_the_whole_ones(shape, kind, tolerance, monkeypatch):
    monkeypatch.setattr(full_field_module, "_AT_ONCE", 1)  # several blocks of samples
    values = np.random.default_rng(2).standard_normal(shape).astype(kind)
    drawn = np.random.default_rng(3).standard_normal((shape[0], 8)).astype(kind).astype(float)
    whole = values.astype(float)
    sketch = full_field_module._sketch(values, 8, np.random.default_rng(3))
    np.testing.assert_allclose(sketch, whole.T @ drawn, atol=tolerance * np.sqrt(shape[0]) * 10)
    basis = np.random.default_rng(4).standard_normal((shape[1], 5)) / np.sqrt(shape[1])
    motions, power = full_field_module._project_samples(values, basis)
    np.testing.assert_allclose(motions, whole @ basis, atol=tolerance * 10)
    assert power == pytest.approx(np.sum(whole**2), rel=tolerance)


@pytest.mark.parametrize("noise", [0.0, 1e-9, 3e-8, 1e-7, 1e-3])
@pytest.mark.parametrize("order", ["C", "F"])
def test_the_basis_is_orthonormal_and_motions_are_the_projection_onto_it(noise, order):
    values = np.asarray(field(noise), order=order)
    found = shared_motions(values, 20)
    rank = found.basis.shape[1]
    np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(rank), atol=1e-13)
    np.testing.assert_allclose(found.motions, values @ found.basis, atol=1e-11)
    outside = values - found.motions @ found.basis.T
    assert found.left_out == pytest.approx(np.sum(outside**2) / np.sum(values**2), rel=1e-6, abs=1e-14)


def test_power_of_single_precision_is_added_up_in_double():
    values = 1 + field(0.0).astype(np.float32) * np.float32(1e-3)
    power = full_field_module._square_sum(values)
    assert power == pytest.approx(np.sum(values.astype(float) ** 2), rel=1e-6)


@pytest.mark.parametrize("smallest", [1e-2, 1e-5, 1e-7, 1e-10, 0.0])
def test_a_sketch_of_any_condition_gets_a_basis_that_its_gram_matrix_sets_right(smallest):
    rng = np.random.default_rng(5)
    left, right = np.linalg.qr(rng.standard_normal((900, 6)))[0], np.linalg.qr(rng.standard_normal((6, 6)))[0]
    sketch = left @ np.diag([1.0, 1.0, 1.0, 1.0, 1.0, smallest]) @ right
    basis, gram = full_field_module._nearly_orthonormal(sketch)
    np.testing.assert_allclose(gram, basis.T @ basis, atol=1e-14)
    exact = basis @ np.linalg.inv(np.linalg.cholesky(gram).T)
    np.testing.assert_allclose(exact.T @ exact, np.eye(6), atol=1e-14)
    np.testing.assert_allclose(exact @ (exact.T @ sketch), sketch, atol=1e-14)
