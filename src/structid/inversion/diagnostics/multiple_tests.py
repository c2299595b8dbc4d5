"""Many tests at once: corrected p-values, and what a test of one among many can see.

References
----------
Holm (1979), Scand. J. Statist. 6, 65; Benjamini and Hochberg (1995), J. R. Statist. Soc. B 57, 289.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.errors import InputError

Correction = Literal["holm", "benjamini_hochberg"]


def require_levels(level: float, power: float, correction: str) -> None:
    """Raise `InputError` unless 0 < level < 0.5, 0.5 <= power < 1 and `correction` is a known one.

    Known are "holm" and "benjamini_hochberg".
    """
    if not 0 < level < 0.5:
        raise InputError(f"`level` must lie between 0 and 0.5, got {level:g}; 0.05 is usual")
    if not 0.5 <= power < 1:
        raise InputError(f"`power` must be at least 0.5 and below 1, got {power:g}; 0.9 is usual")
    if correction not in ("holm", "benjamini_hochberg"):
        raise InputError(f"`correction` must be 'holm' or 'benjamini_hochberg', got {correction!r}; use one of them")


def adjusted_p_values(p_values: FloatArray, correction: Correction = "holm") -> FloatArray:
    """p-values (n,) corrected for the number of tests by Holm or Benjamini-Hochberg; NaN entries stay NaN.

    With p_(1) <= ... <= p_(n): Holm max over j <= i of (n - j + 1) p_(j), Benjamini-Hochberg min over j >= i of
    n p_(j) / j, at most 1.

    Examples
    --------
    >>> adjusted_p_values(np.array([0.01, 0.04, 0.03])).tolist()
    [0.03, 0.06, 0.06]
    """
    tested = np.flatnonzero(np.isfinite(p_values))
    n = len(tested)
    order = tested[np.argsort(p_values[tested], kind="stable")]
    ranked = p_values[order]
    if correction == "holm":
        made = np.maximum.accumulate((n - np.arange(n)) * ranked)
    else:
        made = np.minimum.accumulate((n / np.arange(1, n + 1) * ranked)[::-1])[::-1]
    adjusted = np.full(len(p_values), np.nan)
    adjusted[order] = np.minimum(made, 1.0)
    return adjusted


def detectable(n_tests: int, level: float, power: float) -> float:
    """Smallest single change, in standard deviations, that is declared with probability `power` among `n_tests` tests.

    It is z(1 - level / (2 n_tests)) + z(power), since both corrections declare the smallest p-value where it is at most
    level / n_tests; a declaration in the wrong direction is left out. NaN if `n_tests` is 0.
    """
    if n_tests == 0:
        return float("nan")
    return float(special.ndtri(1 - level / (2 * n_tests)) + special.ndtri(power))
