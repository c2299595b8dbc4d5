"""Model of the results of a solver, with the runs that it is made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.units import FORCES, LENGTHS
from structid.external.expansion import Point
from structid.external.runs import RunCounts, Solver
from structid.fem.elements import ElementSet
from structid.fem.elements.element import dof_code
from structid.fem.elements.matrix_group import ModelParameter
from structid.fem.supports import DofEquations
from structid.inversion.search.work import TaskExecutor


@dataclass(frozen=True)
class Units:
    """Units of the numbers that a solver gives; time is in seconds.

    Attributes
    ----------
    length, force : str
    """

    length: str = "m"
    force: str = "N"

    @property
    def mass(self) -> float:
        """Unit of mass of the deck in kg, consistent with its units of force and length and with seconds."""
        return FORCES[self.force] / LENGTHS[self.length]


@dataclass(frozen=True, eq=False)
class ShapeTie:
    """Degrees of freedom that follow others by the shapes that a solver gave.

    Attributes
    ----------
    name : str
    dependents, masters : tuple of Dof
    matrix : (n_dependents, n_masters) float array
    """

    name: str
    dependents: tuple[Dof, ...]
    masters: tuple[Dof, ...]
    matrix: FloatArray

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Each dependent degree of freedom as a sum of masters: factors by code of the master, for each code of a dependent one.

        `positions` and `active` are not used: the matrix holds already how shapes move together.
        """
        codes = [dof_code(dof.node, dof.direction) for dof in self.masters]
        return {
            dof_code(dof.node, dof.direction): dict(zip(codes, row, strict=True))
            for dof, row in zip(self.dependents, self.matrix.tolist(), strict=True)
        }


@dataclass(frozen=True)
class SolverCheck:
    """Comparison of one more run of the solver with the model of its results.

    Attributes
    ----------
    difference : float
        Largest relative difference: of frequencies, or of entries of matrices to their diagonals.
    words : str
    """

    difference: float
    words: str


@dataclass(frozen=True, eq=False)
class SolvedModel(ABC):
    """Model fitted to the runs of a solver, with these runs.

    Attributes
    ----------
    solver : Solver
    model : ElementSet
        The element set.
    ties : tuple of ShapeTie
    constrained : tuple of Dof
    counts : RunCounts
    facts : tuple of str
        What was found, for the reader.
    at : mapping of str to float
        Values of the run that it is made about.
    units : Units
    """

    solver: Solver
    model: ElementSet
    ties: tuple[ShapeTie, ...]
    constrained: tuple[Dof, ...]
    counts: RunCounts
    facts: tuple[str, ...]
    at: Mapping[str, float]
    units: Units

    @property
    def nodes(self) -> tuple[int, ...]:
        """Labels of all nodes of the solver."""
        followers = [dof.node for dof in (*self.constrained, *(dof for tie in self.ties for dof in tie.dependents))]
        return tuple(sorted({*self.model.nodes.ravel().tolist(), *followers}))

    @property
    @abstractmethod
    def is_exact(self) -> bool:
        """True if the model holds at all parameter values; otherwise it must be made again about the answer."""

    @abstractmethod
    def checked(self, values: Point, work: TaskExecutor) -> SolverCheck:
        """Comparison of the model with a solver run at `values` (by name).

        Raises
        ------
        InputError
            If the run fails.
        """


def model_parameters(solver: Solver, references: Mapping[str, float]) -> tuple[ModelParameter, ...]:
    """The deck's parameters for the model, with nominal values, and scales from `references` (by name)."""
    nominal = solver.deck.nominal
    return tuple(ModelParameter(p.name, p.unit, nominal[p.name], references[p.name]) for p in solver.deck.parameters)
