"""The equations of motion at sampled instants as rows of a linear regression in the parameters.

M(p) a + C(p) v + K(p) w = f is linear in the parameters where M, C and K are. With the property values
``offset + design p`` the row of degree of freedom d and the column of parameter q are row d of dM/dq times a, of
dC/dq times v and of dK/dq times w (Norris 1986, Eqs. 3.6 to 3.11). Those few nonzero rows, one under another, make one
sparse operator, so that the regressors of a whole chunk of samples are one sparse product.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked, require_shape
from structid.core.errors import InputError
from structid.fem import Contribution, Structure
from structid.forward.motion.motion import MOTION_QUANTITIES, Motion
from structid.forward.sensitivity import require_linear_weights, require_matrices_in_time
from structid.unknowns import Parameters

_MATRIX_KINDS = ("mass", "damping", "stiffness")  # in the order of MOTION_QUANTITIES
_STATE_ENTRIES = 40_000_000
_MOST_IN_ONE_BLOCK = 200


@dataclass(frozen=True, eq=False)
class TimeEquations:
    """Operator from motion to the rows of a regression.

    Attributes
    ----------
    unknown : Parameters
    n_dofs : int
    columns : (n_blocks, n_columns) int array
        Parameter of each column of each block, -1 for none; one block a degree of freedom, or one for all of them.
    operator : (n_dofs (n_columns + 1), 4 n_dofs) sparse array
        Maps [acceleration velocity displacement force] of one instant to regressors and right-hand side.
    """

    unknown: Parameters
    n_dofs: int
    columns: IntArray
    operator: sparse.csr_array

    @property
    def side(self) -> int:
        """Columns of a block with the right-hand side."""
        return self.columns.shape[1] + 1

    def fields(self, motion: Motion) -> FloatArray:
        """Stacked fields [acceleration velocity displacement force] of a motion, (4 n_dofs, n_times).

        A quantity that the motion lacks, and the equations do not hold, is 0.

        Raises
        ------
        InputError
            If the motion is of another size, or lacks a quantity that the equations hold.
        """
        if motion.force.shape[1] != self.n_dofs:
            raise InputError(f"motion must have {self.n_dofs} degrees of freedom, got {motion.force.shape[1]}")
        self.require({name for name in MOTION_QUANTITIES if getattr(motion, name) is not None})
        measured = (getattr(motion, name) for name in MOTION_QUANTITIES)
        parts = [np.zeros(motion.force.shape) if part is None else part for part in measured]
        return np.concatenate([part.T for part in (*parts, motion.force)])

    def require(self, present: Collection[str]) -> None:
        """Raise `InputError` unless the quantities that the equations hold are all among the names `present`.

        Names are "acceleration", "velocity" and "displacement".
        """
        needed = np.bincount(self.operator.indices // self.n_dofs, minlength=4) > 0
        for name, matrix_kind, need in zip(MOTION_QUANTITIES, _MATRIX_KINDS, needed, strict=False):
            if need and name not in present:
                raise InputError(
                    f"{name} is missing, and the structure has {_MATRIX_WORDS[matrix_kind]}; measure it, or make it by a stated"
                    " rule: 'trapezoid' from acceleration, 'difference' from displacement (see `completed`)"
                )

    def rows(self, fields: FloatArray) -> FloatArray:
        """Regressors and right-hand sides of `fields` (4 n_dofs, n_times), (n_blocks, n_rows, n_columns + 1)."""
        return self.shaped(self.operator @ fields)

    def shaped(self, products: FloatArray) -> FloatArray:
        """Rows of each block, (n_blocks, n_rows, n_columns + 1), from the output of the operator.

        `products` are (n_dofs (n_columns + 1), n_times).
        """
        products = products.reshape(self.n_dofs, self.side, -1)
        return np.swapaxes(products, 1, 2).reshape(len(self.columns), -1, self.side)

    def sizes(self, energy: FloatArray) -> FloatArray:
        """Norm that each parameter's regressor column would have without cancellation, (n_params,).

        Parameters
        ----------
        energy : (4 n_dofs,) float array
            Sum over samples of the square of each field: accelerations, velocities, displacements, then forces.
        """
        gross = (abs(self.operator) @ np.sqrt(energy)) ** 2
        total = np.zeros(self.unknown.n_params + 1)
        np.add.at(total, self._places, gross)
        return np.sqrt(total[:-1])

    def noise_gram(self, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Expected additions to B'B (n_params, n_params) and B'c (n_params,) by independent errors of the fields.

        B are the regressors and c the right-hand sides of all equations.

        Parameters
        ----------
        variance : (4 n_dofs,) float array
            Sum over samples of the error variance of each field: accelerations, velocities, displacements, then forces.

        Returns
        -------
        (n_params, n_params) and (n_params,) float arrays
        """
        n_params = self.unknown.n_params
        spread = self.operator @ sparse.diags_array(np.sqrt(variance))
        dof, row = np.arange(spread.shape[0]) // self.side, np.arange(spread.shape[0])
        slot = self._places  # by parameter and by (degree of freedom, field), so that the product sums over both
        index = np.repeat(row, np.diff(spread.indptr))
        column = dof[index] * spread.shape[1] + spread.indices
        right = np.arange(self.side - 1, spread.shape[0], self.side)
        slot = slot.copy()
        slot[right] = n_params
        keep = slot[index] >= 0
        table = (spread.data[keep], (slot[index][keep], column[keep]))
        wide = sparse.csr_array(sparse.coo_array(table, (n_params + 1, self.n_dofs * spread.shape[1])))
        gram = (wide @ wide.T).toarray()
        return gram[:n_params, :n_params], gram[:n_params, n_params]

    @property
    def _places(self) -> IntArray:
        """Parameter (n_rows,) of each row of the operator; -1, the last of one more, for right-hand sides and none."""
        columns = np.broadcast_to(self.columns, (self.n_dofs, self.side - 1))
        return np.concatenate([columns, np.full((self.n_dofs, 1), -1)], axis=1).ravel()


