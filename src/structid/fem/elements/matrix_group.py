"""Whole matrices as elements: groups of a model from another finite element code, and the model of a solver.

A solver gives matrices as polynomials in parameters, or FRFs alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar, TypeAlias, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    Given,
    Kind,
    Matrices,
    NodeCoordinates,
    Nodes,
    Power,
    PropertyMatrices,
    Values,
    declared,
    dof_code,
    element,
)

#: Sparse or dense.
AnyMatrix: TypeAlias = sparse.sparray | sparse.spmatrix | ArrayLike
Rows: TypeAlias = Annotated[Given[Iterable[str | Dof], tuple[Dof, ...]], "sequence of degrees of freedom"]
Matrix: TypeAlias = Annotated[
    Given[AnyMatrix, sparse.csc_array | None], "(n_dofs, n_dofs) sparse or dense array, optional"
]
#: Powers of parameters, each over its reference; () is the constant.
Powers = tuple[tuple[str, int], ...]
#: The kind of property that a factor on a matrix is.
_KINDS: dict[str, Kind] = {"mass": "mass", "damping": "viscous_damping", "stiffness": "stiffness"}


def _sparse(name: str, matrix: AnyMatrix) -> sparse.csc_array:
    return sparse.csc_array(matrix, dtype=np.float64)


class GroupMatrices(TypedDict, total=False):
    """Arguments of `MatrixGroup` beside its name and degrees of freedom."""

    mass: AnyMatrix
    stiffness: AnyMatrix
    damping: AnyMatrix
    loss_factor: ArrayLike


@element
class MatrixGroup(ElementSet):
    """Sparse matrices of one part of a structure; each is multiplied by a factor of nominal value 1."""

    nodes: Nodes = declared("Nodes of the rows, in order, as one element", init=False)
    dofs: Rows = declared("What the rows of the matrices stand for")
    mass: Matrix = declared("Symmetric, SI units", stored=_sparse, default=None)
    stiffness: Matrix = declared("Likewise", stored=_sparse, default=None)
    damping: Matrix = declared("Likewise", stored=_sparse, default=None)
    loss_factor: Values = declared("Structural damping of `stiffness`", "loss_factor", "1", default=0.0)

    def __post_init__(self) -> None:
        """Derive the nodes from the rows, and check that the matrices are finite, symmetric and of their size.

        Raises `InputError` otherwise, and if no matrix is stated.
        """
        dofs = parse_dofs(self.dofs)
        object.__setattr__(self, "dofs", dofs)
        object.__setattr__(self, "nodes", locked(np.unique([d.node for d in dofs])[None, :], np.int64))
        super().__post_init__()
        if not self.given:
            raise InputError(f"group {self.name!r} has no matrix; give `mass`, `stiffness` or `damping`")
        for key, matrix in self.given.items():
            _require_symmetric(self.name, key, matrix, len(dofs))

    @property
    def given(self) -> dict[str, sparse.csc_array]:
        """Matrices that are stated, by kind."""
        every = {"mass": self.mass, "stiffness": self.stiffness, "damping": self.damping}
        return {key: matrix for key, matrix in every.items() if matrix is not None}

    @property
    def property_names(self) -> tuple[str, ...]:
        return *self.given, "loss_factor"

    def property_matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> tuple[PropertyMatrices, ...]:
        """The group's factors as properties, nominally 1, with the matrices that they multiply; then its loss factor.

        Factors are of mass, stiffness and damping, as far as it has these matrices. A group without stiffness has no
        loss factor. The arguments have no influence.
        """
        matrix_terms_of, unit = self.matrices(positions, used_codes), np.ones(1)
        terms = [
            PropertyMatrices(key, _KINDS[key], "1", unit, matrix_terms) for key, matrix_terms in matrix_terms_of.items()
        ]
        loss = (
            [PropertyMatrices("loss_factor", "loss_factor", "1", self.loss_factor)]
            if "stiffness" in matrix_terms_of
            else []
        )
        return (*terms, *loss)

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """The group's matrices by "mass", "stiffness" and "damping", each as one element.

        Signs of the rows are taken out. The arguments have no influence.
        """
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        sign = sparse.diags_array([float(d.sign) for d in self.dofs])
        signed = {key: sparse.csc_array(sign @ matrix @ sign) for key, matrix in self.given.items()}
        return {key: (ElementMatrixTerm(codes, np.zeros((1, 0, 0)), whole=matrix),) for key, matrix in signed.items()}


def _require_symmetric(group: str, name: str, matrix: sparse.csc_array, size: int) -> None:
    """Raise `InputError` unless the matrix is (size, size), finite and symmetric to 1e-8 of its largest entry.

    `group` and `name` are named in the message.
    """
    if matrix.shape != (size, size):
        raise InputError(f"`{name}` of group {group!r} must be ({size}, {size}) like its dofs, got {matrix.shape}")
    if not np.isfinite(matrix.data).all():
        raise InputError(f"`{name}` of group {group!r} must be finite; it holds NaN or infinite entries")
    asymmetry = abs(matrix - matrix.T).max() if matrix.nnz else 0.0
    if asymmetry > 1e-8 * max(abs(matrix).max(), np.finfo(float).tiny):
        raise InputError(
            f"`{name}` of group {group!r} must be symmetric, got entries that differ by {asymmetry:.3g};"
            " if only one triangle is stored, add the other"
        )


@dataclass(frozen=True, eq=False)
class Part:
    """A matrix that goes with powers of parameters.

    Attributes
    ----------
    matrix_of : str
        ``mass``, ``damping`` or ``stiffness``.
    powers : tuple of (str, int)
        Parameters with the exponents of value over reference; () for the part that no parameter changes.
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
    """Structure whose matrices an external solver gives; the parameters of its deck are the properties.

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
    has_mass: bool = declared(
        "Whether its modes came with their modal masses, without which each has a scale of its own and no response a size",
        default=True,
    )
    loss_factor: Values = declared("Structural damping of the stiffness", "loss_factor", "1", default=0.0)

    def __post_init__(self) -> None:
        """Derive the nodes from the degrees of freedom; raise `InputError` if a parameter has the name of a factor.

        Those names are "mass", "damping", "stiffness" and "loss_factor".
        """
        object.__setattr__(self, "nodes", locked(np.unique([d.node for d in self.dofs])[None, :], np.int64))
        super().__post_init__()
        reserved = {*_KINDS, "loss_factor"}
        for parameter in self.parameters:
            if parameter.name in reserved:
                raise InputError(
                    f"a parameter of {self.name!r} must not be called {parameter.name!r}; give it another name"
                )

    @property
    def property_names(self) -> tuple[str, ...]:
        return *_KINDS, *(parameter.name for parameter in self.parameters), "loss_factor"

    def property_matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> tuple[PropertyMatrices, ...]:
        """The model's parameters, factors and loss factor, in this order, as properties with matrices to multiply.

        A part of a matrix that depends on parameters is multiplied by the first of them, relative to its reference; the
        other powers are factors on its weight. Factors that multiply nothing are left out; in a model with `own_modes`
        all but the loss factor are of kind "parameter". The arguments have no influence.
        """
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        sign = sparse.diags_array([float(d.sign) for d in self.dofs])
        references = {parameter.name: parameter.reference for parameter in self.parameters}
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
        unit_factor = np.ones(1)
        terms = [
            PropertyMatrices(name, kind, "1", unit_factor, matrix_terms[name])
            for name, kind in kinds.items()
            if matrix_terms[name]
        ]
        terms.append(PropertyMatrices("loss_factor", "loss_factor", "1", self.loss_factor))
        parameter_terms = [
            PropertyMatrices(
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
        """The ``mass``, ``damping`` or ``stiffness`` matrix, sparse (n_dofs, n_dofs), SI units; zero without parts.

        `values` are the values of all parameters by name, each in its unit.
        """
        references = {parameter.name: parameter.reference for parameter in self.parameters}
        total = sparse.csc_array((len(self.dofs), len(self.dofs)))
        for part in self.parts:
            if part.matrix_of == matrix_of:
                total = total + part.matrix * np.prod([(values[n] / references[n]) ** k for n, k in part.powers])
        return total


@dataclass(frozen=True, eq=False)
class FrfRuns:
    """Receptances of a solver at a centre, and at two changes of each parameter.

    Beside the centre each value goes straight with the parameters, by the slope at the centre of the parabola through
    its three runs.

    Attributes
    ----------
    frequency : (n_lines,) float array
        Hz.
    outputs, inputs : tuple of Dof
    centre : (n_lines, n_outputs, n_inputs) complex array
        SI units.
    at : mapping of str to float
        Value of each parameter there.
    changes : (n_params, 2) float array
        Two changes of each parameter from the centre, in its unit.
    runs : (n_params, 2, n_lines, n_outputs, n_inputs) complex array
    """

    frequency: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    centre: ComplexArray
    at: Mapping[str, float]
    changes: FloatArray
    runs: ComplexArray

    def mapped(self, frequency: FloatArray, convert: Callable[[ComplexArray], ComplexArray]) -> FrfRuns:
        """A copy with new lines `frequency` (Hz) and the receptances of every run put through `convert`.

        `convert` takes (n_lines, n_outputs, n_inputs), once for the centre and once for each run.
        """
        centre = convert(self.centre)
        transformed = np.zeros((*self.runs.shape[:2], *centre.shape), dtype=np.complex128)
        for index in np.ndindex(*self.runs.shape[:2]):
            transformed[index] = convert(self.runs[index])
        return replace(self, frequency=frequency, centre=centre, runs=transformed)

    def lines(self, frequency: FloatArray) -> IntArray:
        """Indices (n,) of the lines `frequency` (n,), Hz, among those of the runs; they must match exactly.

        Raises
        ------
        InputError
            If a line is not there.
        """
        index = np.clip(np.searchsorted(self.frequency, frequency), 0, len(self.frequency) - 1)
        missing = frequency[self.frequency[index] != frequency]
        if len(missing):
            raise InputError(
                f"the solver was not asked for the line at {missing[0]:g} Hz; take lines of the records, inside `band`"
            )
        return index

    @cached_property
    def _derivatives(self) -> ComplexArray:
        """Derivatives of the receptances by the parameters at the centre, (n_lines, n_outputs, n_inputs, n_params).

        Each is the slope of the parabola through the centre and the two runs with a changed value of the parameter.
        """
        derivatives = np.zeros((*self.centre.shape, len(self.changes)), dtype=np.complex128)
        for k, ((a, b), (run_a, run_b)) in enumerate(zip(self.changes, self.runs, strict=True)):
            up, down = (run_a - self.centre) / a, (run_b - self.centre) / b
            derivatives[..., k] = up - a * (down - up) / (b - a)
        return derivatives

    def evaluated(self, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Receptances (n_lines, n_outputs, n_inputs), and their derivatives by the parameters, (..., n_params).

        `values` (n_params,) are those of all parameters, in the order of `at`. SI units per unit of each parameter.
        """
        return self.centre + self._derivatives @ (values - np.array(list(self.at.values()))), self._derivatives


