"""Tests that a residual is larger than its noise explains."""

from __future__ import annotations

from scipy import special

from structid.core.arrays import FloatArray
from structid.inversion.covariance import row_law
from structid.inversion.diagnostics.residual_tests import has_order
from structid.inversion.problem import Problem


def misses_noise(
    problem: Problem, residual: FloatArray, scale: float, freedom: float, probability: float, more: float = 0.0
) -> bool:
    """True if noise alone would leave a chi-square above that of `residual` with less than this `probability`.

    `more` is added to the sum of squares. What few averages leave more than known noise would is no misfit, but where it has an
    order that noise has not. Without degrees of freedom
    data are missed where they are as far off as the truth itself seldom is.
    """
    data, (_, share) = residual[: problem.n_data], row_law(problem.rows.averages)
    chi_square, of_known = float(data @ data) + more, freedom / share
    if freedom <= 0:
        return is_misfit(chi_square / scale, max(len(data), 1), probability)
    if is_misfit(chi_square / scale, freedom, probability):
        return True
    return share < 1 and is_misfit(chi_square, of_known, probability) and has_order(problem, residual, of_known)


def is_misfit(chi_square: float, freedom: float, probability: float) -> bool:
    """True where a larger chi-square has less than this probability."""
    return bool(special.gammaincc(freedom / 2, chi_square / 2) < probability)
