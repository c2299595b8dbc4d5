"""Receptances at s = decay + i omega, right of the axis where they are measured: smooth, with their error.

The receptance H(s) of a stable structure is analytic for Re s > 0. Its values there follow from FRFs on the axis by the
Poisson integral, and from time histories that start at rest by a transform with a decaying factor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.errors import InputError
from structid.records.record import DERIVATIVES, FrfKind, FrfRecord

#: Share of |H| that an error may reach before the value counts for nothing.
LARGEST_ERROR = 0.25
#: Error that is never undercut in the weight of a value.
SMALLEST_ERROR = 0.02
_CHUNK_ENTRIES = 4_000_000
_LINES_A_DECAY = 2.0
_MEANS_A_DECAY = 8
_FEWEST_MEANS = 250


def right_half_plane(record: FrfRecord, frequency: ArrayLike, decay: ArrayLike) -> FrfRecord:
    """FRFs at s = decay + i omega by the Poisson integral over the lines of `record`, with their error as variance.

    H(s) = (1/pi) integral of decay / (decay^2 + (omega - nu)^2) H(i nu) d nu, with H(-i nu) = conj H(i nu): an average
    with a Lorentzian weight, which reduces noise too. It is formed of receptance, mobility and accelerance, each
    converted to the record's kind by powers of s, and at each line the result with the smallest error is taken:
    receptance loses least at the end of the band, and accelerance alone is bounded at 0 Hz where a structure is free.
    Transmissibility counts as accelerance. Beyond the last line receptance and mobility count as 0, accelerance, which
    tends to a real limit, as its mean near the end.

    Parameters
    ----------
    record : FrfRecord
        FRFs on the imaginary axis, or with the same `decay` at every line; lines may be unevenly spaced.
    frequency : (n_lines,) array
        omega / 2 pi of the new lines, Hz, increasing.
    decay : (n_lines,) array
        Decay of the new lines, 1/s, above that of the record.

    Returns
    -------
    FrfRecord
        FRFs with `decay` set. `variance` is E|error|^2: that of the noise, plus the error of a finite number of lines,
        estimated from the part of the kernel beyond either end of the band and from the difference to every second
        line; the error is at least 2 % of the value (`SMALLEST_ERROR`). Lines where no channel has a relative error
        below 25 % (`LARGEST_ERROR`) are left out; single values above it get a standard deviation of 100 times the
        error, or of 100 times the value if that is larger.

    Raises
    ------
    InputError
        If the record has several decays or fewer than 8 lines, a decay is not above the record's, or no line is left
        because the lines are too coarse or the band too short.

    Notes
    -----
    Real receptances only: a constant loss factor makes a structure that moves before it is struck, and the integral
    is then off by about the loss factor.

    References
    ----------
    Shin and Cha (2009), Geophysical Journal International 177, 1067-1079: inversion in the Laplace-Fourier domain.
    """
    lines, depth = np.atleast_1d(np.asarray(frequency, float)), np.atleast_1d(np.asarray(decay, float))
    record_decay = 0.0 if record.decay is None else float(record.decay[0])
    if record.decay is not None and np.ptp(record.decay) > 0:
        raise InputError("`record` must have one decay for all lines, got several; give what was measured")
    if lines.shape != depth.shape or not (depth > record_decay).all():
        raise InputError(
            f"`decay` must hold one value above {record_decay:g} 1/s a line, got {depth.shape} for {lines.shape} lines"
        )
    used = record.lines(np.flatnonzero(record.frequency > 0)) if record.frequency[0] == 0 else record
    if len(used.frequency) < 8:
        raise InputError(f"the Poisson integral needs at least 8 lines, got {len(used.frequency)}")
    values, variance = _smooth_best_kind(used, depth + 2j * np.pi * lines, record_decay)
    size = np.abs(values)
    error = np.maximum(np.sqrt(variance), SMALLEST_ERROR * size)
    poor = error > LARGEST_ERROR * size
    keep = np.flatnonzero(~poor.all(axis=(1, 2)))
    if not keep.size:
        raise InputError(
            f"no line of {lines[0]:g}-{lines[-1]:g} Hz has an error below {100 * LARGEST_ERROR:.0f} % after the Poisson integral:"
            " `decay` is too small for the spacing of the lines, or the band too short; give finer lines or a larger decay"
        )
    error = np.where(poor, 100 * np.maximum(error, size), error)
    return replace(
        record,
        frequency=lines[keep],
        values=values[keep],
        variance=np.square(error[keep]),
        coherence=None,
        averages=None,
        noise_source="declared",
        decay=depth[keep],
        relative=None,
        sizes=None,
    )


def _smooth_best_kind(record: FrfRecord, laplace: ComplexArray, std: float) -> tuple[ComplexArray, FloatArray]:
    """Poisson integrals in the record's kind and E|error|^2, (n_lines, n_outputs, n_inputs) each.

    Each value comes from receptance, mobility or accelerance, whichever has the least error. `laplace` (n_lines,) holds
    s = decay + i omega in 1/s; `std` is the decay of the record itself in 1/s.
    """
    if record.is_per_motion:  # as accelerance, it is bounded at 0 and tends to a real limit
        record = replace(record, kind="accelerance")
    relative = laplace - std
    values = np.zeros((len(laplace), *record.values.shape[1:]), dtype=np.complex128)
    variance = np.full(values.shape, np.inf)
    kinds: tuple[FrfKind, ...] = ("receptance", "mobility", "accelerance")
    ratio = float((relative.real / np.abs(relative)).min())
    measured = [
        [_average_lines(record.lines(lines).as_kind(kind), ratio) for lines in _subsets(record)] for kind in kinds
    ]
    step = max(1, _CHUNK_ENTRIES // len(measured[0][0].frequency))
    for first in range(0, len(laplace), step):
        part = slice(first, first + step)
        weights = [poisson_weights(thinned.omega, relative[part]) for thinned in measured[0]]
        for kind, records in zip(kinds, measured, strict=True):
            power = laplace[part] ** float(DERIVATIVES[record.kind] - DERIVATIVES[kind])
            smoothed, error = _integrate(records, relative[part], weights)
            smoothed, error = smoothed * power[:, None, None], error * (np.abs(power) ** 2)[:, None, None]
            better = error < variance[part]
            values[part] = np.where(better, smoothed, values[part])
            variance[part] = np.where(better, error, variance[part])
    return values, variance


def _subsets(record: FrfRecord) -> tuple[IntArray, IntArray, IntArray]:
    """Indices (n,) of all lines, of the even and of the odd lines; results of the latter show the error of the spacing."""
    every = np.arange(len(record.frequency))
    return every, every[::2], every[1::2]


def _average_lines(record: FrfRecord, ratio: float) -> FrfRecord:
    """`record` averaged over groups of neighbouring lines much narrower than the decay, for a faster Poisson integral.

    `ratio` is the smallest ratio of decay to |s| among the new lines. A group spans 1/8 of it in ln omega, or 1/250 if that is
    less; the variance of its mean is that of independent errors.
    """
    per_unit = max(_MEANS_A_DECAY / ratio, _FEWEST_MEANS)
    stretch = np.floor(per_unit * np.log(record.omega / record.omega[0]))
    first = np.flatnonzero(np.concatenate([[True], np.diff(stretch) > 0]))
    count = np.diff(np.append(first, len(stretch)))

    def mean(values: np.ndarray) -> np.ndarray:
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.asarray(np.add.reduceat(values, first, axis=0) / count.reshape(shape))

    return replace(
        record,
        frequency=mean(record.frequency),
        values=mean(record.values),
        variance=None if record.variance is None else mean(record.variance) / count[:, None, None],
        coherence=None,
        decay=None if record.decay is None else record.decay[first],
        relative=None,
        sizes=None,
    )


def _integrate(
    records: list[FrfRecord], laplace: ComplexArray, weights: list[tuple[FloatArray, FloatArray]]
) -> tuple[ComplexArray, FloatArray]:
    """Poisson integrals of the FRFs of the first record at `laplace` (n,), and E|error|^2, (n, n_outputs, n_inputs) each.

    Parameters
    ----------
    records : list of FrfRecord
        The first from all lines of a record, the others from its even and its odd lines: their differences are the error of the
        spacing. Noise and the part of the kernel beyond the band count as errors too.
    laplace : (n,) complex array
        Points s in 1/s, with the real part counted from the line on which the FRFs are: the decay less that of the record.
    weights : list of (forward, backward)
        For each record the weights (n, n_lines) of its FRFs and of their conjugates, by `poisson_weights`.
    """
    record = records[0]
    shape = (len(laplace), *record.values.shape[1:])
    flats = [item.values.reshape(len(item.frequency), -1) for item in records]
    flat = flats[0]
    sums = [w[0] @ part + w[1] @ np.conj(part) for w, part in zip(weights, flats, strict=True)]
    error = np.zeros(sums[0].shape)
    for other in sums[1:]:
        error += np.abs(other - sums[0]) ** 2
    below, above = _kernel_outside(record.omega, laplace)
    last = flat[record.omega > 0.8 * record.omega[-1]]
    limit = np.mean(last.real, axis=0) * (record.kind == "accelerance")
    sums[0] = sums[0] + above[:, None] * limit
    error += (2 * below[:, None] * np.abs(flat[0])) ** 2
    error += above[:, None] ** 2 * np.mean(np.abs(last) ** 2, axis=0)
    if record.variance is not None:
        error += (weights[0][0] ** 2 + weights[0][1] ** 2) @ record.variance.reshape(len(flat), -1)
    return sums[0].reshape(shape), error.reshape(shape)


def _kernel_outside(omega: FloatArray, laplace: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Fractions of the Poisson kernel at `laplace` (n,) below the first and above the last line of `omega`, (n,) each.

    `omega` is in rad/s; mirror images at negative frequencies are included.
    """

    def reach(end: float) -> FloatArray:
        """The fraction of the kernel between -end and end, (n,)."""
        return np.asarray(
            (np.arctan((end - laplace.imag) / laplace.real) + np.arctan((end + laplace.imag) / laplace.real)) / np.pi
        )

    return reach(float(omega[0])), 1 - reach(float(omega[-1]))


