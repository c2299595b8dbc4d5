"""Nonlinear least squares: one loop, the minimum that it ends at, and a method that says how its steps are made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import SingularModelError
from structid.inversion.fixed_values import FixedColumns
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import Problem
from structid.inversion.uncertainty import Uncertainty

Progress = Callable[[int, float], None]
#: Numbers, texts, arrays, and lists or mappings of them by name: what goes to and from checkpoints and other processes.
StoredValues: TypeAlias = Mapping[str, Any]
#: All that a search needs to go on with the same digits, free variables as ``theta``.
State: TypeAlias = StoredValues
_LEAST_DAMPING, _MOST_DAMPING = 1e-20, 1e40
#: A step that keeps less than this part of what the linear model promises is not made.
_ACCEPTED = 1e-4
#: With more damping than this a small promise says nothing.
_MUCH_DAMPING = 1e3
#: Memory that a search with a Jacobian may take; it takes some arrays of the Jacobian's size, and three of n_params squared.
_DENSE_BYTES, _DENSE_COPIES = 2_000_000_000, 4
#: The message of searches that end early, as others are better.
LEFT = "left where other searches are better"
A = TypeVar("A", bound=Linearization | OperatorLinearization)


class SearchStateStore(Protocol):
    """Store in which a search leaves its state after each iteration, and finds one to resume from."""

    @property
    def state(self) -> State | None:
        """State of an earlier run of the same search; None where the search has to begin."""
        ...

    def keep(self, iteration: int, cost: float, state: Callable[[], State]) -> None:
        """Take the state after iteration number `iteration`, which ended with the sum of squares `cost`.

        The store calls `state` if it wants the state, at once or later.
        """
        ...


class StageCourse(NamedTuple):
    """Course of the search of one stage: free variables (n_iterations + 1, n_params), sums of squares beside them, and data."""

    name: str
    history: FloatArray
    costs: FloatArray
    n_data: int

    @property
    def n_rows(self) -> int:
        """Rows of data that its iterations evaluated, all together."""
        return (len(self.costs) - 1) * self.n_data


@dataclass(frozen=True, eq=False)
class Minimum:
    """End point of a search, with its status and history.

    Attributes
    ----------
    theta : (n_params,) float array
    linearization : Linearization or OperatorLinearization
        At `theta`, as the method makes it.
    history : (n_iterations + 1, n_params) float array
        Free variables from the start to the end.
    costs : (n_iterations + 1,) float array
        Sum of squared residuals along the history.
    inner : (n_iterations,) int array
        Conjugate gradient iterations of every step; 0 where it is found at once.
    converged : bool
    message : str
        What ended the search.
    stages : tuple of StageCourse
        The searches of easier problems that led to its start, in order.
    """

    theta: FloatArray
    linearization: Linearization | OperatorLinearization
    history: FloatArray
    costs: FloatArray
    inner: IntArray
    converged: bool
    message: str
    stages: tuple[StageCourse, ...] = ()


def residual_at(problem: Problem, theta: FloatArray) -> FloatArray | None:
    """Residual (n_residuals,) at free variables `theta` (n_params,); None if singular or not finite there."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            residual = problem.residual(theta)
        except (SingularModelError, np.linalg.LinAlgError):
            return None
    return residual if np.isfinite(residual).all() else None


def squared(residual: FloatArray | None) -> float:
    """Sum of squares of `residual` (n,); infinite if it is None."""
    if residual is None:
        return np.inf
    with np.errstate(over="ignore"):
        return float(residual @ residual)


def cost_at(problem: Problem, theta: FloatArray) -> float:
    """Sum of squared residuals at free variables `theta` (n_params,); infinite if the model cannot be evaluated there."""
    return squared(residual_at(problem, theta))


class End(NamedTuple):
    """End of a search: True if it converged, and the reason as a clause."""

    converged: bool
    message: str


class IterationResult(NamedTuple):
    """Result of one iteration.

    `step` is made where `gain`, the decrease in parts of what the linear model promises, is large enough; where there
    is none the search ends. `end` without a step ends it at once, with a step after it.
    """

    step: FloatArray | None
    gain: float = np.inf
    inner: int = 0
    end: End | None = None


@dataclass(frozen=True, eq=False)
class Point(Generic[A]):
    """One point of the path.

    Attributes
    ----------
    theta : (n_params,) float array
    at : Linearization or OperatorLinearization
    scale : (n_params,) float array
        Lengths of the columns of the Jacobian.
    size : (n_params,) float array
        Change of each free variable that, to first order, changes its parameter by the parameter's own size.
    """

    theta: FloatArray
    at: A
    scale: FloatArray
    size: FloatArray

    @cached_property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.at.residual @ self.at.residual)


