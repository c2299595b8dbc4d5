"""Problems made of others: several as one joint problem; one with other data of the same noise, or with some variables fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import DataRows, NoiseLaw, Problem, Unknowns


@dataclass(frozen=True, eq=False)
class Wrapped(Problem):
    """A problem that answers as the inner `problem` does; subclasses change a part of it."""

    problem: Problem

    @property
    def unknowns(self) -> Unknowns:
        return self.problem.unknowns

    @property
    def rows(self) -> DataRows:
        return self.problem.rows

    def noise_law(self, theta: FloatArray) -> NoiseLaw:
        return self.problem.noise_law(theta)

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta)

    def linearize(self, theta: FloatArray) -> Linearization:
        return self.problem.linearize(theta)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        return self.problem.linearize_operator(theta)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        return self.problem.prior_rows(theta)


@dataclass(frozen=True, eq=False)
class ShiftedResidual(Wrapped):
    """`problem` with `shift` added to its residual: other data of the same noise, in units of that noise.

    Parameters
    ----------
    problem : Problem
    shift : (n_residuals,) float array
    """

    shift: FloatArray

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta) + self.shift

    def linearize(self, theta: FloatArray) -> Linearization:
        linearization = self.problem.linearize(theta)
        return replace(linearization, residual=linearization.residual + self.shift)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        linearization = self.problem.linearize_operator(theta)
        return replace(linearization, residual=linearization.residual + self.shift)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(theta)
        return residual + self.shift[self.n_data :], rows


@dataclass(frozen=True, eq=False)
class _OtherUnknowns:
    """All of `unknowns` but those at `indices` (n,), whose free variables are fixed at `values` (n,)."""

    unknowns: Unknowns
    indices: IntArray
    values: FloatArray

    @cached_property
    def free(self) -> IntArray:
        """Indices (n_free,) of the free variables that are not fixed, rising."""
        return np.delete(np.arange(len(self.unknowns.names)), self.indices)

    @property
    def names(self) -> tuple[str, ...]:
        return self._others(self.unknowns.names)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self._others(self.unknowns.kinds)

    @property
    def units(self) -> tuple[str, ...]:
        return self._others(self.unknowns.units)

    @property
    def theta_start(self) -> FloatArray:
        return np.asarray(self.unknowns.theta_start)[self.free]

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,), from those that are not fixed, `others` (n_free,), and the fixed values."""
        whole = np.empty(len(self.unknowns.names))
        whole[self.free], whole[self.indices] = others, self.values
        return whole

    def physical(self, others: FloatArray) -> FloatArray:
        return np.asarray(self.unknowns.physical(self.whole(others))[self.free])

    def slope(self, others: FloatArray) -> FloatArray:
        return np.asarray(self.unknowns.slope(self.whole(others))[self.free])

    def sizes(self, physical: FloatArray) -> FloatArray:
        """Sizes of the other unknowns (n_free,) at their `physical` values, with the fixed ones at theirs."""
        whole = np.array(self.unknowns.physical(self.whole(self.theta_start)))
        whole[self.free] = physical
        return np.asarray(self.unknowns.sizes(whole)[self.free])

    @property
    def bounds(self) -> FloatArray:
        return np.asarray(self.unknowns.bounds[self.free])

    @property
    def reach(self) -> FloatArray:
        return np.asarray(self.unknowns.reach[self.free])

    def _others(self, entries: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(entries[i] for i in self.free)


@dataclass(frozen=True, eq=False)
class _OtherScores:
    """Noise `law` of a problem, seen by those at the indices `free` (n_free,) of its `n_params` unknowns."""

    law: NoiseLaw
    free: IntArray
    n_params: int

    @property
    def factor(self) -> FloatArray | None:
        return self.law.factor

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        """Covariance (n_free, n_free) of J'r for data rows J, `jacobian` (n_data, n_free), by the free unknowns.

        None if `self.law` gives None, which means that it is J'J.
        """
        padded = np.zeros((len(jacobian), self.n_params))
        padded[:, self.free] = jacobian
        whole = self.law.score_covariance(padded)
        return None if whole is None else whole[np.ix_(self.free, self.free)]


@dataclass(frozen=True, eq=False)
class FixedVariables(Problem):
    """`problem` with some free variables fixed at values; the others are its unknowns.

    Parameters
    ----------
    problem : Problem
    indices : (n_fixed,) int array
        Indices of the fixed variables.
    values : (n_fixed,) float array
        Their values.
    """

    problem: Problem
    indices: IntArray
    values: FloatArray

    @cached_property
    def unknowns(self) -> _OtherUnknowns:
        return _OtherUnknowns(self.problem.unknowns, self.indices, self.values)

    @property
    def rows(self) -> DataRows:
        return self.problem.rows

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,), from `others` (n_free,), those that are not fixed."""
        return self.unknowns.whole(others)

    def residual(self, others: FloatArray) -> FloatArray:
        return self.problem.residual(self.whole(others))

    def linearize(self, others: FloatArray) -> Linearization:
        linearization = self.problem.linearize(self.whole(others))
        return replace(linearization, jacobian=linearization.jacobian[:, self.unknowns.free])

    def linearize_operator(self, others: FloatArray) -> OperatorLinearization:
        """Residual at the variables that are not fixed, `others` (n_free,), and products with its Jacobian by them."""
        whole, free = self.problem.linearize_operator(self.whole(others)), self.unknowns.free

        def forward(v: FloatArray) -> FloatArray:
            padded = np.zeros(whole.n_params)
            padded[free] = v
            return whole.forward(padded)

        return replace(
            whole,
            forward=forward,
            adjoint=lambda u: np.asarray(whole.adjoint(u)[free]),
            data_squares=whole.data_squares[free],
            prior=sparse.csr_array(whole.prior[:, free]),
            jacobian=None if whole.jacobian is None else whole.jacobian[:, free],
        )

    def noise_law(self, others: FloatArray) -> NoiseLaw:
        law = self.problem.noise_law(self.whole(others))
        return _OtherScores(law, self.unknowns.free, len(self.problem.names))

    def prior_rows(self, others: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(self.whole(others))
        return residual, sparse.csr_array(rows[:, self.unknowns.free])


_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
    """Several problems in one fit: different records, set-ups or kinds of data of one structure.

    Parameters are merged by name, in the order of their first appearance, and begin where the first problem that has
    them begins. Rows of the residual are the data of each problem in turn, then the priors; a prior that several
    problems state is one piece of knowledge and counts once.

    Parameters
    ----------
    problems : tuple of Problem
        Independent data: noise of one is not correlated with that of another.
    first_prior_counts : bool
        Whether the first of several different priors of one parameter is taken instead of an error raised, as in
        easier forms of a problem, whose priors only keep the search near.
    labels : tuple of tuples of str, optional
        Names of the parameters of each problem in the joint problem, where they are not those of the problem itself.

    Raises
    ------
    InputError
        If there is none, or a parameter that problems share differs among them in unit, transform, bounds or prior.
    """

    problems: tuple[Problem, ...]
    first_prior_counts: bool = False
    labels: tuple[tuple[str, ...], ...] | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` if there is no problem, or if the unknowns of the problems do not fit together."""
        object.__setattr__(self, "problems", tuple(self.problems))
        if not self.problems:
            raise InputError("`problems` must hold at least one problem, got none; give one for each record")
        _ = self.unknowns  # which must fit together

    @cached_property
    def unknowns(self) -> JointUnknowns:
        labels = tuple(problem.names for problem in self.problems) if self.labels is None else self.labels
        return JointUnknowns(tuple(problem.unknowns for problem in self.problems), labels)

    @cached_property
    def rows(self) -> DataRows:
        return joint_rows([problem.rows for problem in self.problems])

    def noise_law(self, theta: FloatArray) -> JointNoise:
        """Block-diagonal covariance of the data rows of all problems, at the joint `theta` (n_params,)."""
        parts = zip(self.problems, self.unknowns.split(theta), strict=True)
        laws = tuple(problem.noise_law(part) for problem, part in parts)
        return JointNoise(laws, tuple(problem.n_data for problem in self.problems), self.unknowns.columns)

    def residual(self, theta: FloatArray) -> FloatArray:
        """Data rows of all problems, then the prior rows that no earlier problem states, at the joint `theta` (n_params,)."""
        if self._is_one:
            return self.problems[0].residual(theta)
        return self._stack_rows(
            [problem.residual(free) for problem, free in zip(self.problems, self.unknowns.split(theta), strict=True)]
        )

    def linearize(self, theta: FloatArray) -> Linearization:
        """Residual and Jacobian of all problems at the joint free variables `theta` (n_params,), stacked.

        The data rows of all problems come first, in their order; the prior rows follow, each prior once.
        """
        if self._is_one:
            return self.problems[0].linearize(theta)
        parts = [
            problem.linearize(free) for problem, free in zip(self.problems, self.unknowns.split(theta), strict=True)
        ]
        n_params = len(self.names)
        wide = [
            _expand_columns(part.jacobian, index, n_params)
            for part, index in zip(parts, self.unknowns.columns, strict=True)
        ]
        eliminated = sum(part.n_eliminated for part in parts)
        return Linearization(self._stack_rows([part.residual for part in parts]), self._stack_rows(wide), eliminated)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        """Stacked residual of all problems at joint free variables `theta` (n_params,), and products with its Jacobian.

        Data rows come first, then prior rows, each prior once. The Jacobian is not formed, and stored only if every
        problem stores its own.
        """
        parts = [
            problem.linearize_operator(free)
            for problem, free in zip(self.problems, self.unknowns.split(theta), strict=True)
        ]
        pairs, n_params = list(zip(parts, self.unknowns.columns, strict=True)), len(self.names)
        ends = np.cumsum([part.n_data for part in parts])[:-1]
        priors = [
            _widened_rows(part.prior[rows - part.n_data], index, n_params)
            for (part, index), rows in zip(pairs, self._first_priors, strict=True)
        ]
        squares = np.zeros(n_params)
        for part, index in pairs:
            squares[index] += part.data_squares

        def forward(v: FloatArray) -> FloatArray:
            return np.concatenate([part.forward(v[index]) for part, index in pairs])

        def adjoint(u: FloatArray) -> FloatArray:
            """J'u for data rows u (n_data,), summed over the problems: (n_params,)."""
            total = np.zeros(n_params)
            for free, (part, index) in zip(np.split(u, ends), pairs, strict=True):
                total[index] += part.adjoint(free)
            return total

        stored = [_expand_columns(part.jacobian, index, n_params) for part, index in pairs if part.jacobian is not None]
        return OperatorLinearization(
            residual=self._stack_rows([part.residual for part in parts]),
            forward=forward,
            adjoint=adjoint,
            data_squares=squares,
            prior=sparse.csr_array(sparse.vstack(priors)),
            words=parts[0].words,
            jacobian=np.concatenate(stored) if len(stored) == len(parts) else None,
        )

    @cached_property
    def _priors_at_start(self) -> list[tuple[FloatArray, sparse.csr_array]]:
        """Prior rows of each problem at the start: residual (n_priors,) and its derivative by the problem's own parameters."""
        starts = self.unknowns.split(self.theta_start)
        return [problem.prior_rows(free) for problem, free in zip(self.problems, starts, strict=True)]

    @cached_property
    def _first_priors(self) -> tuple[IntArray, ...]:
        """Residual indices (n,) of the prior rows of each problem that no earlier problem states, one array a problem."""
        priors = self._priors_at_start
        kept = _first_prior_rows(priors, self.unknowns.columns, self.names, self.first_prior_counts)
        return tuple(problem.n_data + rows for problem, rows in zip(self.problems, kept, strict=True))

    @cached_property
    def _is_one(self) -> bool:
        """True for a single problem with parameters and prior rows in the joint order and no prior stated twice."""
        if len(self.problems) > 1:
            return False
        [index], [rows], [problem] = self.unknowns.columns, self._first_priors, self.problems
        n_rows = problem.n_data + len(self._priors_at_start[0][0])
        return np.array_equal(index, np.arange(len(problem.names))) and np.array_equal(
            rows, np.arange(problem.n_data, n_rows)
        )

    def _stack_rows(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Data rows of all `parts`, (n_residuals, ...) each, then prior rows that no earlier problem states."""
        data = [part[: problem.n_data] for part, problem in zip(parts, self.problems, strict=True)]
        priors = [part[rows] for part, rows in zip(parts, self._first_priors, strict=True)]
        return np.concatenate([*data, *priors])


def _expand_columns(jacobian: FloatArray, index: IntArray, n_params: int) -> FloatArray:
    """`jacobian` (n_rows, n_own) by the parameters at `index` (n_own,) as one by all `n_params`, (n_rows, n_params).

    Columns of other parameters are 0.
    """
    wide = np.zeros((len(jacobian), n_params))
    wide[:, index] = jacobian
    return wide


def _widened_rows(rows: sparse.csr_array, index: IntArray, n_params: int) -> sparse.csr_array:
    """`rows` of the parameters at `index` as rows of all `n_params`."""
    return sparse.csr_array((rows.data, index[rows.indices], rows.indptr), (rows.shape[0], n_params))


def _first_prior_rows(
    priors: Sequence[tuple[FloatArray, sparse.csr_array]],
    columns: Sequence[IntArray],
    names: tuple[str, ...],
    first_counts: bool,
) -> tuple[IntArray, ...]:
    """Indices among the prior rows of each problem of those that no earlier problem states: one int array a problem.

    `priors` are residual (n_rows,) and derivative (n_rows, n_own_params) of the prior rows of each problem, `columns`
    the joint indices (n_own_params,) of its parameters, and `names` the joint names. A prior on one parameter that
    differs from an earlier one on it is dropped with `first_counts`, else it raises `InputError`; one on several
    parameters is kept.
    """
    known: dict[tuple[int, ...], list[tuple[FloatArray, float]]] = {}
    first_rows = []
    for number, ((residual, prior), index) in enumerate(zip(priors, columns, strict=True), 1):
        rows = _widened_rows(sparse.csr_array(prior), index, len(names))
        rows.eliminate_zeros()
        rows.sort_indices()
        kept = []
        for k, value in enumerate(residual.tolist()):
            span = slice(rows.indptr[k], rows.indptr[k + 1])
            members, entries = tuple(rows.indices[span].tolist()), rows.data[span]
            stated = known.setdefault(members, [])
            if any(_is_same(other, (entries, value)) for other in stated):
                continue
            if stated and len(members) == 1:
                if first_counts:
                    continue
                raise InputError(
                    f"prior of {names[members[0]]} must be the same in all problems, got another in problem {number};"
                    " state it once, or alike"
                )
            stated.append((entries, value))
            kept.append(k)
        first_rows.append(np.array(kept, dtype=int))
    return tuple(first_rows)


def _is_same(first: tuple[FloatArray, float], second: tuple[FloatArray, float]) -> bool:
    return bool(
        np.allclose(first[0], second[0], rtol=_SAME, atol=0) and np.isclose(first[1], second[1], rtol=_SAME, atol=_SAME)
    )


@dataclass(frozen=True, eq=False)
class JointUnknowns:
    """Unknowns of `parts` merged by name, in the order of their first appearance; the first part that has one defines it.

    Parameters
    ----------
    parts : tuple of Unknowns
    labels : tuple of tuples of str
        Names of the unknowns of each part among all.

    Raises
    ------
    InputError
        If an unknown that parts share differs among them in unit, transform or bounds.
    """

    parts: tuple[Unknowns, ...]
    labels: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for number in range(len(self.parts)):
            _require_same_declaration(self, number)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for labels in self.labels for name in labels))

    @cached_property
    def columns(self) -> tuple[IntArray, ...]:
        """Indices (n_part,) of the unknowns of each part among all, one array a part."""
        index = {name: i for i, name in enumerate(self.names)}
        return tuple(np.array([index[name] for name in labels], dtype=int) for labels in self.labels)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        return _first_words(self.labels, [part.kinds for part in self.parts])

    @cached_property
    def units(self) -> tuple[str, ...]:
        return _first_words(self.labels, [part.units for part in self.parts])

    @cached_property
    def theta_start(self) -> FloatArray:
        return _first_of_each(self, [np.asarray(part.theta_start) for part in self.parts])

    def physical(self, theta: FloatArray) -> FloatArray:
        return _first_of_each(
            self, [part.physical(free) for part, free in zip(self.parts, self.split(theta), strict=True)]
        )

    def slope(self, theta: FloatArray) -> FloatArray:
        return _first_of_each(
            self, [part.slope(free) for part, free in zip(self.parts, self.split(theta), strict=True)]
        )

    def sizes(self, physical: FloatArray) -> FloatArray:
        """Size with which each standard deviation is compared, (n_params,): the largest of all problems.

        `physical` (n_params,) are the parameters; sizes are in physical units too.
        """
        sizes = np.zeros(len(self.names))
        for part, index in zip(self.parts, self.columns, strict=True):
            sizes[index] = np.maximum(sizes[index], part.sizes(physical[index]))
        return sizes

    @property
    def bounds(self) -> FloatArray:
        return _first_of_each(self, [part.bounds for part in self.parts])

    @property
    def reach(self) -> FloatArray:
        return _first_of_each(self, [part.reach for part in self.parts])

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Values of the unknowns of each problem, in the order of the problems, from joint `values` (n_params, ...)."""
        return [values[index] for index in self.columns]


def _first_of_each(unknowns: JointUnknowns, values: Sequence[FloatArray]) -> FloatArray:
    """Array (n_params, ...) with a row for each joint unknown, taken from the first problem that has it.

    `values` has an array (n_own, ...) for each problem.
    """
    rows = np.zeros((len(unknowns.names), *values[0].shape[1:]))
    for part_rows, index in reversed(list(zip(values, unknowns.columns, strict=True))):
        rows[index] = part_rows
    return rows


def _first_words(labels: Sequence[tuple[str, ...]], words: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Word for each joint unknown, such as its unit: that of the first problem that has it.

    `labels` are the joint names of the unknowns of each problem, `words` the words for them in the same order. The
    result is in the order of first appearance.
    """
    word_of: dict[str, str] = {}
    for names, part_words in zip(labels, words, strict=True):
        for name, word in zip(names, part_words, strict=True):
            word_of.setdefault(name, word)
    return tuple(word_of.values())


def _require_same_declaration(unknowns: JointUnknowns, number: int) -> None:
    """Raise `InputError` if problem `number` (from 0) declares an unknown otherwise than the first problem that has it.

    Units must be equal, and physical value and slope at the common start, which bounds and transform decide.
    """
    start, part = unknowns.theta_start, unknowns.parts[number]
    index, names = unknowns.columns[number], unknowns.labels[number]
    for name, unit, column in zip(names, part.units, index, strict=True):
        if unit != unknowns.units[column]:
            raise InputError(
                f"{name} must have one unit in all problems, got {unknowns.units[column]} and {unit} in problem"
                f" {number + 1}; give one of the two another name"
            )
    pairs = (
        (part.physical(start[index]), unknowns.physical(start)[index]),
        (part.slope(start[index]), unknowns.slope(start)[index]),
    )
    is_same = np.logical_and(*(np.isclose(a, b, rtol=_SAME, atol=0) for a, b in pairs))
    if not is_same.all():
        raise InputError(
            f"{names[int(np.argmin(is_same))]} must have the same bounds and transform in all problems,"
            f" got others in problem {number + 1}; declare it the same way"
        )


def joint_rows(parts: Sequence[DataRows]) -> DataRows:
    """Labels of the data rows of all `parts`, one after another; the numbers of lines and channels are distinct between parts.

    Quantities keep their numbers, and are dropped if the parts that have any differ in them.
    """
    return DataRows(
        _laid_out([np.asarray(part.lines) for part in parts]),
        _laid_out([np.asarray(part.series) for part in parts], 2),
        tuple(name for part in parts for name in part.names),
        _joint_quantities(parts),
        _joint_averages(parts),
    )


def _joint_quantities(parts: Sequence[DataRows]) -> IntArray | None:
    """Quantity number of each data row of all `parts`, (n_data,), -1 for none.

    None if no part has quantities, or the parts that have some do not have the same set.
    """
    numbers = [set(part.quantities[part.quantities >= 0].tolist()) for part in parts if part.quantities is not None]
    if not numbers or any(other != numbers[0] for other in numbers):
        return None
    return np.concatenate([np.full(part.n_data, -1) if part.quantities is None else part.quantities for part in parts])


def _joint_averages(parts: Sequence[DataRows]) -> FloatArray | None:
    """Number of averages behind the variance of each data row, (n_data,), infinite where it is known; None if all are known."""
    if all(part.averages is None for part in parts):
        return None
    return np.concatenate([np.full(part.n_data, np.inf) if part.averages is None else part.averages for part in parts])


@dataclass(frozen=True, eq=False)
class JointNoise:
    """Noise of several problems, independent of each other.

    Attributes
    ----------
    laws : tuple of NoiseLaw
    n_data : tuple of int
        Number of data rows of each.
    columns : tuple of (n_part_params,) int arrays
        Indices of the unknowns of each among all.
    """

    laws: tuple[NoiseLaw, ...]
    n_data: tuple[int, ...]
    columns: tuple[IntArray, ...]

    factor = None

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        """Sum of the score covariances of all problems, (n_params, n_params); None if it is J'J in all of them.

        `jacobian` (n_data, n_params) has the data rows of the problems one after another.
        """
        total, first, independent = np.zeros((jacobian.shape[1],) * 2), 0, True
        for law, n_data, index in zip(self.laws, self.n_data, self.columns, strict=True):
            rows = jacobian[first : first + n_data][:, index]
            covariance = law.score_covariance(rows)
            independent &= covariance is None
            total[np.ix_(index, index)] += rows.T @ rows if covariance is None else covariance
            first += n_data
        return None if independent else total


def _laid_out(parts: Sequence[IntArray], step: int = 1) -> IntArray:
    """Non-negative integer labels of all `parts` (n,) in one array, raised so that different parts share none.

    Each part is raised by the least multiple of `step` that does so after the parts before it.
    """
    raised, first = [], 0
    for part in parts:
        raised.append(part + first)
        first += step * (int(part.max(initial=-1)) // step + 1)
    return np.concatenate(raised)
