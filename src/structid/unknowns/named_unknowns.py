"""The part of a least-squares problem that its parameters alone decide."""

from __future__ import annotations

from structid.arrays import FloatArray
from structid.unknowns.parameters import Parameters


class NamedUnknowns:
    """Names, units, start and transforms of a problem whose unknowns are `parameters` and nothing else."""

    parameters: Parameters

    @property
    def names(self) -> tuple[str, ...]:
        return self.parameters.names

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.parameters.kinds

    @property
    def units(self) -> tuple[str, ...]:
        return self.parameters.units

    @property
    def start(self) -> FloatArray:
        """Physical values that the search begins at, (n_params,)."""
        return self.parameters.start

    @property
    def prior_mean(self) -> FloatArray:
        """Of each parameter, physical units; NaN where there is no prior."""
        return self.parameters.prior_mean

    @property
    def prior_std(self) -> FloatArray:
        """Likewise."""
        return self.parameters.prior_std

    @property
    def theta_start(self) -> FloatArray:
        return self.parameters.theta_start

    def physical(self, theta: FloatArray) -> FloatArray:
        """Physical parameters, (n_params,)."""
        return self.parameters.transforms.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative of each with respect to its free variable, (n_params,)."""
        return self.parameters.transforms.slope(theta)
