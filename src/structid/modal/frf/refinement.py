"""Poles, participation and shapes of FRFs by weighted least squares, with what noise does to them.

Poles and residues are the model: as receptance, with phi for the shape, l for the participation of the inputs and real
matrices R_k for the modes outside the band,

    H(s) = sum over modes of phi l' / (s - p) + conj(phi l') / (s - conj(p))  +  sum over k of R_k s^k,

times s for mobility and s^2 for accelerance. It is linear in phi and R_k, each output by itself. A mode below the band
is a series of powers -2, -3, ... of s, one above of 0, 1, 2, ...; a mode at f_r falls off by (f_r / f)^2, or (f / f_r)^2, from
each even power to the next, its damping stands in the odd ones. k = -2 and 0 alone are the common residual mass and
stiffness.

Shapes and residuals of one output are linear in `terms`; they are eliminated output by output, and
Gauss-Newton steps with Levenberg-Marquardt damping are taken in poles and participation only. With the record's
variance it is the maximum-likelihood estimate for noise that is independent from line to line.

With errors e_o of output o, C the inverse of the normal equations and B_o, P_o slope and pseudo-inverse of
`OutputBlock`, the nonlinear unknowns move by C sum of B_o' e_o, and the output's own by P_o e_o - A_o C sum of B' e.

References
----------
Model: Heylen, Lammens and Sas (1997), Modal analysis theory and testing, section A.3 (least-squares frequency domain method);
Verboven (2002), Frequency-domain system identification for modal analysis, Vrije Universiteit Brussel, chapter 4.
Search: Golub and Pereyra (1973), The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate, SIAM J. Numer. Anal. 10; Kaufman (1975), BIT 15; Guillaume, Verboven and Vanlanduit (1998), Frequency-domain
maximum likelihood identification of modal parameters with confidence intervals, ISMA 23.
Covariance: Pintelon, Guillaume and Schoukens (2007), Uncertainty calculation in (operational) modal analysis, Mech. Syst. Signal
Process. 21, 2359-2373; White (1980), A heteroskedasticity-consistent covariance matrix estimator, Econometrica 48;
MacKinnon and White (1985), Some heteroskedasticity-consistent covariance matrix estimators with improved finite sample
properties, J. Econom. 29, 305-325 (HC3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from structid.core.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.inversion.eliminated_problem import EliminatedProblem, NormalEquations, minimize_eliminated
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.modal.poles.poles import frequency_damping_slope

OUTSIDE = (-2, 0)  # powers of s that stand for the modes outside the band at least
_RANK = 1e-10  # of a column that is left after those before it, below which it says nothing new
_SEARCH = LevenbergMarquardt(
    max_iterations=100, step_tolerance=1e-13, initial_damping=1e-6, largest_step=10.0, acceleration=0.0
)
_SMALL_GAIN = 1e-10
_WHITE = 4.0  # standard deviations of a sum of correlations of white noise, above which a residual is not white


def terms(
    laplace: ComplexArray,
    poles: ComplexArray,
    participation: ComplexArray,
    power: int,
    outside: tuple[int, ...] = OUTSIDE,
) -> ComplexArray:
    """Regressors of one output: factors of Re phi, Im phi and the terms of modes outside the band.

    Parameters
    ----------
    laplace : (n_lines,) complex array
        Laplace variable s of the lines, 1/s, nowhere 0.
    poles : (n_modes,) complex array
        In the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
        The residue of mode m at an input is phi times this.
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.
    outside : tuple of int
        Powers of s, of receptance, that stand for the modes outside the band.

    Returns
    -------
    (n_lines, n_inputs, 2 n_modes + n_outside n_inputs) complex array
        The last axis are the unknowns, which are real: Re phi of all modes, Im phi of all modes, then for each power of s the
        coefficient of every input.
    """
    here, there = _fractions(laplace, poles, power)
    a, b = here[:, None, :] * participation, there[:, None, :] * participation.conj()
    each = np.eye(len(participation))
    static = [laplace[:, None, None] ** (power + k) * each for k in outside]
    return np.concatenate([a + b, 1j * (a - b), *static], axis=2)


def slopes(
    laplace: ComplexArray, poles: ComplexArray, participation: ComplexArray, shape: ComplexArray, power: int
) -> ComplexArray:
    """Derivatives of the FRFs of one output by Re p, Im p, and Re l, Im l of every input and mode.

    Parameters
    ----------
    laplace : (n_lines,) complex array
        Laplace variable of the lines, 1/s, nowhere 0.
    poles : (n_modes,) complex array
        p, in the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
        l.
    shape : (n_modes,) complex array
        Entry of this output in each shape.
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.

    Returns
    -------
    (n_lines, n_inputs, 2 n_modes + 2 n_inputs n_modes) complex array
        Participation is counted input by input, all modes of each.
    """
    here, there = _fractions(laplace, poles, power)
    a = (here / (laplace[:, None] - poles) * shape)[:, None, :] * participation
    b = (there / (laplace[:, None] - poles.conj()) * shape.conj())[:, None, :] * participation.conj()
    n = len(participation)
    first, second = here * shape, there * shape.conj()
    each = np.eye(n)[None, :, :, None]
    real = (each * (first + second)[:, None, None, :]).reshape(len(laplace), n, -1)
    imag = (each * (1j * (first - second))[:, None, None, :]).reshape(len(laplace), n, -1)
    return np.concatenate([a + b, 1j * (a - b), real, imag], axis=2)


def _fractions(laplace: ComplexArray, poles: ComplexArray, power: int) -> tuple[ComplexArray, ComplexArray]:
    factor = laplace[:, None] ** power
    return factor / (laplace[:, None] - poles), factor / (laplace[:, None] - poles.conj())


def weighted(columns: ComplexArray, weights: FloatArray) -> FloatArray:
    """Real matrix of weighted columns, (2 n_lines n_inputs, n_columns): rows of real parts, then of imaginary parts.

    `columns` is (n_lines, n_inputs, n_columns), `weights` (n_lines, n_inputs).
    """
    n_lines, n_inputs, n_columns = columns.shape
    return stack_real(
        (columns * weights[:, :, None]).reshape(n_lines * n_inputs, n_columns)
    )  # where there is no column too


def residue_shapes(
    laplace: ComplexArray,
    values: ComplexArray,
    weights: FloatArray,
    poles: ComplexArray,
    participation: ComplexArray,
    power: int,
) -> ComplexArray:
    """Shapes phi of all outputs, (n_outputs, n_modes), by least squares with poles and participation held.

    Terms for modes outside the band are fitted along and dropped. Where the regressors are linearly dependent, the
    solution of least norm is taken.

    Parameters
    ----------
    laplace : (n_lines,) complex array
        Laplace variable of the lines, 1/s, nowhere 0.
    values : (n_lines, n_outputs, n_inputs) complex array
        FRFs.
    weights : (n_lines, n_inputs) float array
        The same for all outputs, which share one factorization.
    poles : (n_modes,) complex array
        In the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.
    """
    matrix = weighted(terms(laplace, poles, participation, power), weights)
    right = weighted(values.transpose(0, 2, 1), weights)
    size = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(size > 0, size, 1.0)
    q, r = np.linalg.qr(matrix)
    regular = np.abs(np.diag(r)).min() > _RANK
    solution = np.linalg.solve(r, q.T @ right) if regular else np.linalg.lstsq(matrix, right, rcond=_RANK)[0]
    solution = solution / np.where(size > 0, size, 1.0)[:, None]
    n = len(poles)
    return np.asarray((solution[:n] + 1j * solution[n : 2 * n]).T)


@dataclass(frozen=True, eq=False)
class FrfData:
    """FRFs and the weights of their residuals.

    Attributes
    ----------
    laplace : (n_lines,) complex array
    values : (n_lines, n_outputs, n_inputs) complex array
    weights : (n_lines, n_outputs, n_inputs) float array
        One over the standard deviation of real and imaginary part each.
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.
    outside : tuple of int
        Powers of s, of receptance, that stand for the modes outside the band.
    """

    laplace: ComplexArray
    values: ComplexArray
    weights: FloatArray
    power: int
    outside: tuple[int, ...] = OUTSIDE


@dataclass(frozen=True, eq=False)
class PolesAndParticipation:
    """The nonlinear unknowns of a fit of FRFs.

    In each mode the participation of the input that has the largest is held, since it only scales the shape.

    Attributes
    ----------
    poles : (n_modes,) complex array
        In the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
    fixed : (n_modes,) bool array
        True for modes whose pole and participation stay as they are.
    """

    poles: ComplexArray
    participation: ComplexArray
    fixed: NDArray[np.bool_]

    @property
    def held(self) -> IntArray:
        """Index of the input with the largest participation in each mode, (n_modes,), which is held fixed."""
        return np.abs(self.participation).argmax(axis=0)

    @property
    def free(self) -> IntArray:
        """Column numbers of `slopes` that belong to free unknowns, (n_unknowns,), for poles p and participation l.

        The order is Re p, Im p, then Re l, Im l input by input, without modes that are `fixed` and, in each mode,
        without the input of the largest participation, whose l stays.
        """
        n_inputs, n = self.participation.shape
        moving = np.flatnonzero(~self.fixed)
        entries = np.flatnonzero(((np.arange(n_inputs)[:, None] != self.held) & ~self.fixed).ravel())
        return np.concatenate([moving, n + moving, 2 * n + entries, 2 * n + n_inputs * n + entries])

    @property
    def sizes(self) -> FloatArray:
        """Magnitude (n_free,) of each free unknown, in the order of `free`: of the pole, or of the mode's largest participation."""
        largest = np.abs(self.participation).max(axis=0)
        entries = np.broadcast_to(largest, self.participation.shape).ravel()
        return np.concatenate([np.abs(self.poles), np.abs(self.poles), entries, entries])[self.free]

    def moved(self, step: FloatArray) -> PolesAndParticipation:
        """Copy with `step` (n_unknowns,) added to the free unknowns: Re and Im of poles, then of participation."""
        n_inputs, n = self.participation.shape
        whole = np.zeros(2 * n + 2 * n_inputs * n)
        whole[self.free] = step
        entries = whole[2 * n :].reshape(2, n_inputs, n)
        poles = self.poles + whole[:n] + 1j * whole[n : 2 * n]
        return PolesAndParticipation(poles, self.participation + entries[0] + 1j * entries[1], self.fixed)

    def select(self, modes: IntArray) -> PolesAndParticipation:
        """The poles and participation of `modes`, in the order of these indices."""
        return PolesAndParticipation(self.poles[modes], self.participation[:, modes], self.fixed[modes])


