"""The ``[[unknown]]`` tables of a study file as `Parameters`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from structid.errors import InputError
from structid.parameters import Parameters, Prior, Unknown, parameters
from structid.structure import Structure
from structid.study.section import BOOLEAN, NUMBER, POSITIVE, RANGE, TEXT, TEXTS, Section

_KINDS = {
    "property": TEXT,
    "elements": TEXTS,
    "each": BOOLEAN,
    "start": NUMBER,
    "factor": BOOLEAN,
    "name": TEXT,
    "bounds": RANGE,
    "positive": BOOLEAN,
    "fixed": BOOLEAN,
    "tied_to": TEXT,
    "ratio": NUMBER,
}


def read_parameters(root: Section, structure: Structure) -> Parameters:
    """The parameters that the ``[[unknown]]`` tables declare on `structure`."""
    entries = root.sections("unknown")
    if not entries:
        raise root.error(
            "the study has no parameter to identify; add [[unknown]] tables with `property` and `elements`,"
            ' as in property = "mass", elements = "plate 1"'
        )
    unknowns = [_unknown(entry) for entry in entries]
    try:
        made = parameters(structure, unknowns)
    except InputError as error:
        raise entries[_culprit(structure, unknowns)].error(str(error)) from error
    if made.n_params == 0:
        raise entries[0].error("every parameter is fixed or tied, so there is none to identify; free at least one")
    return made


def _unknown(entry: Section) -> Unknown:
    given: dict[str, Any] = entry.values(_KINDS, ("property", "elements"), ("prior",))
    prior = entry.section("prior")
    if prior is not None:
        given["prior"] = Prior(**prior.values({"mean": NUMBER, "std": POSITIVE}, ("mean", "std")))
    if "bounds" in given:
        given["bounds"] = (given["bounds"][0], given["bounds"][1])
    return Unknown(**given)


def _culprit(structure: Structure, unknowns: list[Unknown]) -> int:
    """Which declaration is wrong: by itself, with those before it, or by its tie."""
    plain = [replace(unknown, tied_to=None) for unknown in unknowns]
    for i in range(len(unknowns)):
        if _fails(structure, [plain[i]]):
            return i
    for i in range(len(unknowns)):
        if _fails(structure, plain[: i + 1]):
            return i
    tied = [i for i, unknown in enumerate(unknowns) if unknown.tied_to is not None]
    for i in tied:
        if _fails(structure, [*plain[:i], unknowns[i], *plain[i + 1 :]]):
            return i
    return tied[0] if tied else 0


def _fails(structure: Structure, unknowns: list[Unknown]) -> bool:
    try:
        parameters(structure, unknowns)
    except InputError:
        return True
    return False
