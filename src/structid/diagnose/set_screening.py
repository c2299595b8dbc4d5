"""Screening of changes whose effect receptances do not give: each changed model is judged by its misfit after one linear step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import StructidError
from structid.diagnose.causes import CoarseMesh, ExponentialWindow, FixedValue, ShearFlexibility, set_candidates
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.clock import Clock
from structid.diagnose.refits import CandidateOfStrength, FittedModel
from structid.diagnose.score_test import Screened
from structid.diagnose.search_budget import METER, UNLIMITED, SearchBudget, iteration_effort, map_within_budget
from structid.diagnose.thresholds import FIRST_OF_SET_KIND, LEAST_DROP
from structid.diagnose.tolerance_directions import fixed_columns, tolerance_directions
from structid.inversion.linearization import triangle_of
from structid.inversion.search.work import TaskContext, TaskExecutor


class LinearizedFit(NamedTuple):
    """A fit with its residual on the lines of `coarse`, and the ways in which fixed values change that within their tolerances.

    Attributes
    ----------
    fitted : FittedModel
    residual : (n_rows,) float array
        Whitened data rows, then priors.
    directions : (n_data, n_directions) float array
        Changes of the data rows, each by one tolerance; see `tolerance_directions`.
    names : tuple of str
        Fixed values, one for each of their columns in `triangle`, in its order.
    triangle : (n, n_columns) float array
        R of the QR factorization of the Jacobian, `directions`, the columns of the fixed values, and the residual; of n rows,
        as many as it has columns, or as there are data and priors where these are fewer.
    """

    fitted: FittedModel
    residual: FloatArray
    directions: FloatArray
    names: tuple[str, ...]
    triangle: FloatArray

    @property
    def misfit(self) -> float:
        """The misfit after one linear step, fixed values within their tolerances."""
        return self._misfit_with(np.zeros((len(self.triangle), 0)))

    def misfit_with_freed(self, names: Sequence[str]) -> float:
        """Weighted sum of squares after a linear step that also multiplies the fixed values `names` by one factor without prior."""
        first = self.triangle.shape[1] - len(self.names) - 1
        chosen = [first + self.names.index(name) for name in names]
        return self._misfit_with(self.triangle[:, chosen].sum(axis=1, keepdims=True))

    def _misfit_with(self, freed: FloatArray) -> float:
        """Misfit after one linear step of the fit with further unknowns, which have no prior.

        `freed` (n, n_freed) are their Jacobian columns, with the rows of `self.triangle`.
        """
        n_directions = self.directions.shape[1]
        n_params = self.triangle.shape[1] - len(self.names) - n_directions - 1
        columns = [self.triangle[:, : n_params + n_directions], freed, self.triangle[:, -1:]]
        return misfit_after_step(np.column_stack(columns), n_params, n_directions)


def misfit_after_step(augmented: FloatArray, n_params: int, n_directions: int) -> float:
    """The sum of squares of data, priors and tolerances that the best linear step leaves.

    Parameters
    ----------
    augmented : (n_rows, n_columns) float array
        In this order: the Jacobian of the parameters, changes by one tolerance each, columns of further unknowns without a
        prior, and the residual.
    n_params, n_directions : int
        Numbers of columns of parameters and of tolerances; each of the latter has a standard normal prior.
    """
    priors = np.zeros((n_directions, augmented.shape[1]))
    priors[:, n_params : n_params + n_directions] = np.eye(n_directions)
    rest = triangle_of(np.concatenate([augmented, priors]))[augmented.shape[1] - 1 :, -1]
    return float(rest @ rest)


def linearize_fit(fitted: FittedModel) -> LinearizedFit:
    """Fit on fewer lines, linearized at its free variables once for all changes that are compared with it.

    Fixed values are free within their tolerances, in large models exact. The effort is counted. `fitted` is that fit.
    """
    modified, target = fitted.modified, fitted.modified.coarse.target
    METER.add(iteration_effort(target))
    at = target.linearize(fitted.theta)
    fixed_values = None if modified.is_large else modified.coarse.fixed_values
    names, columns, tolerance = fixed_columns(fixed_values, target.names, fitted.theta, len(at.residual))
    directions = tolerance_directions(at.jacobian, columns * tolerance)
    triangle = triangle_of(np.column_stack([at.jacobian, directions, columns, at.residual]))
    return LinearizedFit(fitted, at.residual, directions[: target.n_data], names, triangle)


def screen_sets(
    base: FittedModel, work: TaskExecutor, name: str, budget: SearchBudget = UNLIMITED
) -> tuple[list[Screened], int]:
    """Changes of sets, records and mesh that lower the misfit by one linear step, and the number of changes screened.

    Each has its best strength; the order is that of the candidates. The misfit must drop by more than 2 % of it, except
    for mesh, shear, window and clock, which need no drop. Of each family the four that leave least are returned, and
    every clock. Misfits are estimated on the lines of `coarse` of the changed models, and scaled to all data. `name` is
    that of the stage in progress messages. `base` is the fit of the study; `work` and `budget` run and limit the steps.
    """
    several = set_candidates(base.modified.model, base.modified.problems)
    sized = [(candidate, float(strength)) for candidate in several for strength in candidate.strengths]
    linearized = linearize_fit(base)
    left = iter(screen_changes(linearized, sized, work, name, budget))
    unchanged, screened, n_seen = linearized.misfit, list[Screened](), 0
    scale = base.modified.target.n_data / base.modified.coarse.target.n_data
    for candidate in several:
        least, strength = min((next(left), float(strength)) for strength in candidate.strengths)
        n_seen += int(np.isfinite(least))
        needs_no_drop = isinstance(candidate, CoarseMesh | ShearFlexibility | ExponentialWindow | Clock)
        if np.isfinite(least) and (needs_no_drop or least < (1 - LEAST_DROP) * unchanged):
            screened.append(Screened(candidate, strength, scale * least))
    order = sorted(range(len(screened)), key=lambda k: screened[k].left)
    few = first_of_each([screened[k].candidate.family for k in order], FIRST_OF_SET_KIND)
    telling = {order[k] for k in few} | {k for k in order if isinstance(screened[k].candidate, Clock)}
    return [screened[k] for k in sorted(telling)], n_seen


def first_of_each(kinds: Sequence[str], most: int) -> list[int]:
    """Indices, from 0 and rising, of the first `most` entries of each kind in `kinds`."""
    counts, kept = Counter[str](), list[int]()
    for k, kind in enumerate(kinds):
        counts[kind] += 1
        if counts[kind] <= most:
            kept.append(k)
    return kept


def screen_changes(
    linearized: LinearizedFit, sized: Sequence[CandidateOfStrength], work: TaskExecutor, name: str, budget: SearchBudget
) -> list[float]:
    """Misfit of each changed model after a linear step, in the order of `sized` (candidate, strength).

    Infinite where there is no such model, its step fails, there is no time for it, or a change without a parameter is
    too small to lower the misfit by 2 %. Fixed values that are columns of `linearized` need no changed model. `name` is
    that of the stage in progress messages. `work` and `budget` run and limit the steps.
    """
    known = {
        k: linearized.misfit_with_freed(one.where) for k, (one, _) in enumerate(sized) if _has_columns(linearized, one)
    }
    others = [item for k, item in enumerate(sized) if k not in known]
    steps = iter(map_within_budget(budget, work, name, _screen_change, linearized, others))
    return [known[k] if k in known else (next(steps) or {"left": np.inf})["left"] for k in range(len(sized))]


def _has_columns(linearized: LinearizedFit, candidate: Candidate) -> bool:
    """True of fixed values whose effects are columns of the linearized fit, so that no changed model is needed."""
    return isinstance(candidate, FixedValue) and set(candidate.where) <= set(linearized.names)


def _screen_change(linearized: LinearizedFit, change: CandidateOfStrength, tools: TaskContext) -> dict[str, float]:
    """Misfit, under the key ``left``, after one linear step of the changed model; infinite on failure.

    The step begins at the values of the fit, and at the initial ones too where the candidate asks for it; the lower
    misfit counts. `change` is the candidate and its strength. A change without a parameter that changes the residual by
    d lowers the misfit W after a step by no more than 2 sqrt(W) |d| to first order; infinite too where that is less
    than 2 % of W. `tools` is not used. `linearized` is the fit without the change.
    """
    base = linearized.fitted
    try:
        modified = base.modified.changed(*change)
        target, theta = modified.coarse.target, modified.theta_of(base.values)
        n_data, is_comparable = target.n_data, target.n_data == base.modified.coarse.target.n_data
        is_alike = is_comparable and target.names == base.modified.target.names
        if is_alike and not change[0].is_screened_at_start:
            difference = np.linalg.norm(target.residual(theta)[:n_data] - linearized.residual[:n_data])
            if 2 * difference < LEAST_DROP * np.sqrt(linearized.misfit):
                return {"left": np.inf}
    except (StructidError, np.linalg.LinAlgError):
        return {"left": np.inf}
    starts = [np.asarray(theta)]
    if change[0].is_screened_at_start and not np.array_equal(theta, target.theta_start):
        starts.append(np.asarray(target.theta_start))
    left = [np.inf]
    for start in starts:
        METER.add(iteration_effort(target))
        try:
            at = target.linearize(start)
        except (StructidError, np.linalg.LinAlgError):
            continue
        directions = linearized.directions if is_comparable else np.zeros((n_data, 0))
        directions = np.pad(directions, ((0, len(at.residual) - n_data), (0, 0)))
        augmented = np.column_stack([at.jacobian, directions, at.residual])
        left.append(misfit_after_step(augmented, at.n_params, directions.shape[1]))
    return {"left": min(left)}
