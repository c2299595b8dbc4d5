"""The ``[[unknown]]`` tables of a study file as `Parameters`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from structid.errors import InputError
from structid.structure import Structure
from structid.study.schema.section import (
    BOOLEAN,
    COUNTS,
    INTEGER,
    NUMBER,
    POSITIVE,
    RANGE,
    TEXT,
    TEXTS,
    Section,
    as_list,
    choice,
)
from structid.unknowns import Field, Parameters, Prior, Unknown
from structid.unknowns.parameters import parameters

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


def read_parameters(root: Section, structure: Structure, known: Collection[str] = ()) -> Parameters:
    """The parameters that the ``[[unknown]]`` tables declare on `structure`.

    Element sets among `known`, those of a study's other set-ups, may be missing from `structure`; what is declared on
    them alone is then no parameter of it.
    """
    entries = root.sections("unknown")
    if not entries:
        raise root.error(
            "the study has no parameter to identify; add [[unknown]] tables with `property` and `elements`,"
            ' as in property = "mass", elements = "plate 1"'
        )
    pairs = [(entry, _present(_unknown(entry), structure, known)) for entry in entries]
    entries, unknowns = [e for e, u in pairs if u is not None], [u for _, u in pairs if u is not None]
    try:
        made = parameters(structure, unknowns)
    except InputError as error:
        raise entries[_culprit(structure, unknowns)].error(str(error)) from error
    if made.n_params == 0:
        raise (entries or [root])[0].error(
            "every parameter is fixed or tied, so there is none to identify; free at least one"
        )
    return made


def _unknown(entry: Section) -> Unknown:
    given: dict[str, Any] = entry.values(_KINDS, ("property", "elements"), ("prior", "field"))
    field = entry.section("field")
    if field is not None:
        kinds = {"intervals": COUNTS, "degree": INTEGER}
        grid = field.values(kinds, ("intervals",))
        with field.located():
            given["field"] = Field(tuple(as_list(grid.pop("intervals"))), **grid)
    prior = entry.section("prior")
    if prior is not None:
        given["prior"] = read_prior(prior)
    if "bounds" in given:
        given["bounds"] = (given["bounds"][0], given["bounds"][1])
    return Unknown(**given)


def read_prior(entry: Section) -> Prior:
    """The prior that a ``prior`` table states."""
    kinds = {"mean": NUMBER, "std": POSITIVE, "relative_std": POSITIVE, "kind": choice("normal", "lognormal")}
    stated: dict[str, Any] = entry.values(kinds, ("mean",))
    relative = stated.pop("relative_std", None)
    if (relative is None) == ("std" not in stated):
        raise entry.error("must have either `std` or `relative_std`; add one of them")
    if relative is not None:
        stated["std"] = relative * abs(stated["mean"])
    return Prior(**stated)


def _present(unknown: Unknown, structure: Structure, known: Collection[str]) -> Unknown | None:
    """The same declaration on the element sets that `structure` has; None where it has none of them."""
    own = {element.name for element in structure.elements}
    absent = set(known) - own
    texts = as_list(unknown.elements)
    kept = [text for text in texts if text not in absent and (text in own or text.rpartition(":")[0] not in absent)]
    if len(kept) == len(texts):
        return unknown
    name = unknown.name if unknown.each else unknown.name or ", ".join(texts)
    return replace(unknown, elements=tuple(kept), name=name) if kept else None


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
