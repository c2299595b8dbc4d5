"""Law of whitened errors whose variance was estimated from few averages, and is itself uncertain."""

from __future__ import annotations

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray

#: Averages up to which squares over their estimated variance have no variance, so that nothing is expected of them.
TOO_FEW = 3.0


def expected_square(averages: FloatArray | float) -> FloatArray:
    """Mean square of complex errors over variances estimated from n averages: n / (n - 2), infinite up to two.

    n times the estimate over the variance is half a chi-square of 2 (n - 1) degrees of freedom, independent of the error: the
    square is n / (n - 1) times one of F(2, 2 (n - 1)).

    References
    ----------
    Goodman (1963), Ann. Math. Stat. 34, section 3, for the law of estimated spectra.
    """
    n = np.asarray(averages, dtype=np.float64)
    return np.divide(1.0, 1 - 2 / n, out=np.full(n.shape, np.inf), where=n > 2)


def square_variance(averages: FloatArray) -> FloatArray:
    """Variance (n,) that each of the two real rows of a complex error adds to the sum of squares, by numbers of `averages` (n,).

    It is 2 for infinitely many averages, and finite only above three.
    """
    mean = expected_square(averages)
    return 2 * mean**2 * (2 * (1 - 2 / averages) / (1 - 3 / averages) - 1)


def score_factor(averages: FloatArray) -> FloatArray:
    """Factor n / (n - 3) by which few averages n increase the covariance of weighted sums of errors, for each entry.

    Sums J'r of whitened rows have the covariance E(1/g^2) / E(1/g) J'J for estimates g of a variance of 1. The factor is 1
    for three averages or fewer, where it has no finite value.
    """
    return np.divide(1.0, 1 - 3 / averages, out=np.ones_like(averages), where=averages > TOO_FEW)


def normal_values(values: FloatArray, averages: FloatArray) -> FloatArray:
    """Whitened residual rows transformed from Student's t to standard normal values by equal tail probability.

    `values` are the rows and `averages` the number n of averages from which the variance of each was estimated, both
    (n_rows,). The t distribution has 2 (n - 1) degrees of freedom. Rows with infinitely many averages stay as they are.
    """
    known = np.isinf(averages)
    n = np.where(known, 2.0, averages)
    size = special.stdtr(2 * (n - 1), -np.abs(values) * np.sqrt(1 - 1 / n))
    return np.where(known, values, -np.sign(values) * special.ndtri(np.maximum(size, np.finfo(float).tiny)))


def few_averages(averages: FloatArray | None) -> FloatArray | None:
    """Array `averages` (n_rows,) where the estimated variances matter, else None.

    None if `averages` is None, if all entries are infinite (variances known), or if any entry is 3 or less.
    """
    if averages is None or np.isinf(averages).all() or (averages <= TOO_FEW).any():
        return None
    return averages
