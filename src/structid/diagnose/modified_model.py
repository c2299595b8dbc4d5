"""A model with changes beside its records, and fits of it: near, with the start held, and as the options ask for.

Changes are screened on every record as FRFs: as they are, averaged from histories, or made of measured modes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, evenly_spaced_indices
from structid.core.errors import StructidError
from structid.core.last_results import LastResults
from structid.diagnose.causes.candidate import MOST_DOFS, Candidate, has_places
from structid.diagnose.model_edits import Edits
from structid.diagnose.receptances import MOST_LINES
from structid.diagnose.score_test import Point, point_at
from structid.diagnose.search_budget import METER, NO_LIMITS, FitLimits, SearchEndedError, count_effort
from structid.diagnose.tested_model import ModelDraft, TestedModel
from structid.diagnose.thresholds import (
    CHANGE_EFFORT,
    MODAL_VIEW_DECAY,
    MODAL_VIEW_ERROR,
    MODAL_VIEW_LINES,
    MODAL_VIEW_LOADS,
    MOST_CACHED,
    NEAR_LEVELS,
    NEAR_LINES,
    NEAR_MODEL_ERROR,
    RACED_AT,
    START_ERROR,
    WORTH_THINNING,
)
from structid.dynamics.receptance import DENSE_UP_TO
from structid.forward import FrfProblem, RecordProblem
from structid.forward.frf.continuation import LEVELS, smoothed_records
from structid.forward.frf.problem import smooth_stage
from structid.forward.modal import compares_modes
from structid.forward.record_problem import decide_polarities
from structid.forward.scatter import ScatterProblem, scatter_problems
from structid.forward.time import compares_spectra
from structid.identification.joint_problem import (
    fixed_values,
    freed_problems,
    harmonize_shared_parameters,
    joint_problem,
)
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup, titles
from structid.identification.varying import with_scatters
from structid.inversion import JointProblem, LevenbergMarquardt, Problem
from structid.inversion.search.least_squares import Minimum, minimize, residual_at, squared
from structid.inversion.search.levenberg_marquardt import Raced
from structid.inversion.search.within_tolerances import FixedValues
from structid.records import FrfRecord
from structid.unknowns.named_unknowns import begun_at

if TYPE_CHECKING:
    from structid.forward import ModalProblem


Values = TypeVar("Values", FloatArray, ComplexArray)


@dataclass(frozen=True, eq=False)
class FrfView:
    """A record as FRFs.

    Attributes
    ----------
    problem : FrfProblem
        FRF problem on the record's lines, without smoothing.
    smooth : dict of float to FrfRecord or None
        Smoothed data by their decay, as far as they were asked for; shared by views of the same data.
    chosen : (n,) float array, optional
        The frequencies of `near`, where they are known.
    """

    problem: FrfProblem
    smooth: dict[float, FrfRecord | None] = field(default_factory=dict)
    chosen: FloatArray | None = None

    def smoothed_at(self, level: float) -> FrfRecord | None:
        """FRFs of the record smoothed with a decay of `level` times the angular frequency; None if it cannot be done.

        That is where the lines of the record do not allow this decay, or the model has no modes. Made at the first
        call, then cached in `self.smooth`.
        """
        if level not in self.smooth:
            has_modes = self.problem.structure.has_modes
            known = dict(smoothed_records(self.problem.record, (level,))) if has_modes else {}
            self.smooth[level] = known.get(level)
        return self.smooth[level]

    @cached_property
    def near(self) -> FloatArray:
        """Frequencies in Hz, (n,), of the lines on which quick fits of changes are made.

        `self.chosen` if that is not None, else up to 300 lines of the record, evenly chosen.
        """
        if self.chosen is not None:
            return self.chosen
        frequency = self.problem.frequency
        return frequency[evenly_spaced_indices(len(frequency), NEAR_LINES)]

    def of(self, problem: RecordProblem) -> FrfView:
        """The view with the same data and quick-fit lines, and the structure, parameters and channel errors of `problem`."""
        channels = None if problem.channels is None else problem.channels.seen_by(self.problem.record)
        shown = replace(self.problem, structure=problem.structure, parameters=problem.parameters, channels=channels)
        return FrfView(shown, self.smooth, self.near)


def views(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], theta: Sequence[FloatArray], options: IdentifyOptions
) -> tuple[FrfView, ...]:
    """Records of a study as FRFs, one view for each: as measured, averaged from histories, or synthesized from modes.

    Parameters
    ----------
    setups, problems : sequences
        Set-up and problem of each record.
    theta : sequence of (n_own,) float arrays
        Free variables of each problem, at which measured modes are scaled.
    options : IdentifyOptions
        Decide how histories are averaged. Histories that are not have no view.
    """
    frf_views = []
    for setup, problem, record_theta in zip(setups, problems, theta, strict=True):
        if isinstance(problem, FrfProblem):
            frf_views.append(FrfView(problem))
        elif (shown := setup.shown_problem(options, problem.channels)) is not None:
            frf_views.append(FrfView(shown))
        elif compares_modes(problem):
            frf_views.append(modal_view(problem, record_theta))
    return tuple(frf_views)


def modal_view(problem: ModalProblem, theta: FloatArray) -> FrfView:
    """View of measured modes as FRFs with their stated errors, scaled to unit modal mass by the model's shapes.

    Modes and shape entries that were not measured are the model's. Damping that is not fitted is the model's, with
    errors as large as all that it does. Lines lie off the axis, where damping hardly counts, 90 from 0.7 to 1.15 times
    the measured frequencies and these; smoothed data are those of the same modes farther off. The loads are the two
    channels that move most. `theta` (n_params,) are the free variables of the model.
    """
    from structid.identification.modal_fit import damping_ratios, paired_modes  # for records of modes alone

    state, pairs = problem.model.state(problem.physical(theta)), paired_modes(problem, theta)
    seen, gains = state.seen, problem.model.readings(problem.physical(theta))[0][:, None]
    shapes, frequency = seen.copy(), state.modes.frequency.copy()
    measured_shapes, like = problem.data.shapes[:, problem.data.measured], seen[:, pairs.number]
    known = ~np.isnan(measured_shapes)
    measured_shapes = np.where(known, measured_shapes, 0.0)
    energy = np.einsum("cm,cm->m", measured_shapes, measured_shapes)
    size = np.einsum("cm,cm->m", measured_shapes, like) / np.where(energy > 0, energy, 1.0)
    shapes[:, pairs.number] = np.where(known, measured_shapes * size, like)
    frequency[pairs.number] = problem.data.frequency
    shape_std, frequency_std = np.zeros_like(shapes), np.zeros_like(frequency)
    stated = problem.data.shape_std[:, problem.data.measured]
    shape_std[:, pairs.number] = np.where(known, stated * np.abs(size), 0.0)
    frequency_std[pairs.number] = problem.data.frequency_std
    of_model = np.maximum(damping_ratios(state), 0.0)
    damping = np.zeros(len(frequency))
    if problem.settings.use_damping:
        measured = np.nan_to_num(problem.record.damping_ratio[problem.data.measured])
        damping[pairs.number] = np.where(of_model[pairs.number] > 0, measured, 0.0)
    likely = np.where(damping > 0, damping, of_model)
    kept = frequency > 0
    span = np.geomspace(0.7 * problem.data.frequency.min(), 1.15 * problem.data.frequency.max(), MODAL_VIEW_LINES)
    lines = np.unique(np.concatenate([span, problem.data.frequency]))
    channels = problem.record.channels
    drive = np.sort(np.argsort(-np.abs(shapes[:, pairs.number]).max(axis=1))[:MODAL_VIEW_LOADS])
    loads = tuple(channels[i] for i in drive)

    outputs, omega = shapes[:, kept], 2 * np.pi * frequency[kept]
    inputs, input_std = (shapes / gains)[drive][:, kept], (shape_std / gains)[drive][:, kept]
    output_std, omega_std = shape_std[:, kept], 2 * np.pi * frequency_std[kept]

    def record(level: float) -> FrfRecord:
        """Receptances (m/N) of the modes, with variances, at the frequencies `lines` (Hz) with a decay.

        The decay, 1/s, is `level` times the angular frequency of each line.
        """
        decay = level * 2 * np.pi * lines
        s = (decay + 2j * np.pi * lines)[:, None]
        of_mode, undamped = (1 / (s**2 + 2 * s * one[kept] * omega + omega**2) for one in (likely, damping))
        values = _synthesized(outputs, of_mode, inputs)
        size_of_line = np.sqrt((np.abs(values) ** 2).mean(axis=(1, 2), keepdims=True))
        power = np.abs(of_mode) ** 2
        variance = (
            MODAL_VIEW_ERROR**2 * (np.abs(values) ** 2 + (size_of_line / 5) ** 2)
            + np.abs(values - _synthesized(outputs, undamped, inputs)) ** 2
            + _synthesized(output_std**2, power, inputs**2)
            + _synthesized(outputs**2, power, input_std**2)
            + _synthesized(outputs**2, (2 * omega * omega_std * power) ** 2, inputs**2)
        )
        return FrfRecord(
            lines, values, channels, loads, "receptance", variance=variance, decay=decay, noise_source="declared"
        )

    near = record(MODAL_VIEW_DECAY)
    errors = None if problem.channels is None else problem.channels.seen_by(near)
    frf_problem = FrfProblem(problem.structure, problem.parameters, near, channels=errors)
    return FrfView(frf_problem, {level: record(level) if level > MODAL_VIEW_DECAY else near for level in LEVELS})


def _synthesized(outputs: FloatArray, of_mode: Values, inputs: FloatArray) -> Values:
    """FRFs (n_lines, n_outputs, n_inputs) as the sum over modes of the products of three factors.

    They are `outputs` (n_outputs, n_modes), `of_mode` (n_lines, n_modes) and `inputs` (n_inputs, n_modes).
    """
    frfs: Values = np.einsum("om,lm,im->loi", outputs, of_mode, inputs)
    return frfs


FINAL = LevenbergMarquardt(max_iterations=40, gain_tolerance=1e-5)
_COARSE = replace(FINAL, gain_tolerance=1e-4)
QUICK = Raced(max_iterations=12, gain_tolerance=1e-2, left_at=RACED_AT)


class NearFit(NamedTuple):
    """End of a quick fit: free variables (n_params,) and sum of squares at the end of each of its stages."""

    path: tuple[FloatArray, ...]
    costs: tuple[float, ...]

    @property
    def theta(self) -> FloatArray:
        """Free variables at the end of the quick fit, (n_params,)."""
        return self.path[-1]

    @property
    def chi_square(self) -> float:
        """Sum of squares at the end of the quick fit, of its last stage."""
        return self.costs[-1]


class Change(NamedTuple):
    """A candidate cause with its strength, and the edits that made it."""

    candidate: Candidate
    strength: float
    edits: Edits


@dataclass(frozen=True, eq=False)
class ModifiedModel:
    """A tested model, unchanged or with changes, with its records.

    Attributes
    ----------
    model : TestedModel
    problems : tuple of RecordProblem
        With starts as the set-ups have them.
    views : tuple of FrfView
        Every record as FRFs.
    changes : tuple of Change
        What was changed, in order.
    fit_limits : FitLimits
        Effort and processor time after which a fit is given up with `SearchEndedError`.
    """

    model: TestedModel
    problems: tuple[RecordProblem, ...]
    views: tuple[FrfView, ...]
    changes: tuple[Change, ...] = ()
    fit_limits: FitLimits = NO_LIMITS

    @property
    def setups(self) -> tuple[AnySetup, ...]:
        """The set-ups of all records."""
        return self.model.setups

    @cached_property
    def target(self) -> Problem:
        """The joint problem of all records."""
        return joint_problem(self.problems)

    @cached_property
    def fixed_values(self) -> FixedValues | None:
        """The values that the models fix, free within their tolerances; None where they are exact."""
        return fixed_values(freed_problems(self.setups, self.problems, self.model.options.tolerances))

    @cached_property
    def coarse(self) -> ModifiedModel:
        """The model with 300 lines of each record that has 450 or more; the model itself where none has."""
        fewer = tuple(_on_fewer_lines(problem) for problem in self.problems)
        is_thinned = any(few is not problem for few, problem in zip(fewer, self.problems, strict=True))
        return replace(self, problems=fewer) if is_thinned else self

    def changed(self, candidate: Candidate, strength: float) -> ModifiedModel:
        """Model with one more change, `candidate` with its `strength`; the last 64 are cached.

        Only those of models up to 64 degrees of freedom are. The effort of a change is counted in any case.

        Raises
        ------
        StructidError
            If the model has no place for the change.
        """
        METER.add(CHANGE_EFFORT)  # of cached models too: what a search may take depends on no cache
        if not self.is_small:
            return self._changed(candidate, strength)
        key = id(candidate), strength  # the candidate is kept too, so that its identity stands
        return self._cache.get_or_make(key, lambda: (candidate, self._changed(candidate, strength)))[1]

    @cached_property
    def _cache(self) -> LastResults[tuple[int, float], tuple[Candidate, ModifiedModel]]:
        return LastResults(MOST_CACHED)

    def _changed(self, candidate: Candidate, strength: float) -> ModifiedModel:
        """Model with one more change, `candidate` with its `strength`, made anew.

        Its data have the weights of the present model's data; its start values are those of the set-ups. Records that
        the change leaves out are dropped.

        Raises
        ------
        StructidError
            If the model has no place for the change.
        """
        edits = candidate.edits(self.model, strength)
        draft = ModelDraft(self.model)
        for edit in edits:
            edit.apply(draft)
        kept = [k for k in range(len(self.setups)) if draft.is_kept(k)]
        model = draft.build()
        before = [(self.setups[k], self.problems[k]) for k in kept]
        problems = prepared_problems(model, before, self.model.options)
        known = [problem for _, problem in before]
        problems = weighed_like(problems, known, scatter_problems(self.problems))
        shown = tuple(
            _same_view(problem, setup, self.setups[k], self.views[k], model.options)
            for problem, setup, k in zip(problems, model.setups, kept, strict=True)
        )
        change = Change(candidate, strength, edits)
        return ModifiedModel(model, problems, shown, (*self.changes, change), self.fit_limits)

    def values(self, theta: FloatArray) -> dict[str, float]:
        """Physical values in SI units of free variables (n_params,), by parameter name."""
        return dict(zip(self.target.names, self.target.physical(theta).tolist(), strict=True))

    def theta_of(self, known: Mapping[str, float]) -> FloatArray:
        """Free variables (n_params,) from physical values by name; parameters not in `known` start as the set-ups say."""
        return joint_problem([started_at(problem, known) for problem in self.problems]).theta_start

    @property
    def is_large(self) -> bool:
        """True where a record's model has more than `MOST_DOFS` degrees of freedom, so that only a few changes are fitted."""
        return any(setup.structure.n_dofs > MOST_DOFS for setup in self.setups)

    @property
    def has_places(self) -> bool:
        """True if the models are small enough for changes at nodes and elements; else only those of records are tried."""
        return all(has_places(view.problem) for view in self.views)

    @property
    def is_small(self) -> bool:
        """True if the models are so small that screening second changes by a linear step is quick (`are_small`)."""
        return are_small(self.setups)

    @property
    def is_of_modes(self) -> bool:
        """True if all records are of modes."""
        return all(compares_modes(problem) for problem in self.problems)

    def smoothed(self, levels: Sequence[float] = LEVELS) -> list[tuple[float, JointProblem]]:
        """Pairs (level, joint problem on FRFs smoothed by it), in the order of `levels`.

        A level is a decay in parts of the angular frequency. Levels that the lines of any record do not allow are left
        out; empty if all records are of modes.
        """
        if self.is_of_modes:
            return []
        stages = []
        for level in levels:
            records = [view.smoothed_at(level) for view in self.views]
            stage = tuple(
                smooth_stage(view.problem, record, START_ERROR)
                for view, record in zip(self.views, records, strict=True)
                if record is not None
            )
            if len(stage) == len(self.views):
                stages.append((level, JointProblem(stage, first_prior_counts=True)))
        return stages

    def anchored(self) -> JointProblem:
        """The joint problem of all `anchored_problems`."""
        return JointProblem(self.anchored_problems(), first_prior_counts=True)

    def anchored_problems(self) -> tuple[RecordProblem, ...]:
        """Problems of the quick fit, one for each record, with a prior at its start on every parameter that has none.

        FRFs, also those that stand for histories, are fitted in logarithms on at most 300 lines, with a model error of
        10 % times the root of the part of lines that is used; modes as they are. The prior has a deviation of 20 % of
        the size of a parameter of the structure, 100 % of that of a channel error.
        """
        anchored: list[RecordProblem] = []
        for of, view in zip(self._fitted_near(), self.views, strict=True):
            near = [part.kept_near_start(START_ERROR if i == 0 else 1.0) for i, part in enumerate(of.parts)]
            one = of.with_parts(near)
            anchored.append(_on_lines(one, view.near) if isinstance(one, FrfProblem) else one)
        return tuple(anchored)

    def _fitted_near(self) -> list[RecordProblem]:
        """The problem of each record in near fits: modes as they are, FRFs for all other records."""
        pairs = zip(self.problems, self.views, strict=True)
        return [problem if compares_modes(problem) else view.problem for problem, view in pairs]

    @property
    def shown_problems(self) -> tuple[FrfProblem, ...]:
        """FRF problems of the `views`, one for each, as they are."""
        return tuple(view.problem for view in self.views)

    def anchored_views(self) -> tuple[FrfProblem, ...]:
        """FRF problems of the `views`, one for each, with the log residual and model error of the anchored fit."""
        return tuple(replace(one, form="log", model_error=NEAR_MODEL_ERROR) for one in self.shown_problems)

    def point_at(self, problems: Sequence[FrfProblem], theta: FloatArray, most_lines: int = MOST_LINES) -> Point:
        """FRF problems, one for each record, linearized at free variables (n_params,), on at most `most_lines` lines each.

        Modes that are fitted without damping say nothing of it, and fixed values may move within their tolerances.
        """
        silent = [k for k, one in enumerate(self.problems) if compares_modes(one) and not one.settings.use_damping]
        return point_at(problems, theta, silent, most_lines, self._free_fixed_values)

    def _free_fixed_values(self, problems: Sequence[FrfProblem]) -> tuple[RecordProblem, ...]:
        """FRF problems of all records with the fixed values of their models among the unknowns.

        Empty for models of more than 1200 degrees of freedom. `problems` has one FRF problem for each record. The gain
        that all channels of a record share is kept only where the record is one of FRFs or histories.
        """
        if self.is_large:
            return ()
        has_gain = [problem.measured_responses is not None for problem in self.problems]
        return freed_problems(self.setups, problems, self.model.options.tolerances, has_gain)

    def minimize(self, problem: Problem, method: LevenbergMarquardt, theta: FloatArray) -> Minimum:
        """The minimum of `problem` from free variables (n_params,), with its effort counted.

        Raises
        ------
        SearchEndedError
            If it takes more than `fit_limits`.
        """
        return minimize(problem, method, theta, count_effort(problem, self.fit_limits))

    def fit_near(self, limits: Sequence[float] = (), path: Sequence[Mapping[str, float]] = ()) -> NearFit:
        """The quick fit with parameters kept near their start: to smoothed data, then to the lines themselves.

        Parameters
        ----------
        limits : sequence of float
            Sums of squares, one for each stage; no limits by default. The fit fails where a stage on smoothed data ends above
            its limit; the search on the lines themselves ends early where it would stay above the last. Limits for another
            number of stages count only for the lines.
        path : sequence of mappings of str to float
            Physical values where each stage of the quick fit without the last change ended. A stage begins there where that
            is nearer: a change that explains nothing then ends where it begins.

        Raises
        ------
        SearchEndedError
            If a stage on smoothed data ends above its limit, or the fit takes more than `fit_limits`.
        """
        problems = [*(stage for _, stage in self.smoothed(NEAR_LEVELS)), self.anchored()]
        if len(limits) != len(problems):  # there are none, or they are those of a model with other stages
            limits = [*[np.inf] * (len(problems) - 1), limits[-1] if limits else np.inf]
        ends = [self.theta_of(values) for values in path] if len(path) == len(problems) else []
        theta, steps = np.asarray(self.target.theta_start), list[Minimum]()
        for number, (problem, limit) in enumerate(zip(problems, limits, strict=True)):
            starts = [theta, *ends[number : number + 1]]
            if len(starts) > 1:
                starts.sort(key=lambda start: squared(residual_at(problem, start)))
            steps.append(self.minimize(problem, replace(QUICK, above=limit), starts[0]))
            theta = steps[-1].theta
            if len(steps) < len(problems) and steps[-1].costs[-1] > limit:
                raise SearchEndedError("other changes are far better on smoothed data")
        return NearFit(tuple(step.theta for step in steps), tuple(float(step.costs[-1]) for step in steps))

    def fitted(self, starts: Sequence[FloatArray]) -> Minimum:
        """The minimum of least cost among full fits from each of `starts`, (n_params,) arrays of free variables.

        Later fits are left where they will hardly get below the best so far. Starts from which the fit fails are passed over.

        Raises
        ------
        StructidError
            If the fits fail from all starts, each since the model cannot be evaluated or the fit takes more than `fit_limits`.
        """
        return self._best_fit(self.target, FINAL, starts)

    def fitted_on_fewer_lines(self, starts: Sequence[FloatArray]) -> Minimum:
        """Minimum of least cost among fits of `self.coarse`, the model on fewer lines, from each of `starts`.

        Starts are (n_params,) free variables; a full fit may start at the minimum.

        Raises
        ------
        StructidError
            If the fits fail from all starts.
        """
        return self._best_fit(self.coarse.target, _COARSE, starts)

    def _best_fit(self, problem: Problem, method: LevenbergMarquardt, starts: Sequence[FloatArray]) -> Minimum:
        """Minimum of least cost among searches of `problem` by `method` from each of `starts`, each (n_params,).

        A search is left early where it will hardly get below the best end so far: where its next step promises to lower
        the sum of squares by less than 5 %, and even a few such steps would end above. Searches that fail are passed
        over.

        Raises
        ------
        StructidError
            If the searches fail from all starts; its cause is the last error.
        """
        minima: list[Minimum] = []
        last: Exception | None = None
        for theta in starts:
            best = min((float(minimum.costs[-1]) for minimum in minima), default=np.inf)
            try:
                minima.append(self.minimize(problem, method.raced(best, RACED_AT), theta))
            except (StructidError, np.linalg.LinAlgError) as error:
                last = error
        if not minima:
            raise StructidError(f"no start can be evaluated: {last}") from last
        return min(minima, key=lambda minimum: minimum.costs[-1])


