"""Element matrices of a structure with the values that weigh them, and the stiffness as B'B of strains of elements."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS
from structid.fem.blocks import Blocks, ElementMatrices
from structid.fem.elements.element import ElementMatrixTerm, PropertyMatrices, shear_ratio
from structid.fem.node_positions import LengthDependence

#: Matrices of the equations of motion; each dry friction has one of its own beside these, ``friction:NAME``.
MATRIX_KINDS = ("mass", "damping", "stiffness", "structural_damping")
#: The matrix to which elements of a property of some kind belong.
_MATRIX_OF = {
    "mass": "mass",
    "rotary_inertia": "mass",
    "viscous_damping": "damping",
    "stiffness": "stiffness",
    "axial_force": "stiffness",
}
#: Part of the largest eigenvalue of a scaled element matrix below which an eigenvalue is rounding.
_ROUNDING = 1e-11


@dataclass(frozen=True, eq=False)
class Property:
    """One property of one element set, and where its values stand among all values of the structure."""

    element: str
    term: PropertyMatrices
    values: slice

    @property
    def label(self) -> str:
        return f"{self.term.property}[{self.element}]"


#: Indices of values among the property values of the structure, one an element.
ValueIndex: TypeAlias = slice | IntArray


class Factor(Protocol):
    """Factor on the weights of element matrices that is not linear in the values."""

    @property
    def value_indices(self) -> tuple[ValueIndex, ...]:
        """Indices, among the values of the structure, of the values that the scale depends on; one an element."""
        ...

    def of(self, values: FloatArray) -> FloatArray:
        """The factors, (n_elements,)."""
        ...

    def slope(self, values: FloatArray, number: int) -> FloatArray:
        """Derivatives of the factors by the values at `value_indices[number]`, (n_elements,), at `values`."""
        ...

    def touched(self, changing: np.ndarray) -> np.ndarray:
        """True for each factor that changes with the values marked in `changing` (n_values,), (n_elements,)."""
        mask: np.ndarray = np.any([changing[index] for index in self.value_indices], axis=0)
        return mask

    def change(self, values: FloatArray, design: sparse.csr_array) -> sparse.csr_array:
        """Derivatives of the factors by parameters at the property `values`, sparse (n_elements, n_params).

        `design` (n_values, n_params) is the derivative of the values by the parameters.
        """
        slopes = ((index, self.slope(values, number)) for number, index in enumerate(self.value_indices))
        return sum_of(design[index].multiply(slope[:, None]) for index, slope in slopes)


@dataclass(frozen=True, eq=False)
class ShearFactor(Factor):
    """The shear ratio G / (G + ratio E) over its nominal value, to a power; the element matrices hold the nominal one.

    Attributes
    ----------
    bending, shear : slice
        Where E and G stand among the values of the structure.
    ratio : (n_elements,) float array
        1/m^2.
    nominal : (n_elements,) float array
        Shear ratio at the nominal values.
    power : int
    """

    bending: slice
    shear: slice
    ratio: FloatArray
    nominal: FloatArray
    power: int = 1

    @property
    def value_indices(self) -> tuple[slice, ...]:
        """Indices of bending stiffnesses and of shear stiffnesses among the values of the structure, one an element."""
        return (self.bending, self.shear)

    def of(self, values: FloatArray) -> FloatArray:
        """Shear ratios over their nominal values, to the power, (n_elements,), at property `values` (n_values,)."""
        relative: FloatArray = (
            shear_ratio(values[self.bending], values[self.shear], self.ratio) / self.nominal
        ) ** self.power
        return relative

    def slope(self, values: FloatArray, number: int) -> FloatArray:
        """Derivative of the factor of each element by its bending (`number` 0) or shear stiffness (1), (n_elements,).

        `values` (n_values,) are all property values of the structure.
        """
        bending, shear = values[self.bending], values[self.shear]
        total = shear + self.ratio * bending
        common = self.ratio / total**2 / self.nominal * self.power * (shear / total / self.nominal) ** (self.power - 1)
        return common * (-shear, bending)[number]


@dataclass(frozen=True, eq=False)
class Monomial(Factor):
    """A product of powers of values over their references, a number an element; element matrices hold the references.

    Attributes
    ----------
    at : tuple of slice
        Where the values stand among the values of the structure.
    references : tuple of (n_elements,) float array or float
        Nominal thicknesses, for one.
    exponents : tuple of int
        Of a thickness 1 for membrane stiffness and mass, 3 for bending.
    """

    at: tuple[slice, ...]
    references: tuple[FloatArray | float, ...]
    exponents: tuple[int, ...]

    @property
    def value_indices(self) -> tuple[slice, ...]:
        """Indices of each property's values among those of the structure, one an element."""
        return self.at

    def of(self, values: FloatArray) -> FloatArray:
        """Products of the powers, (n_elements,), at property `values` (n_values,) of the structure."""
        first, *others = self._powers(values)
        return math.prod(others, start=first)

    def slope(self, values: FloatArray, number: int) -> FloatArray:
        """Derivative of the product of powers of values, (n_elements,), by its factor `number` (from 0).

        The factor is the power of the values at `value_indices[number]`; all are taken at the property values `values`
        (n_values,) of the structure.
        """
        powers = self._powers(values)
        rows, reference, exponent = self._parts[number]
        slope = exponent * (values[rows] / reference) ** (exponent - 1) / reference
        return math.prod((*powers[:number], *powers[number + 1 :]), start=slope)

    @property
    def _parts(self) -> list[tuple[slice, FloatArray | float, int]]:
        return list(zip(self.at, self.references, self.exponents, strict=True))

    def _powers(self, values: FloatArray) -> list[FloatArray]:
        return [(values[index] / reference) ** exponent for index, reference, exponent in self._parts]


