"""Runs about the centre of each parameter, with steps that are made smaller or larger until their differences can be used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from structid.core.errors import InputError
from structid.external.deck import DeckParameter
from structid.external.expansion import Point
from structid.external.runs import RunCounts, RunFailedError, Solver, needed_runs, point_words, runs
from structid.inversion.search.work import TaskExecutor

R = TypeVar("R")

#: How often a step is changed, and between which parts of a value it stays.
_TRIALS, _SMALLEST_STEP, _LARGEST_STEP = 4, 1e-4, 0.3


@dataclass(frozen=True)
class StepRules:
    """Rules for the steps of differences: sizes, and the change of results that each should make.

    Attributes
    ----------
    first : float
        First step, as a part of the value.
    least, most : float
        Relative changes between which differences can be used; steps outside are made larger or smaller.
    no_effect : float
        Below this a parameter does nothing, even with the largest step.
    what : str
        What changes, for messages.
    """

    first: float
    least: float
    most: float
    no_effect: float
    what: str


@dataclass(frozen=True, eq=False)
class Pair(Generic[R]):
    """Runs on both sides of the centre, or two on one side, for a parameter.

    Attributes
    ----------
    name : str
    changes : (float, float)
        Two changes of the parameter from its value at the centre, in its unit.
    runs : (R, R)
        Results with each of the changes, all other parameters at the centre.
    """

    name: str
    changes: tuple[float, float]
    runs: tuple[R, R]


@dataclass(frozen=True, eq=False)
class Differences(Generic[R]):
    """Runs about a centre, and the steps of the parameters that they have.

    Attributes
    ----------
    at : mapping of str to float
        The centre, as the deck shows it.
    centre : R
    pairs : tuple of Pair
        One a parameter.
    counts : RunCounts
    """

    at: Mapping[str, float]
    centre: R
    pairs: tuple[Pair[R], ...]
    counts: RunCounts

    @property
    def references(self) -> dict[str, float]:
        """Value of each parameter at the centre, 1 in place of 0, in which its powers are measured."""
        return {pair.name: self.at[pair.name] or 1.0 for pair in self.pairs}

    @property
    def words(self) -> str:
        """Words on the centre and on the largest step of each parameter."""
        steps = ", ".join(f"{difference.name} {max(map(abs, difference.changes)):.2g}" for difference in self.pairs)
        return f"differences about {point_words(self.at)} with steps {steps}"


def take_differences(
    solver: Solver,
    read: Callable[[Path], R],
    change: Callable[[R, R, Point], float],
    rules: StepRules,
    work: TaskExecutor,
) -> Differences[R]:
    """Results of solver runs at the centre of all parameters and at two steps of each, with steps of usable size.

    Steps that change the results too little or too much, or at which the solver fails, are changed and repeated, in at
    most four rounds.

    Parameters
    ----------
    solver : Solver
        Deck with its parameters, command and folder of the runs.
    read : callable
        Returns the result in the folder of a run.
    change : callable
        Returns the relative change from the result at the centre (first) to that of a run (second) at a point (third).
    rules : StepRules
        Sizes of steps, and the changes that they should make.
    work : TaskExecutor
        Executor of the runs.

    Raises
    ------
    InputError
        If a run fails at the centre or at the smallest step, a parameter has no effect, or no step can be used.
    """
    centre = solver.deck.shown({parameter.name: parameter.centre for parameter in solver.deck.parameters})
    folders, counts = needed_runs(solver, [centre], work)
    read_at_centre = read(folders[0])
    pending = {parameter.name: _Step(parameter, centre[parameter.name], rules) for parameter in solver.deck.parameters}
    done: dict[str, Pair[R]] = {}
    for _ in range(_TRIALS):
        points = [
            (key, centre | {key: value}) for key, step in pending.items() for value in step.values(solver, centre)
        ]
        results, more = runs(solver, [point for _, point in points], work)
        counts = counts + more
        for key, step in list(pending.items()):
            trials = [(p, g) for (k, p), g in zip(points, results, strict=True) if k == key]
            errors = [g for _, g in trials if isinstance(g, RunFailedError)]
            if errors and not step.can_shrink:
                raise errors[0]
            if errors:
                step.shrink()
                continue
            first, second = (read(folder) for _, folder in trials if isinstance(folder, Path))
            changes = [
                change(read_at_centre, run, point) for (point, _), run in zip(trials, (first, second), strict=True)
            ]
            low, high = (point[key] - centre[key] for point, _ in trials)
            if step.settles(max(changes)):
                done[key] = Pair(key, (low, high), (first, second))
                del pending[key]
        if not pending:
            break
    else:
        raise InputError(f"no step of {', '.join(pending)} gives differences that can be used; give `step`")
    return Differences(centre, read_at_centre, tuple(done.values()), counts)


class _Step:
    """The step of one parameter's differences, on the way to one that can be used."""

    def __init__(self, parameter: DeckParameter, centre: float, rules: StepRules) -> None:
        """The first step of `parameter` about the value `centre`: the parameter's `step`, or that of the `rules`.

        It is relative to the centre. It is absolute where the centre is 0; `InputError` if the parameter has no step
        then.
        """
        self.parameter, self.centre, self.rules = parameter, centre, rules
        if not centre and parameter.step is None:
            raise InputError(f"parameter {parameter.name!r} is 0; give `step`, by how much it changes, in its unit")
        self.unit = abs(centre) or 1.0
        self.part = rules.first if parameter.step is None else parameter.step
        self.tried: set[float] = set()

    @property
    def can_shrink(self) -> bool:
        return self.part > _SMALLEST_STEP and len(self.tried) < _TRIALS

    def values(self, solver: Solver, centre: Mapping[str, float]) -> list[float]:
        """Two values of the parameter: a step above and a step below the centre, or one and two steps to one side near a bound.

        They are one-sided if a bound is nearer than the step; the step is then at most half the distance to the other bound.
        `centre` has the values of all parameters by name. The values are rounded as the deck shows them; `InputError` if the
        digits of the mark do not resolve the step.
        """
        self.tried.add(self.part)
        low, high = self.parameter.limits
        size = self.part * self.unit
        room_above, room_below = high - self.centre, self.centre - low
        if min(room_above, room_below) < size:
            sense = 1.0 if room_above > room_below else -1.0
            size = min(size, max(room_above, room_below) / 2)
            values = [self.centre + sense * size, self.centre + 2 * sense * size]
        else:
            values = [self.centre + size, self.centre - size]
        as_written = [solver.deck.shown({**centre, self.parameter.name: v})[self.parameter.name] for v in values]
        if len({*as_written, self.centre}) < 3:
            raise InputError(
                f"a step of {size:g} of {self.parameter.name!r} does not show in the digits of its mark; widen it, as in"
                f" {{{{{self.parameter.name}:16}}}}, or give `step`"
            )
        return as_written

    def shrink(self) -> None:
        self.part /= 4

    def settles(self, change: float) -> bool:
        """True if the step can be used for differences; False if it was changed and the runs must be repeated.

        It can be used if `change`, the largest relative change of the results by the step, is from `rules.least` to
        `rules.most`. A larger change makes the step a quarter of it, a smaller one ten times it, up to 0.3 of the value; a step
        that cannot be changed further, or was tried before, is used as it is. `InputError` if even the largest step changes the
        results by less than `rules.no_effect`.
        """
        rules = self.rules
        if change > rules.most and self.part > _SMALLEST_STEP and self.part / 4 not in self.tried:
            self.shrink()
            return False
        if change < rules.least and self.part < _LARGEST_STEP:
            self.part = min(10 * self.part, _LARGEST_STEP)
            return self.part in self.tried
        if change < rules.no_effect:
            raise InputError(
                f"parameter {self.parameter.name!r} has no effect: no {rules.what} changes by more than {change:.1g} of its value"
                f" where it changes by {self.part:.2g}; look for the mark in a part of the deck that is not used, or take the"
                " parameter out"
            )
        return True