def started_at(problem: RecordProblem, known: Mapping[str, float]) -> RecordProblem:
    """The problem with its start at the physical values `known`, by parameter name; others keep the start that they have."""
    common = {
        own_name: name
        for one in problem.parameters.scatters
        for own_name, name in zip(one.own, one.common, strict=True)
    }
    known = {**{own_name: known[name] for own_name, name in common.items() if name in known}, **known}
    return problem.with_parts([begun_at(part, known) for part in problem.parts])


def base_model(model: TestedModel, problems: Sequence[RecordProblem], theta: FloatArray) -> ModifiedModel:
    """The model as it is, without a change; its records are shown as FRFs at the free variables `theta` (n_params,).

    `problems` has one problem for each record.
    """
    theta_of_records = JointProblem(tuple(problems), first_prior_counts=True).unknowns.split(theta)
    return ModifiedModel(model, tuple(problems), views(model.setups, problems, theta_of_records, model.options))


def are_small(setups: Sequence[AnySetup]) -> bool:
    """True if no model has more than `DENSE_UP_TO` degrees of freedom, so that a screening by a linear step is quick."""
    return all(setup.structure.n_dofs <= DENSE_UP_TO for setup in setups)


def prepared_problems(
    model: TestedModel, before: Sequence[tuple[AnySetup, RecordProblem]], options: IdentifyOptions
) -> tuple[RecordProblem, ...]:
    """The problems of a changed model, one for each record; histories that are as before are not transformed again.

    Parameters
    ----------
    model : TestedModel
        The changed model.
    before : sequence of (RecordSetup, RecordProblem)
        Each record of `model` before the change.
    options : IdentifyOptions
        Those before the change.

    Raises
    ------
    StructidError
        If a record cannot be prepared with the changed model.
    """
    problems = [
        _prepared(setup, known, problem, model.options, model.options is options)
        for setup, (known, problem) in zip(model.setups, before, strict=True)
    ]
    same = harmonize_shared_parameters(problems, titles(model.setups))
    return tuple(decide_polarities(problem, problem.theta_start) for problem in same)


