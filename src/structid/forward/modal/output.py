"""Modes of the model paired with measured ones and their differences, with finite derivatives at close modes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.forward.modal.measured import GroupData, MeasuredModes, by_mode
from structid.forward.modal.model import ModalModel, ModelState
from structid.similarity import assign_pairs, mac_with_model, pairing_worth

_DENSE_UP_TO = 600
#: Of the largest motion of the sensors in any mode, what the sensors see of a mode that counts in the order.
_SEEN = 0.01
#: Of the least eigenvalue of a group, the least diagonal entry of A^-1 Lambda A that counts as a squared frequency:
#: where measured shapes of a group are nearly one, entries become negative.
_FLOOR = 1e-6
#: The same as `_SEEN` for a mode that moves a sensor at all: less is rounding, as of the torsion of a tower at its sensors.
_ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class GroupFit:
    """Model quantities of one group of modes; derivatives have the parameters last.

    Attributes
    ----------
    frequency : (m,) float array
        Hz; with the slope (m, n_params).
    damping : (m,) float array
        Damping ratio, NaN in a group of several; with its slope.
    shape_residual : (n_own, m) float array
        Measured shapes less their nearest in the span of the model's; with its slope.
    mixing : (m, m) float array
        Off-diagonal entries of A^-1 Lambda A over their standard deviation, zero on the diagonal; with its slope.
    """

    frequency: FloatArray
    frequency_slope: FloatArray
    damping: FloatArray
    damping_slope: FloatArray
    shape_residual: FloatArray
    shape_slope: FloatArray
    mixing: FloatArray
    mixing_slope: FloatArray


class _Slopes(NamedTuple):
    """Derivatives, the parameters last, and what they come from.

    `seen` are those of the shapes at sensors and losses, (n_y, m, n_params), `eigenvalues` those within the group,
    (m, m, n_params), `viscous` and `structural` those of the losses of a single mode, (n_params,).
    """

    seen: FloatArray
    eigenvalues: FloatArray
    viscous: FloatArray
    structural: FloatArray


def group_fit(state: ModelState, group: GroupData, chosen: IntArray, with_slopes: bool = True) -> GroupFit:
    """Model counterparts of a group of m measured modes, from the model's modes at indices `chosen` (m,).

    These are frequencies (Hz), damping ratio (of a single mode), shape residual and mixing, with their derivatives.
    With Phi the mass-normalized shapes, Psi the measured ones and B = S' Phi, the shape residual is Psi - B A with A
    from least squares, and the frequencies are the diagonal of A^-1 Lambda A. Both stay if the shapes Phi turn among
    themselves, so derivatives need no difference of eigenvalues in the group: d Lambda = Phi' (dK - (lambda_k +
    lambda_l) / 2 dM) Phi and, outside, S' d phi_k = -Y_k' (dK - lambda_k dM) phi_k with Y_k = (K - lambda_k M)^+ S.
    `state` has the modes and matrices of the model, and sensors divided by the standard deviations of the channels, as
    Psi is: the residual is in these. Without `with_slopes` the derivatives by the parameters have no columns.

    References
    ----------
    Nelson (1976), AIAA J. 14, 1201-1205 (bordered system); Golub and Pereyra (1973), SIAM J. Numer. Anal. 10,
    413-432, Eq. (4.12) (derivative of a projection).
    """
    phi = state.modes.mode_shapes[:, chosen]
    omega = 2 * np.pi * state.modes.frequency[chosen]
    eigenvalues = omega**2
    m = len(chosen)
    loss = _loss_force(state, phi, omega) if m == 1 else np.zeros((len(phi), 0))
    weights = np.vstack([state.sensors.T, loss.T]) @ phi  # (n_y, m)
    if not with_slopes:
        none = _Slopes(np.zeros((*weights.shape, 0)), np.zeros((m, m, 0)), np.zeros(0), np.zeros(0))
        return _fit_group(state, group, phi, omega, weights, none)
    adjoint = _adjoint(state, phi, eigenvalues, np.hstack([state.sensors, loss]))
    x = phi.T[:, :, None]
    y = np.concatenate([adjoint, np.broadcast_to(phi, (m, *phi.shape))], axis=2)
    forms = state.slopes.products(state.physical, ("mass", "stiffness", "damping", "structural_damping"), y, x)
    n_y = adjoint.shape[2]
    d_mass, d_stiffness = forms["mass"][:, :, 0], forms["stiffness"][:, :, 0]  # (m, n_y + m, n_params), mode first
    outside = -(d_stiffness[:, :n_y] - eigenvalues[:, None, None] * d_mass[:, :n_y])
    inside = d_mass[:, n_y:]  # phi_l' dM phi_k at [k, l]
    change = np.moveaxis(outside, 0, 1) - 0.5 * np.einsum("yl,klp->ykp", weights, inside)
    mean = 0.5 * (eigenvalues[:, None] + eigenvalues[None, :])
    d_lambda = d_stiffness[:, n_y:] - mean[:, :, None] * inside
    n_channels, n_params = state.readings.shape[0], change.shape[2]
    seen, values = _append_zero_columns(state, change), _append_zero_columns(state, d_lambda)
    seen[:n_channels, :, n_params:] = weights[:n_channels, :, None] * state.readings[:, None]
    viscous, structural = (
        _append_zero_columns(state, forms[matrix_kind][0, -1, 0]) for matrix_kind in ("damping", "structural_damping")
    )
    return _fit_group(state, group, phi, omega, weights, _Slopes(seen, values, viscous, structural))


def _fit_group(
    state: ModelState, group: GroupData, phi: FloatArray, omega: FloatArray, weights: FloatArray, slopes: _Slopes
) -> GroupFit:
    """Frequencies, damping, shape residual and mixing of the model for a measured group, with their derivatives.

    `state` has the model, its sensors divided by their standard deviations. The m modes have shapes `phi` (n_dofs, m)
    and frequencies `omega` (m,), rad/s. The first rows of `weights` (n_y, m) are the shapes at the sensors; `slopes`
    are derivatives by parameters. The damping ratio is NaN unless m is 1.
    """
    n_channels, m = state.readings.shape[0], len(omega)
    shape, d_shape, a, d_a = _project_shapes(weights[:n_channels], slopes.seen[:n_channels], group.shapes)
    frequency, d_frequency, mixing, d_mixing = _frequencies_of_group(omega**2, slopes.eigenvalues, a, d_a, group)
    ratio, d_ratio = np.full(m, np.nan), np.full((m, slopes.eigenvalues.shape[2]), np.nan)
    if m == 1:
        ratio, d_ratio = _damping(state, phi[:, 0], float(omega[0]), slopes)
    return GroupFit(frequency, d_frequency, ratio, d_ratio, shape, d_shape, mixing, d_mixing)


def _append_zero_columns(state: ModelState, slope: NDArray[np.floating]) -> FloatArray:
    """`slope` (..., n) with further zero columns for the errors of channels."""
    none = np.zeros((*slope.shape[:-1], state.readings.shape[1]))
    wider: FloatArray = np.concatenate([slope, none], axis=-1)
    return wider


def group_changes(
    state: ModelState, group: GroupData, chosen: IntArray, shapes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Changes of frequency, shape residual and mixing of a group of close modes by changes of its measured `shapes`.

    Parameters
    ----------
    state : ModelState
        Model, its sensors scaled by the standard deviations of the group's channels.
    group : GroupData
        The m measured modes.
    chosen : (m,) int array
        Indices of the model's modes.
    shapes : (n_own, m, n_changes) float array
        Changes of the shapes, in standard deviations of each channel.

    Returns
    -------
    (m, n_changes), (n_own, m, n_changes) and (m, m, n_changes) float arrays
        Changes of the frequency (Hz), the shapes' residual and the mixing (scaled off-diagonal of A^-1 Lambda A, where
        A fits the measured shapes by those of the model).
    """
    eigenvalues = (2 * np.pi * state.modes.frequency[chosen]) ** 2
    b = state.sensors.T @ state.modes.mode_shapes[:, chosen]
    pseudo = np.linalg.pinv(b)
    d_a = np.einsum("kc,crp->krp", pseudo, shapes)
    still = np.zeros((len(chosen), *d_a.shape[1:]))
    _, frequency, _, mixing = _frequencies_of_group(eigenvalues, still, pseudo @ group.shapes, d_a, group)
    return frequency, shapes - np.einsum("ck,krp->crp", b, d_a), mixing


