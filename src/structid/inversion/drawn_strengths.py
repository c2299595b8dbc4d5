"""Strengths of smoothness for very many parameters, by marginal likelihood with traces from posterior draws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.linearization import OperatorLinearization
from structid.inversion.posterior_draws import posterior_draws
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import Progress, minimize
from structid.inversion.search.matrix_free import MatrixFree
from structid.inversion.search.work import Minimizer

#: Largest factor by which a strength changes from one fit to the next, and how far the first may move in all.
_LARGEST_FACTOR, _FARTHEST = 30.0, 1e8
_DRAWS, _MOST_ROUNDS = 8, 15
#: A fit on the way to the strengths; the last one is exact.
_LOOSE = MatrixFree(max_iterations=15, gain_tolerance=1e-4, inner_tolerance=1e-4)


@dataclass(frozen=True, eq=False)
class Differences:
    """Rows at strength 1 that hold differences of parameters, or of their logarithms, to 0.

    Attributes
    ----------
    matrix : (n_rows, n_params) sparse array
        Of the parameters or of their logarithms.
    residual : callable
        The rows for physical values, (n_params,) to (n_rows,).
    jacobian : callable
        Their derivative with respect to physical values, (n_params,) to sparse (n_rows, n_params).
    """

    matrix: sparse.csr_array
    residual: Callable[[FloatArray], FloatArray]
    jacobian: Callable[[FloatArray], sparse.csr_array]

    @property
    def members(self) -> IntArray:
        """Indices (n_members,) of the parameters that take part, rising."""
        return np.unique(self.matrix.indices)

    @property
    def nullity(self) -> int:
        """Number of combinations of the members that no row restrains: one mean for each connected group of members."""
        members = self.members
        graph = abs(self.matrix[:, members])
        return int(connected_components(graph.T @ graph, directed=False, return_labels=False))


@dataclass(frozen=True, eq=False)
class SettledStrengths:
    """Strengths that the data choose.

    Attributes
    ----------
    strengths : tuple of float
    determined : tuple of float
        How many combinations of parameters the data determine in spite of each penalty, besides those it leaves free.
    theta : (n_params,) float array
        Where the last fit ended.
    converged : bool
    """

    strengths: tuple[float, ...]
    determined: tuple[float, ...]
    theta: FloatArray
    converged: bool


def settled_strengths(
    make_problem: Callable[[Sequence[float]], Problem],
    terms: Sequence[Differences],
    given: Sequence[float | None],
    strengths: tuple[float, ...],
    theta: FloatArray,
    seed: int = 0,
    progress: Progress | None = None,
    search: Minimizer = minimize,
) -> SettledStrengths:
    """Penalty strengths chosen by the data, by fits for very many parameters repeated until each strength settles.

    The strength of penalty k is g_k / |x_k|^2 with x_k its rows at strength 1 and g_k = tr_k(C H) - nullity, where C is
    the posterior covariance of the free variables, H the information of all but these penalties, and the trace runs
    over the members of penalty k. It is estimated by draws s of covariance C, as the mean of s_k (H s)_k. At most 15
    fits are made, each with at most 15 iterations. A strength has settled when it changes by less than it is known to,
    a factor of exp(0.1) or more. The result is marked as not settled if that is not reached, or if no draw converges.

    Parameters
    ----------
    make_problem : callable
        Makes the problem from the strengths of all penalties.
    terms : sequence of Differences
        No two of which share members.
    given : sequence of float or None
        Strengths that are known; None for those that the data choose.
    strengths : tuple of float
        Of the first fit, such as `balanced_strengths` gives.
    theta : (n_params,) float array
        Where the first fit begins.
    seed : int
        Of the draws, the same in every round.
    progress : callable, optional
        Called with the iteration, all rounds together, and the sum of squares.
    search : Minimizer
        Runs the fits, one after another, and may store them.

    Raises
    ------
    InputError
        If two penalties hold the same parameter.

    References
    ----------
    MacKay (1992), Neural Computation 4, 415, Eq. (4.8). Papandreou and Yuille (2011), Efficient variational inference
    in large-scale Bayesian compressed sensing, section 3, for the trace.
    """
    everyone = np.concatenate([term.members for term in terms])
    if len(np.unique(everyone)) < len(everyone):
        raise InputError("`terms` must hold different parameters each, got one held twice; give one smoothness for it")
    begun = strengths
    determined = (float("nan"),) * len(terms)
    done = 0
    for _ in range(_MOST_ROUNDS):
        problem = make_problem(strengths)
        minimum = search(problem, _LOOSE, theta, None if progress is None else partial(_later, progress, done))
        theta, done = minimum.theta, done + len(minimum.inner)
        linearization = cast(OperatorLinearization, minimum.linearization)
        determined = _determined(problem, linearization, theta, terms, strengths, seed)
        if not np.isfinite(determined).all():
            return SettledStrengths(strengths, determined, theta, False)
        physical, before = problem.physical(theta), strengths
        strengths = tuple(
            s if known is not None else _new_strength(term, physical, g, s, b)
            for term, known, g, s, b in zip(terms, given, determined, strengths, begun, strict=True)
        )
        known_to = [max(0.1, np.sqrt(2 / max(g, 1.0))) for g in determined]
        if all(abs(np.log(s / b)) <= d for s, b, d in zip(strengths, before, known_to, strict=True)):
            return SettledStrengths(strengths, determined, theta, True)
    return SettledStrengths(strengths, determined, theta, False)


def _later(progress: Progress, done: int, iteration: int, cost: float) -> None:
    """Report to `progress` an iteration, counted on from the `done` ones of earlier fits, and its sum of squares."""
    progress(done + iteration, cost)


def balanced_strengths(
    problem: Problem, theta: FloatArray, terms: Sequence[Differences], given: Sequence[float | None]
) -> tuple[float, ...]:
    """Penalty strengths, one for each of `terms`, at which penalty and data have information of equal trace.

    The trace runs over the members of the penalty; information is that on the free variables `theta` (n_params,).
    Entries of `given` that are not None are known strengths and stay. Unless all are known, 0 becomes the least
    positive float.
    """
    if all(value is not None for value in given):
        return tuple(float(value) for value in given if value is not None)
    linearization, slope, physical = problem.linearize_operator(theta), problem.slope(theta), problem.physical(theta)
    made = []
    for term, value in zip(terms, given, strict=True):
        rows = term.jacobian(physical) @ sparse.diags_array(slope)
        information = float(rows.multiply(rows).sum())
        made.append(float(linearization.data_squares[term.members].sum()) / information if value is None else value)
    return tuple(max(value, np.finfo(float).tiny) for value in made)


def _new_strength(term: Differences, physical: FloatArray, determined: float, strength: float, begun: float) -> float:
    """New strength of the penalty `term`: number of determined combinations over the squared residual at strength 1.

    `physical` (n_params,) are the values and `determined` that number; without a positive quotient the strength rises
    as far as allowed. It changes at most by a factor of 30 from `strength`, the present value, and of 1e8 from `begun`,
    the first.
    """
    rows = term.residual(physical)
    cost = float(rows @ rows)
    wanted = determined / cost if determined > 0 and cost > 0 else np.inf
    limited = np.clip(wanted, strength / _LARGEST_FACTOR, strength * _LARGEST_FACTOR)
    return float(np.clip(limited, begun / _FARTHEST, begun * _FARTHEST))


def _determined(
    problem: Problem,
    linearization: OperatorLinearization,
    theta: FloatArray,
    terms: Sequence[Differences],
    strengths: Sequence[float],
    seed: int,
) -> tuple[float, ...]:
    """Numbers of parameter combinations that the data determine, one for each penalty, by eight posterior draws.

    `terms` are the penalties, `strengths` their present ones. NaN if no draw converges. `theta` (n_params,) are the
    free variables at which `linearization` was made; `seed` fixes the draws.
    """
    slope, physical = problem.slope(theta), problem.physical(theta)
    draws, _ = posterior_draws(linearization, _DRAWS, np.random.default_rng(seed))
    rows = [term.jacobian(physical) @ sparse.diags_array(slope) for term in terms]
    sums: FloatArray = np.zeros(len(terms))
    sound = draws[np.isfinite(draws).all(axis=1)]
    for draw in sound:
        rest = linearization.information(draw)
        for part, strength in zip(rows, strengths, strict=True):
            rest = rest - strength * (part.T @ (part @ draw))
        sums = sums + np.array([float(draw[term.members] @ rest[term.members]) for term in terms])
    means = sums / len(sound) if len(sound) else np.full(len(terms), np.nan)
    return tuple(float(mean) - term.nullity for mean, term in zip(means, terms, strict=True))
