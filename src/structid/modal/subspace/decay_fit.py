"""Free decays by maximum likelihood: poles refined by least squares on all samples, amplitudes eliminated.

    y_c(t) = Re sum_k a_kc exp(s_k t) + e_c(t),   e_c of variance sigma_c^2

Amplitudes are linear and leave the search (variable projection with Kaufman's Jacobian); the sigma_c come from the
residual. Subspace methods give the start, which is several times less accurate: in white noise this estimator reaches
the Cramer-Rao bound, and its covariance is that of the linearized problem.

References
----------
Kaufman (1975), A variable projection method for solving separable nonlinear least squares problems, BIT 15, 49-57;
Golub and Pereyra (2003), Separable nonlinear least squares, Inverse Problems 19, R1-R26.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from structid.core.arrays import ComplexArray, FloatArray
from structid.inversion.eliminated_problem import EliminatedProblem, NormalEquations, minimize_eliminated
from structid.inversion.linearization import solve_upper
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.modal.correlations import ScaledMotion, displacement_rows
from structid.modal.modal_record import ModalRecord, by_frequency
from structid.modal.poles.poles import frequency_damping_slope

#: Steps are those of Gauss-Newton while they gain; converged where a step promises this decrease of the whitened sum of squares.
_SEARCH = LevenbergMarquardt(
    max_iterations=50, step_tolerance=1e-13, initial_damping=1e-12, largest_step=10.0, acceleration=0.0
)
_CONVERGED = 1e-10
_SHOWN = 1.0  # exponent of the fastest decay that tells free motion from motion kept up
_FASTEST = 1.0  # nepers a sample: a faster decay is one sample
_FAR = 0.05  # of its size: a pole that moves further has left its mode
_GROWTH = 20.0  # exponent that a growing pole may reach
_ROUNDING = 1e-10  # residual, as a part of the rms, below which there is no noise to average


@dataclass(frozen=True, eq=False)
class DecayFit:
    """Free decays fitted to every sample.

    Attributes
    ----------
    poles : (n_modes,) complex array
        rad/s.
    amplitudes : tuple of (n_modes, n_channels) complex arrays
        a_k of every record at its first sample, in the scaled unit of `ScaledMotion`.
    pole_covariance : (2 n_modes, 2 n_modes) float array
        Covariance of all Re s, then all Im s, of the poles, 1/s^2.
    slopes : tuple of (2 n_modes, n_modes, n_channels) complex arrays
        Derivative of the amplitudes by Re s and Im s.
    amplitude_covariance : tuple of (n_modes, 2, 2) float arrays
        Covariance of (Re a, Im a) of each mode and record at known poles, for noise sigma_c of 1.
    noise : (n_channels, n_modes) float array
        sigma_c as the residual shows it around each mode's frequency, scaled.
    """

    poles: ComplexArray
    amplitudes: tuple[ComplexArray, ...]
    pole_covariance: FloatArray
    slopes: tuple[ComplexArray, ...]
    amplitude_covariance: tuple[FloatArray, ...]
    noise: FloatArray


@dataclass(frozen=True, eq=False)
class _RecordAtPoles:
    """One record at given poles, its amplitudes eliminated."""

    basis: FloatArray  # (n_times, 2 n_modes), orthonormal
    triangle: FloatArray  # of the basis [Re E, Im E], E = exp(s t)
    coefficients: FloatArray  # (2 n_modes, n_channels), of the basis
    residual: FloatArray  # (n_times, n_channels)
    outside: FloatArray  # (n_times, 2 n_modes): t [Re E, Im E] without its part in the basis
    along: FloatArray  # (2 n_modes, 2 n_modes): that part, in the basis

    @property
    def inside(self) -> FloatArray:
        """Coefficients (2 n_modes, 2 n_modes) of the part of t [Re E, Im E] that is a sum of [Re E, Im E]."""
        return solve_upper(self.triangle, self.along)


def decay_fit(data: ScaledMotion, start: ComplexArray) -> DecayFit | None:
    """Maximum-likelihood fit of free decays with common poles to all records; None if it does not converge.

    Parameters
    ----------
    data : ScaledMotion
        Free decays.
    start : (n_modes,) complex array
        Poles of a subspace method, rad/s, in the upper half plane.

    Returns
    -------
    DecayFit or None
        Poles (rad/s) with their covariance, and amplitudes (n_modes, n_channels) of each record at its first sample.
        None where the records hold no noise, or the search ends without a minimum or with two poles merged.

    Notes
    -----
    Cost of one step: 24 N n^2 for N samples and n modes, and 4 N n m for m channels.
    """
    first = _project_records(data, start)
    sigma = _noise(first)
    if (sigma < _ROUNDING).any():
        return None
    poles = start
    for _ in range(2):  # the second time with the noise of the first
        minimum = _minimum(data, poles, sigma)
        if minimum is None:
            return None
        poles, parts = minimum
        sigma = _noise(parts)
    return _with_covariance(data, poles, parts)


def energy_fractions(data: ScaledMotion, poles: ComplexArray) -> FloatArray:
    """Energy of each mode's fitted decay over that of all records, (n_modes,), channels scaled to equal power.

    `data` has the records, `poles` (n_modes,) are in rad/s; decays of all modes are fitted together. Fractions need not
    add up to 1.
    """
    n, energy = len(poles), np.zeros(len(poles))
    for p in _project_records(data, poles):
        gram = p.triangle.T @ p.triangle
        for k in range(n):
            amplitudes = p.coefficients[[k, n + k]]
            energy[k] += np.sum(amplitudes * (gram[np.ix_([k, n + k], [k, n + k])] @ amplitudes))
    return energy / sum(float(np.sum(y**2)) for y in data.series)


def strength(data: ScaledMotion, poles: ComplexArray) -> FloatArray:
    """Wald's F statistic of the amplitudes of each mode with `poles` (rad/s), (n_modes,); about 1 for mere noise.

    Amplitudes of all modes are fitted to all records together; the noise of a channel is its residual. A statistic has
    two degrees of freedom for each channel and record.
    """
    parts = _project_records(data, poles)
    sigma, n = _noise(parts), len(poles)
    statistic = np.zeros(n)
    for p in parts:
        gram, scaled = _inverse_gram(p), p.coefficients / sigma
        for k in range(n):
            amplitudes = scaled[[k, n + k]]
            statistic[k] += np.sum(amplitudes * linalg.solve(gram[np.ix_([k, n + k], [k, n + k])], amplitudes))
    return statistic / (2 * len(sigma) * len(parts))


def stands_out(data: ScaledMotion, poles: ComplexArray) -> NDArray[np.bool_]:
    """Mask (n_modes,) of the modes of a free decay whose `strength` is above that of noise; `poles` in rad/s.

    Poles that a method has chosen to follow the noise reach a `strength` of some 1 + 5 / sqrt(n) for n series; the limit is
    1 + 9 / sqrt(n).
    """
    return np.asarray(strength(data, poles) > noise_strength(data))


def noise_strength(data: ScaledMotion) -> float:
    """The `strength` that poles fitted to noise do not reach: 1 + 9 / sqrt(n) for n series, channels times records."""
    return float(1 + 9 / np.sqrt(len(data.series) * data.n_channels))


def schwarz(data: ScaledMotion, poles: ComplexArray) -> float:
    """Schwarz's (1978) information criterion of a free decay with `poles` (rad/s); the lowest value marks the best set.

    It is twice the negative log-likelihood of white noise of unknown size in each channel, plus the logarithm of the
    number of values for each real number in poles and amplitudes.
    """
    n_samples = sum(len(y) for y in data.series)
    unknowns = 2 * len(poles) * (1 + len(data.series) * data.n_channels)
    misfit = 2 * n_samples * float(np.sum(np.log(_noise(_project_records(data, poles)))))
    return float(misfit + unknowns * np.log(n_samples * data.n_channels))


def left_over(data: ScaledMotion, poles: ComplexArray, candidates: ComplexArray) -> FloatArray:
    """F statistic of the amplitudes of each of `candidates` if it alone is added to `poles`, (n_candidates,).

    It is about 1 for noise. Poles and candidates are in rad/s. `poles` stay as they are, with their amplitudes fitted
    anew; the noise is that left with `poles` alone.
    """
    parts = _project_records(data, poles)
    sigma = _noise(parts)
    statistic = np.zeros(len(candidates))
    for p in parts:
        time = np.arange(len(p.residual)) / data.sampling_rate
        for k, s in enumerate(candidates):
            motion = np.exp(s * (time - (time[-1] if s.real > 0 else 0.0)))
            basis = np.stack([motion.real, motion.imag], axis=1)
            q = np.linalg.qr(basis - p.basis @ (p.basis.T @ basis))[0]
            statistic[k] += np.sum(np.square(q.T @ (p.residual / sigma)))
    return statistic / (2 * len(sigma) * len(parts))


def is_left_over(data: ScaledMotion, poles: ComplexArray, candidates: ComplexArray) -> bool:
    """True if at least one of `candidates` (rad/s), added to `poles`, would exceed `noise_strength`."""
    return bool((left_over(data, poles, candidates) > noise_strength(data)).any())


def is_near(poles: ComplexArray, start: ComplexArray) -> bool:
    """True if each of `poles` (rad/s) is within 5 % of the magnitude of the pole of `start` that it was refined from."""
    return bool((np.abs(poles - start) <= _FAR * np.abs(start)).all())


def _project_records(data: ScaledMotion, poles: ComplexArray) -> list[_RecordAtPoles]:
    """Projection of each record onto the decays of `poles` (rad/s): coefficients, residual and bases, one item each.

    The basis is [Re E, Im E], (n_times, 2 n_modes), with E = exp(s t), t from 0 at the first sample of the record.
    """
    projections = []
    for y in data.series:
        time = np.arange(len(y))[:, None] / data.sampling_rate
        motion = np.exp(poles * time)
        basis = np.concatenate([motion.real, motion.imag], axis=1)
        q, triangle = np.linalg.qr(basis)
        along = q.T @ y
        slope = time * basis
        part = q.T @ slope
        projections.append(
            _RecordAtPoles(
                q,
                triangle,
                solve_upper(triangle, along),
                y - q @ along,
                slope - q @ part,
                part,
            )
        )
    return projections


def _inverse_gram(part: _RecordAtPoles) -> FloatArray:
    """Covariance of the coefficients for unit noise, (2 n_modes, 2 n_modes)."""
    inverse = solve_upper(part.triangle, np.eye(len(part.triangle)))
    return np.asarray(inverse @ inverse.T)


def _noise(parts: Sequence[_RecordAtPoles]) -> FloatArray:
    """Standard deviation of the residual of each channel over all records, (n_channels,), by degrees of freedom."""
    freedom = sum(max(p.residual.shape[0] - len(p.triangle), 1) for p in parts)
    return np.asarray(np.sqrt(sum(np.sum(p.residual**2, axis=0) for p in parts) / freedom))


def _directions(coefficients: FloatArray) -> FloatArray:
    """Coefficients S_i of t times the decays in the fit's derivative by Re s, then Im s, (2 n, 2 n, n_channels).

    `coefficients` (2 n, n_channels) are alpha, then beta, of n modes; axes are unknown, basis function, channel. With
    a = alpha - i beta, d/d Re s of alpha Re E + beta Im E is t (alpha Re E + beta Im E), and d/d Im s is
    t (beta Re E - alpha Im E).
    """
    n = len(coefficients) // 2
    alpha, beta = coefficients[:n], coefficients[n:]
    slopes, mode = np.zeros((2 * n, *coefficients.shape)), np.arange(n)
    slopes[mode, mode], slopes[mode, n + mode] = alpha, beta
    slopes[n + mode, mode], slopes[n + mode, n + mode] = beta, -alpha
    return slopes


def _normal(parts: Sequence[_RecordAtPoles], sigma: FloatArray) -> NormalEquations:
    """Normal equations, in all Re s, then all Im s, of the least-squares problem for the poles s (rad/s).

    They are matrix (2 n, 2 n), gradient (2 n,) of half the sum of squares, and cost of n poles. Residuals are divided
    by `sigma` (n_channels,), the standard deviation of the noise. `parts` are the projections of the records at the
    present poles.
    """
    size = len(parts[0].triangle)
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    for p in parts:
        slopes = _directions(p.coefficients) / sigma
        matrix += (p.outside.T @ p.outside @ slopes).reshape(size, -1) @ slopes.reshape(size, -1).T
        gradient -= slopes.reshape(size, -1) @ (p.outside.T @ (p.residual / sigma)).ravel()
    return NormalEquations(matrix, gradient, _cost(parts, sigma))


def _cost(parts: Sequence[_RecordAtPoles], sigma: FloatArray) -> float:
    """Sum of squares of residuals divided by `sigma` (n_channels,)."""
    return sum(float(np.sum((p.residual / sigma) ** 2)) for p in parts)


def _minimum(
    data: ScaledMotion, start: ComplexArray, sigma: FloatArray
) -> tuple[ComplexArray, list[_RecordAtPoles]] | None:
    """Poles (n_modes,), rad/s, of least squared residual, and the projections there; None without convergence.

    `start` are the poles to begin with, `sigma` (n_channels,) the standard deviation of the noise. None also if a pole of
    `start` does not oscillate, grows or decays too fast.
    """
    n = len(start)

    @lru_cache(maxsize=1)  # a step is tried and taken at the same poles
    def project(changes: bytes) -> tuple[ComplexArray, list[_RecordAtPoles]] | None:
        """Poles (n_modes,), rad/s, after changes from `start`, and the projections of the records onto their decays.

        `changes` are of all Re s, then all Im s (a float array as bytes). None where a pole does not oscillate, decays
        or grows too fast, or the projection is singular.
        """
        parts = np.frombuffer(changes)
        poles = start + parts[:n] + 1j * parts[n:]
        is_fast = -float(poles.real.min()) / data.sampling_rate > _FASTEST
        if (poles.imag <= 0).any() or (poles.real * data.duration > _GROWTH).any() or is_fast:
            return None
        try:
            return poles, _project_records(data, poles)
        except np.linalg.LinAlgError:
            return None

    def cost(changes: FloatArray) -> float:
        projected = project(changes.tobytes())
        return np.inf if projected is None else _cost(projected[1], sigma)

    def normal(changes: FloatArray) -> NormalEquations:
        projected = project(changes.tobytes())
        assert projected is not None  # a search stays where the sum of squares is finite
        return _normal(projected[1], sigma)

    if project(np.zeros(2 * n).tobytes()) is None:
        return None
    n_rows = sum(y.size for y in data.series)
    problem = EliminatedProblem(np.tile(np.abs(start), 2), cost, normal)
    minimum = minimize_eliminated(problem, replace(_SEARCH, gain_tolerance=_CONVERGED / n_rows))
    if minimum is None:
        return None
    changes, has_converged = minimum
    return project(changes.tobytes()) if has_converged else None


def _with_covariance(data: ScaledMotion, poles: ComplexArray, parts: list[_RecordAtPoles]) -> DecayFit | None:
    """Decay fit at its minimum `poles` (rad/s), with covariance from the noise around each mode.

    None if the matrix of the normal equations is singular. `parts` are the projections of the records of `data` at
    these poles, one for each record.
    """
    n = len(poles)
    level = _noise(parts)
    matrix = _normal(parts, level).matrix
    scale = np.sqrt(np.diag(matrix))
    try:
        factors = linalg.cho_factor(matrix / np.outer(scale, scale))
    except np.linalg.LinAlgError:  # two poles in one
        return None
    inverse = linalg.cho_solve(factors, np.eye(2 * n)) / np.outer(scale, scale)
    local = np.sqrt(_local_noise(data, poles, parts, level))
    factor = np.tile(local, 2)
    slopes, spreads, amplitudes = [], [], []
    for p in parts:
        amplitudes.append(p.coefficients[:n] - 1j * p.coefficients[n:])
        # the basis takes up what its own slope holds: coefficients move by -inside S_i
        moved = -(p.inside @ _directions(p.coefficients))
        slopes.append(moved[:, :n] - 1j * moved[:, n:])
        gram, mode = _inverse_gram(p), np.arange(n)
        rows = np.stack([mode, n + mode], axis=1)
        block = gram[rows[:, :, None], rows[:, None, :]]
        spreads.append(block * np.array([[1, -1], [-1, 1]]))  # Im a = -beta
    return DecayFit(
        poles,
        tuple(amplitudes),
        inverse * np.outer(factor, factor),
        tuple(slopes),
        tuple(spreads),
        np.outer(level, local),
    )


def _local_noise(
    data: ScaledMotion, poles: ComplexArray, parts: Sequence[_RecordAtPoles], level: FloatArray
) -> FloatArray:
    """Residual power near each mode's frequency, relative to white noise of standard deviation `level`, (n_modes,).

    `poles` are in rad/s, `parts` the projections of the records, `level` is (n_channels,). The mean over 4 to 16
    Hann-windowed segments per record, half overlapping, and over channels; what the fit removes from white noise is
    corrected for. Peaks narrower than a segment's line are not resolved.
    """
    n_segments = min(max(-(-24 // len(level)), 4), 16)
    power, expected = np.zeros(len(poles)), np.zeros(len(poles))
    for p in parts:
        y = p.residual / level
        n = max(16, len(y) // n_segments)
        time = np.arange(n) / data.sampling_rate
        wave = np.sin(np.pi * (np.arange(n) + 0.5) / n) * np.exp(-1j * np.outer(poles.imag, time))
        for k in range(0, len(y) - n + 1, n // 2):
            power += np.mean(np.abs(wave @ y[k : k + n]) ** 2, axis=1)
            expected += np.sum(np.abs(wave) ** 2, axis=1) - np.sum(np.abs(wave @ p.basis[k : k + n]) ** 2, axis=1)
    return np.asarray(power / expected)


def decay_shapes(fit: DecayFit, scale: FloatArray, merge: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Mode shapes (n_dofs, n_modes) with largest entry 1, and the standard deviations of their real parts.

    Parameters
    ----------
    fit : DecayFit
    scale : (n_channels,) float array
        Unit of each scaled channel.
    merge : (n_dofs, n_channels, n_modes) complex array
        Weights of the channels in the displacement of each degree of freedom.

    Returns
    -------
    (n_dofs, n_modes) complex array
    (n_dofs, n_modes) float array

    Notes
    -----
    Several records have one shape times an amplitude each, b_r: the shape is sum_r conj(b_r) a_r / sum_r |b_r|^2.
    """
    n_modes = len(fit.poles)
    shapes = np.empty((len(merge), n_modes), dtype=np.complex128)
    std = np.empty((len(merge), n_modes))
    factor = np.linalg.cholesky(fit.pole_covariance)
    for k in range(n_modes):
        stack = np.array([a[k] for a in fit.amplitudes])
        weight = np.linalg.svd(stack, full_matrices=False)[0][:, 0].conj()
        to_dofs = merge[:, :, k] * scale
        raw = to_dofs @ (weight @ stack)
        top = int(np.abs(raw).argmax())
        shapes[:, k] = raw / raw[top]
        change = (to_dofs - np.outer(shapes[:, k], to_dofs[top])) / raw[top]
        by_pole = sum(w * (slope[:, k] @ change.T) for w, slope in zip(weight, fit.slopes, strict=True))
        variance = np.sum((factor.T @ by_pole.real) ** 2, axis=0)
        for w, spread in zip(weight, fit.amplitude_covariance, strict=True):
            part = np.stack([(w * change).real, -(w * change).imag])
            variance = variance + np.einsum("idc,ij,jdc,c->d", part, spread[k], part, fit.noise[:, k] ** 2)
        std[:, k] = np.sqrt(variance)
    return shapes, std


