"""First-order covariance of poles and shapes from the spread of the block Hankel matrix over pieces of the record.

Pieces b with parts w_b of all instants contribute G_b to G = sum of G_b; the deviations d_b = G_b - w_b G carry
cov(G) = nb / (nb - 1) sum of vec(d_b) vec(d_b)'. Each is sent through the singular value decomposition, the
shift-invariant transition matrix and its eigenvalues to first order, exactly and without repeating any of them.
For free decays the deviations are what measurement noise does to G.

References
----------
Reynders, Pintelon and De Roeck (2008), Uncertainty bounds on modal parameters obtained from stochastic subspace
identification, Mech. Syst. Signal Process. 22(4), 948-969; Doehler and Mevel (2013), Efficient multi-order
uncertainty computation for stochastic subspace identification, Mech. Syst. Signal Process. 38(2), 346-366.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.modal.correlations import Outputs, Piece
from structid.modal.poles import oscillating
from structid.modal.subspace import Subspace


@dataclass(frozen=True, eq=False)
class Deviations:
    """Changes of G seen through its singular vectors, scaled so that covariances are plain sums over them.

    Attributes
    ----------
    right : (n_changes, n_rows, max_order) float array
        d_b V.
    left : (n_changes, n_columns, max_order) float array
        d_b' U.
    free : bool
        From the noise of a free decay; otherwise from the spread over pieces.
    """

    right: FloatArray
    left: FloatArray
    free: bool = False


def deviations(subspace: Subspace, max_order: int, poles: ComplexArray) -> Deviations | None:
    """The changes that suit the motion; None where the method has no parts, or fewer than two pieces are asked for.

    Parameters
    ----------
    poles : (n_modes,) complex array
        Identified. Motion of which they explain more than half as one free decay is taken for a free decay.
    """
    if subspace.parts is None or len(subspace.windows) < 2:
        return None
    decay, noise = free_decay_fit(subspace.data, poles)
    total = sum(float(np.sum(np.square(y))) for y in subspace.data.series)
    if sum(float(np.sum(np.square(y))) for y in noise) < 0.5 * total:
        return noise_deviations(subspace, max_order, decay, noise, max(len(subspace.windows), 4 * len(poles)))
    return piece_deviations(subspace, max_order)


def piece_deviations(subspace: Subspace, max_order: int) -> Deviations:
    """The deviations d_b of all pieces, for stationary motion."""
    assert subspace.parts is not None
    u, v = subspace.left[:, :max_order], subspace.right[:, :max_order]
    s = subspace.singular[:max_order]
    factor = np.sqrt(len(subspace.windows) / (len(subspace.windows) - 1))
    right, left = [], []
    parts = subspace.parts(subspace.data, subspace.windows)
    for window, part in zip(subspace.windows, parts, strict=True):
        right.append(factor * (part @ v - window.part * u * s))
        left.append(factor * (part.T @ u - window.part * v * s))
    return Deviations(np.array(right), np.array(left))


def noise_deviations(
    subspace: Subspace, max_order: int, decay: Sequence[FloatArray], noise: Sequence[FloatArray], n_changes: int
) -> Deviations:
    """What noise like the residual of a free decay does to G: the residual, shifted in time by various steps.

    Pieces of a decay are no repeats of each other, and what noise does at the end of one the next one undoes.
    """
    assert subspace.parts is not None
    u, v = subspace.left[:, :max_order], subspace.right[:, :max_order]
    whole = _whole_windows(subspace.windows)

    def matrix(series: Sequence[FloatArray]) -> FloatArray:
        assert subspace.parts is not None
        return np.asarray(np.sum(list(subspace.parts(replace(subspace.data, series=tuple(series)), whole)), axis=0))

    clean, right, left = matrix(decay), [], []
    for k in range(n_changes):
        shifts = [round((k + 0.5) * len(y) / n_changes) for y in noise]
        drawn = [y + np.roll(e, shift, axis=0) for y, e, shift in zip(decay, noise, shifts, strict=True)]
        change = (matrix(drawn) - clean) / np.sqrt(n_changes)
        right.append(change @ v)
        left.append(change.T @ u)
    return Deviations(np.array(right), np.array(left), free=True)


def _whole_windows(windows: Sequence[Piece]) -> tuple[Piece, ...]:
    """One window a record instead of several pieces."""
    found = []
    for number in sorted({piece.record for piece in windows}):
        own = [piece for piece in windows if piece.record == number]
        ends = min(p.start for p in own), max(p.stop for p in own)
        found.append(Piece(number, *ends, sum(p.part for p in own)))
    return tuple(found)


def free_decay_fit(data: Outputs, poles: ComplexArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Least-squares free decay with `poles` of every record, and the rest, scaled by its degrees of freedom.

    Returns
    -------
    list of (n_times, n_channels) float arrays
        The decay of each record.
    list of (n_times, n_channels) float arrays
        Records less decay.
    """
    decay, rest = [], []
    for y in data.series:
        time = np.arange(len(y)) / data.sampling_rate
        start = np.where(poles.real > 0, time[-1], 0.0)  # growing poles count back from the end
        motion = np.exp(poles * (time[:, None] - start))
        basis = np.concatenate([motion.real, motion.imag], axis=1)
        basis = basis / np.linalg.norm(basis, axis=0)
        fitted = basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
        decay.append(fitted)
        rest.append((y - fitted) * np.sqrt(len(y) / max(len(y) - basis.shape[1], 1)))
    return decay, rest