@dataclass(frozen=True, eq=False)
class LengthFactor(Factor):
    """(length / nominal length) to a power, a number an element; the element matrices hold the nominal one.

    Attributes
    ----------
    length_dependence : LengthDependence
    power : int
        Power of the length ratio, such as -3 for bending stiffness and 1 for mass.
    """

    length_dependence: LengthDependence
    power: int

    @property
    def value_indices(self) -> tuple[ValueIndex, ...]:
        """Indices of node positions, and of a common factor on lengths, that each element's length depends on."""
        return self.length_dependence.at

    def of(self, values: FloatArray) -> FloatArray:
        """Lengths over the nominal ones, to the power, (n_elements,), at property `values` (n_values,)."""
        powers: FloatArray = self.length_dependence.ratio(values) ** self.power
        return powers

    def slope(self, values: FloatArray, number: int) -> FloatArray:
        """Derivatives of the factors by the values at `value_indices[number]`, (n_elements,), at `values`."""
        steep = self.power * self.length_dependence.ratio(values) ** (self.power - 1) / self.length_dependence.lengths
        return steep * self.length_dependence.slopes[number]


@dataclass(frozen=True, eq=False)
class Contribution:
    """Element matrices on free degrees of freedom, with the values that weigh them.

    The weight of element e is ``values[value][e]``, times ``values[factor][e]`` for structural damping
    (stiffness times loss factor), times what `scale` gives where the element has a thickness, shears or has an end that
    slides, or where it is an entry of a modal damping.

    `matrix_kind` is the matrix that they belong to, with its coefficient in the dynamic stiffness: ``mass`` (-omega^2),
    ``damping`` (i omega), ``stiffness`` (1), ``structural_damping`` (i), ``friction:NAME`` (i over the sliding
    amplitude of the friction element NAME).
    """

    matrix_kind: str
    blocks: ElementMatrices
    value: ValueIndex
    factor: slice | None = None
    scale: Factor | None = None

    @property
    def first(self) -> int:
        """Index of the contribution's first value among the values of the structure."""
        return int(np.r_[self.value][0])

    @property
    def is_product(self) -> bool:
        """True if the weight is a product of several values."""
        return self.factor is not None or self.scale is not None

    @property
    def value_indices(self) -> tuple[ValueIndex, ...]:
        """Indices of the values that make up the weights."""
        factor: tuple[ValueIndex, ...] = () if self.factor is None else (self.factor,)
        return (self.value, *factor, *(() if self.scale is None else self.scale.value_indices))

    def weights(self, values: FloatArray) -> FloatArray:
        """Weight of each element matrix at the property values (n_values,) of the structure, (n_elements,).

        It is the element's own value, times the loss factor if there is one, times `scale` (length, shear, thickness)
        if there is one.
        """
        weights = values[self.value]
        if self.factor is not None:
            weights = weights * values[self.factor]
        return weights if self.scale is None else weights * self.scale.of(values)

    def touched(self, changing: np.ndarray) -> np.ndarray:
        """True for each element whose weight depends on a value marked in `changing` (n_values,), (n_elements,)."""
        value_indices = (self.value,) if self.factor is None else (self.value, self.factor)
        mask: np.ndarray = np.any([changing[index] for index in value_indices], axis=0)
        return mask if self.scale is None else mask | self.scale.touched(changing)

    def change(self, values: FloatArray, design: sparse.csr_array) -> sparse.csr_array:
        """Derivative of the weights of the element matrices by parameters, sparse (n_elements, n_params).

        It is taken at the property values `values` (n_values,) of the structure; `design` (n_values, n_params) is their
        derivative by the parameters.
        """
        if not self.is_product:
            return design[self.value]
        value, factor = values[self.value], 1.0 if self.factor is None else values[self.factor]
        parts = [design[self.value].multiply(self.slope(values, 0)[:, None])]
        if self.factor is not None:
            parts.append(design[self.factor].multiply(self.slope(values, 1)[:, None]))
        if self.scale is not None:
            parts.append(self.scale.change(values, design).multiply((value * factor)[:, None]))
        return sum_of(parts)

    def slope(self, values: FloatArray, number: int) -> FloatArray:
        """Derivative of the weights of the element matrices, (n_elements,), by the values at `value_indices[number]`.

        Number 0 is the elements' own value, 1 the loss factor if there is one, and those behind belong to length, shear
        or thickness. It is taken at the property values `values` (n_values,) of the structure.
        """
        factor = 1.0 if self.factor is None else values[self.factor]
        value, before = values[self.value], 1 if self.factor is None else 2
        if self.scale is not None and number >= before:
            return value * factor * self.scale.slope(values, number - before)
        scale = 1.0 if self.scale is None else self.scale.of(values)
        return np.full(value.shape, factor * scale) if number == 0 else value * scale


