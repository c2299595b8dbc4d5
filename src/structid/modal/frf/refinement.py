"""Poles, participation and shapes of FRFs by weighted least squares, with what noise does to them.

Shapes and residuals of one output are linear in `residues.terms`; they are eliminated output by output, and
Gauss-Newton steps with Levenberg-Marquardt damping are taken in poles and participation only. With the record's
variance it is the maximum-likelihood estimate for noise that is independent from line to line.

References
----------
Golub and Pereyra (1973), The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate, SIAM J. Numer. Anal. 10; Kaufman (1975), BIT 15; Guillaume, Verboven and Vanlanduit (1998), Frequency-domain
maximum likelihood identification of modal parameters with confidence intervals, ISMA 23; White (1980), Econometrica 48.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.inversion.eliminated_problem import EliminatedProblem, NormalEquations, minimize_eliminated
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.modal.frf.residues import OUTSIDE, slopes, terms, weighted

_SEARCH = LevenbergMarquardt(
    max_iterations=100, step_tolerance=1e-13, initial_damping=1e-6, largest_step=10.0, acceleration=0.0
)
_SMALL_GAIN = 1e-10


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
        """Copy with `step` (n_unknowns,) added to the free ones of Re and Im of poles, then of participation."""
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
    """Least-squares fit of the shape entries of each output at the poles and participation `parameters`, output by output.

    A block has the fitted coefficients (those of the columns of `terms`), the weighted residual (real parts, then
    imaginary ones), and its derivatives by the unknowns `free` of poles and participation (column numbers of `slopes`;
    by default the free ones of `parameters`), without columns unless `with_slopes`.

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
    """Sum of squares of the weighted FRF residual at the poles and participation `parameters`, with all linear unknowns fitted.

    These are each output's shape entries and terms for modes outside the band; infinite if they are linearly dependent.
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

    Steps continue while each promises to lower the misfit by the fraction `gain`. Fixed poles stay; the result is
    `start` and True if nothing is free, `start` and False if the search cannot begin.
    """
    n_free = len(start.free)
    if not n_free:
        return start, True

    def normal(changes: FloatArray) -> NormalEquations:
        """Gauss-Newton matrix, gradient and misfit at `start` plus `changes` (n_free,) of its free unknowns."""
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
