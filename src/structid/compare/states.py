"""Two states of a structure compared: read or run, tested, what stays unchanged, and what the reader should know first."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypedDict, cast

import numpy as np

from structid.compare.options import CompareOptions, least_part
from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words, plural
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError, SingularModelError
from structid.core.json_types import JsonValue, plain_table
from structid.diagnose.verdict import NOT_TRIED, Judgement, Verdict, judged
from structid.fem import Structure
from structid.files.contained import hdf5_fields, texts_of
from structid.forward import RecordProblem
from structid.forward.fixed_values import tolerances_of
from structid.identification.joint_problem import fixed_values, joint_problem
from structid.identification.mesh_pieces import MESH_WARNINGS
from structid.inversion import Estimate, Problem, Status
from structid.inversion.diagnostics.residual_tests import Correction, require_levels
from structid.inversion.estimate import estimate
from structid.inversion.fixed_values import FIXED
from structid.inversion.search.least_squares import residual_at, squared
from structid.inversion.search.within_tolerances import FixedValues
from structid.inversion.search.work import StageProgress
from structid.inversion.state_comparison import (
    LATER,
    Comparison,
    Identified,
    UnchangedTest,
    compare_jointly,
    compare_states,
    states_problem,
)
from structid.study.results.hdf5 import number_of_pieces
from structid.study.results.result import StudyResult
from structid.study.run.run import SearchFailedError, is_matrix_free, refine_mesh, relinearized_study, run_prepared
from structid.study.schema.model.structure import read_structure
from structid.study.schema.section import InputFiles, Section, read_study_text
from structid.study.schema.study import Study, cut_study, load_study
from structid.study.schema.unknowns import read_parameters
from structid.unknowns import Parameters, joint_prior
from structid.unknowns.named_unknowns import begun_at

COMPARE_PAGE = "compare.html"


class _Settings(TypedDict):
    """Settings of the comparison of two states, as `compare_states` takes them."""

    level: float
    power: float
    correction: Correction
    least: float


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """A comparison of two states with the states it was made from.

    Attributes
    ----------
    comparison : Comparison
    baseline, later : State
    basis : str
        ``independent``: two estimates from data of their own; ``carried``: the baseline's result was the prior of
        what did not change; ``joint``: one estimate from both data, with what did not change in common.
    warnings : tuple of str
    unchanged : UnchangedTest or None
        Whether the data allow what was named as unchanged; None where nothing was.
    """

    comparison: Comparison
    baseline: State
    later: State
    basis: str
    warnings: tuple[str, ...]
    unchanged: UnchangedTest | None = None

    @property
    def is_contradicted(self) -> bool:
        """True if the data contradict what was named as unchanged."""
        return self.unchanged is not None and self.unchanged.is_contradicted

    @property
    def words(self) -> str:
        """The result in a sentence: what changed, or that the data contradict what was named as unchanged."""
        return self.unchanged.words if self.unchanged is not None and self.is_contradicted else self.comparison.words

    @property
    def basis_words(self) -> str:
        """A clause on how the two states were identified: independently, with a prior from the baseline, or jointly."""
        kinds = Counter(name.split("[")[0] for name in self.comparison.carried)
        shared = ", ".join(f"{kind} ({count})" for kind, count in kinds.items())
        return {
            "independent": "each state was identified from its own data; uncertainties of both add",
            "carried": f"the later state was identified with the baseline's result as the prior of {shared}",
            "joint": f"both states were identified at once from all data, with {shared} in common",
        }[self.basis]


def compare(
    baseline: str | Path,
    later: str | Path,
    options: CompareOptions | None = None,
    progress: StageProgress | None = None,
) -> ComparisonResult:
    """Changes of the parameters from the state `baseline` to the state `later`, with tests of their significance.

    Without unchanged parameters the states are independent estimates. With them, the result of a baseline folder is the
    prior of the later study, or, where both are studies, all data are fitted at once, and it is tested whether they did
    not change.

    Parameters
    ----------
    baseline, later : path
        A study file, which is run, or a results folder of `structid identify`. With unchanged parameters the later one
        must be a study.
    options : CompareOptions, optional
        Unchanged parameters, level, power and correction of the tests, and least change of interest.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.

    Returns
    -------
    ComparisonResult
        Changes with their tests, both states, the basis (independent, carried or joint), warnings and the test of the
        unchanged.

    Raises
    ------
    InputError
        If a file cannot be used, or the states have nothing in common to compare.
    SearchFailedError
        If a search, of a state or of both at once, comes to where the model cannot be evaluated.
    """
    chosen = options or CompareOptions()
    settings: _Settings = {
        "level": chosen.level,
        "power": chosen.power,
        "correction": chosen.correction,
        "least": least_part(chosen.least),
    }
    require_levels(chosen.level, chosen.power, chosen.correction)
    before = _source(Path(baseline), progress)
    if not chosen.unchanged:
        first, second = _on_one_mesh([before, _source(Path(later), progress)])
        comparison = compare_states(first.estimate, second.estimate, (), **settings)
        return ComparisonResult(comparison, first, second, "independent", _warnings(comparison, first, second))
    if Path(later).is_dir():
        raise InputError(
            f"{later}: unchanged parameters need the later state as a study file, got a results folder; give its study"
        )
    study = load_study(later)
    first = before if isinstance(before, State) else before.run(1)
    names = unchanged_parameters(first.estimate, study.parameters, chosen.unchanged)
    with_prior, without_prior = (
        _StudySource(study, progress, partial(_from_baseline, baseline=first, names=prior)) for prior in (names, ())
    )
    if first.result is None:
        _, second, free = _on_one_mesh([first, with_prior, without_prior])
        comparison = compare_states(first.estimate, second.estimate, names, **settings)
        test = _unchanged_test(names, _least_cost(second), _least_cost(free), first, free)
        return ComparisonResult(comparison, first, second, "carried", _warnings(comparison, first, second), test)
    first, second = _on_one_mesh([before, without_prior], [first])
    joint = states_problem(_restart_problem(first), _restart_problem(second, first), names)
    fixed = _fixed_in_both(_problems_with_free_values(first), _problems_with_free_values(second), names)
    both = _joint_estimate(joint, fixed)
    comparison = compare_jointly(both, names, **settings)
    cost = _cost_within_tolerances(joint, fixed, both)
    common = (
        0 if fixed is None else sum(name.startswith(FIXED) and not name.endswith(LATER) for name in fixed.problem.names)
    )
    test = _unchanged_test(names, cost, _least_cost(first) + _least_cost(second), first, second, common)
    return ComparisonResult(comparison, first, second, "joint", _warnings(comparison, first, second), test)


def _least_cost(state: State) -> float:
    """Least sum of squares of a state that was run, priors included, with fixed values free within their tolerances.

    Without such tolerances it is that at the answer.

    Raises
    ------
    InputError
        If time histories were fitted in a way that gives no problem to be joined.
    """
    assert state.result is not None
    answer = state.result.identification
    if answer.target is None:
        raise InputError("states fitted in time cannot be joined; compare their results folders, or use fit 'spectra'")
    fixed = fixed_values(answer.freed) if answer.freed else None
    return _cost_within_tolerances(answer.target, fixed, answer.estimate)


def _cost_within_tolerances(problem: Problem, fixed: FixedValues | None, estimate: Estimate) -> float:
    """Sum of squares of `problem` at its estimate, priors included, with the values `fixed` free within their tolerances."""
    cost = squared(residual_at(problem, estimate.theta))
    return cost if fixed is None else squared(fixed.refit(estimate.names, estimate.theta, cost).at.residual)


def _unchanged_test(
    names: tuple[str, ...], cost: float, separate_cost: float, baseline: State, later: State, n_fixed: int = 0
) -> UnchangedTest:
    """Test that the parameters `names` have one value in both states, with those of them that differ, the most significant first.

    `cost` is the sum of squares of a joint fit with one value of each, `separate_cost` that of the two states fitted apart.
    `n_fixed` fixed values have one value in the joint fit too, and count as conditions. `baseline` and `later` give the
    estimates and the degrees of freedom.
    """
    shared = [name for name in names if name in later.estimate.names]
    tests = compare_states(baseline.estimate, later.estimate, ())
    rows = sorted((i for i, name in enumerate(tests.names) if name in shared), key=lambda i: tests.p_values[i])
    differing = tuple(
        (tests.names[i], float(tests.relative_change[i]), float(tests.change[i] / tests.std[i]))
        for i in rows
        if tests.changed[i]
    )
    states = [state.estimate for state in (baseline, later) if isinstance(state.estimate, Estimate)]
    freedom = sum(estimate.goodness.degrees_of_freedom for estimate in states)
    return UnchangedTest(names, cost, separate_cost, freedom, len(names) + n_fixed, differing)


def _problems_with_free_values(state: State) -> tuple[RecordProblem, ...]:
    """Problems of a state, one for each record, with fixed values among the unknowns; empty for a results folder."""
    return () if state.result is None else state.result.identification.freed


def _fixed_in_both(
    baseline: Sequence[RecordProblem], later: Sequence[RecordProblem], shared: Sequence[str]
) -> FixedValues | None:
    """Fixed values of both states with their tolerances, common where they have the same name.

    None if a state has none. `baseline` and `later` are the problems with fixed values among the unknowns, `shared` the
    parameters common to both states. Where only the later state has a fixed value, or has it for itself, its name gets
    a suffix.
    """
    if not baseline or not later:
        return None
    first, second = joint_problem(baseline), joint_problem(later)
    names = [*shared, *(name for name in second.names if name.startswith(FIXED) and name in first.names)]
    tolerances = {**tolerances_of(baseline), **tolerances_of(later)}
    tolerances |= {name + LATER: std for name, std in tolerances_of(later).items() if name not in names}
    whole = states_problem(first, second, names)
    return FixedValues(whole, {name: tolerances[name] for name in whole.names if name.startswith(FIXED)})


def _joint_estimate(problem: Problem, fixed: FixedValues | None) -> Estimate:
    try:
        return estimate(problem, fixed=fixed)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SearchFailedError(
            f"the search of both states at once failed: {error}; compare them without unchanged parameters"
        ) from error


@dataclass(frozen=True, eq=False)
class _StudySource:
    """A study that is to be run, its parameters changed by `begun` first."""

    study: Study
    progress: StageProgress | None
    begun: Callable[[Study], Study] = lambda study: study

    @property
    def may_be_divided(self) -> bool:
        return self.study.leaves_pieces_open and bool(self.study.structure.divisible)

    def run(self, pieces: int) -> State:
        """The state that a run gives with beams divided into `pieces`; from 1 on into as many as the mesh asks for."""
        return _run_study(self.begun(cut_study(self.study, pieces) if pieces > 1 else self.study), self.progress)


def _source(path: Path, progress: StageProgress | None) -> _StudySource | State:
    return stored_state(path) if path.is_dir() else _StudySource(load_study(path), progress)


def _on_one_mesh(sources: Sequence[_StudySource | State], known: Sequence[State] = ()) -> tuple[State, ...]:
    """The states of `sources`, in order, with as many pieces of each beam as the finest, where that may be chosen.

    Studies are run again for that, so that what the mesh changes is the same in all states. `known` are states of the
    first sources that were run before; sources that are states are not run again.
    """
    others = [source if isinstance(source, State) else source.run(1) for source in sources[len(known) :]]
    states, is_alike = [*known, *others], False
    while not is_alike:
        most, is_alike = max(state.pieces for state in states), True
        for k, (source, state) in enumerate(zip(sources, states, strict=True)):
            if isinstance(source, _StudySource) and source.may_be_divided and state.pieces < most:
                states[k], is_alike = source.run(most), False
    return tuple(states)


def _run_study(study: Study, progress: StageProgress | None) -> State:
    """The state that a run of `study` gives, with beams divided finer and a solver's model renewed at the answer.

    The run is that of `structid identify` without its search for causes and without a last check by the solver.

    Raises
    ------
    InputError
        If the search is matrix-free.
    """
    ready = relinearized_study(study, progress)
    if is_matrix_free(ready):
        raise InputError(
            f"{study.path}: [method] search is 'matrix_free', which gives no covariance matrix to compare by; group the"
            " unknowns and leave it out"
        )
    _, result = refine_mesh(ready, run_prepared(ready, progress), progress)
    return state_of(result)


def _from_baseline(study: Study, baseline: State, names: Sequence[str]) -> Study:
    """The study with its starts at the baseline's answer, whose covariance is the prior of the parameters `names`.

    The prior is stated with the first record only; without `names` there is none.
    """
    made = [
        replace(source, parameters=carried(baseline.estimate, source.parameters, () if number else names))
        for number, source in enumerate(study.setups)
    ]
    return replace(study, setups=tuple(made))


def _restart_problem(state: State, fallback: State | None = None) -> Problem:
    """The joint problem of a state that was run, with its start at the answer of that state.

    The start is at the answer of `fallback` where the search of `state` did not converge.

    Raises
    ------
    InputError
        If the state was fitted in time.
    """
    assert state.result is not None
    source = state if fallback is None or state.estimate.status is Status.CONVERGED else fallback
    values = dict(zip(source.estimate.names, source.estimate.values, strict=True))
    identification = state.result.identification
    if identification.target is None:
        raise InputError("states fitted in time cannot be joined; compare their results folders, or use fit 'spectra'")
    return joint_problem(
        [problem.with_parameters(begun_at(problem.parameters, values)) for problem in identification.problems]
    )


def _warnings(comparison: Comparison, baseline: State, later: State) -> tuple[str, ...]:
    """Sentences on failed or doubtful states, parameters not tested or too uncertain to show a change, and common files."""
    warnings = []
    for word, state in (("baseline", baseline), ("later state", later)):
        if state.estimate.status is not Status.CONVERGED:
            warnings.append(f"{word}: {state.estimate.status.words}")
        if state.doubt:
            warnings.append(
                f"the answer of the {word} is not sound, and what is declared changed rests on it: {state.doubt}"
            )
        warnings += [f"{word}: {words}" for words in state.mesh_warnings]
    if baseline.pieces != later.pieces:
        warnings.append(
            f"beams are of {plural(baseline.pieces, 'piece')} in the baseline and of {later.pieces} in the later state, so that"
            f" what the mesh moves does not cancel: identify both with `subdivide = {max(baseline.pieces, later.pieces)}`"
        )
    regularizations = dict.fromkeys((*baseline.regularizations, *later.regularizations))
    if regularizations:
        warnings.append(
            f"{' and '.join(regularizations)}: standard deviations of the regularized parameters, and tests of their"
            " changes, depend on the assumption more than on the data"
        )
    if (
        comparison.status is not Status.CONVERGED
        and Status.CONVERGED is baseline.estimate.status is later.estimate.status
    ):
        warnings.append(f"both states at once: {comparison.status.words}")
    for names, word, other in (
        (comparison.only_before, "baseline", "later state"),
        (comparison.only_after, "later state", "baseline"),
    ):
        if names:
            warnings.append(
                f"{join_words(names, 3)}: identified in the {word} only; if the {other} takes them as known from it, their"
                " uncertainty is missing in the changes: identify them in both and name them as unchanged"
            )
    untested = [n for n, p in zip(comparison.names, comparison.p_values, strict=True) if not np.isfinite(p)]
    if untested:
        warnings.append(f"not tested, because a state does not determine them: {', '.join(untested)}")
    n_undetectable = int((comparison.relative_detection_limit >= 1).sum())
    if n_undetectable:
        warnings.append(
            f"these data cannot show that {n_undetectable} of {len(comparison.names)} parameters fell to nothing: their detection"
            " limit is above 100 %; measure more places, more averages, or name what did not change"
        )
    common_inputs = set(baseline.inputs.items()) & set(later.inputs.items())
    shared = sorted(name for name, _ in common_inputs if not name.endswith(".toml"))
    if shared:
        warnings.append(f"both states read the same {', '.join(shared)}: independent data are assumed")
    return tuple(warnings)


def comparison_summary(result: ComparisonResult) -> dict[str, JsonValue]:
    """Content of compare.json in types of JSON; numbers that are not finite become None.

    Keys mirror `ComparisonResult` and its `Comparison`: texts, ``baseline`` and ``later``, ``unchanged`` and its test,
    settings and statistics of the test, ``changes`` (a row for each parameter), ``covariance`` and ``warnings``.
    """
    comparison = result.comparison
    z = 1.959963984540054
    rows = [
        {
            "name": name,
            "kind": comparison.kinds[i],
            "unit": comparison.units[i],
            "before": comparison.before[i],
            "std_before": np.sqrt(comparison.covariance_before[i, i]),
            "after": comparison.after[i],
            "std_after": np.sqrt(comparison.covariance_after[i, i]),
            "change": comparison.change[i],
            "std": comparison.std[i],
            "interval_95": [comparison.change[i] - z * comparison.std[i], comparison.change[i] + z * comparison.std[i]],
            "relative_change": comparison.relative_change[i],
            "relative_std": comparison.relative_std[i],
            "p_value": comparison.p_values[i],
            "p_value_adjusted": comparison.adjusted[i],
            "changed": bool(comparison.changed[i]),
            "detection_limit": comparison.detection_limit[i],
            "relative_detection_limit": comparison.relative_detection_limit[i],
        }
        for i, name in enumerate(comparison.names)
    ]
    sides = {
        word: {"title": state.title, "status": state.estimate.status.value, "inputs": state.inputs}
        for word, state in (("baseline", result.baseline), ("later", result.later))
    }
    return plain_table(
        {
            "text": result.words,
            "status": comparison.status.value,
            "complete": comparison.is_complete,
            **sides,
            "basis": result.basis,
            "basis_text": result.basis_words,
            "unchanged": comparison.carried,
            "unchanged_test": None
            if result.unchanged is None
            else {
                "text": result.unchanged.words,
                "contradicted": result.unchanged.is_contradicted,
                "chi_square": result.unchanged.cost,
                "chi_square_separate": result.unchanged.separate_cost,
                "degrees_of_freedom": result.unchanged.freedom,
                "probability": result.unchanged.probability,
            },
            "least_change": comparison.least,
            "correction": comparison.correction,
            "level": comparison.level,
            "power": comparison.power,
            "chi_square_of_all": comparison.statistic,
            "chi_square_probability": comparison.probability,
            "only_in_baseline": comparison.only_before,
            "only_in_later": comparison.only_after,
            "changes": rows,
            "covariance": comparison.covariance,
            "warnings": result.warnings,
        }
    )


@dataclass(frozen=True, eq=False)
class StoredChanges:
    """Influence of fixed values as a results folder stores it; the attributes are those of `FixedValueInfluence`."""

    change_names: tuple[str, ...]
    change_tolerances: tuple[float, ...]
    changes: FloatArray


@dataclass(frozen=True, eq=False)
class StoredEstimate:
    """Estimate as a results folder stores it; the attributes are those of `Estimate`."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    status: Status
    covariance_of_data: FloatArray
    fixed: StoredChanges | None = None


