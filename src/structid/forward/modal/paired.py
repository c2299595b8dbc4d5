"""Modes of the model paired with measured ones and held against them: the residual of form ``output``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.forward.modal.measured import MeasuredModes
from structid.forward.modal.model import ModalModel
from structid.forward.modal.output import GroupData, GroupFit, ModelState, by_mode, group_changes, group_fit
from structid.similarity import assign_pairs, mac_with_model, pairing_worth

#: Of the largest motion of the sensors in any mode, what the sensors see of a mode that counts in the order.
_SEEN = 0.01


def pairing(data: MeasuredModes, state: ModelState, in_order: bool) -> IntArray:
    """Index of the model mode for each measured mode, (n_measured,), by shape and frequency, or in order of frequency.

    The sum of `pairing_worth` (MAC with a guard on frequency) is maximized. Modes without a known shape entry are
    paired by frequency alone. Raises `InputError` if the model has too few modes that move the sensors. With `in_order`
    modes are paired in order of frequency and shapes are not used.
    """
    frequency, found, shapes = data.frequency, state.modes, data.shapes[:, data.measured]
    seen = state.sensors.T @ found.mode_shapes
    motion = np.abs(seen).max(axis=0, initial=0.0)
    is_bare = np.isnan(shapes).all(axis=0)
    counts = (motion > 0) | is_bare.any()
    use = np.flatnonzero((found.frequency > 1e-3 * frequency.min()) & counts)
    if len(use) < len(data.measured):
        raise InputError(
            f"the model has {len(use)} modes that move the sensors and {len(data.measured)} are measured;"
            " refine the model, or leave modes out with `use`"
        )
    if in_order:
        clear = use if is_bare.all() else use[motion[use] > _SEEN * motion[use].max(initial=0.0)]
        return (clear if len(clear) >= len(data.measured) else use)[np.argsort(np.argsort(frequency))]
    likeness = mac_with_model(shapes, seen[:, use], motion[use] > 0)
    worth = pairing_worth(likeness, frequency, found.frequency[use], data.settings.frequency_guard)
    return use[assign_pairs(worth)[1]]


def _groups_at(
    data: MeasuredModes, model: ModalModel, physical: FloatArray, in_order: bool
) -> list[tuple[ModelState, GroupData, IntArray]]:
    """Model state with its sensors scaled, group, and indices of its model modes, for each group of measured modes.

    `physical` are the parameters of the structure, then those of channel errors; with `in_order` modes are paired by
    frequency order. Indices are (n_modes of the group,).
    """
    state = model.state(physical)
    pairs = dict(zip(data.measured.tolist(), pairing(data, state, in_order).tolist(), strict=True))
    found = []
    for group in data.groups:
        own = group.channels
        seen = replace(state, sensors=state.sensors[:, own] / group.shape_std, readings=state.readings[own])
        found.append((seen, group, np.array([pairs[r] for r in group.members.tolist()])))
    return found


def output_rows(
    data: MeasuredModes, model: ModalModel, physical: FloatArray, in_order: bool, with_slopes: bool = True
) -> tuple[FloatArray, FloatArray, int]:
    """Weighted data rows (n_data,) of form ``output``, their slopes (n_data, n_params), and the number of eliminated unknowns.

    `physical` are the parameters of the structure, then those of channel errors; with `in_order` modes are paired by
    frequency order. Without `with_slopes` the slopes are (n_data, 0).
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
    """Changes (n_changes, n_data) of the data rows whose products sum to their covariance; None if unknown.

    None if the record does not say how its numbers vary together; the rows then count as independent. `physical` are the
    parameters of the structure, then those of channel errors; with `in_order` modes are paired by frequency order.
    """
    if data.changes is None:
        return None
    frequency, ratio, shapes = data.changes
    rows, moving = [], []
    for state, group, chosen in _groups_at(data, model, physical, in_order):
        own = np.moveaxis(shapes[:, group.channels][:, :, group.members], 0, -1)
        moved = own / group.shape_std[:, None, None]
        d_frequency, d_shape, d_mixing = group_changes(state, group, chosen, moved)
        rows += [d_shape.reshape(-1, len(shapes)), d_mixing.reshape(-1, len(shapes))]
        moving.append(d_frequency)
    rows.append(data.whitened(by_mode(data.groups, moving) - frequency.T, -ratio.T))
    return np.concatenate(rows).T
