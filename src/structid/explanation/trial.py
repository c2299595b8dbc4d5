"""A study with changes, and fits of it: near, with the start held, and as the study asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import StructidError
from structid.core.json_types import Plain
from structid.criticism.candidate import Candidate
from structid.criticism.fields import MOST_LINES
from structid.criticism.pool import MOST_DOFS
from structid.criticism.screen import Point, point_at
from structid.criticism.views import View, views
from structid.dynamics.receptance import DENSE_UP_TO
from structid.explanation.edits import edit
from structid.explanation.time_budget import time_limit_callback
from structid.forward import FrfProblem, ModalProblem, RecordProblem, ResponseCache
from structid.forward.frf.continuation import LEVELS
from structid.forward.frf.problem import smooth_stage
from structid.forward.polarities import decide_polarities
from structid.forward.scatter import ScatterProblem, scatter_problems
from structid.identification.joint_problem import harmonize_shared_parameters, joint_problem
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup, titles
from structid.identification.varying import with_scatters
from structid.inversion import JointProblem, LevenbergMarquardt, Problem
from structid.inversion.search.least_squares import minimize
from structid.inversion.search.levenberg_marquardt import Raced
from structid.inversion.search.minimum import Minimum
from structid.records import FrfRecord
from structid.study.run.start import loaded
from structid.study.schema.study import Study, edited_study
from structid.unknowns.named_unknowns import begun_at

#: Keys of a record that change its model, not what was measured.
_OF_MODEL = ("structure", "channel_error", "name")
#: Error of each value of an anchored fit, and of the start of each parameter, as parts of them.
_MODEL_ERROR, START_ERROR = 0.1, 0.2
FINAL = LevenbergMarquardt(max_iterations=40, gain_tolerance=1e-5)
#: Decays of the smoothed lines, in parts of their frequency, at which candidates are followed.
NEAR_LEVELS = (0.06, 0.015)
QUICK = Raced(max_iterations=12, gain_tolerance=1e-3, left_at=0.05)


class Approached(NamedTuple):
    """Where an anchored fit ended: free variables and misfit."""

    theta: FloatArray
    cost: float


@dataclass(frozen=True, eq=False)
class Trial:
    """A study, as it is or with changes, with its records.

    Attributes
    ----------
    study : Study
    setups : tuple of RecordSetup
    problems : tuple of RecordProblem
        With starts as the study has them.
    views : tuple of View
        Every record as FRFs.
    changes : tuple of (Candidate, float)
        What was changed, in order, with the strengths written.
    fit_seconds : float
        Processor time after which a fit is given up with `TimeUpError`.
    """

    study: Study
    setups: tuple[AnySetup, ...]
    problems: tuple[RecordProblem, ...]
    views: tuple[View, ...]
    changes: tuple[tuple[Candidate, float], ...] = ()
    fit_seconds: float = np.inf

    @cached_property
    def target(self) -> Problem:
        """All problems as one."""
        return joint_problem(self.problems)

    def changed(self, candidate: Candidate, strength: float) -> Trial:
        """The study with one change more.

        Raises
        ------
        StructidError
            If the study has no place for the change, or cannot be read with it.
        """
        tables = deepcopy(dict(self.study.root.table))
        edit(tables, candidate, strength)
        kept = [k for k in range(len(self.setups)) if candidate.kind != "record" or k != candidate.record]
        before = [(self.study.setups[k].section.table, self.setups[k]) for k in kept]
        problems, setups, edited = read_study(self.study, tables, before)
        problems = weighed_like(problems, [self.problems[k] for k in kept], scatter_problems(self.problems))
        shown = tuple(
            _same_view(problem, setup, self.setups[k], self.views[k], edited.options)
            for problem, setup, k in zip(problems, setups, kept, strict=True)
        )
        return Trial(edited, setups, problems, shown, (*self.changes, (candidate, strength)), self.fit_seconds)

    def values(self, theta: FloatArray) -> dict[str, float]:
        """Physical values of free variables, by name."""
        return dict(zip(self.target.names, self.target.physical(theta).tolist(), strict=True))

    def theta_of(self, known: Mapping[str, float]) -> FloatArray:
        """Free variables with physical values by name, the study's starts for those not known."""
        return joint_problem([started_at(problem, known) for problem in self.problems]).theta_start

    @property
    def is_large(self) -> bool:
        """Whether only changes of its records are looked at."""
        return any(setup.structure.n_dofs > MOST_DOFS for setup in self.setups)

    @property
    def is_small(self) -> bool:
        """Whether a linear look beside a change takes little."""
        return are_small(self.setups)

    @property
    def is_of_modes(self) -> bool:
        """Whether all records are of modes."""
        return all(isinstance(problem, ModalProblem) for problem in self.problems)

    def smoothed(self, levels: Sequence[float] = LEVELS) -> list[tuple[float, JointProblem]]:
        """Stages on smoothed data with their decays, from far to near; those that the lines of every record allow."""
        if self.is_of_modes:
            return []
        shared = [level for level in levels if all(level in view.smooth for view in self.views)]
        stages = [
            [smooth_stage(view.problem, view.smooth[level], START_ERROR) for view in self.views] for level in shared
        ]
        return [
            (level, JointProblem(tuple(stage), first_prior_counts=True))
            for level, stage in zip(shared, stages, strict=True)
        ]

    def anchored(self) -> JointProblem:
        """All of `anchored_problems` as one."""
        return JointProblem(self.anchored_problems(), first_prior_counts=True)

    def anchored_problems(self) -> tuple[RecordProblem, ...]:
        """The logarithm of some hundred lines of the FRFs with 10 % of model error, as if of all lines; modes as they are.

        Every parameter is held near its start.
        """
        held: list[RecordProblem] = []
        for of, view in zip(self._fitted_near(), self.views, strict=True):
            near = [part.kept_near_start(START_ERROR if i == 0 else 1.0) for i, part in enumerate(of.parts)]
            one = of.with_parts(near)
            held.append(_on_lines(one, view.near) if isinstance(one, FrfProblem) else one)
        return tuple(held)

    def _fitted_near(self) -> list[RecordProblem]:
        """What near fits take of every record: modes as they are, the FRFs of all others."""
        pairs = zip(self.problems, self.views, strict=True)
        return [problem if isinstance(problem, ModalProblem) else view.problem for problem, view in pairs]

    @property
    def seen(self) -> tuple[FrfProblem, ...]:
        """The views as they are."""
        return tuple(view.problem for view in self.views)

    def anchored_views(self) -> tuple[FrfProblem, ...]:
        """The views in the form of the anchored fit."""
        return tuple(replace(one, form="log", model_error=_MODEL_ERROR) for one in self.seen)

    def looked_at(self, problems: Sequence[FrfProblem], theta: FloatArray, most_lines: int = MOST_LINES) -> Point:
        """Views in some form where changes are screened; modes whose damping is not fitted say nothing of damping."""
        silent = [
            k for k, one in enumerate(self.problems) if isinstance(one, ModalProblem) and not one.settings.use_damping
        ]
        return point_at(problems, theta, silent, most_lines)

    def approached(self, above: float = np.inf) -> Approached:
        """The anchored fit, come to by the nearest smoothed stages; it ends early where its misfit would stay `above`."""
        theta, stop = np.asarray(self.target.theta_start), time_limit_callback(self.fit_seconds)
        for _, stage in self.smoothed(NEAR_LEVELS):
            theta = minimize(stage, QUICK, theta, stop).theta
        near = minimize(self.anchored(), replace(QUICK, above=above), theta, stop)
        return Approached(near.theta, float(near.costs[-1]))

    def fitted(self, starts: Sequence[FloatArray]) -> Minimum:
        """The best fit as the study asks for from some starts.

        Raises
        ------
        StructidError
            If the model can be evaluated at none of them.
        """
        found: list[Minimum] = []
        last: Exception | None = None
        for theta in starts:
            try:
                found.append(minimize(self.target, FINAL, theta, time_limit_callback(self.fit_seconds)))
            except (StructidError, np.linalg.LinAlgError) as error:
                last = error
        if not found:
            raise StructidError(f"no start can be evaluated: {last}") from last
        return min(found, key=lambda minimum: minimum.costs[-1])