@element
class SolverFrfs(ElementSet):
    """A structure of which a solver gives FRFs alone: deck parameters are its properties, and it has no matrices."""

    has_matrices: ClassVar[bool] = False

    nodes: Nodes = declared("Nodes of sensors and loads, in order, as one element", init=False)
    table: FrfRuns = declared("FRFs of the runs of the solver")
    parameters: tuple[ModelParameter, ...] = declared("Parameters of the deck")

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", locked(np.unique([dof.node for dof in self.dofs])[None, :], np.int64))
        super().__post_init__()

    @property
    def dofs(self) -> tuple[Dof, ...]:
        """Degrees of freedom of sensors and loads, each once, in their order."""
        return tuple(dict.fromkeys(dof.unsigned for dof in (*self.table.outputs, *self.table.inputs)))

    @property
    def property_names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    def property_matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> tuple[PropertyMatrices, ...]:
        """The parameters as properties with nominal values and zero matrices, since the model has FRFs alone.

        The arguments have no influence.
        """
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        nothing = sparse.csc_array((codes.size, codes.size))
        matrix_term = ElementMatrixTerm(
            codes, np.zeros((1, 0, 0)), whole=nothing, matrix_kind="stiffness", reduced=True
        )
        return tuple(
            PropertyMatrices(p.name, "parameter", p.unit, locked([p.value], float), [matrix_term])
            for p in self.parameters
        )

    def channel_indices(self, dofs: tuple[Dof, ...], role: str) -> tuple[IntArray, FloatArray]:
        """Indices of sensors or loads among the solver's channels, and signs +1 or -1 relative to these; (n,) each.

        `dofs` are the n sensors or loads; `role` is ``output`` for sensors and ``input`` for loads.

        Raises
        ------
        InputError
            If the solver has no such channel.
        """
        channels = self.table.outputs if role == "output" else self.table.inputs
        index_and_sign = {dof.unsigned: (k, dof.sign) for k, dof in enumerate(channels)}
        for dof in dofs:
            if dof.unsigned not in index_and_sign:
                raise InputError(f"the solver gives no FRF with {role} {dof}, only {', '.join(map(str, channels))}")
        pairs = [index_and_sign[dof.unsigned] for dof in dofs]
        return np.array([k for k, _ in pairs]), np.array(
            [sign * dof.sign for (_, sign), dof in zip(pairs, dofs, strict=True)], dtype=float
        )


def _split_powers(part: Part) -> tuple[str, Powers]:
    """The property that multiplies a part of a matrix, and the remaining (name, exponent) powers in its weight.

    It is the first parameter of `part.powers`, whose exponent is lowered by 1; without powers, the kind of the matrix.
    """
    if not part.powers:
        return part.matrix_of, ()
    (name, exponent), *others = part.powers
    remaining = ((name, exponent - 1),) if exponent > 1 else ()
    return name, (*remaining, *others)


def _kind_of_parameter(name: str, parts: Sequence[Part]) -> Kind:
    """Kind of the property of the parameter `name`: that of the one matrix proportional to it, else ``parameter``.

    The kind is ``mass``, ``viscous_damping`` or ``stiffness`` if all parts with the parameter belong to one matrix and
    have the parameter to the first power, alone.
    """
    of_parameter = [part for part in parts if any(name == other for other, _ in part.powers)]
    kinds = {part.matrix_of for part in of_parameter}
    if len(kinds) == 1 and all(part.powers == ((name, 1),) for part in of_parameter):
        return _KINDS[kinds.pop()]
    return "parameter"
