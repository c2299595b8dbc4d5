"""The joint problem of several records: shared parameters have one start and one prior, and every record counts once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.display import join_words
from structid.core.errors import InputError
from structid.forward import RecordProblem
from structid.forward.fixed_values import tolerances_of, with_fixed_values
from structid.forward.scatter import ScatterProblem, scatter_problems
from structid.identification.setups.setup import AnySetup, titles
from structid.identification.varying import varying
from structid.inversion import JointProblem, Problem
from structid.inversion.fixed_values import FixedValueInfluence
from structid.inversion.problem import ContinuationPath, Schedule
from structid.inversion.search.within_tolerances import FixedValues
from structid.unknowns.named_unknowns import N, NamedUnknowns
from structid.unknowns.priors import Prior, priors_of
from structid.unknowns.tolerances import Tolerances, fixed_properties


def joint_problem(problems: Sequence[RecordProblem]) -> Problem:
    """The joint problem of all records and of the scatters between them; of one record its own problem."""
    parts = _parts(problems)
    return parts[0] if len(parts) == 1 else JointProblem(parts)


def joint_schedules(problems: Sequence[RecordProblem]) -> Sequence[Schedule]:
    """Sequences of search stages for the joint problem: those of the records' problems, joined stage by stage.

    A problem with fewer sequences or stages than another repeats its last one; a problem without any takes part as it
    is. For a single problem they are its own.
    """
    parts = _parts(problems)
    if len(parts) == 1:
        return problems[0].schedules()
    schedules = [part.schedules() if isinstance(part, RecordProblem) else () for part in parts]
    joint = []
    for number in range(max(map(len, schedules))):
        chosen = [every[min(number, len(every) - 1)] if every else () for every in schedules]
        joint.append(tuple(_joint_stage(parts, chosen, k) for k in range(max(map(len, chosen)))))
    return tuple(joint)


def joint_paths(problems: Sequence[RecordProblem]) -> Sequence[ContinuationPath]:
    """Continuation paths of the joint problem: its schedules, and those made for a start where there is one problem."""
    return problems[0].continuation_paths() if len(_parts(problems)) == 1 else joint_schedules(problems)


def joint_sample(problems: Sequence[RecordProblem]) -> Problem | None:
    """The joint problem in which each large problem has a part of its data only, for quick searches.

    None where every problem is small enough to be taken whole.
    """
    parts = _parts(problems)
    samples = [part.subsampled() if isinstance(part, RecordProblem) else None for part in parts]
    if all(sample is None for sample in samples):
        return None
    if len(parts) == 1:
        return samples[0]
    return JointProblem(tuple(sample or whole for sample, whole in zip(samples, parts, strict=True)))


def joint_obstacle(problems: Sequence[RecordProblem]) -> str:
    """Reason why a matrix-free search of all problems together is impossible; "" if it is possible.

    It goes on a sentence that begins with the search, and is that of the first problem that has one; unknowns that vary
    from record to record are the last reason.
    """
    obstacles = [problem.matrix_free_obstacle for problem in problems]
    if scatter_problems(problems):
        obstacles.append("takes no unknown that varies from record to record")
    return next(filter(None, obstacles), "")


def _parts(problems: Sequence[RecordProblem]) -> tuple[RecordProblem | ScatterProblem, ...]:
    """Problems of the records, then those of the scatters between them."""
    return (*problems, *scatter_problems(problems))


def _joint_stage(parts: Sequence[Problem], schedules: Sequence[Schedule], stage: int) -> tuple[str, JointProblem]:
    """Name and joint problem of stage number `stage`, from 0; a shorter schedule stays in its last stage.

    `parts` are the problems of the records, each with its entry in `schedules`; one with an empty schedule is taken as
    it is. Different names are joined by commas.
    """
    reached = [
        schedule[min(stage, len(schedule) - 1)] if schedule else ("", part)
        for part, schedule in zip(parts, schedules, strict=True)
    ]
    names = ", ".join(dict.fromkeys(name for name, _ in reached if name))
    return names, JointProblem(tuple(problem for _, problem in reached), first_prior_counts=True)


def indices_of(names: tuple[str, ...], wanted: Sequence[str]) -> IntArray:
    """Indices (n_wanted,) in `names` of the names `wanted`."""
    index_of = {name: i for i, name in enumerate(names)}
    return np.array([index_of[name] for name in wanted], dtype=int)


def first_values(
    names: tuple[str, ...], problems: Sequence[RecordProblem], values: Callable[[NamedUnknowns], FloatArray]
) -> FloatArray:
    """Value of each parameter in `names`, (n_params,), from the first problem that has it.

    `values` gives the array of all unknowns of a problem, in their order.
    """
    known: dict[str, float] = {}
    for problem in problems:
        for name, value in zip(problem.names, values(problem.unknowns), strict=True):
            known.setdefault(name, value)
    return np.array([known[name] for name in names])


def harmonize_shared_parameters(problems: Sequence[RecordProblem], titles: Sequence[str]) -> tuple[RecordProblem, ...]:
    """Copies of the problems in which parameters of one name share start, scale and prior.

    Start and scale are those of the first problem that has the parameter; the prior is the one that any states. A
    parameter that varies from record to record has a value of its own in each of them. A single problem keeps its
    starts and priors.

    Parameters
    ----------
    problems : sequence of RecordProblem
        Problem of each record.
    titles : sequence of str
        Name of each record.

    Raises
    ------
    InputError
        If two of them state different priors or scatters of one parameter, or too few records have one that varies.
    """
    problems = varying(problems, titles)
    if len(problems) == 1:
        return tuple(problems)
    first: dict[str, tuple[NamedUnknowns, int]] = {}
    priors: dict[str, Prior] = {}
    for part in (part for problem in problems for part in problem.parts):
        for i, name in enumerate(part.names):
            first.setdefault(name, (part, i))
            stated = part.priors.one(i)
            if stated is not None and priors.setdefault(name, stated) != stated:
                raise InputError(f"prior of {name} must be the same in all set-ups, got two; state it once, or alike")
    return tuple(
        problem.with_parts([_begun_alike(part, first, priors) for part in problem.parts]) for problem in problems
    )


def _begun_alike(unknowns: N, first: Mapping[str, tuple[NamedUnknowns, int]], priors: Mapping[str, Prior]) -> N:
    """Copy of `unknowns` with start and scale from the first problem that has each, and with `priors` (by name).

    `first` gives, by name, the unknowns of the first problem and the index among them. An unknown that `priors`
    lacks has none.
    """
    if not unknowns.names:
        return unknowns
    origin = [first[name] for name in unknowns.names]
    return replace(
        unknowns,
        start=locked([one.start[i] for one, i in origin], float),
        scale=locked([one.scale[i] for one, i in origin], float),
        priors=priors_of(priors.get(name) for name in unknowns.names),
    )


def freed_problems(
    setups: Sequence[AnySetup],
    problems: Sequence[RecordProblem],
    tolerances: Tolerances,
    has_gain: Sequence[bool] | None = None,
) -> tuple[RecordProblem, ...]:
    """Problem of each record with the fixed values of its model among its unknowns; see `with_fixed_values`.

    `has_gain` has an entry for each record: True if its common gain may be among them, which is the default.
    """
    named = zip(setups, titles(setups), problems, has_gain or [True] * len(setups), strict=True)
    return tuple(
        with_fixed_values(problem, tolerances, setup.calibration if is_free else 0.0, title)
        for setup, title, problem, is_free in named
    )


def taken_as_exact(problems: Sequence[RecordProblem], tolerances: Tolerances, carried: Sequence[str]) -> str:
    """Clause that names the fixed values whose tolerance the search did not include, all except `carried`.

    It is "" if there are none. `tolerances` are for sets that state none, `carried` are labels such as ``mass[deck]``.
    If a model has no matrices, as that of a solver that gives FRFs alone, the clause names this whole model.
    """
    if not all(problem.structure.has_matrices for problem in problems):
        return "the model behind the FRFs of the solver is taken as exact"
    labels = dict.fromkeys(
        item.label
        for problem in problems
        for item in fixed_properties(problem.structure, problem.parameters, tolerances)
        if item.label not in carried
    )
    return f"fixed {join_words(list(labels))} taken as exact, without the tolerance" if labels else ""


def tolerances_clause(
    influence: FixedValueInfluence, problems: Sequence[RecordProblem], tolerances: Tolerances | None
) -> str:
    """Clause on the tolerances that standard deviations include, and on the fixed values that they take as exact.

    Without `tolerances` the second part is left out.
    """
    exact = "" if tolerances is None else taken_as_exact(problems, tolerances, influence.names)
    return f"± includes {influence.words}" + (f"; {exact}" if exact else "")


def fixed_values(freed: Sequence[RecordProblem]) -> FixedValues | None:
    """Fixed values that are unknowns of the `freed` problems, for the joint problem of all records; None if there are none."""
    known = tolerances_of(freed)
    return FixedValues(joint_problem(freed), known, joint_sample(freed)) if known else None
