"""Weak form: the equations of motion integrated against smooth test functions of compact support.

With a test function f that vanishes with its derivatives at both ends of its window, the integral of f d^e x / dt^e is
(-1)^(e-o) times that of (d^(e-o) f) d^o x / dt^o. So one of displacement, velocity and acceleration of each degree of
freedom is enough, noise is never differentiated nor summed up, and the state at the start never enters. With
f = d^b g for an accelerometer of order b, the derivative of negative order that stiffness asks for is one of g.

The rows R = B p - c are linear in the noise of all channels, with a covariance C(p) that follows from it. The
parameters solve B^' C^-1 R = 0, where B^ is B of the data less the noise expected from R: the maximum of the
likelihood of noisy regressors (errors in variables), found by iteration.

References
----------
Bortz, Messenger and Dukic (2023), Bull. Math. Biol. 85, 110: weak-form estimation with the covariance of the equation
error (WENDy). Shinbrot (1957), Trans. ASME 79, 579-588: modulating functions. Fuller (1987), Measurement Error Models,
section 3.2: functional maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from scipy import linalg, sparse

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward.motion.equations import TimeEquations, time_equations
from structid.forward.time.estimate import WhitenedRows, dense_rows, fixed_rows, linear_estimate, stack_rows
from structid.forward.time.model import require_viscous
from structid.forward.time.options import TimeOptions
from structid.forward.time.output_error import declared_variance
from structid.inversion import Estimate
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES
from structid.unknowns import Parameters

_POWER = 8
_MOST_ROWS = 3000
_DENSITY = 8  # test functions begin so many times in the length of one
_BAND = 5.0  # a test function of length T passes frequencies up to about 5 / T
_FEWEST_SAMPLES = 12
_POWER_IN_BAND = 0.95
_MATRIX_KINDS = ("stiffness", "damping", "mass")  # by the order of the derivative that they multiply
_TOLERANCE = 1e-4  # of a standard deviation
_DEPENDENT = (
    "the test functions must be independent under the declared noise; take fewer `windows`, and declare noise of every"
    " channel of motion"
)


@dataclass(frozen=True, eq=False)
class WeakForm:
    """Filtered motion and force of a record, and the covariance of their noise.

    Attributes
    ----------
    equations : TimeEquations
    structure : Structure
    fields : (4 n_dofs, n_windows) float array
        Integrals of the test functions with acceleration, velocity, displacement and force.
    spread : mapping of int to (n_dofs, n_dofs) float array
        Noise covariance of the degrees of freedom that are measured as derivative of this order.
    grams : mapping of (int, int) to (n_windows, n_windows) float array
        Products of the sampled derivatives of these orders of all pairs of test functions.
    base : int
        Order of the derivative that the test functions are.
    force_spread : (n_dofs, n_dofs) float array
    """

    equations: TimeEquations
    structure: Structure
    fields: FloatArray
    spread: Mapping[int, FloatArray]
    grams: Mapping[tuple[int, int], FloatArray]
    base: int
    force_spread: FloatArray

    @property
    def n_windows(self) -> int:
        return self.fields.shape[1]

    def covariance(self, values: FloatArray) -> FloatArray:
        """Noise covariance of the equation rows, (n_rows, n_rows), at physical parameters `values`.

        A row is one window and degree of freedom; the window varies slowest. `values` is (n_params,).
        """
        matrices = self._matrices(values)
        total = np.kron(self.grams[self.base, self.base], self.force_spread)
        for order, spread in self.spread.items():
            for e in range(3):
                for other in range(3):
                    gram = self.grams[self.base + e - order, self.base + other - order]
                    total += (-1) ** (e + other) * np.kron(gram, matrices[e] @ spread @ matrices[other].T)
        return total

    def noise(self, values: FloatArray, weighted: FloatArray) -> FloatArray:
        """Expected noise of the windowed fields, (4 n_dofs, n_windows), given the weighted residuals of the equations.

        Fields are accelerations, velocities, displacements and forces; `weighted` (n_windows, n_dofs) is the inverse
        covariance times the residual, and `values` (n_params,) are the parameters.
        """
        matrices, n = self._matrices(values), self.equations.n_dofs
        noise = np.zeros((3, n, self.n_windows))
        for order, spread in self.spread.items():
            for e in range(3):
                for other in range(3):
                    gram = self.grams[self.base + e - order, self.base + other - order]
                    noise[2 - e] += (-1) ** (e + other) * spread @ matrices[other].T @ weighted.T @ gram.T
        force = -self.force_spread @ weighted.T @ self.grams[self.base, self.base].T
        return np.concatenate([*noise, force])

    def _matrices(self, values: FloatArray) -> list[FloatArray]:
        properties = self.equations.unknown.values(values)
        return [self.structure.matrix(matrix_kind, properties).toarray() for matrix_kind in _MATRIX_KINDS]

    def rows(self, values: FloatArray) -> WhitenedRows:
        """Weak-form equations weighted by their noise covariance at `values` (n_params,), and their instruments.

        The instruments are the regressors less the noise that the residual at `values`, weighted, lets expect in them:
        so they are free of the noise of the rows.

        Raises
        ------
        InputError
            If the covariance is singular: too many windows, or channels without noise.
        """
        regressors, right = dense_rows(self.equations, self.fields)
        n = self.equations.n_dofs
        covariance = self.covariance(values)
        size = np.sqrt(np.diag(covariance))
        if not (size > 0).all():
            raise InputError(_DEPENDENT)
        try:
            factor = linalg.cholesky(covariance / np.outer(size, size), lower=True)
        except linalg.LinAlgError as error:
            raise InputError(_DEPENDENT) from error

        def whitened(array: FloatArray) -> FloatArray:
            scaled = array.reshape(len(size), -1) / size[:, None]
            return np.asarray(linalg.solve_triangular(factor, scaled, lower=True))

        wide, single = whitened(regressors), whitened(right)[:, 0]
        weighted = linalg.solve_triangular(factor, single - wide @ values, lower=True, trans="T") / size
        noise = self.noise(values, -weighted.reshape(self.n_windows, n))
        instruments, _ = dense_rows(self.equations, self.fields - noise)
        shape = self.n_windows, n
        return stack_rows(
            self.equations.unknown,
            wide,
            single.reshape(shape),
            whitened(instruments),
            whitened(self.fields[3 * n :].T)[:, 0].reshape(shape),
        )

    def rows_with(self, unknown: Parameters, values: FloatArray) -> WhitenedRows:
        """The equations with other `unknown` parameters of the structure, at `values` of these."""
        return replace(self, equations=time_equations(self.structure, unknown)).rows(values)


def weak_form(structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions) -> WeakForm:
    """Weak-form equations of motion of a record: integrals of test functions with motion and force, over windows.

    Derivatives act on the test functions, so that one kind of motion serves each degree of freedom. The length of a
    window is `options.window` or suits the power of the motion.

    Raises
    ------
    InputError
        If a degree of freedom is measured in no way, forces are missing, noise is not declared, or the record is
        shorter than its windows.
    """
    require_viscous(structure, unknown)
    equations, n = time_equations(structure, unknown), structure.n_dofs
    variance = declared_variance(record)
    loads = [i for i, q in enumerate(record.quantities) if q == "force"]
    if not loads:
        raise InputError("the record must hold force channels; the weak form takes the force where it acts as known")
    where = structure.selection([record.channels[i] for i in loads]).toarray()
    readers = _readers(structure, record, options)
    base = max(readers) + options.drift
    orders = {base + e - order for order in readers for e in range(3)} | {base}
    used = np.flatnonzero(np.any([np.abs(reader).any(axis=0) for reader in readers.values()], axis=0))
    length = options.window or _suited_length(record.values[:, used], 1 / record.sampling_rate)
    filters = _filters(len(record.values), 1 / record.sampling_rate, n, length, options.windows, orders)
    grams = {(a, b): (filters[a] @ filters[b].T).toarray() for a in orders for b in orders}
    motions = np.zeros((3, n, filters[base].shape[0]))
    for order, reader in readers.items():
        motion = reader @ record.values.T
        for e in range(3):
            motions[2 - e] += (-1) ** (e - order) * (filters[base + e - order] @ motion.T).T
    force = where @ (filters[base] @ record.values[:, loads]).T
    spread = {order: (reader * variance) @ reader.T for order, reader in readers.items()}
    force_spread = (where * variance[loads]) @ where.T
    return WeakForm(equations, structure, np.concatenate([*motions, force]), spread, grams, base, force_spread)


def _readers(structure: Structure, record: TimeRecord, options: TimeOptions) -> dict[int, FloatArray]:
    """Matrices (n_dofs, n_channels) from channels to motion of the degrees of freedom, by order of derivative (0 to 2).

    Quantities are taken in the order of `TimeOptions.quantities`, each for the degrees of freedom still missing. Raises
    `InputError` if some are not measured at all.
    """
    n, missing = structure.n_dofs, np.arange(structure.n_dofs)
    readers: dict[int, FloatArray] = {}
    for quantity in options.quantities:
        chosen = [i for i, q in enumerate(record.quantities) if q == quantity]
        if not chosen or not len(missing):
            continue
        sensors = structure.selection([record.channels[i] for i in chosen]).toarray().T
        inverse = np.linalg.pinv(sensors)
        resolved = np.abs(inverse @ sensors - np.eye(n)).max(axis=1) < 1e-9
        taken = missing[resolved[missing]]
        if len(taken):
            reader = np.zeros((n, len(record.channels)))
            reader[np.ix_(taken, chosen)] = inverse[taken]
            readers[MOTION_DERIVATIVES[quantity]] = reader
            missing = missing[~resolved[missing]]
    if len(missing):
        raise InputError(
            f"every degree of freedom must be measured as {' or '.join(options.quantities)} for the weak form, got none at"
            f" {', '.join(structure.words(structure.dofs[i]) for i in missing)}; add sensors, condense the model, or take method"
            " 'output_error', which needs only some"
        )
    return readers


def _suited_length(motion: FloatArray, step: float) -> float:
    """Window length (s) of test functions that pass 95 % of the power of each column of `motion` (n_times, n).

    At least 12 time steps and at most a fifth of the record, if that is longer; `step` is the time step, s.
    """
    n_times = len(motion)
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n_times) + 0.5) / n_times)
    power = np.abs(np.fft.rfft(hann[:, None] * (motion - motion.mean(axis=0)), axis=0)) ** 2
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    highest = float((share < _POWER_IN_BAND).sum(axis=0).max(initial=1)) / (n_times * step)
    span = (n_times - 1) * step
    return float(np.clip(_BAND / max(highest, 1 / span), _FEWEST_SAMPLES * step, max(span / 5, _FEWEST_SAMPLES * step)))


def _filters(
    n_times: int, step: float, n_dofs: int, length: float, windows: int | None, orders: set[int]
) -> dict[int, sparse.csr_array]:
    """Sampled derivatives of the test functions times the time step, sparse (n_windows, n_times), by derivative order.

    `length` and `step` are in s; `windows` is the number of test functions, by default eight to a length, at most what
    3000 equations allow. `orders` are the orders of derivatives wanted. Raises `InputError` if the length does not fit
    the record, or if `windows` makes more than 3000 equations, one for each window and each of `n_dofs` degrees of
    freedom.
    """
    span, shortest = (n_times - 1) * step, _FEWEST_SAMPLES * step
    if not shortest <= length * (1 + 1e-9) or length > span * (1 + 1e-9):
        raise InputError(
            f"`window` must be from {shortest:g} s ({_FEWEST_SAMPLES} samples) to the record's {span:g} s, got"
            f" {length:g} s; measure longer, sample faster, or give `window`"
        )
    most = max(1, _MOST_ROWS // n_dofs)
    count = windows or min(most, int(_DENSITY * (span - length) / length) + 1)
    if count > most:
        raise InputError(
            f"`windows` must be at most {most} for {n_dofs} degrees of freedom, got {count}; take fewer and longer ones"
        )
    middle = np.linspace(length / 2, span - length / 2, count) if count > 1 else np.array([span / 2])
    first = np.maximum(np.floor((middle - length / 2) / step).astype(int), 0)
    samples = first[:, None] + np.arange(int(np.ceil(length / step)) + 2)
    position = (samples * step - middle[:, None]) / length
    is_inside = (np.abs(position) < 0.5) & (samples < n_times)
    columns, starts = samples[is_inside], np.concatenate([[0], np.cumsum(is_inside.sum(axis=1))])
    weights = {order: step * modulating_function(position[is_inside], order) / length**order for order in orders}
    return {o: sparse.csr_array((w, columns, starts), shape=(count, n_times)) for o, w in weights.items()}


def modulating_function(position: FloatArray, order: int) -> FloatArray:
    """Derivative of given `order` of the test function cos(pi x)^16, |x| < 1/2, at `position` x, in window lengths.

    The function's first 15 derivatives vanish at both ends, so that sums over samples integrate it as exactly as the
    samples show the motion. `position` may have any shape, which the result has too; it is 0 outside.
    """
    total = np.zeros_like(position)
    for k in range(_POWER + 1):
        weight = comb(2 * _POWER, _POWER - k) / 4**_POWER * (2.0 if k else 1.0)
        rate = 2 * np.pi * k
        total += weight * rate**order * np.cos(rate * position + 0.5 * np.pi * order)
    return np.where(np.abs(position) < 0.5, total, 0.0)


def identified_by_weak_form(
    structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions
) -> Estimate:
    """Estimate of mass, damping and stiffness by the weak form, with noise of the measured motion accounted for.

    Equations are reweighted and solved until no parameter changes by 1e-4 standard deviations or more, at most
    `max_iterations` times. Raises `InputError` if a degree of freedom, force or noise is not measured or declared, or
    the record is too short.
    """
    form = weak_form(structure, unknown, record, options)
    values: FloatArray = np.array(unknown.start)
    history: list[FloatArray] = [values]
    converged, solution, before = False, None, values
    for _ in range(options.max_iterations):
        rows, before = form.rows(values), values
        if len(history) == 1:  # the given start serves for the weight alone: its residual says nothing of the noise
            rows = replace(rows, instruments=rows.regressors)
        solution = rows.solution()
        if solution is None:
            break
        history.append(solution)
        moved = np.abs(solution - values) / np.sqrt(np.diag(rows.covariance()))
        values = solution
        if moved.max(initial=0.0) < _TOLERANCE:
            converged = True
            break
    message = "the parameters stay" if converged else f"stopped after {options.max_iterations} iterations"
    if solution is None:
        message = "the windows do not determine the parameters"
    fixed = None if solution is None else fixed_rows(structure, unknown, options.tolerances, before, form.rows_with)
    return linear_estimate(rows, solution, history, converged, message, True, options.misfit_probability, fixed=fixed)
