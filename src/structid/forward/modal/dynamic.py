"""The modal dynamic residual: the smallest force that makes a measured shape a motion of the model."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.fem import Structure
from structid.forward.modal.measured import MeasuredModes
from structid.forward.modal.model import MatrixSlopes, ModalModel


def dynamic_rows(data: MeasuredModes, model: ModalModel, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force residual of all modes with a shape, (n_rows,), and its derivative by the parameters, (n_rows, n_params).

    A mode has a row for each known shape entry. Residuals are relative to the inertia force and to the relative error of the
    eigenvalue, at least 1e-3. `physical` (n_params,) are the parameters.
    """
    shown = data.record.known[:, data.measured].any(axis=0)
    found = [
        dynamic_residual(
            model.structure,
            model.slopes,
            physical,
            model.parameters.start,
            model.sensors[:, data.record.known[:, mode]],
            2 * np.pi * data.record.frequency[mode],
            data.shapes[data.record.known[:, mode], mode],
        )
        for mode in data.measured[shown]
    ]
    size = np.maximum(2 * data.frequency_std / data.frequency, 1e-3)[shown]
    error = np.concatenate([e / s for (e, _), s in zip(found, size, strict=True)])
    return error, np.concatenate([d / s for (_, d), s in zip(found, size, strict=True)])


def dynamic_residual(
    structure: Structure,
    slopes: MatrixSlopes,
    physical: FloatArray,
    start: FloatArray,
    sensors: FloatArray,
    omega: float,
    shape: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Smallest force residual of one measured mode over all unmeasured motions, and its derivative by the parameters.

    Among all fields phi with S' phi = psi it is the force Z phi, Z = K - omega^2 M, that is smallest in the norm of D^-1, with
    D^2 = diag(K) / omega^2 + diag(M) at the start. With Q R = D Z^-1 S the residual is R^-T psi and Q' D^-1 dZ phi its
    derivative (variable projection, exact gradient). It stays smooth where modes meet.

    Parameters
    ----------
    structure : Structure
    slopes : MatrixSlopes
    physical, start : (n_params,) float arrays
    sensors : (n_dofs, n_channels) float array
    omega : float
        Measured, rad/s.
    shape : (n_channels,) float array
        Measured.

    Returns
    -------
    (n_channels,) and (n_channels, n_params) float arrays
        In parts of the inertia force that the field of the model at the start has with the present masses, so that a
        common scale of masses and stiffnesses changes nothing.

    References
    ----------
    Norris (1986), Eqs. (4.20) to (4.26), for a free vibration; Kaufman (1975), BIT 15, 49-57.
    """
    turn = _independent(sensors)
    sensors, shape = sensors @ turn, turn.T @ shape
    values, first = slopes.parameters.values(physical), slopes.parameters.values(start)
    stiffness, mass = (structure.matrix(matrix_kind, values).toarray() for matrix_kind in ("stiffness", "mass"))
    stiffness_0, mass_0 = (structure.matrix(matrix_kind, first).toarray() for matrix_kind in ("stiffness", "mass"))
    weight = np.sqrt(np.abs(np.diag(stiffness_0)) / omega**2 + np.abs(np.diag(mass_0)))
    orthogonal, triangle, dynamic = _weighted_flexibility_factors(stiffness, mass, sensors, weight, omega)
    error = np.linalg.solve(triangle.T, shape)
    field = np.linalg.solve(dynamic, weight * (orthogonal @ error))
    forms = slopes.products(physical, ("stiffness", "mass"), (orthogonal / weight[:, None])[None], field[None, :, None])
    change = (forms["stiffness"] - omega**2 * forms["mass"])[0, :, 0]
    q_0, r_0, z_0 = _weighted_flexibility_factors(stiffness_0, mass_0, sensors, weight, omega)
    field_0 = np.linalg.solve(z_0, weight * (q_0 @ np.linalg.solve(r_0.T, shape)))
    inertia = omega**2 * (mass @ field_0) / weight
    size = float(np.linalg.norm(inertia))
    toward = (inertia / (size * weight))[None, :, None]
    growth = omega**2 * slopes.products(physical, ("mass",), toward, field_0[None, :, None])["mass"][0, 0, 0]
    return turn @ (error / size), turn @ (change / size - np.outer(error, growth) / size**2)


def _independent(sensors: FloatArray) -> FloatArray:
    """Orthonormal combinations of sensors that see different motions, (n_channels, rank); the unit matrix at full rank.

    `sensors` are (n_dofs, n_channels).
    """
    _, singular, rows = np.linalg.svd(sensors, full_matrices=False)
    rank = int(np.sum(singular > 1e-12 * singular.max(initial=0.0)))
    return np.eye(sensors.shape[1]) if rank == sensors.shape[1] else rows[:rank].T


def _weighted_flexibility_factors(
    stiffness: FloatArray, mass: FloatArray, sensors: FloatArray, weight: FloatArray, omega: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Factors Q and R of D Z^-1 S, and the dynamic stiffness Z = K - omega^2 M.

    `weight` (n_dofs,) is the diagonal of D, `sensors` (n_dofs, n_channels) is S, and `omega` is in rad/s. `stiffness` K
    and `mass` M are (n_dofs, n_dofs), Q (n_dofs, n_channels) and R (n_channels, n_channels).
    """
    dynamic = stiffness - omega**2 * mass
    orthogonal, triangle = np.linalg.qr(weight[:, None] * np.linalg.solve(dynamic, sensors))
    return orthogonal, triangle, dynamic