def poisson_weights(omega: FloatArray, laplace: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Quadrature weights of the Poisson integral on the lines `omega` and on their mirror images at -`omega`.

    H(s_i) is forward[i] @ H + backward[i] @ conj(H). If the decay is at least twice the spacing of the lines near omega,
    and omega above twice the first line, the trapezoidal rule is used, with an error of the order
    exp(-2 pi decay / spacing); otherwise H is interpolated linearly between lines and the kernel integrated exactly.
    Beyond the last line H counts as 0; below the first it is interpolated to its mirror image.

    Parameters
    ----------
    omega : (n_lines,) float array
        Angular frequencies in rad/s, positive and increasing.
    laplace : (n_points,) complex array
        Points s in 1/s, real parts positive.

    Returns
    -------
    forward, backward : (n_points, n_lines) float arrays
    """
    nodes = np.concatenate([-omega[::-1], omega])
    spacing = np.diff(nodes)
    count = len(omega)
    weights = np.empty((len(laplace), len(nodes)))
    width = 0.5 * (np.append(spacing, 0.0) + np.insert(spacing, 0, 0.0))
    near = np.interp(np.abs(laplace.imag), nodes, width)
    fine = (laplace.real >= _LINES_A_DECAY * near) & (laplace.imag > 2 * omega[0])
    weights[fine] = _trapezoid(nodes, width, laplace[fine])
    weights[~fine] = _exact_weights(nodes, spacing, laplace[~fine])
    return weights[:, count:], weights[:, count - 1 :: -1]


def _trapezoid(nodes: FloatArray, width: FloatArray, laplace: ComplexArray) -> FloatArray:
    """Trapezoidal weights of the Poisson kernel at each of `laplace`, (n_laplace, n_nodes).

    `nodes` (n_nodes,) are frequencies in rad/s, negative ones included, and `width` (n_nodes,) their widths; `laplace`
    (n_laplace,) are s = decay + i omega, 1/s.
    """
    kernel = nodes - laplace.imag[:, None]
    kernel *= kernel
    kernel += np.square(laplace.real)[:, None]
    np.divide(width, kernel, out=kernel)
    kernel *= (laplace.real / np.pi)[:, None]
    return kernel


def _exact_weights(nodes: FloatArray, spacing: FloatArray, laplace: ComplexArray) -> FloatArray:
    """Integrals of the Poisson kernel times the hat function of each node, (n_laplace, n_nodes).

    `nodes` are frequencies in rad/s, and `spacing` (n_nodes - 1,) the differences between neighbours. `laplace`
    (n_laplace,) are s = decay + i omega, 1/s.
    """
    depth = laplace.real[:, None]
    away = (nodes - laplace.imag[:, None]) / depth
    zeroth = np.arctan(away) / np.pi
    first = depth * np.log1p(away**2) / (2 * np.pi)
    mass = np.diff(zeroth, axis=1)
    moment = np.diff(first, axis=1) - depth * away[:, :-1] * mass
    rising = moment / spacing
    weights = np.zeros(away.shape)
    weights[:, 1:] = rising
    weights[:, :-1] += mass - rising
    return weights
