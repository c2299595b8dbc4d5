"""The score test: how much of a misfit each candidate would remove, all parameters following along.

Changes of whitened data by fixed values within their tolerances are removed first: no cause is asked to explain them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes import candidates
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.data_rows import scaled_misfit
from structid.diagnose.receptances import MOST_LINES, Receptances, receptances_at
from structid.diagnose.search_budget import METER, iteration_effort, screening_effort
from structid.diagnose.thresholds import FINELY_SCREENED, LEAST_TOLERANCE_EFFECT
from structid.dynamics.receptance import single_blas
from structid.forward import FrfProblem, RecordProblem
from structid.forward.fixed_values import tolerances_of
from structid.inversion import JointProblem
from structid.inversion.linearization import triangle_of
from structid.inversion.search.within_tolerances import FixedValues


def fixed_columns(
    fixed_values: FixedValues | None, names: tuple[str, ...], theta: FloatArray, n_rows: int
) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names of fixed values, changes (n_rows, n_fixed) of all rows by their logarithms, and relative tolerances.

    The effort of a linearization is counted.

    Parameters
    ----------
    fixed_values : FixedValues, optional
        Fixed values of the model; without them there are no names, no columns and no tolerances.
    names : tuple of str
        Names of the parameters.
    theta : (n_params,) float array
        Free variables at which the changes are evaluated.
    n_rows : int
        Number of data rows and, behind them, rows of priors, which fixed values do not change.
    """
    if fixed_values is None:
        return (), np.zeros((n_rows, 0)), np.zeros(0)
    METER.add(iteration_effort(fixed_values.problem))
    influence = fixed_values.sensitivities_at(names, theta)
    padded = np.pad(influence.columns, ((0, n_rows - len(influence.columns)), (0, 0)))
    return influence.names, padded, influence.tolerance


def tolerance_directions(jacobian: FloatArray, columns: FloatArray) -> FloatArray:
    """Changes of data rows by one tolerance each, independent in what parameters cannot follow, (n_rows, n_directions).

    Columns T of one tolerance each are turned to T V, with V the right singular vectors of the part of T that is off
    the Jacobian; the coefficients of T V are standard normal as those of T are. Columns whose part off the Jacobian has
    a norm up to 0.3 standard deviations of the data are left out: noise hides them. No columns where there are no fixed
    values.

    Parameters
    ----------
    jacobian : (n_rows, n_params) float array
        Whitened Jacobian of the parameters.
    columns : (n_rows, n_fixed) float array
        Changes of the whitened rows by one tolerance of each fixed value.
    """
    n_params = jacobian.shape[1]
    if not columns.shape[1]:
        return columns
    off = triangle_of(np.column_stack([jacobian, columns]))[n_params:, n_params:]
    _, size, right = np.linalg.svd(off, full_matrices=False)
    return np.asarray(columns @ right[size > LEAST_TOLERANCE_EFFECT].T)


