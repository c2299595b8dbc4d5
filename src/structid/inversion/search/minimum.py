"""The result of a search for a minimum, and the parts that every search needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import SingularModelError
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import Problem

Progress = Callable[[int, float], None]
#: Numbers, texts, arrays, and lists or mappings of them by name: what goes to and from checkpoints and other processes.
StoredValues: TypeAlias = Mapping[str, Any]
#: All that a search needs to go on with the same digits, free variables as ``theta``.
State: TypeAlias = StoredValues


class SearchStateStore(Protocol):
    """Store in which a search leaves its state after each iteration, and finds one to resume from."""

    @property
    def state(self) -> State | None:
        """State of an earlier run of the same search; None where the search has to begin."""
        ...

    def keep(self, iteration: int, cost: float, state: Callable[[], State]) -> None:
        """Take the state after an iteration; `state` makes it, if it is wanted, then or later."""
        ...


class StageCourse(NamedTuple):
    """Course of the search of one stage: free variables (n_iterations + 1, n_params) and sums of squares beside them."""

    name: str
    history: FloatArray
    costs: FloatArray


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
    """Residual (n_residuals,) at free variables `theta` (n_params,); None if the model is singular there or it is not finite."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            residual = problem.residual(theta)
        except SingularModelError:
            return None
    return residual if np.isfinite(residual).all() else None


def squared(residual: FloatArray | None) -> float:
    """Sum of squares of `residual` (n,); infinite if it is None."""
    if residual is None:
        return np.inf
    with np.errstate(over="ignore"):
        return float(residual @ residual)