@dataclass(frozen=True, eq=False)
class DrawableStructure:
    """Structure, parameters and channels for a drawing of the state.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
    outputs, inputs : tuple of Dof
    """

    structure: Structure
    parameters: Parameters
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]


@dataclass(frozen=True, eq=False)
class State:
    """One side of a comparison.

    Attributes
    ----------
    title : str
    path : Path
        Study file or results folder.
    estimate : Estimate or StoredEstimate
    inputs : mapping of str to str
        SHA-256 of the input files.
    result : StudyResult or None
        Of a study that was run just now.
    regularizations : tuple of str
        Names of the regularizations that hold its parameters.
    drawn : DrawableStructure or None
        None where the study of a results folder cannot be read without the files beside it.
    judgement : Judgement
        The verdict, and its words.
    mesh_warnings : tuple of str
        On what a coarse mesh does to its values.
    pieces : int
        Number into which each beam was divided.
    """

    title: str
    path: Path
    estimate: Estimate | StoredEstimate
    inputs: Mapping[str, str]
    result: StudyResult | None
    regularizations: tuple[str, ...]
    drawn: DrawableStructure | None
    judgement: Judgement
    mesh_warnings: tuple[str, ...] = ()
    pieces: int = 1

    @property
    def doubt(self) -> str:
        """The verdict in words; "" where the answer is sound."""
        return "" if self.judgement.verdict == "sound" else self.judgement.words

    @property
    def is_wrong(self) -> bool:
        """True if the model does not explain the record."""
        return self.judgement.verdict == "wrong_model"