def sum_of(matrices: Iterable[sparse.sparray]) -> sparse.csr_array:
    """Sum of sparse matrices of one shape."""
    first, *others = matrices
    return sparse.csr_array(sum(others, first))


class WeighedEntries(NamedTuple):
    """Entries of the element matrices of several contributions, with the weight that multiplies each; (n_entries,).

    Columns are raised by n_dofs times the index of the matrix that an entry belongs to. Weights are numbered through
    all contributions.
    """

    row: IntArray
    column: IntArray
    weight: IntArray
    value: FloatArray


def weighed_entries(contributions: Sequence[Contribution], kinds: Sequence[str], n_dofs: int) -> WeighedEntries:
    """Entries (row, column, element, value) of all element matrices of `contributions`, one contribution after another.

    Matrices stand side by side: the k-th of `kinds` has the columns from k `n_dofs` on. Elements are counted from 0
    through all contributions. Raises `ValueError` if a contribution's matrix is none of `kinds`.
    """
    entries_of = {id(part.blocks): part.blocks.entries() for part in contributions}
    none: IntArray = np.zeros(0, dtype=np.int64)
    pieces, first = [WeighedEntries(none, none, none, np.zeros(0))], 0
    for part in contributions:
        row, column, element, value = entries_of[id(part.blocks)]
        pieces.append(WeighedEntries(row, kinds.index(part.matrix_kind) * n_dofs + column, first + element, value))
        first += part.blocks.n_elements
    return WeighedEntries(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))


