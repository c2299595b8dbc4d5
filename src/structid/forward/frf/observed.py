"""FRFs as sensors and load cells read them: the response of a structure with the errors of its channels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray
from structid.forward.channel_errors import ChannelErrors
from structid.forward.frf.channels import read
from structid.forward.frf.response import Response
from structid.forward.frf.slopes import matrix_coefficients
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES, FrfKind


@dataclass(frozen=True, eq=False)
class ObservedFrf:
    """FRFs as a record has them, for physical parameters: those of the structure, then those of the channels.

    Parameters
    ----------
    model : Response
    channels : ChannelErrors or None
    record : FrfRecord
        Gives lines and kind.
    """

    model: Response
    channels: ChannelErrors | None
    record: FrfRecord

    def values(self, physical: FloatArray) -> ComplexArray:
        """FRFs with channel errors, (n_frequencies, n_outputs, n_inputs), in the kind of the record.

        `physical` (n_params,) are the parameters of the structure, then those of the channels.
        """
        if self.channels is None:
            return self.model.values_at(physical)
        own, rest = np.split(physical, [self.model.parameters.n_params])
        model, laplace = self._shift_by_decay(self.channels, rest)
        return model.values_at(own) * self.channels.factor(rest, laplace)

    def derivatives(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """FRFs with channel errors, (n_frequencies, n_outputs, n_inputs), and their derivatives, (..., n_params).

        `physical` (n_params,) are the parameters of the structure, then those of the channels.
        """
        if self.channels is None:
            return self.model.derivatives_at(physical)
        own, rest = np.split(physical, [self.model.parameters.n_params])
        model, laplace = self._shift_by_decay(self.channels, rest)
        values, derivative = model.derivatives_at(own)
        change = self.channels.log_slopes(rest, laplace) * values[..., None]
        for row in self.channels.rows("window_decay"):
            steep = _laplace_slope(model, own, values, laplace, self.record.kind)
            change[..., row] = steep - self.channels.lateness(rest) * values
        factor = self.channels.factor(rest, laplace)[..., None]
        return values * factor[..., 0], np.concatenate([derivative, change], axis=-1) * factor

    def _shift_by_decay(self, channels: ChannelErrors, rest: FloatArray) -> tuple[Response, ComplexArray]:
        """Response model and its Laplace variable s (n_frequencies,), 1/s, shifted by an unknown window decay.

        A window exp(-decay t) turns H at i omega into H at s = decay + i omega. Nothing is shifted if the decay is no
        parameter. `rest` are the parameters of the channels.
        """
        decay = channels.decay(rest)
        if decay is None:
            return self.model, self.record.laplace
        laplace = self.record.laplace + decay
        coefficients = matrix_coefficients(self.model.slopes.matrix_kinds, laplace, {})
        factor = laplace ** DERIVATIVES[self.record.kind]
        return replace(self.model, fixed_coefficients=coefficients, kind_factor=factor), laplace


def _laplace_slope(
    model: Response, physical: FloatArray, values: ComplexArray, laplace: ComplexArray, kind: FrfKind
) -> ComplexArray:
    """Derivative dH/ds of the FRFs `values` of `model`, in the unit of H times s, (n_frequencies, n_outputs, n_inputs).

    With H = s^n S' Z^-1 F and Z = s^2 M + s C + K it is n H / s - s^n Y' (2 s M + C) X, where X = Z^-1 F and Y = Z^-1 S.
    `physical` are the parameters of the structure, `laplace` (n_frequencies,) is s in 1/s.
    """
    fields = model.fields_at(physical, model.channels.columns)
    x, y = model.channels.under_loads(fields), model.channels.under_sensors(fields)
    weights = model.parameters.values(physical)
    inertia, viscous = (model.slopes.structure.matrix(matrix_kind, weights) for matrix_kind in ("mass", "damping"))
    s = laplace[:, None, None]
    change = 2 * s * read(sparse.csr_array(inertia), x)
    change = change + read(sparse.csr_array(viscous), x)
    slope: ComplexArray = DERIVATIVES[kind] * values / s - model.kind_factor[:, None, None] * (
        np.swapaxes(y, 1, 2) @ change
    )
    return slope
