"""Changes of whitened data by fixed values within their tolerances, which no cause is asked to explain."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.search_budget import METER, iteration_effort
from structid.diagnose.thresholds import LEAST_TOLERANCE_EFFECT
from structid.inversion.linearization import triangle_of
from structid.inversion.search.within_tolerances import FixedValues


def fixed_columns(
    fixed_values: FixedValues | None, names: tuple[str, ...], theta: FloatArray, n_rows: int
) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names of fixed values, changes (n_rows, n_fixed) of all rows by their logarithms, and relative tolerances.

    The effort of a linearization is counted.

    Parameters
    ----------
    fixed_values : FixedValues, optional
        Fixed values of the model; without them there are no names, no columns and no tolerances.
    names : tuple of str
        Names of the parameters.
    theta : (n_params,) float array
        Free variables at which the changes are evaluated.
    n_rows : int
        Number of data rows and, behind them, rows of priors, which fixed values do not change.
    """
    if fixed_values is None:
        return (), np.zeros((n_rows, 0)), np.zeros(0)
    METER.add(iteration_effort(fixed_values.problem))
    influence = fixed_values.sensitivities_at(names, theta)
    padded = np.pad(influence.columns, ((0, n_rows - len(influence.columns)), (0, 0)))
    return influence.names, padded, influence.tolerance


def tolerance_directions(jacobian: FloatArray, columns: FloatArray) -> FloatArray:
    """Changes of data rows by one tolerance each, independent in what parameters cannot follow, (n_rows, n_directions).

    Columns T of one tolerance each are turned to T V, with V the right singular vectors of the part of T that is off
    the Jacobian; the coefficients of T V are standard normal as those of T are. Columns whose part off the Jacobian has
    a norm up to 0.3 standard deviations of the data are left out: noise hides them. No columns where there are no fixed
    values.

    Parameters
    ----------
    jacobian : (n_rows, n_params) float array
        Whitened Jacobian of the parameters.
    columns : (n_rows, n_fixed) float array
        Changes of the whitened rows by one tolerance of each fixed value.
    """
    n_params = jacobian.shape[1]
    if not columns.shape[1]:
        return columns
    off = triangle_of(np.column_stack([jacobian, columns]))[n_params:, n_params:]
    _, size, right = np.linalg.svd(off, full_matrices=False)
    return np.asarray(columns @ right[size > LEAST_TOLERANCE_EFFECT].T)


def damped_basis(basis: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """An orthonormal basis B of what parameters and tolerances can follow, and the part W of each direction that they take.

    With Q = `basis` and the singular values s of the part of `directions` off it, least squares with standard normal priors
    on the directions leave |(I - B W B') r|^2 of a residual r: W is 1 for Q and 1 - 1 / sqrt(1 + s^2) for the rest. Shapes are
    (n_rows, n_params + n_directions) and (n_params + n_directions,).

    Parameters
    ----------
    basis : (n_rows, n_params) float array
        Orthonormal basis of what the parameters can follow.
    directions : (n_rows, n_directions) float array
        Changes by one tolerance each.
    """
    left, size, _ = np.linalg.svd(directions - basis @ (basis.T @ directions), full_matrices=False)
    weights = np.concatenate([np.ones(basis.shape[1]), 1 - 1 / np.sqrt(1 + size**2)])
    return np.column_stack([basis, left]), weights
