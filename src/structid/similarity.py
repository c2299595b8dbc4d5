"""Similarity of mode shapes (MAC, COMAC, ECOMAC, orthogonality, angles) and of responses (FRAC, FDAC), and modes paired by it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from structid.core.arrays import FloatArray, IntArray, require_finite
from structid.core.errors import InputError

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


def mac(first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """Modal assurance criterion |x_i^H y_j|^2 / (x_i^H x_i  y_j^H y_j) of every pair of columns.

    1 where two shapes agree up to a factor, real or complex; 0 where they are orthogonal.

    Parameters
    ----------
    first : (n_channels, n_first) array, real or complex
        Mode shapes as columns; a single shape may be (n_channels,). Unknown entries are NaN, and each pair is compared at
        the channels where both are known.
    second : (n_channels, n_second) array, optional
        Further mode shapes; by default `first` is compared with itself.

    Returns
    -------
    (n_first, n_second) float array
        NaN where two shapes have no known entry in common.

    Raises
    ------
    InputError
        If the channels differ in number, or a shape is zero throughout.

    References
    ----------
    Allemang and Brown (1982), A correlation coefficient for modal vector analysis, Proc. 1st IMAC.

    Examples
    --------
    >>> mac([1.0, 2.0], [2.0, 4.0]).item()
    1.0
    """
    x, y = _check_channels(first, second)
    known_x, known_y = (~np.isnan(z) for z in (x, y))
    x, y = np.where(known_x, x, 0.0), np.where(known_y, y, 0.0)
    for name, shapes, known in (("first", x, known_x), ("second", y, known_y)):
        energies(name, np.where(known.any(axis=0), shapes, 1.0))
    cross = np.abs(x.conj().T @ y) ** 2
    energy = ((np.abs(x) ** 2).T @ known_y) * (known_x.T @ (np.abs(y) ** 2))
    shared = known_x.T.astype(float) @ known_y
    return np.where(shared > 0, np.divide(cross, energy, out=np.zeros_like(cross), where=energy > 0), np.nan)


def comac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Coordinate modal assurance criterion (COMAC) of each channel: `mac` along the modes of paired shapes.

    COMAC_c = |sum_r x_cr^* y_cr|^2 / (sum_r |x_cr|^2  sum_r |y_cr|^2), after each shape is scaled to unit norm and y rotated to
    the phase of x: 1 for a channel that agrees in every mode up to a common factor. A channel with reversed sign keeps
    its COMAC; see `ecomac`.

    Parameters
    ----------
    first, second : (n_channels, n_modes) arrays, real or complex
        Mode shapes; column r of `first` is paired with column r of `second`. Unknown entries are NaN and left out.

    Returns
    -------
    (n_channels,) float array
        NaN where a channel moves in no mode of one of the sets, or is unknown in all.

    Raises
    ------
    InputError
        If the shapes differ in size, or a column is zero throughout.

    References
    ----------
    Lieven and Ewins (1988), Spatial correlation of mode shapes, the COMAC, Proc. 6th IMAC; Allemang (2003), The modal
    assurance criterion: twenty years of use and abuse, Sound and Vibration 37(8), 14-23.
    """
    x, y, _ = _paired_columns(first, second)
    cross = np.abs(np.sum(x.conj() * y, axis=1)) ** 2
    energy = np.sum(np.abs(x) ** 2, axis=1) * np.sum(np.abs(y) ** 2, axis=1)
    return np.divide(cross, energy, out=np.full(len(x), np.nan), where=energy > 0)


