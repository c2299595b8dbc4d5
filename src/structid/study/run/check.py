"""Check of a study before any search: the accuracy expected from its record and initial model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.diagnose.checks.initial_comparison import InitialComparison, ResonancePair
from structid.diagnose.checks.loose_parts import PlacedFinding, coarse_elements, structure_findings
from structid.diagnose.checks.mesh import MeshErrors, checked_mesh
from structid.dynamics import Modes
from structid.fem.measuring_points import AimedSensor, MeshPoint
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.identify import mass_deviation
from structid.identification.joint_problem import (
    first_values,
    fixed_values,
    freed_problems,
    indices_of,
    joint_problem,
    tolerances_clause,
)
from structid.identification.ratios import common_scale, scale_words
from structid.identification.record_fit import LEAST_DAMPING, response_rounding, rounding_warnings, structure_modes
from structid.identification.regularizing import coupled, unit_penalties
from structid.identification.setups.setup import AnySetup, prefixes
from structid.identification.warning_words import unused_damping
from structid.inversion import Covariance, DenseCovariance, Identifiability, Linearization, Problem
from structid.inversion.covariance import inverse_information
from structid.inversion.diagnostics.identifiability import identifiability
from structid.inversion.fixed_values import FixedValueInfluence
from structid.inversion.posterior_draws import counted_draws, drawn_covariance, solved_influence
from structid.inversion.problem import expected_square
from structid.inversion.uncertainty import relative_jacobian
from structid.records import FrfRecord, TimeRecord
from structid.records.quality import drifts, leakage, signal_checks
from structid.study.run.run import is_matrix_free
from structid.study.run.start import PreparedStudy, compare_with_models, pieces_for_band, prepare_study, with_pieces
from structid.study.schema.records.record import RecordSource, read_histories
from structid.study.schema.study import Study
from structid.unknowns import Regularization, term_name
from structid.unknowns.tolerances import fixed_properties, relative_sensitivities

_MOST_DIRECTIONS = 12
#: Strength that stands for one that the data will choose: neighbours within 10 %.
USUAL_STRENGTH = 100.0
_DRAWS = 16
#: Part of its frequency within which a mode that shows no peak may belong to a measured one.
_HIDDEN = 0.1
#: Averages from which on the chi-square that their coherence leads to is not worth a word.
_MANY = 100


@dataclass(frozen=True)
class ResonanceCheck(ResonancePair):
    """A pair, and how far apart it is.

    Attributes
    ----------
    half_bandwidths : float
        How far the model is above, by the model's damping; NaN where it has none.
    """

    half_bandwidths: float


@dataclass(frozen=True, eq=False)
class RecordCheck:
    """One record beside its model, before a fit.

    Attributes
    ----------
    title : str
    resonances : tuple of ResonanceCheck
    warnings : tuple of str
        Of samples and windows.
    facts : tuple of str
    """

    title: str
    resonances: tuple[ResonanceCheck, ...]
    warnings: tuple[str, ...]
    facts: tuple[str, ...]


def checked_record(
    title: str,
    source: RecordSource,
    setup: AnySetup,
    problem: RecordProblem,
    comparison: InitialComparison,
    modes: Modes,
) -> RecordCheck:
    """The checks of one record before a fit: resonances beside the model's, warnings on signals and windows, and remarks.

    Parameters
    ----------
    title : str
        Name that messages about the record begin with.
    source : RecordSource
        The record's tables in the study file, from which its files are read again.
    setup : RecordSetup
        Structure, parameters and record.
    problem : RecordProblem
        Problem of the lines in the band.
    comparison : InitialComparison
        Measured resonances paired with those of the initial model.
    modes : Modes
        Modes of the initial model.
    """
    warnings: list[str] = []
    histories = read_histories(source)
    for record in histories:
        checks = [one for one in signal_checks(record) if one.severity != "note"]
        slow = drifts(record) if not any(one.kind == "short" for one in checks) else ()
        warnings += [one.words for one in (*checks, *slow)]
    warnings += leaking_windows(source, histories, problem, modes)
    lost = setup.truncation(problem, problem.theta_start)
    warnings += [lost.warning] if lost is not None and lost.warning else []
    reduced = () if lost is None else (*(one.words for one in setup.structure.reductions), lost.words)
    read = tuple(f"read: {record.source}" for record in histories if "; " in record.source)
    return RecordCheck(title, _resonances(comparison, modes), tuple(warnings), (*read, *reduced, *_facts(setup)))


def _resonances(comparison: InitialComparison, modes: Modes) -> tuple[ResonanceCheck, ...]:
    """Each measured resonance (Hz) with the model's, their MAC, and how far the model's lies above it.

    The distance is a multiple of half the half-power bandwidth of the model's mode. Where the comparison has no model
    resonance, the nearest unpaired mode within 10 % of the measured frequency is taken. Frequency and distance are NaN
    where there is none; the distance also for a mode without positive damping.
    """
    free = np.ones(len(modes.frequency), dtype=bool)
    for pair in comparison.resonances:
        if free.size and np.isfinite(pair.model):
            free[np.abs(modes.frequency - pair.model).argmin()] = False
    checks = []
    for pair in comparison.resonances:
        model, distance = pair.model, float("nan")
        distances = np.abs(modes.frequency - (pair.measured if np.isnan(model) else model))
        if np.isnan(model):
            distances = np.where(free & (distances <= _HIDDEN * pair.measured), distances, np.inf)
        nearest = int(distances.argmin()) if distances.size else -1
        if nearest >= 0 and np.isfinite(distances[nearest]):
            if np.isnan(model):
                model, free[nearest] = float(modes.frequency[nearest]), False
            damping = float(modes.damping_ratio[nearest])
            if damping > 0:
                distance = (model - pair.measured) / (max(damping, LEAST_DAMPING) * model)
        checks.append(ResonanceCheck(pair.measured, model, pair.mac, distance))
    return tuple(checks)


def _facts(setup: AnySetup) -> tuple[str, ...]:
    """At most one remark, on noise that was estimated from the coherence of 1 to 100 averages.

    The tuple is empty for all other records. Up to two averages do not give the noise; with more, the remark says which
    chi-square a right model has.
    """
    record = setup.record
    if not isinstance(record, FrfRecord) or record.noise_source != "coherence" or not record.averages:
        return ()
    n = record.averages
    if n > _MANY:
        return ()
    if n <= 2:
        return (f"coherence from {n} averages does not tell the noise; state it in [record.noise]",)
    expected = float(expected_square(n))
    return (
        f"coherence from {n} averages: a chi-square of {expected:.3g} per degree of freedom is expected where all is right",
    )


def leaking_windows(
    source: RecordSource, histories: list[TimeRecord], problem: RecordProblem, modes: Modes
) -> list[str]:
    """At most one warning, if the window of averaged spectra blurs resonances in the band of `problem`.

    `source` has the settings of the averaging, `histories` are the averaged time records, of which the first is judged,
    and `modes` those of the initial model. The list is empty if no resonance is blurred, or no spectra were averaged.
    """
    if source.frf is None or source.time is not None or not histories:
        return []
    settings = source.frf.others
    length = settings.get("segment_length") or len(histories[0].values)
    window = settings.get("window", "hann")
    axis: FloatArray = problem.frequency
    in_band = (modes.frequency >= axis[0]) & (modes.frequency <= axis[-1])
    words = leakage(histories[0], length, window, modes.frequency[in_band], modes.damping_ratio[in_band])
    return [words] if words else []


@dataclass(frozen=True)
class ChannelCheck:
    """One sensor or load of the record, and the free degrees of freedom of the structure that it sees.

    Attributes
    ----------
    channel : str
        As the record names it.
    role : str
        ``output`` or ``input``.
    seen : str
        Free degrees of freedom with their coefficients, through rigid links and constraints.
    """

    channel: str
    role: str
    seen: str


@dataclass(frozen=True)
class ModeCheck:
    """One mode of the initial model, and how well the record's lines resolve it.

    Attributes
    ----------
    frequency, damping_ratio : float
        Hz, and 1.
    in_band : bool
    lines_per_bandwidth : float
        Half-power bandwidth (2 damping ratio frequency, and what an exponential window adds) over the line spacing there;
        below about 4 a resonance is poorly resolved, 0 for an undamped mode, and NaN where modes were measured.
    rounding : float
        Relative error of the frequency by rounding of the stiffness matrix.
    """

    frequency: float
    damping_ratio: float
    in_band: bool
    lines_per_bandwidth: float
    rounding: float


@dataclass(frozen=True, eq=False)
class PredictedIdentification:
    """Prediction of an identification before it is made, from a linearization at the initial values.

    Attributes
    ----------
    problem : Problem
        All that would be fitted.
    start : (n_params,) float array
        Initial value of each parameter.
    covariance : Covariance
        The Cramer-Rao bound at the initial values, with the noise (and model error) of the study, its priors and
        regularizations of given strength; by draws where the parameters are too many for a Jacobian.
    identifiability : Identifiability
        Rank, condition and undetermined directions there, from the data alone; of very many parameters the rank only.
    warnings : tuple of str
        The gravest first.
    of_data : Covariance
        `covariance` without the tolerances of what the model holds.
    assumption : str
        What `covariance` allows that to be wrong by, in words; "" where it is taken as exact.
    fixed : FixedValueInfluence or None
        How the parameters change with it; None where it is taken as exact.
    """

    problem: Problem
    start: FloatArray
    covariance: Covariance
    identifiability: Identifiability
    warnings: tuple[str, ...]
    of_data: Covariance
    assumption: str
    fixed: FixedValueInfluence | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, each once: record by record those of the structure, then those of its channels."""
        return self.problem.names

    @property
    def units(self) -> tuple[str, ...]:
        return self.problem.unknowns.units

    @property
    def sizes(self) -> FloatArray:
        """Magnitude by which each standard deviation is divided to be relative, (n_params,)."""
        return self.problem.unknowns.sizes(self.start)

    @property
    def std(self) -> FloatArray:
        """Predicted standard deviation of each parameter, (n_params,); NaN where the data do not determine it."""
        return self.covariance.std

    @property
    def determined(self) -> bool:
        """True if data and priors determine every parameter to better than its own size."""
        return bool((self.of_data.std <= self.sizes).all())


