"""A model of a solver's modes by differences: exact about the values of its parameters where they are taken."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from structid.core.arrays import FloatArray
from structid.core.units import LENGTHS
from structid.external.expansion import Point, expand_about_centre
from structid.external.outputs import ModesOut, RunModes, require_same_dofs
from structid.external.runs import Solver, needed_runs, point_words, run_words
from structid.external.solved import SolvedModel, SolverCheck, Units, model_parameters
from structid.external.steps import StepRules, take_differences
from structid.external.tangent import tangent
from structid.fem.elements.solver_model import Part, Powers, SolverModel
from structid.inversion.search.work import TaskExecutor

_RULES = StepRules(first=0.01, least=1e-5, most=0.1, no_effect=2e-7, what="frequency")


@dataclass(frozen=True, eq=False)
class SolvedModes(SolvedModel):
    """Model from the modes that a solver gives.

    Attributes
    ----------
    out : ModesOut
    n_modes : int
        Modes that the model has.
    """

    model: SolverModel
    out: ModesOut
    n_modes: int

    @property
    def is_exact(self) -> bool:
        return False

    def checked(self, values: Point, work: TaskExecutor) -> SolverCheck:
        """Largest relative difference between the model's frequencies and a solver run at `values` (by name), with a sentence.

        Rigid-body modes are left out. The solver runs unless this run is kept already.
        """
        [folder], _ = needed_runs(self.solver, [values], work)
        of_solver = self.out.read(folder).frequency[: self.n_modes]
        squared = eigh(*(self.model.matrix(key, values).toarray() for key in ("stiffness", "mass")), eigvals_only=True)
        of_model = np.sqrt(np.maximum(squared[: len(of_solver)], 0.0)) / (2 * np.pi)
        is_elastic = of_solver > 1e-3 * of_solver.max()
        worst = float(np.abs(of_model[is_elastic] / of_solver[is_elastic] - 1).max())
        return SolverCheck(
            worst, f"the solver with the updated deck gives the model's frequencies to {worst:.2g} of their value"
        )


def solved_modes(name: str, solver: Solver, out: ModesOut, units: Units, work: TaskExecutor) -> SolvedModes:
    """A model with the modes of a solver, linearized by finite differences about the centre of each parameter.

    Parameters
    ----------
    name : str
        Name of the model in its structure.
    solver : Solver
    out : ModesOut
        Reads frequencies and shapes in the folder of a run.
    units : Units
        Units of the deck.
    work : TaskExecutor
        Executor of the runs.

    Raises
    ------
    InputError
        If a run fails, has other nodes than the first, or a parameter changes no frequency.
    """
    steps = take_differences(solver, out.read, _frequency_change, _RULES, work)
    shapes, centre = steps.centre, steps.at
    pairs = [replace(d, runs=(_shapes_in_si(d.runs[0], units), _shapes_in_si(d.runs[1], units))) for d in steps.pairs]
    small = tangent(f"shapes of {name}", _shapes_in_si(shapes, units), pairs)
    references = {parameter.name: centre[parameter.name] or 1.0 for parameter in solver.deck.parameters}
    parts = []
    for key, table in (("mass", small.mass), ("stiffness", small.stiffness)):
        about_zero: dict[Powers, FloatArray] = {}
        for powers, matrix in table.items():
            for shift, factor in expand_about_centre(powers, centre, references):
                about_zero[shift] = about_zero.get(shift, 0.0) + factor * matrix
        parts += [Part(key, shift, sparse.csc_array(matrix)) for shift, matrix in about_zero.items()]
    model = SolverModel(name, small.masters, tuple(parts), model_parameters(solver, references), small.n_modes)
    frequency = ", ".join(f"{f:.5g}" for f in shapes.frequency[: small.n_modes])
    fact = f"solver: {run_words(steps.counts)}; modes at {frequency} Hz, {len(shapes.dofs)} degrees of freedom; {steps.words}"
    ties = (small.tie,) if small.tie.dependents else ()
    return SolvedModes(solver, model, ties, small.constrained, steps.counts, (fact,), centre, units, out, small.n_modes)


def _frequency_change(centre: RunModes, run: RunModes, point: Point) -> float:
    """Largest relative change of a frequency from the run `centre` to `run`; rigid-body modes are left out.

    `point` are the parameter values of `run`, for the error if both have different degrees of freedom.
    """
    require_same_dofs(centre, run, point_words(point))
    n = min(len(run.frequency), len(centre.frequency))
    first = centre.frequency[:n]
    is_elastic = first > 1e-3 * first.max(initial=0.0)
    return float(np.abs(run.frequency[:n] / np.where(is_elastic, first, 1.0) - 1)[is_elastic].max(initial=0.0))


def _shapes_in_si(shapes: RunModes, units: Units) -> RunModes:
    """Shapes of unit modal mass, converted from the deck's units to kg^-1/2, for rotations rad/m kg^-1/2."""
    rotation = shapes.dofs[:, 1] > 3
    scale = np.where(rotation, 1.0 / LENGTHS[units.length], 1.0) / np.sqrt(units.mass)
    return replace(shapes, values=shapes.values * scale[:, None])