@dataclass(frozen=True, eq=False)
class DenseSum:
    """Dense matrices as sums of weighed element matrices, for any property values; made by `dense_sum`.

    Attributes
    ----------
    shape : (n_matrices, n_dofs, n_dofs)
    place, weight : (n_entries,) int arrays
        Where in the flattened matrices each entry of an element matrix belongs, and the index of its weight.
    value : (n_entries,) float array
    factors : (2, n_weights) int array
        Indices of the two values whose product is a weight; that after the last value stands for a factor of 1.
    scaled : tuple of (slice, Factor)
        Weights that have a further factor, and what gives it.
    """

    shape: tuple[int, int, int]
    place: IntArray
    weight: IntArray
    value: FloatArray
    factors: IntArray
    scaled: tuple[tuple[slice, Factor], ...]

    def at(self, values: FloatArray) -> FloatArray:
        """The matrices, (n_matrices, n_dofs, n_dofs), at the property `values` (n_values,)."""
        first, second = np.append(values, 1.0)[self.factors]
        weights = first * second
        for part, factor in self.scaled:
            weights[part] *= factor.of(values)
        sums = np.bincount(self.place, self.value * weights[self.weight], math.prod(self.shape))
        return np.asarray(sums, np.float64).reshape(self.shape)


def dense_sum(contributions: Sequence[Contribution], kinds: Sequence[str], n_dofs: int, n_values: int) -> DenseSum:
    """Dense matrices of the `kinds`, in their order, as a sum that `DenseSum.at` evaluates for any property values.

    The matrices are (n_dofs, n_dofs) each, zero where no contribution is of that kind; contributions of other kinds are
    left out. `n_values` is the number of property values of the structure.
    """
    parts = [part for part in contributions if part.matrix_kind in kinds]
    row, column, weight, value = weighed_entries(parts, kinds, n_dofs)
    matrix, column = np.divmod(column, n_dofs) if n_dofs else (column, column)
    numbers, scaled, first = np.arange(n_values), [], 0
    factors: list[IntArray] = [np.zeros((2, 0), dtype=np.int64)]
    for part in parts:
        own = numbers[part.value]
        other = np.full_like(own, n_values) if part.factor is None else numbers[part.factor]
        factors.append(np.stack([own, other]))
        if part.scale is not None:
            scaled.append((slice(first, first + len(own)), part.scale))
        first += len(own)
    place = (matrix * n_dofs + row) * n_dofs + column
    return DenseSum((len(kinds), n_dofs, n_dofs), place, weight, value, np.hstack(factors), tuple(scaled))


def weigh_properties(
    properties: Sequence[Property],
    blocks_of: Callable[[ElementMatrixTerm], ElementMatrices],
    length_dependences: Mapping[str, LengthDependence],
) -> tuple[Contribution, ...]:
    """The contributions of all properties: element matrices with the values that weigh them, one for each matrix term.

    Those of structural damping, one for each stiffness that a loss factor multiplies, come last.

    Parameters
    ----------
    properties : sequence of Property
    blocks_of : callable
        Returns the element matrices of a matrix term, such as those on free degrees of freedom.
    length_dependences : mapping of str to LengthDependence
        By name of the element set, for those whose lengths depend on properties.
    """
    contributions: list[Contribution] = []
    stiffness: dict[str, list[Contribution]] = {}
    blocks: dict[int, ElementMatrices] = {}  # properties with the same matrices share them
    for item in properties:
        for matrix_term in item.term.matrix_terms:
            matrix_kind = matrix_term.matrix_kind or (
                f"friction:{item.element}" if item.term.kind == "friction" else _MATRIX_OF[item.term.kind]
            )
            if id(matrix_term) not in blocks:
                blocks[id(matrix_term)] = blocks_of(matrix_term)
            scale = _factor_of(properties, item.element, matrix_term, length_dependences)
            contributions.append(Contribution(matrix_kind, blocks[id(matrix_term)], item.values, scale=scale))
            if matrix_kind == "stiffness" and item.term.kind != "axial_force":  # a force has no loss
                stiffness.setdefault(item.element, []).append(contributions[-1])
    lost = [
        replace(part, matrix_kind="structural_damping", factor=item.values)
        for item in properties
        if item.term.kind == "loss_factor"
        for part in stiffness.get(item.element, [])
    ]
    return (*contributions, *lost)


