"""Element matrices that parameters weigh, and the sensitivity of fields to parameters: the forces (dZ/dp) x.

For every parameter the derivative of Z is a sum of element matrices, so (dZ/dp) x is a force on the degrees of freedom
of its elements alone. The forces of all parameters are kept as one sparse matrix whose pattern is found once; line by
line only its entries change. A parameter with one element and one with a thousand cost the same an entry.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray, with_entries
from structid.core.errors import InputError
from structid.core.last_results import LastResults
from structid.fem import Contribution, Structure
from structid.fem.blocks import Blocks, ElementMatrices, index_kind
from structid.fem.contribution import weighed_entries
from structid.unknowns import Parameters

#: Most entries of forces that are held at once; and of small models, where they are to stay near the processor.
_CHUNK_ENTRIES, _NEAR_ENTRIES = 4_000_000, 65_536


@dataclass(frozen=True, eq=False)
class WeightedElements:
    """Element matrices and how the parameters weigh them.

    Attributes
    ----------
    blocks : ElementMatrices
    slope : (n_elements, n_params) sparse array
        Derivative of the weights with respect to the parameters.
    kind : int
        Parts of one kind enter the dynamic stiffness alike.
    """

    blocks: ElementMatrices
    slope: sparse.csr_array
    kind: int


@dataclass(frozen=True, eq=False)
class ParameterForces:
    """The forces (dZ/dp) x of all parameters, as a map from fields; made by `parameter_forces`.

    Attributes
    ----------
    indices, indptr : int arrays
        Degrees of freedom that each parameter's forces act on, parameter after parameter.
    maps : tuple of (n_forces, n_dofs) sparse arrays
        From a field to the forces, one for each kind of `WeightedElements`.
    n_dofs : int
    """

    indices: IntArray
    indptr: IntArray
    maps: tuple[sparse.csr_array, ...]
    n_dofs: int

    @property
    def n_params(self) -> int:
        return len(self.indptr) - 1

    def entries(self, factors: ComplexArray, x: NumberArray) -> NumberArray:
        """Nonzero entries of the forces (dZ/dp) x for fields `x` (n_dofs, n_x) at one frequency line, (n_forces, n_x).

        Z is the dynamic stiffness; `factors` (n_maps,) are the coefficients of `maps` in it at that line. Rows are the
        forces of one parameter after another, at the degrees of freedom `indices`.
        """
        is_complex = np.iscomplexobj(x)
        flat = np.ascontiguousarray(x)
        flat = flat.view(np.float64) if is_complex else flat
        total: NumberArray = np.zeros((len(self.indices), x.shape[1]), dtype=x.dtype)
        for factor, matrix in zip(factors, self.maps, strict=True):
            if factor == 0:
                continue
            forces = matrix @ flat
            forces_of_map = forces.view(np.complex128) if is_complex else forces
            total = total + (factor if factor.imag else factor.real) * forces_of_map
        return total

    def columns(self, entries: NumberArray) -> NumberArray:
        """Dense forces (n_dofs, n_x n_params) from their `entries` (n_forces, n_x); columns have parameters fastest."""
        shape = (self.n_params, self.n_dofs)
        wide = [sparse.csr_array((column, self.indices, self.indptr), shape).toarray().T for column in entries.T]
        return np.concatenate(wide, axis=1)

    def products(self, factors: ComplexArray, x: NumberArray, y: NumberArray) -> list[NumberArray]:
        """Products y' (dZ/dp) x without conjugate, as a list with an array (n_params, n_y) for each column of `x`.

        Fields are `x` (n_dofs, n_x) and `y` (n_dofs, n_y); `factors` (n_maps,) are the coefficients of the matrices at
        one frequency line.
        """
        entries = np.ascontiguousarray(self.entries(factors, x).T)
        rows = np.ascontiguousarray(y)
        return [with_entries(self._pattern, column) @ rows for column in entries]

    @cached_property
    def _pattern(self) -> sparse.csr_array:
        """A matrix (n_params, n_dofs) of the pattern of all forces, whose indices are checked once for all lines."""
        return sparse.csr_array((np.zeros(len(self.indices)), self.indices, self.indptr), (self.n_params, self.n_dofs))

    def projected(self, factors: ComplexArray, vectors: FloatArray, x: NumberArray, y: NumberArray) -> ComplexArray:
        """Products y' V' (dZ/dp) V x without conjugate for a reduced basis V, (n_lines, n_y, n_x, n_params).

        Parameters
        ----------
        factors : (n_lines, n_maps) complex array
            Coefficient of each map in the dynamic stiffness Z.
        vectors : (n_dofs, n_vectors) float array
            The basis V.
        x, y : (n_lines, n_vectors, n_x) and (n_lines, n_vectors, n_y) complex arrays
            Coordinates of the fields in the basis.
        """
        products = np.zeros((len(x), y.shape[2], x.shape[2], self.n_params), dtype=np.complex128)
        adjoint = np.swapaxes(y, 1, 2)
        for p, (first, last) in enumerate(pairwise(self.indptr)):
            basis_rows = vectors[self.indices[first:last]].T
            for factor, matrix in zip(factors.T, self.maps, strict=True):
                if factor.any():
                    small = basis_rows @ (matrix[first:last] @ vectors)
                    products[..., p] += factor[:, None, None] * (adjoint @ (small @ x))
        return products


def parameter_forces(parts: Sequence[WeightedElements], n_params: int, n_dofs: int) -> ParameterForces:
    """Operator from fields x to the forces (dZ/dp) x of all parameters, Z the dynamic stiffness.

    `parts` are element matrices whose weights depend on the `n_params` parameters; `n_dofs` is the size of a field.
    Rows are the forces that can be nonzero, parameter after parameter; there is a sparse map for each kind (0, 1, ...)
    of the parts.
    """
    keys = [key for part in parts for key in _force_keys(part, n_dofs)]
    pattern = np.unique(np.concatenate([np.zeros(0, np.int64), *keys]))
    shape = (len(pattern), n_dofs)
    maps = []
    for kind in range(1 + max((part.kind for part in parts), default=-1)):
        pieces = [piece for part in parts if part.kind == kind for piece in _force_maps(part, pattern, n_dofs)]
        if pieces:
            row, column, value = (np.concatenate([piece[i] for piece in pieces]) for i in range(3))
            maps.append(sparse.coo_array((value, (row, column)), shape).tocsr())
        else:
            maps.append(sparse.csr_array(shape))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(pattern // n_dofs, minlength=n_params))])
    kind_of = index_kind(max(n_dofs, len(pattern)))
    return ParameterForces((pattern % n_dofs).astype(kind_of), indptr.astype(kind_of), tuple(maps), n_dofs)


def _weight_derivatives(part: WeightedElements) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
    """Yield element index, parameter index and derivative, (n_pairs,) each, of weights that depend on parameters.

    They come in chunks of at most 4 million entries of element matrices, at least one pair.
    """
    element = np.repeat(np.arange(part.slope.shape[0]), np.diff(part.slope.indptr))
    local = part.blocks.dofs.shape[1] ** 2 if isinstance(part.blocks, Blocks) else 1
    step = max(1, _CHUNK_ENTRIES // max(1, local))
    for first in range(0, len(element), step):
        chosen = slice(first, first + step)
        yield element[chosen], part.slope.indices[chosen].astype(np.int64), part.slope.data[chosen]


def _force_keys(part: WeightedElements, n_dofs: int) -> Iterator[IntArray]:
    """Yield keys (n_keys,) of all forces (dZ/dp) x that can be nonzero: parameter index times n_dofs plus dof.

    Each array holds a key once, sorted; keys may repeat in later arrays. `part` has element matrices of the dynamic
    stiffness Z with the derivatives of their weights.
    """
    if not isinstance(part.blocks, Blocks):
        yield np.unique(_matrix_entries(part, n_dofs)[0])
        return
    acts = part.blocks.local.any(axis=2) & (part.blocks.dofs >= 0)
    for element, parameter, _ in _weight_derivatives(part):
        yield np.unique((parameter[:, None] * n_dofs + part.blocks.dofs[element])[acts[element]])


def _force_maps(
    part: WeightedElements, pattern: IntArray, n_dofs: int
) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
    """Yield sparse entries (row, column, value) of the map from fields to forces (dZ/dp) x, in chunks of limited size.

    Rows are indices in the sorted keys `pattern` (parameter index times n_dofs plus degree of freedom), columns are
    degrees of freedom. Entries may repeat and add up.
    """
    if not isinstance(part.blocks, Blocks):
        key, column, value = _matrix_entries(part, n_dofs)
        yield np.searchsorted(pattern, key), column, value
        return
    kind = index_kind(max(len(pattern), n_dofs))
    for element, parameter, slope in _weight_derivatives(part):
        key = parameter[:, None] * n_dofs + part.blocks.dofs[element]
        row = np.minimum(np.searchsorted(pattern, key.ravel()), len(pattern) - 1).astype(kind)
        _, column, kept = part.blocks.stored(element)
        ends = np.concatenate([[0], np.cumsum(kept.sum(axis=2))]).astype(kind)
        values = (part.blocks.local[element] * slope[:, None, None])[kept]
        each = sparse.csr_array((values, column, ends), (key.size, n_dofs))
        sums = sparse.csc_array((np.ones(key.size), row, np.arange(key.size + 1, dtype=kind)), (len(pattern), key.size))
        forces = (sums.tocsr() @ each).tocoo()
        yield forces.row, forces.col, forces.data


def _matrix_entries(part: WeightedElements, n_dofs: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Sparse entries of derivatives of a weighted sum of element matrices: key, column, value, (n_entries,) each.

    `part` has the element matrices and the derivatives of their weights by the parameters. The key is parameter index
    times n_dofs plus row. Entries may repeat and add up.
    """
    joined = _derivative_entries(part.blocks.entries(), part.slope, n_dofs)
    pieces = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)), *((k, c, v) for k, c, _, v in joined)]
    key, column, value = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    return key, column, value