def damped_basis(basis: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """An orthonormal basis B of what parameters and tolerances can follow, and the part W of each direction that they take.

    With Q = `basis` and the singular values s of the part of `directions` off it, least squares with standard normal priors
    on the directions leave |(I - B W B') r|^2 of a residual r: W is 1 for Q and 1 - 1 / sqrt(1 + s^2) for the rest. Shapes are
    (n_rows, n_params + n_directions) and (n_params + n_directions,).

    Parameters
    ----------
    basis : (n_rows, n_params) float array
        Orthonormal basis of what the parameters can follow.
    directions : (n_rows, n_directions) float array
        Changes by one tolerance each.
    """
    left, size, _ = np.linalg.svd(directions - basis @ (basis.T @ directions), full_matrices=False)
    weights = np.concatenate([np.ones(basis.shape[1]), 1 - 1 / np.sqrt(1 + size**2)])
    return np.column_stack([basis, left]), weights


_SMALL = 1e-4
#: Part of the misfit by which strengths that leave equally little may differ by rounding.
_TIED = 1e-9
#: Columns of residuals from which on candidates are not computed together with further ones: arrays stay near the processor.
_COLUMNS = 48

#: What candidates of the same look have in common.
_Key: TypeAlias = tuple[object, ...]


@dataclass(frozen=True, eq=False)
class Screened:
    """Result of screening one candidate: the best strength, and `left`, the sum of squares that remains with it."""

    candidate: Candidate
    strength: float
    left: float


class RequestedChange(NamedTuple):
    """A candidate with its first-order strength from the residual, and this strength over its standard deviation."""

    candidate: Candidate
    strength: float
    score: float


class _CandidateScreening(NamedTuple):
    """Screening of one candidate: `strengths` (n,) and the sums of squares `left` (n,) after a linear step with each.

    `step` is the strength of least misfit by the candidate's slope, `promised` the lowest sum of squares by either.
    """

    strengths: FloatArray
    left: FloatArray
    step: float
    promised: float

    def best(self, candidate: Candidate) -> Screened:
        k = int(np.argmax(self.left <= self.left.min() * (1 + _TIED)))  # the first of those that leave as little
        return Screened(candidate, float(self.strengths[k]), float(self.left[k]))


@dataclass(frozen=True, eq=False)
class Point:
    """Problems of FRFs at one point of their parameters, linearized.

    Attributes
    ----------
    records : tuple of Receptances
    residual : (n_rows,) float array
        Whitened, of all records, then of priors.
    basis : (n_rows, n_basis) float array
        Orthonormal basis of what the parameters, and fixed values within their tolerances, can follow of a residual.
    weights : (n_basis,) float array
        Part of a residual along each basis vector that is followed: 1 along those of parameters; see `damped_basis`.
    undamped : collection of int
        Positions of the records that say nothing of damping.
    """

    records: tuple[Receptances, ...]
    residual: FloatArray
    basis: FloatArray
    weights: FloatArray
    undamped: Collection[int] = ()

    @property
    def left(self) -> float:
        """Sum of squares of the residual, less what parameters and fixed values within tolerances can follow of it.

        No change is made to the model.
        """
        return float(self._base @ self._base)

    def candidates(self, record_names: Sequence[str]) -> list[Candidate]:
        """All candidates whose effects follow from the receptances; made at the first call, then cached.

        `record_names` has the name of each record, in order.
        """
        key = tuple(record_names)
        if key not in self._candidates:
            self._candidates[key] = candidates(self.records, record_names)
        return self._candidates[key]

    @cached_property
    def _candidates(self) -> dict[tuple[str, ...], list[Candidate]]:
        return {}

    def without(self, mask: np.ndarray) -> float:
        """Misfit after a linear step where the errors of the masked data rows are larger by the likeliest factor.

        `mask` (n_data,) is True for these rows of all records. The step fits the rows that are not masked, and
        directions that fixed values damp have priors.
        """
        keep = np.ones(len(self.residual), dtype=bool)
        keep[: len(mask)] = ~mask
        priors = np.diag(np.sqrt((1 - self.weights) ** 2 / (1 - (1 - self.weights) ** 2)))
        right = np.append(self.residual[keep], np.zeros(len(priors)))
        step, *_ = np.linalg.lstsq(np.concatenate([self.basis[keep], priors]), right, rcond=None)
        residual, prior_residual = self.residual - self.basis @ step, priors @ step
        misfit_of_rows = float(residual[~keep] @ residual[~keep])
        return float(residual[keep] @ residual[keep] + prior_residual @ prior_residual) + scaled_misfit(
            misfit_of_rows, int((~keep).sum())
        )

    @single_blas()
    def screened(self, candidates: Sequence[Candidate]) -> list[Screened]:
        """Screening result of every candidate, in the same order: its best strength and the misfit that this leaves.

        Parameters follow by a linear step. The 16 most promising of each kind are screened with all their strengths and
        some more, others with every second strength. Candidates with equal effects are computed once.
        """
        keys = [self._key(candidate) for candidate in candidates]
        first: dict[_Key, Candidate] = {}
        for key, candidate in zip(keys, candidates, strict=True):
            first.setdefault(key, candidate)
        known = dict(zip(first, self._first_screening(list(first.values())), strict=True))
        kinds = defaultdict[str, list[int]](list)
        for k in sorted(range(len(keys)), key=lambda k: known[keys[k]].promised):
            kinds[candidates[k].kind].append(k)
        closer = {k for kind in kinds.values() for k in kind[:FINELY_SCREENED]}
        finely = list(dict.fromkeys(keys[k] for k in sorted(closer)))
        nearer = dict(
            zip(finely, self._closer([first[key] for key in finely], [known[key] for key in finely]), strict=True)
        )
        return [
            (nearer if k in closer else known)[key].best(candidate)
            for k, (candidate, key) in enumerate(zip(candidates, keys, strict=True))
        ]

    @single_blas()
    def requested(self, candidates: Sequence[Candidate]) -> list[RequestedChange]:
        """Small changes that the residual asks for by a score test, each alone, with all parameters following linearly.

        With w the slope of a candidate off the basis its strength is -w'r / w'w, and its score |w'r| / |w|, the size of a
        standard normal variable where model and noise are right. Candidates with one fixed strength, and those whose strength
        would be out of bounds, are left out; the order is that of `candidates`.

        References
        ----------
        Rao (1948), Proc. Cambridge Phil. Soc. 44, 50-57.
        """
        small = [_SMALL * np.abs(candidate.strengths).min() for candidate in candidates]
        changed = self._residuals_off_parameters(candidates, [np.array([strength]) for strength in small])
        requested = []
        for candidate, strength, off in zip(candidates, small, changed, strict=True):
            step, size = self._linear(off[:, 0], strength)
            low, high = candidate.bounds
            if len(candidate.strengths) > 1 and size > 0 and low < step < high:
                requested.append(RequestedChange(candidate, step, float(abs(step) * np.sqrt(size))))
        return requested

    def _linear(self, off: FloatArray, small: float) -> tuple[float, float]:
        """The strength of least misfit by a candidate's slope (0 without a finite slope), and the squared length of the slope.

        `off` (n_rows,) is the residual with the candidate at strength `small`, projected off the basis.
        """
        slope = (off - self._base) / small
        size = float(slope @ slope)
        return (float(-(slope @ self._base) / size) if 0 < size < np.inf else 0.0), size

    def _key(self, candidate: Candidate) -> _Key:
        """A hashable key, equal for candidates with equal effects, such as masses at nodes of one rigid part.

        A candidate that does not say what its effect depends on (`alike_by`) has a key of its own.
        """
        alike = candidate.alike_by()
        if alike is None:
            return (id(candidate),)
        directions, values = alike
        moves = [part.tobytes() for receptances in self.records for part in directions.rows(receptances)]
        return *values, *moves

    def _first_screening(self, candidates: Sequence[Candidate]) -> list[_CandidateScreening]:
        """First screening of each candidate, in their order, by every second one of its strengths.

        It has the misfit at each strength after a linear step of the parameters, the strength of least misfit by the
        candidate's slope (0 for a candidate with one strength), and the lowest misfit by either, where the former is
        within bounds.
        """
        every_second = [candidate.strengths[::2] for candidate in candidates]
        small = [_SMALL * np.abs(strengths).min() for strengths in every_second]
        has_one = [len(candidate.strengths) == 1 for candidate in candidates]
        looked = [
            strengths if is_one else np.append(strengths, least)
            for strengths, least, is_one in zip(every_second, small, has_one, strict=True)
        ]
        screenings = []
        changed = self._residuals_off_parameters(candidates, looked)
        for candidate, strengths, least, is_one, off in zip(
            candidates, every_second, small, has_one, changed, strict=True
        ):
            left = _squares(off[:, : len(strengths)])
            if is_one:
                screenings.append(_CandidateScreening(strengths, left, 0.0, float(left[0])))
                continue
            step, size = self._linear(off[:, -1], least)
            low, high = candidate.bounds
            linear = self.left - step**2 * size if low < step < high else np.inf
            screenings.append(_CandidateScreening(strengths, left, step, float(min(left.min(), linear))))
        return screenings

    def _closer(
        self, candidates: Sequence[Candidate], screenings: Sequence[_CandidateScreening]
    ) -> list[_CandidateScreening]:
        """First `screenings` of candidates, in their order, with further strengths appended.

        These are the strengths that were skipped, then 0.5, 1 and 2 times the strength by the slope, and 0.75 and 1.35
        times the best one, within bounds. Unchanged for candidates with one strength.
        """
        others = [candidate.strengths[1::2] for candidate in candidates]
        screenings = self._with_strengths(candidates, screenings, others)
        near = []
        for candidate, screening in zip(candidates, screenings, strict=True):
            low, high = candidate.bounds
            best = screening.best(candidate)
            about = (
                0.5 * screening.step,
                screening.step,
                2 * screening.step,
                0.75 * best.strength,
                1.35 * best.strength,
            )
            few = about if len(candidate.strengths) > 1 else ()
            near.append(np.array([q for q in few if low < q < high and q]))
        return self._with_strengths(candidates, screenings, near)

    def _with_strengths(
        self,
        candidates: Sequence[Candidate],
        screenings: Sequence[_CandidateScreening],
        strengths: Sequence[FloatArray],
    ) -> list[_CandidateScreening]:
        """The `screenings` with further `strengths` of each candidate, (n,) or empty, and their misfits appended."""
        changed = self._residuals_off_parameters(candidates, strengths)
        return [
            screening._replace(
                strengths=np.append(screening.strengths, more), left=np.append(screening.left, _squares(off))
            )
            for screening, more, off in zip(screenings, strengths, changed, strict=True)
        ]

    @cached_property
    def _base(self) -> FloatArray:
        return self._off_basis(self.residual)

    def _off_basis(self, rows: FloatArray) -> FloatArray:
        """Rows (n_rows, ...) less what parameters, and fixed values within their tolerances, can follow of each column."""
        followed = self.basis.T @ rows
        return rows - (self.basis * self.weights) @ followed

    def _residuals_off_parameters(
        self, candidates: Sequence[Candidate], strengths: Sequence[FloatArray]
    ) -> Iterator[FloatArray]:
        """Yield whitened residuals (n_rows, n_strengths) of each candidate, less what parameters follow.

        `strengths` has an array for each of `candidates`, whose order the results have. About 48 columns are computed
        together, since arrays of one candidate are small.
        """
        first, n_columns = 0, 0
        for last, values in enumerate(strengths, 1):
            n_columns += len(values)
            if n_columns >= _COLUMNS or last == len(candidates):
                yield from self._off_parameters_together(candidates[first:last], strengths[first:last])
                first, n_columns = last, 0

    def _off_parameters_together(
        self, candidates: Sequence[Candidate], strengths: Sequence[FloatArray]
    ) -> list[FloatArray]:
        """Whitened residuals (n_rows, n_strengths) of each candidate at its `strengths`, less what parameters follow.

        They are computed in one array. A candidate changes the rows of its record, or of all; those of damping do not
        change records that show none. The effort is counted.
        """
        ends = np.cumsum([len(values) for values in strengths])
        columns = [slice(end - len(values), end) for end, values in zip(ends.tolist(), strengths, strict=True)]
        rows = np.empty((len(self.residual), int(ends[-1])))
        for values in strengths:
            METER.add(screening_effort(len(rows), len(values)))
        rows[:] = self.residual[:, None]
        first = 0
        with np.errstate(all="ignore"):
            for number, receptances in enumerate(self.records):
                problem = receptances.problem
                size = problem.n_data
                changes, changed = [], []
                for candidate, values, own in zip(candidates, strengths, columns, strict=True):
                    is_silent = candidate.is_damping and number in self.undamped
                    if len(values) and candidate.record in (None, number) and not is_silent:
                        changes.append(receptances.frf + candidate.effect(receptances, values))
                        changed.append(np.arange(own.start, own.stop))
                if changes:
                    rows[first : first + size, np.concatenate(changed)] = problem.data_rows(np.concatenate(changes))
                first += size
            off = self._off_basis(rows)
        return [off[:, own] for own in columns]


def _squares(off: FloatArray) -> FloatArray:
    """Sum of squares of each column of `off` (n_rows, n_columns), (n_columns,); infinite for a column that is not finite."""
    left = np.einsum("ij,ij->j", off, off)
    return np.where(np.isfinite(left), left, np.inf)


def point_at(
    problems: Sequence[FrfProblem],
    theta: FloatArray,
    undamped: Collection[int] = (),
    most_lines: int = MOST_LINES,
    free_fixed_values: Callable[[Sequence[FrfProblem]], Sequence[RecordProblem]] = lambda problems: (),
) -> Point:
    """FRF problems linearized at joint free variables `theta`, on at most `most_lines` lines each, with receptances.

    Parameters
    ----------
    problems : sequence of FrfProblem
        One for each record.
    theta : (n_params,) float array
        Free variables of all problems together.
    undamped : collection of int
        Indices, from 0, of the records that say nothing of damping.
    most_lines : int
        Fewer are taken of large models.
    free_fixed_values : callable
        Takes the problems on the chosen lines and returns them with the fixed values of their models among the
        unknowns. By default it returns none, and the fixed values are exact.
    """
    own = JointProblem(tuple(problems), first_prior_counts=True).unknowns.split(theta)
    records = tuple(receptances_at(problem, at, most_lines) for problem, at in zip(problems, own, strict=True))
    on_lines = tuple(receptances.problem for receptances in records)
    whole = JointProblem(on_lines, first_prior_counts=True)
    METER.add(iteration_effort(whole))
    at = whole.linearize(theta)
    freed = free_fixed_values(on_lines)
    tolerances = tolerances_of(freed)
    fixed_values = FixedValues(JointProblem(tuple(freed), first_prior_counts=True), tolerances) if tolerances else None
    _, columns, tolerance = fixed_columns(fixed_values, whole.names, theta, len(at.residual))
    directions = tolerance_directions(at.jacobian, columns * tolerance)
    basis, weights = damped_basis(np.linalg.qr(at.jacobian)[0], directions)
    return Point(records, at.residual, basis, weights, undamped)
