"""A study with changes, and fits of it: near, with the start held, and as the study asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from structid.arrays import FloatArray
from structid.criticism.candidate import Candidate
from structid.errors import StructidError
from structid.estimation import JointProblem, LevenbergMarquardt, Problem
from structid.estimation.search.least_squares import minimize
from structid.estimation.search.minimum import Minimum
from structid.explanation.edits import edit
from structid.identification.setups import AnySetup
from structid.identification.together import alike, together
from structid.observation import FrfProblem, RecordProblem
from structid.observation.frf.continuation import LEVELS, smoothed_records
from structid.observation.frf.problem import smooth_stage
from structid.records import FrfRecord
from structid.study.run.run import loaded
from structid.study.schema.study import Study, load_study

#: Keys of a record that change its model, not what was measured.
_OF_MODEL = ("structure", "channel_error", "name")
#: Error of each value of an anchored fit, and of the start of each parameter, as parts of them.
_MODEL_ERROR, START_ERROR = 0.1, 0.2
_QUICK = LevenbergMarquardt(max_iterations=12, gain_tolerance=1e-3)
_FINAL = LevenbergMarquardt(max_iterations=60, gain_tolerance=1e-6)
#: Decays of the smoothed lines, in parts of their frequency, at which candidates are followed.
NEAR_LEVELS = (0.06, 0.015)


@dataclass(frozen=True, eq=False)
class Trial:
    """A study, as it is or with changes, with its records.

    Attributes
    ----------
    study : Study
    setups : tuple of RecordSetup
    problems : tuple of RecordProblem
        With starts as the study has them.
    changes : tuple of (Candidate, float)
        What was changed, in order, with the strengths written.
    known : tuple of (FrfRecord, dict)
        Smoothed data that need not be found again.
    """

    study: Study
    setups: tuple[AnySetup, ...]
    problems: tuple[RecordProblem, ...]
    changes: tuple[tuple[Candidate, float], ...] = ()
    known: tuple[tuple[FrfRecord, dict[float, FrfRecord]], ...] = ()

    @cached_property
    def target(self) -> Problem:
        """All problems as one."""
        return together(self.problems)

    @cached_property
    def frfs(self) -> tuple[FrfProblem, ...]:
        """The problems where all are of FRFs; else none."""
        found = tuple(problem for problem in self.problems if isinstance(problem, FrfProblem))
        return found if len(found) == len(self.problems) else ()

    def changed(self, candidate: Candidate, strength: float) -> Trial:
        """The study with one change more.

        Raises
        ------
        StructidError
            If the study has no place for the change, or cannot be read with it.
        """
        tables = deepcopy(dict(self.study.root.table))
        edit(tables, candidate, strength)
        made = read_trial(self.study, tables, self.setups)
        problems = tuple(_on_same_record(new, self.frfs) for new in made.problems)
        known = tuple(zip((p.record for p in self.frfs), self.smooth, strict=True))
        return replace(made, problems=problems, changes=(*self.changes, (candidate, strength)), known=known)

    def theta_of(self, known: Mapping[str, float]) -> FloatArray:
        """Free variables with physical values by name, the study's starts for those not known."""
        return together([_started(problem, known) for problem in self.problems]).theta_start

    @cached_property
    def smooth(self) -> tuple[dict[float, FrfRecord], ...]:
        """Smoothed data of every record by their decay; see `smoothed_records`."""
        known = {id(record): data for record, data in self.known}
        return tuple(known.get(id(one)) or dict(smoothed_records(one)) for one in (p.record for p in self.frfs))

    def smoothed(self, levels: Sequence[float] = LEVELS) -> list[tuple[float, JointProblem]]:
        """Stages on smoothed data with their decays, from far to near; those that the lines of every record allow."""
        shared = [level for level in levels if self.frfs and all(level in data for data in self.smooth)]
        return [
            (level, JointProblem(tuple(
                smooth_stage(problem, data[level], START_ERROR)
                for problem, data in zip(self.frfs, self.smooth, strict=True)
            ), first_prior_counts=True))
            for level in shared
        ]  # fmt: skip

    def anchored(self) -> Problem:
        """The logarithm of the FRFs with 10 % of model error and every parameter held near its start."""
        held = [p.with_parts([part.kept_near_start(START_ERROR if i == 0 else 1.0) for i, part in enumerate(p.parts)])
                for p in self.problems]  # fmt: skip
        if self.frfs:
            held = [replace(p, form="log", model_error=_MODEL_ERROR) for p in held if isinstance(p, FrfProblem)]
        return JointProblem(tuple(held), first_prior_counts=True)

    def approached(self) -> tuple[FloatArray, float]:
        """Free variables and misfit of the anchored fit, come to by the nearest smoothed stages."""
        theta = np.asarray(self.target.theta_start)
        for _, stage in self.smoothed(NEAR_LEVELS):
            theta = minimize(stage, _QUICK, theta).theta
        found = minimize(self.anchored(), _QUICK, theta)
        return found.theta, float(found.costs[-1])

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
                found.append(minimize(self.target, _FINAL, theta))
            except (StructidError, np.linalg.LinAlgError) as error:
                last = error
        if not found:
            raise StructidError(f"no start can be evaluated: {last}") from last
        return min(found, key=lambda minimum: minimum.costs[-1])


def _started(problem: RecordProblem, known: Mapping[str, float]) -> RecordProblem:
    parts = []
    for part in problem.parts:
        values = np.array([known.get(name, start) for name, start in zip(part.names, part.start, strict=True)])
        inside = (values > part.transforms.lower) & (values < part.transforms.upper)
        parts.append(part.started_at(np.where(inside, values, part.start)))
    return problem.with_parts(parts)


def read_trial(study: Study, tables: Mapping[str, Any], measured: Sequence[AnySetup]) -> Trial:
    """The study with other tables; records that are the same are not read again."""
    edited = load_study(study.path, tables)
    setups = []
    for number, source in enumerate(edited.setups):
        same = number < len(measured) and _of_record(source.section.table) == _of_record(
            study.setups[number].section.table
        )
        setups.append(loaded(source, measured[number] if same else None))
    problems = alike([setup.prepared(edited.options).problem for setup in setups])
    decided = tuple(problem.decided(problem.theta_start) for problem in problems)
    return Trial(edited, tuple(setups), decided)


def _on_same_record(problem: RecordProblem, known: Sequence[FrfProblem]) -> RecordProblem:
    """The problem with a record that is known already, where that is the same."""
    if isinstance(problem, FrfProblem):
        for other in known:
            if other.record.values is problem.record.values or _is_same(other.record, problem.record):
                return replace(problem, record=other.record)
    return problem


def _is_same(one: FrfRecord, other: FrfRecord) -> bool:
    return (
        one.values.shape == other.values.shape and one.outputs == other.outputs and one.inputs == other.inputs
        and np.array_equal(one.frequency, other.frequency) and np.array_equal(one.values, other.values)
    )  # fmt: skip


def _of_record(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in _OF_MODEL}