@dataclass(frozen=True, eq=False)
class OutputBlock:
    """One output at given poles and participation: its own unknowns eliminated.

    Attributes
    ----------
    own : (n_own,) float array
        Least-squares Re phi, Im phi, and what stands for the modes outside the band.
    residual : (n_rows,) float array
        Weighted data less model.
    slope : (n_rows, n_unknowns) float array
        Derivatives of the model, orthogonal to the output's own terms.
    basis : (n_rows, n_own) float array
        Orthonormal columns that span the output's own terms.
    triangle : (n_own, n_own) float array
        The regressors of the own terms are `basis` times this upper triangle.
    shared : (n_own, n_unknowns) float array
        Coefficients, in `basis`, of the part of the derivatives that the own terms follow and `slope` leaves out.
    """

    own: FloatArray
    residual: FloatArray
    slope: FloatArray
    basis: FloatArray
    triangle: FloatArray
    shared: FloatArray

    @property
    def through(self) -> FloatArray:
        """Negative derivative of `own` by the unknowns, (n_own, n_unknowns)."""
        return np.asarray(linalg.solve_triangular(self.triangle, self.shared))

    @property
    def pseudo_inverse(self) -> FloatArray:
        """Pseudo-inverse: the change of `own` for changes of the data, (n_own, n_rows)."""
        return np.asarray(linalg.solve_triangular(self.triangle, self.basis.T))

    @property
    def leverage(self) -> FloatArray:
        """Part of an error in each value that the fit of the output's own terms follows, (n_rows,), 0 to 1."""
        return np.asarray(np.sum(self.basis**2, axis=1))


