"""First-order covariance of refined poles, participation and shapes from the noise of FRFs; scaling of shapes.

With errors e_o of output o, C the inverse of the normal equations and B_o, P_o slope and pseudo-inverse of
`OutputBlock`, the nonlinear unknowns move by C sum of B_o' e_o, and the output's own by P_o e_o - A_o C sum of B' e.

References
----------
Pintelon, Guillaume and Schoukens (2007), Uncertainty calculation in (operational) modal analysis, Mech. Syst. Signal
Process. 21, 2359-2373; White (1980), A heteroskedasticity-consistent covariance matrix estimator, Econometrica 48;
MacKinnon and White (1985), Some heteroskedasticity-consistent covariance matrix estimators with improved finite sample
properties, J. Econom. 29, 305-325 (HC3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.modal.frf.refinement import FrfData, PolesAndParticipation, output_blocks, residuals
from structid.modal.poles.poles import frequency_damping_slope

_WHITE = 4.0  # standard deviations of a sum of correlations of white noise, above which a residual is not white


@dataclass(frozen=True, eq=False)
class FrfModes:
    """Poles, participation and shapes at the minimum, and what is needed for their covariance.

    Attributes
    ----------
    at : PolesAndParticipation
    shapes : (n_outputs, n_modes) complex array
    residuals : (n_lines, n_outputs, n_inputs) complex array
        Weighted data less model.
    covariance : (n_unknowns, n_unknowns) float array
        Covariance of the nonlinear unknowns, in the order of `at.free`.
    through : (n_outputs, 2 n_modes, n_unknowns) float array
        A_o of each output: the negative derivative of its Re phi, then Im phi, by the nonlinear unknowns.
    cross : (n_outputs, 2 n_modes, n_unknowns) float array
        Covariance of P_o e_o, which the errors of the output make of its shape entries alone, with the nonlinear unknowns.
    own : (n_outputs, 2 n_modes, 2 n_modes) float array
        Covariance of P_o e_o.
    """

    at: PolesAndParticipation
    shapes: ComplexArray
    residuals: ComplexArray
    covariance: FloatArray
    through: FloatArray
    cross: FloatArray
    own: FloatArray

    def joint(self, mode: int, outputs: tuple[int, int]) -> FloatArray:
        """Covariance (n_unknowns + 4, n_unknowns + 4) of the nonlinear unknowns, then Re and Im of the shape at both outputs.

        `mode` and `outputs` are indices; the last four rows are Re, Im at the first output, then Re, Im at the second.
        """
        rows = [mode, len(self.at.poles) + mode]
        through = [self.through[o][rows] for o in outputs]
        cross = [self.cross[o][rows] for o in outputs]
        n = len(self.covariance)
        covariance = np.zeros((n + 4, n + 4))
        covariance[:n, :n] = self.covariance
        for i, a in enumerate(outputs):
            here = slice(n + 2 * i, n + 2 * i + 2)
            covariance[here, :n] = cross[i] - through[i] @ self.covariance
            covariance[:n, here] = covariance[here, :n].T
            for j, b in enumerate(outputs):
                there = slice(n + 2 * j, n + 2 * j + 2)
                block = through[i] @ self.covariance @ through[j].T - cross[i] @ through[j].T - through[i] @ cross[j].T
                covariance[here, there] = block + (self.own[a][np.ix_(rows, rows)] if a == b else 0.0)
        return covariance


def frf_modes(
    data: FrfData, parameters: PolesAndParticipation, from_residual: bool, widening: FloatArray | float = 1.0
) -> FrfModes:
    """Shapes, residuals and covariances at the minimum of the weighted squared residual of the FRFs.

    Parameters
    ----------
    data : FrfData
    parameters : PolesAndParticipation
        The minimum.
    from_residual : bool
        Squares of the residual stand for the variance, value by value, each over the square of the part that the model
        does not take up (HC3); otherwise weights are right and the variance of every weighted value is 1.
    widening : (n_outputs,) float array
        Factor on all variances of an output's errors (`correlation_excess`); 1 by default.

    Returns
    -------
    FrfModes
        Shapes (n_outputs, n_modes), residuals (n_lines, n_outputs, n_inputs), and the covariances of poles, participation and
        shapes; these are NaN where the normal equations are singular.
    """
    n = len(parameters.poles)
    blocks = list(output_blocks(data, parameters))
    normal = sum(block.slope.T @ block.slope for block in blocks)
    inverse = _inverse(np.asarray(normal))
    middle, cross, shape_noise = np.zeros_like(inverse), [], []
    for block, times in zip(blocks, np.broadcast_to(widening, len(blocks)), strict=True):
        power = np.ones(len(block.residual))
        if from_residual:
            taken = block.leverage + np.einsum("ri,ij,rj->r", block.slope, inverse, block.slope, optimize=True)
            power = np.square(block.residual / np.maximum(1 - taken, 0.01))
        power = times * power
        inverse_of_shapes = block.pseudo_inverse[: 2 * n]
        inner = inverse_of_shapes * power
        middle += (block.slope.T * power) @ block.slope
        cross.append(inner @ block.slope @ inverse)
        shape_noise.append(inner @ inverse_of_shapes.T)
    shapes = np.array([block.own[:n] + 1j * block.own[n : 2 * n] for block in blocks])
    return FrfModes(
        parameters, shapes, residuals(data, parameters), inverse @ middle @ inverse,
        np.array([block.through[: 2 * n] for block in blocks]), np.array(cross), np.array(shape_noise),
    )  # fmt: skip


def correlation_excess(residuals: ComplexArray) -> FloatArray:
    """Upper bound of the factor by which correlation between lines multiplies variances, (n_outputs,); 1 where none is seen.

    Noise with correlations r_k at a distance of k lines gives a weighted sum over lines at most 1 + 2 (r_1 + r_2 + ...) times
    the variance that white noise gives it, where this is the peak of the noise's spectrum. The sum ends after 1, 2, 4, ...
    lines, up to an eighth of all, where it is most significant, and counts above 4 of its standard deviations in white noise.

    Parameters
    ----------
    residuals : (n_lines, n_outputs, n_inputs) complex array
        Weighted data less model.
    """
    n = len(residuals)
    power = np.sum(np.abs(np.fft.fft(residuals, 2 * n, axis=0)) ** 2, axis=2)
    products = np.fft.ifft(power, axis=0).real
    ends = 2 ** np.arange(max(int(np.log2(n // 8)), 0) + 1)
    sums = np.cumsum(products[1:], axis=0)[ends - 1] / np.maximum(products[0], np.finfo(float).tiny)
    sureness = sums * np.sqrt(2 * n * residuals.shape[2] / ends)[:, None]
    best = np.argmax(sureness, axis=0), np.arange(residuals.shape[1])
    return np.asarray(np.where(sureness[best] > _WHITE, 1 + 2 * sums[best], 1.0))


def _inverse(normal: FloatArray) -> FloatArray:
    """Inverse of the symmetric matrix `normal` after scaling to a unit diagonal; NaN throughout where it is singular."""
    size = np.sqrt(np.diag(normal))
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = normal / np.outer(size, size)
    if not scaled.size:
        return scaled
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < 1e-14:
        return np.full_like(normal, np.nan)
    return np.asarray(np.linalg.inv(scaled) / np.outer(size, size))


def frequency_damping_covariance(modes: FrfModes) -> FloatArray:
    """Covariance (2 n_modes, 2 n_modes) of frequencies (Hz), then damping ratios; NaN for modes whose poles are fixed."""
    slope, n = frequency_damping_slope(modes.at.poles), len(modes.at.poles)
    of_poles = np.full((2 * n, 2 * n), np.nan)
    free = modes.at.free[modes.at.free < 2 * n]
    of_poles[np.ix_(free, free)] = modes.covariance[: len(free), : len(free)]
    moving = np.tile(~modes.at.fixed, 2)
    covariance = np.full((2 * n, 2 * n), np.nan)
    inside = np.ix_(moving, moving)
    covariance[inside] = slope[inside] @ of_poles[inside] @ slope[inside].T
    return covariance


@dataclass(frozen=True)
class DrivingPoint:
    """Output and input at one place and direction; `sense` is -1 where they count in opposite senses."""

    output: int
    input: int
    sense: int


def scaled_shapes(modes: FrfModes, driving: list[DrivingPoint] | None) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Shapes of largest entry 1, or of modal mass 1 by the driving point that moves most in each mode.

    `driving` None asks for the largest entry. Mass scaling: the residue at the driving point is phi_d^2 / (2 i omega_d) with
    omega_d the damped circular frequency Im p, exact for proportional damping; for complex modes it says that modal a is
    2 i omega_d.

    Returns
    -------
    (n_outputs, n_modes) complex array
    (n_outputs, n_modes) float array
        Standard deviation of real parts; NaN for modes whose poles are fixed.
    (n_modes,) float array
        Standard deviation of the factor of each shape relative to the factor itself; 0 for largest entries of 1.
    """
    shapes, std, doubt = np.empty_like(modes.shapes), np.empty(modes.shapes.shape), np.zeros(modes.shapes.shape[1])
    for m in range(modes.shapes.shape[1]):
        phi, residue = modes.shapes[:, m], modes.at.participation[:, m]
        if driving is None:
            top = int(np.abs(phi).argmax())
            factor, relative = 1 / phi[top], _largest_change(modes, m, top)
        else:
            point = max(driving, key=lambda d: abs(phi[d.output] * residue[d.input]))
            top, factor, relative = point.output, *_mass_change(modes, m, point)
            doubt[m] = np.sqrt(np.abs(relative @ modes.joint(m, (top, top)) @ relative.conj()))
        scaled = phi * factor
        if driving is not None and scaled[np.abs(scaled).argmax()].real < 0:
            scaled, factor = -scaled, -factor
        for o in range(len(phi)):
            change = scaled[o] * relative
            change[-4:-2] += factor * np.array([1.0, 1j])
            std[o, m] = np.sqrt(np.maximum(change.real @ modes.joint(m, (o, top)) @ change.real, 0.0))
        shapes[:, m] = scaled
    std[:, modes.at.fixed] = np.nan
    return shapes, std, doubt


