"""Full-field records: many channels brought down to the few motions that they share, and shapes brought back.

The samples W (n_times, n_channels) of a camera or scanner have the rank of the modes that move, plus noise. A basis Q
of that rank, orthonormal over the channels, turns them into a record W Q of few channels with the same poles; a mode
shape psi of it is Q psi at the channels.

References
----------
Halko, Martinsson and Tropp (2011), Finding structure with randomness, SIAM Review 53, 217-288, Algorithm 4.1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.modal.identification import modal_identification
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import unit_largest
from structid.records import TimeRecord
from structid.records.record import Quantity

_AT_ONCE = 1 << 22  # entries of a block of samples
_ROWS = 240  # samples of a block at least
_PIECE = 1 << 16  # numbers whose squares are added up in the precision of the record
_OVERSAMPLING = 5
_WIDE = 8  # columns of a product come in multiples of what a processor multiplies at once
_SMALL = 1e6  # multiply-adds that BLAS does without rearranging its operands first, which costs more than they do
_PROJECTED = 120  # samples of such a product where channels are projected
_SKETCHED = 16  # and where samples are mixed
_NEARLY = 0.1  # how far from orthonormal a basis may be that a second triangle sets right


@dataclass(frozen=True, eq=False)
class SharedMotions:
    """The motions that channels share.

    Attributes
    ----------
    basis : (n_channels, rank) float array
        Orthonormal columns, strongest motion first.
    motions : (n_times, rank) float array
        Samples of each, in the unit of the record.
    left_out : float
        Part of the record's power outside the basis.
    """

    basis: FloatArray
    motions: FloatArray
    left_out: float

    def record(self, sampling_rate: float, quantity: Quantity) -> TimeRecord:
        """The motions as channels 1X+, 2X+, ... of a record, in the unit of `quantity`; `sampling_rate` in Hz."""
        rank = self.motions.shape[1]
        names = tuple(Dof(i + 1, "X") for i in range(rank))
        return TimeRecord(sampling_rate, self.motions, names, (quantity,) * rank)


def sample_blocks(values: NDArray[np.floating]) -> Iterator[tuple[slice, NDArray[np.floating]]]:
    """Iterator over blocks of consecutive rows of `values`, which may be a memory map, as (slice of rows, array).

    A block holds about four million entries, but at least 240 rows; the last one has the rows that are left.
    """
    step = max(_ROWS, _AT_ONCE // max(values.shape[1], 1))
    for start in range(0, len(values), step):
        rows = slice(start, min(start + step, len(values)))
        yield rows, np.asarray(values[rows])


def covariance(values: NDArray[np.floating]) -> FloatArray:
    """Mean of y y' over the samples y of `values`, (n_channels, n_channels), in one pass without subtracting means.

    Products are taken in the precision of `values` and added up in double precision.

    Parameters
    ----------
    values : (n_times, n_channels) float array
        Single or double precision; a memory map is read block by block.
    """
    total = np.zeros((values.shape[1],) * 2)
    for _, block in sample_blocks(values):
        total += block.T @ block
    return total / len(values)


def shared_motions(values: ArrayLike, rank: int = 40, rng: np.random.Generator | None = None) -> SharedMotions:
    """Principal motions that channels share, as far as they exceed white noise; at most `rank` of them.

    Parameters
    ----------
    values : (n_times, n_channels) float array
        Samples of one quantity; single or double precision, a memory map if need be.
    rank : int
        Greatest number to keep. Those whose singular value lies below the largest one of white noise with the power
        that is left out, sigma (sqrt(n) + sqrt(N)) for n channels and N samples, are left out as well.
    rng : numpy.random.Generator, optional
        For the range finder; a fixed seed by default.

    Returns
    -------
    SharedMotions
        Orthonormal `basis` (n_channels, n_kept), strongest motion first, the `motions` (n_times, n_kept) along it, and
        the fraction of the sum of squares that is `left_out`. At least one motion is kept.

    Raises
    ------
    InputError
        If `values` is no table, holds nothing but zeros or values that are not finite, or `rank` does not fit.

    Notes
    -----
    With no more channels than samples, by the eigenvectors of the covariance: n^2 N operations for n channels and N
    samples. With more, by a randomized range finder of about rank + 5 columns: 4 n N (rank + 5)
    operations in two passes over the samples, and no array larger than n (rank + 5) beside them. Products are taken in
    the precision of the record, a few hundred samples or channels at a time, and added up in double precision.
    """
    table = values if isinstance(values, np.ndarray) else np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or not np.issubdtype(table.dtype, np.floating):
        raise InputError(
            f"`values` must be real samples of shape (n_times, n_channels), got {table.dtype} of shape {table.shape}"
        )
    if not 1 <= rank <= min(table.shape):
        raise InputError(
            f"`rank` must lie from 1 to {min(table.shape)} for {table.shape[0]} samples of {table.shape[1]} channels, "
            f"got {rank}"
        )
    if table.shape[1] <= table.shape[0]:
        basis: FloatArray = np.linalg.eigh(covariance(table))[1][:, ::-1][:, :rank]
        gram: FloatArray = np.eye(rank)
    else:
        width = min(-(-(rank + _OVERSAMPLING) // _WIDE) * _WIDE, len(table))
        basis, gram = _nearly_orthonormal(_sketch(table, width, rng or np.random.default_rng(0)))
    motions, power = _project_samples(table, basis)
    if not np.isfinite(power) or power == 0.0:
        words = "only zeros" if power == 0.0 else "NaN or infinite samples"
        raise InputError(f"`values` hold {words}; leave these channels or samples out, or repair the file")
    right = linalg.inv(np.linalg.cholesky(gram).T)  # basis @ right is orthonormal to the last digit
    motions = motions @ right
    _, singular, turn = np.linalg.svd(motions, full_matrices=False)
    rank = _above_noise(singular[:rank], power, table.shape)
    turn = turn[:rank].T
    return SharedMotions(
        basis @ (right @ turn), motions @ turn, max(0.0, 1.0 - float(np.sum(singular[:rank] ** 2)) / power)
    )


def _above_noise(singular: FloatArray, power: float, shape: tuple[int, ...]) -> int:
    """Number of leading `singular` values that exceed those of white noise, at least 1.

    `singular` decreases; `power` is the sum of squares of all samples, `shape` is (n_times, n_channels). The limit is that of
    noise with the power outside the values kept, and is renewed until their number no longer grows.
    """
    kept = 0
    while True:
        rest = max(power - float(np.sum(singular[:kept] ** 2)), (1e-14 * singular[0]) ** 2 * max(shape))
        freedom = max((shape[0] - kept) * (shape[1] - kept), 1)
        edge = np.sqrt(rest / freedom) * (np.sqrt(shape[0]) + np.sqrt(shape[1]))
        above = int(np.sum(singular > edge))
        if above <= kept:
            return max(1, kept)
        kept = above


def _sketch(table: NDArray[np.floating], width: int, rng: np.random.Generator) -> FloatArray:
    """Random combinations of the samples, W' Omega, (n_channels, width), for W = `table` (n_times, n_channels).

    Omega (n_times, width) is standard normal, drawn from `rng`.
    """
    sketch = np.zeros((table.shape[1], width))
    columns = _columns(width, _SKETCHED)
    sums, product = np.empty((2, columns, width), table.dtype)  # made once: memory that is asked for anew is slow
    for taken, block in sample_blocks(table):
        drawn = rng.standard_normal((taken.stop - taken.start, width)).astype(table.dtype)
        for j in range(0, table.shape[1], columns):
            part = sketch[j : j + columns]
            own, one = sums[: len(part)], product[: len(part)]
            np.matmul(block[:_SKETCHED, j : j + columns].T, drawn[:_SKETCHED], out=own)
            for i in range(_SKETCHED, len(block), _SKETCHED):
                own += np.matmul(block[i : i + _SKETCHED, j : j + columns].T, drawn[i : i + _SKETCHED], out=one)
            part += own
    return sketch


def _project_samples(table: NDArray[np.floating], basis: FloatArray) -> tuple[FloatArray, float]:
    """Projected samples W Q, (n_times, rank), and the sum of squares of the samples W.

    `table` (n_times, n_channels) is W and `basis` (n_channels, rank) is Q; rank is the number of its columns.
    """
    short = basis.astype(np.float32) if table.dtype == np.float32 else basis
    rows = max(_PROJECTED, int(_SMALL / basis.size))
    columns = _columns(basis.shape[1], rows)
    motions, power = np.zeros((len(table), basis.shape[1])), 0.0
    product = np.empty((rows, basis.shape[1]), np.result_type(table, short))
    for taken, block in sample_blocks(table):
        for i in range(0, len(block), rows):
            tile = block[i : i + rows]
            power += _square_sum(tile)
            sums = motions[taken.start + i : taken.start + i + len(tile)]
            for j in range(0, table.shape[1], columns):
                sums += np.matmul(tile[:, j : j + columns], short[j : j + columns], out=product[: len(tile)])
    return motions, power


def _columns(width: int, rows: int) -> int:
    """Number of channels in one small matrix product with `rows` samples and `width` vectors: a multiple of 16."""
    return max(16, int(_SMALL / width / rows) // 16 * 16)


def _square_sum(values: NDArray[np.floating]) -> float:
    """Sum of squares; pieces of it are taken in the precision of `values` and added up in double precision."""
    flat = values.ravel()
    return sum(float(np.dot(flat[i : i + _PIECE], flat[i : i + _PIECE])) for i in range(0, flat.size, _PIECE))


def _nearly_orthonormal(sketch: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Basis Q of the column space of `sketch`, with entries of Q'Q within 0.1 of the identity, and Q'Q (width, width).

    Q has the shape of `sketch` (n_channels, width). It is zero, with the identity, if `sketch` is not finite.
    """
    if np.isfinite(sketch).all():
        try:  # Cholesky's triangle instead of QR: one product instead of many passes over the columns
            inverse = linalg.inv(np.linalg.cholesky(sketch.T @ sketch).T)
            basis = sketch @ inverse
            gram = basis.T @ basis
            if np.abs(gram - np.eye(len(gram))).max() <= _NEARLY:
                return basis, gram
        except np.linalg.LinAlgError:
            pass
        return np.asarray(np.linalg.qr(sketch)[0]), np.eye(sketch.shape[1])
    return np.zeros_like(sketch), np.eye(sketch.shape[1])  # the caller names the samples that are not finite