def ecomac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Enhanced COMAC of each channel: mean distance of the paired shapes, sum_r |x_cr - y_cr| / (2 n_modes).

    Each shape is scaled to a mean square of 1 over its known channels and y rotated to the phase of x: 0 for a channel that
    agrees in every mode, large if its sense, gain or position is wrong.

    Parameters
    ----------
    first, second : (n_channels, n_modes) arrays, real or complex
        Mode shapes; column r of `first` is paired with column r of `second`. Unknown entries are NaN and left out.

    Returns
    -------
    (n_channels,) float array
        NaN where a channel is unknown in all modes.

    Raises
    ------
    InputError
        If the shapes differ in size, or a column is zero throughout.

    References
    ----------
    Hunt (1992), Application of an enhanced coordinate modal assurance criterion, Proc. 10th IMAC; Allemang (2003).
    """
    x, y, known = _paired_columns(first, second)
    distance = np.sum(np.abs(x - y) * np.sqrt(known.sum(axis=0)), axis=1)
    count = 2.0 * known.sum(axis=1)
    return np.divide(distance, count, out=np.full(len(x), np.nan), where=count > 0)


def orthogonality(mass: ArrayLike, first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """Mass orthogonality |x_i^H M y_j| / sqrt(x_i^H M x_i  y_j^H M y_j) of every pair of columns: 0 if orthogonal, 1 if equal.

    By the usual rule, off-diagonal entries of a measured set with itself stay below 0.1 (self-orthogonality), and those of
    pairs of measured and modelled shapes are above 0.9 (cross-orthogonality).

    Parameters
    ----------
    mass : (n_channels, n_channels) array
        Mass matrix reduced to the channels; see `structid.compare.mode_correlation`.
    first : (n_channels, n_first) array, real or complex
        Mode shapes as columns.
    second : (n_channels, n_second) array, optional
        Further mode shapes; by default `first` is compared with itself.

    Returns
    -------
    (n_first, n_second) float array

    Raises
    ------
    InputError
        If sizes differ, an entry is NaN, or a shape has no mass.

    References
    ----------
    Ewins (2000), Modal Testing, 2nd ed., section 5.5; NASA-STD-5002 (1996) for the limits.
    """
    x, y = _require_complete(first, second)
    m = np.asarray(mass, dtype=np.float64)
    if m.shape != (len(x), len(x)):
        raise InputError(f"`mass` must be ({len(x)}, {len(x)}) like the channels, got shape {m.shape}")
    sizes = [np.einsum("cm,cd,dm->m", z.conj(), m, z).real for z in (x, y)]
    if min(size.min() for size in sizes) <= 0:
        raise InputError("a shape has no mass at the channels; leave it out, or measure places that have")
    return np.asarray(np.abs(x.conj().T @ m @ y) / np.sqrt(np.outer(*sizes)))


def most_real(shapes: ArrayLike) -> FloatArray:
    """Real parts of complex shapes (n_channels, n_modes), each rotated first to the phase that makes it as real as possible.

    Unknown entries (NaN) stay NaN; real shapes are returned as they are.
    """
    given = np.asarray(shapes)
    return np.asarray((given * real_turn(given)).real if np.iscomplexobj(given) else given)


def real_turn(shapes: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Unit phase factor of each shape that makes it as real as possible, (n_modes,); `shapes` is (n_channels, n_modes)."""
    turn: NDArray[np.inexact] = np.exp(-0.5j * np.angle(np.nansum(shapes**2, axis=0)))
    return turn