@dataclass(frozen=True, eq=False)
class Damping:
    """Damping of the steps, its units and the limits of a step, as one iteration hands them to the next.

    Attributes
    ----------
    factor : float
        Multiple of the squares of `scale`.
    growth : float
        Factor on it after the next step that is not made.
    scale, limit : (n_params,) float arrays
        Recent largest lengths of the Jacobian's columns; most that each variable may change by in a step.
    reach : (n_params, 2) float array
        Free variables between which the search stays (`Unknowns.reach`).
    """

    factor: float
    growth: float
    scale: FloatArray
    limit: FloatArray
    reach: FloatArray

    def at(self, point: Point[A], largest_step: float) -> Damping:
        """A copy with the column lengths and step limits updated for `point`.

        Each limit is the largest so far of `largest_step` times the size of the parameter.
        """
        scale = np.maximum(point.scale, 0.1 * self.scale)
        reach = np.where(point.size > 0, largest_step * point.size, np.inf)
        return replace(self, scale=scale, limit=np.maximum(self.limit, reach))

    def after(self, gain: float) -> Damping:
        """Damping for the next step, after one whose decrease of the cost was `gain` times the predicted decrease.

        For a gain above 1e-4 it is multiplied by a factor from 0.1 to 2, smaller for a larger gain; else by `growth`, which
        doubles.
        """
        if gain > _ACCEPTED:
            factor = self.factor * max(1 / 10, 1 - (2 * min(gain, 1.0) - 1) ** 3)
            return replace(self, factor=max(factor, _LEAST_DAMPING), growth=2.0)
        return replace(self, factor=self.factor * self.growth, growth=2 * self.growth)


P = TypeVar("P", bound=Point)


class Method(Protocol[P]):
    """A method of least squares: points, steps from them, and the uncertainty at the minimum."""

    @property
    def max_iterations(self) -> int: ...

    #: Whether no Jacobian is formed.
    is_matrix_free: ClassVar[bool]

    @property
    def initial_damping(self) -> float:
        """Factor on diag(J'J) that is added to J'J in the first step."""
        ...

    @property
    def largest_step(self) -> float:
        """Largest change of a parameter in one step, as a part of its largest magnitude so far."""
        ...

    def at(self, problem: Problem, theta: FloatArray) -> P:
        """Point at which `problem` is linearized, at free variables `theta` (n_params,)."""
        ...

    def tried(self, problem: Problem, point: P, damping: Damping) -> IterationResult:
        """Result of one damped step from `point`, the linearization of `problem` where the search stands."""
        ...

    def for_stages(self) -> Method[P]:
        """The method of easier forms of the problem, which only lead near."""
        ...

    def patient(self) -> Method[P]:
        """A copy whose easier forms of the problem are never left early."""
        ...

    def has_stalled(self, costs: Sequence[float] | FloatArray) -> bool:
        """True where a search with the sums of squares `costs`, the start's first, gains too little to go on."""
        ...

    def for_polishing(self) -> Method[P]:
        """A copy for a start that is known to be close to the minimum."""
        ...

    def raced(self, above: float) -> Method[P]:
        """A copy for one of several searches, which may end as `LEFT` where little is gained above a sum of squares."""
        ...

    def for_reduced(self) -> Method[P]:
        """A copy for a problem whose residual has a small relative error."""
        ...

    def misfits(self, problem: Problem, minimum: Minimum, probability: float) -> bool:
        """True where a larger chi-square than that of the minimum has less than this probability."""
        ...

    def uncertainty(
        self,
        problem: Problem,
        minimum: Minimum,
        misfit_probability: float,
        seed: int,
        fixed: FixedColumns | None = None,
    ) -> Uncertainty:
        """Uncertainty of the parameters at `minimum`, with the influence of `fixed` values; these are exact if None.

        The fit holds model error if its chi-square is less probable than `misfit_probability`; `seed` is that of random
        draws.
        """
        ...


