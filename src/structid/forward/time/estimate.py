"""The `Estimate` of an iterated linear fit to time records: instrumental variables and the weak form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.fem import Structure
from structid.forward.fixed_values import append_fixed_factors
from structid.forward.motion.equations import TimeEquations
from structid.forward.sensitivity import nonlinear_values
from structid.inversion import DataRows, DenseCovariance, Estimate, FreeUnknowns, Linearization, Problem, Status
from structid.inversion.covariance import correlation_length, inverse_information, model_error_covariance
from structid.inversion.diagnostics.identifiability import identifiability
from structid.inversion.diagnostics.residual_tests import is_misfit
from structid.inversion.estimate import Goodness, ParameterValues, SearchRecord
from structid.inversion.fixed_values import FitWithinTolerances, FixedColumns, FixedValueInfluence, explained_part
from structid.inversion.uncertainty import Spread
from structid.unknowns import Parameters
from structid.unknowns.tolerances import Tolerances, fixed_properties

_UNSOUND = 1e-10


@dataclass(frozen=True, eq=False)
class WhitenedRows(Problem):
    """Equations linear in the parameters, with rows of unit variance, and instruments for them.

    Attributes
    ----------
    parameters : Parameters
    regressors : (n_rows, n_params) float array
    right : (n_rows,) float array
    instruments : (n_rows, n_params) float array
        Regressors as far as they are free of the noise of the rows.
    labels : DataRows
        Instant (or window), and twice the degree of freedom, of each row.
    force : (n_rows,) float array
        Measured force in the rows, which `right` holds beside what is known of the structure. The derivative of the
        residual by a relative error of the calibration is its negative.
    """

    parameters: Parameters
    regressors: FloatArray
    right: FloatArray
    instruments: FloatArray
    labels: DataRows
    force: FloatArray

    @property
    def rows(self) -> DataRows:
        """Labels of the rows."""
        return self.labels

    @property
    def unknowns(self) -> FreeUnknowns:
        """Parameters as they are: no variable is transformed."""
        return FreeUnknowns(self.parameters.names, self.parameters.start, self.parameters.kinds, self.parameters.units)

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.regressors @ theta - self.right

    def linearize(self, theta: FloatArray) -> Linearization:
        """Residual, with the instruments in place of the Jacobian."""
        return Linearization(self.residual(theta), self.instruments)

    @cached_property
    def _system(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Matrix Q' B S^-1, basis Q and scale S of the instrumental-variables equations Z' B p = Z' c.

        Z = Q R S are the instruments (n_rows, n_params), S (n_params,) their column norms, Q (n_rows, n_params)
        orthonormal, B the regressors; Q' B S^-1 is (n_params, n_params). None with fewer rows than parameters, or if Z
        or the matrix is singular to 1e-10.
        """
        scale = np.linalg.norm(self.instruments, axis=0)
        if len(self.right) < len(scale) or not (scale > 0).all() or not np.isfinite(scale).all():
            return None
        basis, triangle = np.linalg.qr(self.instruments / scale)
        singular = np.linalg.svd(triangle, compute_uv=False)
        system = basis.T @ self.regressors / scale
        if singular[-1] < _UNSOUND * singular[0] or not np.linalg.cond(system) < 1 / _UNSOUND:
            return None
        return system, basis, scale

    @property
    def determine_all(self) -> bool:
        """True where there is one solution."""
        return self._system is not None

    def solution(self) -> FloatArray | None:
        """Instrumental-variables solution (n_params,), residual orthogonal to all instruments; None if not unique."""
        return None if self._system is None else self.solve_for(self.right)

    def solve_for(self, right: FloatArray) -> FloatArray:
        """Solution (Z'B)^-1 Z' c, (n_params, ...), for right-hand sides c (n_rows, ...), given as `right`.

        Z are the instruments, B the regressors. NaN if the rows do not determine all parameters.
        """
        if self._system is None:
            return np.full((len(self.parameters.names), *right.shape[1:]), np.nan)
        system, basis, scale = self._system
        return np.asarray((np.linalg.solve(system, basis.T @ right).T / scale).T)

    def covariance(self) -> FloatArray:
        """Covariance (n_params, n_params) of the instrumental-variables solution for rows of unit noise.

        If the rows do not determine all parameters it is that of least squares with the instruments as regressors, NaN
        for those that are undetermined.
        """
        if self._system is None:
            return inverse_information(self.instruments)
        system, _, scale = self._system
        half = np.linalg.inv(system) / scale[:, None]
        return half @ half.T