def _prepared(
    setup: AnySetup,
    earlier_setup: AnySetup,
    earlier_problem: RecordProblem,
    options: IdentifyOptions,
    is_same_record: bool,
) -> RecordProblem:
    """Problem of a changed set-up, with transformed histories of the earlier problem where the record is unchanged.

    `earlier_setup` and `earlier_problem` are those before the change. `is_same_record` is True if the options are
    unchanged. Histories are reused where they are fitted as spectra, and channel errors and settings are the same too.
    """
    if (
        is_same_record
        and compares_spectra(earlier_problem)
        and setup.record is earlier_setup.record
        and tuple(setup.channel_unknowns) == tuple(earlier_setup.channel_unknowns)
        and vars(setup)["settings"] is vars(earlier_setup)["settings"]
    ):
        kept = earlier_problem.with_structure(setup.structure, setup.parameters)
    else:
        kept = None
    return kept or setup.prepared(options).problem


def _on_fewer_lines(problem: RecordProblem) -> RecordProblem:
    """Problem on 300 evenly spaced of its lines or samples; the same problem if it has fewer than 450."""
    n_lines = len(problem.frequency)
    if n_lines < WORTH_THINNING * NEAR_LINES:
        return problem
    return problem.with_lines(evenly_spaced_indices(n_lines, NEAR_LINES))


