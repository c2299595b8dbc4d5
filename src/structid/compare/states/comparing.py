"""Two states compared from start to end: read or run, tested, and what the reader should know first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from structid.compare.states.state import State, carried, state_of, stored_state, unchanged_parameters
from structid.core.display import listed
from structid.core.errors import InputError, SingularModelError
from structid.core.json_types import Plain, plain_table
from structid.forward import RecordProblem
from structid.identification.fixed_values import fixed_values, tolerances_of
from structid.identification.together import together
from structid.inversion import Estimate, Problem, Status
from structid.inversion.comparison.comparison import Comparison, compare_jointly, compare_states
from structid.inversion.comparison.multiple_tests import Correction, require_levels
from structid.inversion.comparison.states import LATER, states_problem
from structid.inversion.comparison.unchanged import UnchangedTest
from structid.inversion.estimate import estimate
from structid.inversion.fixed_values import FIXED
from structid.inversion.search.minimum import residual_at, squared
from structid.inversion.search.within_tolerances import FixedValues
from structid.inversion.search.work import StageProgress
from structid.study.run.run import SearchFailedError, is_matrix_free, run_refined
from structid.study.run.solver.rounds import about_answer
from structid.study.run.start import started
from structid.study.schema.study import Study, load_study
from structid.unknowns.named_unknowns import begun_at

COMPARE_PAGE = "compare.html"


@dataclass(frozen=True)
class CompareOptions:
    """How two states are compared. Every field is a flag of the command; a list may be one text with commas.

    Parameters
    ----------
    unchanged : sequence of str
        What is the same in both states: names, kinds or patterns, as in mass or 'mass[beam:*],loss_factor'.
    level : float
        Accepted rate of false declarations.
    power : float
        Probability that belongs to the detection limit.
    correction : {"holm", "benjamini_hochberg"}
        holm (family-wise) or benjamini_hochberg.
    least : float or str
        Least change of interest, as a part or in per cent, as in 0.01 or 1%: only what is surely larger is declared.
    """

    unchanged: Sequence[str] = ()
    level: float = 0.05
    power: float = 0.9
    correction: Correction = "holm"
    least: float | str = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "least", least_part(self.least))
        if isinstance(self.unchanged, str):
            names = tuple(name.strip() for name in self.unchanged.split(",") if name.strip())
            object.__setattr__(self, "unchanged", names)


def least_part(given: float | str) -> float:
    """A least change of interest as a part, from a number or a text such as ``1 %``.

    Raises
    ------
    InputError
        If it is no number of at least 0 and below 1.
    """
    text = str(given).strip()
    try:
        part = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        part = float("nan")
    if not 0 <= part < 1:
        raise InputError(f"`least` must be at least 0 and below 1, got {given!r}; 0.01 and 1% are one per cent")
    return part


class _Settings(TypedDict):
    level: float
    power: float
    correction: Correction
    least: float


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """A comparison with what it was made from.

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
        """Whether the data contradict what was named as unchanged."""
        return self.unchanged is not None and self.unchanged.is_contradicted

    @property
    def words(self) -> str:
        """The result in a sentence: what changed, or that the data contradict what was named as unchanged."""
        return self.unchanged.words if self.unchanged is not None and self.is_contradicted else self.comparison.words

    @property
    def basis_words(self) -> str:
        """How the states were brought together, in a sentence."""
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
    """What changed from the state of `baseline` to that of `later`.

    Parameters
    ----------
    baseline, later : path
        A study file, which is run, or a results folder of `structid identify`. With unchanged parameters the later
        one must be a study; if both are, all data are fitted at once.
    options : CompareOptions, optional
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.

    Raises
    ------
    InputError
        If a file cannot be used, or the states have nothing in common to compare.
    """
    chosen = options or CompareOptions()
    settings: _Settings = {
        "level": chosen.level,
        "power": chosen.power,
        "correction": chosen.correction,
        "least": least_part(chosen.least),
    }
    require_levels(chosen.level, chosen.power, chosen.correction)
    first = _state(Path(baseline), progress)
    if not chosen.unchanged:
        second = _state(Path(later), progress)
        found = compare_states(first.estimate, second.estimate, (), **settings)
        return ComparisonResult(found, first, second, "independent", _warnings(found, first, second))
    if Path(later).is_dir():
        raise InputError(
            f"{later}: unchanged parameters need the later state as a study file, got a results folder; give its study"
        )
    study = load_study(later)
    names = unchanged_parameters(first.estimate, study.parameters, chosen.unchanged)
    if first.result is None:
        second, free = (_run(_from_baseline(study, first, prior), progress) for prior in (names, ()))
        found = compare_states(first.estimate, second.estimate, names, **settings)
        test = _unchanged_test(names, _least_cost(second), _least_cost(free), first, free)
        return ComparisonResult(found, first, second, "carried", _warnings(found, first, second), test)
    second = _run(_from_baseline(study, first, ()), progress)
    joint = states_problem(_problem(first), _problem(second, first), names)
    held = _held_in_both(_freed(first), _freed(second), names)
    both = _joint_estimate(joint, held)
    found = compare_jointly(both, names, **settings)
    cost = squared(residual_at(joint, both.theta) if held is None else held.refit(both.names, both.theta).at.residual)
    common = (
        0 if held is None else sum(name.startswith(FIXED) and not name.endswith(LATER) for name in held.problem.names)
    )
    test = _unchanged_test(names, cost, _least_cost(first) + _least_cost(second), first, second, common)
    return ComparisonResult(found, first, second, "joint", _warnings(found, first, second), test)


