"""The model that a solver's own FRFs give, by differences: straight in the deck's parameters at each line of the records."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.external.expansion import Point
from structid.external.frfs.output import FrfsOut
from structid.external.model import ModelParameter
from structid.external.runs import Solver, needed_runs, run_words
from structid.external.solved import Checked, Solved, Units, model_parameters
from structid.external.steps import StepRules, taken
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    Nodes,
    Positions,
    Term,
    declared,
    dof_code,
    element,
)
from structid.inversion.search.work import Work

#: FRFs bend where modes hardly do: a step of 0.002 moves a resonance by a thousandth of its frequency.
_RULES = StepRules(first=0.002, least=1e-4, most=0.3, no_effect=1e-6, what="FRF")


@dataclass(frozen=True, eq=False)
class FrfRuns:
    """Receptances of a solver at a centre, and at two changes of each parameter.

    Beside the centre each value goes straight with the parameters, by the slope at the centre of the parabola through its
    three runs.

    Attributes
    ----------
    frequency : (n_lines,) float array
        Hz.
    outputs, inputs : tuple of Dof
    centre : (n_lines, n_outputs, n_inputs) complex array
        SI units.
    at : mapping of str to float
        Value of each parameter there.
    changes : (n_params, 2) float array
        Of each parameter, in its unit.
    runs : (n_params, 2, n_lines, n_outputs, n_inputs) complex array
    """

    frequency: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    centre: ComplexArray
    at: Mapping[str, float]
    changes: FloatArray
    runs: ComplexArray

    def mapped(self, frequency: FloatArray, convert: Callable[[ComplexArray], ComplexArray]) -> FrfRuns:
        """A copy whose receptances (n_lines, ...) of all runs went through `convert`; `frequency` are the new lines, Hz."""
        centre = convert(self.centre)
        transformed = np.zeros((*self.runs.shape[:2], *centre.shape), dtype=np.complex128)
        for index in np.ndindex(*self.runs.shape[:2]):
            transformed[index] = convert(self.runs[index])
        return replace(self, frequency=frequency, centre=centre, runs=transformed)

    def lines(self, frequency: FloatArray) -> IntArray:
        """Indices of the lines `frequency`, Hz, among those of the runs; raises `InputError` if one is missing.

        Raises
        ------
        InputError
            If one is not there.
        """
        index = np.clip(np.searchsorted(self.frequency, frequency), 0, len(self.frequency) - 1)
        missing = frequency[self.frequency[index] != frequency]
        if len(missing):
            raise InputError(
                f"the solver was not asked for the line at {missing[0]:g} Hz; take lines of the records, inside `band`"
            )
        return index

    @cached_property
    def _derivatives(self) -> ComplexArray:
        """Derivatives of the receptances by the parameters at the centre, (n_lines, n_outputs, n_inputs, n_params)."""
        derivatives = np.zeros((*self.centre.shape, len(self.changes)), dtype=np.complex128)
        for k, ((a, b), (run_a, run_b)) in enumerate(zip(self.changes, self.runs, strict=True)):
            up, down = (run_a - self.centre) / a, (run_b - self.centre) / b
            derivatives[..., k] = up - a * (down - up) / (b - a)
        return derivatives

    def evaluated(self, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Receptances and their derivatives, (n_lines, n_outputs, n_inputs) and (..., n_params), for values of all parameters."""
        return self.centre + self._derivatives @ (values - np.array(list(self.at.values()))), self._derivatives


