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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from structid.core.arrays import ComplexArray, FloatArray
from structid.modal.correlations import RecordPiece, ScaledMotion
from structid.modal.poles.poles import oscillating
from structid.modal.subspace.kernel import Subspace

_PEAK = 4.0  # peak over median of the residual's spectrum from which motion counts as forced
_STILL = 1e-9  # of a channel's root mean square: nothing but rounding
_BATCH = 2.0  # memories of the slowest mode in a batch
_LEAST_FREEDOM = 4.0  # degrees of freedom of a damping ratio in a record of two memories or fewer
_HARDLY = 0.2  # of the power of a few sums of channels: less than it, and a decay does not explain half of all
_SUMS, _CHUNK = 4, 256  # sums of channels, and samples of a chunk of theirs
_OVERFLOW = 300.0  # exponent of a growing pole


@dataclass(frozen=True, eq=False)
class SingularVectorChanges:
    """Changes d_b of the subspace matrix G = U S V', seen through its singular vectors; covariances are sums over b.

    With V_n and U_n the leading `max_order` vectors:

    Attributes
    ----------
    right : (n_changes, rank, max_order) float array
        U' d_b V_n.
    left : (n_changes, rank, max_order) float array
        V' d_b' U_n.
    outside : (n_changes, n_rows, max_order) float array, or None
        d_b V_n less its part along U; None where U is square and leaves none.
    """

    right: FloatArray
    left: FloatArray
    outside: FloatArray | None = None

    @classmethod
    def seen(cls, subspace: Subspace, changes: Iterable[tuple[FloatArray, FloatArray]]) -> SingularVectorChanges:
        """Changes d_b of the matrix U S V' of `subspace`, reduced to their products with its singular vectors.

        `changes` yields pairs d_b V_n, (n_rows, max_order), and d_b' U_n, (n_columns, max_order), one after another,
        with V_n and U_n the leading `max_order` vectors. The result has U' d_b V_n, V' d_b' U_n and the part of d_b V_n
        outside of U (None if U has as many columns as rows), with b as first axis.
        """
        u, v = subspace.left, subspace.right
        right, left, outside = [], [], []
        for moved, turned in changes:
            right.append(u.T @ moved)
            left.append(v.T @ turned)
            if u.shape[0] > u.shape[1]:
                outside.append(moved - u @ right[-1])
        return cls(np.array(right), np.array(left), np.array(outside) if outside else None)


@dataclass(frozen=True, eq=False)
class FreeDecay:
    """Records taken as one free decay each.

    Attributes
    ----------
    decay, rest : lists of (n_times, n_channels) float arrays
        The least-squares decay of every record, and the rest, scaled by its degrees of freedom; empty where decays explain
        hardly anything.
    explains_most : bool
        Whether less than half of the power of the records is left.
    explains_all : bool
        Whether, besides, no peaks are left around the modes: what ambient forces add in the course of the record gathers
        there, while sensors' noise does not. Around each mode, the spectrum of the rest must stay below four times its
        median.
    """

    decay: list[FloatArray]
    rest: list[FloatArray]
    explains_most: bool
    explains_all: bool