def _largest_change(modes: FrfModes, mode: int, top: int) -> ComplexArray:
    """Derivative of log(1 / phi_top) by the unknowns of `FrfModes.joint`, (n_unknowns + 4,); `mode` and `top` are indices."""
    change = np.zeros(len(modes.covariance) + 4, dtype=complex)
    change[-2:] = -np.array([1.0, 1j]) / modes.shapes[top, mode]
    return change


def _mass_change(modes: FrfModes, mode: int, point: DrivingPoint) -> tuple[complex, ComplexArray]:
    """Factor c with c^2 = 2 i omega_d l_d / phi_d that scales a shape to modal mass 1, and the derivative of log c.

    `mode` is the index of the mode; l_d and phi_d are its participation and shape at the driving point, omega_d is Im p. The
    derivative (n_unknowns + 4,) is by the unknowns of `FrfModes.joint` with the driving point as second output.
    """
    s, phi = modes.at.poles[mode], modes.shapes[point.output, mode]
    participation = modes.at.participation[point.input, mode]
    change = np.zeros(len(modes.covariance) + 4, dtype=complex)
    columns: IntArray = modes.at.free
    n = len(modes.at.poles)
    entry = 2 * n + point.input * n + mode
    for column, slope in (
        (n + mode, 1 / s.imag),
        (entry, 1 / participation),
        (entry + modes.at.participation.size, 1j / participation),
    ):
        change[: len(columns)] += np.where(columns == column, 0.5 * slope, 0.0)
    change[-2:] = -0.5 * np.array([1.0, 1j]) / phi
    return complex(np.sqrt(2j * s.imag * point.sense * participation / phi)), change
