"""What moves between the rounds of differences of a solver: values of its deck, and the study about them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.json_types import Tables
from structid.external.solved import Solved
from structid.forward import RecordProblem
from structid.identification.identified import Identification
from structid.inversion.search.work import Work
from structid.study.schema.study import Study, edited_study
from structid.unknowns.named_unknowns import begun_at

#: Most that a parameter moves in a round, as a part of its value.
_FARTHEST = 0.5


def deck_values(solved: Solved, problem: RecordProblem, names: Sequence[str], values: FloatArray) -> dict[str, float]:
    """Value of each parameter of the deck, by name, for `values` (n_params,) of the identified parameters `names`."""
    made = _property_values(problem, names, values)
    return {
        item.term.property: float(made[item.values][0])
        for item in problem.structure.properties
        if item.element == solved.model.name and item.term.property in solved.at
    }


def deck_std(solved: Solved, identification: Identification) -> dict[str, float]:
    """Standard deviation of each parameter of the deck, by name; 0 where the data do not determine it.

    A deck's parameter is d'p + constant in the parameters p that are sought, so its variance is d' C d.
    """
    problem, estimate = identification.problems[0], identification.estimate
    order = [estimate.names.index(name) for name in problem.parameters.names]
    std = estimate.std[order]
    covariance = estimate.covariance[np.ix_(order, order)] if estimate.uncertainty.has_matrix else np.diag(std**2)
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    rows = np.arange(len(problem.parameters.offset))
    weights = {
        item.term.property: problem.parameters.design[[rows[item.values][0]]].toarray()[0]
        for item in problem.structure.properties
        if item.element == solved.model.name and item.term.property in solved.at
    }
    return {name: float(np.sqrt(max(weight @ covariance @ weight, 0.0))) for name, weight in weights.items()}


def _property_values(problem: RecordProblem, names: Sequence[str], values: FloatArray) -> FloatArray:
    value_of = dict(zip(names, values.tolist(), strict=True))
    return problem.parameters.values(np.array([value_of[name] for name in problem.parameters.names]))


def within(solved: Solved, name: str, value: float) -> float:
    """`value` of the deck parameter `name`, limited to its bounds and to the farthest that one round may go."""
    at = solved.at[name]
    low, high = next(parameter.limits for parameter in solved.solver.deck.parameters if parameter.name == name)
    far = _FARTHEST * abs(at) or np.inf
    return float(np.clip(value, max(low, at - far), min(high, at + far)))


def tables(study: Study, at: Mapping[str, float | None], step: float | None = None) -> Tables:
    """The study's tables with finite differences about other values (`at`), or the nominal ones where that is None.

    With `step`, the differences begin with it, as a part of each value; else as the file says.
    """
    edited: Tables = deepcopy(dict(study.root.table))
    stated = tomllib.loads(study.text)["structure"]["solver"]["parameter"]
    own_steps = {entry["name"]: entry["step"] for entry in stated if "step" in entry}
    for entry in edited["structure"]["solver"]["parameter"]:
        name = entry["name"]
        changes = {"at": at[name], "step": step if step is not None and at[name] else own_steps.get(name)}
        for key, value in changes.items():
            entry.pop(key, None)
            if value is not None:
                entry[key] = value
    return edited


def about(
    study: Study, at: Mapping[str, float], known: Mapping[str, float], work: Work, step: float | None = None
) -> Study:
    """The study with finite differences about `at`, and searches that start at the `known` values of parameters.

    See `tables` for `step`.
    """
    edited = edited_study(study, tables(study, at, step), work)
    pairs = zip(study.setups, edited.setups, strict=True)
    setups = (replace(after, parameters=begun_at(before.parameters, known)) for before, after in pairs)
    return replace(edited, setups=tuple(setups))