def started_at(problem: RecordProblem, known: Mapping[str, float]) -> RecordProblem:
    """The problem with its start at physical values by name, its own start for those not known."""
    common = {own: name for one in problem.parameters.scatters for own, name in zip(one.own, one.common, strict=True)}
    known = {**{own: known[name] for own, name in common.items() if name in known}, **known}
    return problem.with_parts([begun_at(part, known) for part in problem.parts])


def base_trial(study: Study, setups: Sequence[AnySetup], problems: Sequence[RecordProblem], theta: FloatArray) -> Trial:
    """The study as it is, with free variables of all its parameters at which its records are looked at as FRFs."""
    own = JointProblem(tuple(problems), first_prior_counts=True).unknowns.split(theta)
    shown = views(setups, problems, own, study.options)
    return Trial(study, tuple(setups), tuple(problems), shown)


def are_small(setups: Sequence[AnySetup]) -> bool:
    """Whether all models are small enough that linear looks take little."""
    return all(setup.structure.n_dofs <= DENSE_UP_TO for setup in setups)


def read_study(
    study: Study, tables: Mapping[str, Plain], before: Sequence[tuple[Mapping[str, Plain], AnySetup]]
) -> tuple[tuple[RecordProblem, ...], tuple[AnySetup, ...], Study]:
    """The study with other tables; records whose tables are as before are not read again."""
    edited = edited_study(study, tables)
    setups, cache = [], ResponseCache()
    for source, (table, measured) in zip(edited.setups, before, strict=True):
        is_same = _of_record(source.section.table) == _of_record(table)
        setups.append(loaded(source, cache, measured if is_same else None))
    problems = harmonize_shared_parameters([setup.prepared(edited.options).problem for setup in setups], titles(setups))
    return tuple(decide_polarities(problem, problem.theta_start) for problem in problems), tuple(setups), edited