@dataclass(frozen=True, eq=False)
class FixedRows:
    """Values that linear equations of motion hold fixed, as relative errors that enter these linearly too.

    Attributes
    ----------
    fixed : FixedColumns
        With the derivative of the whitened rows with respect to each relative error.
    instruments : (n_rows, n_fixed) float array
        The part of that derivative that is free of noise.
    """

    fixed: FixedColumns
    instruments: FloatArray

    def influence(self, rows: WhitenedRows, values: FloatArray) -> FixedValueInfluence:
        """Influence of the fixed values on the solution `values` (n_params,): K = -(Z'B)^-1 Z'B_h, instruments Z."""
        return self.fixed.influence_by(values, -rows.solve_for(self.fixed.columns), np.ones(len(values)))

    def refit(self, rows: WhitenedRows) -> FitWithinTolerances | None:
        """Fit with each fixed value free within its tolerance, and its deviation counted as data; None if not unique.

        `rows` are the equations without fixed values. The result has the problem, its solution (parameters, then
        deviations of the fixed values in tolerances), the linearization there, the deviations and the parameters. The
        unknowns of the problem name the parameters only.
        """
        tolerance, n, n_fixed = self.fixed.tolerance, rows.parameters.n_params, len(self.fixed.names)
        stated = np.hstack([np.zeros((n_fixed, n)), np.eye(n_fixed)])
        together = replace(
            rows,
            regressors=np.vstack([np.hstack([rows.regressors, self.fixed.columns * tolerance]), stated]),
            instruments=np.vstack([np.hstack([rows.instruments, self.instruments * tolerance]), stated]),
            right=np.concatenate([rows.right, np.zeros(n_fixed)]),
        )
        solution = together.solution()
        if solution is None:
            return None
        asked, values = solution[n:], solution[:n]
        return FitWithinTolerances(together, solution, together.linearize(solution), asked, values)


def fixed_rows(
    structure: Structure,
    unknown: Parameters,
    tolerances: Tolerances,
    values: FloatArray,
    rows_with: Callable[[Parameters, FloatArray], WhitenedRows],
) -> FixedRows | None:
    """Effect of relative errors of the fixed values on linear equations of motion, at `values`; None if all are exact.

    The gain that all channels of the record share comes last, where it has a tolerance. Values that enter matrices
    non-linearly, such as a thickness, count as exact.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    tolerances : Tolerances
        Relative standard deviation of the fixed values, by property, and of the gain.
    values : (n_params,) float array
        Parameters in physical units.
    rows_with : callable
        Gives the whitened rows of the equations for unknowns and their values: here `unknown` at `values`, then a
        factor of 1 on each fixed value.

    Returns
    -------
    FixedRows or None
        Names, kinds and tolerances of the fixed values, and the derivative (n_rows, n_fixed) of the whitened rows by
        each relative error, as measured and as instruments.
    """
    is_nonlinear = nonlinear_values(structure)
    properties = fixed_properties(structure, unknown, tolerances)
    properties = tuple(item for item in properties if not is_nonlinear[item.indices].any())
    if not properties and not tolerances.calibration:
        return None
    freed = append_fixed_factors(unknown, properties)
    rows = rows_with(freed, np.concatenate([values, np.ones(len(properties))]))
    n, has_gain = unknown.n_params, tolerances.calibration > 0
    gain = -rows.force[:, None] if has_gain else np.zeros((rows.n_data, 0))
    fixed = FixedColumns(
        names=(*(item.label for item in properties), *(["calibration[record]"] if has_gain else [])),
        kinds=(*(item.kind for item in properties), *(["gain"] if has_gain else [])),
        tolerance=np.array([*(item.tolerance for item in properties), *([tolerances.calibration] if has_gain else [])]),
        columns=np.hstack([rows.regressors[:, n:], gain]),
        within=None,
    )
    return FixedRows(fixed, np.hstack([rows.instruments[:, n:], gain]))


def stack_rows(
    unknown: Parameters, regressors: FloatArray, right: FloatArray, instruments: FloatArray, force: FloatArray
) -> WhitenedRows:
    """Whitened rows of all instants (or windows), one after another, with their instruments.

    The arguments are already whitened; degrees of freedom vary fastest.

    Parameters
    ----------
    unknown : Parameters
    regressors, instruments : (n_times, n_dofs, n_params) or (n_times n_dofs, n_params) float arrays
    right, force : (n_times, n_dofs) float arrays
        Right-hand side of the equations, and the force as far as it is part of it.
    """
    lines, series = np.divmod(np.arange(right.size), right.shape[1])
    flat = (right.size, unknown.n_params)
    labels = DataRows(lines, 2 * series)
    return WhitenedRows(
        unknown, regressors.reshape(flat), right.ravel(), instruments.reshape(flat), labels, force.ravel()
    )


