"""The ``[[unknown]]`` and ``[[regularization]]`` tables of a study file: parameters, and what holds them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from structid.core.constraints import Positive
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward import ChannelUnknown
from structid.study.schema.section import Section
from structid.study.schema.tables import Key, as_list, choice, table_of
from structid.unknowns import Field, Parameters, Prior, Regularization, Smoothness, Sparsity, Unknown, penalty
from structid.unknowns.parameters import parameters
from structid.unknowns.priors import PriorKind


@dataclass(frozen=True)
class PriorEntry:
    """A prior as a study states it.

    Parameters
    ----------
    mean : float
        In the parameter's unit.
    std : float, optional
        Standard deviation in the parameter's unit.
    relative_std : float, optional
        The same as a part of the mean.
    kind : {"normal", "lognormal"}
        Log-normal for what is positive and known to a factor.
    """

    mean: float
    std: Positive | None = None
    relative_std: Positive | None = None
    kind: PriorKind = "normal"


PRIOR = table_of(PriorEntry)
UNKNOWN = table_of(Unknown, prior=PRIOR)
CHANNEL_ERROR = table_of(ChannelUnknown, prior=PRIOR)
_TERMS: dict[str, type[Smoothness] | type[Sparsity]] = {"smoothness": Smoothness, "sparsity": Sparsity}
REGULARIZATION = table_of(Smoothness) | {"kind": Key(choice(*_TERMS), "Which of them", required=True)}


def read_parameters(root: Section, structure: Structure, element_sets: Collection[str] = ()) -> Parameters:
    """The parameters that the ``[[unknown]]`` tables declare on `structure`.

    `element_sets` are the names of sets in any set-up of the study. Those that `structure` lacks are ignored, and a parameter
    that is declared on them alone is left out. Raises `StudyError` if a table cannot be used, or no free parameter is left.
    """
    entries = root.sections("unknown")
    if not entries:
        raise root.error(
            "the study has no parameter to identify; add [[unknown]] tables with `property` and `elements`,"
            ' as in property = "mass", elements = "plate 1"'
        )
    pairs = [(entry, _restrict_to_structure(_read_unknown(entry), structure, element_sets)) for entry in entries]
    entries, unknowns = [e for e, u in pairs if u is not None], [u for _, u in pairs if u is not None]
    try:
        declared = parameters(structure, unknowns)
    except InputError as error:
        raise entries[_faulty_declaration(structure, unknowns)].error(str(error)) from error
    if declared.n_params == 0:
        raise (entries or [root])[0].error(
            "every parameter is fixed or tied, so there is none to identify; free at least one"
        )
    return declared


def _read_unknown(entry: Section) -> Unknown:
    """The declaration of one ``[[unknown]]`` table, with its field and prior; each is None if the table has none."""
    values = entry.values(UNKNOWN)
    field = entry.section("field")
    if field is not None:
        values["field"] = field.read(Field)
    return Unknown(**values, prior=read_prior(entry))


def read_prior(entry: Section) -> Prior | None:
    """The prior in the table ``prior`` of an unknown; None without that table.

    ``relative_std`` is taken of the magnitude of the mean. `StudyError` unless just one of it and ``std`` is stated.
    """
    section = entry.section("prior")
    if section is None:
        return None
    stated = section.read(PriorEntry)
    if stated.std is not None and stated.relative_std is None:
        return Prior(stated.mean, stated.std, stated.kind)
    if stated.relative_std is not None and stated.std is None:
        return Prior(stated.mean, stated.relative_std * abs(stated.mean), stated.kind)
    raise section.error("must have either `std` or `relative_std`; add one of them")


def read_regularization(root: Section, structure: Structure, unknown: Parameters) -> tuple[Regularization, ...]:
    """The regularization terms of the ``[[regularization]]`` tables, in order; () if there are none.

    `unknown` are the parameters of the study on `structure`. `StudyError` if a term does not fit them.
    """
    terms = []
    for entry in root.sections("regularization"):
        values = entry.values(REGULARIZATION)
        term = _TERMS[values.pop("kind")](**values)
        with entry.located("strength" if "strength" in entry.table else None):
            penalty(structure, unknown, term)
        terms.append(term)
    return tuple(terms)


def _restrict_to_structure(unknown: Unknown, structure: Structure, element_sets: Collection[str]) -> Unknown | None:
    """The declaration restricted to the element sets that `structure` has; None if it has none of them.

    Only names in `element_sets` may be missing; others are kept, so that they are errors later.
    """
    present = {element.name for element in (*structure.elements, *structure.sets)}
    absent = set(element_sets) - present
    texts = as_list(unknown.elements)
    elements = [
        text for text in texts if text not in absent and (text in present or text.rpartition(":")[0] not in absent)
    ]
    if len(elements) == len(texts):
        return unknown
    name = unknown.name if unknown.each else unknown.name or ", ".join(texts)
    return replace(unknown, elements=tuple(elements), name=name) if elements else None


def _faulty_declaration(structure: Structure, unknowns: list[Unknown]) -> int:
    """Index of the first declaration that cannot be used: alone, else with those before it, else because of its tie.

    If none of these fails, it is the first declaration with a tie, else 0. `unknowns` are the declarations, in the
    order of the study.
    """
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
    """True if the declarations `unknowns` cannot be used on `structure`."""
    try:
        parameters(structure, unknowns)
    except InputError:
        return True
    return False
