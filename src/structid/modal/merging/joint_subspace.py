"""The joint observability matrix of several set-ups, its poles, and what pieces of the records do to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from structid.arrays import ComplexArray, FloatArray
from structid.errors import InputError
from structid.modal.correlations import Piece
from structid.modal.merging.setup_data import SetupData
from structid.modal.poles import Poles, oscillating, state_poles


@dataclass(frozen=True, eq=False)
class JointSubspace:
    """Covariances of all set-ups with the references, and the decomposition of the references' part.

    Attributes
    ----------
    data : SetupData
    rows : int
        Block rows.
    references : tuple of (rows * n_references, rows * n_references) float arrays
        Block Hankel matrix of the references' own rows, one a set-up.
    others : tuple of (rows * n_others, rows * n_references) float arrays
        That of the other sensors.
    left, singular, right : arrays
        Singular value decomposition of `references` side by side; `right` is (n_setups * n_columns, rank).
    windows : tuple of tuples of Piece
        The pieces of every set-up.
    """

    data: SetupData
    rows: int
    references: tuple[FloatArray, ...]
    others: tuple[FloatArray, ...]
    left: FloatArray
    singular: FloatArray
    right: FloatArray
    windows: tuple[tuple[Piece, ...], ...]

    def part(self, setup: int) -> slice:
        """Rows of `right` that belong to a set-up."""
        width = self.references[0].shape[1]
        return slice(setup * width, (setup + 1) * width)


def joint_subspace(data: SetupData, rows: int, n_pieces: int) -> JointSubspace:
    """`JointSubspace` of lags 1 to 2 rows - 1."""
    shortest = min(len(y) for y in data.series)
    if shortest < 6 * rows:
        raise InputError(
            f"every set-up must hold at least {6 * rows} samples for {rows} block rows, got {shortest}; measure longer,"
            " or lower `block_rows`"
        )
    windows = tuple(_windows(len(y), 2 * rows, n_pieces) for y in data.series)
    matrices = [np.sum(list(_parts(data, rows, j, own)), axis=0) for j, own in enumerate(windows)]
    split = [_split(matrix, rows, data.n_references) for matrix in matrices]
    references, others = tuple(a for a, _ in split), tuple(b for _, b in split)
    left, singular, right = linalg.svd(np.concatenate(references, axis=1), full_matrices=False)
    return JointSubspace(data, rows, references, others, left, singular, right.T, windows)


def _windows(n_times: int, tail: int, n_pieces: int) -> tuple[Piece, ...]:
    edges = np.round(np.linspace(0, n_times - tail, n_pieces + 1)).astype(int)
    length = float(edges[-1])
    return tuple(Piece(0, a, b, (b - a) / length) for a, b in pairwise(edges.tolist()))


def _parts(data: SetupData, rows: int, setup: int, windows: Sequence[Piece]) -> Iterator[FloatArray]:
    """Block Hankel matrix of R_(1 + r + c) with the references, as each piece contributes to it (divisor N - k)."""
    y = data.series[setup]
    past = y[:, : data.n_references]
    for piece in windows:
        stack = []
        for lag in range(1, 2 * rows):
            stop = len(y) - lag if piece is windows[-1] else piece.stop
            stack.append(y[piece.start + lag : stop + lag].T @ past[piece.start : stop] / (len(y) - lag))
        yield np.block([[stack[r + c] for c in range(rows)] for r in range(rows)])


def _split(matrix: FloatArray, rows: int, n_references: int) -> tuple[FloatArray, FloatArray]:
    """Rows of the references, and of the others."""
    blocks = matrix.reshape(rows, -1, matrix.shape[1])
    width = matrix.shape[1]
    return blocks[:, :n_references].reshape(-1, width), blocks[:, n_references:].reshape(-1, width)


def _stacked(reference: FloatArray, others: Sequence[FloatArray], rows: int) -> FloatArray:
    """Block rows of all channels from those of the references and of every set-up's others, (rows, n_channels, n)."""
    n = reference.shape[1]
    return np.concatenate([part.reshape(rows, -1, n) for part in (reference, *others)], axis=1)


@dataclass(frozen=True, eq=False)
class _Model:
    """The model of one order: O = [H_ref V / S; H_j V_j G_j^-1 / S], G_j = V_j' V_j."""

    observability: FloatArray
    gram: tuple[FloatArray, ...]
    mixed: tuple[FloatArray, ...]
    transition: FloatArray
    output: FloatArray