def free_decay(data: ScaledMotion, poles: ComplexArray) -> FreeDecay:
    """Records split into the least-squares free decay with `poles` (rad/s) and the residual, and what it explains.

    The split is left out (empty lists) if a quick estimate finds less than 20 % of the power explained. The decay
    explains most if less than half of the power is left; it explains all if, in addition, the smoothed spectrum of the
    residual at the poles is at most 4 times its median. The residual is scaled up for the degrees of freedom that the
    fit takes.
    """
    if _decay_fraction(data, poles) < _HARDLY:
        return FreeDecay([], [], explains_most=False, explains_all=False)
    decay, rest = [], []
    for y in data.series:
        time = np.arange(len(y)) / data.sampling_rate
        start = np.where(poles.real > 0, time[-1], 0.0)  # growing poles count back from the end
        motion = np.exp(poles * (time[:, None] - start))
        basis = np.concatenate([motion.real, motion.imag], axis=1)
        basis = basis / np.linalg.norm(basis, axis=0)
        q = np.linalg.qr(basis)[0]
        fitted = q @ (q.T @ y)
        decay.append(fitted)
        rest.append((y - fitted) * np.sqrt(len(y) / max(len(y) - basis.shape[1], 1)))
    left, total = (sum(float(np.sum(np.square(y))) for y in part) for part in (rest, data.series))
    if left >= 0.5 * total:
        return FreeDecay(decay, rest, explains_most=False, explains_all=False)
    still = (_peak(y, data.sampling_rate, poles) <= _PEAK for y in rest if np.abs(y).max() > _STILL)
    return FreeDecay(decay, rest, explains_most=True, explains_all=all(still))


def _decay_fraction(data: ScaledMotion, poles: ComplexArray) -> float:
    """Fraction (0 to 1) of the records' power that free decays with `poles` (rad/s) explain, estimated from a few channel sums.

    Normal equations are used, whose matrix is a geometric series. 1 where a pole grows so fast that it would overflow, or the
    records are zero.
    """
    if (poles.real * data.duration > _OVERFLOW).any():
        return 1.0
    step, signs = 1 / data.sampling_rate, np.random.default_rng(0).choice([-1.0, 1.0], (data.n_channels, _SUMS))
    both = np.concatenate([poles, poles.conj()])
    explained = total = 0.0
    for y in data.series:
        sums, n = y @ signs, len(y)
        start = np.where(both.real > 0, (n - 1) * step, 0.0)
        exponent = (both.conj()[:, None] + both) * step
        series = np.where(exponent == 0, n, np.expm1(n * exponent) / np.where(exponent == 0, 1.0, np.expm1(exponent)))
        gram = series * np.exp(-((both * start).conj()[:, None] + both * start))
        length = min(_CHUNK, n)
        chunks = np.concatenate([sums, np.zeros((-n % length, _SUMS))]).reshape(-1, length, _SUMS)
        within = np.exp(poles.conj() * (np.arange(length) * step)[:, None])
        ahead = np.exp(poles.conj() * (np.arange(len(chunks))[:, None] * length * step - start[: len(poles)]))
        stacked = chunks.transpose(1, 0, 2).reshape(length, -1)
        inside = within.real.T @ stacked + 1j * (within.imag.T @ stacked)
        along = np.einsum("kp,pks->ps", ahead, inside.reshape(len(poles), len(chunks), _SUMS))
        along = np.concatenate([along, along.conj()])
        size = np.sqrt(np.diag(gram).real)
        fit = np.linalg.lstsq(gram / size[:, None] / size, along / size[:, None], rcond=1e-10)[0]
        explained += float(np.sum((along / size[:, None]).conj() * fit).real)
        total += float(np.sum(sums**2))
    return explained / total if total > 0 else 1.0