def minimize(
    problem: Problem,
    method: Method[P],
    theta: FloatArray | None = None,
    progress: Progress | None = None,
    keeper: SearchStateStore | None = None,
) -> Minimum:
    """Nearest minimum of the sum of squared residuals, from `theta` by `method`.

    It is returned also where the search did not converge: `converged` and `message` tell.

    Parameters
    ----------
    problem : Problem
    method : GaussNewton, LevenbergMarquardt or MatrixFree
    theta : (n_params,) float array, optional
        Start; the problem's own by default.
    progress : callable, optional
        Called with the iteration and the sum of squares.
    keeper : SearchStateStore, optional
        Takes the state of the search after each iteration; where it has one already, the search goes on from there.
    """
    begun = None if keeper is None else keeper.state
    if begun is None:
        start = np.array(problem.theta_start if theta is None else theta, dtype=np.float64)
        costs, inner = [], []
        history: list[FloatArray] = [start]
        damping = Damping(
            method.initial_damping, 2.0, np.zeros(len(start)), np.zeros(len(start)), _reach(problem, start)
        )
    else:
        history, costs, inner = [*np.array(begun["history"])], [*begun["costs"]], [*begun["inner"]]
        scale, limit = np.array(begun["scale"]), np.array(begun["limit"])
        damping = Damping(float(begun["damping"]), float(begun["growth"]), scale, limit, _reach(problem, history[0]))
    here = method.at(problem, history[-1])
    costs = [float(cost) for cost in costs] or [here.cost]
    end = End(False, f"stopped after {method.max_iterations} iterations")
    for iteration in range(len(inner), method.max_iterations):
        damping = damping.at(here, method.largest_step)
        trial = method.tried(problem, here, damping)
        if trial.step is None:
            end = trial.end or end
            break
        if trial.gain > _ACCEPTED:
            here = method.at(problem, here.theta + trial.step)
        damping = damping.after(trial.gain)
        history.append(here.theta)
        costs.append(here.cost)
        inner.append(trial.inner)
        if progress is not None:
            progress(iteration + 1, here.cost)
        if trial.end is not None:
            end = trial.end
            break
        if method.has_stalled(costs):
            end = End(True, "the search hardly gains any more")
            break
        if keeper is not None:
            keeper.keep(iteration + 1, here.cost, partial(_state, damping, tuple(history), tuple(costs), tuple(inner)))
    return Minimum(here.theta, here.at, np.array(history), np.array(costs), np.array(inner, dtype=int), *end)


def _reach(problem: Problem, start: FloatArray) -> FloatArray:
    """Lower and upper limit of each free variable in the search, (n_params, 2): `Unknowns.reach`, widened to hold `start`."""
    return np.stack(
        [np.minimum(problem.unknowns.reach[:, 0], start), np.maximum(problem.unknowns.reach[:, 1], start)], axis=1
    )


def _state(damping: Damping, history: Sequence[FloatArray], costs: Sequence[float], inner: Sequence[int]) -> State:
    """State of a search that is stored after an iteration: all that the next one depends on, by name.

    `history` holds the free variables (n_params,) of all iterations, the last of which are ``theta``, `costs` their
    sums of squares and `inner` the numbers of inner iterations.
    """
    return {
        "theta": history[-1],
        "damping": damping.factor,
        "growth": damping.growth,
        "scale": damping.scale,
        "limit": damping.limit,
        "history": np.array(history),
        "costs": np.array(costs),
        "inner": np.array(inner, dtype=int),
    }


def sizes_at(problem: Problem, theta: FloatArray) -> FloatArray:
    """Size of each free variable, (n_params,), at `theta` (n_params,): the size of its parameter over the slope.

    The slope is that of the physical parameter by the free variable; sizes are very large where it is 0.
    """
    slope = np.maximum(np.abs(problem.slope(theta)), 1e-100)  # 0 where a bounded parameter is at its bound
    size: FloatArray = problem.unknowns.sizes(problem.physical(theta)) / slope
    return size


def damped_end(
    point: Point[A], damping: Damping, step: FloatArray, promised: float, step_tolerance: float, gain_tolerance: float
) -> End | None:
    """Reason why a damped search ends before `step` (n_params,), of predicted decrease `promised`; None if it goes on.

    It ends as converged if every entry is at most `step_tolerance` times the size of its parameter or the damping is
    above 1e40, or if the decrease is at most `gain_tolerance` times the sum of squares and the damping below 1000.
    `point` is where the step begins, with sum of squares and sizes.
    """
    if (np.abs(step) <= step_tolerance * point.size).all() or damping.factor > _MOST_DAMPING:
        return End(True, "the step fell below its tolerance")
    if promised <= gain_tolerance * point.cost and damping.factor < _MUCH_DAMPING:
        return End(True, "the search has converged")
    return None


def shortened(step: FloatArray, limit: FloatArray) -> FloatArray:
    """Step (n_params,) scaled down as a whole so that no entry exceeds its `limit`; unchanged if none does."""
    return step / max(1.0, float((np.abs(step) / limit).max(initial=0.0)))


def dense_search_fits(n_params: int, n_data: int, dense_bytes: float = _DENSE_BYTES) -> tuple[bool, str]:
    """True if a search with a dense Jacobian fits in `dense_bytes` of memory, and a sentence with the reason.

    Parameters
    ----------
    n_params, n_data : int
        Numbers of parameters and of data rows: the search takes 32 n_params (n_data + n_params) bytes.
    dense_bytes : float
        Memory that a dense search may take.
    """
    size = 8.0 * _DENSE_COPIES * n_params * (n_data + n_params)
    figures = f"{n_params} parameters and {n_data} data: a dense search would take {size / 1e9:.2g} GB"
    if size <= dense_bytes:
        return True, f"{figures}, which is within {dense_bytes / 1e9:.2g} GB"
    return False, f"{figures}, more than {dense_bytes / 1e9:.2g} GB; steps are solved without forming J'J"