def output_blocks(
    data: FrfData, parameters: PolesAndParticipation, free: IntArray | None = None, with_slopes: bool = True
) -> Iterator[OutputBlock]:
    """Least-squares fit of each output's shape entries at the poles and participation `parameters`, in order.

    `data` has the FRFs with their weights. A block has the fitted coefficients (those of the columns of `terms`), the
    weighted residual (real parts, then imaginary ones), and its derivatives by the unknowns `free` of poles and
    participation (column numbers of `slopes`; by default the free ones of `parameters`), without columns unless
    `with_slopes`.

    Raises
    ------
    LinAlgError
        If poles coincide.
    """
    columns = terms(data.laplace, parameters.poles, parameters.participation, data.power, data.outside)
    n, unknowns = len(parameters.poles), parameters.free if free is None else free
    for o in range(data.values.shape[1]):
        weight = data.weights[:, o]
        matrix = weighted(columns, weight)
        right = weighted(data.values[:, o, :, None], weight)[:, 0]
        q, r = np.linalg.qr(matrix)
        solution = linalg.solve_triangular(r, q.T @ right)
        residual = right - matrix @ solution
        if not with_slopes:
            yield OutputBlock(solution, residual, np.zeros((len(residual), 0)), q, r, np.zeros((len(solution), 0)))
            continue
        shape = solution[:n] + 1j * solution[n : 2 * n]
        change = weighted(
            slopes(data.laplace, parameters.poles, parameters.participation, shape, data.power)[:, :, unknowns], weight
        )
        shared = q.T @ change
        yield OutputBlock(solution, residual, change - q @ shared, q, r, shared)