def _loss_force(state: ModelState, phi: FloatArray, omega: FloatArray) -> FloatArray:
    """(C / omega + D / omega^2) phi of a single mode, (n_dofs, 1)."""
    return (state.damping @ phi) / omega + (state.structural @ phi) / omega**2


def _damping(state: ModelState, phi: FloatArray, omega: float, slopes: _Slopes) -> tuple[FloatArray, FloatArray]:
    """Damping ratio (phi' C phi / omega + phi' D phi / omega^2) / 2 of a mode, (1,), and its slope, (1, n_params).

    C is the viscous and D the structural damping matrix of `state`; `phi` (n_dofs,) is mass-normalized, `omega` is in
    rad/s, and `slopes` are the derivatives of eigenvalue, shapes and losses by the parameters.
    """
    c, d = float(phi @ (state.damping @ phi)), float(phi @ (state.structural @ phi))
    d_omega = slopes.eigenvalues[0, 0] / (2 * omega)
    slope = slopes.viscous / omega + slopes.structural / omega**2 + 2 * slopes.seen[-1, 0]
    slope = slope - (c / omega**2 + 2 * d / omega**3) * d_omega
    return np.array([0.5 * (c / omega + d / omega**2)]), 0.5 * slope[None]


def _adjoint(state: ModelState, phi: FloatArray, eigenvalues: FloatArray, right: FloatArray) -> FloatArray:
    """Products (K - lambda_k M)^+ `right` for each mode k of the group, (m, n_dofs, n_right), by the bordered system.

    The pseudo-inverse leaves out the shapes `phi` (n_dofs, m) of the group. `eigenvalues` (m,) are their lambda, and
    `right` is (n_dofs, n_right); K and M are the matrices of `state`.
    """
    n, m = phi.shape
    border = state.mass @ phi
    if n <= _DENSE_UP_TO:
        system = np.zeros((m, n + m, n + m))
        system[:, :n, :n] = state.stiffness.toarray() - eigenvalues[:, None, None] * state.mass.toarray()
        system[:, :n, n:], system[:, n:, :n] = border, border.T
        padded = np.vstack([right, np.zeros((m, right.shape[1]))])
        return np.linalg.solve(system, np.broadcast_to(padded, (m, *padded.shape)))[:, :n]
    solutions = []
    padded = np.vstack([right, np.zeros((m, right.shape[1]))])
    for value in eigenvalues:
        upper = sparse.hstack([state.stiffness - value * state.mass, sparse.csc_array(border)])
        lower = sparse.hstack([sparse.csc_array(border.T), sparse.csc_array((m, m))])
        solutions.append(splu(sparse.csc_matrix(sparse.vstack([upper, lower]))).solve(padded)[:n])
    return np.array(solutions)