@dataclass(frozen=True, eq=False)
class CheckResult(PredictedIdentification):
    """Result of `check_study`: the prediction, and the checks of records, channels and modes behind it.

    Attributes
    ----------
    study : Study
        With beams in the pieces that `division` names.
    records : tuple of str
        What was measured, and which part of it is used, a line each.
    channels : tuple of ChannelCheck
    modes : tuple of ModeCheck
        Of the first set-up.
    total_mass, total_mass_std : float
        Of the initial model, kg, and predicted.
    beside : tuple of RecordCheck
        Each record beside its initial model.
    mesh : MeshErrors or str
        Of the first set-up's structure; in words why it was not judged, "" where it has no elements with a size.
    places : tuple of PlacedFinding
        What is doubtful about that structure, and where.
    division : str
        The pieces into which beams and bars were divided for this check; "" where they are as the study has them.
    """

    study: Study
    records: tuple[str, ...]
    channels: tuple[ChannelCheck, ...]
    modes: tuple[ModeCheck, ...]
    total_mass: float
    total_mass_std: float
    beside: tuple[RecordCheck, ...]
    mesh: MeshErrors | str
    places: tuple[PlacedFinding, ...]
    division: str


def check_study(study: Study) -> CheckResult:
    """The study read and checked, with the accuracy predicted at the initial values; nothing is estimated or written.

    The result has all records and channels, modes and mesh of the first record's initial model, the predicted
    covariance and identifiability, the total mass (kg) and warnings, the gravest first. Where the study leaves the
    pieces of beams and bars open, as many are taken as the modes in the first record's band need.

    Raises
    ------
    InputError
        If a file, a record or an option of the study cannot be used.
    SingularModelError
        If the initial model has a mechanism.
    """
    ready, mesh, mesh_warning, division = _divided(prepare_study(study))
    study = ready.study
    predicted = _predict_by_draws(ready) if is_matrix_free(ready) else _predict_by_jacobian(ready)
    problem, options = predicted.problem, study.options
    modes = [
        structure_modes(setup.structure, setup.parameters.values(setup.parameters.start), options.n_modes)
        for setup in ready.setups
    ]
    checked = [_mode_checks(modes_of_part, part) for modes_of_part, part in zip(modes, ready.problems, strict=True)]
    titled = prefixes(ready.setups)
    values = study.parameters.values(study.parameters.start)
    beside = [
        checked_record(title, source.record, setup, part, comparison, modes_of_part)
        for title, source, setup, part, comparison, modes_of_part in zip(
            titled, study.setups, ready.setups, ready.problems, ready.comparisons, modes, strict=True
        )
    ]
    structure = ready.setups[0].structure
    findings = structure_findings(structure, values)
    coarse = None if isinstance(mesh, str) else coarse_elements(structure, values, mesh)
    row = np.zeros((1, len(problem.names)))
    gradient = study.structure.mass_gradient(options.direction, values)
    row[0, indices_of(problem.names, study.parameters.names)] = gradient @ study.parameters.design
    fixed = fixed_properties(study.structure, study.parameters, options.tolerances)
    changes = gradient @ relative_sensitivities(values, fixed)
    fixed_masses = dict(zip((item.label for item in fixed), changes, strict=True))
    return CheckResult(
        study=study,
        records=tuple(setup.words(options) for setup in ready.setups),
        channels=tuple(
            check for name, setup in zip(titled, ready.setups, strict=True) for check in channel_checks(name, setup)
        ),
        modes=checked[0],
        problem=problem,
        start=predicted.start,
        covariance=predicted.covariance,
        identifiability=predicted.identifiability,
        total_mass=study.structure.mass_of(values, options.direction),
        total_mass_std=mass_deviation(row, predicted.covariance, fixed_masses, predicted.fixed),
        of_data=predicted.of_data,
        assumption=predicted.assumption,
        fixed=predicted.fixed,
        warnings=(
            *ready.channel_warnings,
            *(item.words for item in findings),
            *([mesh_warning] if mesh_warning else []),
            *(item.title + words for item in beside for words in item.warnings),
            *ready.warnings,
            *(
                name + words
                for name, structure in zip(titled, checked, strict=True)
                for words in (*rounding_warnings(np.array([m.rounding for m in structure])), *_mode_warnings(structure))
            ),
            *predicted.warnings,
        ),
        beside=tuple(beside),
        mesh=mesh,
        places=(*findings, *([] if coarse is None else [coarse])),
        division=division,
    )


