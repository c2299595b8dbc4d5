"""Fits to parts of the data: where the model is right they agree within their uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypedDict

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.dof import Dof
from structid.core.errors import StructidError
from structid.diagnose.thresholds import (
    FAR_APART,
    FEWEST_PART_LINES,
    MANIFOLD,
    PARTS_DIFFERENCE,
    PARTS_RISK,
)
from structid.forward import FrfProblem, RecordProblem
from structid.forward.fixed_values import tolerances_of
from structid.identification.joint_problem import joint_problem
from structid.inversion import LevenbergMarquardt, Problem, Search
from structid.inversion.estimate import estimate
from structid.inversion.fixed_values import widen_changes
from structid.inversion.search.within_tolerances import FixedValues
from structid.inversion.search.work import SERIAL, TaskContext, TaskExecutor

_METHOD = LevenbergMarquardt(max_iterations=30, gain_tolerance=1e-6)


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Two parts of the data whose fits do not agree.

    Attributes
    ----------
    parts : (str, str)
    name : str
        The parameter that differs most.
    values : (float, float)
    distance : float
        Difference of the two values of this parameter, in standard deviations of the difference.
    share : float
        Part of the parameters, those of damping aside, that differ beyond chance.
    unit : str
    """

    parts: tuple[str, str]
    name: str
    values: tuple[float, float]
    distance: float
    share: float
    unit: str = ""

    @property
    def is_gross(self) -> bool:
        """True if one value is more than 3 times the other, and they are more than 10 standard deviations apart.

        No interval of the answer covers both.
        """
        low, high = sorted(np.abs(self.values))
        return bool(high > MANIFOLD * low and self.distance > FAR_APART)


class _Fit(TypedDict, total=False):
    """Fit of a part of the data, with the keys of `_fit_part`; empty where it cannot be fitted."""

    values: FloatArray
    std: FloatArray
    changes: FloatArray
    errors: FloatArray


def disagreements(
    problems: Sequence[RecordProblem],
    theta: FloatArray,
    work: TaskExecutor = SERIAL,
    freed: Sequence[RecordProblem] = (),
) -> tuple[Disagreement, ...]:
    """Pairs of parts of the data whose fits give different values, beyond chance and by more than 3 %.

    The parts are the lower and the upper half of the band, and, for FRFs of more than three sensors without channel
    errors, every other sensor. The result has at most one entry for each pair, with the parameter that differs most (a
    damping only if no other does). The chance is 0.1 % for all parameters of a pair. A pair of which a part cannot be
    fitted is left out.

    Parameters
    ----------
    problems : sequence of RecordProblem
    theta : (n_params,) float array
        Free variables of all parameters together, from which each part is fitted.
    work : TaskExecutor
        Runs the fits of the parts.
    freed : sequence of RecordProblem
        The problems with the fixed values of their models among the unknowns: errors of these change all parts alike,
        and do not count as a difference. Without them fixed values are exact.
    """
    place = {name: i for i, name in enumerate(joint_problem(problems).names)}
    by_sensors = all(isinstance(p, FrfProblem) and len(p.record.outputs) > 3 and p.channels is None for p in problems)
    pairs = list(_pairs(problems, by_sensors))
    parts = [part for pair in pairs for _, part in pair]
    loose = [part for pair in _pairs(freed, by_sensors) for _, part in pair]
    known = tolerances_of(freed)
    held = tuple(FixedValues(part, known) if known else None for part in loose) or (None,) * len(parts)
    starts = [theta[[place[name] for name in part.names]] for part in parts]
    fits = iter(work.map("parts of the data", _fit_part, _Parts(tuple(parts), held), list(enumerate(starts))))
    found = []
    for first, second in pairs:
        one, other = next(fits), next(fits)
        if not one or not other:
            continue
        names, others = first[1].names, second[1].names
        shared = [name for name in names if name in others]
        mine, theirs = [names.index(name) for name in shared], [others.index(name) for name in shared]
        values = one["values"][mine], other["values"][theirs]
        difference = values[0] - values[1]
        std = np.hypot(one["std"][mine], other["std"][theirs])
        wider = np.maximum(one["errors"], other["errors"])
        changes, changes_there = (widen_changes(fit["changes"], fit["errors"], wider) for fit in (one, other))
        changes = changes[mine] - changes_there[theirs]
        std = np.sqrt(std**2 + (changes**2).sum(axis=1))
        distance = np.where(np.isfinite(std) & (std > 0), np.abs(difference) / np.where(std > 0, std, 1.0), 0.0)
        size = np.maximum(np.abs(values[0]), np.abs(values[1]))
        matters = np.abs(difference) > PARTS_DIFFERENCE * size
        beyond = (2 * special.ndtr(-distance) * len(shared) < PARTS_RISK) & matters
        if beyond.any():
            stiff = np.array([not is_damping(name) for name in shared])
            share = float(beyond[stiff].mean()) if stiff.any() else 1.0
            listed = stiff & beyond if (stiff & beyond).any() else beyond
            worst = int(np.argmax(np.where(listed, distance, -np.inf)))
            pair = float(values[0][worst]), float(values[1][worst])
            unit = first[1].unknowns.units[mine[worst]]
            distance_of_worst = float(distance[worst])
            found.append(Disagreement((first[0], second[0]), shared[worst], pair, distance_of_worst, share, unit))
    return tuple(found)