def state_of(result: StudyResult) -> State:
    """The state of a study, from the result of a run; its verdict is without a search for causes.

    It has the estimate, the digests of the input files, regularizations, structure to draw, warnings on the mesh and
    the number of pieces of each beam.
    """
    identification = result.identification
    drawn = DrawableStructure(
        identification.structure, identification.parameters, identification.sensors, identification.loads
    )
    study = result.study
    regularizations = tuple(item.name for item in identification.priors.regularizations)
    judgement = judged(identification, untried=NOT_TRIED)
    return State(
        study.title,
        study.path,
        identification.estimate,
        result.provenance.inputs,
        result,
        regularizations,
        drawn,
        judgement,
        _on_mesh(identification.warnings),
        study.structure.subdivide,
    )


def _on_mesh(warnings: Iterable[object]) -> tuple[str, ...]:
    return tuple(words for words in map(str, warnings) if words.startswith(MESH_WARNINGS))


def stored_state(folder: Path) -> State:
    """The state stored in a results folder of `structid identify`, for comparison with another.

    Raises
    ------
    InputError
        If estimate.json or estimate.h5 is missing or cannot be read, or the search was matrix-free (`FileError`).
    """
    texts = {}
    for name in ("estimate.json", "estimate.h5"):
        if not (folder / name).is_file():
            raise FileError(f"{folder}: holds no {name}; give a results folder of `structid identify`, or a study file")
    try:
        texts = json.loads((folder / "estimate.json").read_text(encoding="utf-8"))
        if texts.get("search") == "matrix_free":
            raise FileError(
                f"{folder}: is of search 'matrix_free', which gives no covariance matrix to compare by; group the unknowns"
                " and identify again without it"
            )
        estimate, channels, pieces = _stored_estimate(
            folder / "estimate.h5", Status(texts["status"]), texts["covariance_basis"]
        )
        inputs = dict(texts["provenance"]["inputs"])
        regularizations = tuple(str(item["name"]) for item in texts.get("regularization", ()))
    except FileError:
        raise
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder}: its estimate.json and estimate.h5 cannot be used ({error}); write them again with"
            " `structid identify`"
        ) from error
    title, drawn = str(texts.get("title", folder.name)), _read_drawn(folder, channels)
    judgement = Judgement(cast(Verdict, texts.get("verdict", "sound")), str(texts.get("verdict_text", "")))
    mesh_warnings = _on_mesh(texts.get("warnings", ()))
    return State(title, folder, estimate, inputs, None, regularizations, drawn, judgement, mesh_warnings, pieces)


