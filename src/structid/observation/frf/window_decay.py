"""What an exponential window does to a measured FRF: it is then H at s = decay + i omega, not at i omega."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.observation.frf.laws import law_coefficients
from structid.observation.frf.response import Response
from structid.records.record import DERIVATIVES, FrfKind


def moved(model: Response, laplace: ComplexArray, kind: FrfKind) -> Response:
    """`model`, whose structure has no friction, at the Laplace variables `laplace` (n_frequencies,), in 1/s."""
    return replace(
        model,
        fixed_coefficients=law_coefficients(model.slopes.assembled.laws, laplace, {}),
        kind_factor=laplace ** DERIVATIVES[kind],
    )


def laplace_slope(
    model: Response, physical: FloatArray, values: ComplexArray, laplace: ComplexArray, kind: FrfKind
) -> ComplexArray:
    """dH/ds of the FRF `values` of `model`, in the unit of H times s, (n_frequencies, n_outputs, n_inputs).

    With H = s^n S' Z^-1 F and Z = s^2 M + s C + K it is n H / s - s^n Y' (2 s M + C) X, where X = Z^-1 F and Y = Z^-1 S.

    Parameters
    ----------
    model : Response
        At `laplace`.
    physical : (n_params,) float array
        Physical parameters of the structure.
    values : (n_frequencies, n_outputs, n_inputs) complex array
        The FRF there.
    laplace : (n_frequencies,) complex array
        s, 1/s, not 0.
    kind : FrfKind
    """
    fields = model.fields_at(physical, model.channels.columns)
    x, y = model.channels.under_loads(fields), model.channels.under_sensors(fields)
    weights = model.parameters.values(physical)
    inertia, viscous = (model.slopes.assembled.structure.matrix(law, weights) for law in ("inertia", "viscous"))
    flat = np.moveaxis(x, 1, 0).reshape(x.shape[1], -1)
    shape = (x.shape[1], x.shape[0], x.shape[2])
    s = laplace[:, None, None]
    change = 2 * s * np.moveaxis((inertia @ flat).reshape(shape), 0, 1)
    change = change + np.moveaxis((viscous @ flat).reshape(shape), 0, 1)
    slope: ComplexArray = DERIVATIVES[kind] * values / s - model.kind_factor[:, None, None] * (
        np.swapaxes(y, 1, 2) @ change
    )
    return slope
