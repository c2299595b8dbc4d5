"""The ``[[regularization]]`` tables of a study file."""

from __future__ import annotations

from structid.structure import Structure
from structid.study.schema.section import POSITIVE, TEXT, TEXTS, Kind, Section, choice
from structid.unknowns import Parameters, Regularization, Smoothness, Sparsity, penalty

_KINDS: dict[str, type[Smoothness] | type[Sparsity]] = {"smoothness": Smoothness, "sparsity": Sparsity}
_RULES = ("marginal_likelihood", "l_curve", "discrepancy")
_STRENGTH = Kind(
    "a positive number or one of " + ", ".join(f'"{rule}"' for rule in _RULES),
    lambda value: value in _RULES if isinstance(value, str) else POSITIVE.accepts(value),
)


def read_regularization(root: Section, structure: Structure, unknown: Parameters) -> tuple[Regularization, ...]:
    """The terms that the study holds its parameters by; () where there is none."""
    found = []
    for entry in root.sections("regularization"):
        kinds = {"kind": choice(*_KINDS), "property": TEXT, "elements": TEXTS, "strength": _STRENGTH}
        given = entry.values(kinds, ("kind", "property", "elements"))
        term = _KINDS[given.pop("kind")](**given)
        with entry.located("strength" if "strength" in entry.table else None):
            penalty(structure, unknown, term)
        found.append(term)
    return tuple(found)
