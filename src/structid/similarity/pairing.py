"""Which mode of a model each measured mode is: by shape and frequency together, close ones by the space they span."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.similarity.shapes import mac, subspace_angles

#: Part of the worth of a pair that another must reach to be as good a choice.
_AS_GOOD = 0.8
#: MAC from which a close mode of the model has a part in a measured one.
_PART = 0.1
#: MAC of every pair from which close modes are distinguished, and compared one by one.
_TOLD = 0.95
#: Logarithmic distance in frequency, in parts of the guard, beyond which there is no pair.
_FARTHEST = 3.0
#: Frequencies beyond those measured, in parts, within which a mode that was not measured is named.
_BEYOND = 0.03
#: Part of the largest motion of a sensor from which a mode of the model moves the sensors at all.
_MOVES = 1e-6


@dataclass(frozen=True, eq=False)
class Pairing:
    """Measured modes and their like in a model. Modes count from 0.

    Attributes
    ----------
    number : (n_measured,) int array
        The model's mode; -1 where none is like it.
    likeness : (n_measured,) float array
        MAC with that mode; of close modes cos^2 of the largest principal angle between the spans. Also where it is too
        low for a pair: then of the best candidate that no other measured mode has. NaN where no entry of the measured
        shape is known: the pair is that of frequencies alone.
    mac : (n_measured, n_model) float array
        0 for modes of the model that move no sensor, NaN for measured shapes without a known entry.
    groups : tuple of (measured, model)
        Close modes that are compared as spans, one-to-many where the measurement has not told them apart: numbers of
        measured and of modelled modes.
    ambiguous : mapping of int to tuple of int
        Measured modes, with modes of the model that are as good a choice as the one taken.
    surplus : tuple of int
        Modes of the model within the measured range that no measured one is like, though they move the sensors.
    nearness : (n_measured, n_model) float array
        What frequencies leave of the worth of a pair, 1 at the same; 0 where there is none, whatever the shapes.
    """

    number: IntArray
    likeness: FloatArray
    mac: FloatArray
    groups: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    ambiguous: Mapping[int, tuple[int, ...]]
    surplus: tuple[int, ...]
    nearness: FloatArray

    @property
    def paired(self) -> IntArray:
        """Indices of the measured modes that have a partner among the model modes."""
        return np.flatnonzero(self.number >= 0)

    @property
    def missing(self) -> IntArray:
        """Indices of the measured modes that have no partner among the model modes."""
        return np.flatnonzero(self.number < 0)

    def partners(self, mode: int) -> tuple[int, ...]:
        """Indices of all model modes that are compared with the measured mode `mode`; () if it has no counterpart."""
        for measured, model in self.groups:
            if mode in measured:
                return model
        return (int(self.number[mode]),) if self.number[mode] >= 0 else ()


def likenesses(measured: NDArray[np.inexact], model: NDArray[np.inexact], moves: NDArray[np.bool_]) -> FloatArray:
    """MAC of each measured shape with each model mode, (n_measured, n_model).

    `measured` and `model` are (n_channels, n_modes) at common channels. The MAC is 0 for model modes that do not move the
    sensors (False in `moves`, (n_model,)), and NaN for measured shapes without a known entry.
    """
    unknown = np.isnan(measured).all(axis=0)
    values = np.zeros((measured.shape[1], model.shape[1]))
    values[unknown] = np.nan
    if moves.any() and not unknown.all():
        values[np.ix_(~unknown, moves)] = mac(measured[:, ~unknown], model[:, moves])
    return values


def pairing_worth(likeness: FloatArray, measured: FloatArray, model: FloatArray, guard: float) -> FloatArray:
    """MAC / (1 + (log(f_model / f) / guard)^2) of every pair, (n_measured, n_model).

    Parameters
    ----------
    likeness : (n_measured, n_model) float array
        MAC; NaN of modes whose shape is unknown, which are paired by frequency alone: it counts as 1.
    measured, model : (n_measured,) and (n_model,) float arrays
        Frequencies above 0, Hz.
    guard : float
        Logarithmic distance in frequency at which a pair is worth half as much.
    """
    distance = np.log(model[None, :] / measured[:, None]) / guard
    return np.asarray(np.where(np.isnan(likeness), 1.0, likeness) / (1 + distance**2))


def assign_pairs(worth: FloatArray) -> tuple[IntArray, IntArray]:
    """Row and column indices of the pairs with the largest sum of `worth`, (n_pairs,) each, rows ascending.

    Each row and each column is used at most once.
    """
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(worth, maximize=True)
    return rows, columns


def pair_modes(
    measured_frequency: ArrayLike,
    measured_shapes: ArrayLike,
    model_frequency: ArrayLike,
    model_shapes: ArrayLike,
    *,
    least_mac: float = 0.5,
    closeness: float = 0.02,
    frequency_guard: float = 0.3,
) -> Pairing:
    """Pairs of measured modes and model modes, each used once, with the largest sum of `pairing_worth`.

    Measured modes with neighbouring frequencies within `closeness` form a group, compared as a subspace with their model modes
    and other model modes close to these, where single shapes cannot be distinguished.

    Parameters
    ----------
    measured_frequency, model_frequency : (n_measured,) and (n_model,) arrays
        Frequencies in Hz, ascending. Model modes below a thousandth of the lowest measured frequency (rigid bodies) are left
        out.
    measured_shapes, model_shapes : (n_channels, n_measured) and (n_channels, n_model) arrays, real or complex
        Shapes at the same channels. Unknown entries of measured shapes are NaN and left out, in a group for all of its
        modes. A mode without a known entry is paired by frequency alone.
    least_mac : float
        Smallest MAC of a pair; for a group, smallest cos^2 of the largest angle between the subspaces.
    closeness : float
        Relative distance of neighbouring frequencies within which modes are close.
    frequency_guard : float
        Distance |ln(f_model / f_measured)| at which a pair is worth half as much; beyond three times that there is none.

    Returns
    -------
    Pairing

    Raises
    ------
    InputError
        If shapes disagree, or a measured frequency is not above 0.

    References
    ----------
    Allemang (2003), Sound and Vibration 37(8), 14-23; Knyazev and Argentati (2002) for angles between spans; Kuhn (1955)
    for the assignment.
    """
    f, g = (np.asarray(given, dtype=np.float64) for given in (measured_frequency, model_frequency))
    x, y = np.asarray(measured_shapes), np.asarray(model_shapes)
    for name, axis, shapes in (("measured", f, x), ("model", g, y)):
        if axis.ndim != 1 or shapes.ndim != 2 or shapes.shape[1] != len(axis):
            raise InputError(
                f"`{name}_shapes` must be (n_channels, {axis.size}), one column a frequency, got shape {shapes.shape}"
            )
    if not len(f) or not (f > 0).all():
        raise InputError("`measured_frequency` must hold frequencies above 0 Hz; leave rigid-body modes out")
    size = np.abs(y).max(axis=0, initial=0.0)
    vibrates = g > 1e-3 * f.min()
    moves = vibrates & (size > _MOVES * size.max(initial=0.0))
    use = np.flatnonzero(vibrates if np.isnan(x).all(axis=0).any() else moves)
    likeness = likenesses(x, y, moves)
    number, worth, nearness = np.full(len(f), -1), np.zeros_like(likeness), np.zeros_like(likeness)
    if len(use):
        worth[:, use] = pairing_worth(likeness[:, use], f, g[use], frequency_guard)
        rows, columns = assign_pairs(worth[:, use])
        distance = np.abs(np.log(g[use] / f[:, None])) / frequency_guard
        nearness[:, use] = np.where(distance <= _FARTHEST, 1 / (1 + distance**2), 0.0)
        near = nearness[rows, use[columns]] > 0
        number[rows[near]] = use[columns[near]]
    own = np.where(number >= 0, likeness[np.arange(len(f)), number], 0.0)
    groups = []
    for members in _group_close_modes(f, np.flatnonzero(~np.isnan(x).all(axis=0)).tolist(), closeness):
        model = _extend_group(members, number, likeness, g, closeness)
        told = bool((own[members] >= _TOLD).all())
        shared = ~np.isnan(x[:, members]).any(axis=1)
        small = not told and len(members) <= len(model) <= max(int(shared.sum()) // 2, 1)
        if len(model) > 1 and small:
            like = float(np.cos(subspace_angles(x[np.ix_(shared, members)], y[np.ix_(shared, model)])[-1]) ** 2)
            if like >= least_mac:
                own[members] = like
                groups.append((tuple(members), tuple(model)))
    number = np.where(own < least_mac, -1, number)
    taken = {*number[number >= 0].tolist(), *(k for _, model in groups for k in model)}
    ambiguous = _find_ambiguous(number, likeness, worth, {i for members, _ in groups for i in members}, least_mac)
    inside = (g >= (1 - _BEYOND) * f.min()) & (g <= (1 + _BEYOND) * f.max())
    surplus = tuple(int(k) for k in np.flatnonzero(moves & inside) if int(k) not in taken)
    return Pairing(number, own, likeness, tuple(groups), ambiguous, surplus, nearness)


def _group_close_modes(frequency: FloatArray, modes: list[int], closeness: float) -> list[list[int]]:
    """Groups of the mode indices in `modes`, split where neighbouring frequencies differ by more than `closeness` (relative).

    `frequency` (n_modes,) is ascending, in Hz. A mode without close neighbours is a group of its own.
    """
    groups: list[list[int]] = []
    for k in modes:
        if groups and frequency[k] - frequency[groups[-1][-1]] <= closeness * frequency[k]:
            groups[-1].append(k)
        else:
            groups.append([k])
    return groups


def _extend_group(
    members: list[int], number: IntArray, likeness: FloatArray, frequency: FloatArray, closeness: float
) -> list[int]:
    """Sorted indices of the model modes of a group: the partners of `members`, and unpaired modes close to these.

    The latter need enough MAC with a member. `number` (n_measured,) is the paired model mode or -1, `likeness` the MAC
    (n_measured, n_model), `frequency` (n_model,) that of the model, and `closeness` a relative distance of frequencies.
    """
    chosen = [int(k) for k in number[members] if k >= 0]
    others = set(number.tolist()) - set(chosen)
    part = (likeness[members] >= _PART).any(axis=0)
    for k in np.flatnonzero(part).tolist():
        near = any(abs(frequency[k] - frequency[j]) <= closeness * frequency[j] for j in chosen)
        if near and k not in chosen and k not in others:
            chosen.append(k)
    return sorted(chosen)


def _find_ambiguous(
    number: IntArray, likeness: FloatArray, worth: FloatArray, grouped: set[int], least_mac: float
) -> dict[int, tuple[int, ...]]:
    """Model modes that fit nearly as well as the partner, by measured mode; modes without such rivals are left out.

    `number` (n_measured,) is the paired model mode or -1, `likeness` (MAC) and `worth` are (n_measured, n_model).
    Measured modes in `grouped`, and rivals with a MAC below `least_mac`, do not count.
    """
    ambiguous = {}
    for i, k in enumerate(number.tolist()):
        if k < 0 or i in grouped:
            continue
        good = (worth[i] >= _AS_GOOD * worth[i, k]) & (likeness[i] >= least_mac)
        good[k] = False
        if good.any():
            ambiguous[i] = tuple(np.flatnonzero(good).tolist())
    return ambiguous
