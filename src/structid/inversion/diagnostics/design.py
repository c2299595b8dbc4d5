"""Which of many possible measurements to make: optimal design on information, with no structure in sight.

A candidate is a block of rows of the whitened Jacobian with respect to relative parameters; the information of a set
is the sum of the squares of its blocks, so every law here is one of triangles: nothing is squared, and what is barely
determined stays so to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.inversion.covariance import inverse_information

Criterion = Literal["d", "a"]

#: Relative standard deviation that stands for ignorance when sets that leave parameters undetermined are compared.
IGNORANCE = 10.0
_BLOCK_ENTRIES = 4_000_000
_MOST_PASSES = 20
_SMALLEST_GAIN = 1e-9


def information_root(rows: FloatArray) -> FloatArray:
    """Matrix R with R'R = J'J for each block of rows J: J itself if it has no more rows than columns, else its triangle.

    Shape (..., n_rows, n_params) to (..., min(n_rows, n_params), n_params).
    """
    if rows.shape[-2] <= rows.shape[-1]:
        return rows
    return np.asarray(np.linalg.qr(rows, mode="r"))


def relative_std(rows: FloatArray) -> FloatArray:
    """Relative standard deviation of each parameter by the Cramer-Rao bound, (n_params,); NaN if not determined.

    `rows` (n_rows, n_params) are whitened derivatives by the logarithms of the parameters.
    """
    if not rows.size:
        return np.full(rows.shape[-1], np.nan)
    return np.sqrt(np.diag(inverse_information(rows)))


def ignorance(n_params: int) -> FloatArray:
    """Rows (n_params, n_params) of a prior of relative standard deviation `IGNORANCE` on each parameter.

    It is so weak that it only ranks designs that leave parameters undetermined.
    """
    return np.eye(n_params) / IGNORANCE


def merit(rows: FloatArray, criterion: Criterion = "d", of_interest: np.ndarray | None = None) -> float:
    """Value of the design criterion for a set of rows, larger for a better one: -log det or -trace of the covariance.

    Parameters
    ----------
    rows : (n_rows, n_params) float array
        Whitened derivatives by the parameters, of full column rank.
    criterion : {"d", "a"}
        Determinant or trace.
    of_interest : (n_params,) bool array, optional
        Parameters whose covariance counts; all by default.
    """
    inverse = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    part = inverse if of_interest is None else inverse[np.asarray(of_interest, dtype=bool)]
    if criterion == "a":
        return -float(np.sum(part**2))
    singular = np.linalg.svd(part, compute_uv=False)
    return -2 * float(np.log(singular).sum())


def gains(
    candidates: FloatArray, existing: FloatArray, criterion: Criterion = "d", of_interest: np.ndarray | None = None
) -> FloatArray:
    """Increase of the design criterion by adding each candidate alone to the existing rows, (n_candidates,).

    With C_i the covariance of the parameters of interest by the existing rows, (J'J)^-1 restricted to them, ``d`` is
    the decrease of log det C_i (D-optimality, or Ds-optimality for a part of the parameters) and ``a`` that of trace
    C_i. By the matrix determinant lemma each candidate costs one factorization of the size of its rows.

    Parameters
    ----------
    candidates : (n_candidates, n_rows, n_params) float array
        Whitened derivatives of each candidate's data by the parameters.
    existing : (n_existing, n_params) float array
        Rows that are there already, of full column rank.
    criterion : {"d", "a"}
        Determinant or trace of the covariance.
    of_interest : (n_params,) bool array, optional
        Parameters whose covariance counts; all by default. The others are still unknown.

    References
    ----------
    Fedorov (1972), Theory of Optimal Experiments; Atkinson and Donev (1992), Optimum Experimental Designs.
    """
    n_candidates, n_rows, n_params = candidates.shape
    root = np.asarray(np.linalg.qr(existing, mode="r"))
    inverse = np.linalg.inv(root)
    wanted = np.ones(n_params, dtype=bool) if of_interest is None else np.asarray(of_interest, dtype=bool)
    increases = np.empty(n_candidates)
    step = max(1, _BLOCK_ENTRIES // max(n_rows * max(n_params, n_rows), 1))
    for first in range(0, n_candidates, step):
        part = slice(first, first + step)
        reached = candidates[part] @ inverse
        increases[part] = _gains(reached, inverse[wanted], criterion, bool(wanted.all()))
    return increases


def _gains(reached: FloatArray, inverse: FloatArray, criterion: Criterion, is_all: bool) -> FloatArray:
    """Gain (n_candidates,) of the design criterion by each candidate's rows G, with R the triangle of the known rows.

    `reached` is G R^-1, (n_candidates, n_rows, n_params); `inverse` (n_of_interest, n_params) holds the rows of R^-1 of
    the parameters of interest, which are all parameters with `is_all`.
    """
    grown = np.eye(reached.shape[1]) + reached @ np.swapaxes(reached, 1, 2)
    if criterion == "a":
        seen = reached @ inverse.T
        return np.trace(np.linalg.solve(grown, seen @ np.swapaxes(seen, 1, 2)), axis1=1, axis2=2)
    total = np.linalg.slogdet(grown)[1]
    if is_all:
        return total
    basis = np.linalg.qr(inverse.T)[0]
    others = reached - (reached @ basis) @ basis.T
    return total - np.linalg.slogdet(np.eye(reached.shape[1]) + others @ np.swapaxes(others, 1, 2))[1]


def greedy(
    candidates: FloatArray,
    existing: FloatArray,
    count: int,
    criterion: Criterion = "d",
    of_interest: np.ndarray | None = None,
    enough: Callable[[tuple[int, ...]], bool] | None = None,
) -> tuple[int, ...]:
    """Indices (from 0) of candidates in the order of choice, one by one for the largest gain of the design criterion.

    Each choice counts those before it as measured. At most `count` are chosen; of equal gains the first.

    Parameters
    ----------
    candidates : (n_candidates, n_rows, n_params) float array
        Whitened derivatives of each candidate's data by the parameters.
    existing : (n_existing, n_params) float array
        Rows that are there already, of full column rank.
    count : int
    criterion : {"d", "a"}
        Determinant or trace of the covariance; see `gains`.
    of_interest : (n_params,) bool array, optional
        Parameters whose covariance counts; all by default.
    enough : callable, optional
        Is given the indices chosen so far; the choice ends where it returns True.

    Raises
    ------
    InputError
        If there are fewer candidates than `count`.
    """
    _require_count(count, len(candidates))
    chosen: list[int] = []
    root = np.asarray(np.linalg.qr(existing, mode="r"))
    while len(chosen) < count and not (enough is not None and enough(tuple(chosen))):
        gain = gains(candidates, root, criterion, of_interest)
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        root = information_root(np.vstack([root, candidates[chosen[-1]]]))
    return tuple(chosen)


def exchanged(
    candidates: FloatArray,
    existing: FloatArray,
    chosen: Sequence[int],
    criterion: Criterion = "d",
    of_interest: np.ndarray | None = None,
) -> tuple[int, ...]:
    """Indices of chosen candidates after single exchanges that improve the design criterion (Fedorov's algorithm).

    In each pass every member is replaced by the candidate of largest gain, if this exceeds its own gain by more than
    1e-9, or 1e-9 of that if it is above 1. It ends after a pass without exchange, or after 20 passes.

    Parameters
    ----------
    candidates : (n_candidates, n_rows, n_params) float array
        Whitened derivatives of each candidate's data by the parameters.
    existing : (n_existing, n_params) float array
        Rows that are there already, of full column rank.
    chosen : sequence of int
        Indices to start from; the result keeps their order.
    criterion : {"d", "a"}
        Determinant or trace of the covariance.
    of_interest : (n_params,) bool array, optional
        Parameters whose covariance counts; all by default.
    """
    members = list(chosen)
    for _ in range(_MOST_PASSES):
        changed = False
        for position, member in enumerate(members):
            rest = members[:position] + members[position + 1 :]
            gain = gains(candidates, np.vstack([existing, *candidates[rest]]), criterion, of_interest)
            present = gain[member]
            gain[rest] = -np.inf
            best = int(np.argmax(gain))
            if gain[best] > present + _SMALLEST_GAIN * max(1.0, abs(present)):
                members[position], changed = best, True
        if not changed:
            break
    return tuple(members)


def optimal(
    candidates: FloatArray,
    existing: FloatArray,
    count: int,
    criterion: Criterion = "d",
    of_interest: np.ndarray | None = None,
) -> tuple[int, ...]:
    """Indices of the best `count` candidates by greedy choice and exchange, in the order of greedy choice among them.

    `candidates` are (n_candidates, n_rows, n_params), the rows `existing` (n_existing, n_params) are measured already;
    `criterion` is the determinant ("d") or trace ("a") of the covariance of the parameters `of_interest`, a mask
    (n_params,), None for all.

    Raises
    ------
    InputError
        If there are fewer candidates than `count`.
    """
    first = greedy(candidates, existing, count, criterion, of_interest)
    members = exchanged(candidates, existing, first, criterion, of_interest)
    order = greedy(candidates[list(members)], existing, count, criterion, of_interest)
    return tuple(members[i] for i in order)


def effective_independence(shapes: FloatArray, count: int) -> tuple[int, ...]:
    """Ascending indices of `count` sensor places that keep mode shapes (n_places, n_modes) linearly independent.

    Of all places the one of least effective independence is left out, again and again, until `count` remain. The
    effective independence of place i is row i of Phi times (Phi'Phi)^-1 times the same row, with the shapes Phi at the
    places that are left: the part of the rank of Phi that would go with it.

    Parameters
    ----------
    shapes : (n_places, n_modes) float array
        Mode shapes at the candidate places.
    count : int
        How many places stay; at least as many as there are modes.

    Raises
    ------
    InputError
        If `count` is less than the number of modes or more than that of places.

    References
    ----------
    Kammer (1991), J. Guidance, Control, and Dynamics 14, 251-259.
    """
    n_places, n_modes = shapes.shape
    _require_count(count, n_places)
    if count < n_modes:
        raise InputError(f"`count` must be at least the number of modes, got {count} for {n_modes}; take fewer modes")
    kept = np.arange(n_places)
    while len(kept) > count:
        left, singular, _ = np.linalg.svd(shapes[kept], full_matrices=False)
        sound = singular > 1e-12 * singular.max(initial=0.0)
        kept = np.delete(kept, int(np.argmin(np.sum(left[:, sound] ** 2, axis=1))))
    return tuple(int(i) for i in kept)


def _require_count(count: int, n_candidates: int) -> None:
    if not 0 <= count <= n_candidates:
        raise InputError(f"`count` must be from 0 to the number of candidates, {n_candidates}, got {count}")