def _on_lines(problem: FrfProblem, frequency: FloatArray) -> FrfProblem:
    """The problem in logarithms of FRFs, on those of its lines that are in `frequency` (Hz).

    The model error, 10 % on all lines, is smaller on fewer lines, so that they weigh as much as all.
    """
    keep = np.flatnonzero(np.isin(problem.frequency, frequency))
    error = NEAR_MODEL_ERROR * float(np.sqrt(len(keep) / len(problem.frequency)))
    return replace(problem.with_lines(keep), form="log", model_error=error)


def _same_view(
    problem: RecordProblem, setup: AnySetup, earlier_setup: AnySetup, earlier_view: FrfView, options: IdentifyOptions
) -> FrfView:
    """FRF view of a changed problem, with data and quick-fit lines of the earlier view where the record is the same.

    `setup` is that of the changed problem, `earlier_setup` and `earlier_view` those before the change. FRFs of another
    record keep the lines of the quick fit: by their numbers if there are as many lines, else by frequency. `options`
    decide how histories are averaged to FRFs.
    """
    if isinstance(problem, FrfProblem):
        known = earlier_view.problem.record
        if _is_same(problem.record, known):
            return FrfView(replace(problem, record=known), earlier_view.smooth, earlier_view.near)
        if len(problem.frequency) == len(earlier_view.problem.frequency):  # the lines may have other frequencies
            return FrfView(
                problem, chosen=problem.frequency[np.isin(earlier_view.problem.frequency, earlier_view.near)]
            )
        return FrfView(problem, chosen=earlier_view.near)
    if setup.record is earlier_setup.record:
        return earlier_view.of(problem)
    return views([setup], [problem], [problem.theta_start], options)[0]


