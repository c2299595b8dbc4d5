"""Comparison of shapes and response functions against their definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structid import InputError
from structid.similarity import frac, mac, subspace_angles

RNG = np.random.default_rng(11)


def shapes(n, m):
    return RNG.standard_normal((n, m)) + 1j * RNG.standard_normal((n, m))


@pytest.mark.parametrize("part", [np.real, np.asarray])
def test_mac_is_its_definition_pair_by_pair(part):
    x, y = part(shapes(5, 3)), part(shapes(5, 2))
    for i in range(3):
        for j in range(2):
            a, b = x[:, i], y[:, j]
            expected = abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real)
            assert mac(x, y)[i, j] == pytest.approx(expected, rel=1e-13)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.floats(0.01, 100), st.floats(0, 6.3))
def test_mac_ignores_factors_and_phase_and_stays_within_0_and_1(seed, size, phase):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((6, 4)) + 1j * rng.standard_normal((6, 4))
    assert np.diag(mac(x, x * size * np.exp(1j * phase))) == pytest.approx(np.ones(4), rel=1e-12)
    assert mac(x) == pytest.approx(mac(x).T, rel=1e-12)
    assert (mac(x) <= 1 + 1e-12).all()


def test_mac_of_known_shapes():
    assert mac([1, 0], [1, 1]).item() == pytest.approx(0.5)  # 45 degrees
    assert mac([1, 2, 2], [2, -2, 1]).item() == 0.0
    assert mac([1.0, 1j], [1.0, 1.0]).item() == pytest.approx(0.5)


def test_frac_is_mac_along_frequency():
    h = shapes(30, 6).reshape(30, 2, 3)
    g = h + 0.3 * shapes(30, 6).reshape(30, 2, 3)
    found = frac(h, g)
    assert found.shape == (2, 3)
    for i in range(2):
        for j in range(3):
            assert found[i, j] == pytest.approx(mac(h[:, i, j], g[:, i, j]).item(), rel=1e-13)
    assert frac(h, 2j * h) == pytest.approx(np.ones((2, 3)), rel=1e-13)


def test_frac_falls_where_a_peak_moves():
    omega = np.linspace(0.5, 1.5, 400)
    peaks = [1 / (w**2 - omega**2 + 0.02j * w * omega) for w in (1.0, 1.0, 1.1)]
    assert frac(peaks[0], peaks[1]) == pytest.approx(1.0, rel=1e-13)
    assert frac(peaks[0], peaks[2]) < 0.1


def test_subspace_angles_of_known_planes():
    turn = 0.3
    first = np.eye(4)[:, :2]
    second = np.column_stack([[1, 0, 0, 0], [0, np.cos(turn), np.sin(turn), 0]])
    assert subspace_angles(first, second) == pytest.approx([0.0, turn], abs=1e-12)
    mixed = second @ [[2.0, 1.0], [-1.0, 3.0]]
    assert subspace_angles(second, mixed) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert subspace_angles(first, np.array([0.0, 0, 0, 2])) == pytest.approx([np.pi / 2])


@pytest.mark.parametrize(
    ("make", "fragment"),
    [
        (lambda: mac(np.ones((3, 1)), np.ones((4, 1))), "same channels, got 3 and 4"),
        (lambda: mac([[1.0, 0.0], [1.0, 0.0]]), "zero throughout in column 2"),
        (lambda: mac([1.0, np.nan]), "`first` must be finite"),
        (lambda: mac(np.ones((2, 2, 2))), "n_channels, n_shapes"),
        (lambda: frac(np.ones((3, 2)), np.ones((3, 1))), "one shape"),
        (lambda: frac(np.ones((3, 2)), np.zeros((3, 2))), "`second` is zero"),
        (lambda: subspace_angles(np.ones((3, 1)), np.ones((4, 1))), "same channels"),
    ],
)
def test_what_cannot_be_compared_is_refused(make, fragment):
    with pytest.raises(InputError, match=fragment):
        make()
