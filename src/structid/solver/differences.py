"""A model of a solver's modes by differences: exact about the values of its parameters where they are taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from structid.arrays import FloatArray
from structid.errors import InputError
from structid.estimation.search.work import Work
from structid.solver.deck import DeckParameter
from structid.solver.expansion import Point, Powers, shifted
from structid.solver.model import Part, SolverModel
from structid.solver.outputs import ModesOut
from structid.solver.runs import RunFailedError, Solver, runs
from structid.solver.shapes import Shapes, require_same_dofs
from structid.solver.solved import Checked, Solved, Units, model_parameters, needed_runs, point_words, run_words
from structid.solver.tangent import Differences, tangent
from structid.structure.importers.exports import LENGTHS

#: First step of differences of modes, as a part of the value.
STEP = 0.01
#: Relative changes of frequencies that steps should make; those outside are made larger or smaller, so many times.
_LEAST_CHANGE, _MOST_CHANGE, _TRIALS = 1e-5, 0.1, 4
_LARGEST_STEP = 0.3
_NO_EFFECT = 2e-7


@dataclass(frozen=True, eq=False)
class SolvedModes(Solved):
    """Of modes.

    Attributes
    ----------
    out : ModesOut
    n_modes : int
        Modes that the model has.
    """

    out: ModesOut
    n_modes: int

    @property
    def is_exact(self) -> bool:
        return False

    def checked(self, values: Point, work: Work) -> Checked:
        [folder], _ = needed_runs(self.solver, [values], work)
        given = self.out.read(folder).frequency[: self.n_modes]
        squared = eigh(*(self.model.matrix(key, values).toarray() for key in ("stiffness", "mass")), eigvals_only=True)
        own = np.sqrt(np.maximum(squared[: len(given)], 0.0)) / (2 * np.pi)
        moves = given > 1e-3 * given.max()
        worst = float(np.abs(own[moves] / given[moves] - 1).max())
        return Checked(
            worst, f"the solver with the updated deck gives the model's frequencies to {worst:.2g} of their value"
        )


def solved_modes(name: str, solver: Solver, out: ModesOut, units: Units, work: Work) -> SolvedModes:
    """The model of modes about the centre of each parameter, from differences.

    Raises
    ------
    InputError
        If a run fails, gives other nodes than the first, or a parameter changes no frequency.
    """
    centre = solver.deck.shown({one.name: one.centre for one in solver.deck.parameters})
    folders, counts = needed_runs(solver, [centre], work)
    at = out.read(folders[0])
    pending = {one.name: _Step(one, centre[one.name]) for one in solver.deck.parameters}
    done: dict[str, Differences] = {}
    for _ in range(_TRIALS):
        asked = [(key, centre | {key: value}) for key, step in pending.items() for value in step.values(solver, centre)]
        given, more = runs(solver, [point for _, point in asked], work)
        counts = counts + more
        for key, step in list(pending.items()):
            own = [(p, g) for (k, p), g in zip(asked, given, strict=True) if k == key]
            errors = [g for _, g in own if isinstance(g, RunFailedError)]
            if errors and not step.can_shrink:
                raise errors[0]
            if errors:
                step.shrink()
                continue
            first, second = (out.read(folder) for _, folder in own if isinstance(folder, Path))
            for (point, _), run in zip(own, (first, second), strict=True):
                require_same_dofs(at, run, point_words(point))
            low, high = (point[key] - centre[key] for point, _ in own)
            if step.settles(_change(at, (first, second))):
                done[key] = Differences(key, (low, high), (first, second))
                del pending[key]
        if not pending:
            break
    else:
        raise InputError(f"no step of {', '.join(pending)} gives differences that can be used; give `step`")
    turned = [
        replace(d, runs=(_shapes_in_si(d.runs[0], units), _shapes_in_si(d.runs[1], units))) for d in done.values()
    ]
    small = tangent(f"shapes of {name}", _shapes_in_si(at, units), turned)
    references = {one.name: centre[one.name] or 1.0 for one in solver.deck.parameters}
    parts = []
    for key, table in (("mass", small.mass), ("stiffness", small.stiffness)):
        about_zero: dict[Powers, FloatArray] = {}
        for powers, matrix in table.items():
            for shift, factor in shifted(powers, centre, references):
                about_zero[shift] = about_zero.get(shift, 0.0) + factor * matrix
        parts += [Part(key, shift, sparse.csc_array(matrix)) for shift, matrix in about_zero.items()]
    model = SolverModel(name, small.masters, tuple(parts), model_parameters(solver, references), reduced=True)
    frequency = ", ".join(f"{f:.5g}" for f in at.frequency[: small.n_modes])
    fact = (
        f"solver: {run_words(counts)}; modes at {frequency} Hz, {len(at.dofs)} degrees of freedom; differences about"
        f" {point_words(centre)} with steps {', '.join(f'{n} {max(map(abs, d.changes)):.2g}' for n, d in done.items())}"
    )
    ties = (small.tie,) if small.tie.dependents else ()
    return SolvedModes(solver, model, ties, small.held, counts, (fact,), centre, units, out, small.n_modes)


class _Step:
    """The step of one parameter's differences, on the way to one that can be used."""

    def __init__(self, parameter: DeckParameter, centre: float) -> None:
        self.parameter, self.centre = parameter, centre
        relative = STEP if parameter.step is None else parameter.step
        if not centre and parameter.step is None:
            raise InputError(f"parameter {parameter.name!r} is 0; give `step`, by how much it changes, in its unit")
        self.unit = abs(centre) or 1.0
        self.part = relative
        self.tried: set[float] = set()

    @property
    def can_shrink(self) -> bool:
        return self.part > 1e-4 and len(self.tried) < _TRIALS

    def values(self, solver: Solver, centre: Mapping[str, float]) -> list[float]:
        """On both sides of the centre; twice on one, where a bound is near."""
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
        shown = [solver.deck.shown({**centre, self.parameter.name: v})[self.parameter.name] for v in values]
        if len({*shown, self.centre}) < 3:
            raise InputError(
                f"a step of {size:g} of {self.parameter.name!r} does not show in the digits of its mark; widen it, as in"
                f" {{{{{self.parameter.name}:16}}}}, or give `step`"
            )
        return shown

    def shrink(self) -> None:
        self.part /= 4

    def settles(self, change: float) -> bool:
        """Whether differences with this relative change of the frequencies can be used; the next step where not."""
        if change > _MOST_CHANGE and self.part > 1e-4 and self.part / 4 not in self.tried:
            self.shrink()
            return False
        if change < _LEAST_CHANGE and self.part < _LARGEST_STEP:
            self.part = min(10 * self.part, _LARGEST_STEP)
            return self.part in self.tried
        if change < _NO_EFFECT:
            raise InputError(
                f"parameter {self.parameter.name!r} has no effect: no frequency changes by more than {change:.1g} of its value"
                f" where it changes by {self.part:.2g}; look for the mark in a part of the deck that is not used, or take the"
                " parameter out"
            )
        return True


def _change(centre: Shapes, runs: Sequence[Shapes]) -> float:
    """Largest relative change of a frequency; of those that are no rigid motion."""
    largest = 0.0
    for run in runs:
        n = min(len(run.frequency), len(centre.frequency))
        first = centre.frequency[:n]
        moves = first > 1e-3 * first.max(initial=0.0)
        largest = max(
            largest, float(np.abs(run.frequency[:n] / np.where(moves, first, 1.0) - 1)[moves].max(initial=0.0))
        )
    return largest


def _shapes_in_si(shapes: Shapes, units: Units) -> Shapes:
    """Mass-normalized shapes in kg^-1/2 (translations)."""
    rotation = shapes.dofs[:, 1] > 3
    scale = np.where(rotation, 1.0 / LENGTHS[units.length], 1.0) / np.sqrt(units.mass)
    return replace(shapes, values=shapes.values * scale[:, None])
