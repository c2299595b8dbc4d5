"""Test that quantities which several records repeat, such as the k-th mode, agree on the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.inversion.covariance import repeated_quantities
from structid.inversion.linearization import Linearization
from structid.inversion.problem import Problem

_NULL = 1e-10


@dataclass(frozen=True)
class Agreement:
    """The test that each quantity alone, in all records, gives the same parameters.

    Attributes
    ----------
    ratio : float
        Mean square of what parameters of each quantity's own would take from the residual, over that of what they would leave.
    between, within : float
        Degrees of freedom of the two.
    probability : float
        Of a larger ratio where model and data are right, whatever the size of the noise.
    """

    ratio: float
    between: float
    within: float
    probability: float

    @property
    def words(self) -> str:
        """Meaning of a small probability, in a sentence."""
        return (
            f"each mode, common to all records, gives other values than the other modes do (F = {self.ratio:.2g},"
            f" {self.between:.0f} and {self.within:.0f} degrees of freedom, p = {self.probability:.1g}): model error that is"
            " common to all records"
        )


def agreement(problem: Problem, linearization: Linearization) -> Agreement | None:
    """F test that quantities measured in several records agree on the parameters; None if it cannot be made.

    With S the sum of squares of a common fit to all quantities and S_q that of a separate fit to quantity q, to first order and
    without priors, (S - sum S_q) / between over (sum S_q) / within follows Fisher's distribution for independent errors. The
    common size of the errors may be unknown. None if `repeated_quantities` is None, or no degree of freedom is left.

    References
    ----------
    Chow (1960), Econometrica 28, 591-605, section 3; Fisher (1970), Econometrica 38, 361-366.
    """
    block = repeated_quantities(problem)
    if block is None:
        return None
    residual, jacobian = linearization.residual[: problem.n_data], linearization.jacobian[: problem.n_data]
    rows = [block == number for number in range(int(block.max()) + 1)]
    told = block >= 0
    whole, rank = _residual_squares_and_rank(jacobian[told], residual[told])
    own = [_residual_squares_and_rank(jacobian[q], residual[q]) for q in rows]
    least = sum(square for square, _ in own)
    ranks = sum(count for _, count in own)
    between, within = ranks - rank, int(told.sum()) - ranks - linearization.n_eliminated
    if between <= 0 or within <= 0 or least <= 0:
        return None
    ratio = (whole - least) / between / (least / within)
    return Agreement(ratio, between, within, float(special.fdtrc(between, within, max(ratio, 0.0))))


def _residual_squares_and_rank(jacobian: FloatArray, residual: FloatArray) -> tuple[float, int]:
    """Residual sum of squares of a linear least-squares fit of `jacobian` (n_rows, n_params) to `residual`, and its rank."""
    scale = np.linalg.norm(jacobian, axis=0)
    vectors, singular, _ = np.linalg.svd(jacobian / np.where(scale > 0, scale, 1.0), full_matrices=False)
    used = vectors[:, singular > _NULL * singular.max(initial=0.0)]
    left = residual - used @ (used.T @ residual)
    return float(left @ left), used.shape[1]
