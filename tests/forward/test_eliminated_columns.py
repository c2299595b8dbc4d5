"""Linear unknowns eliminated from whitened spectra, against least squares of the same columns by singular values."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import structid as sid
from structid.forward.time import spectra
from structid.forward.time.spectra import EliminatedColumns, eliminated_columns, spectra_problem


def polynomial_columns(lowest: float, n_lines: int = 400) -> np.ndarray:
    """Powers of a frequency from `lowest` to 1 and a resonance, (6, n_lines), each of another size."""
    s = 1j * np.linspace(lowest, 1.0, n_lines)
    shapes = [*(s**k for k in range(5)), 1 / (s**2 + 0.02 * s + 0.8)]
    return np.stack(shapes) * 10.0 ** np.arange(6)[:, None]


@pytest.mark.parametrize("lowest", [0.0, 0.6, 0.95], ids=["wide band", "half the band", "narrow band"])
def test_what_is_left_and_the_unknowns_are_those_of_least_squares(lowest):
    columns, rng = polynomial_columns(lowest), np.random.default_rng(3)
    data = rng.standard_normal((2, columns.shape[1])) + 1j * rng.standard_normal((2, columns.shape[1]))
    eliminated = eliminated_columns(columns)
    left, unknowns = eliminated.project_out(data)
    real = np.concatenate([columns.real, columns.imag], axis=1).T
    u, singular, _ = np.linalg.svd(real / np.linalg.norm(real, axis=0), full_matrices=False)
    assert eliminated.rank == (singular > 1e-10 * singular[0]).sum() == 6
    stacked = np.concatenate([data.real, data.imag], axis=1).T
    rest = stacked - u @ (u.T @ stacked)
    assert_allclose(np.concatenate([left.real, left.imag], axis=1).T, rest, atol=1e-11 * np.abs(stacked).max())
    assert_allclose(real @ unknowns, stacked - rest, atol=1e-8 * np.abs(stacked).max())


def test_dependent_columns_count_once():
    columns = polynomial_columns(0.0)
    eliminated = eliminated_columns(np.concatenate([columns, columns[:2] + columns[1:3]]))
    assert eliminated.rank == 6
    left, _ = eliminated.project_out(columns[1:2].copy())
    assert np.abs(left).max() < 1e-9 * np.abs(columns[1]).max()


def dense_elimination(columns):
    """As `eliminated_columns`, by singular values of all columns, those that are 0 among them."""
    real = np.ascontiguousarray(columns).view(np.float64)
    size = np.linalg.norm(real, axis=1)
    safe = np.where(size > 0, size, 1.0)
    u, singular, right = np.linalg.svd(real.T / safe, full_matrices=False)
    rank = int((singular > 1e-10 * singular[0]).sum())
    solution = right[:rank].T / singular[:rank] / safe[:, None]
    basis = np.ascontiguousarray(u[:, :rank].T).view(np.complex128)
    return EliminatedColumns(basis, np.eye(rank), solution, rank)


def test_columns_that_are_0_take_nothing_and_are_left_out(monkeypatch):
    columns, rng = polynomial_columns(0.0), np.random.default_rng(3)
    silent = np.zeros((9, columns.shape[1]), dtype=complex)
    silent[[1, 2, 3, 5, 6, 8]] = columns
    data = rng.standard_normal((2, columns.shape[1])) + 1j * rng.standard_normal((2, columns.shape[1]))
    monkeypatch.setattr(spectra, "_orthonormal", None)  # which takes ten times as long, and is not needed here
    eliminated = eliminated_columns(silent)
    left, unknowns = eliminated.project_out(data)
    kept_left, kept_unknowns = eliminated_columns(columns).project_out(data)
    dense = dense_elimination(silent)
    dense_left, dense_unknowns = dense.project_out(data)
    assert eliminated.rank == dense.rank == 6
    np.testing.assert_array_equal(left, kept_left)
    np.testing.assert_array_equal(unknowns[[1, 2, 3, 5, 6, 8]], kept_unknowns)
    np.testing.assert_array_equal(unknowns[[0, 4, 7]], 0.0)
    assert_allclose(left, dense_left, atol=1e-11 * np.abs(data).max())
    assert_allclose(unknowns, dense_unknowns, rtol=1e-8, atol=1e-12)
    none = eliminated_columns(np.zeros((3, columns.shape[1]), dtype=complex))
    assert none.rank == 0
    np.testing.assert_array_equal(none.project_out(data)[0], data)
    np.testing.assert_array_equal(none.project_out(data)[1], np.zeros((3, 2)))


def test_a_record_of_modes_in_two_directions_with_sensors_in_one_has_the_fit_of_all_columns(monkeypatch):
    """Masses that move in X and Y, measured in X: the transient of the modes in Y has columns that are 0."""
    feet, tops = [f"{i}" for i in range(5)], [f"{i}" for i in range(1, 6)]
    parts: list = [sid.PointMass("m", range(1, 6), 2.0)]
    for along, stiffness in (("X", 4000.0), ("Y", 900.0)):
        ends = [[place + along for place in places] for places in (feet, tops)]
        parts.append(sid.Spring(f"k{along}", *ends, stiffness=stiffness))
        parts.append(sid.Dashpot(f"c{along}", *ends, viscous_damping=0.4))
    structure = sid.Structure({i: (float(i), 0.0) for i in range(6)}, parts, ["0X", "0Y"], active=["X", "Y"])
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "kX", each=True)])
    values, variance = np.random.default_rng(4).standard_normal((600, 3)), np.array([0.0, 0.01, 0.01])
    channels, quantities = ("5X", "5X", "3X"), ("force", "acceleration", "acceleration")
    history = sid.TimeRecord(40.0, values, channels, quantities, variance=variance)
    given = []

    def fit(eliminate):
        monkeypatch.setattr(spectra, "eliminated_columns", lambda columns: given.append(columns) or eliminate(columns))
        problem = spectra_problem(structure, unknown, history, band=(0.1, 18.0))
        return problem.linearize(problem.theta_start)

    found, dense = fit(eliminated_columns), fit(dense_elimination)
    assert (~given[0].any(axis=1)).sum() == 10
    assert found.n_eliminated == dense.n_eliminated
    assert found.residual @ found.residual == pytest.approx(dense.residual @ dense.residual, rel=1e-10)
    assert np.linalg.norm(found.jacobian) == pytest.approx(np.linalg.norm(dense.jacobian), rel=1e-8)
