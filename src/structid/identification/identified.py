"""The result of an identification: an estimate, each record beside its model, and values that the answer misses.

Records, and kinds of values of modes, may be missed while the many values of others hide it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import Overview, Shown, plural
from structid.core.dof import Dof
from structid.dynamics import Modes
from structid.fem import Structure
from structid.forward import FrfProblem, RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.alternatives import Alternatives
from structid.identification.joint_problem import indices_of, tolerances_clause
from structid.identification.options import IdentifyOptions
from structid.identification.ratios import Ratios
from structid.identification.record_fit import RecordFit, Resonance, Truncation
from structid.identification.regularizing import AppliedRegularization
from structid.identification.setups.setup import AnySetup
from structid.identification.varying import Varied
from structid.inversion import Estimate, Problem
from structid.inversion.estimate import Value
from structid.inversion.fixed_values import FIXED
from structid.inversion.intervals import Intervals
from structid.inversion.problem import expected_square
from structid.plotting import IdentificationPlots
from structid.records import FrfRecord
from structid.unknowns import Parameters

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit


#: Probability, of all parts together, below which noise is not why a part is missed.
_RISK = 1e-3
#: Chi-square per value, in parts of what is expected, from where on values are missed: of modes, whose errors are less
#: surely known than those of lines, and of other records.
_OF_MODES, _OF_LINES = 4.0, 1.25
#: Chi-square per degree of freedom of all data, below which they hide what one part misses.
_HIDES = 2.0


@dataclass(frozen=True)
class MissedValues:
    """Values of a record that the answer misses.

    Attributes
    ----------
    what : str
        Such as ``the frequencies of "ambient"``.
    n_values, n_others : int
        Numbers of these values, and of all data besides.
    chi_square_per_value : float
    """

    what: str
    n_values: int
    n_others: int
    chi_square_per_value: float

    @property
    def is_far(self) -> bool:
        """True if the values are missed by so much that no interval of the fit can be valid."""
        return self.chi_square_per_value > _OF_MODES

    @property
    def words(self) -> str:
        """Sentence on the values that are missed, by how much, and why the whole misfit does not show it."""
        size = float(np.sqrt(self.chi_square_per_value))
        return (
            f"{self.what} are missed by {size:.2g} times their stated errors (root mean square of"
            f" {plural(self.n_values, 'value')}), which the fit to {plural(self.n_others, 'other value')} hides"
        )


def theta_within_tolerances(problem: Problem, estimate: Estimate) -> FloatArray:
    """Free variables of `problem`, which has fixed values among its unknowns, at the fit within their tolerances.

    That is the fit in `estimate.fixed`, which must be there. A fixed value that it lacks, as its influence could not be
    solved for, is exact.
    """
    fixed = estimate.fixed
    assert fixed is not None
    free = dict(zip(estimate.names, fixed.theta.tolist(), strict=True))
    free |= zip((FIXED + name for name in fixed.names), (fixed.asked * fixed.tolerance).tolist(), strict=True)
    return np.array([free.get(name, 0.0) if name.startswith(FIXED) else free[name] for name in problem.names])


def missed_parts(
    names: Sequence[str], problems: Sequence[RecordProblem], estimate: Estimate, freed: Sequence[RecordProblem] = ()
) -> tuple[MissedValues, ...]:
    """Records, or kinds of values of modes, that the fit misses beyond their errors, the worst first.

    A part is missed if its sum of squares per value exceeds a limit (4 for modes, 1.25 for lines, more with few
    averages) and is improbable at 0.1 % for all parts together, by chi-square with as many degrees of freedom as
    values. Empty with fewer than two parts to test, or if the misfit of the whole is 2 or more.

    Parameters
    ----------
    names : sequence of str
        Names of the records; "" for a single one.
    problems : sequence of RecordProblem
        Problem of each record.
    estimate : Estimate
        Estimate of all parameters.
    freed : sequence of RecordProblem
        Problems with the fixed values of their models among the unknowns; where given, the fit within tolerances is
        tested.
    """
    is_whole = len(problems) == 1 and not compares_modes(problems[0])
    if is_whole or not estimate.goodness.misfit < _HIDES:
        return ()
    parts = []
    is_freed = bool(freed) and estimate.fixed is not None
    for name, problem in zip(names, freed if is_freed else problems, strict=True):
        theta = (
            theta_within_tolerances(problem, estimate)
            if is_freed
            else estimate.theta[indices_of(estimate.names, problem.names)]
        )
        residual = problem.residual(theta)[: problem.n_data]
        parts += [(what, rows, least) for what, rows, least in _tested_parts(name, problem, residual) if len(rows)]
    if len(parts) < 2:
        return ()
    missed = []
    for what, rows, least in parts:
        square, n = float(rows @ rows), len(rows)
        if square > least * n and float(special.gammaincc(n / 2, square / 2)) * len(parts) < _RISK:
            missed.append(MissedValues(what, n, estimate.goodness.n_data - n, square / n))
    return tuple(sorted(missed, key=lambda one: -one.chi_square_per_value))


def _tested_parts(name: str, problem: RecordProblem, residual: FloatArray) -> Iterator[tuple[str, FloatArray, float]]:
    """Parts of a record to be tested: name, residual rows, and the chi-square per value above which the part is missed.

    A record of modes has a part for each kind of value, without residuals of exactly 0; any other record is one part.
    `name` is the record, "" for a single one. `residual` (n_residuals,) is whitened; rows of a part are (n,).
    """
    if compares_modes(problem):
        kinds = problem.row_kinds
        for kind in dict.fromkeys(kinds.tolist()):
            rows = residual[(kinds == kind) & (residual != 0)]
            yield f"the {kind} of {f'record {name}' if name else 'the modes'}", rows, _OF_MODES
        return
    few = 1.0 if problem.rows.averages is None else float(expected_square(problem.rows.averages).mean())
    yield f"the values of record {name}", residual, _OF_LINES * few


#: Part of a parameter's variance from which on it is owed to priors.
_MOSTLY = 0.5
#: Part of the largest entry of a direction from which on a parameter takes part in it.
_TAKES_PART = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class PriorSummary:
    """Knowledge of the parameters beside the data.

    Attributes
    ----------
    mean, std : (n_params,) float arrays
        Prior of each parameter alone, physical units; NaN where there is none.
    variance_fraction : (n_params,) float array or None
        Part of each parameter's variance that stems from priors and regularization instead of data; None of a
        matrix-free search.
    regularizations : tuple of AppliedRegularization
        Regularizations and their strengths.
    varied : tuple of Varied
        Parameters that differ from record to record, and by how much.
    """

    mean: FloatArray
    std: FloatArray
    variance_fraction: FloatArray | None = None
    regularizations: tuple[AppliedRegularization, ...] = ()
    varied: tuple[Varied, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class MassEstimate:
    """The total mass, and the common scale of masses and stiffnesses.

    Attributes
    ----------
    total, std : float
        Total mass of the first set-up's structure and its standard deviation, kg; NaN where the structure has no mass property
        in kg.
    ratios : Ratios or None
        Ratios of parameters where the data leave the scale free.
    scale_from_force : bool
        Whether only measured forces determine the scale.
    """

    total: float
    std: float
    ratios: Ratios | None = None
    scale_from_force: bool = False


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Identification(Shown, IdentificationPlots):
    """An estimate with the data that it was made from and its predictions.

    Properties that concern one record are those of the first.

    Attributes
    ----------
    estimate : Estimate
        All parameters: those of the structure, then those of the records' channels.
    priors : PriorSummary
    mass : MassEstimate
    fits : tuple of RecordFit
        Each record of responses beside the model.
    modal_fits : tuple of ModalFit
        Each record of modes beside the model.
    problems : tuple of RecordProblem
        Problem of each record, with the polarities that were found.
    target : Problem or None
        The problem that was minimized; None by an estimator of time histories that minimizes nothing of many records.
    warnings : tuple of str
        Warnings, the most important first.
    intervals : Intervals
        95 % intervals of all parameters, and how they were found.
    ran_away : tuple of int
        Indices of parameters that ended far from their starts for no reason; see `warning_words.ran_away`.
    truncations : tuple of Truncation
        Changes at the answer by the reduction of components, as each record sees them.
    missed : tuple of MissedValues
        Records, or kinds of values of modes, that the answer misses beyond their errors, the worst first.
    freed : tuple of RecordProblem
        The problems with the fixed values of their models among the unknowns, within tolerances; () where these are exact.
    setups : tuple of RecordSetup
        Set-ups of the records.
    options : IdentifyOptions or None
    alternatives : Alternatives or None
        Sets of values that fit the data equally well; None where one only was found.
    mesh : str
        Words on the pieces into which beams were divided, and on elements that cannot be; "" where the mesh is as drawn and moves
        no value, and where the study states the number.
    """

    estimate: Estimate
    priors: PriorSummary
    mass: MassEstimate
    problems: tuple[RecordProblem, ...]
    target: Problem | None
    warnings: tuple[str, ...]
    intervals: Intervals
    fits: tuple[RecordFit, ...] = ()
    modal_fits: tuple[ModalFit, ...] = ()
    ran_away: tuple[int, ...] = ()
    truncations: tuple[Truncation, ...] = ()
    missed: tuple[MissedValues, ...] = ()
    freed: tuple[RecordProblem, ...] = ()
    setups: tuple[AnySetup, ...] = ()
    options: IdentifyOptions | None = None
    alternatives: Alternatives | None = None
    mesh: str = ""

    def __contains__(self, name: object) -> bool:
        """True if there is a parameter of that name."""
        return name in self.estimate

    def __iter__(self) -> Iterator[str]:
        """Names of the parameters, as iterating over a dictionary gives its keys."""
        return iter(self.estimate)

    def __getitem__(self, name: str) -> Value:
        """Value and standard deviation of one parameter, such as ``fit["mass[beam]"]``; see `Estimate`.

        Raises
        ------
        MissingNameError
            If there is none of that name; with the nearest names, then the first that there are. It is a `KeyError` too.
        """
        return self.estimate[name]

    @property
    def first(self) -> RecordFit | ModalFit:
        """The first record: of responses, or of modes where there are no responses."""
        return self.fits[0] if self.fits else self.modal_fits[0]

    @property
    def structure(self) -> Structure:
        return self.first.problem.structure

    @property
    def parameters(self) -> Parameters:
        return self.first.problem.parameters

    @property
    def sensors(self) -> tuple[Dof, ...]:
        return self.fits[0].problem.record.outputs if self.fits else self.modal_fits[0].measured.channels

    @property
    def loads(self) -> tuple[Dof, ...]:
        """Loads of the first record of responses; () where all records are of modes."""
        return self.fits[0].problem.record.inputs if self.fits else ()

    @property
    def modes_initial(self) -> Modes:
        return self.first.modes_initial

    @property
    def modes(self) -> Modes:
        return self.first.modes

    @property
    def problem(self) -> FrfProblem:
        return self.fits[0].problem

    @property
    def measured(self) -> FrfRecord:
        """All lines of the first record of responses."""
        return self.fits[0].measured

    @property
    def evaluation(self) -> FrfRecord:
        """Lines of the first record on which the fit is judged."""
        return self.fits[0].evaluation

    @property
    def relative_error(self) -> FloatArray:
        """abs(predicted - measured) / abs(measured) of the first record, (n_evaluated, n_outputs, n_inputs)."""
        return self.fits[0].relative_error

    @property
    def resonances(self) -> tuple[Resonance, ...]:
        return self.fits[0].resonances if self.fits else ()

    @property
    def assumption(self) -> str:
        """The errors of fixed values that standard deviations and intervals include, and the choice of the mesh, in words."""
        return "; ".join(words for words in (self._fixed_value_clause, self.mesh) if words)

    @property
    def _fixed_value_clause(self) -> str:
        """A clause on the errors of fixed values that the standard deviations include, or that they include none."""
        fixed = self.estimate.fixed
        if fixed is not None:
            return tolerances_clause(fixed, self.problems, None if self.options is None else self.options.tolerances)
        can_tell = self.estimate.uncertainty.has_matrix
        return "± takes what the model holds as exact" + (
            "" if can_tell else ": this search does not tell what it changes"
        )

    def overview(self) -> Overview:
        """Text with the outcome of the estimate, above a table with a row for each parameter."""
        return self.estimate.overview()

    def summary(self) -> str:
        """Verdict, next step, and a row for each parameter: what `print` shows."""
        view: Shown = import_module("structid.study.results.view").results_view(self)
        return view.summary()

    @property
    def listed(self) -> tuple[int, ...]:
        """Indices of all parameters except the values of single records in what varies from record to record."""
        varied_names = {name for parameter in self.priors.varied for name in parameter.own}
        return tuple(i for i, name in enumerate(self.estimate.names) if name not in varied_names)

    def seen_from(self, number: int) -> Identification:
        """A copy with the record of responses at position `number` (from 0) as the only one."""
        return replace(self, fits=(self.fits[number],))

    @property
    def by_prior(self) -> tuple[int, ...]:
        """Indices of parameters that priors determine more than the data do, alone or in an undetermined direction.

        Such a parameter has a prior, and more than half of its variance comes from priors, or its share of an
        undetermined direction is above 10 % of the largest. Empty for a matrix-free search.
        """
        if self.priors.variance_fraction is None:
            return ()
        is_open = np.zeros(len(self.priors.variance_fraction), dtype=bool)
        for direction in self.estimate.identifiability.directions:
            size = np.abs(direction.vector)
            is_open |= size > _TAKES_PART * size.max()
        is_by_prior = np.isfinite(self.priors.std) & ((self.priors.variance_fraction > _MOSTLY) | is_open)
        return tuple(np.flatnonzero(is_by_prior).tolist())

    @property
    def own_index(self) -> IntArray:
        """Indices (n,) of `parameters` among all parameters of the estimate."""
        return indices_of(self.estimate.names, self.parameters.names)
