"""Several problems as one: parameters of the same name are one unknown, and every set of data counts once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import DataRows, Problem
from structid.inversion.problems.joint_parts import JointNoise, JointUnknowns, joint_rows

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
        parts = zip(self.problems, self.unknowns.split(theta), strict=True)
        laws = tuple(problem.noise_law(part) for problem, part in parts)
        return JointNoise(laws, tuple(problem.n_data for problem in self.problems), self.unknowns.columns)

    def residual(self, theta: FloatArray) -> FloatArray:
        if self._is_one:
            return self.problems[0].residual(theta)
        return self._stacked(
            [problem.residual(own) for problem, own in zip(self.problems, self.unknowns.split(theta), strict=True)]
        )

    def linearize(self, theta: FloatArray) -> Linearization:
        """Residual and Jacobian of all records, stacked, at the joint free variables `theta` (n_params,)."""
        if self._is_one:
            return self.problems[0].linearize(theta)
        parts = [problem.linearize(own) for problem, own in zip(self.problems, self.unknowns.split(theta), strict=True)]
        n_params = len(self.names)
        wide = [
            _widened(part.jacobian, index, n_params) for part, index in zip(parts, self.unknowns.columns, strict=True)
        ]
        eliminated = sum(part.n_eliminated for part in parts)
        return Linearization(self._stacked([part.residual for part in parts]), self._stacked(wide), eliminated)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        """Stacked residual of all records and products with its derivative, which is not formed."""
        parts = [
            problem.linearize_operator(own)
            for problem, own in zip(self.problems, self.unknowns.split(theta), strict=True)
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
            for own, (part, index) in zip(np.split(u, ends), pairs, strict=True):
                total[index] += part.adjoint(own)
            return total

        stored = [_widened(part.jacobian, index, n_params) for part, index in pairs if part.jacobian is not None]
        return OperatorLinearization(
            residual=self._stacked([part.residual for part in parts]),
            forward=forward,
            adjoint=adjoint,
            data_squares=squares,
            prior=sparse.csr_array(sparse.vstack(priors)),
            words=parts[0].words,
            jacobian=np.concatenate(stored) if len(stored) == len(parts) else None,
        )

    @cached_property
    def _first_priors(self) -> tuple[IntArray, ...]:
        """For each problem the indices of the residual rows of priors that no earlier problem states."""
        priors = [
            problem.prior_rows(own)
            for problem, own in zip(self.problems, self.unknowns.split(self.theta_start), strict=True)
        ]
        kept = _first_prior_rows(priors, self.unknowns.columns, self.names, self.first_prior_counts)
        return tuple(problem.n_data + rows for problem, rows in zip(self.problems, kept, strict=True))

    @cached_property
    def _is_one(self) -> bool:
        """True if the joint problem is a single problem with its own order of parameters."""
        if len(self.problems) > 1:
            return False
        [index], [rows], [problem] = self.unknowns.columns, self._first_priors, self.problems
        n_rows = problem.n_data + len(problem.prior_rows(self.theta_start)[0])
        return np.array_equal(index, np.arange(len(problem.names))) and np.array_equal(
            rows, np.arange(problem.n_data, n_rows)
        )

    def _stacked(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Data rows of all problems, then the rows of priors that no earlier problem states."""
        data = [part[: problem.n_data] for part, problem in zip(parts, self.problems, strict=True)]
        priors = [part[rows] for part, rows in zip(parts, self._first_priors, strict=True)]
        return np.concatenate([*data, *priors])


def _widened(jacobian: FloatArray, index: IntArray, n_params: int) -> FloatArray:
    """`jacobian` by the parameters at `index` as one by all `n_params`."""
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
    """Indices of the prior rows of each problem that no earlier problem states."""
    known: dict[tuple[int, ...], list[tuple[FloatArray, float]]] = {}
    found = []
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
        found.append(np.array(kept, dtype=int))
    return tuple(found)


def _is_same(first: tuple[FloatArray, float], second: tuple[FloatArray, float]) -> bool:
    return bool(
        np.allclose(first[0], second[0], rtol=_SAME, atol=0) and np.isclose(first[1], second[1], rtol=_SAME, atol=_SAME)
    )
