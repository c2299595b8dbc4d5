"""Viscous damping with one damping ratio in every mode, and how it changes with masses and stiffnesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, sparse

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError, SingularModelError
from structid.core.last_results import LastResults
from structid.fem.blocks import Blocks
from structid.fem.contribution import Contribution, Factor
from structid.fem.elements.element import PropertyMatrices

#: What stands for the modes where properties name element sets.
ALL_MODES = "all modes"
#: Largest model; and most entries of the matrix times values of masses and stiffnesses.
_MOST_DOFS, _MOST_SLOPES = 1200, 1_000_000_000
#: Slopes by all values together that are kept, 32 MB.
_MOST_KEPT = 4_000_000
#: Part of what a motion takes along in stiffness or mass below which it has none: a rigid body's, or one without mass.
_NOTHING = 1e-13


def damping_term(damping_ratio: float) -> PropertyMatrices:
    """The `damping_ratio` of all modes as a property of the structure.

    Raises
    ------
    InputError
        If it is negative, or 1 or more.
    """
    if not 0 <= damping_ratio < 1:
        raise InputError(f"`damping_ratio` must be at least 0 and less than 1, as 0.01 for 1 %, got {damping_ratio:g}")
    return PropertyMatrices("damping_ratio", "damping_ratio", "1", locked([damping_ratio]))


@dataclass(frozen=True, eq=False)
class ModalState:
    """Modes of a structure, scaled so that each has phi' (M + K / shift) phi = 1.

    Attributes
    ----------
    shapes, duals : (n_dofs, n_dofs) float arrays
        Phi, a column a mode, and the transpose of its inverse.
    heavy, stiff : (n_dofs,) float arrays
        Square roots of phi' M phi and phi' K phi: 0 of a motion without mass, and of a rigid body's.
    """

    shapes: FloatArray
    duals: FloatArray
    heavy: FloatArray
    stiff: FloatArray

    @cached_property
    def shares(self) -> dict[str, FloatArray]:
        """Factors on dM and dK in modal coordinates, by kind of matrix, whose sum is the change of the mean M # K.

        M # K is the geometric mean of mass and stiffness matrix; dM and dK are their changes. Arrays (n_dofs, n_dofs)
        for "mass" and "stiffness"; entry (k, l) belongs to modes k and l, and is 0 where both lack mass or both lack
        stiffness.
        """
        products = np.outer(self.heavy, self.stiff)
        sums = products + products.T
        size = np.hypot(self.heavy, self.stiff)
        is_positive = sums > _NOTHING * np.outer(size, size)
        sums = np.where(is_positive, sums, 1.0)
        return {
            "mass": np.where(is_positive, np.outer(self.stiff, self.stiff) / sums, 0.0),
            "stiffness": np.where(is_positive, np.outer(self.heavy, self.heavy) / sums, 0.0),
        }

    @cached_property
    def matrix(self) -> FloatArray:
        """2 (M # K), (n_dofs, n_dofs)."""
        return 2 * (self.duals * (self.heavy * self.stiff)) @ self.duals.T


@dataclass(frozen=True, eq=False)
class ModalDamping(Factor):
    """Entries of the damping matrix for a damping ratio of 1 in all modes.

    With modes K Phi = M Phi Omega^2, Phi' M Phi = I, it is M Phi (2 Omega) Phi' M = 2 M (M^-1 K)^(1/2), twice the
    geometric mean S = M # K of mass and stiffness. S solves S M^-1 S = K, so that its change between modes k and l is

        phi_k' dS phi_l = (phi_k' dK phi_l + omega_k omega_l phi_k' dM phi_l) / (omega_k + omega_l)

    and nothing divides by a difference. Motions without stiffness or without mass are not damped.

    Attributes
    ----------
    parts : tuple of Contribution
        Of mass and stiffness.
    n_values : int
        Number of values of the structure.
    rows, columns : (n_entries,) int arrays
        On and above the diagonal.

    References
    ----------
    Bhatia (2007), Positive Definite Matrices, section 4.1 (geometric mean); Higham (2008), Functions of Matrices,
    section 6.1 (derivative of the square root).
    """

    parts: tuple[Contribution, ...]
    n_values: int
    rows: IntArray
    columns: IntArray

    @cached_property
    def value_indices(self) -> tuple[IntArray, ...]:
        """Indices of the values that the damping depends on, each broadcast over all entries."""
        return tuple(np.broadcast_to(value, self.rows.shape) for value in self._values)

    def of(self, values: FloatArray) -> FloatArray:
        """Damping entries (n_entries,) at property `values`, N s/m, N m s and so on; see `Factor.of`."""
        found: FloatArray = self.at(values).matrix[self.rows, self.columns]
        return found

    def touched(self, changing: np.ndarray) -> np.ndarray:
        """True for every entry if a mass or stiffness value is marked in `changing` (n_values,); (n_entries,)."""
        return np.full(self.rows.shape, changing[self._values].any())

    def slope(self, values: FloatArray, number: int) -> FloatArray:
        """Derivative of the damping entries (n_entries,) by the property value at `value_indices[number]`.

        It is taken at the property `values` (n_values,) of the whole structure. Derivatives by all values are cached
        together unless they are too many.
        """
        if len(self.rows) * len(self._values) > _MOST_KEPT:
            return self.change(values, self._alone([number])).toarray()[:, 0]
        every = self._alone(range(len(self._values)))
        table = self._last_slopes.get_or_make(values.tobytes(), lambda: locked(self.change(values, every).toarray().T))
        return np.asarray(table[number])

    def _alone(self, numbers: Sequence[int]) -> sparse.csr_array:
        """Derivative (n_values, n) of all values by those with `numbers` among the ones that damping depends on."""
        columns = np.arange(len(numbers))
        return sparse.csr_array(
            (np.ones(len(numbers)), (self._values[list(numbers)], columns)), (self.n_values, len(numbers))
        )

    @cached_property
    def _last_slopes(self) -> LastResults[bytes, FloatArray]:
        """Slopes by all values that damping depends on, a row each, at the values last asked for."""
        return LastResults(1)

    def change(self, values: FloatArray, design: sparse.csr_array) -> sparse.csr_array:
        """Derivative of the damping entries by parameters, sparse (n_entries, n_parameters), at property `values`.

        `values` (n_values,) are those of the whole structure; `design` (n_values, n_parameters) is their derivative by
        the parameters. The entries are those of the upper triangle for a damping ratio of 1.
        """
        state = self.at(values)
        changes = [(part, part.change(values, design).tocsc()) for part in self.parts]
        touched = np.flatnonzero(np.sum([np.diff(change.indptr) for _, change in changes], axis=0))
        rows = np.empty((len(touched), len(self.rows)))
        for row, column in zip(rows, touched.tolist(), strict=True):
            total = np.zeros(self._shape)
            for part, change in changes:
                span = slice(change.indptr[column], change.indptr[column + 1])
                if span.start < span.stop:
                    matrix = part.blocks.take(change.indices[span]).assemble(change.data[span])
                    total += state.shares[part.matrix_kind] * (state.shapes.T @ (matrix @ state.shapes))
            row[:] = 2 * (state.duals @ total @ state.duals.T)[self.rows, self.columns]
        indices = np.tile(np.arange(len(self.rows)), len(touched)), np.repeat(touched, len(self.rows))
        return sparse.coo_array((rows.ravel(), indices), (len(self.rows), design.shape[1])).tocsr()

    def at(self, values: FloatArray) -> ModalState:
        """Modes of the structure at the property values `values` (n_values,): shapes, and modal masses and stiffnesses.

        The last result is cached, by the values that masses and stiffnesses depend on.
        """
        key = values[self._values].tobytes()
        if key not in self._known:
            self._known.clear()
            self._known[key] = self._solve_modes(values)
        return self._known[key]

    def _solve_modes(self, values: FloatArray) -> ModalState:
        """Modes at property values (n_values,), with phi' (M + K / c) phi = 1; c balances mass and stiffness.

        c is the least ratio of diagonal entries of K and M, 1 if that is not above 0. The result has shapes, the
        highest frequency first, their products with M + K / c, and square roots of modal mass and stiffness. Raises
        `SingularModelError` if a motion has neither.
        """
        mass, stiffness = (self._dense_matrix(matrix_kind, values) for matrix_kind in ("mass", "stiffness"))
        has_mass = np.diag(mass) > 0
        scaling = float((np.diag(stiffness)[has_mass] / np.diag(mass)[has_mass]).min(initial=np.inf))
        scaling = scaling if 0 < scaling < np.inf else 1.0
        scaled_sum = mass + stiffness / scaling
        try:
            shapes = linalg.eigh(mass, scaled_sum)[1]
        except (linalg.LinAlgError, ValueError) as error:
            raise SingularModelError(
                "modal damping needs mass or stiffness in every motion, none of them negative; fix loose parts with `fixed`, or"
                " give them some"
            ) from error
        squares = [np.einsum("ij,ij->j", shapes, matrix @ shapes) for matrix in (mass, stiffness / scaling)]
        heavy, stiff = (np.sqrt(np.where(square > _NOTHING, square, 0.0)) for square in squares)
        return ModalState(shapes, scaled_sum @ shapes, heavy, stiff * np.sqrt(scaling))

    def _dense_matrix(self, matrix_kind: str, values: FloatArray) -> FloatArray:
        """Dense mass or stiffness matrix of the structure at property values (n_values,), (n_dofs, n_dofs).

        `matrix_kind` is "mass" or "stiffness".
        """
        total = np.zeros(self._shape)
        for part in self.parts:
            if part.matrix_kind == matrix_kind:
                total += part.blocks.assemble(part.weights(values)).toarray()
        return total

    @property
    def _shape(self) -> tuple[int, int]:
        n_dofs = self.parts[0].blocks.n_dofs
        return n_dofs, n_dofs

    @cached_property
    def _values(self) -> IntArray:
        """Indices (n,) of the values of masses and stiffnesses among all property values."""
        every = np.arange(self.n_values)
        return np.unique(np.concatenate([every[index] for part in self.parts for index in part.value_indices]))

    @cached_property
    def _known(self) -> dict[bytes, ModalState]:
        """The last state, by the values of masses and stiffnesses."""
        return {}


def modal_damping(parts: Sequence[Contribution], ratio_index: int, n_values: int, n_dofs: int) -> Contribution:
    """Viscous damping with one ratio in all modes, as a contribution to the damping matrix that the ratio multiplies.

    It has one element for each entry of the upper triangle, weighted by that entry for a ratio of 1, which depends on
    masses and stiffnesses.

    Parameters
    ----------
    parts : sequence of Contribution
        All others of the structure; those of mass and stiffness are used.
    ratio_index : int
        Index of the damping ratio among the property values of the structure.
    n_values, n_dofs : int
        Number of property values, and of free degrees of freedom.

    Raises
    ------
    InputError
        If the structure is too large (more than 1200 degrees of freedom, or too many entries times values), or lacks
        mass or stiffness.
    """
    own = tuple(part for part in parts if part.matrix_kind in ("mass", "stiffness"))
    if {part.matrix_kind for part in own} != {"mass", "stiffness"}:
        raise InputError(
            "modal damping needs masses and stiffnesses; leave `damping_ratio` out, or add what is missing"
        )
    rows, columns = np.triu_indices(n_dofs)
    damping = ModalDamping(own, n_values, locked(rows, np.int64), locked(columns, np.int64))
    if n_dofs > _MOST_DOFS or len(rows) * len(damping.value_indices) > _MOST_SLOPES:
        raise InputError(
            f"modal damping has a full matrix, up to {_MOST_DOFS} degrees of freedom and {_MOST_SLOPES:.0e} entries times"
            f" values, and the structure has {n_dofs} and {len(rows) * len(damping.value_indices):.1e}; reduce parts of it to"
            " components, or use loss factors of twice the damping ratio"
        )
    local = np.where((rows == columns)[:, None, None], [[1.0, 0.0], [0.0, 0.0]], [[0.0, 1.0], [1.0, 0.0]])
    dofs = np.stack([rows, np.where(rows == columns, -1, columns)], axis=1)
    value = np.broadcast_to(np.int64(ratio_index), rows.shape)
    return Contribution("damping", Blocks(dofs, local, n_dofs), value, scale=damping)