def weighed_like(
    problems: Sequence[RecordProblem], before: Sequence[RecordProblem], scatters: Sequence[ScatterProblem]
) -> tuple[RecordProblem, ...]:
    """The changed `problems` with the weights of those before the change, where both have the same data.

    `before` has one problem for each of `problems`; `scatters` are the problems of scatter between records, whose deviations
    are taken over by name.
    """
    weighed = tuple(_of_weights(one, other) for one, other in zip(problems, before, strict=True))
    return with_scatters(weighed, {one.name: one.std for one in scatters})


def _of_weights(problem: RecordProblem, before: RecordProblem) -> RecordProblem:
    """Problem whose FRFs have the noise-free magnitudes (`sizes`) of those of `before`, if both are the same FRFs.

    Else `problem` itself.
    """
    if isinstance(problem, FrfProblem) and isinstance(before, FrfProblem) and _is_same(problem.record, before.record):
        return replace(problem, record=replace(problem.record, sizes=before.record.sizes))
    return problem


def _is_same(one: FrfRecord, other: FrfRecord) -> bool:
    return one is other or (
        one.values.shape == other.values.shape and one.outputs == other.outputs and one.inputs == other.inputs
        and one.segment == other.segment and np.array_equal(one.frequency, other.frequency)
        and np.array_equal(one.values, other.values)
    )  # fmt: skip