def decay_modes(data: ScaledMotion, modes: ModalRecord) -> ModalRecord:
    """Modes of free decays, with those that stand out of the noise refined by maximum likelihood.

    Parameters
    ----------
    data : ScaledMotion
        Records that `modes` come from.
    modes : ModalRecord
        By a subspace method; for refined modes, frequencies, damping ratios, shapes and their covariance are replaced.
        The covariance of refined modes with others becomes 0; it stays as it is if `modes` lack it or `shape_std`.

    Returns
    -------
    ModalRecord
        By rising frequency, without `changes`; `modes` itself if no mode has amplitudes above noise, the search does
        not converge, or a pole moves by more than 5 %.
    """
    poles = modes.poles
    strong = np.flatnonzero(stands_out(data, poles))
    fit = decay_fit(data, poles[strong]) if len(strong) else None
    if fit is None or not is_near(fit.poles, poles[strong]):
        return modes
    s = fit.poles
    _, merge = displacement_rows(data, s)
    shapes, std = decay_shapes(fit, data.scale, merge)
    frequency, ratio = modes.frequency.copy(), modes.damping_ratio.copy()
    all_shapes = np.array(modes.mode_shapes)
    frequency[strong], ratio[strong], all_shapes[:, strong] = np.abs(s) / (2 * np.pi), -s.real / np.abs(s), shapes
    covariance, shape_std = modes.covariance, modes.shape_std
    if covariance is not None and shape_std is not None:
        covariance, shape_std = covariance.copy(), shape_std.copy()
        refined = np.concatenate([strong, modes.n_modes + strong])
        covariance[refined, :], covariance[:, refined] = 0.0, 0.0
        slope = frequency_damping_slope(s)
        covariance[np.ix_(refined, refined)] = slope @ fit.pole_covariance @ slope.T
        shape_std[:, strong] = std
    return by_frequency(
        frequency, ratio, all_shapes, modes.channels, covariance, shape_std,
        warnings=(*modes.warnings, *_shown_decay(data, s)),
        source=f"{modes.source}, refined by maximum likelihood of the free decay",
    )  # fmt: skip


def _shown_decay(data: ScaledMotion, s: ComplexArray) -> tuple[str, ...]:
    """Warning, in a tuple, that the records are too short to show that their motion dies out; () if they do show it.

    They do if the fastest of the poles `s` (rad/s) decays by a factor e within the longest record.
    """
    if float(np.max(-s.real)) * data.duration > _SHOWN:
        return ()
    return (
        f"no mode dies out in {data.duration:.3g} s, and the motion is taken as free: if forces kept it up, standard "
        "deviations are far too small; then measure longer",
    )
