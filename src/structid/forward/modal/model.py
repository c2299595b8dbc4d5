"""Modes of a parametrized structure as sensors see them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.forward.channel_errors import ChannelErrors
from structid.forward.modal.matrix_slopes import MatrixSlopes
from structid.forward.modal.output import ModelState
from structid.inversion.last_evaluation import LastEvaluation
from structid.unknowns import Parameters

#: Degrees of freedom up to which all modes of the model are found, and dense matrices made.
DENSE_UP_TO = 600


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
        Of the sensors; their parameters follow those of the structure.
    n_modes : int
        How many modes were measured, which says how many are sought of a large model.
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
        """Matrices, modes and sensor columns of the model at `physical`, computed afresh.

        Up to `DENSE_UP_TO` degrees of freedom all modes are computed, else 3 `n_modes` + 10. `physical` are the
        parameters of the structure, then those of channel errors.
        """
        own, values = physical[: self.parameters.n_params], self.parameters.values(physical[: self.parameters.n_params])
        matrix_kinds = ("mass", "damping", "stiffness", "structural_damping")
        mass, damping, stiffness, structural = (
            self.structure.matrix(matrix_kind, values) for matrix_kind in matrix_kinds
        )
        count = None if self.structure.n_dofs <= DENSE_UP_TO else 3 * self.n_modes + 10
        found = modes(mass, stiffness, n_modes=count, strains=partial(self.structure.strain_operator, values))
        gains, change = self.readings(physical)
        sensors = self.sensors * gains
        return ModelState(mass, damping, stiffness, structural, found, sensors, self.slopes, own, change)

    def readings(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Factor of each sensor's reading, (n_channels,), and the derivative of its logarithm, (n_channels, n_errors).

        `physical` are the parameters of the structure, then those of channel errors.
        """
        if self.errors is None:
            return np.ones(self.sensors.shape[1]), np.zeros((self.sensors.shape[1], 0))
        errors, still = physical[self.parameters.n_params :], np.zeros(1, dtype=np.complex128)
        return self.errors.readings(errors, still)[0][0].real, self.errors.output_slopes(errors, still)[0].real

    @cached_property
    def _last(self) -> LastEvaluation[ModelState]:
        return LastEvaluation()