def _model(space: JointSubspace, order: int) -> _Model:
    if not 1 <= order <= len(space.singular):
        raise InputError(f"`orders` must lie from 1 to {len(space.singular)}, got {order}; raise `block_rows`")
    s, gram, mixed = space.singular[:order], [], []
    for j, other in enumerate(space.others):
        v = space.right[space.part(j), :order]
        gram.append(v.T @ v)
        mixed.append(np.linalg.solve(gram[-1], (other @ v).T).T)
    whole = _stacked(space.left[:, :order], [x / s for x in mixed], space.rows)
    n = whole.shape[2]
    up, down = whole[:-1].reshape(-1, n), whole[1:].reshape(-1, n)
    transition = np.linalg.lstsq(up, down, rcond=None)[0]
    return _Model(whole, tuple(gram), tuple(mixed), transition, space.data.scale[:, None] * whole[0])


def joint_poles(space: JointSubspace, order: int) -> Poles:
    """Poles and shapes at all sensors of the model of `order` states."""
    model = _model(space, order)
    return state_poles(model.transition, model.output, space.data.sampling_rate)


def joint_deviations(space: JointSubspace, order: int, chosen: Sequence[int]) -> tuple[ComplexArray, ComplexArray]:
    """First-order changes of poles and shapes by every piece of every set-up, scaled so that their squares add up.

    Parameters
    ----------
    chosen : sequence of int
        Which poles, counted as `joint_poles` does.

    Returns
    -------
    (n_pieces, n_chosen) complex array
        Changes of the continuous poles, rad/s.
    (n_pieces, n_channels, n_chosen) complex array
        Changes of the shapes.

    References
    ----------
    Doehler, Lam and Mevel (2013), Uncertainty quantification for modal parameters from stochastic subspace
    identification on multi-setup measurements, Mech. Syst. Signal Process. 36(2), 562-581.
    """
    model = _model(space, order)
    values, vectors = np.linalg.eig(model.transition)
    duals = np.linalg.inv(vectors)
    index = oscillating(values, space.data.sampling_rate)[list(chosen)]
    up, down = (part.reshape(-1, order) for part in (model.observability[:-1], model.observability[1:]))
    gram, residual = up.T @ up, down - up @ model.transition
    poles, shapes = [], []
    for change in _changes(space, model, order):
        d_up, d_down = change[:-1].reshape(-1, order), change[1:].reshape(-1, order)
        slope = up.T @ (d_down - d_up @ model.transition) + d_up.T @ residual
        coupling = duals @ np.linalg.solve(gram, slope) @ vectors[:, index]
        gaps = values[None, index] - values[:, None]
        weights = np.where(gaps == 0, 0.0, coupling / np.where(gaps == 0, 1.0, gaps))
        moved = space.data.scale[:, None] * (change[0] @ vectors[:, index])
        poles.append(coupling[index, np.arange(len(index))] / values[index] * space.data.sampling_rate)
        shapes.append(moved + model.output @ (vectors @ weights))
    return np.array(poles), np.array(shapes)


def _changes(space: JointSubspace, model: _Model, order: int) -> Iterator[FloatArray]:
    """Changes of the observability matrix by every piece, (rows, n_channels, order) each."""
    for j, windows in enumerate(space.windows):
        factor = np.sqrt(len(windows) / (len(windows) - 1))
        for window, part in zip(windows, _parts(space.data, space.rows, j, windows), strict=True):
            reference, other = _split(part, space.rows, space.data.n_references)
            d_reference = factor * (reference - window.part * space.references[j])
            d_other = factor * (other - window.part * space.others[j])
            yield _observability_change(space, model, j, d_reference, d_other, order)


def _observability_change(
    space: JointSubspace, model: _Model, setup: int, d_reference: FloatArray, d_other: FloatArray, order: int
) -> FloatArray:
    """What a change of one set-up's matrices does to O, the basis of the leading right singular vectors included."""
    u, v, s = space.left, space.right, space.singular
    own, lead = space.part(setup), slice(0, order)
    known = s[lead] > np.finfo(float).eps * len(v) * s[0]
    inside, rest = np.where(known, s[lead], np.inf), s[order:]
    seen = np.where(known, d_reference @ v[own, lead], 0.0)
    turned = np.zeros((len(v), order))
    turned[own] = np.where(known, d_reference.T @ u[:, lead], 0.0)
    toward = v[:, order:].T @ turned + rest[:, None] * (u[:, order:].T @ seen) / inside
    gaps = inside * (1.0 - (rest[:, None] / inside) ** 2)
    weight = np.divide(toward, gaps, out=np.full_like(toward, np.nan), where=gaps > 0)
    dv = (turned - v @ (v.T @ turned)) / inside + v[:, order:] @ weight
    reference = (seen + u[:, order:] @ (rest[:, None] * weight)) / inside
    others = []
    for k, (matrix, gram, mixed) in enumerate(zip(space.others, model.gram, model.mixed, strict=True)):
        part, moved = v[space.part(k), lead], dv[space.part(k)]
        top = matrix @ moved - mixed @ (moved.T @ part + part.T @ moved)
        if k == setup:
            top = top + d_other @ part
        others.append(np.linalg.solve(gram, top.T).T / inside)
    return _stacked(reference, others, space.rows)
