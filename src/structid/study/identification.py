"""One identification from structure, unknowns and record to everything that a report shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.dynamics import Modes, modes
from structid.estimation import Estimate, Status, estimate
from structid.estimation.estimate import StageProgress
from structid.estimation.least_squares import LevenbergMarquardt, Method
from structid.observation import Form, FrfProblem, measures_everything, one_step_values, response
from structid.parameters import Parameters
from structid.records import FrfRecord
from structid.structure import Structure
from structid.study.checks import record_warnings
from structid.study.resonances import Resonance, resonances

_RELATIVE_WEIGHT = 0.1


@dataclass(frozen=True)
class IdentifyOptions:
    """How an identification is done.

    Parameters
    ----------
    band : (float, float), optional
        Lowest and highest frequency used, Hz; all lines by default.
    exclude : sequence of (float, float)
        Stretches of the band that are left out, Hz.
    residual : Form
        Residual of the last stage; see `FrfProblem`.
    model_error : float
        Error of the model as a part of each value's magnitude, added to the noise.
    pole_free_start : bool
        Whether a search on easier forms of the residual comes first, for starts far from the answer.
    restarts : int
        How many more searches are tried where the fit does not reach the noise: one by another way from the same
        start, then from random starts about 20 % from it. The best fit is kept.
    seed : int
        Of those starts.
    method : Method
        Search of the last stage.
    direction : str, optional
        Translation of the total mass; the first that has mass by default.
    n_modes : int
        How many modes of the identified model are given.
    evaluation_band : (float, float), optional
        Where the fit is judged and drawn, Hz; the lines that were used by default. A wider one shows how the model
        does on lines that had no part in the fit.
    """

    band: tuple[float, float] | None = None
    exclude: Sequence[tuple[float, float]] = ()
    residual: Form = "output"
    model_error: float = 0.0
    pole_free_start: bool = True
    restarts: int = 2
    seed: int = 0
    method: Method = field(default_factory=LevenbergMarquardt)
    direction: str | None = None
    n_modes: int = 12
    evaluation_band: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Identification:
    """An estimate with what it was made from and what it predicts.

    Attributes
    ----------
    problem : FrfProblem
        Structure, parameters and the lines of the record that were used.
    measured : FrfRecord
        The whole record, before the band was cut out.
    estimate : Estimate
    predicted_initial, predicted : (n_frequencies, n_outputs, n_inputs) complex arrays
        The model's FRF at the used lines, with initial and with identified parameters.
    evaluation : FrfRecord
        The lines on which the fit is judged.
    evaluation_initial, evaluation_predicted : (n_evaluated, n_outputs, n_inputs) complex arrays
        The model's FRF there.
    modes_initial, modes : Modes
        Of the initial and of the identified model.
    resonances : tuple of Resonance
        Peaks of the evaluated lines, measured beside predicted.
    total_mass, total_mass_std : float
        kg; NaN where the structure has no mass property in kg.
    warnings : tuple of str
        What the reader should know first.
    """

    problem: FrfProblem
    measured: FrfRecord
    estimate: Estimate
    predicted_initial: ComplexArray
    predicted: ComplexArray
    evaluation: FrfRecord
    evaluation_initial: ComplexArray
    evaluation_predicted: ComplexArray
    modes_initial: Modes
    modes: Modes
    resonances: tuple[Resonance, ...]
    total_mass: float
    total_mass_std: float
    warnings: tuple[str, ...]

    @property
    def relative_error(self) -> FloatArray:
        """abs(predicted - measured) / abs(measured), (n_evaluated, n_outputs, n_inputs)."""
        measured = self.evaluation.values
        return np.abs(self.evaluation_predicted - measured) / np.maximum(np.abs(measured), np.finfo(float).tiny)


def prepared_problem(
    structure: Structure, unknown: Parameters, record: FrfRecord, options: IdentifyOptions
) -> tuple[FrfProblem, tuple[str, ...]]:
    """The least-squares problem of the lines that `options` choose, and what is worth a warning about it."""
    used = used_lines(record, options)
    warnings = list(record_warnings(structure, used))
    model_error = options.model_error
    if used.variance is None and model_error == 0:
        model_error = _RELATIVE_WEIGHT
        warnings.append(
            "the record has no noise level: every line is weighted by its own magnitude, and standard deviations come"
            " from the scatter of the residual"
        )
    return FrfProblem(structure, unknown, used, options.residual, model_error), tuple(warnings)


def used_lines(record: FrfRecord, options: IdentifyOptions) -> FrfRecord:
    """The lines of `record` inside the band and outside the excluded stretches."""
    keep = np.ones(len(record.frequency), dtype=bool)
    if options.band is not None:
        keep &= (record.frequency >= options.band[0]) & (record.frequency <= options.band[1])
    for low, high in options.exclude:
        keep &= (record.frequency < low) | (record.frequency > high)
    return record if keep.all() else record.lines(np.flatnonzero(keep))


def identify(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    options: IdentifyOptions | None = None,
    progress: StageProgress | None = None,
) -> Identification:
    """Parameters of `structure` from a frequency response record, from any set of sensors.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    record : FrfRecord
    options : IdentifyOptions, optional
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.

    Returns
    -------
    Identification
        Also where the search failed or the data do not determine the answer: see ``estimate.status``.

    References
    ----------
    Norris (1986), chapter 4, with the unmeasured degrees of freedom eliminated.
    """
    chosen = options or IdentifyOptions()
    problem, warnings = prepared_problem(structure, unknown, record, chosen)
    if measures_everything(structure, problem.record):
        problem = _started_by_one_step(problem)
    plans = problem.stage_plans() if chosen.pole_free_start else ()
    found = estimate(problem, chosen.method, plans, restarts=chosen.restarts, seed=chosen.seed, progress=progress)
    found = replace(found, initial=unknown.start)
    judged = record.band(*chosen.evaluation_band) if chosen.evaluation_band else problem.record
    judge = response(structure, unknown, judged)
    judged_prediction = judge.values_at(found.values)
    values = unknown.values(found.values)
    gradient = structure.mass_gradient(chosen.direction) @ unknown.design
    return Identification(
        problem=problem,
        measured=record,
        estimate=found,
        predicted_initial=problem.predicted(unknown.theta_start),
        predicted=problem.predicted(found.theta),
        evaluation=judged,
        evaluation_initial=judge.values_at(unknown.start),
        evaluation_predicted=judged_prediction,
        modes_initial=structure_modes(structure, unknown.values(unknown.start), chosen.n_modes),
        modes=structure_modes(structure, values, chosen.n_modes),
        resonances=resonances(judged, judged_prediction),
        total_mass=structure.mass_of(values, chosen.direction),
        total_mass_std=float(np.sqrt(gradient @ np.nan_to_num(found.covariance) @ gradient))
        if np.isfinite(found.covariance[np.ix_(gradient != 0, gradient != 0)]).all()
        else float("nan"),
        warnings=(*warnings, *_estimate_warnings(found)),
    )


def _started_by_one_step(problem: FrfProblem) -> FrfProblem:
    """The same problem from the one-step linear solve, where that gives a value inside a parameter's range."""
    unknown = problem.parameters
    solved = one_step_values(problem.structure, unknown, problem.record)
    inside = (solved > unknown.transforms.lower) & (solved < unknown.transforms.upper)
    return replace(problem, parameters=unknown.started_at(np.where(inside, solved, unknown.start)))


