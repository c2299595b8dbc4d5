"""The model that a solver's runs give: matrices that are polynomials in the deck's parameters, as one element set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import IntArray, locked
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.external.expansion import Powers
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    Kind,
    Nodes,
    Positions,
    Power,
    Term,
    Values,
    declared,
    dof_code,
    element,
)

#: The kind of property that a factor on a matrix is.
_KINDS: dict[str, Kind] = {"mass": "mass", "damping": "viscous_damping", "stiffness": "stiffness"}


@dataclass(frozen=True, eq=False)
class Part:
    """A matrix that goes with powers of parameters.

    Attributes
    ----------
    matrix_of : str
        ``mass``, ``damping`` or ``stiffness``.
    powers : tuple of (str, int)
        Of value over reference; () for the part that no parameter changes.
    matrix : (n_dofs, n_dofs) sparse array
    """

    matrix_of: str
    powers: Powers
    matrix: sparse.csc_array


@dataclass(frozen=True)
class ModelParameter:
    """A parameter of a model: name, unit, nominal value, and the reference of its powers."""

    name: str
    unit: str
    value: float
    reference: float


@element
class SolverModel(ElementSet):
    """A structure as a solver has it: parameters of its deck are the properties.

    What no parameter changes has factors `mass`, `damping` and `stiffness` of nominal value 1.
    """

    nodes: Nodes = declared("Nodes of the rows, in order, as one element", init=False)
    dofs: tuple[Dof, ...] = declared("What the rows of the matrices stand for")
    parts: tuple[Part, ...] = declared("Symmetric matrices in SI units, with the powers that they go with")
    parameters: tuple[ModelParameter, ...] = declared("Parameters of the deck")
    own_modes: int = declared(
        "Modes of the solver that it is made of, whose shapes other degrees of freedom follow, so that no mass can be told; 0 of"
        " whole matrices",
        default=0,
    )
    loss_factor: Values = declared("Structural damping of the stiffness", "loss_factor", "1", default=0.0)

    def __post_init__(self) -> None:
        """Derive the nodes from the degrees of freedom, and check the names of the parameters."""
        object.__setattr__(self, "nodes", locked(np.unique([d.node for d in self.dofs])[None, :], np.int64))
        super().__post_init__()
        reserved = {*_KINDS, "loss_factor"}
        for parameter in self.parameters:
            if parameter.name in reserved:
                raise InputError(
                    f"a parameter of {self.name!r} must not be called {parameter.name!r}; give it another name"
                )

    def terms(self, positions: Positions, present: IntArray) -> tuple[Term, ...]:
        """The model's properties (factors and parameters) with their matrices; see `ElementSet.terms`."""
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        sign = sparse.diags_array([float(d.sign) for d in self.dofs])
        references = {one.name: one.reference for one in self.parameters}
        kinds: dict[str, Kind] = dict.fromkeys(_KINDS, "parameter") if self.own_modes else _KINDS
        matrix_terms: dict[str, list[ElementMatrixTerm]] = {name: [] for name in (*_KINDS, *references)}
        for part in self.parts:
            owner, other_powers = _split_powers(part)
            scale = 1.0 / references[owner] if part.powers else 1.0
            whole = sparse.csc_array(sign @ part.matrix @ sign) * scale
            powers = tuple(Power(name, references[name], exponent) for name, exponent in other_powers)
            matrix_terms[owner].append(
                ElementMatrixTerm(
                    codes,
                    np.zeros((1, 0, 0)),
                    whole=whole,
                    powers=powers,
                    matrix_kind=part.matrix_of,
                    reduced=bool(self.own_modes),
                )
            )
        one = np.ones(1)
        terms = [Term(name, kind, "1", one, matrix_terms[name]) for name, kind in kinds.items() if matrix_terms[name]]
        terms.append(Term("loss_factor", "loss_factor", "1", self.loss_factor))
        parameter_terms = [
            Term(
                p.name,
                "parameter" if self.own_modes else _kind_of_parameter(p.name, self.parts),
                p.unit,
                locked([p.value], float),
                matrix_terms[p.name],
            )
            for p in self.parameters
        ]
        return (*parameter_terms, *terms)

    def matrix(self, matrix_of: str, values: Mapping[str, float]) -> sparse.csc_array:
        """The ``mass``, ``damping`` or ``stiffness`` matrix for parameter `values` by name, sparse (n_dofs, n_dofs), SI units."""
        references = {parameter.name: parameter.reference for parameter in self.parameters}
        total = sparse.csc_array((len(self.dofs), len(self.dofs)))
        for part in self.parts:
            if part.matrix_of == matrix_of:
                total = total + part.matrix * np.prod([(values[n] / references[n]) ** k for n, k in part.powers])
        return total


def _split_powers(part: Part) -> tuple[str, Powers]:
    """The property that multiplies a part of a matrix, and the remaining powers that multiply it."""
    if not part.powers:
        return part.matrix_of, ()
    (name, exponent), *others = part.powers
    remaining = ((name, exponent - 1),) if exponent > 1 else ()
    return name, (*remaining, *others)


def _kind_of_parameter(name: str, parts: Sequence[Part]) -> Kind:
    """``mass`` or ``stiffness`` for a parameter to which parts of one matrix alone are proportional, else ``parameter``."""
    of_parameter = [part for part in parts if any(name == other for other, _ in part.powers)]
    kinds = {part.matrix_of for part in of_parameter}
    if len(kinds) == 1 and all(part.powers == ((name, 1),) for part in of_parameter):
        return _KINDS[kinds.pop()]
    return "parameter"
