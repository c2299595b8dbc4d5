"""Comparison of shapes and response functions against their definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structid import InputError
from structid.similarity import comac, ecomac, fdac, frac, mac, most_real, orthogonality, subspace_angles

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
        (lambda: mac([1.0, np.inf]), "`first` must be finite"),
        (lambda: mac([[1.0, 0.0], [1.0, np.nan]]), "zero throughout in column 2"),
        (lambda: subspace_angles([1.0, np.nan], [1.0, 2.0]), "with unknown entries"),
        (lambda: orthogonality(np.eye(2), [1.0, np.nan]), "with unknown entries"),
        (lambda: mac(np.ones((2, 2, 2))), "n_channels, n_shapes"),
        (lambda: frac(np.ones((3, 2)), np.ones((3, 1))), "one shape"),
        (lambda: frac(np.ones((3, 2)), np.zeros((3, 2))), "`second` is zero"),
        (lambda: subspace_angles(np.ones((3, 1)), np.ones((4, 1))), "same channels"),
    ],
)
def test_what_cannot_be_compared_is_refused(make, fragment):
    with pytest.raises(InputError, match=fragment):
        make()


def test_comac_and_ecomac_are_their_definitions():
    x, y = shapes(5, 3), shapes(5, 3)
    for r in range(3):
        x[:, r] /= np.linalg.norm(x[:, r])
        y[:, r] /= np.linalg.norm(y[:, r])
        phase = np.vdot(y[:, r], x[:, r])
        y[:, r] *= phase / abs(phase)
    for c in range(5):
        cross = abs(sum(np.conj(x[c, r]) * y[c, r] for r in range(3))) ** 2
        energy = sum(abs(x[c, r]) ** 2 for r in range(3)) * sum(abs(y[c, r]) ** 2 for r in range(3))
        factors = np.array([2.0, -1j, 0.3])
        assert comac(x * factors, y)[c] == pytest.approx(cross / energy, rel=1e-12)
        distance = sum(abs(x[c, r] - y[c, r]) for r in range(3)) / 6 * np.sqrt(5)
        assert ecomac(x, y * factors)[c] == pytest.approx(distance, rel=1e-12)


def test_unknown_entries_leave_the_measures_of_the_known_ones():
    x, y = shapes(6, 4), shapes(6, 4)
    x[[0, 3], 1], x[:, 2], y[5, 3] = np.nan, np.nan, np.nan
    for i in range(4):
        for j in range(4):
            own = ~np.isnan(x[:, i]) & ~np.isnan(y[:, j])
            if i == 2:
                assert np.isnan(mac(x, y)[i, j])
            else:
                assert mac(x, y)[i, j] == pytest.approx(mac(x[own, i], y[own, j]).item(), rel=1e-12)
    pairs = [0, 1, 3]
    assert mac([1.0, np.nan], [0.0, 1.0]).item() == 0  # measured where the other stands still
    by_hand = np.full((6, 3), np.nan)
    for r, pair in enumerate(pairs):
        own = ~np.isnan(x[:, pair]) & ~np.isnan(y[:, pair])
        by_hand[own, r] = ecomac(x[own, pair], y[own, pair]) * 2
    assert ecomac(x[:, pairs], y[:, pairs]) == pytest.approx(np.nanmean(by_hand, axis=1) / 2, rel=1e-12)
    assert comac(x[:, [0, 1]], y[:, [0, 1]])[[0, 3]] == pytest.approx(1.0)  # one pair of entries is always alike
    for measure in (comac, ecomac):  # nothing is known of the third pair: the others count
        assert measure(x, y) == pytest.approx(measure(x[:, pairs], y[:, pairs]), rel=1e-12)
        assert np.isnan(measure(x[:, [2]], y[:, [2]])).all()
    whole = shapes(6, 3)
    turned = whole * np.exp(0.7j)
    whole[1, 2] = np.nan
    assert comac(whole, turned) == pytest.approx(np.ones(6), rel=1e-12)
    assert ecomac(whole, turned) == pytest.approx(np.zeros(6), abs=1e-12)


def test_a_sensor_that_is_turned_round_shows_by_ecomac_alone():
    x = shapes(6, 3).real
    x[4] = 0.3 * np.sign(x[4])
    y = x.copy()
    y[4] *= -1
    assert comac(x, y) == pytest.approx(np.ones(6), rel=1e-9)
    assert int(ecomac(x, y).argmax()) == 4
    assert ecomac(x, x) == pytest.approx(np.zeros(6), abs=1e-12)


def test_orthogonality_is_its_definition_and_1_for_mass_orthogonal_shapes():
    root = RNG.standard_normal((5, 5))
    mass = root @ root.T + np.eye(5)
    x, y = shapes(5, 3).real, shapes(5, 2).real
    for i in range(3):
        for j in range(2):
            expected = abs(x[:, i] @ mass @ y[:, j]) / np.sqrt(x[:, i] @ mass @ x[:, i] * (y[:, j] @ mass @ y[:, j]))
            assert orthogonality(mass, x, y)[i, j] == pytest.approx(expected, rel=1e-12)
    modal = np.linalg.solve(np.linalg.cholesky(mass).T, np.eye(5))
    assert orthogonality(mass, modal) == pytest.approx(np.eye(5), abs=1e-12)
    with pytest.raises(InputError, match="must be"):
        orthogonality(mass[:3, :3], x)
    with pytest.raises(InputError, match="no mass"):
        orthogonality(np.diag([1.0, 0, 0, 0, 0]), np.eye(5)[:, 1:2])


def test_fdac_is_mac_of_operating_shapes_line_by_line():
    h, g = shapes(4, 6).reshape(4, 3, 2), shapes(5, 6).reshape(5, 3, 2)
    found = fdac(h, g)
    assert found.shape == (2, 4, 5)
    for i in range(2):
        for w in range(4):
            for v in range(5):
                assert found[i, w, v] == pytest.approx(mac(h[w, :, i], g[v, :, i]).item(), rel=1e-12)
    with pytest.raises(InputError, match="same outputs"):
        fdac(h, g[:, :2])


def test_shapes_are_turned_to_where_they_are_most_real():
    x = RNG.standard_normal((5, 3))
    found = most_real(x * np.exp(1j * np.array([0.4, 2.0, -1.0])))
    assert np.abs(found) == pytest.approx(np.abs(x), rel=1e-12)
