"""The Poisson integral and the transform from rest against receptances known in closed form."""

from functools import cache

import numpy as np
import pytest

import structid as sid
from structid.dof import parse_dofs
from structid.errors import InputError
from structid.records.transforms.half_plane import LARGEST_ERROR, poisson_weights, right_half_plane
from structid.records.transforms.laplace_transform import frf_from_rest

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


@cache
def struck_chain(length: float) -> tuple[np.ndarray, sid.Structure]:
    """Force and two accelerations of a two-storey chain struck by a smooth pulse, sampled far above its resonances."""
    chain = sid.Structure(
        {0: 0.0, 1: 1.0, 2: 2.0},
        [
            sid.PointMass("mass", [1, 2], [2.0, 1.0]),
            sid.Spring("spring", ["1X", "1X"], ["0X", "2X"], stiffness=[30.0, 20.0]),
            sid.Dashpot("dashpot", ["1X", "1X"], ["0X", "2X"], viscous_damping=[0.3, 0.2]),
        ],
        ["0X"],
    )
    time = np.arange(int(length * RATE)) / RATE
    force = np.where(time < 0.2, np.sin(np.pi * time / 0.2) ** 4, 0.0)
    load = chain.selection(parse_dofs(["2X"])).toarray()
    motion = sid.sampled_transient(
        chain.matrix("inertia"), chain.matrix("elastic"), load, force[:, None], RATE, chain.matrix("viscous")
    )
    return np.column_stack([force, motion.acceleration @ chain.selection(parse_dofs(["1X", "2X"])).toarray()]), chain


def hammer(length: float, noise: float = 0.0, seed: int = 0) -> tuple[sid.TimeRecord, sid.Structure]:
    """The record of that impact, with noise in parts of each channel's largest value."""
    signals, chain = struck_chain(length)
    rng, std = np.random.default_rng(seed), noise * np.abs(signals).max(axis=0)
    noisy = signals + std * rng.standard_normal(signals.shape)
    variance = std**2 if noise else None
    channels, quantities = ("2X", "1X", "2X"), ("force", "acceleration", "acceleration")
    return sid.TimeRecord(RATE, noisy, channels, quantities, variance), chain


@pytest.mark.parametrize("decay", [None, 0.5, np.array([0.4, 0.6, 1.0])])
def test_transform_from_rest_is_exact_although_the_motion_is_cut(decay):
    struck, chain = hammer(20.0)
    at = np.array([0.3, 0.7, 1.5])
    found = frf_from_rest(struck, "2X", ["1X", "2X"], decay, at)
    assert found.decay is not None
    s = found.laplace[:, None, None]
    mass, damping, stiffness = (chain.matrix(law).toarray() for law in ("inertia", "viscous", "elastic"))
    read = chain.selection(parse_dofs(["1X", "2X"])).toarray()
    exact = s**2 * (read.T @ np.linalg.inv(s**2 * mass + s * damping + stiffness) @ read[:, 1:])
    # the simulated force runs straight between its samples, which takes (omega step)^2 / 12 = 7e-4 off it at 1.5 Hz;
    # what is left of the motion after 20 s, times exp(-decay 20 s), is below 1e-3
    error = np.abs(found.values - exact) / np.abs(exact)
    assert error.max() < 2e-3
    assert (np.abs(found.values - exact) ** 2 < 4 * found.variance + (1e-3 * np.abs(exact)) ** 2).all()


def test_transform_from_rest_lies_on_the_axis_where_the_motion_has_died_away():
    struck, _ = hammer(120.0, noise=0.01)
    found = frf_from_rest(struck, "2X", ["1X"], force_until=0.2)
    assert found.decay is None
    assert found.frequency[0] == pytest.approx(1 / 120)


def test_transform_from_rest_states_its_noise():
    at = np.array([0.4, 0.62, 1.2])
    clean = frf_from_rest(hammer(20.0)[0], "2X", ["1X", "2X"], 0.4, at, 0.2).values
    found = [frf_from_rest(hammer(20.0, 0.01, seed)[0], "2X", ["1X", "2X"], 0.4, at, 0.2) for seed in range(300)]
    ratio = np.mean([np.abs(one.values - clean) ** 2 / one.variance for one in found], axis=0)
    # 300 draws of a complex error: 0.06 is a standard deviation
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)


def test_transform_by_fft_equals_the_direct_sum():
    struck, _ = hammer(20.0, 0.01)
    fast = frf_from_rest(struck, "2X", ["1X"], 0.4)
    slow = frf_from_rest(struck, "2X", ["1X"], 0.4, fast.frequency)
    np.testing.assert_allclose(fast.values, slow.values, rtol=1e-9)
    np.testing.assert_allclose(fast.variance, slow.variance, rtol=1e-9)


def test_transform_from_rest_refuses_missing_channels():
    struck, _ = hammer(1.0)
    with pytest.raises(InputError, match="no acceleration at 3X"):
        frf_from_rest(struck, "2X", ["3X"])
    with pytest.raises(InputError, match="at least 0"):
        frf_from_rest(struck, "2X", ["1X"], -1.0)


def test_no_format_keeps_a_decay(tmp_path):
    at = np.geomspace(0.5, 5, 20)
    smooth = right_half_plane(record(OMEGA), at / (2 * np.pi), 0.1 * at)
    for suffix in ("npz", "csv", "uff"):
        with pytest.raises(InputError, match="cannot be written"):
            sid.write_record(tmp_path / f"record.{suffix}", smooth)
