"""Regularization of many parameters: smoothness over neighbours, and sparsity of changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.constraints import Positive, constraint_violation, declared_types
from structid.core.errors import InputError
from structid.fem import Structure
from structid.inversion.strengths import StrengthRule
from structid.unknowns.parameters import Parameters
from structid.unknowns.priors import Coupling
from structid.unknowns.unknown import named_members

#: Rows of penalties with more entries than this are kept sparse.
_DENSE_UP_TO = 2_000_000


class _Term:
    """Fields that both kinds of regularization term share."""

    is_sparse: ClassVar[bool]
    strength: float | StrengthRule

    @property
    def given(self) -> float | None:
        """The strength if it is a number; None if a rule chooses it."""
        return None if isinstance(self.strength, str) else float(self.strength)

    @property
    def rule(self) -> str:
        """Rule that chooses the strength; ``given`` where it is a number."""
        return self.strength if isinstance(self.strength, str) else "given"


@dataclass(frozen=True)
class Smoothness(_Term):
    """A property varies little from one element to the next: differences of its logarithm are held to 0.

    Neighbours are elements that share a node. The prior of each difference is Gaussian with a standard deviation of
    1 / sqrt(strength): 100 lets neighbours differ by about 10 %.

    Parameters
    ----------
    property : str
        As in `Unknown`.
    elements : str or sequence of str
        As in `Unknown`; each needs parameters of its own.
    strength : float or {"marginal_likelihood", "l_curve", "discrepancy"}
        Given, or the rule that chooses it from the data.
    """

    is_sparse: ClassVar[bool] = False

    property: str
    elements: str | Sequence[str]
    strength: Positive | StrengthRule = "marginal_likelihood"


@dataclass(frozen=True)
class Sparsity(_Term):
    """Few elements differ from their start, as where damage is sought from a baseline.

    Parameters
    ----------
    property : str
        As in `Unknown`.
    elements : str or sequence of str
        As in `Unknown`.
    strength : float or "marginal_likelihood"
        ``marginal_likelihood``: every change has a Gaussian prior of its own width, and the widths that make the data
        most probable are 0 for most. A number: the sum of squares gains 2 strength sum abs(log(p / start)).
    """

    is_sparse: ClassVar[bool] = True

    property: str
    elements: str | Sequence[str]
    strength: Positive | Literal["marginal_likelihood"] = "marginal_likelihood"


Regularization = Smoothness | Sparsity


def term_name(term: Regularization) -> str:
    """Name of `term` in reports, such as ``smoothness of mass[beam]``."""
    elements = term.elements if isinstance(term.elements, str) else ", ".join(term.elements)
    return f"{type(term).__name__.lower()} of {term.property}[{elements}]"


def penalty(structure: Structure, unknown: Parameters, term: Regularization) -> Coupling:
    """The regularization rows of `term` at strength 1, as a coupling in logarithms.

    They are log ratios of neighbouring parameters (smoothness), or of parameters to their start (sparsity). `unknown`
    are the parameters of `structure`.

    Raises
    ------
    InputError
        If the strength is not usable, there are no parameters or no neighbours for it, or one may be negative.
    """
    _require_strength(term)
    columns, values = _parameters_of_term(structure, unknown, term)
    if not term.is_sparse:
        pairs = _neighbour_pairs(structure, columns, values)
        if not len(pairs):
            raise InputError(
                f"{term_name(term)} must have elements that share a node and have parameters of their own, got"
                f" {len(np.unique(columns))} parameters; set `each` on the unknown"
            )
        rows, ones = np.arange(len(pairs)), np.ones(len(pairs))
        entries = np.concatenate([ones, -ones]), (np.concatenate([rows, rows]), pairs.T.ravel())
        matrix = _dense_where_small(sparse.csr_array(entries, (len(pairs), unknown.n_params)))
        coupling = Coupling(term_name(term), matrix, np.zeros(len(pairs)), logarithmic=True)
    else:
        chosen = np.unique(columns)
        start = unknown.start[chosen]
        if not (start > 0).all():
            name = unknown.names[int(chosen[np.argmin(start)])]
            raise InputError(f"{term_name(term)} needs positive starts, got {start.min():g} for {name}")
        entries = np.ones(len(chosen)), (np.arange(len(chosen)), chosen)
        matrix = _dense_where_small(sparse.csr_array(entries, (len(chosen), unknown.n_params)))
        coupling = Coupling(term_name(term), matrix, np.log(start), logarithmic=True)
    unknown.coupled(coupling)
    return coupling


def _dense_where_small(matrix: sparse.csr_array) -> FloatArray | sparse.csr_array:
    return matrix.toarray() if matrix.shape[0] * matrix.shape[1] <= _DENSE_UP_TO else matrix


def _require_strength(term: Regularization) -> None:
    """Raise `InputError` unless the strength of `term` is a finite number or rule that its declaration allows."""
    problem = constraint_violation(declared_types(type(term))["strength"], term.strength)
    if problem or term.strength == np.inf:
        raise InputError(f"`strength` of {term_name(term)} {problem or 'must be finite, got inf'}")


def _parameters_of_term(structure: Structure, unknown: Parameters, term: Regularization) -> tuple[IntArray, IntArray]:
    """Indices of a parameter and of a property value that it enters, (n_pairs,) each, for the elements of a term.

    Raises `InputError` if no parameter enters them.
    """
    texts = (term.elements,) if isinstance(term.elements, str) else tuple(term.elements)
    members = [member for text in texts for member in named_members(structure, term.property, text)]
    values = np.unique(np.concatenate([item.values.start + rows for item, rows in members]))
    part = unknown.design.tocsr()[values].tocoo()
    if not part.nnz:
        raise InputError(f"{term_name(term)} has no parameter to hold; declare an [[unknown]] of that property")
    return part.coords[1], values[part.coords[0]]


def _neighbour_pairs(structure: Structure, columns: IntArray, values: IntArray) -> IntArray:
    """Pairs of parameter indices whose elements share a node, (n_pairs, 2), the lower first, each once.

    `columns` and `values`, (n_entries,) each, are indices of a parameter and of a property value that it enters.
    """
    tables = {element.name: element.nodes for element in structure.sets}
    owners, nodes = [], []
    for item in structure.properties:
        of_item = (values >= item.values.start) & (values < item.values.stop)
        if of_item.any():
            element_nodes = tables[item.element][values[of_item] - item.values.start]
            owners.append(np.repeat(columns[of_item], element_nodes.shape[1]))
            nodes.append(element_nodes.ravel())
    owner, node = np.concatenate(owners), np.concatenate(nodes)
    owner, node = owner[node >= 0], np.unique(node[node >= 0], return_inverse=True)[1]
    size, n_nodes = int(columns.max()) + 1, int(node.max(initial=-1)) + 1
    incidence = sparse.coo_array((np.ones(len(owner)), (owner, node)), (size, n_nodes)).tocsr()
    shared = sparse.csr_array(incidence @ incidence.T)
    shared.sort_indices()
    return np.column_stack(sparse.triu(shared, 1).tocoo().coords)