def pole_deviations(
    subspace: Subspace, spread: Deviations, order: int, chosen: Sequence[int]
) -> tuple[ComplexArray, ComplexArray]:
    """What each piece's deviation does to poles and shapes of the model of `order` states.

    Parameters
    ----------
    chosen : sequence of int
        Which of its poles, counted as in `poles_of_orders`.

    Returns
    -------
    (n_pieces, n_chosen) complex array
        Changes of the continuous poles, rad/s.
    (n_pieces, n_channels, n_chosen) complex array
        Changes of the shapes C phi, of which the parts along the shapes themselves mean nothing.
    """
    m, u = subspace.data.n_channels, subspace.left[:, :order]
    a, c = subspace.transition(order), subspace.output(order)
    values, vectors = np.linalg.eig(a)
    duals = np.linalg.inv(vectors)
    index = oscillating(values, subspace.data.sampling_rate)[list(chosen)]
    up, down = u[:-m], u[m:]
    gram = up.T @ up
    residual = down - up @ a
    changed_poles, changed_shapes = [], []
    for right, left in zip(spread.right, spread.left, strict=True):
        du = _left_change(subspace, right[:, :order], left[:, :order], order)
        slope = up.T @ (du[m:] - du[:-m] @ a) + du[:-m].T @ residual
        coupling = duals @ np.linalg.solve(gram, slope) @ vectors[:, index]
        change = coupling[index, np.arange(len(index))]
        gaps = values[None, index] - values[:, None]
        weights = np.where(gaps == 0, 0.0, coupling / np.where(gaps == 0, 1.0, gaps))
        shapes = subspace.data.scale[:, None] * (du[:m] @ vectors[:, index])
        changed_shapes.append(shapes + c @ (vectors @ weights))
        changed_poles.append(change / values[index] * subspace.data.sampling_rate)
    return np.array(changed_poles), np.array(changed_shapes)


def _left_change(subspace: Subspace, right: FloatArray, left: FloatArray, order: int) -> FloatArray:
    """First-order change of the leading left singular vectors, as far as it changes the space they span.

    Directions at the level of rounding, which noise-free motion leaves, stay as they are.
    """
    u, s, v = subspace.left, subspace.singular, subspace.right
    known = s[:order] > np.finfo(float).eps * len(u) * s[0]
    inside, rest = np.where(known, s[:order], np.inf), s[order:]
    right = np.where(known, right, 0.0)
    to_rest = u[:, order:].T @ right
    mixed = to_rest + rest[:, None] * (v[:, order:].T @ left) / inside
    gaps = inside * (1.0 - (rest[:, None] / inside) ** 2)
    outside = (right - u @ (u.T @ right)) / inside
    return np.asarray(outside + u[:, order:] @ np.divide(mixed, gaps, out=np.full_like(mixed, np.nan), where=gaps > 0))
