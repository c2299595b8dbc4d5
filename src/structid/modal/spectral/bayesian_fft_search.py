"""Most probable modes of one band, and the covariance of their posterior distribution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from structid.core.arrays import FloatArray
from structid.modal.spectral.bayesian_fft_likelihood import (
    BandLines,
    BandModes,
    Chart,
    chart,
    coordinates,
    gradient,
    modes_at,
    negative_log_likelihood,
    transfer,
)

_DAMPING = (0.003, 0.01, 0.03)
_DAMPING_LIMITS = (1e-5, 0.5)
_SEARCH_LINES = 200
_SEARCHES = 2
_SEARCH_STEPS = 20
_STEPS = 40
_DECREMENT = 1e-8
_STEP = 1e-4  # of coordinates of order 1, for differences of gradients


@dataclass(frozen=True, eq=False)
class Posterior:
    """Modes of a band and how well its data determine them.

    Attributes
    ----------
    modes : BandModes
        Most probable.
    covariance : (2 m, 2 m) float array
        Of all frequencies (Hz), then all damping ratios; NaN where the data do not determine them.
    shape_covariance : (m, n_channels, n_channels) float array
        Of each shape of unit norm; singular along the shape itself, which the norm fixes.
    converged : bool
        Whether a last Newton step would change no coordinate by 1e-4 of its standard deviation.
    """

    modes: BandModes
    covariance: FloatArray
    shape_covariance: FloatArray
    converged: bool


def posterior(data: BandLines, places: Sequence[float]) -> Posterior:
    """Most probable modes near `places` (Hz, one for each mode) and their posterior covariance.

    The search has several starts, and uses part of the lines and the directions in which the band has most power; the best
    result is refined with all lines and channels.
    """
    every = max(1, len(data.frequency) // _SEARCH_LINES)
    kept = min(data.n_channels, 2 * len(places) + 2)
    basis = np.linalg.eigh((data.lines.T @ data.lines.conj()).real)[1][:, ::-1][:, :kept]
    part = replace(data, frequency=data.frequency[::every], lines=data.lines[::every] @ basis)
    likely = sorted(starts(part, places), key=lambda modes: negative_log_likelihood(part, modes))[
        : min(len(places), _SEARCHES)
    ]
    searched = [_newton(part, modes, _SEARCH_STEPS)[0].centre for modes in likely]
    best = min(searched, key=lambda modes: negative_log_likelihood(part, modes))
    return _refine_posterior(data, replace(best, shapes=basis @ best.shapes))


def _newton(data: BandLines, modes: BandModes, n_steps: int) -> tuple[Chart, float, FloatArray]:
    """Chart at the minimum that Newton's method reaches, the decrease still expected there, and the Hessian.

    At most `n_steps` are taken. The decrease is that of twice the negative log-likelihood (Newton's decrement). The Hessian
    (size, size) is NaN where the steps did not suffice or it is not finite.
    """
    place = chart(modes)
    unknown = np.full((place.size,) * 2, np.nan)
    decrement = np.inf
    for _ in range(n_steps):
        x = coordinates(place)
        value, slope = gradient(data, place, x)
        curvature = hessian(data, place, x)
        if not np.isfinite(curvature).all():
            return place, decrement, unknown
        values, vectors = np.linalg.eigh(curvature)
        along = vectors.T @ slope
        size = np.maximum(np.abs(values), 1e-9 * np.abs(values).max())
        decrement = float(np.sum(along**2 / size))
        if decrement < _DECREMENT:
            return place, decrement, curvature
        step = -vectors @ (along / size)
        step = _shorten_step(data, place, x, step)
        while not gradient(data, place, x + step)[0] < value:
            step = 0.5 * step
            if np.abs(step).max() < 1e-9:
                return place, decrement, curvature
        place = chart(modes_at(place, x + step))
    return place, decrement, unknown


def _shorten_step(data: BandLines, chart: Chart, x: FloatArray, step: FloatArray) -> FloatArray:
    """Step (size,) shortened to at most 1 in every coordinate, with frequencies and damping ratios inside `_limits`.

    `x` (size,) are the coordinates at which `step` begins.
    """
    step = step / max(1.0, float(np.abs(step).max()))
    m = chart.centre.n_modes
    low, high = _limits(data, chart.centre)
    step[: 2 * m] = np.clip(x[: 2 * m] + step[: 2 * m], low, high) - x[: 2 * m]
    return np.asarray(step)


def _limits(data: BandLines, start: BandModes) -> tuple[FloatArray, FloatArray]:
    """Least and greatest coordinates of frequencies, then damping ratios, in the search, (2 m,) each.

    Frequencies stay within the lines of the band, damping ratios from 1e-5 to 0.5; the coordinate 0 of `start` is always
    allowed.
    """
    zeta = start.damping_ratio
    ends = [np.log(f / start.frequency) / zeta for f in (data.frequency.min(), data.frequency.max())]
    ratios = [np.log(limit / zeta) for limit in _DAMPING_LIMITS]
    low, high = (np.concatenate(pair) for pair in zip(ends, ratios, strict=True))
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


def _refine_posterior(data: BandLines, modes: BandModes) -> Posterior:
    """Posterior of the modes: Newton's method from the near start `modes`, and covariance from the inverse Hessian."""
    place, decrement, curvature = _newton(data, modes, _STEPS)
    modes = place.centre
    n, m = modes.shapes.shape
    inverse = _inverse(curvature)
    if inverse is None:
        return Posterior(modes, np.full((2 * m,) * 2, np.nan), np.full((m, n, n), np.nan), decrement < _DECREMENT)
    size = np.concatenate([modes.frequency * modes.damping_ratio, modes.damping_ratio])
    shapes = np.empty((m, n, n))
    for r, tangent in enumerate(place.tangents):
        own = slice(2 * m + r * (n - 1), 2 * m + (r + 1) * (n - 1))
        shapes[r] = tangent @ inverse[own, own] @ tangent.T
    covariance = size[:, None] * inverse[: 2 * m, : 2 * m] * size
    return Posterior(modes, covariance, shapes, decrement < _DECREMENT)


def hessian(data: BandLines, chart: Chart, x: FloatArray) -> FloatArray:
    """Hessian of the negative log-likelihood at coordinates `x`, by differences of its gradient; (size, size)."""
    rows = []
    for e in np.eye(len(x)) * _STEP:
        rows.append((gradient(data, chart, x + e)[1] - gradient(data, chart, x - e)[1]) / (2 * _STEP))
    return np.asarray((np.array(rows) + np.array(rows).T) / 2)


def _inverse(curvature: FloatArray) -> FloatArray | None:
    """Inverse of the symmetric matrix `curvature`; None if it is not positive definite within numerical accuracy."""
    if not np.isfinite(curvature).all():
        return None
    values, vectors = np.linalg.eigh(curvature)
    if values[0] <= 1e-7 * values[-1] * _STEP:
        return None
    return np.asarray((vectors / values) @ vectors.T)


def starts(data: BandLines, places: Sequence[float]) -> list[BandModes]:
    """Starting points for the search for modes near `places` (Hz): one for each choice of shapes.

    Shapes come from the lines near each place, and from principal directions of all lines in several orders; the damping ratio
    of each is the likeliest of 0.003, 0.01 and 0.03.
    """
    m, n = len(places), data.n_channels
    whole = np.linalg.eigh((data.lines.T @ data.lines.conj()).real)[1][:, ::-1]
    basis = whole[:, : min(m, n)]
    basis = basis[:, np.arange(m) % basis.shape[1]]
    turned = basis + np.roll(basis, 1, axis=1) * np.array([1.0 if r % 2 else -1.0 for r in range(m)])
    turned = turned / np.maximum(np.linalg.norm(turned, axis=0), 1e-12)
    choices = [_local_shapes(data, places)]
    for shapes in (basis, turned) if min(m, n) > 1 else (basis,):
        orders = list(permutations(range(m))) if m <= 3 else [tuple(range(m))]
        choices += [shapes[:, list(order)] for order in orders]
    found = []
    for shapes in choices:
        rough = [_rough(data, places, [zeta] * m, shapes) for zeta in _DAMPING]
        found.append(min(rough, key=lambda modes: negative_log_likelihood(data, modes)))
    return found


def _local_shapes(data: BandLines, places: Sequence[float]) -> FloatArray:
    """Shapes (n_channels, n_places), principal directions of the lines nearest each place (Hz), kept distinct if possible."""
    shapes: list[FloatArray] = []
    width = max(5, len(data.frequency) // (4 * len(places)))
    for f in places:
        near = data.lines[np.argsort(np.abs(data.frequency - f))[:width]]
        vectors = np.linalg.eigh((near.T @ near.conj()).real)[1][:, ::-1]
        free = [v for v in vectors.T if all((v @ s) ** 2 < 0.9 for s in shapes)]
        shapes.append(free[0] if free else vectors[:, 0])
    return np.stack(shapes, axis=1)


def _rough(data: BandLines, places: Sequence[float], zetas: Sequence[float], shapes: FloatArray) -> BandModes:
    """Modes at frequencies `places` (Hz) with damping ratios `zetas` and `shapes`, and rough force and noise densities.

    Frequencies that coincide are moved apart a little; `shapes` is (n_channels, n_modes).
    """
    m, n = len(places), data.n_channels
    frequency = np.array(places, dtype=float)
    for r in range(1, m):  # modes that begin alike stay alike
        frequency[r] = max(frequency[r], frequency[r - 1] * (1 + 0.2 * zetas[r]))
    values = np.linalg.eigvalsh((data.lines.T @ data.lines.conj()).real / len(data.lines))
    power = np.sort(np.sum(np.abs(data.lines) ** 2, axis=1))
    noise = float(np.mean(values[: n - m])) if n > m else float(power[len(power) // 10]) / (10 * n)
    noise = max(noise, 1e-12 * float(values[-1]))
    modes = BandModes(frequency, np.array(zetas, dtype=float), shapes, np.eye(m, dtype=complex), noise)
    h = transfer(data, modes)[0]
    seen = np.mean(np.abs(data.lines @ shapes) ** 2, axis=0)
    return replace(modes, force=np.diag(np.maximum(seen, noise) / np.mean(np.abs(h) ** 2, axis=0) / m).astype(complex))
