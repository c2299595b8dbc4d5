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
from structid.inversion.problem import BaseProblem, OfData, OfUnknowns, Problem, Stages
from structid.inversion.problems.joint_parts import JointData, JointUnknowns

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class JointProblem(OfUnknowns, OfData, BaseProblem):
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

    Raises
    ------
    InputError
        If there is none, or a parameter that problems share differs among them in unit, transform, bounds or prior.
    """

    problems: tuple[Problem, ...]
    first_prior_counts: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "problems", tuple(self.problems))
        if not self.problems:
            raise InputError("`problems` must hold at least one problem, got none; give one for each record")
        _ = self.unknowns  # which must fit together

    @cached_property
    def unknowns(self) -> JointUnknowns:
        return JointUnknowns(self.problems)

    @cached_property
    def data(self) -> JointData:
        return JointData(self.problems, self.unknowns.columns)

    def residual(self, theta: FloatArray) -> FloatArray:
        if self._is_one:
            return self.problems[0].residual(theta)
        return self._stacked(
            [problem.residual(own) for problem, own in zip(self.problems, self.unknowns.split(theta), strict=True)]
        )

    def linearize(self, theta: FloatArray) -> Linearization:
        if self._is_one:
            return self.problems[0].linearize(theta)
        parts = [problem.linearize(own) for problem, own in zip(self.problems, self.unknowns.split(theta), strict=True)]
        n_params = len(self.names)
        wide = [
            _widened(part.jacobian, index, n_params) for part, index in zip(parts, self.unknowns.columns, strict=True)
        ]
        eliminated = sum(part.n_eliminated for part in parts)
        return Linearization(self._stacked([part.residual for part in parts]), self._stacked(wide), eliminated)

    @property
    def matrix_free_obstacle(self) -> str:
        return next((p.matrix_free_obstacle for p in self.problems if p.matrix_free_obstacle), "")

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        parts = [
            problem.linearize_operator(own)
            for problem, own in zip(self.problems, self.unknowns.split(theta), strict=True)
        ]
        pairs, n_params = list(zip(parts, self.unknowns.columns, strict=True)), len(self.names)
        ends = np.cumsum([part.n_data for part in parts])[:-1]
        priors = [
            _widened_rows(part.prior[rows - part.n_data], index, n_params)
            for (part, index), rows in zip(pairs, self._kept_priors, strict=True)
        ]
        squares = np.zeros(n_params)
        for part, index in pairs:
            squares[index] += part.data_squares

        def forward(v: FloatArray) -> FloatArray:
            return np.concatenate([part.forward(v[index]) for part, index in pairs])

        def adjoint(u: FloatArray) -> FloatArray:
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

    def stage_plans(self) -> Sequence[Stages]:
        """Ways to the answer: the ways of each problem, joined stage by stage.

        A problem with fewer ways or stages than another stays in its last one, and one without any is as it is.
        """
        own = [problem.stage_plans() for problem in self.problems]
        joined = []
        for way in range(max(len(plans) for plans in own)):
            paths = [plans[min(way, len(plans) - 1)] if plans else () for plans in own]
            joined.append(tuple(_joined_stage(self.problems, paths, k) for k in range(max(map(len, paths)))))
        return tuple(joined)

    def thinned(self) -> JointProblem | None:
        """The same with a part of the data; None where every problem is small enough."""
        parts = [problem.thinned() for problem in self.problems]
        if all(part is None for part in parts):
            return None
        return JointProblem(tuple(part or whole for part, whole in zip(parts, self.problems, strict=True)))

    @cached_property
    def _kept_priors(self) -> tuple[IntArray, ...]:
        """Of each problem the rows of those priors that no earlier problem states."""
        priors = [
            problem.prior_rows(own)
            for problem, own in zip(self.problems, self.unknowns.split(self.theta_start), strict=True)
        ]
        kept = _kept_prior_rows(priors, self.unknowns.columns, self.names, self.first_prior_counts)
        return tuple(problem.n_data + rows for problem, rows in zip(self.problems, kept, strict=True))

    @cached_property
    def _is_one(self) -> bool:
        """Whether there is one problem alone, with its parameters in their order and each of its priors once."""
        if len(self.problems) > 1:
            return False
        [index], [rows], [problem] = self.unknowns.columns, self._kept_priors, self.problems
        n_rows = problem.n_data + len(problem.prior_rows(self.theta_start)[0])
        return np.array_equal(index, np.arange(len(problem.names))) and np.array_equal(
            rows, np.arange(problem.n_data, n_rows)
        )

    def _stacked(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Data rows of all problems, then the priors that are kept."""
        data = [part[: problem.n_data] for part, problem in zip(parts, self.problems, strict=True)]
        priors = [part[rows] for part, rows in zip(parts, self._kept_priors, strict=True)]
        return np.concatenate([*data, *priors])


def _joined_stage(whole: Sequence[Problem], paths: Sequence[Stages], stage: int) -> tuple[str, JointProblem]:
    """One stage of each path, its last one where it has fewer, or the whole problem where it has none."""
    reached = [path[min(stage, len(path) - 1)] if path else ("", one) for one, path in zip(whole, paths, strict=True)]
    words = ", ".join(dict.fromkeys(name for name, _ in reached if name))
    return words, JointProblem(tuple(problem for _, problem in reached), first_prior_counts=True)


def _widened(jacobian: FloatArray, index: IntArray, n_params: int) -> FloatArray:
    """`jacobian` by the parameters at `index` as one by all `n_params`."""
    wide = np.zeros((len(jacobian), n_params))
    wide[:, index] = jacobian
    return wide


def _widened_rows(rows: sparse.csr_array, index: IntArray, n_params: int) -> sparse.csr_array:
    """`rows` of the parameters at `index` as rows of all `n_params`."""
    return sparse.csr_array((rows.data, index[rows.indices], rows.indptr), (rows.shape[0], n_params))


def _kept_prior_rows(
    priors: Sequence[tuple[FloatArray, sparse.csr_array]],
    columns: Sequence[IntArray],
    names: tuple[str, ...],
    first_counts: bool,
) -> tuple[IntArray, ...]:
    """Of each problem the rows of those priors that no earlier problem states: residual and derivative at the start tell."""
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