def full_field_modes(
    values: ArrayLike,
    sampling_rate: float,
    channels: Sequence[Dof | str],
    quantity: Quantity = "displacement",
    rank: int = 40,
    method: str | None = None,
    options: ModalOptions | None = None,
) -> ModalIdentification:
    """Modes of a record of very many channels of one quantity, by the few motions that they share.

    Parameters
    ----------
    values : (n_times, n_channels) float array
        Single or double precision; a memory map is read block by block.
    sampling_rate : float
        Hz.
    channels : sequence of Dof or str
        Degree of freedom of each channel.
    quantity : str
        Of all channels.
    rank : int
        Greatest number of principal motions that the modes are sought in; more than the modes that move. Motions that
        do not exceed white noise are left out.
    method : str, optional
        Name of an identification method for time records, ``pencil`` by default.
    options : ModalOptions, optional
        Settings of the identification.

    Returns
    -------
    ModalIdentification
        With shapes at all channels; their standard deviations are None.

    Raises
    ------
    InputError
        If `values` are no finite samples with some motion, `rank` or an option does not fit, or names and channels
        differ in number.
    NoModesError
        If no mode can be relied on.

    Examples
    --------
    >>> t = np.arange(300)[:, None] * 0.05
    >>> places = np.linspace(0.0, np.pi, 2000)
    >>> field = np.exp(-0.02 * t) * (np.cos(2 * t) * np.sin(places) + np.cos(5 * t) * np.sin(2 * places))
    >>> found = full_field_modes(field, 20.0, [f"{i}Z" for i in range(2000)], options=ModalOptions(orders=[4]))
    >>> found.modes.omega.round(3).tolist()
    [2.0, 5.0]
    """
    motions = shared_motions(values, rank)
    if len(channels) != len(motions.basis):
        raise InputError(f"`channels` must name all {len(motions.basis)} channels, got {len(channels)} names")
    found = modal_identification(motions.record(sampling_rate, quantity), method, options)
    return at_all_channels(found, motions, parse_dofs(channels))


def at_all_channels(
    identification: ModalIdentification, motions: SharedMotions, channels: tuple[Dof, ...]
) -> ModalIdentification:
    """`identification` of `motions.record` with its shapes expanded to all `channels`, largest entry 1.

    `channels` are the rows of `motions.basis`. The result has no `shape_std` and no `changes`.
    """
    modes, rank = identification.modes, motions.basis.shape[1]
    words = f"{len(channels)} channels by {rank} shared motions, which leave out {100 * motions.left_out:.2g} % of the power"
    shapes = unit_largest(motions.basis @ modes.mode_shapes)
    source = f"{modes.source}; {words}"
    return replace(
        identification,
        modes=replace(modes, mode_shapes=shapes, channels=channels, shape_std=None, changes=None, source=source),
    )
