"""The solutions of an iteration by instruments, kept one by one, so that an interrupted one goes on from the last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import SingularModelError
from structid.forward.time.estimate import WhitenedRows
from structid.inversion.search.minimum import Keeper

#: What came of an iteration: a solution, rows that determine none, or a motion that cannot be simulated.
SOLVED, UNDETERMINED, UNSTABLE = 0, 1, 2


class Step(NamedTuple):
    """One iteration; `rows` are None where it is remembered from an earlier run, or cannot be made."""

    outcome: int
    solution: FloatArray
    deviation: FloatArray
    rows: WhitenedRows | None


class RowsAt(Protocol):
    """Equations and instruments as functions of the parameters."""

    def rows(self, values: FloatArray) -> WhitenedRows: ...


class InstrumentalSteps:
    """Iterations in their order, whatever way and stage they belong to: first those that `keeper` has from before.

    The rows, which take all the time, are not made for those; what follows from them is kept bit for bit.

    Parameters
    ----------
    keeper : Keeper, optional
    """

    def __init__(self, keeper: Keeper | None) -> None:
        """Steps read back from the checkpoint of `keeper`, or none."""
        self.keeper, self.count = keeper, 0
        state: Mapping[str, Any] | None = None if keeper is None else keeper.state
        self.steps: list[Step] = []
        if state is not None:
            for outcome, solution, deviation in zip(
                np.asarray(state["outcomes"]).tolist(), state["solutions"], state["deviations"], strict=True
            ):
                self.steps.append(Step(int(outcome), np.asarray(solution), np.asarray(deviation), None))

    def taken(self, fit: RowsAt, values: FloatArray) -> Step:
        """Step with the next iterate, from the parameters `values`; read from the checkpoint if it is there."""
        self.count += 1
        if self.count <= len(self.steps):
            return self.steps[self.count - 1]
        step, cost = _made(fit, values)
        self.steps.append(step._replace(rows=None))
        if self.keeper is not None:
            self.keeper.keep(self.count, cost, self._state)
        return step

    def _state(self) -> dict[str, Any]:
        """Steps as arrays for a checkpoint: outcomes, solutions and deviations, (n_steps, n_params)."""
        solutions = np.array([step.solution for step in self.steps])
        deviations = np.array([step.deviation for step in self.steps])
        outcomes = [step.outcome for step in self.steps]
        return {"theta": solutions[-1], "outcomes": outcomes, "solutions": solutions, "deviations": deviations}


def _made(fit: RowsAt, values: FloatArray) -> tuple[Step, float]:
    """One instrumental iteration from the parameters `values`, and the sum of squares there (infinite if unstable)."""
    nothing = np.full(len(values), np.nan)
    try:
        rows = fit.rows(values)
    except SingularModelError:
        return Step(UNSTABLE, nothing, nothing, None), float("inf")
    residual = rows.residual(values)
    cost, found = float(residual @ residual), rows.solution()
    if found is None:
        return Step(UNDETERMINED, nothing, nothing, rows), cost
    return Step(SOLVED, found, np.sqrt(np.diag(rows.covariance())), rows), cost