def _peak(y: FloatArray, sampling_rate: float, poles: ComplexArray) -> float:
    """Greatest spectral level, smoothed over 1/16 of the lines, at frequencies of `poles` (rad/s) over the median.

    `y` are the samples (n_times, n_channels), `sampling_rate` in Hz. Spectra are taken under a sine window, channels
    scaled to equal power, and averaged over channels. 0 where the median is 0.
    """
    n = len(y)
    size = np.sqrt(np.mean(y**2, axis=0))
    window = np.sin(np.pi * (np.arange(n) + 0.5) / n)[:, None]
    lines = np.mean(np.abs(np.fft.rfft(window * y / np.where(size > 0, size, 1.0), axis=0)) ** 2, axis=1)
    width = 2 * max(2, n // 64) + 1
    smooth = np.convolve(lines, np.ones(width) / width, "same")
    level = np.median(lines)
    density = np.interp(poles.imag / (2 * np.pi), np.fft.rfftfreq(n, 1 / sampling_rate), smooth)
    return float(density.max(initial=0.0) / level) if level > 0 else 0.0


def deviations(subspace: Subspace, max_order: int, motion: FreeDecay, n_modes: int) -> SingularVectorChanges | None:
    """Deviations of the subspace matrix: by noise if `motion` is a free decay throughout, else by windows of the records.

    None if there are fewer than two windows, or the method gives no parts of the matrix. `n_modes` sets the least
    number of noise deviations, 4 `n_modes`. `max_order` is the number of singular vectors that count.
    """
    if len(subspace.windows) < 2 or subspace.parts is None:
        return None
    if not motion.explains_all:
        return piece_deviations(subspace, max_order)
    return noise_deviations(subspace, max_order, motion, max(len(subspace.windows), 4 * n_modes))


def piece_deviations(subspace: Subspace, max_order: int) -> SingularVectorChanges:
    """Deviation of each window's part of the subspace matrix from its share of the whole, for stationary motion.

    Deviations are reduced to their products with the singular vectors, (n_windows, rank, max_order): U' d V_n and V' d'
    U_n with the leading `max_order` right and left vectors V_n and U_n, and the part of d V_n outside of U. The sum
    over windows of squared deviations is the variance of the whole.
    """
    assert subspace.parts is not None
    u, v = subspace.left[:, :max_order], subspace.right[:, :max_order]
    s = subspace.singular[:max_order]
    factor = np.sqrt(len(subspace.windows) / (len(subspace.windows) - 1))
    parts = zip(subspace.windows, subspace.parts(subspace.data, subspace.windows), strict=True)
    return SingularVectorChanges.seen(
        subspace,
        (
            (factor * (part @ v - window.part * u * s), factor * (part.T @ u - window.part * v * s))
            for window, part in parts
        ),
    )


def overlapping_batches(
    ds: ComplexArray, dshape: ComplexArray, piece: float, memory: float
) -> tuple[ComplexArray, ComplexArray]:
    """Scaled sums of L neighbouring changes of poles and shapes, whose covariance includes correlation between pieces.

    Pieces short against the memory of a mode are no independent repeats. L is the least number of pieces that are together as
    long as two memories, but at most an eighth of all pieces; runs of L overlap. Standard deviations are scaled so that 1.96
    of them are the 95 % interval of Student's t with 1.5 n / L degrees of freedom for n pieces.

    Parameters
    ----------
    ds : (n_pieces, n_modes) complex array
        Changes of poles by each piece.
    dshape : (n_pieces, n_channels, n_modes) complex array
        Changes of shapes by each piece.
    piece : float
        Duration of a piece, s.
    memory : float
        Of the slowest mode, 1 / (zeta omega), s.

    Returns
    -------
    (n_pieces - L + 1, n_modes) complex array
    (n_pieces - L + 1, n_channels, n_modes) complex array
        The arguments themselves if L is 1.

    References
    ----------
    Meketon and Schmeiser (1984), Overlapping batch means: something for nothing?, Proc. Winter Simul. Conf., 226-230.
    """
    n = len(ds)
    size = _batch_size(n, piece, memory)
    if size == 1:
        return ds, dshape
    scale = np.sqrt(n * (n - 1) / (size * (n - size + 1) * (n - size)))
    scale *= float(special.stdtrit(1.5 * n / size, 0.975) / special.ndtri(0.975))

    def sums(changes: ComplexArray) -> ComplexArray:
        total = np.concatenate([np.zeros_like(changes[:1]), np.cumsum(changes, axis=0)])
        return scale * (total[size:] - total[:-size])

    return sums(ds), sums(dshape)


def _batch_size(n_pieces: int, piece: float, memory: float) -> int:
    """Number of pieces of `piece` s in a batch of at least two memories of the slowest mode; at most an eighth of `n_pieces`.

    `memory` is in s; the result is at least 1.
    """
    return int(np.clip(np.ceil(_BATCH * memory / piece), 1, max(1, n_pieces // 8)))


def frequency_widening(poles: ComplexArray, seconds: float, n_pieces: int, memory: float) -> FloatArray:
    """Factors, 1 or more, on standard deviations of frequencies, since these rest on an uncertain damping; (n_modes,).

    In T seconds a frequency f with damping ratio zeta has a variance of f zeta / (2 pi T) at least, and zeta has one of
    zeta / (2 pi f T). A variance stated with the damping found thus has a relative variance of 1 / (T zeta omega), that
    of 2 T zeta omega degrees of freedom (4 at least). Where batches of the record would have more, 1.96 standard
    deviations become the 95 % interval of Student's t with these. Damping ratios err together with their own standard
    deviation, and are not widened.

    Parameters
    ----------
    poles : (n_modes,) complex array
        rad/s.
    seconds : float
        Duration of all records together.
    n_pieces : int
        Number of pieces.
    memory : float
        1 / (zeta omega) of the slowest mode, s; a batch of pieces is two memories long, which `overlapping_batches` has
        accounted for.

    References
    ----------
    Au (2014), Uncertainty law in ambient modal identification, part I: theory, Mech. Syst. Signal Process. 48, 15-33.
    """
    size = _batch_size(n_pieces, seconds / n_pieces, memory)
    batches = 1.5 * n_pieces / size if size > 1 else np.inf
    damping = np.maximum(2 * seconds * np.maximum(-poles.real, 0.0), _LEAST_FREEDOM)
    return np.asarray(special.stdtrit(np.minimum(batches, damping), 0.975) / special.stdtrit(batches, 0.975))


def noise_deviations(subspace: Subspace, max_order: int, motion: FreeDecay, n_changes: int) -> SingularVectorChanges:
    """Deviations of the subspace matrix by noise, `n_changes` in number, from shifted residuals of a free decay.

    The residual of each record is shifted cyclically and added to its fitted decay, both of which `motion` has;
    deviations are over the square root of `n_changes`, so that the sum of squares is the variance. Pieces of a decay
    cannot serve, since they are no repeats of each other. The result has products of deviations with the leading
    `max_order` singular vectors.
    """
    assert subspace.parts is not None
    u, v = subspace.left[:, :max_order], subspace.right[:, :max_order]
    whole = _whole_windows(subspace.windows)

    def matrix(series: Sequence[FloatArray]) -> FloatArray:
        assert subspace.parts is not None
        return np.asarray(np.sum(list(subspace.parts(replace(subspace.data, series=tuple(series)), whole)), axis=0))

    clean = matrix(motion.decay)

    def changes() -> Iterator[tuple[FloatArray, FloatArray]]:
        """Products of each deviation D of the matrix: D V (n_rows, max_order), then D' U (n_columns, max_order).

        D is over the square root of `n_changes`, so that squares of the products sum to variances.
        """
        for k in range(n_changes):
            noise = [np.roll(e, round((k + 0.5) / n_changes * len(e)), axis=0) for e in motion.rest]
            drawn = [y + e for y, e in zip(motion.decay, noise, strict=True)]
            change = (matrix(drawn) - clean) / np.sqrt(n_changes)
            yield change @ v, change.T @ u

    return SingularVectorChanges.seen(subspace, changes())


def _whole_windows(windows: Sequence[RecordPiece]) -> tuple[RecordPiece, ...]:
    """Windows that join all of `windows` of each record, one for each record, by record number; gaps are covered."""
    joined = []
    for number in sorted({piece.record for piece in windows}):
        pieces = [piece for piece in windows if piece.record == number]
        ends = min(p.start for p in pieces), max(p.stop for p in pieces)
        joined.append(RecordPiece(number, *ends, sum(p.part for p in pieces)))
    return tuple(joined)


def pole_deviations(
    subspace: Subspace, spread: SingularVectorChanges, order: int, chosen: Sequence[int]
) -> tuple[ComplexArray, ComplexArray]:
    """Changes of poles (rad/s) and shapes of the model of `order` states by each deviation in `spread`.

    Parameters
    ----------
    subspace : Subspace
    spread : SingularVectorChanges
        Deviations of the matrix of `subspace`, through at least `order` singular vectors.
    order : int
        Number of states.
    chosen : sequence of int
        Indices (from 0) of the poles wanted among those in the upper half plane, sorted by magnitude.

    Returns
    -------
    (n_changes, n_chosen) complex array
        Changes of the continuous poles, rad/s.
    (n_changes, n_channels, n_chosen) complex array
        Changes of the shapes C phi, of which the parts along the shapes themselves mean nothing.
    """
    m, rate = subspace.data.n_channels, subspace.data.sampling_rate
    u, rest = subspace.left[:, :order], subspace.left[:, order:]
    a, c = subspace.transition(order), subspace.output(order)
    values, vectors = np.linalg.eig(a)
    duals = np.linalg.inv(vectors)
    index = oscillating(values, rate)[list(chosen)]
    picked, x = values[index], vectors[:, index]
    up, down = u[:-m], u[m:]
    gram, residual = up.T @ up, down @ x - up @ (x * picked)
    pairs, ahead = zip(spread.right, spread.left, strict=True), _times(rest[:-m].T, residual)
    moved = [_turned(subspace, *pair, order, x, ahead) for pair in pairs]
    dx, missed = (np.array(part) for part in zip(*moved, strict=True))
    dx = _times(rest, dx)  # of the changes of U with the eigenvectors, (n_changes, n_rows, n_chosen)
    if spread.outside is not None:
        beside = spread.outside[:, :, :order] / _inside(subspace, order)
        dx, missed = dx + _times(beside, x), missed + _times(beside[:, :-m].transpose(0, 2, 1), residual)
    da = np.linalg.solve(gram, up.T @ (dx[:, m:] - dx[:, :-m] * picked) + missed)
    coupling = duals @ da
    gaps = picked - values[:, None]
    weights = np.where(gaps == 0, 0.0, coupling / np.where(gaps == 0, 1.0, gaps))
    shapes = subspace.data.scale[:, None] * dx[:, :m] + c @ (vectors @ weights)
    return np.asarray(coupling[:, index, np.arange(len(index))] / picked * rate), np.asarray(shapes)


def _times(matrix: FloatArray, x: ComplexArray) -> ComplexArray:
    """Real `matrix` (..., n, m) times complex `x` (..., m, k), without a complex copy of the matrix."""
    return np.asarray(matrix @ x.real + 1j * (matrix @ x.imag))


def _inside(subspace: Subspace, order: int) -> FloatArray:
    """Leading `order` singular values, infinite at the level of rounding, as of noise-free motion, whose vectors stay unchanged."""
    s = subspace.singular
    return np.where(s[:order] > np.finfo(float).eps * len(subspace.left) * s[0], s[:order], np.inf)


def _turned(
    subspace: Subspace, right: FloatArray, left: FloatArray, order: int, x: ComplexArray, y: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Products T x (rank - order, k) and T' y (order, k), T the turn of the leading left singular vectors to the rest.

    T (rank - order, order) is the turn by one change of the matrix of `subspace`, to first order; `right` and `left`
    (rank, max_order) are that change's products with singular vectors as in `SingularVectorChanges`. `x` is (order, k),
    `y` (rank - order, k). NaN where singular values coincide.
    """
    inside, rest = _inside(subspace, order), subspace.singular[order:, None]
    mixed = np.where(np.isinf(inside), 0.0, right[order:, :order]) + rest * left[order:, :order] / inside
    gaps = inside * (1.0 - (rest / inside) ** 2)
    turn = np.divide(mixed, gaps, out=np.full_like(mixed, np.nan), where=gaps > 0)
    return _times(turn, x), _times(turn.T, y)
