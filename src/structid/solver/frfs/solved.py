"""A solver's own FRFs at the lines of the records, and their differences."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import ComplexArray
from structid.estimation.search.work import Work
from structid.solver.expansion import Point
from structid.solver.frfs.model import FrfRuns, SolverFrfs
from structid.solver.frfs.output import FrfsOut
from structid.solver.runs import Solver, needed_runs, run_words
from structid.solver.solved import Checked, Solved, Units, model_parameters
from structid.solver.steps import StepRules, taken

#: FRFs bend where modes hardly do: a step of 0.002 moves a resonance by a thousandth of its frequency.
_RULES = StepRules(first=0.002, least=1e-4, most=0.3, no_effect=1e-6, what="FRF")


@dataclass(frozen=True, eq=False)
class SolvedFrfs(Solved):
    """Of FRFs.

    Attributes
    ----------
    out : FrfsOut
    """

    model: SolverFrfs
    out: FrfsOut

    @property
    def is_exact(self) -> bool:
        return False

    def run_at(self, values: Point, work: Work) -> FrfRuns:
        """What the solver gives with `values`, whatever the parameters of the model are then.

        Raises
        ------
        InputError
            If the run fails.
        """
        [folder], _ = needed_runs(self.solver, [values], work)
        found = self.model.found
        return replace(
            found,
            centre=self.out.read(folder),
            runs=np.zeros((0, 2, *found.centre.shape)),
            changes=np.zeros((0, 2)),
            at={},
        )

    def checked(self, values: Point, work: Work) -> Checked:
        given = self.run_at(values, work).centre
        own, _ = self.model.found.evaluated(np.array([values[name] for name in self.model.found.at]))
        worst = float((np.abs(own - given).max(axis=0) / np.abs(given).max(axis=0)).max())
        return Checked(
            worst,
            f"the solver with the updated deck gives the model's FRFs to {worst:.2g} of the largest value of each",
        )


def solved_frfs(name: str, solver: Solver, out: FrfsOut, units: Units, work: Work) -> SolvedFrfs:
    """The model of FRFs about the centre of each parameter, from differences.

    Raises
    ------
    InputError
        If a run fails, or a parameter changes no FRF.
    """
    own = taken(solver, out.read, _change, _RULES, work)
    pairs = {one.name: one for one in own.pairs}
    names = solver.deck.names
    found = FrfRuns(
        out.frequency,
        out.outputs,
        out.inputs,
        own.centre,
        {name: own.at[name] for name in names},
        np.array([pairs[name].changes for name in names]),
        np.array([pairs[name].runs for name in names]),
    )
    references = {key: own.at[key] or 1.0 for key in names}
    frfs = SolverFrfs(name, found, model_parameters(solver, references))
    fact = (
        f"solver: {run_words(own.counts)}; {len(out.frequency)} lines from {out.frequency[0]:.5g} to {out.frequency[-1]:.5g} Hz,"
        f" {len(out.outputs)} x {len(out.inputs)} FRFs; {own.words}"
    )
    return SolvedFrfs(solver, frfs, (), (), own.counts, (fact,), own.at, units, out)


def _change(centre: ComplexArray, run: ComplexArray, point: Point) -> float:
    """Relative change of the FRFs, root mean square over lines and channels, none counted as more than 1."""
    size = np.abs(centre)
    there = size > 0
    return float(np.sqrt(np.mean(np.minimum(np.abs(run - centre)[there] / size[there], 1.0) ** 2)))