def _divided(ready: PreparedStudy) -> tuple[PreparedStudy, MeshErrors | str, str, str]:
    """The study with beams and bars in as many pieces as the modes in the band need; its mesh errors, a warning, a remark.

    The remark says how many pieces there are; it is "" where `pieces_for_band` divides no element, and the study is then as
    it came. The warning is on a mesh that is too coarse, or on modes that the elements as drawn lack; "" if there are none.
    """
    drawn = checked_mesh(ready.setups[0], ready.problems[0])
    count, mesh = pieces_for_band(ready, drawn)
    if isinstance(drawn, str):
        return ready, drawn, "", ""
    if count == 1:
        is_left = ready.study.leaves_pieces_open and not any(element.cells for element in drawn.structure.elements)
        later = f"{drawn.finding}; `structid identify` divides beams and bars until this moves no value"
        return ready, drawn, later if is_left and drawn.finding else drawn.words, ""
    divided = compare_with_models(*with_pieces(ready.study, ready.setups, count))
    lacking = f"{drawn.finding}; `subdivide = {count}` in [structure] starts the search with them"
    remark = (
        f"each element of beams and bars in {count} pieces for this check, by the modes in the band; `structid identify` divides"
        " them by what this moves the values by"
    )
    warnings = [lacking if drawn.passed_over.size else "", "" if isinstance(mesh, str) else mesh.words]
    return divided, mesh, "; ".join(filter(None, warnings)), remark


