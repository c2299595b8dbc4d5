"""Modes against closed forms, and the large-model path against the dense one."""

from fractions import Fraction
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

from structid.core.errors import SingularModelError
from structid.dynamics.factorization import installed_factorizers
from structid.dynamics.normal_modes import _shift_below, modes
from structid.fem import Beam, Plate, Structure


def cantilever(n):
    """Mass and stiffness of a clamped beam of n elements, all its properties 1."""
    beam = Beam("beam", [[i, i + 1] for i in range(n)], 1.0, 1.0)
    structure = Structure({i: i / n for i in range(n + 1)}, [beam], ["0Y", "0RZ"])
    return structure.matrix("mass"), structure.matrix("stiffness")


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
    return structure.matrix("mass"), structure.matrix("stiffness")


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
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=30)
    assert (found.frequency[:20] <= 1e-3).all()
    assert 2 * np.pi * found.frequency[20:] == pytest.approx(np.full(10, 22.37329), rel=1e-5)
    gram = found.mode_shapes.T @ (structure.matrix("mass") @ found.mode_shapes)
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


def supported_beam(points, fixed):
    """Beam of all properties 1 on `points`, m."""
    beam = Beam("beam", [[i, i + 1] for i in range(len(points) - 1)], 1.0, 1.0)
    return Structure(dict(enumerate(points)), [beam], fixed, active=["Y", "RZ"])