@dataclass(frozen=True, eq=False)
class DenseForces:
    """The forces (dZ/dp) x of all parameters of a small model, for many lines at once; made by `DenseSlopes.at`.

    Attributes
    ----------
    dofs, parameters : (n_forces,) int arrays
        Degree of freedom and parameter of each force.
    maps : tuple of (int, int array, (n, n_dofs) float array)
        For each matrix with such forces: its index, which of the forces, and the map from a field to them.
    n_params : int
    """

    dofs: IntArray
    parameters: IntArray
    maps: tuple[tuple[int, IntArray, FloatArray], ...]
    n_params: int

    def products(self, coefficients: ComplexArray, x: NumberArray, y: NumberArray) -> ComplexArray:
        """Products y' (dZ/dp) x without conjugate at every line, (n_lines, n_y, n_x, n_params).

        Parameters
        ----------
        coefficients : (n_lines, n_matrices) complex array
            Factor of each matrix in Z, the dynamic stiffness.
        x, y : (n_lines, n_dofs, n_x) and (n_lines, n_dofs, n_y) complex arrays
        """
        n_lines, n_dofs, n_x = x.shape
        products = np.empty((n_lines, y.shape[2], n_x, self.n_params), dtype=np.complex128)
        step = max(1, _NEAR_ENTRIES // max(1, n_dofs * self.n_params))
        wide = np.zeros((min(step, n_lines), n_dofs * self.n_params), dtype=np.complex128)
        flat_index = self.dofs * self.n_params + self.parameters
        for first in range(0, n_lines, step):
            part = slice(first, min(first + step, n_lines))
            forces = self._forces(coefficients[part], x[part])
            adjoint, scattered = np.swapaxes(y[part], 1, 2), wide[: forces.shape[1]]
            for column in range(n_x):
                scattered[:, flat_index] = forces[:, :, column].T
                products[part, :, column] = adjoint @ scattered.reshape(-1, n_dofs, self.n_params)
        return products

    def _forces(self, coefficients: ComplexArray, x: NumberArray) -> ComplexArray:
        """Nonzero entries of the forces (dZ/dp) x for fields `x` (n_lines, n_dofs, n_x): (n_forces, n_lines, n_x).

        Z is the dynamic stiffness, with `coefficients` (n_lines, n_matrices) of its matrices. Force k acts on the
        degree of freedom `dofs[k]` and belongs to the parameter `parameters[k]`.
        """
        n_lines, n_dofs, n_x = x.shape
        flat = np.ascontiguousarray(np.moveaxis(x, 1, 0), np.complex128).reshape(n_dofs, -1).view(np.float64)
        total = np.zeros((len(self.dofs), n_lines, n_x), dtype=np.complex128)
        for matrix_kind, chosen, matrix in self.maps:
            forces = (matrix @ flat).view(np.complex128).reshape(-1, n_lines, n_x)
            forces *= coefficients[:, matrix_kind, None]
            total[chosen] += forces
        return total


@dataclass(frozen=True, eq=False)
class DenseSlopes:
    """Derivatives of the matrices of a small model with respect to each parameter; made by `dense_slopes`.

    All entries of the maps of `DenseForces` are linear in the slopes of the weights of element matrices, which are the
    only things that change with the values.

    Attributes
    ----------
    structure : Structure
    slots : tuple of (int, tuple of int)
        Contributions whose weights change with a parameter, and by which of their `places`.
    forces : DenseForces
        Its maps are not filled in.
    operators : tuple of (n n_dofs, n_slopes) sparse arrays
        For each of the maps: its entries from all slopes in the order of `slots`.
    """

    structure: Structure
    slots: tuple[tuple[int, tuple[int, ...]], ...]
    forces: DenseForces
    operators: tuple[sparse.csr_array, ...]

    def at(self, values: FloatArray) -> DenseForces:
        """Operator for the forces (dZ/dp) x of the structure with the property `values` (n_values,), physical units.

        The last one is kept: a record at a few lines may share it with the same structure at others.
        """
        return self._last.get_or_make(values.tobytes(), lambda: self._filled(values))

    @cached_property
    def _last(self) -> LastResults[bytes, DenseForces]:
        return LastResults(1)

    def _filled(self, values: FloatArray) -> DenseForces:
        """Operator of the forces (dZ/dp) x with its dense matrices computed at the property values (n_values,)."""
        slopes: list[FloatArray] = [np.zeros(0)]
        for member, used in self.slots:
            slopes += [self.structure.contributions[member].slope(values, k) for k in used]
        stacked, n_dofs = np.concatenate(slopes), self.structure.n_dofs
        maps = tuple(
            (matrix_kind, chosen, (operator @ stacked).reshape(-1, n_dofs))
            for (matrix_kind, chosen, _), operator in zip(self.forces.maps, self.operators, strict=True)
        )
        return replace(self.forces, maps=maps)


def dense_slopes(structure: Structure, matrix_kinds: Sequence[str], design: sparse.sparray) -> DenseSlopes:
    """Derivatives of dense system matrices by parameters, in a form that is evaluated fast for any values.

    The result gives the operator of the forces (dZ/dp) x for property values. `matrix_kinds` name the matrices in the
    order of their coefficients in Z; `design` (n_values, n_params) is the derivative of the property values by the
    parameters.
    """
    table, n_dofs, members = sparse.csr_array(design), structure.n_dofs, structure.contributions
    n_weights = sum(item.blocks.n_elements for item in members)
    changes, numbers = np.diff(table.indptr) > 0, np.arange(table.shape[0])
    slots: list[tuple[int, tuple[int, ...]]] = []
    # of each place of a contribution: the value and the slope of every weight, -1 where no parameter changes it
    values: list[IntArray] = []
    slopes: list[IntArray] = []
    n_slopes, first = 0, 0
    for member, item in enumerate(members):
        weights_of_item, used = slice(first, first + item.blocks.n_elements), []
        for k, index in enumerate(item.value_indices):
            if not changes[index].any():
                continue
            while len(values) <= k:
                values.append(np.full(n_weights, -1))
                slopes.append(np.full(n_weights, -1))
            values[k][weights_of_item], slopes[k][weights_of_item] = (
                numbers[index],
                n_slopes + np.arange(item.blocks.n_elements),
            )
            n_slopes += item.blocks.n_elements
            used.append(k)
        if used:
            slots.append((member, tuple(used)))
        first = weights_of_item.stop
    none: IntArray = np.zeros(0, dtype=np.int64)
    pieces: list[tuple[IntArray, IntArray, IntArray, FloatArray]] = [(none, none, none, np.zeros(0))]
    row, column, weight, value = weighed_entries(members, matrix_kinds, n_dofs)
    for of_value, of_slope in zip(values, slopes, strict=True):
        known = of_value[weight] >= 0
        entries = row[known], column[known], weight[known], value[known]
        own_rows = table[np.maximum(of_value, 0)]
        pieces += [
            (key, at, of_slope[which], product)
            for key, at, which, product in _derivative_entries(entries, own_rows, n_dofs)
        ]
    key, at, slope, change = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    pattern, maps, operators = np.unique(key), [], []
    for matrix_index in np.unique(at // n_dofs).tolist():
        of_matrix = at // n_dofs == matrix_index
        rows, place_of = np.unique(key[of_matrix], return_inverse=True)
        shape = (len(rows) * n_dofs, n_slopes)
        entry = place_of * n_dofs + at[of_matrix] % n_dofs
        operators.append(sparse.coo_array((change[of_matrix], (entry, slope[of_matrix])), shape).tocsr())
        maps.append((matrix_index, np.searchsorted(pattern, rows), np.zeros((0, n_dofs))))
    forces = DenseForces(pattern % n_dofs, pattern // n_dofs, tuple(maps), table.shape[1])
    return DenseSlopes(structure, tuple(slots), forces, tuple(operators))


def _derivative_entries(
    entries: tuple[IntArray, IntArray, IntArray, FloatArray], design: sparse.csr_array, n_dofs: int
) -> Iterator[tuple[IntArray, IntArray, IntArray, FloatArray]]:
    """Yield entries of the derivatives of matrices by parameters: key, column, index of the element weight, and value.

    The k-th tuple of arrays has the k-th parameter of every weight, as far as a weight has that many. The key is
    parameter index times n_dofs plus row. `entries` are row, column, weight index and value of the element matrices;
    `design` (n_weights, n_params) is the derivative of the weights. Every array is (n_entries,).
    """
    row, column, element, value = entries
    counts = np.diff(design.indptr)
    for k in range(int(counts.max(initial=0))):
        has_parameter = counts[element] > k
        at = design.indptr[element[has_parameter]] + k
        yield (
            design.indices[at].astype(np.int64) * n_dofs + row[has_parameter],
            column[has_parameter],
            element[has_parameter],
            design.data[at] * value[has_parameter],
        )


def element_products(blocks: ElementMatrices, y: NumberArray, x: NumberArray) -> FloatArray:
    """Real part of conj(y)' B_e x, summed over columns, for the matrix B_e of each element, (n_elements,).

    Fields `y` and `x` are (n_dofs, n_columns); columns are lines and loads, for example. Constrained degrees of freedom
    of an element count as 0.
    """
    left, right = (np.ascontiguousarray(a, dtype=np.complex128).view(np.float64) for a in (y, x))
    if not isinstance(blocks, Blocks):
        rows, columns, element, value = blocks.entries()
        order = np.argsort(element, kind="stable")
        totals = np.zeros(blocks.n_elements)
        step = max(1, _CHUNK_ENTRIES // left.shape[1])
        for first in range(0, len(order), step):
            part = order[first : first + step]
            forms = np.einsum("ij,ij->i", left[rows[part]], right[columns[part]]) * value[part]
            totals += np.bincount(element[part], forms, minlength=len(totals))
        return totals
    left, right = (np.concatenate([a, np.zeros((1, a.shape[1]))]) for a in (left, right))  # row -1: held at 0
    totals = np.empty(blocks.n_elements)
    step = max(1, _CHUNK_ENTRIES // (left.shape[1] * blocks.dofs.shape[1]))
    for first in range(0, blocks.n_elements, step):
        chosen = slice(first, first + step)
        products = blocks.local[chosen] @ right[blocks.dofs[chosen]]
        totals[chosen] = np.einsum("eij,eij->e", left[blocks.dofs[chosen]], products)
    return totals


def weight_slope(part: Contribution, unknown: Parameters, values: FloatArray) -> sparse.csr_array:
    """Derivative of the element weights of one contribution with respect to the parameters, (n_elements, n_params)."""
    return part.change(values, unknown.design.tocsr())


_REMEDIES = {"thickness": "take Young's modulus as the unknown", "position": "fix it"}


def require_linear_weights(structure: Structure, unknown: Parameters) -> None:
    """Raise `InputError` if a value that enters matrices non-linearly is a parameter or differs from the structure's.

    Such values are a thickness, a node coordinate, and bending and shear stiffness of a shear-flexible beam. Modal
    damping of the structure (`damping_ratio`) is refused too.
    """
    if structure.damping_ratio is not None:
        raise InputError(
            "modal damping (`damping_ratio` of all modes) is not linear in masses and stiffnesses, and these equations of motion"
            " are; fit spectra or output error, or FRFs, or take viscous elements in its place"
        )
    changing = (np.diff(unknown.design.tocsr().indptr) > 0) | (unknown.offset != structure.values)
    factors = nonlinear_values(structure)
    for item in structure.properties:
        if (factors[item.values] & changing[item.values]).any():
            remedy = _REMEDIES.get(item.term.kind, "leave the shear out")
            raise InputError(
                f"{item.label} must be known here, where equations of motion are linear in the parameters; {remedy}, or"
                f" identify the {item.term.property.replace('_', ' ')} from FRFs, spectra or output error"
            )


def nonlinear_values(structure: Structure) -> np.ndarray:
    """True for property values that enter matrices non-linearly, (n_values,) bool."""
    factors = np.zeros(len(structure.values), dtype=bool)
    for index in (index for part in structure.contributions if part.scale for index in part.scale.value_indices):
        factors[index] = True
    return factors


def require_matrices_in_time(structure: Structure, unknown: Parameters) -> None:
    """Raise `InputError` if the structure has friction or loss factors, which have no linear equation in time.

    Values of 0 that are no parameter count as absent.
    """
    touched = (np.diff(unknown.design.tocsr().indptr) > 0) | (unknown.offset != 0)
    for part in structure.contributions:
        if part.matrix_kind.startswith("friction:") and touched[part.value].any():
            raise InputError(
                f"friction {part.matrix_kind.removeprefix('friction:')!r} is not linear in the motion; take it out, or identify it"
                " from FRFs with `identify`"
            )
        if part.factor is not None and touched[part.factor].any():
            raise InputError(
                "loss factors have no equation in time (structural damping is defined for harmonic motion only); set them to 0"
                " and use viscous damping, or identify them from FRFs with `identify`"
            )


@dataclass(frozen=True, eq=False)
class SensitiveElements:
    """Elements of one family of blocks whose weights depend on the parameters, and the matrices they appear in."""

    blocks: ElementMatrices
    rows: IntArray
    members: tuple[int, ...]


def sensitive_elements(structure: Structure, unknown: Parameters) -> tuple[SensitiveElements, ...]:
    """Families of element matrices whose weights depend on parameters, without elements that do not.

    Contributions with the same element matrices are one family, which names those contributions that depend on
    parameters.
    """
    touched = np.diff(unknown.design.tocsr().indptr) > 0
    families: dict[int, list[int]] = {}
    for member, part in enumerate(structure.contributions):
        families.setdefault(id(part.blocks), []).append(member)
    sensitive = []
    for members in families.values():
        masks = []
        for member in members:
            part = structure.contributions[member]
            masks.append(part.touched(touched))
        rows = np.flatnonzero(np.any(masks, axis=0))
        used = tuple(m for m, mask in zip(members, masks, strict=True) if mask.any())
        if len(rows):
            sensitive.append(SensitiveElements(structure.contributions[members[0]].blocks.take(rows), rows, used))
    return tuple(sensitive)


@dataclass(frozen=True, eq=False)
class WeightedParts:
    """All element matrices that the parameters weigh, and the matrices to which they add.

    Attributes
    ----------
    parts : tuple of WeightedElements
    members : tuple of (int, (n_elements,) int array)
        For each part: a contribution of the structure that has its matrices, and which of its elements they are.
    uses : tuple of tuples of (str, float)
        For each kind of part: the matrices to which it adds, each with a number that multiplies it.
    variable : tuple of float arrays
        Entries of the slopes that may change with the values of the parameters.
    """

    parts: tuple[WeightedElements, ...]
    members: tuple[tuple[int, IntArray], ...]
    uses: tuple[tuple[tuple[str, float], ...], ...]
    variable: tuple[FloatArray, ...]

    def same_slopes(self, other: WeightedParts) -> bool:
        """True where the part that may change is equal in both."""
        if [part.kind for part in self.parts] != [part.kind for part in other.parts]:
            return False
        return all(np.array_equal(a, b) for a, b in zip(self.variable, other.variable, strict=True))


def slope_value_indices(
    structure: Structure, unknown: Parameters, sensitive: tuple[SensitiveElements, ...]
) -> IntArray:
    """Indices (n,), sorted, of the property values on which the derivatives of element weights depend.

    A weight is a value times factors: the factors count, and the value too if a parameter changes a factor. `sensitive`
    are the families of element matrices whose weights depend on parameters.
    """
    counts, marks = np.diff(unknown.design.tocsr().indptr), np.zeros(len(unknown.offset), dtype=bool)
    for member in (member for group in sensitive for member in group.members):
        item = structure.contributions[member]
        for index in item.value_indices[1:]:
            marks[index] = True
            if counts[index].any():
                marks[item.value] = True
    return np.flatnonzero(marks)


def weighted_elements(
    structure: Structure, unknown: Parameters, sensitive: tuple[SensitiveElements, ...], physical: FloatArray
) -> WeightedParts:
    """Element matrices with the derivatives of their weights by the parameters, at `physical` (n_params,).

    A loss factor that is equal in all elements of a family, and no parameter, is a multiple of their stiffness: both
    matrices then share one part. Parts that enter the same matrices with the same factors are of one kind. `sensitive`
    are the families of element matrices whose weights depend on parameters.
    """
    weights, design = unknown.values(physical), unknown.design.tocsr()
    counts = np.diff(design.indptr)
    groups: dict[tuple[int, int, int], tuple[ElementMatrices, sparse.csr_array, list[tuple[str, float]]]] = {}
    members: list[tuple[int, IntArray]] = []
    variable: list[FloatArray] = []
    for number, group in enumerate(sensitive):
        for member in group.members:
            item = structure.contributions[member]
            factor = np.ones(1) if item.factor is None else weights[item.factor][group.rows]
            other = 0 if item.factor is None else counts[item.factor][group.rows].sum()
            if item.scale is not None:
                factor = factor * item.scale.of(weights)[group.rows]
                other += item.scale.touched(counts > 0)[group.rows].sum()
            simple = np.ptp(factor) == 0 and not other
            key = (number, item.first, -1 if simple else member)
            if key not in groups:
                slope = design[item.value] if simple else weight_slope(item, unknown, weights)
                groups[key] = (group.blocks, sparse.csr_array(slope[group.rows]), [])
                members.append((member, group.rows))
                variable += [] if simple else [groups[key][1].data]
            groups[key][2].append((item.matrix_kind, float(factor[0]) if simple else 1.0))
    kinds = {uses: kind for kind, uses in enumerate(dict.fromkeys(tuple(uses) for _, _, uses in groups.values()))}
    parts = tuple(WeightedElements(blocks, slope, kinds[tuple(uses)]) for blocks, slope, uses in groups.values())
    return WeightedParts(parts, tuple(members), tuple(kinds), tuple(variable))