def _with_strengths(ready: PreparedStudy, terms: Sequence[Regularization], strengths: Sequence[float]) -> Problem:
    """The joint problem of all records with the regularization `terms` at these `strengths`, one for each term."""
    rows = unit_penalties(ready.problems, terms)
    return joint_problem(coupled(ready.problems, [row.scaled(s) for row, s in zip(rows, strengths, strict=True)]))


def _predict_by_jacobian(ready: PreparedStudy) -> PredictedIdentification:
    """Predicted covariance, identifiability and warnings from the Jacobian at the initial values.

    The covariance is the bound of Cramér and Rao plus the influence of tolerances of fixed values. Of the
    regularizations, smoothness with a given strength is included; a warning names the others.
    """
    terms = [t for t in ready.study.options.regularization if t.given is not None and not t.is_sparse]
    problem = _with_strengths(ready, terms, [term.given or 0.0 for term in terms])
    theta = np.asarray(problem.theta_start)
    linearization = problem.linearize(theta)
    fixed = fixed_values(freed_problems(ready.setups, ready.problems, ready.study.options.tolerances))
    of_data = DenseCovariance(cramer_rao_bound(problem, linearization))
    covariance, assumption, influence = of_data, "", None
    if fixed is not None:
        influence = fixed.sensitivities_at(problem.names, theta).influence(theta, linearization, problem.slope(theta))
        covariance = DenseCovariance(of_data.matrix + influence.covariance)
        assumption = tolerances_clause(influence, ready.problems, ready.study.options.tolerances)
    relative = relative_jacobian(problem, theta, linearization)
    identified_directions = identifiability(relative, problem.physical(theta), problem.names)
    identified = of_data.std <= problem.unknowns.sizes(problem.physical(theta))
    warnings = unused_damping(ready.problems, problem.names, problem.unknowns.kinds, identified)
    if not all(part.facts.measures_force for part in ready.problems):
        warnings += _ratio_warnings(problem, relative, identified)
    not_included = [term_name(term) for term in ready.study.options.regularization if term not in terms]
    warnings += _direction_warnings(identified_directions)
    warnings += [f"predicted without the {' and '.join(not_included)} that `identify` will use"] if not_included else []
    return PredictedIdentification(
        problem,
        _start(problem, ready),
        covariance,
        identified_directions,
        tuple(warnings),
        of_data,
        assumption,
        influence,
    )