def _least_cost(state: State) -> float:
    """Sum of squares at the answer of a state that was run, priors included, with held values free within their tolerances."""
    assert state.result is not None
    found = state.result.identification
    if found.target is None:
        raise InputError("states fitted in time cannot be joined; compare their results folders, or use fit 'spectra'")
    fixed = fixed_values(found.freed) if found.freed else None
    if fixed is None:
        return squared(residual_at(found.target, found.estimate.theta))
    return squared(fixed.refit(found.estimate.names, found.estimate.theta).at.residual)


def _unchanged_test(
    names: tuple[str, ...], cost: float, separate_cost: float, baseline: State, later: State, n_held: int = 0
) -> UnchangedTest:
    """The test of the parameters `names` as the same in both states, from states in which they are free.

    `n_held` held values are the same in both states too.
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
    freedom = sum(estimate.degrees_of_freedom for estimate in states)
    return UnchangedTest(names, cost, separate_cost, freedom, len(names) + n_held, differing)


def _freed(state: State) -> tuple[RecordProblem, ...]:
    """The problems of a state that was run with what its model holds among the unknowns."""
    return () if state.result is None else state.result.identification.freed


def _held_in_both(
    baseline: Sequence[RecordProblem], later: Sequence[RecordProblem], shared: Sequence[str]
) -> FixedValues | None:
    """The held values of both states, those of one name the same in both; None where nothing that is held may be wrong."""
    if not baseline or not later:
        return None
    first, second = together(baseline), together(later)
    names = [*shared, *(name for name in second.names if name.startswith(FIXED) and name in first.names)]
    known = {**tolerances_of(baseline), **tolerances_of(later)}
    known |= {name + LATER: std for name, std in tolerances_of(later).items() if name not in names}
    whole = states_problem(first, second, names)
    return FixedValues(whole, {name: known[name] for name in whole.names if name.startswith(FIXED)})


def _joint_estimate(problem: Problem, held: FixedValues | None) -> Estimate:
    try:
        return estimate(problem, fixed=held)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SearchFailedError(
            f"the search of both states at once failed: {error}; compare them without unchanged parameters"
        ) from error


def _state(path: Path, progress: StageProgress | None) -> State:
    return stored_state(path) if path.is_dir() else _run(load_study(path), progress)


def _run(study: Study, progress: StageProgress | None) -> State:
    ready = about_answer(started(study), progress)
    if is_matrix_free(ready):
        raise InputError(
            f"{study.path}: [method] search is 'matrix_free', which gives no covariance matrix to compare by; group the"
            " unknowns and leave it out"
        )
    return state_of(run_refined(ready, progress)[1])


def _from_baseline(study: Study, baseline: State, names: Sequence[str]) -> Study:
    """The study begun at the baseline's answer, which is the prior of `names`, stated with the first record."""
    made = [
        replace(source, parameters=carried(baseline.estimate, source.parameters, () if number else names))
        for number, source in enumerate(study.setups)
    ]
    return replace(study, setups=tuple(made))


