"""One identification from structure, unknowns and records to everything that a report shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.errors import InputError, require_class
from structid.fem import Structure
from structid.forward import ChannelUnknown, RecordProblem
from structid.forward.scatter import scatter_problems
from structid.identification.alternatives import alternatives
from structid.identification.identified import Identification, MassEstimate, PriorSummary, missed_parts
from structid.identification.joint_problem import first_values, freed_problems, harmonize_shared_parameters, indices_of
from structid.identification.options import IdentifyOptions
from structid.identification.ratios import ratios, scale_from_force
from structid.identification.record_fit import FittedUnknowns, RecordFit
from structid.identification.regularizing import regularization_warnings, shares
from structid.identification.search import search_parameters
from structid.identification.setups.frf import Setup
from structid.identification.setups.setup import AnySetup, RecordSetup, prefixes, prepared_warnings, titles
from structid.identification.warning_words import estimate_warnings, ran_away, ran_away_warning, unused_damping
from structid.inversion import Covariance, Estimate
from structid.inversion.fixed_values import FIXED, FixedValueInfluence
from structid.inversion.intervals import parameter_intervals
from structid.inversion.search.work import SERIAL, StageProgress, TaskExecutor
from structid.records import FrfRecord
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import begun_at

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit

__all__ = ["Identification", "IdentifyOptions", "Setup", "identify", "identify_together"]

_RECORD_MAKERS = (
    "make it by `read_record` or `FrfRecord`; modes and histories go to `identify_together`, each in a set-up"
)
#: What makes each part of a set-up.
_MADE_BY = {
    "structure": "make it by `Structure(nodes, elements, fixed)`",
    "parameters": "make it by `parameters(structure, unknowns)`",
    "record": "make it by `read_record` or its class, and give the set-up of its kind: `Setup`, `TimeSetup` or `ModalSetup`",
}


def identify(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    options: IdentifyOptions | None = None,
    progress: StageProgress | None = None,
    channel_unknowns: Sequence[ChannelUnknown] = (),
) -> Identification:
    """Identification of the parameters of `structure` from a record of frequency responses at any set of sensors.

    Parameters
    ----------
    structure : Structure
        Model with initial values of all properties, in SI units.
    unknown : Parameters
        Parameters to be identified, made by `parameters` on that structure.
    record : FrfRecord
        Measured frequency responses, with their noise.
    options : IdentifyOptions, optional
        Band, search, noise model, regularization and intervals; the defaults without it.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    channel_unknowns : sequence of ChannelUnknown
        Errors of sensors and loads that are identified too.

    Returns
    -------
    Identification
        Also where the search failed or the data do not determine the answer: see ``estimate.status``.

    Raises
    ------
    InputError
        If an argument is of another class, nothing is unknown, the parameters were made for another structure, or the
        record cannot be used.

    References
    ----------
    Norris (1986), chapter 4, with the unmeasured degrees of freedom eliminated.
    """
    require_class("structure", structure, Structure, _MADE_BY["structure"])
    require_class("unknown", unknown, Parameters, _MADE_BY["parameters"])
    require_class("record", record, FrfRecord, _RECORD_MAKERS)
    return identify_together([Setup(structure, unknown, record, channel_unknowns)], options, progress)


def identify_together(
    setups: Sequence[AnySetup],
    options: IdentifyOptions | None = None,
    progress: StageProgress | None = None,
    work: TaskExecutor = SERIAL,
    near: Mapping[str, float] | None = None,
) -> Identification:
    """Identification of parameters from several records of a structure, with other sensors, loads, supports or masses.

    Records of responses (`Setup`), of modes (`ModalSetup`) and of time histories (`TimeSetup`) go together as they come.
    Very many parameters are searched for without a Jacobian; see `IdentifyOptions.matrix_free`.

    Parameters of the same name are one unknown (but for those that vary, see `Unknown`), errors of channels too: give those
    a `name` where two records have different sensors at the same place. Such a parameter begins where the first set-up has
    it; a prior that any of them states counts once.

    Parameters
    ----------
    setups : sequence of Setup, ModalSetup or TimeSetup
        Set-ups with their records; the noise of one is independent of that of the others.
    options : IdentifyOptions, optional
        For all records alike.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    work : TaskExecutor
        Where searches and their repeats run, and whether they are kept.
    near : mapping of str to float, optional
        Free variables of a nearby answer by name, from which the first search begins at once; by default the starts of the
        parameters, which all other searches begin about in any case.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        If an argument is of another class, there is no set-up, nothing is unknown, parameters were made for another structure,
        a shared parameter is declared differently in two set-ups, or a record cannot be used.
    """
    chosen = IdentifyOptions() if options is None else options
    setups = _checked_setups(setups, chosen)
    prepared = [setup.prepared(chosen) for setup in setups]
    problems = initial = harmonize_shared_parameters([ready.problem for ready in prepared], titles(setups))
    if len(setups) == 1:
        problems = (setups[0].begun(problems[0]),)
    outcome = search_parameters(setups, problems, chosen, progress, work, near)
    problems, target = outcome.problems, outcome.target
    freed = () if outcome.estimate.fixed is None else freed_problems(setups, problems, chosen.tolerances)
    estimate = outcome.estimate.with_initial(first_values(outcome.estimate.names, initial, lambda part: part.start))
    if estimate.goodness.residual_tests is not None and target is not None:
        tests = estimate.goodness.residual_tests.named(_series_names(setups, problems))
        estimate = replace(estimate, goodness=replace(estimate.goodness, residual_tests=tests))
    ends = parameter_intervals(target or problems[0], estimate, chosen.intervals, seed=chosen.seed, work=work)
    fitted = [_fitted_unknowns(problem, estimate) for problem in problems]
    records = list(zip(setups, titles(setups), problems, fitted, strict=True))
    fits = [setup.response_fit(title, problem, unknowns, chosen) for setup, title, problem, unknowns in records]
    modal_fits = [setup.modal_fit(title, problem, unknowns, chosen) for setup, title, problem, unknowns in records]
    of_reduction = [setup.truncation(problem, unknowns.theta) for setup, _, problem, unknowns in records]
    truncations = tuple(
        replace(truncation, words=prefix + truncation.words)
        for prefix, truncation in zip(prefixes(setups), of_reduction, strict=True)
        if truncation is not None
    )
    measures_force = all(problem.facts.measures_force for problem in problems)
    scale_free = None if target is None or measures_force else ratios(target, estimate)
    prior_fraction = shares(target, estimate)
    runaways = ran_away(estimate, problems)
    warnings = (
        *(truncation.warning for truncation in truncations if truncation.warning),
        *prepared_warnings(setups, prepared),
        *_fit_warnings(setups, fits),
        *_fit_warnings(setups, modal_fits),
        *(fit.outvoted for fit in modal_fits if fit is not None and len(setups) == 1 and fit.outvoted),
        *(ran_away_warning(estimate, index) for index in runaways),
        *(() if scale_free is None else (scale_free.words,)),
        *unused_damping(problems, estimate.names, estimate.kinds, estimate.identified),
        *estimate_warnings(estimate),
        *regularization_warnings(problems, estimate, outcome.regularizations, prior_fraction),
    )
    mass, std = total_mass(problems[0], estimate, chosen.direction, freed[0] if freed else None)
    priors = PriorSummary(
        mean=first_values(estimate.names, problems, lambda part: part.priors.mean),
        std=first_values(estimate.names, problems, lambda part: part.priors.std),
        variance_fraction=prior_fraction,
        regularizations=outcome.regularizations,
        varied=outcome.varied,
    )
    return Identification(
        estimate=estimate,
        fits=tuple(fit for fit in fits if fit is not None),
        modal_fits=tuple(fit for fit in modal_fits if fit is not None),
        problems=problems,
        target=target,
        priors=priors,
        mass=MassEstimate(
            total=mass,
            std=std,
            ratios=scale_free,
            scale_from_force=target is not None and scale_from_force(problems, estimate),
        ),
        warnings=warnings,
        intervals=ends,
        ran_away=runaways,
        truncations=truncations,
        missed=missed_parts(titles(setups) if len(setups) > 1 else [""], problems, estimate, freed),
        freed=freed,
        setups=tuple(setups),
        options=chosen,
        alternatives=alternatives(estimate, problems, outcome.without_priors),
        mesh=_undivided_words(setups),
    )


def _fit_warnings(setups: Sequence[AnySetup], fits: Sequence[RecordFit | ModalFit | None]) -> list[str]:
    """Warnings of the fits to records, in the order of the set-ups, with the title of the record where there are several.

    `fits` has an entry for each set-up, None where the record has no fit of that kind.
    """
    pairs = [(prefix, fit) for prefix, fit in zip(prefixes(setups), fits, strict=True) if fit is not None]
    return [prefix + words for prefix, fit in pairs for words in fit.warnings]


def _undivided_words(setups: Sequence[AnySetup]) -> str:
    """A clause on beams and bars that are as the caller drew them, which a study would divide.

    It is "" where there are none, or they are cut into pieces already.
    """
    structures = [setup.structure for setup in setups if setup.structure.subdivide == 1]
    names = list(dict.fromkeys(element.name for structure in structures for element in structure.divisible))
    if not names:
        return ""
    return (
        f"the elements of {join_words(names, 4)} are as drawn, and not judged for their length: `subdivide=4` in `Structure`"
        " shows whether values move"
    )


def _checked_setups(setups: Iterable[AnySetup], options: IdentifyOptions) -> tuple[AnySetup, ...]:
    """The set-ups as a tuple, after checks that they, their parts and `options` are of their classes.

    `InputError` if they are not, there is none, parameters were made for another structure, or no set-up has an
    unknown.
    """
    if isinstance(setups, RecordSetup):
        raise InputError("`setups` must be a list of set-ups, got a single one; write `[setup]`")
    require_class("setups", setups, Iterable, "give a list of set-ups, one for each record")
    setups = tuple(setups)
    for number, setup in enumerate(setups):
        require_class(f"setups[{number}]", setup, RecordSetup, "make it by `Setup`, `TimeSetup` or `ModalSetup`")
        parts = (
            ("structure", setup.structure, Structure),
            ("parameters", setup.parameters, Parameters),
            ("record", setup.record, setup.record_class),
        )
        for name, part, kind in parts:
            require_class(f"setups[{number}].{name}", part, kind, _MADE_BY[name])
    if not setups:
        raise InputError("`setups` must hold at least one set-up, got none; give one for each record")
    require_class("options", options, IdentifyOptions, "make it as in `IdentifyOptions(band=(5, 100))`")
    for number, setup in enumerate(setups):
        if setup.parameters.offset.shape != setup.structure.values.shape:
            raise InputError(
                f"the parameters of setups[{number}] were made for another structure; make them by"
                " `parameters(structure, unknowns)` with the structure that is identified"
            )
    if not any(setup.parameters.names for setup in setups):
        beside = " beside the errors of channels" if any(setup.channel_unknowns for setup in setups) else ""
        raise InputError(f"nothing is unknown{beside}; give `parameters(structure, unknowns)` at least one `Unknown`")
    return setups


def _series_names(setups: Sequence[AnySetup], problems: Sequence[RecordProblem]) -> list[str]:
    """Names of the channels of the residual, in the order of the residual series, then those of scatters.

    With several records the title of the record comes first.
    """
    pairs = zip(prefixes(setups), problems, strict=True)
    channels = [prefix + name for prefix, problem in pairs for name in problem.rows.names]
    return channels + [f"scatter of {scatter.name}" for scatter in scatter_problems(problems)]


def _fitted_unknowns(problem: RecordProblem, estimate: Estimate) -> FittedUnknowns:
    """Free variables, values and initial values of the problem's parameters, taken by name from the whole estimate.

    After a linear fit, which has no free variables, they are made from the values; a value out of range takes that of
    the start.
    """
    indices = indices_of(estimate.names, problem.names)
    values, theta = estimate.values[indices], estimate.theta[indices]
    if estimate.parameters.slope is None:
        theta = begun_at(problem.unknowns, dict(zip(estimate.names, estimate.values.tolist(), strict=True))).theta_start
    return FittedUnknowns(theta, values, estimate.initial[indices])


def total_mass(
    problem: RecordProblem, estimate: Estimate, direction: str | None, freed: RecordProblem | None = None
) -> tuple[float, float]:
    """Total mass of the problem's structure for motion in a direction, and its standard deviation, kg.

    Parameters
    ----------
    problem : RecordProblem
        Its structure and parameters are used.
    estimate : Estimate
        Estimate of all parameters.
    direction : str or None
        X, Y or Z; if None, the first in which the structure has mass (see `Structure.mass_of`).
    freed : RecordProblem, optional
        The problem with the fixed values of its model among the unknowns; with it, the standard deviation includes the
        tolerances of fixed values that the mass depends on.
    """
    unknown, row = problem.parameters, np.zeros((1, len(estimate.names)))
    index = indices_of(estimate.names, unknown.names)
    values = unknown.values(estimate.values[index])
    gradient = problem.structure.mass_gradient(direction, values)
    row[0, index] = gradient @ unknown.design
    mass = problem.structure.mass_of(values, direction)
    fixed_changes: dict[str, float] = {}
    if freed is not None:
        changes = zip(freed.parameters.names, gradient @ freed.parameters.design, strict=True)
        fixed_changes = {name.removeprefix(FIXED): change for name, change in changes if name.startswith(FIXED)}
    return mass, mass_deviation(row, estimate.uncertainty, fixed_changes, estimate.fixed)


def mass_deviation(
    row: FloatArray, covariance: Covariance, fixed_changes: Mapping[str, float], fixed: FixedValueInfluence | None
) -> float:
    """Standard deviation, kg, of a total mass that depends on parameters and fixed values.

    Correlations of both through the influence of fixed values are included.

    Parameters
    ----------
    row : (1, n_params) float array
        Derivative of the mass with respect to the parameters.
    covariance : Covariance
        Covariance of the parameters, with what `fixed` adds.
    fixed_changes : mapping of str to float
        Change of the mass for a relative change of each fixed value, kg, by its name; 0 for names that it lacks.
    fixed : FixedValueInfluence or None
        Influence of fixed values on the parameters; None where all fixed values are exact.
    """
    variance = float(covariance.variance(row)[0])
    if fixed is not None:
        changes = np.array([fixed_changes.get(name, 0.0) for name in fixed.names]) * fixed.error
        variance += float(changes @ changes + 2 * changes @ (row @ np.nan_to_num(fixed.slope * fixed.error))[0])
    return float(np.sqrt(max(variance, 0.0)))