def subspace_angles(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Principal angles between the spans of two sets of shapes, rad, smallest first.

    The measure for close or repeated modes, whose single shapes are not determined though their span is.

    Parameters
    ----------
    first, second : (n_channels, n_first) and (n_channels, n_second) arrays, real or complex
        Columns span the two subspaces.

    Returns
    -------
    (min(n_first, n_second),) float array
        0 to pi/2; all zero where one span holds the other.

    References
    ----------
    Knyazev and Argentati (2002), SIAM J. Sci. Comput. 23(6), 2009-2041.
    """
    x, y = _require_complete(first, second)
    angles: FloatArray = linalg.subspace_angles(x, y)[::-1]
    return angles


def _as_columns(name: str, values: ArrayLike) -> NDArray[np.inexact]:
    """`values` as a float or complex array (n_channels, n_shapes), from an array of this shape or (n_channels,).

    `InputError`, naming `name`, for other shapes, an empty array or infinite entries; NaN is allowed.
    """
    array = np.asarray(values)
    if not np.issubdtype(array.dtype, np.inexact):
        array = array.astype(np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"`{name}` must be (n_channels, n_shapes), got shape {np.shape(values)}; one shape a column")
    require_finite(name, np.where(np.isnan(array), 0.0, array))
    return array


def _paired_columns(
    first: ArrayLike, second: ArrayLike
) -> tuple[NDArray[np.inexact], NDArray[np.inexact], NDArray[np.bool_]]:
    """Two sets of shapes with columns of unit norm, the second in phase with the first, and a mask of common entries.

    The mask is True where an entry is known in both. All are (n_channels, n_shapes). Entries that are NaN in either
    set become 0, so that a pair without a common entry is all 0. `InputError` if the sets differ in size or a
    column is zero throughout.
    """
    x, y = _as_columns("first", first), _as_columns("second", second)
    if x.shape != y.shape:
        raise InputError(f"`first` and `second` must have one shape, got {x.shape} and {y.shape}; pair them first")
    known = ~(np.isnan(x) | np.isnan(y))
    x, y = np.where(known, x, 0.0), np.where(known, y, 0.0)
    shared = known.any(axis=0)
    x = x / np.sqrt(energies("first", np.where(shared, x, 1.0)))
    y = y / np.sqrt(energies("second", np.where(shared, y, 1.0)))
    product = np.sum(y.conj() * x, axis=0)
    size = np.abs(product)
    return x, y * np.where(size > 0, product / np.where(size > 0, size, 1.0), 1.0), known


def _check_channels(first: ArrayLike, second: ArrayLike | None) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """Both sets of shapes as arrays (n_channels, n_shapes) after a check of their channels; `first` twice if `second` is None.

    `InputError` if the numbers of channels differ.
    """
    x = _as_columns("first", first)
    y = x if second is None else _as_columns("second", second)
    if x.shape[0] != y.shape[0]:
        raise InputError(
            f"`first` and `second` must have the same channels, got {x.shape[0]} and {y.shape[0]}; "
            "bring them to common sensors first"
        )
    return x, y


def _require_complete(first: ArrayLike, second: ArrayLike | None) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """Both sets of shapes as arrays (n_channels, n_shapes); `first` twice if `second` is None.

    `InputError` if an entry is NaN or infinite, or the numbers of channels differ.
    """
    x, y = _check_channels(first, second)
    hint = "leave out shapes, or channels, with unknown entries"
    require_finite("first", x, hint)
    require_finite("second", y, hint)
    return x, y


def frac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Frequency response assurance criterion (FRAC) of each pair of functions: their `mac` along the frequency axis.

    Parameters
    ----------
    first, second : (n_frequencies, ...) arrays, real or complex
        Response functions at the same frequencies, paired by their position.

    Returns
    -------
    (...) float array
        From 0 to 1. A common factor of a whole function does not lower it, a shift of its peaks does.

    Raises
    ------
    InputError
        If the shapes differ, an entry is not finite, or a function is zero throughout.

    References
    ----------
    Heylen and Lammens (1996), FRAC: a consistent way of comparing frequency response functions.
    """
    x, y = np.asarray(first), np.asarray(second)
    if x.shape != y.shape or x.ndim == 0:
        raise InputError(f"`first` and `second` must have one shape, got {x.shape} and {y.shape}")
    require_finite("first", x)
    require_finite("second", y)
    x, y = x.reshape(len(x), -1), y.reshape(len(y), -1)
    cross = np.abs(np.sum(x.conj() * y, axis=0)) ** 2
    values = cross / (energies("first", x) * energies("second", y))
    return values.reshape(np.shape(first)[1:])


def fdac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Frequency domain assurance criterion (FDAC): `mac` of response shapes under each load at pairs of frequencies.

    FDAC(w, v)_i = |sum_o x_oi(w)^* y_oi(v)|^2 / (sum_o |x_oi(w)|^2  sum_o |y_oi(v)|^2). For a model that is too stiff
    throughout, the ridge of ones lies beside the diagonal.

    Parameters
    ----------
    first : (n_first, n_outputs, n_inputs) array, real or complex
        Response functions, such as measured FRFs.
    second : (n_second, n_outputs, n_inputs) array, real or complex
        Response functions of the same outputs and inputs; the frequencies may differ.

    Returns
    -------
    (n_inputs, n_first, n_second) float array
        From 0 to 1; NaN where nothing responds. For a single output it is 1 everywhere.

    Raises
    ------
    InputError
        If outputs or loads differ in number, or a value is not finite.

    References
    ----------
    Pascual, Golinval and Razeto (1997), A frequency domain correlation technique for model correlation and updating,
    Proc. 15th IMAC.
    """
    x, y = np.asarray(first), np.asarray(second)
    if x.ndim != 3 or y.ndim != 3 or x.shape[1:] != y.shape[1:]:
        raise InputError(
            "`first` and `second` must be (n_frequencies, n_outputs, n_inputs) with the same outputs and inputs, got"
            f" {x.shape} and {y.shape}"
        )
    require_finite("first", x)
    require_finite("second", y)
    cross = np.abs(np.moveaxis(x, 2, 0).conj() @ np.moveaxis(y, 2, 0).transpose(0, 2, 1)) ** 2
    energy = [np.sum(np.abs(z) ** 2, axis=1).T for z in (x, y)]
    size = energy[0][:, :, None] * energy[1][:, None, :]
    return np.divide(cross, size, out=np.full(size.shape, np.nan), where=size > 0)


def energies(name: str, x: NDArray[np.inexact]) -> FloatArray:
    """Sum of squared moduli of each column of `x` (n, n_columns), as (n_columns,); `name` is the argument named in errors.

    Raises
    ------
    InputError
        If a column is zero throughout.
    """
    sums: FloatArray = np.sum(np.abs(x) ** 2, axis=0)
    if (sums == 0).any():
        raise InputError(f"`{name}` is zero throughout in column {int(np.argmin(sums)) + 1}; leave it out")
    return sums


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
        """Indices, from 0, of all model modes that are compared with the measured mode `mode`, also from 0.

        They are several for a mode of a group of close modes, and none if the mode has no counterpart.
        """
        for measured, model in self.groups:
            if mode in measured:
                return model
        return (int(self.number[mode]),) if self.number[mode] >= 0 else ()


def mac_with_model(measured: NDArray[np.inexact], model: NDArray[np.inexact], moves: NDArray[np.bool_]) -> FloatArray:
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

    Measured modes with neighbouring frequencies within `closeness` form a group, compared as a subspace with their
    model modes and other model modes close to these, where single shapes cannot be distinguished.

    Parameters
    ----------
    measured_frequency, model_frequency : (n_measured,) and (n_model,) arrays
        Frequencies in Hz, ascending. Model modes below a thousandth of the lowest measured frequency (rigid bodies) are
        left out.
    measured_shapes, model_shapes : (n_channels, n_measured) and (n_channels, n_model) arrays, real or complex
        Shapes at the same channels. Unknown entries of measured shapes are NaN and left out, in a group for all of its
        modes. A mode without a known entry is paired by frequency alone.
    least_mac : float
        Smallest MAC of a pair; for a group, smallest cos^2 of the largest angle between the subspaces.
    closeness : float
        Relative distance of neighbouring frequencies within which modes are close.
    frequency_guard : float
        Distance |ln(f_model / f_measured)| at which a pair is worth half as much; beyond three times that there is
        none.

    Returns
    -------
    Pairing
        Model mode of each measured mode (from 0; -1 without a pair), groups, rivals that fit nearly as well, and model
        modes in the measured range that are in no pair.

    Raises
    ------
    InputError
        If shapes disagree, or a measured frequency is not above 0.

    References
    ----------
    Allemang (2003), Sound and Vibration 37(8), 14-23; Knyazev and Argentati (2002) for angles between spans;
    Kuhn (1955) for the assignment.
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
    likeness = mac_with_model(x, y, moves)
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
    """Groups of the mode indices in `modes`, split at gaps above the part `closeness` of the higher frequency.

    `frequency` (n_modes,), in Hz, and `modes` are ascending. A mode without close neighbours is a group of its own.
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

    The latter need a MAC of 0.1 or more with a member, and count as close if they are near one that was taken before.
    `number` (n_measured,) is the paired model mode or -1, `likeness` the MAC (n_measured, n_model), `frequency`
    (n_model,) that of the model, and `closeness` a relative distance of frequencies.
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

    A rival has a worth of at least 0.8 of the partner's and a MAC of at least `least_mac`. `number` (n_measured,) is
    the paired model mode or -1, `likeness` (MAC) and `worth` (of a pair) are (n_measured, n_model). Measured modes in
    `grouped` do not count.
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