def _on_lines(problem: FrfProblem, frequency: FloatArray) -> FrfProblem:
    """The logarithm of the FRFs at those of these frequencies that it has, which weigh as all of its lines do."""
    keep = np.flatnonzero(np.isin(problem.frequency, frequency))
    error = _MODEL_ERROR * float(np.sqrt(len(keep) / len(problem.frequency)))
    return replace(problem.with_lines(keep), form="log", model_error=error)


def _same_view(problem: RecordProblem, setup: AnySetup, before: AnySetup, view: View, options: IdentifyOptions) -> View:
    """The view of a changed problem: the same FRFs where the record is the same."""
    if isinstance(problem, FrfProblem):
        known = view.problem.record
        if _is_same(problem.record, known):
            return View(replace(problem, record=known), view.smooth, view.near)
        return View(problem, chosen=view.near)
    if setup.record is before.record:
        return view.of(problem)
    return views([setup], [problem], [problem.theta_start], options)[0]


def weighed_like(
    problems: Sequence[RecordProblem], before: Sequence[RecordProblem], scatters: Sequence[ScatterProblem]
) -> tuple[RecordProblem, ...]:
    """Changed problems with the weights of those that they are compared with, where both have the same data."""
    weighed = tuple(_of_weights(one, other) for one, other in zip(problems, before, strict=True))
    return with_scatters(weighed, {one.name: one.std for one in scatters})


def _of_weights(problem: RecordProblem, before: RecordProblem) -> RecordProblem:
    if isinstance(problem, FrfProblem) and isinstance(before, FrfProblem) and _is_same(problem.record, before.record):
        return replace(problem, record=replace(problem.record, sizes=before.record.sizes))
    return problem


def _is_same(one: FrfRecord, other: FrfRecord) -> bool:
    return one is other or (
        one.values.shape == other.values.shape and one.outputs == other.outputs and one.inputs == other.inputs
        and one.segment == other.segment and np.array_equal(one.frequency, other.frequency)
        and np.array_equal(one.values, other.values)
    )  # fmt: skip


def _of_record(table: Mapping[str, Plain]) -> dict[str, Plain]:
    return {key: value for key, value in table.items() if key not in _OF_MODEL}
