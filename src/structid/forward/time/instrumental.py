"""Refined instrumental variables: equations of motion at sampled instants, solved without the bias of noisy motion.

Least squares takes products of the noisy motion with itself, whose mean does not vanish. Instruments are the same
regressors made from a simulated motion, which has nothing to do with the noise: Z' W (B p - c) = 0 with Z from the
model at the present parameters, W the inverse covariance of the equation error there; again with the new ones, until
they stay (Young and Jakeman 1979; Soderstrom and Stoica 1983).

References
----------
Young and Jakeman (1979), Int. J. Control 29, 1-30: refined instrumental variables. Soderstrom and Stoica (1983),
Instrumental Variable Methods for System Identification, chapter 4: consistency and covariance. Norris (1986),
Eqs. 3.6 to 3.15: the regressors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import linalg, sparse, special

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError, SingularModelError
from structid.fem import Structure
from structid.forward.motion.equations import TimeEquations, time_equations
from structid.forward.motion.fit import identify_motion
from structid.forward.motion.motion import MOTION_QUANTITIES, Motion, field_map, recorded_motion
from structid.forward.time.estimate import WhitenedRows, dense_rows, fixed_rows, linear_estimate, stack_rows
from structid.forward.time.model import TimeModel
from structid.forward.time.options import TimeOptions
from structid.forward.time.output_error import declared_variance, time_model
from structid.inversion import Estimate
from structid.inversion.search.least_squares import SearchStateStore
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES
from structid.unknowns import Parameters

#: What came of an iteration: a solution, rows that determine none, or a motion that cannot be simulated.
SOLVED, UNDETERMINED, UNSTABLE = 0, 1, 2
_MATRIX_KINDS = {"acceleration": "mass", "velocity": "damping", "displacement": "stiffness"}
_TOLERANCE = 1e-2  # of a standard deviation; instruments need no more, since any make a consistent estimate
_STEPS_A_STAGE = 3


class Step(NamedTuple):
    """One iteration; `rows` are None where it is remembered from an earlier run, or cannot be made."""

    outcome: int
    solution: FloatArray
    deviation: FloatArray
    rows: WhitenedRows | None


class RowsAt(Protocol):
    """Equations and instruments as functions of the parameters."""

    def rows(self, values: FloatArray) -> WhitenedRows: ...


class InstrumentalSteps:
    """Iterations of all stages in their order; those in the checkpoint of `keeper` are read back, not made again.

    Their rows, which take all the time, are not made; what follows from the rows is stored bit for bit.

    Parameters
    ----------
    keeper : SearchStateStore, optional
    """

    def __init__(self, keeper: SearchStateStore | None) -> None:
        """Instrumental iterations read back from the checkpoint of `keeper`, in order; none without a checkpoint."""
        self.keeper, self.count = keeper, 0
        state: Mapping[str, Any] | None = None if keeper is None else keeper.state
        self.steps: list[Step] = []
        if state is not None:
            for outcome, solution, deviation in zip(
                np.asarray(state["outcomes"]).tolist(), state["solutions"], state["deviations"], strict=True
            ):
                self.steps.append(Step(int(outcome), np.asarray(solution), np.asarray(deviation), None))

    def taken(self, fit: RowsAt, values: FloatArray) -> Step:
        """Next iteration of `fit` from the parameters `values` (n_params,), read from the checkpoint or made and kept.

        One that is read has outcome, solution and deviation but no rows. Calls are counted: the k-th gives the k-th
        iteration.
        """
        self.count += 1
        if self.count <= len(self.steps):
            return self.steps[self.count - 1]
        step, cost = _iterate_once(fit, values)
        self.steps.append(step._replace(rows=None))
        if self.keeper is not None:
            self.keeper.keep(self.count, cost, self._state)
        return step

    def _state(self) -> dict[str, Any]:
        """Steps for a checkpoint: ``outcomes`` (n_steps,), ``solutions`` and ``deviations`` (n_steps, n_params).

        ``theta`` is the last solution.
        """
        solutions = np.array([step.solution for step in self.steps])
        deviations = np.array([step.deviation for step in self.steps])
        outcomes = [step.outcome for step in self.steps]
        return {"theta": solutions[-1], "outcomes": outcomes, "solutions": solutions, "deviations": deviations}


def _iterate_once(fit: RowsAt, values: FloatArray) -> tuple[Step, float]:
    """Instrumental iteration from the parameters `values` (n_params,), and the sum of squares there.

    The sum is infinite if motion is unstable. The step has the outcome, the solution and its standard deviations
    (n_params,) each, and the rows. Solution and deviation are NaN if the rows do not determine the parameters; if
    motion cannot be simulated there are no rows either.
    """
    nothing = np.full(len(values), np.nan)
    try:
        rows = fit.rows(values)
    except SingularModelError:
        return Step(UNSTABLE, nothing, nothing, None), float("inf")
    residual = rows.residual(values)
    cost, solution = float(residual @ residual), rows.solution()
    if solution is None:
        return Step(UNDETERMINED, nothing, nothing, rows), cost
    return Step(SOLVED, solution, np.sqrt(np.diag(rows.covariance())), rows), cost


@dataclass(frozen=True, eq=False)
class InstrumentalFit:
    """Equations of motion of a record, and what makes instruments for them.

    Attributes
    ----------
    equations : TimeEquations
    structure : Structure
    model : TimeModel
        Time-domain model with a sensor for each quantity of `simulated` at every degree of freedom.
    simulated : tuple of str
    motion : Motion
        Measured motion and force.
    noise : mapping of quantity to (n_dofs, n_dofs) float array, or None
        Error covariance of motion and force; None where it is not declared.
    force : float array
        Force of the simulation: samples, or amplitudes of an oscillation.
    initial : (2 n_dofs,) float array, optional
    """

    equations: TimeEquations
    structure: Structure
    model: TimeModel
    simulated: tuple[str, ...]
    motion: Motion
    noise: dict[str, FloatArray] | None
    force: FloatArray
    initial: FloatArray | None

    def first(self, n_times: int) -> InstrumentalFit:
        """A copy with the first samples only."""
        force = self.force if self.model.drive.oscillates else self.force[:n_times]
        return replace(self, motion=self.motion.at(slice(0, n_times)), force=force)

    def rows(self, values: FloatArray) -> WhitenedRows:
        """Regression equations and simulated instruments at the parameters `values` (n_params,), whitened.

        The instruments are the regressors of simulated motion; with a measured initial state those of the first sample
        are 0.

        Raises
        ------
        SingularModelError
            If motion cannot be simulated with these parameters.
        """
        n_times, n = self.motion.n_times, self.equations.n_dofs
        regressors, right = dense_rows(self.equations, self.equations.fields(self.motion))
        with np.errstate(over="ignore", invalid="ignore"):
            readings = self.model.readings(values, self.force, self.initial, n_times)
        if not np.isfinite(readings).all():
            raise SingularModelError("the simulated motion grows without bound")
        parts = dict(zip(self.simulated, readings.reshape(n_times, len(self.simulated), n).swapaxes(0, 1), strict=True))
        instruments, _ = dense_rows(self.equations, self.equations.fields(replace(self.motion, **parts)))
        if self.initial is not None:
            instruments[0] = 0.0  # it starts from the noisy state of this sample
        weight = self._whitening(values, right - regressors @ values)
        return stack_rows(
            self.equations.unknown,
            weight @ regressors,
            right @ weight.T,
            np.asarray(weight @ instruments),
            self.motion.force @ weight.T,
        )

    def rows_with(self, unknown: Parameters, values: FloatArray) -> WhitenedRows:
        """The equations with other `unknown` parameters of the structure, at `values` of these."""
        model, equations = replace(self.model, unknown=unknown), time_equations(self.structure, unknown)
        return replace(self, model=model, equations=equations).rows(values)

    def _whitening(self, values: FloatArray, residual: FloatArray) -> FloatArray:
        """Matrix (n_dofs, n_dofs) that whitens the equation error at an instant, an inverse Cholesky factor.

        `values` (n_params,) are the parameters, `residual` (n_times, n_dofs) the equation error. If no noise is
        declared the matrix is diagonal, one over the RMS of each equation's error (the largest RMS where it is 0).
        Raises `InputError` if the covariance of the declared noise is singular.
        """
        if self.noise is None:
            size = np.sqrt((residual**2).mean(axis=0))
            return np.diag(1 / np.where(size > 0, size, max(float(size.max(initial=0.0)), 1e-300)))
        properties = self.equations.unknown.values(values)
        total = self.noise["force"].copy()
        for quantity in MOTION_QUANTITIES:
            if quantity in self.noise:
                matrix = self.structure.matrix(_MATRIX_KINDS[quantity], properties)
                total += matrix @ (matrix @ self.noise[quantity]).T
        try:
            factor = np.linalg.cholesky(total)
        except np.linalg.LinAlgError as error:
            raise InputError(
                "the declared noise leaves some equation of motion exact, so that no finite weight exists; declare noise"
                " of the acceleration of every degree of freedom, or leave `variance` out"
            ) from error
        return linalg.solve_triangular(factor, np.eye(len(factor)), lower=True)


def instrumental_fit(
    structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions
) -> InstrumentalFit:
    """Set-up of the instrumental-variables fit of a structure to a record, with the whole of its samples.

    With `options.initial` "unknown" the simulation starts from the measured state of the first sample, else at rest.

    Raises
    ------
    InputError
        If a quantity that the equations hold is not measured at every degree of freedom, or the force or the start of
        the simulation is not known.
    """
    equations = time_equations(structure, unknown)
    motion = recorded_motion(structure, record)
    equations.fields(motion.at(slice(0, 1)))  # so that a missing quantity shows here
    simulated = tuple(q for q in MOTION_QUANTITIES if getattr(motion, q) is not None)
    base = time_model(structure, unknown, record, options)
    dofs = tuple(Dof(d.node, d.direction, d.sign) for d in structure.dofs)
    orders = np.repeat([MOTION_DERIVATIVES[q] for q in simulated], structure.n_dofs)
    model = replace(base, sensors=dofs * len(simulated), orders=orders)
    loads = [i for i, q in enumerate(record.quantities) if q == "force"]
    force, initial = model.drive.force_values(record.values[:, loads]), None
    if options.initial == "unknown":
        if motion.velocity is None or motion.displacement is None:
            raise InputError(
                "displacement and velocity at the first sample are needed to start the simulation that makes the"
                " instruments; record both, begin at rest, or take method 'output_error'"
            )
        initial = np.concatenate([motion.displacement[0], motion.velocity[0]])
    noise = None if record.variance is None else _noise(structure, record)
    return InstrumentalFit(equations, structure, model, simulated, motion, noise, force, initial)


def _noise(structure: Structure, record: TimeRecord) -> dict[str, FloatArray]:
    """Error covariance (n_dofs, n_dofs) of each measured quantity and of the force at free degrees of freedom, by name.

    Raises `InputError` if the noise variance of a channel is not declared, negative or not finite.
    """
    variance, covariances = declared_variance(record), {}
    for quantity in (*MOTION_QUANTITIES, "force"):
        reader = field_map(structure, record, quantity)
        if reader is not None:
            covariances[quantity] = (reader @ sparse.diags_array(variance) @ reader.T).toarray()
    return covariances


def identified_by_instruments(
    structure: Structure, unknown: Parameters, record: TimeRecord, options: TimeOptions, work: TaskExecutor = SERIAL
) -> Estimate:
    """Estimate by refined instrumental variables, from few samples first and then from more and more.

    Starting points are tried until one fits the noise; otherwise the end with the least chi-square counts, of those
    that converged if any did. `work` may store the iterations. Raises `InputError` if the record or the model does not
    suit the method.
    """
    fit = instrumental_fit(structure, unknown, record, options)
    size = options.first_samples or max(4, -(-2 * unknown.n_params // structure.n_dofs))
    steps = InstrumentalSteps(work.keeper(_no_rows(unknown)))
    ends: list[_End] = []
    for first, values in _starting_attempts(fit, unknown, size):
        ends.append(_follow_stages(fit, first, values, options.max_iterations, steps))
        if ends[-1].fits(fit.noise is not None, options.misfit_probability):
            break
    end = min(ends, key=lambda e: (not e.converged, e.chi_square))
    message = "the parameters stay" if end.converged else f"stopped after {options.max_iterations} iterations"
    if end.rows is None:
        message = "motion cannot be simulated with the parameters found"
    elif end.values is None:
        message = "the samples do not determine the parameters"
    rows, known, fixed = end.rows or _plain_rows(fit), fit.noise is not None, None
    if end.values is not None and end.rows is not None:
        fixed = fixed_rows(structure, unknown, options.tolerances, end.linearized_at, fit.rows_with)
    return linear_estimate(
        rows, end.values, end.history, end.converged, message, known, options.misfit_probability, len(ends), fixed
    )


@dataclass(frozen=True, eq=False)
class _End:
    """End of the iteration from one start; `rows`, made at `linearized_at`, is None if motion cannot be simulated."""

    values: FloatArray | None
    converged: bool
    rows: WhitenedRows | None
    linearized_at: FloatArray
    history: list[FloatArray]

    @property
    def chi_square(self) -> float:
        """Weighted sum of squared residuals at the final values; infinite where there are none."""
        if self.rows is None or self.values is None:
            return float("inf")
        residual = self.rows.residual(self.values)
        return float(residual @ residual)

    def fits(self, known_noise: bool, probability: float) -> bool:
        """True if the probability of a larger chi-square is at least `probability`; also if the noise is not known.

        False where motion cannot be simulated. `known_noise` says that the deviations of the noise are known.
        """
        if self.rows is None or not known_noise:
            return self.rows is not None
        freedom = self.rows.n_data - len(self.history[0])
        return bool(freedom <= 0 or special.gammaincc(freedom / 2, self.chi_square / 2) >= probability)


def _starting_attempts(fit: InstrumentalFit, unknown: Parameters, size: int) -> Iterator[tuple[int, FloatArray]]:
    """Yield the number of samples of the first stage, and starting parameters (n_params,), for each attempt in turn.

    First linear fits to `size` and 8 `size` samples, if they determine all parameters, then the initial values with 8
    `size` and with all samples.
    """
    n_times, initial = fit.motion.n_times, np.array(unknown.start)
    for first in dict.fromkeys((min(size, n_times), min(8 * size, n_times))):
        values = identify_motion(fit.structure, unknown, fit.motion.at(slice(0, first))).values
        if np.isfinite(values).all():
            yield first, values
    yield min(8 * size, n_times), initial
    yield n_times, initial


def _follow_stages(fit: InstrumentalFit, size: int, values: FloatArray, most: int, steps: InstrumentalSteps) -> _End:
    """End of the instrumental fit that starts with `size` samples, which double until all are used.

    Each stage starts at the values of the one before, or at its own start if that one has none; the last takes at most
    `most` iterations, the others three. `steps` stores the iterations. `values` (n_params,) are the parameters at the
    start.
    """
    history = [values]
    while size < fit.motion.n_times:
        stage = _iterate(fit.first(size), values, _STEPS_A_STAGE, history, steps).values
        values = values if stage is None else stage
        size *= 2
    return _iterate(fit, values, most, history, steps)


def _iterate(
    fit: InstrumentalFit, values: FloatArray, most: int, history: list[FloatArray], steps: InstrumentalSteps
) -> _End:
    """End of at most `most` instrumental iterations from the parameters `values` (n_params,).

    It converges when no parameter changes by 0.01 standard deviations or more. Each solution (n_params,) is appended to
    `history`; the value is the mean of old and new where a step reverses the one before by more than half. `steps`
    stores the iterations. Without solution, or where motion cannot be simulated, the end has no values.
    """
    converged, last, before = False, None, values
    for _ in range(most):
        taken = steps.taken(fit, values)
        if taken.outcome == UNSTABLE:
            return _End(None, False, None, values, history)
        if taken.outcome == UNDETERMINED:
            return _End(None, False, taken.rows or fit.rows(values), values, history)
        history.append(taken.solution)
        step = (taken.solution - values) / taken.deviation
        swings = last is not None and float(step @ last) < -0.5 * float(last @ last)
        before, last = values, step
        values = 0.5 * (values + taken.solution) if swings else taken.solution
        if np.abs(step).max(initial=0.0) < _TOLERANCE:
            converged = True
            break
    return _End(values, converged, taken.rows or fit.rows(before), before, history)


def _no_rows(unknown: Parameters) -> WhitenedRows:
    """Empty rows of the parameters, which then keep their values."""
    none = np.zeros((0, 1, unknown.n_params))
    return stack_rows(unknown, none, np.zeros((0, 1)), none, np.zeros((0, 1)))


def _plain_rows(fit: InstrumentalFit) -> WhitenedRows:
    """The equations as they are, with the noisy regressors in place of instruments."""
    regressors, right = dense_rows(fit.equations, fit.equations.fields(fit.motion))
    return stack_rows(fit.equations.unknown, regressors, right, regressors, fit.motion.force)
