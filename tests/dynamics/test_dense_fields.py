"""Fields of small structures, summed over poles or solved for, against one dense solution a line."""

import numpy as np
import pytest
from scipy import linalg

from structid.core.errors import SingularModelError
from structid.dynamics import dense_fields
from structid.dynamics.dense_fields import DenseFields, solve_small_systems

LINES = np.linspace(0.02, 0.9, 400)


def chain(n=6, viscous=0.0, loss=0.0, held=True, massless=0):
    """Mass, viscous damping, stiffness and structural damping of masses on springs, held at one end or free."""
    rng = np.random.default_rng(n)
    springs = rng.uniform(5.0, 15.0, n)
    springs[0] *= held
    stiffness = np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    mass[n - massless - 1 : n - 1] = 0.0
    return np.stack([mass, viscous * np.diag(rng.uniform(0.5, 1.5, n)), stiffness, loss * stiffness])


def laws(laplace, *more):
    plain = [laplace**2, laplace, np.ones_like(laplace), np.full_like(laplace, 1j)]
    return np.stack([*plain, *more], axis=1)


def contacts(n, *vectors):
    return np.stack([sign * np.outer(b, b) for sign, b in vectors]) if vectors else np.zeros((0, n, n))


def fields(matrices, laplace, loads, coefficients=None, chosen=None):
    """Of all lines, and whether they came from poles."""
    at = DenseFields(matrices, laplace, loads, laplace.imag / (2 * np.pi))
    coefficients = laws(laplace) if coefficients is None else coefficients
    chosen = np.arange(loads.shape[1]) if chosen is None else chosen
    parts = list(at.solve_in_chunks(coefficients, chosen))
    assert [part.start for part, _ in parts] == [0, *[part.stop for part, _ in parts[:-1]]]
    return np.concatenate([found for _, found in parts]), at.modal is not None


def dense(matrices, coefficients, loads):
    return np.array([np.linalg.solve(np.tensordot(c, matrices, 1), loads.astype(complex)) for c in coefficients])


def off(found, exact):
    return (np.abs(found - exact).max(axis=1) / np.abs(exact).max(axis=1)).max()