def structure_modes(structure: Structure, values: FloatArray, n_modes: int) -> Modes:
    """The lowest modes of `structure` with the property values `values`; friction is left out."""
    mass, stiffness, damping, structural = (
        structure.matrix(law, values) for law in ("inertia", "elastic", "viscous", "structural")
    )
    return modes(mass, stiffness, damping, structural, n_modes)


def _estimate_warnings(found: Estimate) -> tuple[str, ...]:
    warnings = []
    if found.status is not Status.CONVERGED:
        warnings.append(f"{found.status.words} ({found.message})")
    warnings.extend(f"the data determine {direction.words}" for direction in found.identifiability.directions)
    for name, identified in zip(found.names, found.identified, strict=True):
        if not identified:
            warnings.append(f"{name} is not identified: its standard deviation is larger than its value")
    if found.n_agreeing < found.n_starts:
        warnings.append(
            f"{found.n_agreeing} of {found.n_starts} searches ended at this minimum, the others at worse ones:"
            " there may be a better one still; start closer, or try more `restarts`"
        )
    if found.covariance_basis == "model_error":
        warnings.append(
            f"the model does not fit to within the stated errors (chi-square per degree of freedom"
            f" {found.chi_square_per_dof:.3g}, residual correlated over {found.residual_correlation:.0f} lines):"
            " standard deviations are those that carry model error"
        )
    return tuple(warnings)