_MATRIX_WORDS = {"mass": "mass", "damping": "viscous damping", "stiffness": "stiffness"}


def time_equations(structure: Structure, unknown: Parameters, row_weights: ArrayLike | None = None) -> TimeEquations:
    """Linear equations of motion in the parameters, for a structure whose M, C and K are linear in these.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Masses, viscous dampings and stiffnesses; groups, ties and factors as declared. Known properties go to the
        right-hand side.
    row_weights : (n_dofs,) array, optional
        Factor on the equation of each degree of freedom, such as one over the standard deviation of its error; 1 by
        default. With metres and radians in one model, weights decide how forces and moments count against each other.

    Raises
    ------
    InputError
        If the structure has loss factors, friction or modal damping, a parameter enters matrices non-linearly,
        parameters have priors, or weights are not finite, negative or all 0.
    """
    _require_linear(structure, unknown)
    n, n_params = structure.n_dofs, unknown.n_params
    weights = np.ones(n) if row_weights is None else np.asarray(row_weights, dtype=np.float64)
    require_shape("row_weights", weights, (n,), "one factor a free degree of freedom")
    if not np.isfinite(weights).all() or (weights < 0).any() or not weights.any():
        raise InputError("`row_weights` must be finite, none negative and not all 0")
    row, field, parameter, value = _entries(structure, unknown)
    columns, slot = _layout(row, parameter, n, n_params)
    side = columns.shape[1] + 1
    rows = np.concatenate([row * side + slot, np.arange(n) * side + side - 1])
    entries = np.concatenate([value * weights[row], weights])
    table = (entries, (rows, np.concatenate([field, 3 * n + np.arange(n)])))
    operator = sparse.csr_array(sparse.coo_array(table, (n * side, 4 * n)))
    operator.eliminate_zeros()
    return TimeEquations(unknown, n, locked(columns), operator)