def _stored_estimate(path: Path, status: Status, basis: str) -> tuple[StoredEstimate, dict[str, tuple[str, ...]], int]:
    """The estimate stored in estimate.h5, channel names under ``outputs`` and ``inputs``, and pieces of each beam.

    `basis` is "noise" or "model_error" and chooses the covariance, to which that of fixed values is added.

    Raises
    ------
    FileError
        If the file does not say into how many pieces beams were cut.
    KeyError
        If an array is missing.
    ValueError
        If arrays differ in their number of parameters.
    """
    names, matrix = ("names", "kinds", "units"), f"covariance_{basis}"
    of_channels = ("frf/outputs", "frf/inputs", "modal_record_1/channels")
    fixed_keys = [f"parameters/{name}" for name in ("fixed_names", "fixed_tolerances", "fixed_changes")]
    of_parameters = [f"parameters/{name}" for name in (*names, "values", matrix)]
    fields = hdf5_fields(path, (*of_channels, *of_parameters, *fixed_keys, "subdivide"))
    texts = {name: texts_of(fields[f"parameters/{name}"]) for name in names}
    values = np.asarray(fields["parameters/values"], dtype=float)
    covariance = np.asarray(fields[f"parameters/{matrix}"], dtype=float)
    if "frf/outputs" in fields:
        channels = {"outputs": texts_of(fields["frf/outputs"]), "inputs": texts_of(fields["frf/inputs"])}
    else:
        channels = {"outputs": texts_of(fields["modal_record_1/channels"]), "inputs": ()}
    n = len(values)
    if covariance.shape != (n, n) or any(len(words) != n for words in texts.values()):
        raise ValueError("parameters of different numbers")
    fixed, of_data = None, locked(covariance)
    if fixed_keys[0] in fields:
        tolerances, changes = (np.asarray(fields[key], dtype=float) for key in fixed_keys[1:])
        if changes.shape != (n, len(tolerances) + 1):
            raise ValueError("changes by fixed values of other numbers")
        of_each = (*tolerances.tolist(), 0.0)  # the second order is last
        fixed = StoredChanges(texts_of(fields[fixed_keys[0]]), of_each, locked(changes))
        covariance = covariance + changes @ changes.T
    estimate = StoredEstimate(
        texts["names"], texts["kinds"], texts["units"], locked(values), locked(covariance), status, of_data, fixed
    )
    return estimate, channels, number_of_pieces(fields.get("subdivide"), path.parent)


