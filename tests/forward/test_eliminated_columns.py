"""Linear unknowns eliminated from whitened spectra, against least squares of the same columns by singular values."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from structid.forward.time.spectra import eliminated_columns


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