def rigid_mass(
    properties: Sequence[Property],
    values: FloatArray,
    directions: Sequence[str],
    length_dependences: Mapping[str, LengthDependence],
) -> tuple[float, FloatArray]:
    """Mass in kg in rigid motion along the first of `directions` that has any, and its derivative by every value.

    The derivative is (n_values,). Both are 0 if none has. Reduced models, whose rigid motion does not show their mass,
    are left out. `properties` are those of the structure, `values` (n_values,) all their values, and
    `length_dependences` those of element lengths, by set.
    """
    total, gradient = 0.0, np.zeros(len(values))
    pairs = [(item, matrix_term) for item in properties for matrix_term in item.term.matrix_terms]
    masses = [
        (i, matrix_term)
        for i, matrix_term in pairs
        if (i.term.kind == "mass" or matrix_term.matrix_kind == "mass") and not matrix_term.reduced
    ]
    for direction in directions:
        for item, matrix_term in masses:
            unit = _rigid_motion_mass(matrix_term, DIRECTIONS.index(direction))
            scale = _factor_of(properties, item.element, matrix_term, length_dependences)
            factor = 1.0 if scale is None else scale.of(values)
            gradient[item.values] += unit * factor
            total += float(unit * factor @ values[item.values])
            if scale is not None:
                for number, rows_of in enumerate(scale.value_indices):
                    rows = np.arange(len(values))[rows_of]
                    np.add.at(gradient, rows, unit * values[item.values] * scale.slope(values, number))
        if gradient.any():
            break
    return total, gradient


def _factor_of(
    properties: Sequence[Property],
    element: str,
    matrix_term: ElementMatrixTerm,
    length_dependences: Mapping[str, LengthDependence],
) -> Factor | None:
    """Factor on the weights of element matrices by lengths, shear, powers of values or thickness; None stands for 1.

    Only the first of these that applies counts. `properties` are all of the structure, `matrix_term` has matrices of
    the set called `element`, and `length_dependences` are by name of the set.
    """
    if matrix_term.length_power:
        return LengthFactor(length_dependences[element], matrix_term.length_power)
    if matrix_term.shear is not None:
        of_element = {p.term.property: p for p in properties if p.element == element}
        bending, shear = of_element[matrix_term.shear.bending], of_element[matrix_term.shear.shear]
        ratio = shear_ratio(bending.term.values, shear.term.values, matrix_term.shear.ratio)
        return ShearFactor(bending.values, shear.values, matrix_term.shear.ratio, ratio, matrix_term.shear.power)
    if matrix_term.powers:
        of_element = {p.term.property: p for p in properties if p.element == element}
        parts = [(of_element[power.property].values, power.reference, power.exponent) for power in matrix_term.powers]
        return Monomial(*zip(*parts, strict=True))
    if matrix_term.power == 0:
        return None
    thickness = next(p for p in properties if p.element == element and p.term.kind == "thickness")
    return Monomial((thickness.values,), (thickness.term.values,), (matrix_term.power,))