def _read_drawn(folder: Path, channels: dict[str, tuple[str, ...]]) -> DrawableStructure | None:
    """Structure, parameters and channels of study.toml in `folder`, for a drawing; None if they cannot be read.

    `channels` has the names of the channels under ``outputs`` and ``inputs``.
    """
    try:
        source = read_study_text(folder / "study.toml")
        root = Section(source, (), source.table)
        section = root.section("structure")
        if section is None:
            return None
        structure = read_structure(section, InputFiles(folder))
        unknown = read_parameters(root, structure)
        return DrawableStructure(structure, unknown, parse_dofs(channels["outputs"]), parse_dofs(channels["inputs"]))
    except InputError:
        return None


def unchanged_parameters(baseline: Identified, later: Parameters, patterns: Sequence[str]) -> tuple[str, ...]:
    """Names of parameters in both states that match any of `patterns`, each once, in the order of the patterns.

    A pattern is a full name, a kind such as ``mass``, or a text in which ``*`` stands for any characters.

    Raises
    ------
    InputError
        If a pattern chooses nothing that both states identify.
    """
    common = [(n, k) for n, k in zip(baseline.names, baseline.kinds, strict=True) if n in later.names]
    chosen: list[str] = []
    for pattern in patterns:
        expression = re.compile(".*".join(map(re.escape, pattern.split("*"))))
        matches = [n for n, k in common if pattern == k or expression.fullmatch(n)]
        if not matches:
            have = ", ".join(dict.fromkeys(k for _, k in common)) or "none"
            raise InputError(
                f"`unchanged` must name parameters that both states identify, got {pattern!r}; kinds that both have:"
                f" {have}"
            )
        chosen += matches
    return tuple(dict.fromkeys(chosen))


def carried(baseline: Identified, later: Parameters, unchanged: Sequence[str]) -> Parameters:
    """The later state's parameters, started at the baseline's values, with its result as prior of the unchanged ones.

    Parameters
    ----------
    baseline : Estimate or StoredEstimate
        Estimate of the baseline.
    later : Parameters
        Parameters of the later state; those that the baseline lacks keep their starts.
    unchanged : sequence of str
        Names; see `unchanged_parameters`. Their prior is the Gaussian of the baseline with all its correlations, in
        logarithms if all values are positive, so that what the baseline does not know of them is not known later
        either; without names there is no prior. Pass the same names to `compare_states` as `carried`.

    Raises
    ------
    InputError
        If the baseline does not determine one of them.
    """
    later = begun_at(later, dict(zip(baseline.names, baseline.values.tolist(), strict=True)))
    if not unchanged:
        return later
    index_of = {name: i for i, name in enumerate(baseline.names)}
    rows = [index_of[name] for name in unchanged]
    return later.coupled(
        joint_prior(
            "baseline",
            later.names,
            tuple(unchanged),
            baseline.values[rows],
            baseline.covariance_of_data[np.ix_(rows, rows)],
            logarithmic=bool((baseline.values[rows] > 0).all()),
        )
    )