def dense_rows(equations: TimeEquations, fields: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Regressors (n_times, n_dofs, n_params) and right-hand side (n_times, n_dofs) of fields (4 n_dofs, n_times).

    Fields are accelerations, velocities, displacements and forces of all degrees of freedom at each instant.
    """
    n, n_params, n_times = equations.n_dofs, equations.unknown.n_params, fields.shape[1]
    rows = equations.rows(fields).reshape(n, n_times, equations.side)
    columns = np.broadcast_to(equations.columns, (n, equations.side - 1))
    dense = np.zeros((n, n_times, n_params + 1))
    for dof in range(n):
        dense[dof][:, columns[dof]] += rows[dof][:, :-1]
    regressors = np.swapaxes(dense[..., :n_params], 0, 1)
    return np.ascontiguousarray(regressors), rows[..., -1].T


def linear_estimate(
    rows: WhitenedRows,
    values: FloatArray | None,
    history: list[FloatArray],
    converged: bool,
    message: str,
    known_noise: bool,
    misfit_probability: float,
    n_starts: int = 1,
    fixed: FixedRows | None = None,
) -> Estimate:
    """Estimate from a linear fit in time, with covariance, status and identifiability.

    `values` (n_params,) are None if there is no solution; estimates are then NaN. With `known_noise` False the unit
    variance of the rows comes from their residual, and chi-square is NaN. `fixed` holds the fixed values at `values`;
    None takes them as exact. `history` are the values of all iterations, `converged` and `message` say how they ended,
    and a chi-square less probable than `misfit_probability` counts as model error, whose covariance is then adopted.
    A parameter is identified if its adopted standard deviation is at most its size. `n_starts` is the number of
    starting points that were tried.
    """
    unknown = rows.parameters
    n_params, determined = unknown.n_params, values is not None
    estimated = np.full(n_params, np.nan) if values is None else values
    residual = rows.residual(estimated) if determined else np.full(rows.n_data, np.nan)
    chi_square, freedom = float(residual @ residual), max(rows.n_data - n_params, 0)
    misfit = determined and freedom > 0 and is_misfit(chi_square, freedom, misfit_probability)
    blank = np.full((n_params, n_params), np.nan)
    noise = rows.covariance() if determined else blank
    model = model_error_covariance(rows, rows.linearize(estimated)) if determined else blank
    influence, least = None if fixed is None or not determined else fixed.influence(rows, estimated), float("nan")
    if fixed is not None and influence is not None and misfit and known_noise:
        within, least = fixed.refit(rows), chi_square
        if within is not None:
            misfit, least = within.misfits_chi_square(misfit_probability, 1.0, freedom), within.chi_square
            explained = explained_part(chi_square, least, freedom)
            influence = replace(influence, asked=within.asked, theta=within.parameters, explained=explained)
    basis = "model_error" if misfit or not known_noise else "noise"
    adopted = np.sqrt(np.diag(model if basis == "model_error" else noise))
    identified = adopted <= np.abs(estimated)
    size = np.where(
        np.isfinite(estimated) & (estimated != 0), np.abs(estimated), np.where(unknown.start != 0, unknown.start, 1.0)
    )
    status = Status.CONVERGED if identified.all() else Status.NOT_IDENTIFIABLE
    if not converged and rows.determine_all:
        status = Status.NOT_CONVERGED
    parameters = ParameterValues(
        names=unknown.names,
        kinds=unknown.kinds,
        units=unknown.units,
        initial=locked(unknown.start),
        values=locked(estimated),
        theta=locked(estimated),
    )
    spread = Spread(
        noise=DenseCovariance(noise),
        model_error=DenseCovariance(model),
        covariance_basis=basis,
        identified=locked(identified),
        identifiability=identifiability(
            rows.instruments * size, estimated, unknown.names, np.sqrt(chi_square / freedom) if misfit else 1.0
        ),
        fixed=influence,
    )
    goodness = Goodness(
        n_data=rows.n_data,
        chi_square=chi_square if known_noise else float("nan"),
        degrees_of_freedom=freedom,
        residual_correlation=correlation_length(residual, rows.labels.lines, rows.labels.series)
        if determined
        else float("nan"),
        least_chi_square=least,
    )
    search = SearchRecord(
        n_iterations=len(history) - 1, n_starts=n_starts, n_agreeing=1, history=locked(np.array(history))
    )
    return Estimate(
        parameters=parameters, spread=spread, goodness=goodness, search=search, status=status, message=message
    )