def _require_linear(structure: Structure, unknown: Parameters) -> None:
    """Raise `InputError` unless the equation of motion in time is linear in the unknowns and these have no priors.

    It is not with unknown thickness, node positions or shear, nor with modal damping, loss factors or friction.
    """
    require_linear_weights(structure, unknown)
    require_matrices_in_time(structure, unknown)
    if unknown.has_priors:
        raise InputError(
            "priors need a known noise level, which identification from motion takes from its residual;"
            " use `without_priors()`, or fix the parameters"
        )


def _entries(structure: Structure, unknown: Parameters) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Sparse entries of the linear equations: row, column among the fields, parameter and value, (n_entries,) each.

    Rows are degrees of freedom; columns are their accelerations, velocities and displacements, in blocks of n_dofs. The
    parameter index is n_params for known terms, whose value is that of the right-hand side.
    """
    design = unknown.design.tocsr()
    entries = [
        _expanded(
            part,
            design[part.value],
            unknown.offset[part.value],
            structure.n_dofs,
            _MATRIX_KINDS.index(part.matrix_kind),
        )
        for part in structure.contributions
        if part.matrix_kind in _MATRIX_KINDS
    ]
    row, field, parameter, value = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    return row, field, parameter, value


def _expanded(
    part: Contribution, design: sparse.csr_array, offset: FloatArray, n_dofs: int, matrix_kind: int
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Sparse entries of one contribution to the equations, one for each parameter in a weight and for the known parts.

    Entries are row, field column (`matrix_kind` n_dofs + degree of freedom), parameter and value. Known terms have the
    parameter index n_params and the opposite sign, as on the right-hand side.

    Parameters
    ----------
    part : Contribution
    design : (n_elements, n_params) sparse array
        Derivative of the element weights by parameters.
    offset : (n_elements,) float array
        Known part of the element weights.
    n_dofs, matrix_kind : int
        Number of degrees of freedom, and index of the matrix among mass, damping and stiffness (from 0).
    """
    row, column, element, value = part.blocks.entries()
    field = matrix_kind * n_dofs + column
    del column
    count = np.diff(design.indptr)[element]
    again = np.repeat(np.arange(len(element)), count)
    entry = np.arange(len(again)) - np.repeat(np.cumsum(count) - count - design.indptr[element], count)
    del count
    known = np.flatnonzero(offset[element])
    parameter = np.concatenate([design.indices[entry], np.full(len(known), design.shape[1])]).astype(np.int64)
    weighted = np.concatenate([value[again] * design.data[entry], -value[known] * offset[element[known]]])
    del entry, element, value
    again = np.concatenate([again, known])
    return row[again], field[again], parameter, weighted


def _layout(row: IntArray, parameter: IntArray, n_dofs: int, n_params: int) -> tuple[IntArray, IntArray]:
    """Parameter of each column of each block, (n_blocks, n_columns), and the column of every entry within its block.

    `row` and `parameter` (n_entries,) are the entries. There is a block for each degree of freedom, or a single one if
    these would take too much memory and there are at most 200 parameters. Unused columns are -1; known
    terms (`parameter` is `n_params`) are in the last column, the right-hand side.
    """
    pairs = np.unique((row * (n_params + 1) + parameter)[parameter < n_params])
    dof, column = pairs // (n_params + 1), pairs % (n_params + 1)
    first = np.searchsorted(dof, np.arange(n_dofs))
    width = int(np.bincount(dof, minlength=n_dofs).max(initial=0))
    if n_dofs * (width + 1) ** 2 > _STATE_ENTRIES and n_params <= _MOST_IN_ONE_BLOCK:
        return np.arange(n_params)[None, :], parameter
    columns = np.full((n_dofs, width), -1, dtype=np.int64)
    columns[dof, np.arange(len(dof)) - first[dof]] = column
    slot = np.searchsorted(pairs, row * (n_params + 1) + parameter) - first[row]
    return columns, np.where(parameter < n_params, slot, width)
