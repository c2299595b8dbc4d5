"""Modes against closed forms, and the large-model path against the dense one."""

import numpy as np
import pytest
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

from structid.core.errors import SingularModelError
from structid.dynamics.factorization import installed_factorizers
from structid.dynamics.modes import _shift_below, modes
from structid.fem import Beam, Plate, Structure


def cantilever(n):
    """Mass and stiffness of a clamped beam of n elements, all its properties 1."""
    beam = Beam("beam", [[i, i + 1] for i in range(n)], 1.0, 1.0)
    structure = Structure({i: i / n for i in range(n + 1)}, [beam], ["0Y", "0RZ"])
    return structure.matrix("inertia"), structure.matrix("elastic")


def test_damping_ratios_of_a_single_mass():
    m, k, c, h = 2.0, 50.0, 0.3, 1.5
    matrices = [sparse.csc_array(np.array([[v]])) for v in (m, k, c, h)]
    found = modes(*matrices)
    omega = np.sqrt(k / m)
    assert found.frequency == pytest.approx([omega / (2 * np.pi)])
    assert found.damping_ratio == pytest.approx([c / (2 * m * omega) + h / (2 * k)])
    assert found.mode_shapes == pytest.approx(np.array([[1 / np.sqrt(m)]]))


def test_motion_without_mass_follows_statically():
    """Two springs in series with no mass between: k/2 in effect."""
    stiffness = sparse.csc_array(np.array([[2.0, -1.0], [-1.0, 1.0]]))
    mass = sparse.csc_array(np.diag([0.0, 1.0]))
    found = modes(mass, stiffness)
    assert 2 * np.pi * found.frequency == pytest.approx([np.sqrt(0.5)])
    assert found.mode_shapes[:, 0] == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize("rounding", [0.0, 1e-16, -1e-16])
def test_combinations_without_mass_follow_statically(rounding):
    """Masses at the ends of a massless lever that reads both: the mass matrix is singular with a positive diagonal."""
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((4, 4)))[0] * [1.0, 1e3, 1.0, 1.0]
    mass = turn.T @ np.diag([2.0, 1.0, rounding, rounding]) @ turn
    stiffness = np.random.default_rng(3).standard_normal((4, 4))
    stiffness = stiffness @ stiffness.T + np.eye(4)
    heavy, light = np.split(np.arange(4), 2)
    follow = np.linalg.solve(stiffness[np.ix_(light, light)], stiffness[np.ix_(light, heavy)])
    condensed = stiffness[np.ix_(heavy, heavy)] - stiffness[np.ix_(heavy, light)] @ follow
    squared = linalg.eigh(condensed, np.diag([2.0, 1.0]), eigvals_only=True)
    found = modes(sparse.csc_array(mass), sparse.csc_array(turn.T @ stiffness @ turn))
    assert (mass.diagonal() > 0).all()
    assert (2 * np.pi * found.frequency) ** 2 == pytest.approx(squared)
    assert found.mode_shapes.T @ mass @ found.mode_shapes == pytest.approx(np.eye(2), abs=1e-9)


def test_a_motion_without_mass_and_stiffness_is_told():
    with pytest.raises(SingularModelError, match="neither mass nor stiffness"):
        modes(sparse.csc_array(np.ones((2, 2))), sparse.csc_array(np.ones((2, 2))))


def test_sparse_path_equals_dense_path():
    n = 320  # 640 unknown motions: above the dense limit of 600
    mass, stiffness = cantilever(n)
    found = modes(mass, stiffness, n_modes=4)
    assert 2 * np.pi * found.frequency == pytest.approx([3.516015, 22.03449, 61.69721, 120.9019], rel=1e-5)
    gram = found.mode_shapes.T @ (mass @ found.mode_shapes)
    assert gram == pytest.approx(np.eye(4), abs=1e-8)