def _problem(state: State, fallback: State | None = None) -> Problem:
    """The problem of a state that was run, begun at its answer, or at that of `fallback` where it has none."""
    assert state.result is not None
    source = state if fallback is None or state.estimate.status is Status.CONVERGED else fallback
    known = dict(zip(source.estimate.names, source.estimate.values, strict=True))
    found = state.result.identification
    if found.target is None:
        raise InputError("states fitted in time cannot be joined; compare their results folders, or use fit 'spectra'")
    return together([one.with_parameters(begun_at(one.parameters, known)) for one in found.problems])


def _warnings(found: Comparison, baseline: State, later: State) -> tuple[str, ...]:
    warnings = []
    for word, state in (("baseline", baseline), ("later state", later)):
        if state.estimate.status is not Status.CONVERGED:
            warnings.append(f"{word}: {state.estimate.status.words}")
        if state.doubt:
            warnings.append(
                f"the answer of the {word} is not sound, and what is declared changed rests on it: {state.doubt}"
            )
    held = dict.fromkeys((*baseline.held, *later.held))
    if held:
        warnings.append(
            f"{' and '.join(held)}: standard deviations of what it holds tell the assumption more than the data, and so"
            " do the tests of its changes"
        )
    if found.status is not Status.CONVERGED and Status.CONVERGED is baseline.estimate.status is later.estimate.status:
        warnings.append(f"both states at once: {found.status.words}")
    for names, one, other in (
        (found.only_before, "baseline", "later state"),
        (found.only_after, "later state", "baseline"),
    ):
        if names:
            warnings.append(
                f"{listed(names, 3)}: identified in the {one} only; if the {other} takes them as known from it, their uncertainty"
                " is missing in the changes: identify them in both and name them as unchanged"
            )
    untested = [n for n, p in zip(found.names, found.p_values, strict=True) if not np.isfinite(p)]
    if untested:
        warnings.append(f"not tested, because a state does not determine them: {', '.join(untested)}")
    blind = int((found.relative_detection_limit >= 1).sum())
    if blind:
        warnings.append(
            f"these data cannot show that {blind} of {len(found.names)} parameters fell to nothing: their detection"
            " limit is above 100 %; measure more places, more averages, or name what did not change"
        )
    same = set(baseline.inputs.items()) & set(later.inputs.items())
    shared = sorted(name for name, _ in same if not name.endswith(".toml"))
    if shared:
        warnings.append(f"both states read the same {', '.join(shared)}: independent data are assumed")
    return tuple(warnings)


def comparison_summary(result: ComparisonResult) -> dict[str, Plain]:
    """The content of compare.json, in the types of JSON; what is not finite is None."""
    found = result.comparison
    z = 1.959963984540054
    rows = [
        {
            "name": name,
            "kind": found.kinds[i],
            "unit": found.units[i],
            "before": found.before[i],
            "std_before": np.sqrt(found.covariance_before[i, i]),
            "after": found.after[i],
            "std_after": np.sqrt(found.covariance_after[i, i]),
            "change": found.change[i],
            "std": found.std[i],
            "interval_95": [found.change[i] - z * found.std[i], found.change[i] + z * found.std[i]],
            "relative_change": found.relative_change[i],
            "relative_std": found.relative_std[i],
            "p_value": found.p_values[i],
            "p_value_adjusted": found.adjusted[i],
            "changed": bool(found.changed[i]),
            "detection_limit": found.detection_limit[i],
            "relative_detection_limit": found.relative_detection_limit[i],
        }
        for i, name in enumerate(found.names)
    ]
    sides = {
        word: {"title": state.title, "status": state.estimate.status.value, "inputs": state.inputs}
        for word, state in (("baseline", result.baseline), ("later", result.later))
    }
    return plain_table(
        {
            "text": result.words,
            "status": found.status.value,
            "complete": found.is_complete,
            **sides,
            "basis": result.basis,
            "basis_text": result.basis_words,
            "unchanged": found.carried,
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
            "least_change": found.least,
            "correction": found.correction,
            "level": found.level,
            "power": found.power,
            "chi_square_of_all": found.statistic,
            "chi_square_probability": found.probability,
            "only_in_baseline": found.only_before,
            "only_in_later": found.only_after,
            "changes": rows,
            "covariance": found.covariance,
            "warnings": result.warnings,
        }
    )