class _Parts(NamedTuple):
    """Problems of the parts of the data, each with the fixed values of its model; None where these count as exact."""

    problems: tuple[Problem, ...]
    held: tuple[FixedValues | None, ...]


def _fit_part(parts: _Parts, item: tuple[int, FloatArray], tools: TaskContext) -> _Fit:
    """Fit of one part of the data, as a dict of arrays; an empty dict where it fails.

    ``values`` and ``std`` (n_params,) are physical, with fixed values exact; ``changes`` (n_params, n_causes) are those
    by one ``errors`` (n_causes,) of each fixed value, and a last one for the second order (one column of zeros if all
    are exact). `item` is the number of the part, from 0, and the free variables at which its fit starts. `tools` is not
    used.
    """
    number, start = item
    search = Search(restarts=0, start=start)
    try:
        found = estimate(parts.problems[number], _METHOD, search=search, fixed=parts.held[number])
    except (StructidError, np.linalg.LinAlgError):
        return {}
    fixed = found.fixed
    changes, errors = (np.zeros((len(start), 1)), (0.0,)) if fixed is None else (fixed.changes, fixed.change_tolerances)
    return {"values": found.values, "std": found.spread.of_data.std, "changes": changes, "errors": np.array(errors)}


def is_damping(name: str) -> bool:
    """True if the parameter `name`, such as ``loss_factor[deck]``, is of damping, which small model errors distort first."""
    prop = name.partition("[")[0]
    return "damping" in prop or prop in ("loss_factor", "friction_force", "window_decay")


Part = tuple[str, Problem]


def _pairs(problems: Sequence[RecordProblem], by_sensors: bool) -> Iterator[tuple[Part, Part]]:
    """Pairs of parts of the data, each a name and a problem: lines up to the median and above it, two sets of sensors.

    The latter are the sensors of even and of odd index of the FRFs, with `by_sensors` only. Pairs of lines need 16 in
    each half of every record. No pair without problems.
    """
    if not problems:
        return
    frequency = np.sort(np.concatenate([problem.frequency for problem in problems]))
    if len(frequency) >= 2 * FEWEST_PART_LINES:
        middle = float(np.median(frequency))
        low, high = ([_select_lines(p, p.frequency <= middle if below else p.frequency > middle) for p in problems]
                     for below in (True, False))  # fmt: skip
        if all(part is not None for part in (*low, *high)):
            yield (f"below {middle:.4g} Hz", _whole(low)), (f"above {middle:.4g} Hz", _whole(high))
    frfs = [problem for problem in problems if isinstance(problem, FrfProblem)]
    if by_sensors:
        parts = [[_sensors(p, p.record.outputs[k::2]) for p in frfs] for k in (0, 1)]
        words = ["at " + join_words([str(dof).rstrip("+") for dof in one[0].record.outputs]) for one in parts]
        yield (words[0], joint_problem(parts[0])), (words[1], joint_problem(parts[1]))


def _sensors(problem: FrfProblem, outputs: tuple[Dof, ...]) -> FrfProblem:
    """The problem of the FRFs of the sensors `outputs` alone."""
    record = problem.record.channels(outputs)
    return replace(
        problem, record=record, channels=None if problem.channels is None else problem.channels.seen_by(record)
    )


def _whole(parts: Sequence[RecordProblem | None]) -> Problem:
    return joint_problem([part for part in parts if part is not None])


def _select_lines(problem: RecordProblem, keep: np.ndarray) -> RecordProblem | None:
    """Problem on the lines where `keep` (n_lines,) is True; None if it cannot be cut, or keeps fewer than 16 lines."""
    if keep.sum() < FEWEST_PART_LINES:
        return None
    cut = problem.with_lines(np.flatnonzero(keep))
    return None if cut is problem else cut