def _predict_by_draws(ready: PreparedStudy) -> PredictedIdentification:
    """Predicted covariance for very many parameters, from posterior draws at the initial values.

    Every regularization is included at its given strength, or at a usual one where the data would choose it.
    """
    terms = ready.study.options.regularization
    strengths = [USUAL_STRENGTH if term.given is None else term.given for term in terms]
    problem = _with_strengths(ready, terms, strengths)
    theta = np.asarray(problem.theta_start)
    linearization = problem.linearize_operator(theta)
    draws, determined, _ = counted_draws(linearization, _DRAWS, np.random.default_rng(ready.study.options.seed))
    words = [
        f"{term_name(term)}: strength {strength:.3g}"
        + (", for one that `identify` will choose by the data" if term.given is None else ", as given")
        for term, strength in zip(terms, strengths, strict=True)
    ]
    of_data = covariance = drawn_covariance(problem, theta, linearization, draws)
    fixed = fixed_values(freed_problems(ready.setups, ready.problems, ready.study.options.tolerances))
    assumption, influence = "", None
    if fixed is not None:
        columns = replace(fixed, is_matrix_free=True).sensitivities_at(problem.names, theta)
        influence, unsolved = solved_influence(problem, theta, linearization, columns)
        words += [unsolved] if unsolved else []
    if influence is not None:
        covariance = of_data.with_changes(influence.changes)
        assumption = tolerances_clause(influence, ready.problems, ready.study.options.tolerances)
    rank = Identifiability(round(np.nan_to_num(determined)), np.nan, np.zeros(0), ())
    return PredictedIdentification(
        problem, _start(problem, ready), covariance, rank, tuple(words), of_data, assumption, influence
    )


def _start(problem: Problem, ready: PreparedStudy) -> FloatArray:
    return first_values(problem.names, ready.problems, lambda part: part.start)


def cramer_rao_bound(problem: Problem, linearization: Linearization) -> FloatArray:
    """Smallest covariance that an unbiased estimate can have at the start, (n_params, n_params), physical units.

    It is (J'J)^-1 with the whitened Jacobian J for the physical parameters, priors counted as data.
    """
    slope = problem.slope(np.asarray(problem.theta_start))
    return inverse_information(linearization.jacobian) * np.outer(slope, slope)