def grid_of_plates(n):
    """A free square plate in bending of n x n elements, its matrices."""
    points = {i * (n + 1) + j: (i / n, j / n) for i in range(n + 1) for j in range(n + 1)}
    first = np.add.outer(np.arange(n) * (n + 1), np.arange(n)).ravel()
    corners = np.stack([first, first + n + 1, first + n + 2, first + 1], axis=1)
    plate = Plate("plate", corners, 70e9, 2700.0, 2e-3, poisson=0.3)
    structure = Structure(points, [plate], [], active=["Z", "RX", "RY"])
    return structure.matrix("inertia"), structure.matrix("elastic")


def test_shift_goes_down_to_the_lowest_eigenvalues_of_a_fine_mesh():
    """From the mean of all eigenvalues, 150 times the eighth of this plate, to their neighbourhood."""
    mass, stiffness = grid_of_plates(40)
    found = modes(mass, stiffness, n_modes=12)
    assert (found.frequency[:3] <= 1e-3).all()
    eighth = (2 * np.pi * found.frequency[7]) ** 2
    shift, _ = _shift_below(stiffness, mass)
    assert 0.3 * eighth <= -shift <= 15 * eighth
    expected = eigsh(stiffness, 12, mass, sigma=-eighth, return_eigenvectors=False)
    assert 2 * np.pi * found.frequency[3:] == pytest.approx(np.sqrt(np.sort(expected)[3:]), rel=1e-7)


@pytest.mark.parametrize("name", installed_factorizers())
def test_modes_of_equal_parts_are_all_found(name, monkeypatch):
    """Ten free beams: twenty modes at 0 Hz, then the first bending mode of each."""
    monkeypatch.setenv("STRUCTID_FACTORIZER", name)
    n = 40
    starts = [(n + 1) * k for k in range(10)]
    lines = [[s + i, s + i + 1] for s in starts for i in range(n)]
    points = {s + i: i / n for s in starts for i in range(n + 1)}
    structure = Structure(points, [Beam("beam", lines, 1.0, 1.0)], [], active=["Y", "RZ"])
    found = modes(structure.matrix("inertia"), structure.matrix("elastic"), n_modes=30)
    assert (found.frequency[:20] <= 1e-3).all()
    assert 2 * np.pi * found.frequency[20:] == pytest.approx(np.full(10, 22.37329), rel=1e-5)
    gram = found.mode_shapes.T @ (structure.matrix("inertia") @ found.mode_shapes)
    assert gram == pytest.approx(np.eye(30), abs=1e-8)


@pytest.mark.parametrize("n", [1000, 3000])
def test_rounding_says_how_far_a_fine_beam_can_be_off(n):
    """Rounding grows with the fourth power of the number of elements; the error found is below it."""
    found = modes(*cantilever(n), n_modes=3)
    error = abs(2 * np.pi * found.frequency[0] / 3.516015 - 1)
    assert 1e-6 <= error <= found.rounding[0]
    assert found.rounding[0] == pytest.approx(4.3e-4 * (n / 1000) ** 4, rel=0.2)
    assert (np.diff(found.rounding) < 0).all()


def test_rounding_of_rigid_modes_counts_beside_the_first_elastic_one():
    found = modes(*grid_of_plates(40), n_modes=6)
    assert found.rounding[:3] == pytest.approx(found.rounding[3], rel=0.1)
    assert found.rounding.max() <= 1e-9


@pytest.mark.parametrize("n_modes", [20, 45])
def test_forty_modes_of_one_frequency_are_all_found(n_modes):
    """Lanczos alone stops at 12 of the first 20, and at 23 of the 40."""
    expected = np.concatenate([np.full(40, 4.0), np.linspace(9.0, 1e6, 700)])
    mass, stiffness = (sparse.csc_array(sparse.diags_array(values)) for values in (np.ones(740), expected))
    found = modes(mass, stiffness, n_modes=n_modes)
    assert (2 * np.pi * found.frequency) ** 2 == pytest.approx(expected[:n_modes], rel=1e-6)
    assert found.mode_shapes.T @ found.mode_shapes == pytest.approx(np.eye(n_modes), abs=1e-8)


def test_values_that_ran_away_are_a_model_that_cannot_be_evaluated():
    good = sparse.csc_array(np.eye(2))
    with pytest.raises(SingularModelError, match="not finite"):
        modes(good, sparse.csc_array(np.array([[np.inf, 0.0], [0.0, 1.0]])))
