"""The Poisson integral and the transform from rest against receptances known in closed form."""

import numpy as np
import pytest

import structid as sid
from structid.core.errors import InputError
from structid.records.half_plane import LARGEST_ERROR, poisson_weights, right_half_plane

POLES = np.array([-0.02 + 1j, -0.03 + 2.5j, -0.05 + 4j])


def receptance(s: np.ndarray, rigid: float = 0.0) -> np.ndarray:
    """Three modes of unit residue, and a rigid-body motion of `rigid` / mass."""
    modes = sum(1 / ((s - p) * (s - p.conjugate())) for p in POLES)
    return modes + rigid / s**2


def record(omega: np.ndarray, rigid: float = 0.0, kind: str = "receptance", noise: float = 0.0, seed: int = 0):
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]
    s = 1j * omega
    values = (s**power * receptance(s, rigid))[:, None, None]
    found = sid.FrfRecord(omega / (2 * np.pi), values, ("1X",), ("1X",), kind)
    if not noise:
        return found
    rng = np.random.default_rng(seed)
    size = noise * np.abs(values)
    error = size * (rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape)) / np.sqrt(2)
    return sid.FrfRecord(found.frequency, values + error, ("1X",), ("1X",), kind, variance=size**2)


OMEGA = np.arange(1, 8001) * 2.5e-3
RATE = 100.0


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("ratio", [0.5, 0.1, 0.02])
def test_poisson_integral_gives_the_receptance_right_of_the_axis(ratio, kind):
    at = np.geomspace(0.05, 6, 60)
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]
    found = right_half_plane(record(OMEGA, kind=kind), at / (2 * np.pi), ratio * at)
    s = found.laplace
    exact = s**power * receptance(s)
    # the band ends at five times the highest resonance: what lies beyond is some 1e-3 of the whole
    np.testing.assert_allclose(found.values[:, 0, 0], exact, rtol=1e-2)
    assert len(found.frequency) >= 55


def test_poisson_integral_of_a_free_structure_is_made_of_its_accelerance():
    at = np.geomspace(0.05, 8, 60)
    found = right_half_plane(record(OMEGA, rigid=1.0), at / (2 * np.pi), 0.1 * at)
    np.testing.assert_allclose(found.values[:, 0, 0], receptance(found.laplace, 1.0), rtol=1e-2)


def chain(s: np.ndarray) -> np.ndarray:
    """Motion (n_lines, 2, 1) of two masses on springs, per motion of the ground below the first."""
    mass, stiffness, damping = (
        np.diag([1.0, 0.7]),
        np.array([[3.0, -1.8], [-1.8, 1.8]]),
        np.array([[0.07, -0.03], [-0.03, 0.03]]),
    )
    z = s[:, None, None] ** 2 * mass + s[:, None, None] * damping + stiffness
    pull = np.zeros((len(s), 2, 1), complex)
    pull[:, 0, 0] = 1.2 + 0.04 * s
    return np.linalg.solve(z, pull)


@pytest.mark.parametrize("ratio", [0.5, 0.1, 0.02])
def test_poisson_integral_gives_transmissibility_right_of_the_axis(ratio):
    at = np.geomspace(0.05, 4, 60)
    lines = sid.FrfRecord(OMEGA / (2 * np.pi), chain(1j * OMEGA), ("1X", "2X"), ("0X",), "transmissibility")
    found = right_half_plane(lines, at / (2 * np.pi), ratio * at)
    assert found.kind == "transmissibility"
    np.testing.assert_allclose(found.values, chain(found.laplace), rtol=0.03)
    assert len(found.frequency) >= 55


def test_poisson_integral_starts_from_any_vertical_line():
    at = np.geomspace(0.1, 5, 40)
    first = sid.FrfRecord(
        OMEGA / (2 * np.pi), receptance(0.03 + 1j * OMEGA)[:, None, None], ("1X",), ("1X",), "receptance",
        decay=np.full(len(OMEGA), 0.03),
    )  # fmt: skip
    found = right_half_plane(first, at / (2 * np.pi), 0.03 + 0.1 * at)
    np.testing.assert_allclose(found.values[:, 0, 0], receptance(found.laplace), rtol=5e-3)


def test_poisson_error_covers_what_coarse_lines_and_noise_cost():
    worst = []
    for seed, omega in enumerate(
        (OMEGA, np.arange(1, 501) * 0.04, np.sort(np.random.default_rng(9).uniform(0.05, 20, 900)))
    ):
        at = np.geomspace(omega[0], omega[-1], 150)
        for ratio in (0.3, 0.1, 0.03):
            found = right_half_plane(record(omega, noise=0.01, seed=seed), at / (2 * np.pi), ratio * at)
            error = np.abs(found.values[:, 0, 0] - receptance(found.laplace))
            std = np.sqrt(found.variance[:, 0, 0])
            assert (std <= LARGEST_ERROR * np.abs(found.values[:, 0, 0]) * 1.0001).all()
            worst.append(np.sqrt(np.mean((error / std) ** 2)))
    assert max(worst) < 1.5


def test_poisson_noise_is_propagated():
    at, quiet = np.array([0.8, 1.5]), np.arange(1, 4001) * 5e-3
    clean = right_half_plane(record(quiet), at / (2 * np.pi), 0.05 * at).values
    scatter = [right_half_plane(record(quiet, noise=0.25, seed=k), at / (2 * np.pi), 0.05 * at) for k in range(200)]
    # 25 % noise a line is a large part of the stated error, which has what half of the lines would say in it too
    measured = np.mean([np.abs(one.values - clean) ** 2 for one in scatter], axis=0)
    stated = np.mean([one.variance for one in scatter], axis=0)
    assert (measured < 1.2 * stated).all()
    assert (measured > 0.1 * stated).all()


def test_poisson_weights_sum_to_the_part_of_the_kernel_inside_the_band():
    s = np.array([0.5 + 2j, 0.05 + 3j, 0.001 + 1.0007j])
    forward, backward = poisson_weights(OMEGA, s)
    reach = (np.arctan((20 - s.imag) / s.real) + np.arctan((20 + s.imag) / s.real)) / np.pi
    np.testing.assert_allclose(forward.sum(axis=1) + backward.sum(axis=1), reach, rtol=2e-5)


def test_poisson_integral_refuses_what_it_cannot_do():
    with pytest.raises(InputError, match="too small for the spacing"):
        right_half_plane(record(np.arange(1, 20) * 1.0), np.array([0.2]), np.array([0.01]))
    with pytest.raises(InputError, match="at least 8 lines"):
        right_half_plane(record(OMEGA[:5]), np.array([0.2]), np.array([0.1]))
    with pytest.raises(InputError, match="above 0 1/s"):
        right_half_plane(record(OMEGA), np.array([0.2]), np.array([-0.1]))


def test_a_decay_is_kept_or_refused(tmp_path):
    at = np.geomspace(0.5, 5, 20)
    smooth = right_half_plane(record(OMEGA), at / (2 * np.pi), 0.1 * at)
    for suffix in ("csv", "uff"):
        with pytest.raises(InputError, match="cannot keep `decay`"):
            sid.write_record(tmp_path / f"record.{suffix}", smooth)
    sid.write_record(tmp_path / "record.npz", smooth)
    np.testing.assert_array_equal(sid.read_record(tmp_path / "record.npz").decay, smooth.decay)
