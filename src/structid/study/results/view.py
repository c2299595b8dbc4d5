"""The results view: one answer with its verdict, as console, files, pages and Python show it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import (
    Overview,
    Shown,
    as_sentence,
    exact,
    join_words,
    number,
    percent,
    plural,
    prefixed,
    span_text,
    with_std,
    with_unit,
)
from structid.core.errors import require_class
from structid.core.json_types import StoredEntry
from structid.diagnose.fixed_value_influence import doubted, resting_words
from structid.diagnose.verdict import NOT_TRIED, Cause, Diagnosis, judged
from structid.files import csv_text
from structid.identification.identified import Identification
from structid.identification.record_fit import RecordFit
from structid.identification.warning_words import (
    INCLUDES_MODEL_ERROR,
    MAY_BE_ZERO,
    OTHER_MINIMA,
    estimate_warnings,
    is_gone,
    ran_away_remedy,
    ran_away_warning,
    ran_away_words,
    unidentified_warnings,
)
from structid.inversion import Estimate, Status
from structid.inversion.search.least_squares import dense_search_fits
from structid.inversion.uncertainty import AtBound

#: Parameters of a search without a Jacobian that the view and estimate.json list, those that moved most.
MOST_CHANGES = 50
#: File of a results folder with all of them.
PARAMETERS = "parameters.csv"
#: Lines of advice that a reader is shown at once.
MOST_ADVICE = 5
#: Length of a first sentence of a verdict that needs the second to say why.
_SHORT_SENTENCE = 60
#: Factor below and above a value that an end of its interval lies beyond where it tells nothing, and the words for two such ends.
_NO_LIMIT, _NO_INTERVAL = 1000.0, "not determined"
_BETWEEN_SENTENCES = re.compile(r"(?<=[.?!]) (?=[A-Z])")
_NEXT_STEPS = {
    "sound": "Use the values with their intervals.",
    "approximate": "Use the values with their intervals, which include the model error.",
    "wrong_model": "Find what is wrong with the model or the record before you use a value: look first at the channels that"
    " fit worst, then at the changes that were tried.",
    "undetermined": "Tie, fix or give a prior to what is not determined, or measure at more places and frequencies.",
    "untested": "Measure more than there are parameters, or tie or fix some of them.",
}
_NOT_SEARCHED = (
    "Find what is wrong with the model or the record before you use a value: `structid explain` tries single changes of"
    " both, in Python `explain(identification)`."
)
_NOT_ALL = "Use the values with their intervals, but not those that the lines below name."
#: What the verdict says of a value that is not to be relied on.
_DOUBTFUL = "ot rely on"
#: Kinds of causes that are choices of the model, which no look at the structure decides.
_OF_THE_MODEL = ("mesh", "shear", "damping_law", "varies", "untied")


@dataclass(frozen=True)
class ParameterResult:
    """One parameter as readers see it.

    Attributes
    ----------
    name, kind, unit : str
    initial, value, std : float
    interval : (float, float)
        Ends at 95 %; NaN where nothing is known.
    std_noise, std_model_error, std_tolerances : float
        Standard deviation from the noise alone, with model error, and from the tolerances of fixed values.
    state : str
        ``determined``, ``weakly determined``, ``by prior``, ``at its lower bound``, ``at its upper bound``,
        ``not determined``, ``ran away``, or ``one of several`` where other sets of values fit as well.
    identified, ran_away : bool
    bound : AtBound, optional
        The bound that it ended at.
    prior_mean, prior_std, prior_share : float
        Its own prior, and the part of its variance that stems from priors; NaN where there is none.
    elements : tuple of str
    is_own : bool
        Whether it is one record's own value of a property that varies between records.
    """

    name: str
    kind: str
    unit: str
    initial: float
    value: float
    std: float
    interval: tuple[float, float]
    std_noise: float
    std_model_error: float
    std_tolerances: float
    state: str
    identified: bool
    ran_away: bool = False
    bound: AtBound | None = None
    prior_mean: float = float("nan")
    prior_std: float = float("nan")
    prior_share: float = float("nan")
    elements: tuple[str, ...] = ()
    is_own: bool = False

    @property
    def scale(self) -> tuple[float, str]:
        """Power of 1000, and the unit with its prefix: numbers over the power are in that unit, with few digits."""
        return prefixed(self.unit, self.value, self.initial)

    def scaled(self, value: float) -> float:
        """A `value` in SI units, in the unit with its prefix; see `scale`."""
        return value / self.scale[0]

    @property
    def value_text(self) -> str:
        """Value and standard deviation without their unit; the limit alone at a bound."""
        if self.bound is not None:
            return exact(self.scaled(self.value))
        return with_std(self.scaled(self.value), np.nan if self.is_unlimited else self.scaled(self.std))

    @property
    def interval_text(self) -> str:
        """The interval as text, lower and upper end without their unit; in words where it limits nothing."""
        low, high = map(self.scaled, self.interval)
        return _NO_INTERVAL if self.is_unlimited else span_text(low, high)

    @property
    def interval_with_unit(self) -> str:
        """The interval as text, its ends with their unit; in words where it limits nothing."""
        low, high = map(self.scaled, self.interval)
        return _NO_INTERVAL if self.is_unlimited else span_text(low, high, self.unit_text)

    @property
    def is_unlimited(self) -> bool:
        """True if the interval of a positive value reaches so far below and above it that neither end tells anything."""
        low, high = self.interval
        return 0 <= low < self.value / _NO_LIMIT and high > self.value * _NO_LIMIT

    @property
    def unit_text(self) -> str:
        """The unit with its prefix and raised powers; empty for a number without unit."""
        return self.scale[1]

    @property
    def is_determined(self) -> bool:
        """True if nothing but the data was needed to determine it."""
        return self.state == "determined"


@dataclass(frozen=True)
class ChannelFit:
    """Fit of one channel: medians over its lines of the relative error of the fitted and of the initial FRF."""

    record: str
    output: str
    input: str
    error: float
    initial_error: float
    index: int

    @property
    def name(self) -> str:
        """Names of sensor and load of the FRF, as in ``3X+/1X+``."""
        return f"{self.output}/{self.input}"


@dataclass(frozen=True, eq=False, repr=False)
class ResultsView(Shown):
    """All that is shown of an answer, in the order in which a reader needs it.

    Attributes
    ----------
    identification : Identification
    diagnosis : Diagnosis
        Verdict and causes.
    title : str
    headline : str
        The verdict in one or two sentences.
    next_step : str
        What to do with the answer.
    advice : tuple of str
        What else to do, the most important first.
    parameters : tuple of ParameterResult
        All of them; those that moved most where there are very many.
    channels : tuple of ChannelFit
        Every sensor with every load of every record of responses.
    statistics : tuple of (str, str)
        Rank, misfit and the like: a label and a text.
    notes : tuple of str
        What the intervals include, and how they were found.
    provenance : mapping
    """

    identification: Identification
    diagnosis: Diagnosis
    title: str
    headline: str
    next_step: str
    advice: tuple[str, ...]
    parameters: tuple[ParameterResult, ...]
    channels: tuple[ChannelFit, ...]
    statistics: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """Sound, approximate, wrong_model, undetermined or untested."""
        return self.diagnosis.judgement.verdict

    @property
    def listed(self) -> tuple[ParameterResult, ...]:
        """All parameters, except the values of single records of a property that varies between records."""
        return tuple(parameter for parameter in self.parameters if not parameter.is_own)

    @property
    def ranked_channels(self) -> tuple[ChannelFit, ...]:
        """The channels, the worst fitted first."""
        return tuple(sorted(self.channels, key=lambda channel: -channel.error))

    def overview(self) -> Overview:
        """Text with verdict, next step and any words on the mesh, above a table with the rows of the parameters.

        A row has name, value with unit, 95 % interval and state. Values that single records have of a varying property
        are left out.
        """
        rows = [
            (one.name, with_unit(one.value_text, one.unit_text), one.interval_text, one.state) for one in self.listed
        ]
        mesh = self.identification.mesh
        words = [self.headline, self.next_step, *([as_sentence(mesh)] if mesh else [])]
        return Overview("\n".join(words), ("parameter", "value", "95 % interval", "state"), rows)


def results_view(
    identification: Identification,
    diagnosis: Diagnosis | None = None,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
) -> ResultsView:
    """A result as console, files, pages and Python show it: verdict, next step, parameters, channels and statistics.

    Parameters
    ----------
    identification : Identification
        Result of `identify`.
    diagnosis : Diagnosis, optional
        Verdict and causes; without it the verdict is made here, and no causes are searched for.
    title : str
        Heading.
    provenance : mapping, optional
        Versions, digests of input files and settings.

    Returns
    -------
    ResultsView

    Examples
    --------
    >>> import numpy as np
    >>> import structid as sid
    >>> spring = sid.Spring("spring", ["0X"], ["1X"], stiffness=900.0, loss_factor=0.02)
    >>> mass = sid.PointMass("mass", [1], 2.0)
    >>> structure = sid.Structure({0: [0.0], 1: [1.0]}, [mass, spring], ["0X"], active=["X"])
    >>> unknown = sid.parameters(structure, [sid.Unknown("stiffness", "spring")])
    >>> lines = sid.FrfRecord(np.linspace(1, 6, 60), np.ones((60, 1, 1), complex), ["1X"], ["1X"], "accelerance")
    >>> record = sid.simulated_record(structure, unknown, lines, 0.01, np.random.default_rng(1))
    >>> view = sid.results_view(sid.identify(structure, unknown, record))
    >>> view.verdict, view.next_step
    ('sound', 'Use the values with their intervals.')
    >>> [(one.name, one.state) for one in view.parameters]
    [('stiffness[spring]', 'determined')]
    """
    require_class(
        "identification",
        identification,
        Identification,
        "make it by `identify` or `identify_together`",
    )
    is_searched = diagnosis is not None and NOT_TRIED not in diagnosis.judgement.reasons
    diagnosis = diagnosis or Diagnosis(judged(identification))
    sentences = _BETWEEN_SENTENCES.split(diagnosis.judgement.words)
    n_headline = 2 if len(sentences[0]) < _SHORT_SENTENCE else 1
    advice = _advice(identification, diagnosis, sentences[n_headline:])
    return ResultsView(
        identification=identification,
        diagnosis=diagnosis,
        title=title,
        headline=" ".join(sentences[:n_headline]),
        next_step=_next_step(identification, diagnosis, is_searched, any(_DOUBTFUL in words for words in advice)),
        advice=advice,
        parameters=_parameters(identification),
        channels=tuple(channel for fit in identification.fits for channel in _channels(fit)),
        statistics=_statistics(identification),
        notes=(identification.assumption, *identification.intervals.notes),
        provenance=dict(provenance or {}),
    )


def _next_step(identification: Identification, diagnosis: Diagnosis, is_searched: bool, is_any_doubtful: bool) -> str:
    """Sentence on the one thing to do next; "" if there is nothing to do.

    `is_searched` is True if causes were searched for, `is_any_doubtful` if a sentence of the advice calls a parameter doubtful.
    """
    verdict = diagnosis.judgement.verdict
    if verdict == "wrong_model" and diagnosis.causes:
        first = diagnosis.causes[0]
        run = f"`structid identify {first.study}`" if first.study else ""
        if first.kind in _OF_THE_MODEL and run:
            return f"Run {run}, which has this change."
        return f"Check on the structure and in the test log whether {first.words}" + (
            f", and run {run}." if run else "."
        )
    if verdict == "wrong_model" and not is_searched:
        return _NOT_SEARCHED
    first_doubt = next(iter(doubted(diagnosis.sensitivities)), None)
    if verdict == "approximate" and first_doubt is not None and first_doubt.is_like_clock:
        return (
            f"Check the clock or sampling rate and {first_doubt.name} before you use a stiffness; the other values hold with their"
            " intervals."
        )
    if _is_to_be_taken_out(identification, diagnosis):
        names = join_words([identification.estimate.names[index] for index in identification.ran_away], 4)
        return f"Take {names} out of the model, where the record shows no stiffness, and identify again."
    return _NOT_ALL if verdict in ("sound", "approximate") and is_any_doubtful else _NEXT_STEPS[verdict]


def _is_to_be_taken_out(identification: Identification, diagnosis: Diagnosis) -> bool:
    """True if all that ran away in an undetermined answer is stiffness that went to zero, which the next step takes out."""
    away = identification.ran_away
    is_undetermined = diagnosis.judgement.verdict == "undetermined" and bool(away)
    return is_undetermined and all(is_gone(identification.estimate, index) for index in away)


def _advice(identification: Identification, diagnosis: Diagnosis, sentences: Sequence[str]) -> tuple[str, ...]:
    """Sentences on what to do, each once: the verdict beyond its headline, further causes, and warnings to act on.

    `sentences` are those of the verdict after the headline, and come first. What other parts of the results say is left
    out.
    """
    estimate = identification.estimate
    lines = list(sentences)
    if diagnosis.causes:
        lines.extend(_alternative(cause) for cause in diagnosis.causes[1:3])
    elif diagnosis.suggestions and diagnosis.suggestions[0].study:
        first = diagnosis.suggestions[0]
        lines = [f"{line.removesuffix('.')} ({first.study})." if first.words in line else line for line in lines]
    tests = () if estimate.goodness.residual_tests is None else estimate.goodness.residual_tests.words
    elsewhere = {*tests, *unidentified_warnings(estimate), f"{estimate.status_words} ({estimate.message})"}
    of_estimate = set(estimate_warnings(estimate))
    # a parameter of which the verdict says that it ran away needs the remedy alone, or nothing if that is the next step
    remedies = {
        ran_away_warning(estimate, index): ""
        if _is_to_be_taken_out(identification, diagnosis)
        else f"{estimate.names[index]}: {ran_away_remedy(estimate, index)}"
        for index in identification.ran_away
        if ran_away_words(estimate, index) in diagnosis.judgement.words
    }
    acts = [
        words
        for words in (remedies.get(words, words) for words in identification.warnings)
        if words
        and words not in elsewhere
        and not any(part in words for part in (INCLUDES_MODEL_ERROR, MAY_BE_ZERO, OTHER_MINIMA))
    ]
    flags = zip(estimate.names, estimate.identified, estimate.spread.is_free, strict=True)
    away = {estimate.names[index] for index in identification.ran_away}
    lost = [name for name, is_identified, is_free in flags if is_free and not is_identified and name not in away]
    said = "\n".join(lines)
    lines.extend(as_sentence(words) for words in acts if words not in of_estimate and words not in said)
    if lost and estimate.uncertainty.has_matrix:
        are, act = ("is", "it acts") if len(lost) == 1 else ("are", "they act")
        lines.append(f"{join_words(lost, 4)} {are} not determined: fix, tie, give a prior, or measure where {act}.")
    directions = [f"the data determine {direction.words}" for direction in estimate.identifiability.directions]
    told_by_verdict = {*directions[1:], *(f"the data determine {name} not at all" for name in away)}
    lines.extend(as_sentence(words) for words in acts if words in of_estimate and words not in told_by_verdict)
    if words := resting_words(diagnosis.sensitivities):
        lines.append(as_sentence(words))
    return tuple(dict.fromkeys(lines))


def _alternative(cause: Cause) -> str:
    """Sentence that names a cause after the first, and its suggested study file if it has one.

    It says if the cause is a second change beside the first, cannot be distinguished from the first, or is less likely.
    """
    run = f" ({cause.study})" if cause.study else ""
    if cause.is_second:
        return f"A second change beside the first: {cause.words}{run}."
    if cause.is_alike:
        return f"The data cannot distinguish the first change from this one: {cause.words}{run}."
    return f"Less likely: {cause.words}{run}."


def _parameters(identification: Identification) -> tuple[ParameterResult, ...]:
    """Result of each parameter, in the order of the estimate.

    Without a covariance matrix only the 50 parameters that changed most have one, the largest change first.
    """
    estimate = identification.estimate
    n_params = len(estimate.names)
    chosen = range(n_params) if estimate.uncertainty.has_matrix else largest_changes(estimate, MOST_CHANGES)
    shares = (
        np.full(n_params, np.nan)
        if identification.priors.variance_fraction is None
        else identification.priors.variance_fraction
    )
    tolerances = np.zeros(n_params) if estimate.fixed is None else estimate.fixed.std
    bounds = {bound.index: bound for bound in estimate.spread.at_bound}
    parts = [problem.parameters for problem in identification.problems]
    elements = {name: tuple(own) for part in parts for name, own in zip(part.names, part.elements, strict=True)}
    states = parameter_states(identification)
    shared = set(identification.listed)
    return tuple(
        ParameterResult(
            name=estimate.names[i],
            kind=estimate.kinds[i],
            unit=estimate.units[i],
            initial=float(estimate.initial[i]),
            value=float(estimate.values[i]),
            std=float(estimate.std[i]),
            interval=(float(identification.intervals.ends[i, 0]), float(identification.intervals.ends[i, 1])),
            std_noise=float(estimate.std_noise[i]),
            std_model_error=float(estimate.spread.std_model_error[i]),
            std_tolerances=float(tolerances[i]),
            state=states[i],
            identified=bool(estimate.identified[i]),
            ran_away=i in identification.ran_away,
            bound=bounds.get(i),
            prior_mean=float(identification.priors.mean[i]),
            prior_std=float(identification.priors.std[i]),
            prior_share=float(shares[i]),
            elements=elements.get(estimate.names[i], ()),
            is_own=i not in shared,
        )
        for i in chosen
    )


def parameter_states(identification: Identification) -> tuple[str, ...]:
    """State of each parameter, such as "determined" or "at its upper bound", in the order of the estimate.

    If several apply, the last of these holds: weakly determined (standard deviation above half the value, or part of an
    undetermined direction without priors), by prior, not determined, at a bound, ran away. "One of several" replaces
    "determined" where another set of values, more than a standard deviation away, fits equally well.
    """
    estimate = identification.estimate
    weak = np.zeros(len(estimate.names), dtype=bool)
    for direction in estimate.identifiability.directions:
        weak |= np.abs(direction.vector) > 0.1 * np.abs(direction.vector).max()
    has_prior = bool(np.isfinite(identification.priors.std).any())
    states = np.full(len(estimate.names), "determined", dtype=object)
    states[estimate.weakly_determined] = "weakly determined"
    states[weak] = "by prior" if has_prior else "weakly determined"
    states[list(identification.by_prior)] = "by prior"
    states[~estimate.identified] = "not determined"
    if identification.alternatives is not None:
        apart = np.abs(identification.alternatives.values - estimate.values).max(axis=0) > estimate.std
        states[apart & (states == "determined")] = "one of several"
    for bound in estimate.spread.at_bound:
        states[bound.index] = f"at its {bound.side} bound"
    states[list(identification.ran_away)] = "ran away"
    return tuple(states.tolist())


def _channels(fit: RecordFit) -> list[ChannelFit]:
    after, before = (
        np.median(error, axis=0).ravel().tolist() for error in (fit.relative_error, fit.initial_relative_error)
    )
    pairs = product(map(str, fit.evaluation.outputs), map(str, fit.evaluation.inputs))
    return [
        ChannelFit(fit.name, output, load, error, initial, index)
        for index, ((output, load), error, initial) in enumerate(zip(pairs, after, before, strict=True))
    ]


def _statistics(identification: Identification) -> tuple[tuple[str, str], ...]:
    """Pairs of a label and a text on search, rank, misfit, chi-square, starts, covariance basis, FRF errors and mass.

    Chi-square needs degrees of freedom, starts more than one of them, and the total mass (kg) is left out where it is
    0.
    """
    estimate = identification.estimate
    is_converged = estimate.status is Status.CONVERGED
    search = estimate.message if is_converged else f"{estimate.status.value.replace('_', ' ')}: {estimate.message}"
    rows = [("Search", f"{search}, {plural(estimate.search.n_iterations, 'iteration')}")]
    if estimate.uncertainty.has_matrix:
        identifiability = estimate.identifiability
        free = " free" if estimate.spread.at_bound else ""
        rows.append(
            (
                "Rank",
                f"{identifiability.rank} of {identifiability.n_free}{free} parameters, condition number"
                f" {number(identifiability.condition, 3)}",
            )
        )
    else:
        of_all = f"{number(estimate.spread.determined, 3)} combinations of {len(estimate.names)} parameters"
        rows.append(("Rank", f"the data determine {of_all}"))
    rows.append(("Misfit", estimate.goodness.misfit_words.removeprefix("misfit ")))
    fit = estimate.goodness
    if fit.degrees_of_freedom > 0:
        size = f"{number(fit.chi_square, 4)} with {number(fit.degrees_of_freedom, 5)} degrees of freedom"
        rows.append(("Chi-square", f"{size}, probability {number(fit.chi_square_probability, 2)}"))
    if estimate.search.n_starts > 1:
        rows.append(
            ("Starts", f"{estimate.search.n_agreeing} of {estimate.search.n_starts} searches ended at this minimum")
        )
    basis = {"noise": "the noise of the data", "model_error": "the residual, so that they include the model error"}
    rows.append(("Standard deviations from", basis[estimate.covariance_basis]))
    rows.extend(_fit_rows(identification.fits))
    if identification.mass.total > 0:
        rows.append(("Total mass", f"{with_std(identification.mass.total, identification.mass.std)} kg"))
    return tuple(rows)


def _fit_rows(fits: Sequence[RecordFit]) -> list[tuple[str, str]]:
    """Label and text with the median relative error of the FRFs of each record, and the lines over which it is taken."""
    rows = []
    for fit in fits:
        error = percent(float(np.median(fit.relative_error)), 3, signed=False)
        judged_lines, used_lines = len(fit.evaluation.frequency), len(fit.problem.record.frequency)
        name = f"Relative error of the FRFs, {fit.name}" if len(fits) > 1 else "Relative error of the FRFs"
        rows.append(
            (
                name,
                f"median {error} over {judged_lines} lines ({used_lines} of them fitted),"
                f" {plural(len(fit.evaluation.outputs), 'sensor')}, {plural(len(fit.evaluation.inputs), 'load')}",
            )
        )
    return rows


def search_summary(estimate: Estimate) -> dict[str, StoredEntry]:
    """Entries on a matrix-free search, ``search``, ``reason`` and ``n_determined``: its kind, why, and how many are determined."""
    return {"search": "matrix_free", "reason": search_reason(estimate), "n_determined": estimate.spread.determined}


def search_reason(estimate: Estimate) -> str:
    """Sentence on the memory that a search with a Jacobian would take."""
    return dense_search_fits(len(estimate.names), estimate.goodness.n_data)[1]


def changes_summary(estimate: Estimate) -> dict[str, StoredEntry]:
    """Entries of estimate.json for very many parameters: those that moved most, and the name of the file with all of them.

    The keys are ``n_beyond_chance``, ``chance_limit_std``, ``largest_changes`` and ``parameters_file``.
    """
    beyond, limit = estimate.beyond_chance()
    rows = _columns(estimate)
    return {
        "n_beyond_chance": int(beyond.sum()),
        "chance_limit_std": limit,
        "largest_changes": [
            {key: column[i] for key, column in rows.items()} for i in largest_changes(estimate, MOST_CHANGES)
        ],
        "parameters_file": PARAMETERS,
    }


def largest_changes(estimate: Estimate, count: int) -> list[int]:
    """Indices of the `count` parameters that moved from their start by most standard deviations, largest change first."""
    size: FloatArray = np.abs(estimate.distance)
    order: list[int] = np.argsort(-np.nan_to_num(size, nan=-1.0), kind="stable")[:count].tolist()
    return order


def changes_table(estimate: Estimate) -> str:
    """All parameters of an estimate as CSV text, one row each; a cell is empty where a number is not finite."""
    columns = _columns(estimate)
    rows = zip(*columns.values(), strict=True)
    return csv_text(columns, (["" if isinstance(v, float) and not np.isfinite(v) else v for v in row] for row in rows))


def _columns(estimate: Estimate) -> dict[str, list[StoredEntry]]:
    """Columns of the table of parameters: name, unit, values, deviations and changes of each."""
    return {
        "name": list(estimate.names),
        "kind": list(estimate.kinds),
        "unit": list(estimate.units),
        "value": estimate.values.tolist(),
        "std": estimate.std.tolist(),
        "std_relative_error": estimate.uncertainty.std_error.tolist(),
        "initial": estimate.initial.tolist(),
        "identified": estimate.identified.tolist(),
        "change_in_std": estimate.distance.tolist(),
    }
