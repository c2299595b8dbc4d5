"""Strengths of regularization of an ill-posed problem: from marginal likelihood, L-curve or discrepancy, and sparsity.

All of it works on a `LocalModel`: residuals of the data and of unit-strength penalties as linear functions of the free
variables. A nonlinear problem is fitted and linearized again until its strengths settle (`settled`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.inversion.covariance import inverse_information
from structid.inversion.linearization import Linearization

StrengthRule = Literal["marginal_likelihood", "l_curve", "discrepancy"]
#: Range of strengths that is searched, as parts of what makes data and penalty equally informative.
_LOWEST, _HIGHEST = 1e-8, 1e8
#: Strength that stands for a row held completely: higher, and rounding hides what the data say of it.
_HELD = 1e6
_CHANGED = 1e-3
_LARGEST_FACTOR = 10.0


@dataclass(frozen=True, eq=False)
class LocalModel:
    """A least-squares problem near one point, with penalties that have no strength yet.

    Parameters
    ----------
    data : Linearization
        Whitened residual of the data, and of what is known of fixed strength, with its derivative.
    penalties : tuple of Linearization
        The same of every penalty at strength 1.
    """

    data: Linearization
    penalties: tuple[Linearization, ...]

    @property
    def n_params(self) -> int:
        return self.data.jacobian.shape[1]

    @cached_property
    def _data_triangle(self) -> tuple[FloatArray, FloatArray, float]:
        """Triangle R and product Q'r of the QR factorization of the data, and the sum of squares of their fit alone.

        R is (n, n_params) and Q'r (n,) with n = min(n_data, n_params); rows of penalties are not included.
        """
        orthogonal, triangle = np.linalg.qr(self.data.jacobian)
        projected = orthogonal.T @ self.data.residual
        rest = float(self.data.residual @ self.data.residual - projected @ projected)
        return triangle, projected, max(rest, 0.0)

    @cached_property
    def ranks(self) -> tuple[int, ...]:
        """Rank of the rows of every penalty: how many combinations of parameters it acts on."""
        return tuple(int(np.linalg.matrix_rank(p.jacobian)) if p.jacobian.size else 0 for p in self.penalties)

    def balance(self, index: int) -> float:
        """Strength at which penalty number `index` (from 0) and the data have information of equal trace.

        It counts the parameters with an entry in the rows of the penalty. 1 for a penalty without entries.
        """
        jacobian = self.penalties[index].jacobian
        used = (jacobian != 0).any(axis=0)
        information = float((jacobian**2).sum())
        return float((self._data_triangle[0][:, used] ** 2).sum()) / information if information > 0 else 1.0

    def solved(self, strengths: tuple[FloatArray | float, ...]) -> LocalFit:
        """Least-squares fit of the linear model with the square of each penalty row multiplied by a strength.

        `strengths` has an entry for each penalty: a number, or an array with one for each row. In undetermined
        directions the step is the shortest for columns scaled to unit norm, not in the variables themselves.
        """
        triangle, projected, rest = self._data_triangle
        roots = [np.sqrt(np.broadcast_to(s, p.residual.shape)) for s, p in zip(strengths, self.penalties, strict=True)]
        rows = np.concatenate(
            [triangle, *(p.jacobian * root[:, None] for p, root in zip(self.penalties, roots, strict=True))]
        )
        right = np.concatenate([projected, *(p.residual * root for p, root in zip(self.penalties, roots, strict=True))])
        size = np.linalg.norm(rows, axis=0)
        safe = np.where(size > 0, size, 1.0)
        step = -np.linalg.lstsq(rows / safe, right, rcond=None)[0] / safe
        data = triangle @ step + projected
        penalties = tuple(p.residual + p.jacobian @ step for p in self.penalties)
        return LocalFit(step, rest + float(data @ data), penalties, rows)


@dataclass(frozen=True, eq=False)
class LocalFit:
    """The answer of a `LocalModel` at given strengths.

    Attributes
    ----------
    step : (n_params,) float array
        From the point of the model.
    data_cost : float
        Sum of squares of the data rows.
    penalties : tuple of float arrays
        Residual of every penalty at strength 1.
    rows : (n, n_params) float array
        Whitened rows whose information is the posterior's.
    """

    step: FloatArray
    data_cost: float
    penalties: tuple[FloatArray, ...]
    rows: FloatArray

    @cached_property
    def covariance(self) -> FloatArray:
        """Posterior covariance (n_params, n_params) of the free variables; NaN where no data or penalty sees them."""
        return inverse_information(self.rows)


def log_evidence(model: LocalModel, strengths: tuple[float, ...]) -> float:
    """Logarithm of the marginal likelihood of the data, with the penalties as Gaussian priors.

    `strengths` has one strength for each penalty of the model. The logarithm is -1/2 [n log 2 pi + |r|^2 + sum_k l_k
    |x_k|^2 - log pdet(P) + log det(J'J + P)] with P the information of all penalties, l_k the strengths and x_k the
    penalty rows. A constant from directions without a prior is left out.

    References
    ----------
    MacKay (1992), Neural Computation 4, 415, Eq. (2.5).
    """
    fit = model.solved(strengths)
    known = [p.jacobian * np.sqrt(s) for p, s in zip(model.penalties, strengths, strict=True)]
    cost = fit.data_cost + sum(s * float(x @ x) for s, x in zip(strengths, fit.penalties, strict=True))
    prior = np.linalg.svd(np.concatenate(known), compute_uv=False)
    prior = prior[prior > 1e-12 * prior.max(initial=0.0)]
    posterior = np.linalg.svd(fit.rows, compute_uv=False)
    determinants = 2 * float(np.log(prior).sum() - np.log(posterior).sum())
    return -0.5 * (len(model.data.residual) * float(np.log(2 * np.pi)) + cost - determinants)


def marginal_likelihood_strengths(model: LocalModel, start: tuple[float, ...] | None = None) -> tuple[float, ...]:
    """Penalty strengths of largest marginal likelihood, by the fixed point of MacKay.

    The strength of a penalty is g_k / |x_k|^2, with g_k = rank_k - l_k tr(C L_k'L_k) the number of combinations that
    the data determine in spite of it, L_k and x_k its rows and residual, and l_k its strength before. Strengths stay
    within 1e-8 and 1e8 times those of `LocalModel.balance`, which are also the default of `start`. At most 500 rounds
    are made, until none changes by 1e-6.

    References
    ----------
    MacKay (1992), Neural Computation 4, 415, Eq. (4.8).
    """
    balance = np.array([model.balance(k) for k in range(len(model.penalties))])
    low, high = _LOWEST * balance, _HIGHEST * balance
    strengths = np.clip(balance if start is None else np.array(start), low, high)
    for _ in range(500):
        fit = model.solved(tuple(strengths))
        before = strengths
        made = []
        for k, (penalty, x) in enumerate(zip(model.penalties, fit.penalties, strict=True)):
            held = strengths[k] * float(((penalty.jacobian @ fit.covariance) * penalty.jacobian).sum())
            determined = max(model.ranks[k] - held, 0.0)
            cost = float(x @ x)
            made.append(determined / cost if cost > determined / high[k] else high[k])
        strengths = np.clip(made, low, high)
        if np.abs(np.log(strengths / before)).max(initial=0.0) < 1e-6:
            break
    return tuple(float(s) for s in strengths)


def discrepancy_strength(model: LocalModel, n_data: int) -> float:
    """Largest strength of the single penalty of `model` at which the data residual is no larger than the noise allows.

    The limit is |r|^2 = n_data + sqrt(2 n_data), one standard deviation above the mean for noise alone. Strengths are
    searched within 1e-8 and 1e8 times `LocalModel.balance`: the lowest if none meets the limit, the highest if all do.
    `n_data` is the number of whitened data rows.

    Raises
    ------
    InputError
        If there is not exactly one penalty.

    References
    ----------
    Morozov (1966), Soviet Math. Dokl. 7, 414.
    """
    low, high = np.log(_ends(model))
    target = n_data + np.sqrt(2 * n_data)

    def excess(log_strength: float) -> float:
        return model.solved((float(np.exp(log_strength)),)).data_cost - target

    if excess(low) >= 0:
        return float(np.exp(low))
    if excess(high) <= 0:
        return float(np.exp(high))
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if excess(middle) > 0 else (middle, high)
    return float(np.exp(0.5 * (low + high)))


def l_curve_strength(model: LocalModel) -> float:
    """Strength of the single penalty at the corner of the L-curve, its point of largest curvature.

    The curve is the logarithm of the squared penalty over that of the squared data residual. Taken from 241 strengths,
    even in logarithm, from 1e-8 to 1e8 times `LocalModel.balance`, without two at each end.

    Raises
    ------
    InputError
        If there is not exactly one penalty.

    References
    ----------
    Hansen and O'Leary (1993), SIAM J. Sci. Comput. 14, 1487, Eq. (4.7).
    """
    low, high = np.log(_ends(model))
    grid = np.linspace(low, high, 241)
    fits = [model.solved((float(s),)) for s in np.exp(grid)]
    tiny = np.finfo(float).tiny
    rho = np.log([max(f.data_cost, tiny) for f in fits])
    eta = np.log([max(float(f.penalties[0] @ f.penalties[0]), tiny) for f in fits])
    d_rho, d_eta = np.gradient(rho, grid), np.gradient(eta, grid)
    curvature = d_rho * np.gradient(d_eta, grid) - d_eta * np.gradient(d_rho, grid)
    speed = d_rho**2 + d_eta**2
    turning = np.where(speed > 1e-8 * speed.max(), curvature / np.maximum(speed, tiny) ** 1.5, -np.inf)
    return float(np.exp(grid[2:-2][int(np.argmax(turning[2:-2]))]))


def _ends(model: LocalModel) -> FloatArray:
    """Lowest and highest strength that is searched, (2,); `InputError` unless `model` has one penalty."""
    if len(model.penalties) != 1:
        raise InputError(
            f"L-curve and discrepancy choose the strength of one penalty, got {len(model.penalties)};"
            " use marginal likelihood, or give the strengths of the others"
        )
    return model.balance(0) * np.array([_LOWEST, _HIGHEST])


def sparse_strengths(model: LocalModel, index: int, strengths: tuple[FloatArray | float, ...]) -> FloatArray:
    """Strength for each row of penalty `index`, (n_rows,), of largest marginal likelihood; it makes few rows nonzero.

    Row by row, with mean m and variance v of the row without its penalty, 1 / l = m^2 - v where that is positive;
    otherwise l is 1e6 times the balance of data and penalty. Rows must be linearly independent. `strengths` are those
    of all penalties at the start; all but that at `index` stay. An entry is a number or an array with one for each row.

    References
    ----------
    Tipping and Faul (2003), Proc. 9th Int. Workshop on Artificial Intelligence and Statistics, Eq. (20).
    """
    rows = model.penalties[index].jacobian
    largest = _HELD * model.balance(index)
    current = np.array(np.broadcast_to(strengths[index], len(rows)), dtype=float)
    for _ in range(200):
        before = current.copy()
        fit = model.solved((*strengths[:index], current, *strengths[index + 1 :]))
        covariance, rest = np.array(fit.covariance), np.array(fit.penalties[index])
        for i, row in enumerate(rows):
            across = covariance @ row
            variance = float(row @ across)
            chosen = _row_strength(variance, float(rest[i]), current[i], largest)
            gain = (chosen - current[i]) / (1 + (chosen - current[i]) * variance)
            rest = rest - gain * rest[i] * (rows @ across)
            covariance -= gain * np.outer(across, across)
            current[i] = chosen
        if np.abs(np.log(current / before)).max(initial=0.0) < 1e-6:
            break
    return current


def _row_strength(variance: float, residual: float, strength: float, largest: float) -> float:
    """Strength of largest marginal likelihood for one penalty row, from its fit at the present `strength`.

    `variance` is the posterior variance of the row and `residual` its value, both at the present strength; `largest` is the
    strength that makes the row zero, and the result where the data do not ask for another value.
    """
    others = 1 / variance - strength  # information from everything else
    if not others > 1e-12 * strength:
        return largest
    mean = residual / (variance * others)
    spread = mean**2 - 1 / others
    return min(1 / spread, largest) if spread > 0 else largest


def absolute_strengths(
    model: LocalModel, index: int, strengths: tuple[FloatArray | float, ...], strength: float, smoothing: float
) -> FloatArray:
    """Strength for each row of penalty `index`, (n_rows,), that turns its sum of squares into a sum of magnitudes.

    By iteratively reweighted least squares: `strength` / sqrt(x^2 + `smoothing`^2) for a row x. `strengths` are those
    of all penalties; that at `index` is not used, all others stay. An entry is a number or an array with one for each
    row.

    References
    ----------
    Daubechies, DeVore, Fornasier and Gunturk (2010), Comm. Pure Appl. Math. 63, 1, Eq. (1.6).
    """
    current = strength / np.sqrt(model.penalties[index].residual ** 2 + smoothing**2)
    for _ in range(500):
        x = model.solved((*strengths[:index], current, *strengths[index + 1 :])).penalties[index]
        before, current = current, strength / np.sqrt(x**2 + smoothing**2)
        if np.abs(np.log(current / before)).max(initial=0.0) < 1e-6:
            break
    return current


Strengths = tuple[FloatArray | float, ...]


@dataclass(frozen=True, eq=False)
class SettledFit:
    """Strengths at which a nonlinear problem and their choice agree.

    Attributes
    ----------
    theta : (n_params,) float array
        Free variables of the last fit.
    strengths : tuple
        One a penalty; an array where it has one a row.
    model : LocalModel
        At `theta`.
    converged : bool
        Whether no strength moved by more than a thousandth in the last round.
    rounds : int
    """

    theta: FloatArray
    strengths: Strengths
    model: LocalModel
    converged: bool
    rounds: int


def settled(
    refit: Callable[[Strengths, FloatArray], FloatArray],
    linearized: Callable[[FloatArray], LocalModel],
    choose: Callable[[LocalModel, Strengths], Strengths],
    theta: FloatArray,
    strengths: Strengths,
    max_rounds: int = 40,
) -> SettledFit:
    """Fit with penalty strengths chosen from the data, by alternate fits and choices until the strengths settle.

    They settle when none changes by 0.1 %. A single strength changes at most by a factor of ten in a round, an array
    with one for each row freely. The result is marked as not settled after `max_rounds` without that.

    Parameters
    ----------
    refit : callable
        Minimizer of the whole problem at given strengths, from given free variables.
    linearized : callable
        The `LocalModel` at free variables.
    choose : callable
        Strengths for a model, given those before.
    theta : (n_params,) float array
        Where the first fit starts.
    strengths : tuple
        Of the first fit: one entry for each penalty.
    max_rounds : int
        Most rounds of one choice and one fit.
    """
    theta = refit(strengths, theta)
    model = linearized(theta)
    for count in range(1, max_rounds + 1):
        chosen = tuple(_limit_change(new, old) for new, old in zip(choose(model, strengths), strengths, strict=True))
        ratios = [np.log(np.asarray(new) / np.asarray(old)) for new, old in zip(chosen, strengths, strict=True)]
        strengths = chosen
        theta = refit(strengths, theta)
        model = linearized(theta)
        if all(np.abs(ratio).max(initial=0.0) < _CHANGED for ratio in ratios):
            return SettledFit(theta, strengths, model, True, count)
    return SettledFit(theta, strengths, model, False, max_rounds)


def _limit_change(new: FloatArray | float, old: FloatArray | float) -> FloatArray | float:
    """`new`, a single strength, moved to within a factor of ten of `old`, so that the next fit begins near its answer.

    Arrays of strengths are returned as they are.
    """
    if np.ndim(new) or np.ndim(old):
        return new
    return float(np.clip(new, float(old) / _LARGEST_FACTOR, float(old) * _LARGEST_FACTOR))


def prior_share(jacobian: FloatArray, n_data: int) -> FloatArray:
    """Share of each parameter's variance that comes from priors instead of data, (n_params,), 0 to 1; NaN if undetermined.

    With information A of the data, B of the priors and C = (A + B)^-1, C = C A C + C B C, the share is (C B C)_ii /
    C_ii. For a single parameter it is b / (a + b).

    Parameters
    ----------
    jacobian : (n_residuals, n_params) float array
        Whitened, data rows first.
    n_data : int
        Number of data rows; the rest are priors.
    """
    covariance = inverse_information(jacobian)
    prior = jacobian[n_data:]
    seen = np.isfinite(np.diag(covariance))
    inner = covariance[np.ix_(seen, seen)]
    share = np.full(len(covariance), np.nan)
    share[seen] = ((prior[:, seen] @ inner) ** 2).sum(axis=0) / np.diag(inner)
    return share
