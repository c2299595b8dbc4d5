"""Cache of the evaluation at the last point."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from structid.core.arrays import FloatArray

T = TypeVar("T")


class LastEvaluation(Generic[T]):
    """The evaluation at the last point, where a step is tried and taken, and tests follow; a pickled copy is empty."""

    def __init__(self) -> None:
        self._kept: tuple[bytes, T] | None = None

    def __reduce__(self) -> tuple[type[LastEvaluation[T]], tuple[()]]:
        return LastEvaluation, ()

    def at(self, theta: FloatArray, evaluate: Callable[[FloatArray], T]) -> T:
        """Evaluation at the free variables `theta` (n_params,): the cached one, else by `evaluate`, which is then cached."""
        found = self.known(theta)
        if found is None:
            found = evaluate(theta)
            self.keep(theta, found)
        return found

    def known(self, theta: FloatArray) -> T | None:
        """The evaluation that is kept of `theta`, if any."""
        return self._kept[1] if self._kept is not None and self._kept[0] == theta.tobytes() else None

    def keep(self, theta: FloatArray, evaluation: T) -> None:
        self._kept = theta.tobytes(), evaluation

    def taken(self, theta: FloatArray) -> T | None:
        """The evaluation that is kept of `theta`, if any; nothing is kept afterwards."""
        found, self._kept = self.known(theta), None
        return found