def channel_checks(name: str, setup: AnySetup) -> list[ChannelCheck]:
    """The free degrees of freedom, with coefficients, that each channel of a set-up measures or loads.

    The list has an entry for each channel. `name` is put before the channel's own name. An input that moves supports
    lists these and their base; a sensor placed beside the nodes also has its distance (m) to the nearest one.
    """
    structure, checks = setup.structure, []
    free = structure.dofs
    placed = [tie for tie in structure.ties if isinstance(tie, MeshPoint | AimedSensor)]
    nearest = {tie.label: tie.distance for tie in placed if tie.distance > 0 or isinstance(tie, MeshPoint)}
    for role, dofs in setup.channels:
        if role == "input" and (bases := structure.driven(dofs)):
            for dof, base in zip(dofs, bases, strict=True):
                supports = " ".join(support.place for support in base.supports)
                checks.append(ChannelCheck(f"{name}{dof}", role, f"moves {supports} (base {base.name})"))
            continue
        columns = structure.selection(dofs).tocsc()
        for j, dof in enumerate(dofs):
            part = columns[:, [j]].tocoo()
            pairs = zip(part.coords[0], part.data, strict=True)
            terms = [_term(value, free[int(row)]) for row, value in pairs]
            terms += [f"(nearest node, {nearest[dof.node]:.3g} m away)"] if dof.node in nearest else []
            checks.append(ChannelCheck(f"{name}{dof}", role, " ".join(terms)))
    return checks


def _term(factor: float, dof: Dof) -> str:
    """A degree of freedom times a factor, which is left out where it is 1: ``+2Y``, ``-0.5 3X``."""
    text = f"{factor:+.3g}"
    return (text[0] if text[1:] == "1" else f"{text} ") + dof.place


def _mode_checks(modes: Modes, problem: RecordProblem) -> tuple[ModeCheck, ...]:
    """One check for each mode: frequency (Hz), damping ratio, if it lies in the band, lines in its bandwidth, rounding.

    Lines are counted in the half-power bandwidth, widened by that of the record's window. Rounding is the relative
    error by floating-point arithmetic, of the frequency where modes were measured, else of the response.
    """
    axis, facts = problem.frequency, problem.facts
    nearest_line = np.clip(np.searchsorted(axis, modes.frequency), 0, len(axis) - 1)
    in_band = (axis[0] <= modes.frequency) & (modes.frequency <= axis[-1])
    lines = (2 * modes.damping_ratio * modes.frequency + facts.window_bandwidth[nearest_line]) / facts.line_spacing[
        nearest_line
    ]
    rounding = modes.rounding if compares_modes(problem) else response_rounding(modes)
    rows = zip(modes.frequency, modes.damping_ratio, in_band, lines, rounding, strict=True)
    return tuple(ModeCheck(float(f), float(d), bool(i), float(n), float(r)) for f, d, i, n, r in rows)


def _mode_warnings(modes: tuple[ModeCheck, ...]) -> list[str]:
    """At most one warning: no mode lies in the band, or a mode there has under one line in its half-power bandwidth.

    The second is on the mode with the fewest lines and counts the others. [] if all is well, or if every mode has NaN
    lines, as for a record of measured modes.
    """
    if all(np.isnan(mode.lines_per_bandwidth) for mode in modes):
        return []
    if not any(mode.in_band for mode in modes):
        return [
            "no mode of the initial model lies in the band: the record cannot determine damping; check band and model"
        ]
    coarse = [mode for mode in modes if mode.in_band and 0 < mode.lines_per_bandwidth < 1]
    if not coarse:
        return []
    least = min(coarse, key=lambda mode: mode.lines_per_bandwidth)
    others = f", and {len(coarse) - 1} more have less than one" if len(coarse) > 1 else ""
    return [
        f"the mode at {least.frequency:.4g} Hz has {least.lines_per_bandwidth:.2g} lines in its half-power bandwidth{others};"
        " measure with a finer frequency spacing to tell its damping"
    ]


def _ratio_warnings(problem: Problem, jacobian: FloatArray, identified: np.ndarray) -> list[str]:
    """A list with one warning if a set of parameters could be scaled together unnoticed, as with modes alone.

    It is empty otherwise, and if a parameter of the set is identified. `jacobian` (n_data, n_params) is by relative
    changes; `identified` (n_params,) masks the identified parameters.
    """
    members = common_scale(jacobian, problem.unknowns.kinds)
    if members is None or identified[members].any():
        return []
    return [scale_words([problem.names[i] for i in members])]


def _direction_warnings(identifiability: Identifiability) -> list[str]:
    """Warnings on the worst-determined directions, and how many more there are; an empty list without such directions."""
    warnings = [f"the data determine {direction.words}" for direction in identifiability.directions[:_MOST_DIRECTIONS]]
    more = len(identifiability.directions) - len(warnings)
    return [*warnings, f"and {more} more combinations that the data do not determine"] if more else warnings