def _project_shapes(
    b: FloatArray, d_b: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Residual Psi - B A of measured shapes Psi by least squares, its slope, the factor A (m, m), and its slope.

    `measured` (n_own, m) is Psi, `b` (n_own, m) are the shapes B of the model, `d_b` (n_own, m, n_params) their slope;
    slopes have the parameters last.
    """
    pseudo = np.linalg.pinv(b)
    a = pseudo @ measured
    residual = measured - b @ a
    moved = np.einsum("ckp,kr->crp", d_b, a)
    turned = np.einsum("ckp,cr->krp", d_b, residual)
    gram = pseudo @ pseudo.T
    d_a = -np.einsum("kc,crp->krp", pseudo, moved) + np.einsum("kl,lrp->krp", gram, turned)
    d_residual = -moved - np.einsum("ck,krp->crp", b, d_a)
    return residual, d_residual, a, d_a


def _frequencies_of_group(
    eigenvalues: FloatArray, d_lambda: FloatArray, a: FloatArray, d_a: FloatArray, group: GroupData
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Frequencies (Hz) from the diagonal of T = A^-1 Lambda A, its off-diagonal in standard deviations, and slopes.

    The order is frequencies (m,), slope, off-diagonal (m, m), slope; slopes have the parameters last. `eigenvalues`
    (m,) are the diagonal of Lambda, `a` is A (m, m); `d_lambda` and `d_a` (m, m, n_params) are the slopes of Lambda and
    A; `group` gives the standard deviations. Diagonal entries below a floor count as the floor, with a slope of 0. For
    a single mode T is Lambda.
    """
    if len(eigenvalues) == 1:
        a, d_a = np.ones_like(a), np.zeros_like(d_a)
    inverse = np.linalg.inv(a)
    turned = inverse @ (eigenvalues[:, None] * a)
    inner = np.einsum("klp,lr->krp", d_lambda, a) + eigenvalues[:, None, None] * d_a
    d_turned = np.einsum("sk,krp->srp", inverse, inner - np.einsum("klp,lr->krp", d_a, turned))
    diagonal = np.arange(len(eigenvalues))
    floor = max(_FLOOR * float(eigenvalues.min()), np.finfo(float).tiny)
    squared = turned[diagonal, diagonal]
    omega = np.sqrt(np.maximum(squared, floor))
    d_omega = np.where(squared[:, None] > floor, d_turned[diagonal, diagonal], 0.0) / (2 * omega[:, None])
    size = group.mixing_std * np.sqrt(np.outer(group.eigenvalues, group.eigenvalues))
    off = 1.0 - np.eye(len(eigenvalues))
    scale = off / np.where(off > 0, size, 1.0)
    return omega / (2 * np.pi), d_omega / (2 * np.pi), turned * scale, d_turned * scale[:, :, None]


def pairing(data: MeasuredModes, state: ModelState, in_order: bool) -> IntArray:
    """Index of the model mode for each measured mode, (n_measured,), by shape and frequency, or in order of frequency.

    By shape the sum over pairs of MAC, lowered by the distance in frequency, is maximized; modes without a known shape
    entry are paired by frequency alone. With `in_order` modes are paired in order of frequency, the lowest first; model
    modes that hardly move a sensor (1 % of the largest motion or less) are passed over if enough others are left and
    some measured shape is known. Raises `InputError` if the model has too few modes that move the sensors.
    """
    use, motion, is_bare = _visible_modes(data, state)
    if len(use) < len(data.measured):
        raise InputError(
            f"the model has {len(use)} modes that move the sensors and {len(data.measured)} are measured;"
            " refine the model, or leave modes out with `use`"
        )
    if in_order:
        clear = use if is_bare.all() else use[motion[use] > _SEEN * motion[use].max(initial=0.0)]
        return (clear if len(clear) >= len(data.measured) else use)[np.argsort(np.argsort(data.frequency))]
    return use[assign_pairs(_worth(data, state, use, motion))[1]]


def unpaired_modes(data: MeasuredModes, state: ModelState) -> tuple[IntArray, FloatArray]:
    """Numbers (from 0) of the measured modes left over where the model has too few, and the model's frequencies (Hz).

    The numbers (n_left,) are empty where the model has a mode for each. The frequencies (n_use,) are those of the model
    modes that can be paired: that move a sensor, if all measured modes have shapes, and are no rigid bodies.
    """
    use, motion, _ = _visible_modes(data, state)
    frequency = state.modes.frequency[use]
    if len(use) >= len(data.measured):
        return np.zeros(0, dtype=int), frequency
    paired = assign_pairs(_worth(data, state, use, motion))[0]
    return np.setdiff1d(data.measured, data.measured[paired]), frequency


def _visible_modes(data: MeasuredModes, state: ModelState) -> tuple[IntArray, FloatArray, NDArray[np.bool_]]:
    """Indices of model modes that can be paired, largest sensor motion in each mode, and modes without shape.

    The indices (n_use,) are ascending: modes that move a sensor by more than rounding, or all if a measured mode has no
    known shape entry, above a thousandth of the lowest measured frequency. The motion is (n_model,), of all model
    modes, 0 where it is rounding. The last is a mask (n_measured,) of the measured modes without a known shape entry.
    """
    is_bare = np.asarray(np.isnan(data.shapes[:, data.measured]).all(axis=0))
    motion = np.abs(state.seen).max(axis=0, initial=0.0)
    motion = np.where(motion > _ROUNDING * motion.max(initial=0.0), motion, 0.0)
    counts = (motion > 0) | is_bare.any()
    return np.flatnonzero((state.modes.frequency > 1e-3 * data.frequency.min()) & counts), motion, is_bare


def _worth(data: MeasuredModes, state: ModelState, use: IntArray, motion: FloatArray) -> FloatArray:
    """Worth of pairing each measured mode with each of the model modes `use`, (n_measured, n_use).

    `motion` (n_model,) is the largest motion of a sensor in each model mode.
    """
    likeness = mac_with_model(data.shapes[:, data.measured], state.seen[:, use], motion[use] > 0)
    return pairing_worth(likeness, data.frequency, state.modes.frequency[use], data.settings.frequency_guard)


def _groups_at(
    data: MeasuredModes, model: ModalModel, physical: FloatArray, in_order: bool
) -> list[tuple[ModelState, GroupData, IntArray]]:
    """Model state, group, and indices (m,) of the model's modes, for each group of m measured modes in turn.

    The state has only the sensors of the group, divided by their standard deviations. `physical` are the parameters of
    the structure, then those of channel errors; with `in_order` modes are paired by frequency order.
    """
    state = model.state(physical)
    pairs = dict(zip(data.measured.tolist(), pairing(data, state, in_order).tolist(), strict=True))
    groups = []
    for group in data.groups:
        channels = group.channels
        seen = replace(state, sensors=state.sensors[:, channels] / group.shape_std, readings=state.readings[channels])
        groups.append((seen, group, np.array([pairs[r] for r in group.members.tolist()])))
    return groups


def output_rows(
    data: MeasuredModes, model: ModalModel, physical: FloatArray, in_order: bool, with_slopes: bool = True
) -> tuple[FloatArray, FloatArray, int]:
    """Weighted data rows (n_data,) of form ``output``, their slopes (n_data, n_params), number of eliminated unknowns.

    Rows are the shape residual (measured less model) and the mixing of one group of modes after another, then
    frequencies and, if used, damping ratios of all modes (model less measured). `physical` are the parameters of the
    structure, then those of channel errors; with `in_order` modes are paired by frequency order. Without `with_slopes`
    the slopes are (n_data, 0).
    """
    fits: list[GroupFit] = []
    rows: list[FloatArray] = []
    slopes: list[FloatArray] = []
    eliminated = 0
    n_params = model.n_params if with_slopes else 0
    for state, group, chosen in _groups_at(data, model, physical, in_order):
        fit = group_fit(state, group, chosen, with_slopes)
        rows += [fit.shape_residual.ravel(), fit.mixing.ravel()]
        slopes += [fit.shape_slope.reshape(fit.shape_residual.size, n_params)]
        slopes += [fit.mixing_slope.reshape(fit.mixing.size, n_params)]
        n_mixing = len(chosen) ** 2 if len(group.channels) else 0
        eliminated += n_mixing + len(chosen)  # A, and the mixing's empty diagonal
        fits.append(fit)
    groups = data.groups
    frequency = by_mode(groups, [fit.frequency for fit in fits]) - data.frequency
    damping = by_mode(groups, [fit.damping for fit in fits]) - data.record.damping_ratio[data.measured]
    scalar = data.whitened(frequency[:, None], damping[:, None])[:, 0]
    change = (
        by_mode(groups, [fit.frequency_slope for fit in fits]),
        by_mode(groups, [fit.damping_slope for fit in fits]),
    )
    unused = int((~data.is_alone).sum()) if data.settings.use_damping else 0
    jacobian = np.concatenate([*slopes, data.whitened(*change)])
    return np.concatenate([*rows, scalar]), jacobian, eliminated + unused


def output_changes(data: MeasuredModes, model: ModalModel, physical: FloatArray, in_order: bool) -> FloatArray | None:
    """Joint variations (n_changes, n_data) of the data rows, whose products sum to their covariance; None if unknown.

    It is unknown if the record does not say how its numbers vary together; data rows then count as independent. Their
    order is that of `output_rows`: shapes and mixing group by group, frequencies, damping ratios. `physical` are the
    parameters of the structure, then of channel errors; with `in_order` modes are paired by frequency order.
    """
    if data.changes is None:
        return None
    frequency, ratio, shapes = data.changes
    rows, moving = [], []
    for state, group, chosen in _groups_at(data, model, physical, in_order):
        by_channel = np.moveaxis(shapes[:, group.channels][:, :, group.members], 0, -1)
        moved = by_channel / group.shape_std[:, None, None]
        d_frequency, d_shape, d_mixing = group_changes(state, group, chosen, moved)
        rows += [d_shape.reshape(-1, len(shapes)), d_mixing.reshape(-1, len(shapes))]
        moving.append(d_frequency)
    rows.append(data.whitened(by_mode(data.groups, moving) - frequency.T, -ratio.T))
    return np.concatenate(rows).T
