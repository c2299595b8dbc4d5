"""Derivatives of the matrices of a parametrized structure, seen only through products y' (dA/dp) x."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Structure
from structid.fem.matrices.assembly import structure_matrix_kinds
from structid.forward.contraction import DenseSlopes, dense_slopes
from structid.forward.sensitive import SensitiveElements, sensitive_elements, weight_slope
from structid.inversion.last_evaluation import LastEvaluation
from structid.unknowns import Parameters

#: Derivative of the weights of some elements, (n_elements, n_params).
Slope: TypeAlias = sparse.csr_array | FloatArray
#: Number of a group of elements, and of a contribution.
_Member: TypeAlias = tuple[int, int]
#: Places of values in a weight, and entries, up to which slopes are full arrays.
_FEW, _SMALL = 6, 50_000


@dataclass(frozen=True, eq=False)
class MatrixSlopes:
    """Products y' (dA/dp) x with the derivatives of mass, damping and stiffness.

    Small models use full matrices dA/dp, which all modes share.
    """

    structure: Structure
    parameters: Parameters

    def products(
        self, physical: FloatArray, matrix_kinds: Iterable[str], y: FloatArray, x: FloatArray
    ) -> dict[str, FloatArray]:
        """Products y' (dA/dp) x of each of several matrices A, for each parameter.

        Parameters
        ----------
        physical : (n_params,) float array
        matrix_kinds : iterable of {"mass", "damping", "stiffness", "structural_damping"}
        y : (n, n_dofs, n_y) float array
        x : (n, n_dofs, n_x) float array

        Returns
        -------
        dict of str to (n, n_y, n_x, n_params) float array
        """
        if self.structure.n_dofs <= DENSE_UP_TO:
            changes, adjoint = self._latest_changes.at(physical, self._changes_at), np.swapaxes(y, 1, 2)[:, None]
            return {
                matrix_kind: np.moveaxis(adjoint @ (changes[matrix_kind] @ x[:, None]), 1, -1)
                for matrix_kind in matrix_kinds
            }
        shape = (x.shape[0], y.shape[2], x.shape[2], self.parameters.n_params)
        found: dict[str, FloatArray] = {matrix_kind: np.zeros(shape) for matrix_kind in matrix_kinds}
        weights = self._weight_slopes(physical)
        for number, group in enumerate(self.elements):
            forms = np.moveaxis(group.blocks.bilinear(y, x), 1, -1)
            for member in group.members:
                matrix_kind = self.structure.contributions[member].matrix_kind
                if matrix_kind in found:
                    slope = weights[number, member]
                    found[matrix_kind] += (slope.T @ forms.reshape(-1, len(group.rows)).T).T.reshape(shape)
        return found

    def _changes_at(self, physical: FloatArray) -> dict[str, FloatArray]:
        """Derivatives dA/dp of each matrix A, (n_params, n_dofs, n_dofs), by the kind of the matrix; for small models.

        `physical` (n_params,) are the parameters.
        """
        at, n_dofs = self._dense.at(self.parameters.values(physical)), self.structure.n_dofs
        shape = (self.parameters.n_params, n_dofs, n_dofs)
        found: dict[str, FloatArray] = {matrix_kind: np.zeros(shape) for matrix_kind in self._matrix_kinds}
        for matrix_kind, chosen, matrix in at.maps:
            found[self._matrix_kinds[matrix_kind]][at.parameters[chosen], at.dofs[chosen]] = matrix
        return found

    @cached_property
    def _matrix_kinds(self) -> tuple[str, ...]:
        return structure_matrix_kinds(self.structure)

    @cached_property
    def _dense(self) -> DenseSlopes:
        return dense_slopes(self.structure, self._matrix_kinds, self.parameters.design)

    @cached_property
    def _latest_changes(self) -> LastEvaluation[dict[str, FloatArray]]:
        return LastEvaluation()

    @cached_property
    def elements(self) -> tuple[SensitiveElements, ...]:
        """Element matrices that the parameters weigh, for larger models."""
        return sensitive_elements(self.structure, self.parameters)

    def _weight_slopes(self, physical: FloatArray) -> dict[_Member, Slope]:
        """Derivatives of the weights of each group's members, by group and member: found once at each point, for all modes."""
        return self._last.at(physical, self._weight_slopes_at)

    def _weight_slopes_at(self, physical: FloatArray) -> dict[_Member, Slope]:
        values = self.parameters.values(physical)
        return {member: self._weight_slope(*member, values) for member in self._designs}

    def _weight_slope(self, number: int, member: int, values: FloatArray) -> Slope:
        """Derivative of the element weights of contribution `member` in group `number`, (n_elements, n_params).

        `values` (n_values,) are the property values. Sparse for large groups.
        """
        part, rows = self.structure.contributions[member], self.elements[number].rows
        designs = self._designs[number, member]
        if not designs:
            return weight_slope(part, self.parameters, values)[rows]
        pieces = [
            part.slope(values, number_of_value)[rows, None] * columns for number_of_value, columns in designs.items()
        ]
        slope: FloatArray = np.sum(pieces, axis=0)
        return slope

    @cached_property
    def _designs(self) -> dict[_Member, dict[int, FloatArray]]:
        """Derivatives by the parameters of the property values in element weights, dense (n_elements, n_params).

        By group and contribution, then by the place of the value; empty for large groups.
        """
        design, found = self.parameters.design.tocsr(), {}
        for number, group in enumerate(self.elements):
            for member in group.members:
                indices = self.structure.contributions[member].value_indices
                is_small = len(indices) <= _FEW and len(group.rows) * design.shape[1] <= _SMALL
                pieces = [design[index][group.rows].toarray() for index in indices] if is_small else []
                found[number, member] = {k: piece for k, piece in enumerate(pieces) if piece.any()}
        return found

    @cached_property
    def _last(self) -> LastEvaluation[dict[_Member, Slope]]:
        return LastEvaluation()