@element
class SolverFrfs(ElementSet):
    """A structure of which a solver gives FRFs alone: parameters of its deck are the properties, and there are no matrices."""

    has_matrices: ClassVar[bool] = False

    nodes: Nodes = declared("Nodes of sensors and loads, in order, as one element", init=False)
    found: FrfRuns = declared("What the solver gave")
    parameters: tuple[ModelParameter, ...] = declared("Parameters of the deck")

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", locked(np.unique([dof.node for dof in self.dofs])[None, :], np.int64))
        super().__post_init__()

    @property
    def dofs(self) -> tuple[Dof, ...]:
        """Of sensors and loads, each once, as they come."""
        return tuple(dict.fromkeys(dof.unsigned for dof in (*self.found.outputs, *self.found.inputs)))

    def terms(self, positions: Positions, present: IntArray) -> tuple[Term, ...]:
        """The parameters as properties with empty matrices; see `ElementSet.terms`."""
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        nothing = sparse.csc_array((codes.size, codes.size))
        matrix_term = ElementMatrixTerm(codes, np.zeros((1, 0, 0)), whole=nothing, law="elastic", reduced=True)
        return tuple(
            Term(p.name, "parameter", p.unit, locked([p.value], float), [matrix_term]) for p in self.parameters
        )

    def channel_indices(self, dofs: tuple[Dof, ...], role: str) -> tuple[IntArray, FloatArray]:
        """Indices of sensors (`role` ``output``) or loads (``input``) among the solver's channels, and their relative sign.

        Raises
        ------
        InputError
            If it has no such channel.
        """
        channels = self.found.outputs if role == "output" else self.found.inputs
        index_and_sign = {dof.unsigned: (k, dof.sign) for k, dof in enumerate(channels)}
        for dof in dofs:
            if dof.unsigned not in index_and_sign:
                raise InputError(f"the solver gives no FRF with {role} {dof}, only {', '.join(map(str, channels))}")
        pairs = [index_and_sign[dof.unsigned] for dof in dofs]
        return np.array([k for k, _ in pairs]), np.array(
            [sign * dof.sign for (_, sign), dof in zip(pairs, dofs, strict=True)], dtype=float
        )


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
        """The largest error of the model's FRFs against a run of the solver at `values`, relative to the peak of each."""
        of_solver = self.run_at(values, work).centre
        of_model, _ = self.model.found.evaluated(np.array([values[name] for name in self.model.found.at]))
        worst = float((np.abs(of_model - of_solver).max(axis=0) / np.abs(of_solver).max(axis=0)).max())
        return Checked(
            worst,
            f"the solver with the updated deck gives the model's FRFs to {worst:.2g} of the largest value of each",
        )


def solved_frfs(name: str, solver: Solver, out: FrfsOut, units: Units, work: Work) -> SolvedFrfs:
    """A model with the FRFs of a solver, linearized by finite differences about the centre of each parameter.

    Raises
    ------
    InputError
        If a run fails, or a parameter changes no FRF.
    """
    steps = taken(solver, out.read, _change, _RULES, work)
    pairs = {pair.name: pair for pair in steps.pairs}
    names = solver.deck.names
    runs = FrfRuns(
        out.frequency,
        out.outputs,
        out.inputs,
        steps.centre,
        {name: steps.at[name] for name in names},
        np.array([pairs[name].changes for name in names]),
        np.array([pairs[name].runs for name in names]),
    )
    references = {key: steps.at[key] or 1.0 for key in names}
    frfs = SolverFrfs(name, runs, model_parameters(solver, references))
    fact = (
        f"solver: {run_words(steps.counts)}; {len(out.frequency)} lines from {out.frequency[0]:.5g} to {out.frequency[-1]:.5g} Hz,"
        f" {len(out.outputs)} x {len(out.inputs)} FRFs; {steps.words}"
    )
    return SolvedFrfs(solver, frfs, (), (), steps.counts, (fact,), steps.at, units, out)


def _change(centre: ComplexArray, run: ComplexArray, point: Point) -> float:
    """Relative change of the FRFs, root mean square over lines and channels, none counted as more than 1."""
    size = np.abs(centre)
    there = size > 0
    return float(np.sqrt(np.mean(np.minimum(np.abs(run - centre)[there] / size[there], 1.0) ** 2)))
