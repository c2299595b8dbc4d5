"""Modes of a parametrized structure as sensors see them, and derivatives of its matrices as products y' (dA/dp) x."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Structure
from structid.fem.assembly import structure_matrix_kinds
from structid.forward.channel_errors import ChannelErrors
from structid.forward.sensitivity import DenseSlopes, SensitiveElements, dense_slopes, sensitive_elements, weight_slope
from structid.inversion.linearization import LastEvaluation
from structid.unknowns import Parameters

#: Degrees of freedom up to which all modes of the model are computed.
ALL_MODES_UP_TO = 600
#: Derivative of the weights of some elements, (n_elements, n_params).
Slope: TypeAlias = sparse.csr_array | FloatArray
#: Number of a group of elements, and of a contribution.
_Member: TypeAlias = tuple[int, int]
#: Places of values in a weight, and entries, up to which slopes are full arrays.
_FEW, _SMALL = 6, 50_000


@dataclass(frozen=True, eq=False)
class ModelState:
    """Matrices, modes and sensors of the model at one point, and what differentiates them.

    Attributes
    ----------
    mass, damping, stiffness, structural : (n_dofs, n_dofs) sparse arrays
    modes : Modes
    sensors : (n_dofs, n_channels) float array
        Columns of the record's sensors; for a group those of its channels, over their standard deviations.
    slopes : MatrixSlopes
    physical : (n_params,) float array
        Parameters of the structure.
    readings : (n_channels, n_errors) float array
        Derivative of the logarithm of what each sensor reads with respect to errors of channels, which follow the
        parameters.
    """

    mass: sparse.csc_array
    damping: sparse.csc_array
    stiffness: sparse.csc_array
    structural: sparse.csc_array
    modes: Modes
    sensors: FloatArray
    slopes: MatrixSlopes
    physical: FloatArray
    readings: FloatArray

    @cached_property
    def seen(self) -> FloatArray:
        """Mode shapes at the sensors, (n_channels, n_modes)."""
        return self.sensors.T @ self.modes.mode_shapes


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Modes of a structure at any values of its parameters and of the errors of its sensors.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
    channels : tuple of Dof
        Sensors.
    errors : ChannelErrors or None
        Errors of the sensors; their parameters follow those of the structure.
    n_modes : int
        Number of measured modes, which sets how many modes of a large model are computed.
    """

    structure: Structure
    parameters: Parameters
    channels: tuple[Dof, ...]
    errors: ChannelErrors | None
    n_modes: int

    @cached_property
    def sensors(self) -> FloatArray:
        """(n_dofs, n_channels)."""
        return self.structure.selection(self.channels).toarray()

    @cached_property
    def slopes(self) -> MatrixSlopes:
        """Derivatives of the structure's matrices."""
        return MatrixSlopes(self.structure, self.parameters)

    @property
    def n_params(self) -> int:
        """Number of parameters of the structure and of the channel errors."""
        return self.parameters.n_params + (0 if self.errors is None else self.errors.n_params)

    def state(self, physical: FloatArray) -> ModelState:
        """Matrices, modes and sensor columns of the model at `physical`, cached for the last point.

        `physical` are the parameters of the structure, then those of channel errors. Sensors are not scaled to a group.
        """
        return self._last.at(physical, self._state_at)

    def _state_at(self, physical: FloatArray) -> ModelState:
        """Matrices, modes and sensor columns (n_dofs, n_channels) of the model at `physical`, computed afresh.

        Up to 600 degrees of freedom all modes are computed, else 3 `n_modes` + 10. `physical` are the parameters of the
        structure, then those of channel errors, which scale the sensors.
        """
        of_structure = physical[: self.parameters.n_params]
        values = self.parameters.values(of_structure)
        matrix_kinds = ("mass", "damping", "stiffness", "structural_damping")
        mass, damping, stiffness, structural = (
            self.structure.matrix(matrix_kind, values) for matrix_kind in matrix_kinds
        )
        count = None if self.structure.n_dofs <= ALL_MODES_UP_TO else 3 * self.n_modes + 10
        normal_modes = modes(mass, stiffness, n_modes=count, strains=partial(self.structure.strain_operator, values))
        gains, change = self.readings(physical)
        sensors = self.sensors * gains
        return ModelState(
            mass, damping, stiffness, structural, normal_modes, sensors, self.slopes, of_structure, change
        )

    def readings(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Factor of each sensor's reading, (n_channels,), and the derivative of its logarithm, (n_channels, n_errors).

        `physical` are the parameters of the structure, then those of channel errors. Without such errors the factors
        are 1, and the derivative has no columns.
        """
        if self.errors is None:
            return np.ones(self.sensors.shape[1]), np.zeros((self.sensors.shape[1], 0))
        errors, still = physical[self.parameters.n_params :], np.zeros(1, dtype=np.complex128)
        return self.errors.readings(errors, still)[0][0].real, self.errors.output_slopes(errors, still)[0].real

    @cached_property
    def _last(self) -> LastEvaluation[ModelState]:
        return LastEvaluation()


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
        """Products y' (dA/dp) x of each of several matrices A, for each parameter p.

        Parameters
        ----------
        physical : (n_params,) float array
            Parameters, at which the derivative is taken.
        matrix_kinds : iterable of {"mass", "damping", "stiffness", "structural_damping"}
        y : (n, n_dofs, n_y) float array
        x : (n, n_dofs, n_x) float array
            n sets of fields, each with the set of the same index in `y`.

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
        products: dict[str, FloatArray] = {matrix_kind: np.zeros(shape) for matrix_kind in matrix_kinds}
        weights = self._weight_slopes(physical)
        for number, group in enumerate(self.elements):
            forms = np.moveaxis(group.blocks.bilinear(y, x), 1, -1)
            for member in group.members:
                matrix_kind = self.structure.contributions[member].matrix_kind
                if matrix_kind in products:
                    slope = weights[number, member]
                    products[matrix_kind] += (slope.T @ forms.reshape(-1, len(group.rows)).T).T.reshape(shape)
        return products

    def _changes_at(self, physical: FloatArray) -> dict[str, FloatArray]:
        """Derivatives dA/dp of each matrix A, (n_params, n_dofs, n_dofs), by the kind of the matrix; for small models.

        `physical` (n_params,) are the parameters.
        """
        slopes, n_dofs = self._dense.at(self.parameters.values(physical)), self.structure.n_dofs
        shape = (self.parameters.n_params, n_dofs, n_dofs)
        changes: dict[str, FloatArray] = {matrix_kind: np.zeros(shape) for matrix_kind in self._matrix_kinds}
        for matrix_kind, chosen, matrix in slopes.maps:
            changes[self._matrix_kinds[matrix_kind]][slopes.parameters[chosen], slopes.dofs[chosen]] = matrix
        return changes

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
        """Derivatives of the weights of each group's members, by group and member: cached for one point."""
        return self._last.at(physical, self._weight_slopes_at)

    def _weight_slopes_at(self, physical: FloatArray) -> dict[_Member, Slope]:
        values = self.parameters.values(physical)
        return {member: self._weight_slope(*member, values) for member in self._designs}

    def _weight_slope(self, number: int, member: int, values: FloatArray) -> Slope:
        """Derivative of the weights of one contribution's element matrices by the parameters, (n_elements, n_params).

        Only the elements of the group count. `number` is the index of the group of elements, `member` that of the
        contribution in the structure, `values` (n_values,) are the property values. Sparse for large groups.
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

        Keys are the index of the group and that of the contribution, then the index of the value in the weight (0 for
        the first factor). A contribution with more than 6 values or 50,000 entries, or without parameters, has an empty
        table.
        """
        design, designs = self.parameters.design.tocsr(), {}
        for number, group in enumerate(self.elements):
            for member in group.members:
                indices = self.structure.contributions[member].value_indices
                is_small = len(indices) <= _FEW and len(group.rows) * design.shape[1] <= _SMALL
                pieces = [design[index][group.rows].toarray() for index in indices] if is_small else []
                designs[number, member] = {k: piece for k, piece in enumerate(pieces) if piece.any()}
        return designs

    @cached_property
    def _last(self) -> LastEvaluation[dict[_Member, Slope]]:
        return LastEvaluation()