def exact_first_eigenvalue(points):
    """Of the same finite elements on supports that let it turn, in rational arithmetic, by inverse iteration."""
    x = [Fraction(p).limit_denominator(10**7) for p in points]
    size = 2 * len(x)
    stiffness, mass = ([[Fraction(0)] * size for _ in range(size)] for _ in range(2))
    for e, (a, b) in enumerate(pairwise(x)):
        h = b - a
        bending = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
        bending += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
        inertia = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2]]
        inertia += [[54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
        for i in range(4):
            for j in range(4):
                stiffness[2 * e + i][2 * e + j] += bending[i][j] / h**3
                mass[2 * e + i][2 * e + j] += inertia[i][j] * h / 420
    free = [i for i in range(size) if i not in (0, size - 2)]
    rows = [[stiffness[i][j] for j in free] for i in free]
    heavy = [[mass[i][j] for j in free] for i in free]
    shape = [Fraction(1)] * len(free)
    for _ in range(6):
        force = [sum(m * y for m, y in zip(row, shape, strict=True)) for row in heavy]
        shape = [value.limit_denominator(10**30) for value in solved(rows, force)]
        top = max(map(abs, shape))
        shape = [(value / top).limit_denominator(10**30) for value in shape]
    force = [sum(m * y for m, y in zip(row, shape, strict=True)) for row in heavy]
    pull = [sum(k * y for k, y in zip(row, shape, strict=True)) for row in rows]
    strained, moved = (sum(a * y for a, y in zip(part, shape, strict=True)) for part in (pull, force))
    return float(strained / moved)


def solved(matrix, right):
    """Gauss's elimination in rational arithmetic, without pivots."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i, pivot in enumerate(rows):
        for j in range(len(rows)):
            if j != i and rows[j][i]:
                factor = rows[j][i] / pivot[i]
                rows[j] = [a - factor * b for a, b in zip(rows[j], pivot, strict=True)]
    return [row[-1] / row[i] for i, row in enumerate(rows)]


@pytest.mark.parametrize("gap", [1e-3, 1e-4, 1e-5])
def test_low_modes_of_nodes_close_together_are_exact(gap):
    """Two nodes 0.01 to 1 mm apart in a beam of 1 m: assembled matrices alone give f1 up to 5 % off."""
    points = [0.0, 0.25, 0.5, 0.5 + gap, 0.75, 1.0]
    structure = supported_beam(points, ["0Y", "5Y"])
    mass, stiffness = structure.matrix("mass"), structure.matrix("stiffness")
    found = modes(mass, stiffness, strains=partial(structure.strain_operator, structure.values))
    exact = np.sqrt(exact_first_eigenvalue(points)) / (2 * np.pi)
    assert found.frequency[0] == pytest.approx(exact, rel=1e-8)
    assert abs(found.frequency[0] / exact - 1) <= found.rounding[0] <= 1e-7
    gram = found.mode_shapes.T @ (mass @ found.mode_shapes)
    assert gram[:4, :4] == pytest.approx(np.eye(4), abs=1e-7)
    assert np.abs(found.mode_shapes[[1, 3], 0]) == pytest.approx(
        np.sqrt(2) * np.sin(np.pi * np.array([0.25, 0.5])), rel=1e-3
    )


@pytest.mark.parametrize("gap", [1e-3, 1e-4])
def test_free_beams_with_close_nodes_have_their_elastic_modes(gap):
    structure = supported_beam([0.0, 0.2, 0.4, 0.4 + gap, 0.6, 0.8, 1.0], [])
    even = supported_beam([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], [])
    matrices = [structure.matrix(kind) for kind in ("mass", "stiffness")]
    found = modes(*matrices, strains=partial(structure.strain_operator, structure.values))
    coarse = modes(even.matrix("mass"), even.matrix("stiffness"))
    assert found.frequency[2] == pytest.approx(coarse.frequency[2], rel=2e-4)
    assert found.frequency[2] < coarse.frequency[2]  # more freedom is softer
    assert (found.frequency[:2] <= 1e-5).all()


def test_low_modes_of_matrices_alone_are_as_exact_as_these():
    """Nodes 0.3 mm apart, no strains: the dense eigenvalue problem would be 1e-3 off, the matrix is 1e-6."""
    points = [0.0, 0.25, 0.5, 0.5003, 0.75, 1.0]
    structure = supported_beam(points, ["0Y", "5Y"])
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"))
    exact = np.sqrt(exact_first_eigenvalue(points)) / (2 * np.pi)
    assert abs(found.frequency[0] / exact - 1) <= min(found.rounding[0], 1e-5)


def test_a_thousand_elements_are_no_worse_than_ten():
    """Strains keep 11 digits of what the matrix loses 4 of."""
    structure = supported_beam([i / 1000 for i in range(1001)], ["0Y", "0RZ"])
    found = modes(
        structure.matrix("mass"),
        structure.matrix("stiffness"),
        n_modes=3,
        strains=partial(structure.strain_operator, structure.values),
    )
    exact = np.square([1.875104068711961, 4.694091132974175, 7.854757438237613])
    assert 2 * np.pi * found.frequency == pytest.approx(exact, rel=2e-9)
    assert found.rounding.max() <= 1e-8


def test_modes_of_a_large_model_half_of_which_has_no_mass_are_condensed():
    """700 degrees of freedom, 20 of which have a mass: as many modes come back, those of the chain of masses alone."""
    n, every = 700, 35
    stiffness = sparse.csc_array(
        sparse.diags_array([-np.ones(n - 1), np.full(n, 2.0), -np.ones(n - 1)], offsets=[-1, 0, 1])
    )
    heavy = np.arange(every - 1, n, every)
    mass = sparse.csc_array((np.ones(len(heavy)), (heavy, heavy)), (n, n))
    found = modes(mass, stiffness, n_modes=n)
    spring = sparse.diags_array([-np.ones(19), np.full(20, 2.0), -np.ones(19)], offsets=[-1, 0, 1]).toarray() / every
    spring[-1, -1] = 1 / every + 1.0  # the last mass stands one spring from the wall
    assert len(found.frequency) == 20
    assert (2 * np.pi * found.frequency) ** 2 == pytest.approx(linalg.eigvalsh(spring), rel=1e-9)


def test_a_model_without_any_mass_has_no_modes():
    with pytest.raises(SingularModelError, match="no motion of the model has a mass"):
        modes(sparse.csc_array((2, 2)), sparse.csc_array(np.array([[2.0, -1.0], [-1.0, 1.0]])))