def _rigid_motion_mass(matrix_term: ElementMatrixTerm, axis: int) -> FloatArray:
    """Mass of each element, (n_elements,), that moves in a unit translation of all its nodes along `axis`.

    It is r' B r with the element matrix B of `matrix_term`; `axis` is 0, 1, 2 for X, Y, Z.
    """
    motion = ((matrix_term.codes >= 0) & (matrix_term.codes % 6 == axis)).astype(np.float64)
    if matrix_term.whole is not None:
        return np.array([motion[0] @ (matrix_term.whole @ motion[0])])
    return np.einsum("ei,eij,ej->e", motion, matrix_term.local, motion)


def strain_operator(contributions: Sequence[Contribution], values: FloatArray, n_dofs: int) -> sparse.csr_array | None:
    """Strain matrix B with K = B'B, the stiffness, sparse (n_strains, n_dofs), without rows that are zero.

    None if an element matrix has a negative eigenvalue beyond rounding, or is a whole matrix of a group.

    An element matrix is a sum of squares of a few strains. The matrix that is assembled from them has rounding errors
    of eps |K|, in parts of a low eigenvalue eps times the condition number of K; B has eps |B|, the square root of
    that. The motions that strain nothing are exact in B.

    Parameters
    ----------
    contributions : sequence of Contribution
        Those of the stiffness are used.
    values : (n_values,) float array
        Property values of the structure.
    n_dofs : int
        Number of free degrees of freedom.

    References
    ----------
    Argyris and Bronlund (1975), The natural factor formulation of the stiffness for the matrix displacement
    method, Comput. Methods Appl. Mech. Eng. 5, 97-119 (the same for static solutions).
    """
    summed: dict[tuple[tuple[int, ...], bytes], tuple[IntArray, FloatArray]] = {}
    for part in contributions:
        if part.matrix_kind != "stiffness":
            continue
        if not isinstance(part.blocks, Blocks):
            return None
        dofs = part.blocks.dofs
        local: FloatArray = part.blocks.local * part.weights(values)[:, None, None]
        key = (dofs.shape, dofs.tobytes())
        summed[key] = (dofs, local + summed[key][1] if key in summed else local)
    row, column, entry, n_strains = [], [], [], 0
    for dofs, local in summed.values():
        strains = _strains(np.where((dofs >= 0)[:, :, None] & (dofs >= 0)[:, None, :], local, 0.0))
        if strains is None:
            return None
        kept = np.broadcast_to((dofs >= 0)[:, None, :], strains.shape) & (strains != 0)
        number = n_strains + np.arange(strains.shape[0] * strains.shape[1]).reshape(*strains.shape[:2], 1)
        row.append(np.broadcast_to(number, strains.shape)[kept])
        column.append(np.broadcast_to(dofs[:, None, :], strains.shape)[kept])
        entry.append(strains[kept])
        n_strains += number.size
    if not n_strains:
        return sparse.csr_array((0, n_dofs))
    indices = np.concatenate(row), np.concatenate(column)
    operator = sparse.csr_array(sparse.coo_array((np.concatenate(entry), indices), (n_strains, n_dofs)))
    return operator[np.diff(operator.indptr) > 0]


def _strains(local: FloatArray) -> FloatArray | None:
    """B of each of the symmetric matrices `local` = B'B, both (n_elements, n_local, n_local).

    None if a matrix has a negative eigenvalue beyond rounding. Degrees of freedom of an element are scaled to a
    diagonal of 1 before, as rotations of a short beam are far softer than its displacements.
    """
    diagonal = np.diagonal(local, axis1=1, axis2=2)
    if (diagonal < 0).any():
        return None
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    squares, turn = np.linalg.eigh(local / size[:, :, None] / size[:, None, :])
    if (squares < -_ROUNDING * np.maximum(squares[:, -1:], 1.0)).any():
        return None
    roots = np.sqrt(np.where(squares > _ROUNDING * squares[:, -1:], squares, 0.0))
    return np.asarray(roots[:, :, None] * np.swapaxes(turn, 1, 2) * size[:, None, :])