CASES = {
    "undamped": {},
    "structural": {"loss": 0.02},
    "viscous": {"viscous": 0.05},
    "both": {"viscous": 0.05, "loss": 0.02},
    "free": {"held": False},
    "free and damped": {"held": False, "viscous": 0.05},
    "motions without mass": {"massless": 2, "loss": 0.02},
    "damped motions without mass": {"massless": 2, "viscous": 0.05},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("decay", [0.0, 0.3])
def test_sum_over_poles_equals_the_direct_solution(case, decay):
    matrices, loads = chain(**CASES[case]), np.eye(6)[:, [0, 3, 5]]
    laplace = 2 * np.pi * LINES * (1j + decay)
    found, by_poles = fields(matrices, laplace, loads)
    assert by_poles
    assert off(found, dense(matrices, laws(laplace), loads)) < 1e-10


@pytest.mark.parametrize(("viscous", "loss"), [(0.0, 0.0), (0.05, 0.02)])
def test_poles_far_above_the_lines_are_summed_as_one_power_series(viscous, loss, monkeypatch):
    """The fields are those that all poles give one by one; with fewer terms they are not."""
    matrices, loads = chain(80, viscous, loss), np.eye(80)[:, [0, 40, 79]]
    laplace = 2j * np.pi * np.linspace(0.001, 0.1, 600)
    exact = dense(matrices, laws(laplace), loads)
    found, by_poles = fields(matrices, laplace, loads)
    at = dense_fields.modal_fields(matrices, loads, laplace)
    assert by_poles
    assert 2 * dense_fields._FAR_TERMS < at._far.sum() < len(at.inverse)
    assert len(at._residues) < len(at.inverse)
    assert off(found, exact) < 1e-11
    monkeypatch.setattr(dense_fields, "_FAR_TERMS", 8)
    assert off(dense_fields._ModalFields(at.variable, at.inverse, at.shapes, at.drive).at(slice(None)), exact) > 1e-9


def test_few_lines_are_factorized():
    matrices, loads, laplace = chain(loss=0.02), np.eye(6)[:, [0, 3]], 2j * np.pi * LINES[:20]
    found, by_poles = fields(matrices, laplace, loads, chosen=np.array([1]))
    assert not by_poles
    assert off(found, dense(matrices, laws(laplace), loads[:, [1]])) < 1e-13


def test_loads_that_do_nothing_and_choices_of_loads():
    matrices, laplace = chain(loss=0.02), 2j * np.pi * LINES
    loads = np.stack([np.eye(6)[2], np.zeros(6), np.eye(6)[4]], axis=1)
    found, by_poles = fields(matrices, laplace, loads, chosen=np.array([2, 1]))
    assert by_poles
    assert not found[:, :, 1].any()
    assert off(found[:, :, :1], dense(matrices, laws(laplace), loads[:, [2]])) < 1e-10


@pytest.mark.parametrize("damping", [0.0, 0.1, 2.0])
def test_sum_over_poles_is_right_or_gives_way_where_poles_coincide(damping):
    # free: the rigid-body motion has a double pole at 0, or one there and one near it
    mass, stiffness = np.diag([1.0, 2.0]), np.array([[1.0, -1.0], [-1.0, 1.0]])
    matrices = np.stack([mass, damping * mass, stiffness, 0 * mass])
    s, load = 1j * np.linspace(0.01, 3, 200), np.array([[1.0], [0.0]])
    found, _ = fields(matrices, s, load)
    assert off(found, dense(matrices, laws(s), load)) < 1e-9


def test_critical_damping_is_factorized():
    # (s + 1)^2 x = f: a double pole with one eigenvector
    matrices = np.array([1.0, 2.0, 1.0, 0.0]).reshape(4, 1, 1)
    s = 1j * np.linspace(0.01, 3, 200)
    found, by_poles = fields(matrices, s, np.ones((1, 1)))
    assert not by_poles
    assert found.ravel() == pytest.approx(1 / (s + 1) ** 2, rel=1e-12)


def test_poles_that_miss_the_direct_solution_are_not_used(monkeypatch):
    matrices, loads, laplace = chain(loss=0.02), np.eye(6)[:, [0, 3]], 2j * np.pi * LINES
    right = np.linalg.eig

    def blurred(matrix):
        """Poles with an error of 1e-6, as badly conditioned eigenvectors make it."""
        poles, vectors = right(matrix)
        return poles * (1 + 1e-6), vectors

    monkeypatch.setattr(np.linalg, "eig", blurred)
    found, by_poles = fields(matrices, laplace, loads)
    assert not by_poles
    assert off(found, dense(matrices, laws(laplace), loads)) < 1e-13


def test_rounding_of_a_stiff_structure_does_not_count_against_its_poles():
    """Two direct solutions of a fine beam differ by more than 1e-10; its poles are no worse."""
    n, h = 32, 1.0 / 32
    local = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / h**3
    inertia = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) * h / 420
    scale = np.outer([1, h, 1, h], [1, h, 1, h])
    mass, stiffness = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for e in range(n):
        mass[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += inertia * scale
        stiffness[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += local * scale
    mass, stiffness = mass[2:, 2:], stiffness[2:, 2:]
    matrices, loads = np.stack([mass, 0 * mass, stiffness, 0.01 * stiffness]), np.eye(2 * n)[:, [-2]]
    laplace = 2j * np.pi * np.linspace(0.2, 30.0, 400)
    found, by_poles = fields(matrices, laplace, loads)
    assert by_poles
    exact = dense(matrices, laws(laplace), loads)
    other = dense(matrices[:, ::-1, ::-1], laws(laplace), loads[::-1])[:, ::-1]
    assert off(other, exact) > 1e-10
    assert off(found, exact) < 30 * off(other, exact)


@pytest.mark.parametrize("n_lines", [20, 400])
def test_friction_equals_the_direct_solution(n_lines):
    """Two contacts, one of them between two masses and one of negative force, from loose to stuck."""
    rng = np.random.default_rng(1)
    loads, laplace = np.eye(6)[:, [0, 3, 5]], 2j * np.pi * LINES[:n_lines]
    held = (1.0, 0.7 * np.eye(6)[2]), (-1.0, 0.02 * (np.eye(6)[4] - np.eye(6)[1]))
    matrices = np.concatenate([chain(loss=0.02), contacts(6, *held)])
    for size in (1e-6, 1.0, 1e6):
        factors = 1j * size * rng.uniform(0.1, 10.0, (2, n_lines))
        found, by_poles = fields(matrices, laplace, loads, laws(laplace, *factors))
        assert by_poles == (n_lines == 400)
        assert off(found, dense(matrices, laws(laplace, *factors), loads)) < 1e-10
    none = fields(matrices, laplace, loads, laws(laplace, *np.zeros((2, n_lines), complex)))[0]
    assert off(none, dense(matrices[:4], laws(laplace), loads)) < 1e-10


def test_friction_that_alone_holds_a_resonance_keeps_its_digits(monkeypatch):
    """Without friction the motion next to a resonance is 1e5 times larger, and the difference of fields shows it."""
    matrices, loads = chain(loss=1e-7), np.eye(6)[:, [0, 3]]
    resonance = np.sqrt(linalg.eigvalsh(matrices[2], matrices[0])[1])
    laplace = 1j * np.sort(np.append(2 * np.pi * LINES, resonance))
    matrices = np.concatenate([matrices, contacts(6, (1.0, np.eye(6)[2]))])
    coefficients = laws(laplace, np.full(len(laplace), 30j))
    exact = dense(matrices, coefficients, loads)
    found, by_poles = fields(matrices, laplace, loads, coefficients)
    assert by_poles
    assert off(found, exact) < 1e-12
    monkeypatch.setattr(dense_fields, "MOST_SMALLER", np.inf)
    assert off(fields(matrices, laplace, loads, coefficients)[0], exact) > 1e-11


@pytest.mark.parametrize("n_lines", [20, 400])
def test_a_line_that_cannot_be_factorized_is_named(n_lines):
    matrices, laplace = np.array([1.0, 0.0, 4.0, 0.0]).reshape(4, 1, 1), 1j * np.linspace(1.0, 3.0, n_lines + 1)
    with pytest.raises(SingularModelError, match=r"singular at 0\.\d+ to 0\.\d+ Hz"):
        fields(matrices, laplace, np.ones((1, 1)))
    assert dense_fields.modal_fields(matrices, np.ones((1, 1)), laplace) is None


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_unknowns_of_many_lines_are_solved_for_as_by_lapack(n):
    rng = np.random.default_rng(n)
    systems = rng.normal(size=(50, n, n)) + 1j * rng.normal(size=(50, n, n))
    right = rng.normal(size=(50, n, 4))
    assert np.allclose(solve_small_systems(systems, right), np.linalg.solve(systems, right), rtol=1e-9)
    systems[7] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        solve_small_systems(systems, right)