def residuals(data: FrfData, parameters: PolesAndParticipation) -> ComplexArray:
    """Weighted data less model, (n_lines, n_outputs, n_inputs)."""
    parts = [b.residual.reshape(2, *data.values.shape[::2]) for b in output_blocks(data, parameters, with_slopes=False)]
    return np.stack([real + 1j * imag for real, imag in parts], axis=1)


def misfit(data: FrfData, parameters: PolesAndParticipation) -> float:
    """Sum of squares of the weighted FRF residual at poles and participation `parameters`, all linear unknowns fitted.

    These are each output's shape entries and terms for modes outside the band; infinite if they are linearly dependent.
    `data` has the FRFs with their weights.
    """
    columns, total = terms(data.laplace, parameters.poles, parameters.participation, data.power, data.outside), 0.0
    for o in range(data.values.shape[1]):
        with_values = np.concatenate([columns, data.values[:, o, :, None]], axis=2)
        *diagonal, remainder = np.diag(np.linalg.qr(weighted(with_values, data.weights[:, o]), mode="r"))
        if not np.all(diagonal):
            return np.inf
        total += float(remainder) ** 2
    return total


def refined(
    data: FrfData, start: PolesAndParticipation, gain: float = _SMALL_GAIN
) -> tuple[PolesAndParticipation, bool]:
    """Poles and participation at the nearest minimum of the FRF misfit from `start`, and True if it was reached.

    Steps continue while each promises to lower the misfit of `data` by the fraction `gain` of it. Fixed poles stay; the
    result is `start` and True if nothing is free, `start` and False if the search cannot begin.
    """
    n_free = len(start.free)
    if not n_free:
        return start, True

    def normal(changes: FloatArray) -> NormalEquations:
        """Gauss-Newton matrix, gradient of half the misfit, and misfit, `changes` (n_free,) away from `start`."""
        matrix, gradient, cost = np.zeros((n_free, n_free)), np.zeros(n_free), 0.0
        for block in output_blocks(data, start.moved(changes), start.free):
            matrix = matrix + block.slope.T @ block.slope
            gradient = gradient - block.slope.T @ block.residual
            cost += float(block.residual @ block.residual)
        return NormalEquations(matrix, gradient, cost)

    problem = EliminatedProblem(start.sizes, lambda changes: misfit(data, start.moved(changes)), normal)
    minimum = minimize_eliminated(problem, replace(_SEARCH, gain_tolerance=gain))
    if minimum is None:
        return start, False
    changes, has_converged = minimum
    return start.moved(changes), has_converged


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
    """Inverse of the symmetric matrix `normal` after scaling to a unit diagonal; NaN throughout where it is singular.

    It counts as singular if its least eigenvalue after scaling is below 1e-14; one without rows is its own inverse.
    """
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

    `driving` None asks for the largest entry. Mass scaling: the residue at the driving point is phi_d^2 / (2 i omega_d)
    with omega_d the damped circular frequency Im p, exact for proportional damping; for complex modes it says that
    modal a is 2 i omega_d. The sign is that of a largest entry with a positive real part.

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
    """Factor c that scales a shape to modal mass 1, c^2 = +-2 i omega_d l_d / phi_d, and the derivative of log c.

    `mode` is the index of the mode; l_d and phi_d are its participation and shape at the driving point, omega_d is Im
    p, and the sign is - where output and input of the point have opposite senses. The derivative (n_unknowns + 4,) is
    by the unknowns of `FrfModes.joint` with the driving point as second output.
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
