"""Rows of the priors of named unknowns below the data rows of a problem, by free variables."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.inversion.linearization import Linearization
from structid.unknowns.named_unknowns import NamedUnknowns
from structid.unknowns.priors import free_prior_rows


def residual_with_priors(unknowns: NamedUnknowns, theta: FloatArray, data: FloatArray) -> FloatArray:
    """Whitened `data` rows, then the residuals of all priors at the free variables `theta`, (n_residuals,)."""
    return np.concatenate(
        [data, unknowns.prior_residual(unknowns.physical(theta)), free_prior_rows(unknowns.free_prior, theta)[1]]
    )


def linearization_with_priors(
    unknowns: NamedUnknowns, theta: FloatArray, data: FloatArray, change: FloatArray, n_eliminated: int = 0
) -> Linearization:
    """Residual and Jacobian at the free variables `theta` of data rows and all priors.

    Parameters
    ----------
    unknowns : NamedUnknowns
    theta : (n_params,) float array
    data : (n_data,) float array
        Whitened data rows.
    change : (n_data, n_params) float array
        Their derivative with respect to the free variables.
    n_eliminated : int
        See `Linearization`.
    """
    residual, rows = unknowns.prior_rows(unknowns.physical(theta))
    members, free_residual, weights = free_prior_rows(unknowns.free_prior, theta)
    free_rows = np.zeros((len(members), len(theta)))
    free_rows[np.arange(len(members)), members] = weights
    jacobian = np.concatenate([change, rows * unknowns.slope(theta), free_rows])
    return Linearization(np.concatenate([data, residual, free_residual]), jacobian, n_eliminated)


def sparse_prior_rows(unknowns: NamedUnknowns, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
    """Residual (n_priors,) of all priors and its derivative with respect to the free variables, sparse (n_priors, n_params)."""
    residual, rows = unknowns.sparse_prior_rows(unknowns.physical(theta))
    members, free_residual, weights = free_prior_rows(unknowns.free_prior, theta)
    free_rows = sparse.csr_array((weights, (np.arange(len(members)), members)), (len(members), len(theta)))
    scaled = rows @ sparse.diags_array(unknowns.slope(theta))
    return np.concatenate([residual, free_residual]), sparse.csr_array(sparse.vstack([scaled, free_rows]))
