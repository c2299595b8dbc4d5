"""Identification from measured motion by one linear least-squares fit, and its `Estimate` with what is missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words
from structid.core.errors import InputError, require_class
from structid.fem import Structure
from structid.forward.motion.equations import TimeEquations, time_equations
from structid.forward.motion.motion import MOTION_QUANTITIES, Motion, Rule, recorded_motion
from structid.inversion import DenseCovariance, Direction, Estimate, Identifiability, Status
from structid.inversion.diagnostics.identifiability import identifiability
from structid.inversion.estimate import Goodness, ParameterValues, SearchRecord
from structid.inversion.regression.block_least_squares import BlockFit
from structid.inversion.regression.local_reduction import FoldingKernels, RowMaker
from structid.inversion.regression.streaming_qr import LinearFit, StreamingQr, no_rows
from structid.inversion.uncertainty import Spread
from structid.records import TimeRecord
from structid.unknowns import Parameters

_CHUNK_ENTRIES = 2_000_000

#: Error variance of each quantity: one number, (n_dofs,) or (n_times, n_dofs).
MotionVariance = Mapping[str, ArrayLike]
_UNSEEN = {
    "stiffness": (
        "the motion does not strain these elements (rigid-body motion only, or no motion there);"
        " excite an elastic mode that bends or stretches them"
    ),
    "axial_force": "the motion does not turn these elements; excite a mode that bends them",
    "mass": "these masses do not accelerate; excite a motion in which they move",
    "rotary_inertia": "these inertias do not turn; excite a motion in which they rotate",
    "viscous_damping": "these dampers do not move; excite a motion that gives them velocity",
}
_BIAS = (
    "least squares takes the motion as exact: its noise biases the values, mostly towards zero, and neither more"
    " samples nor these standard deviations show it (see least_squares_bias)"
)
_SWAMPED = 0.5


@dataclass(frozen=True, eq=False)
class RecursiveMotionFit:
    """Parameters from the samples seen so far; `updated` gives the next value and leaves this one as it is.

    One sample at a time, chunks of any size and the whole record give the same answer, and so do parts of a record
    that are fitted apart and `merged`, in any order.

    Attributes
    ----------
    equations : TimeEquations
    state : StreamingQr
        Its size does not depend on the number of samples.
    energy, error : (4 n_dofs,) float arrays
        Sums over samples of the square, and of the error variance where given, of acceleration, velocity,
        displacement and force.
    n_samples : int
    """

    equations: TimeEquations
    state: StreamingQr
    energy: FloatArray
    error: FloatArray
    n_samples: int

    def updated(
        self, chunk: Motion, variance: MotionVariance | None = None, work: FoldingKernels | None = None
    ) -> RecursiveMotionFit:
        """Fit after one more chunk of motion; `variance` is the error variance of its quantities, where known."""
        fields = self.equations.fields(chunk)
        return replace(
            self,
            state=reduced_state(self.equations, self.state, None, fields, work),
            energy=locked(self.energy + (fields**2).sum(axis=1)),
            error=self.error
            if variance is None
            else locked(self.error + _summed_variances(variance, chunk.force.shape)),
            n_samples=self.n_samples + chunk.n_times,
        )

    def merged(self, other: RecursiveMotionFit) -> RecursiveMotionFit:
        """Fit of the samples of both fits, which must have the same equations.

        Raises
        ------
        InputError
            If the columns of the equations differ.
        """
        return replace(
            self,
            state=self.state.merged(other.state),
            energy=locked(self.energy + other.energy),
            error=locked(self.error + other.error),
            n_samples=self.n_samples + other.n_samples,
        )

    def solution(self) -> LinearFit:
        """Values, covariance, rank, condition with unit columns and residual variance, as numbers.

        Raises
        ------
        InputError
            If there is nothing to fit: no samples, no motion, or no force and nothing known to scale by.
        """
        self.require_content()
        return self.state.solution(self.equations.sizes(self.energy))

    def require_content(self) -> None:
        """Raise `InputError` if there are no samples, the motion is zero throughout, or force and known terms are."""
        n = self.equations.n_dofs
        if self.n_samples == 0:
            raise InputError("there are no samples yet; call `updated` with some motion first")
        if not self.energy[: 3 * n].any():
            raise InputError(
                "the motion is zero in every sample: the force excites nothing; check the channels and their scale, and"
                " load a degree of freedom that can move"
            )
        if not self.state.triangles[..., -1].any():
            raise InputError(
                "the force is zero in every sample and nothing in the structure is known: free motion gives ratios of"
                " parameters only; apply and record a force, or fix one parameter (a known mass, say)"
            )

    def bias(self, values: FloatArray | None = None, exact_motion: bool = False) -> FloatArray:
        """Predicted bias (n_params,) of the fit by noise of the motion, in the units of the parameters.

        It is -(B'B)^-1 (N p - n), with B and c the regressors and right-hand sides, B'B p = B'c, and N and n what the
        noise of the motion is expected to add to B'B and B'c. `values` (n_params,) are p, by default the fitted ones.
        With `exact_motion` the motion that was fitted has no noise, and N is added to B'B.
        """
        solution = self.solution()
        p = solution.values if values is None else np.asarray(values, dtype=np.float64)
        gram, cross = self.equations.noise_gram(self.error)
        normal = solution.triangle.T @ solution.triangle + (gram if exact_motion else 0.0)
        seen = np.diag(normal) > 0
        scale = np.sqrt(np.where(seen, np.diag(normal), 1.0))
        right = -(gram @ p - cross) / scale
        return np.linalg.lstsq(normal / np.outer(scale, scale), right, rcond=None)[0] / scale

    def estimate(self) -> Estimate:
        """Estimate with covariance, status and words; see `identify_motion`.

        The bias is predicted if error variances are known and all parameters are determined.
        """
        bias = self.bias() if self.error.any() and self.solution().rank == self.state.n_params else None
        return motion_estimate(self.equations, self.solution(), self.n_samples, bias)


def reduced_state(
    equations: TimeEquations,
    state: StreamingQr,
    rows: RowMaker | None,
    fields: FloatArray,
    work: FoldingKernels | None = None,
) -> StreamingQr:
    """QR `state` updated by the equation rows of the samples `fields` (n_fields, n_times).

    `rows` forms the equation rows from `fields`, which may then be channels of a record; None takes the operator of
    `equations`. `work` does the update where each degree of freedom has a block of rows.
    """
    if len(equations.columns) == equations.n_dofs:
        return state.reduced(equations.operator if rows is None else rows, fields, work)
    operator = equations.operator if rows is None else rows.operator
    step = max(1, _CHUNK_ENTRIES // operator.shape[0])
    for first in range(0, fields.shape[1], step):
        state = state.updated(equations.shaped(operator @ fields[:, first : first + step]))
    return state


def motion_fit(structure: Structure, unknown: Parameters, row_weights: ArrayLike | None = None) -> RecursiveMotionFit:
    """Fit before any sample, for updates by motion.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    row_weights : (n_dofs,) array, optional
        See `time_equations`.

    Examples
    --------
    >>> from structid import Spring, PointMass, Structure, Unknown, parameters
    >>> from structid.forward.motion.motion import Motion
    >>> parts = [PointMass("mass", [1], 1.0), Spring("spring", "1X", stiffness=1.0)]
    >>> structure = Structure({1: 0.0}, parts, active=["X"])
    >>> unknown = parameters(structure, [Unknown("mass", "mass"), Unknown("stiffness", "spring")])
    >>> fit = motion_fit(structure, unknown)
    >>> for t, f, a, w in [(0.0, 2.0, 1.0, 0.0), (0.1, 5.0, 1.0, 1.0), (0.2, 8.0, 1.0, 2.0)]:
    ...     fit = fit.updated(Motion([t], [[f]], [[a]], None, [[w]]))
    >>> fit.estimate().values.round(9).tolist()
    [2.0, 3.0]
    """
    equations = time_equations(structure, unknown, row_weights)
    zeros = locked(np.zeros(4 * structure.n_dofs))
    return RecursiveMotionFit(equations, no_rows(equations.columns, unknown.n_params), zeros, zeros, 0)


def identify_motion(
    structure: Structure,
    unknown: Parameters,
    record: TimeRecord | Motion,
    rule: Rule | None = None,
    row_weights: ArrayLike | None = None,
    variance: MotionVariance | None = None,
) -> Estimate:
    """Masses, viscous dampings and stiffnesses from the motion of every free degree of freedom and known forces.

    Solves M(p) a + C(p) v + K(p) w = f at all samples together by least squares, in one linear step: no start, no
    iteration (Norris 1986, Eqs. 3.11 to 3.15, by QR instead of the normal equations).

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Linear: no loss factors, no friction, no priors. Bounds are not imposed; the message names values outside.
    record : TimeRecord or Motion
        Motion of all free degrees of freedom with the forces.
    rule : {"trapezoid", "difference"}, optional
        How quantities that a `TimeRecord` lacks are made: integrated from acceleration, or differentiated from
        displacement. None makes none.
    row_weights : (n_dofs,) array, optional
        Factor on the equation of each degree of freedom; 1 by default.
    variance : mapping of quantity to error variance, optional
        Of ``acceleration``, ``velocity`` and ``displacement``: a number, (n_dofs,) or (n_times, n_dofs). The message
        then says how large the bias is, and parameters that it swamps count as not identified.

    Returns
    -------
    Estimate
        `covariance_noise` is the residual variance times (B'B)^-1: right for errors of the force that are independent
        from sample to sample and of one size. `covariance_model_error`, `chi_square` and `residual_correlation` are
        NaN, since they are not computed; `theta` repeats `values`. Values that the motion does not determine are NaN.

    Raises
    ------
    InputError
        If degrees of freedom, forces or quantities are missing, or motion or force are zero throughout.

    Notes
    -----
    Plain least squares on noisy motion is inconsistent: errors in the regressors pull the values towards zero by
    -(B'B)^-1 N p, however many samples there are, and no covariance of the residual shows it. `least_squares_bias`
    predicts it. Motion integrated from noisy acceleration carries a random walk, so that longer records are worse.
    """
    require_class("structure", structure, Structure, "make it by `Structure(nodes, elements, fixed)`")
    require_class("unknown", unknown, Parameters, "make it by `parameters(structure, unknowns)`")
    require_class("record", record, (TimeRecord, Motion), "make it by `read_record` or `TimeRecord`")
    motion = record if isinstance(record, Motion) else recorded_motion(structure, record, rule)
    if isinstance(record, Motion) and rule is not None:
        raise InputError("`rule` belongs to a TimeRecord; complete a Motion with `completed(motion, rule)` first")
    return motion_fit(structure, unknown, row_weights).updated(motion, variance).estimate()


def least_squares_bias(
    structure: Structure,
    unknown: Parameters,
    motion: Motion,
    variance: MotionVariance,
    values: ArrayLike | None = None,
    row_weights: ArrayLike | None = None,
    exact_motion: bool = False,
) -> FloatArray:
    """Bias of the least-squares parameters by errors of the motion, (n_params,) in their units.

    To first order -(B'B + N)^-1 (N p - n), where N is the mean that the errors add to B'B of the exact motion, and n
    what they add to B'c through the known properties. Measured motion holds N in its own B'B.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    motion : Motion
    variance : mapping of quantity to error variance
        As for `identify_motion`; errors independent between degrees of freedom and between quantities.
    values : (n_params,) array, optional
        True parameters, as far as known; the initial values of `unknown` by default.
    row_weights : (n_dofs,) array, optional
    exact_motion : bool
        Whether `motion` is free of the errors, as in a simulation.
    """
    fit = motion_fit(structure, unknown, row_weights).updated(motion, variance)
    return fit.bias(np.asarray(unknown.start if values is None else values, dtype=np.float64), exact_motion)


def _summed_variances(variance: MotionVariance, shape: tuple[int, ...]) -> FloatArray:
    """Error variances of the motion summed over samples, (4 n_dofs,), zero for forces.

    Accelerations come first, then velocities and displacements. `variance` maps a quantity to a number, (n_dofs,) or
    (n_samples, n_dofs), 0 if absent; `shape` is (n_samples, n_dofs). Raises `InputError` if it names another quantity,
    or has a wrong shape or sign.
    """
    for name in variance:
        if name not in MOTION_QUANTITIES:
            raise InputError(f"`variance` must be of {', '.join(MOTION_QUANTITIES)}, got {name!r}")
    parts = []
    for name in MOTION_QUANTITIES:
        try:
            variances = np.broadcast_to(np.asarray(variance.get(name, 0.0), dtype=np.float64), shape)
        except ValueError as error:
            raise InputError(
                f"`variance` of {name} must be one number, ({shape[1]},) or {shape}, got {np.shape(variance[name])}"
            ) from error
        if not np.isfinite(variances).all() or (variances < 0).any():
            raise InputError(f"`variance` of {name} must be finite and not negative")
        parts.append(variances.sum(axis=0))
    return np.concatenate([*parts, np.zeros(shape[1])])


def motion_estimate(
    equations: TimeEquations, fit: LinearFit, n_samples: int, bias: FloatArray | None = None
) -> Estimate:
    """Estimate with covariance, status and words from a linear fit to motion; `bias` (n_params,) if it was predicted.

    A parameter is identified if its standard deviation is at most its size and its bias, if given, at most half of it;
    the status is ``NOT_IDENTIFIABLE`` if one is not. `n_samples` is the number of instants that were fitted.
    """
    unknown = equations.unknown
    std = np.sqrt(np.diag(fit.covariance))
    identified = std <= np.abs(fit.values)
    if bias is not None:
        identified &= np.abs(bias) <= _SWAMPED * np.abs(fit.values)
    parameters = ParameterValues(
        names=unknown.names,
        kinds=unknown.kinds,
        units=unknown.units,
        initial=unknown.start,
        values=fit.values,
        theta=fit.values,
    )
    spread = Spread(
        noise=DenseCovariance(fit.covariance),
        model_error=DenseCovariance(np.full_like(fit.covariance, np.nan)),
        covariance_basis="noise",
        identified=locked(identified),
        identifiability=_identifiability(equations, fit),
    )
    goodness = Goodness(
        chi_square=float("nan"),
        n_data=equations.n_dofs * n_samples,
        degrees_of_freedom=fit.degrees_of_freedom,
        residual_correlation=float("nan"),
    )
    history = locked(np.array([unknown.start, fit.values]))
    return Estimate(
        parameters=parameters,
        spread=spread,
        goodness=goodness,
        search=SearchRecord(n_iterations=1, n_starts=1, n_agreeing=1, history=history),
        status=Status.CONVERGED if identified.all() else Status.NOT_IDENTIFIABLE,
        message="; ".join(_words(equations, fit, n_samples, bias)),
    )


def _words(equations: TimeEquations, fit: LinearFit, n_samples: int, bias: FloatArray | None) -> list[str]:
    """Words for the reader, the most important first."""
    words = solution_words(equations.unknown, fit, equations.n_dofs * n_samples, n_samples)
    return [*words[:-1], *_bias_words(equations, fit, bias), words[-1]]


def solution_words(unknown: Parameters, fit: LinearFit | BlockFit, n_rows: int, n_samples: int) -> list[str]:
    """Sentences on the linear fit: what the data lack and how to supply it, then rank, condition and residual.

    Values outside the declared range are named too. `n_rows` is the number of equations, `n_samples` that of instants.
    """
    n_params, n = unknown.n_params, n_rows // max(1, n_samples)
    words = []
    if n_rows < n_params:
        words.append(
            f"{n_samples} samples of {n} degrees of freedom give {n_rows} equations for {n_params} parameters;"
            f" at least {-(-n_params // n)} samples are needed"
        )
    lost = np.flatnonzero(~fit.seen)
    for kind in dict.fromkeys(unknown.kinds[i] for i in lost):
        names = [unknown.names[i] for i in lost if unknown.kinds[i] == kind]
        words.append(f"not seen: {join_words(names)}: {_UNSEEN[kind]}")
    if fit.rank < fit.seen.sum() and n_rows >= n_params:
        words.append(
            f"the regressors have rank {fit.rank} for {n_params} parameters; samples at other instants, a force at"
            " another place or of other frequencies, or fewer parameters would supply what is missing"
        )
    if fit.rank == n_params and fit.degrees_of_freedom == 0:
        words.append("as many equations as parameters: no residual is left to tell the noise from; add samples")
    outside = (fit.values <= unknown.transforms.lower) | (fit.values >= unknown.transforms.upper)
    if outside.any():
        words.append(
            f"outside the declared range: {join_words([unknown.names[i] for i in np.flatnonzero(outside)])};"
            " least squares does not impose it, and noise or a wrong model is the usual cause"
        )
    words.append(
        f"rank {fit.rank} of {n_params}, condition {fit.condition:.3g} with unit columns, residual"
        f" {np.sqrt(fit.residual_variance):.3g} RMS over {fit.degrees_of_freedom} degrees of freedom"
    )
    return words


def _bias_words(equations: TimeEquations, fit: LinearFit, bias: FloatArray | None) -> list[str]:
    """Sentences on the predicted `bias` (n_params,) of the parameters of `fit`, in their units, by noise of the motion.

    The first names the parameter with the largest bias relative to its value; a second those with a bias above half of
    their value, if any. One general sentence if `bias` is None.
    """
    if bias is None:
        return [_BIAS]
    relative = np.abs(bias / fit.values)
    worst = int(np.argmax(relative))
    words = [
        f"predicted bias from the noise of the motion: up to {relative[worst]:.2g} of {equations.unknown.names[worst]}"
    ]
    swamped = np.flatnonzero(relative > _SWAMPED)
    if len(swamped):
        words.append(
            f"the motion does not rise above its noise for {join_words([equations.unknown.names[i] for i in swamped])};"
            " measure it better, excite it more, or take the displacements from a better sensor than an integral"
        )
    return words


def _identifiability(equations: TimeEquations, fit: LinearFit) -> Identifiability:
    """Rank, condition and undetermined directions of relative changes of the parameters, by a linear fit.

    A parameter that no equation holds is a direction of its own with infinite standard deviation, has a singular value
    of 0, and makes the condition infinite.
    """
    unknown = equations.unknown
    values = np.where(np.isfinite(fit.values) & (fit.values != 0), fit.values, unknown.start)
    values = np.where(values != 0, values, 1.0)
    noise = np.sqrt(fit.residual_variance)
    sigma = noise if noise > 0 else 1.0
    seen = np.flatnonzero(fit.seen)
    relative = fit.triangle[:, seen] * np.abs(values[seen]) / sigma
    part = identifiability(relative, values[seen], tuple(unknown.names[i] for i in seen))
    directions = []
    for i in np.flatnonzero(~fit.seen):
        unit = np.zeros(unknown.n_params)
        unit[i] = 1.0
        directions.append(Direction(unit, float("inf"), f"{unknown.names[i]} not at all"))
    for item in part.directions:
        vector = np.zeros(unknown.n_params)
        vector[seen] = item.vector
        directions.append(Direction(vector, item.relative_std, item.words))
    singular = np.concatenate([part.singular_values, np.zeros(unknown.n_params - len(seen))])
    condition = part.condition if len(seen) == unknown.n_params else float("inf")
    return Identifiability(part.rank, condition, singular, tuple(directions))
