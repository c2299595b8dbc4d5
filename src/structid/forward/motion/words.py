"""The `Estimate` of a fit of measured motion, with words on what is missing and what would supply it."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words
from structid.forward.motion.equations import TimeEquations
from structid.inversion import DenseCovariance, Direction, Estimate, Identifiability, Status
from structid.inversion.diagnostics.identifiability import identifiability
from structid.inversion.estimate import Goodness, ParameterValues, SearchRecord
from structid.inversion.regression.block_least_squares import BlockFit
from structid.inversion.regression.streaming_qr import LinearFit
from structid.inversion.uncertainty import Spread
from structid.unknowns import Parameters

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


def motion_estimate(
    equations: TimeEquations, fit: LinearFit, n_samples: int, bias: FloatArray | None = None
) -> Estimate:
    """Estimate with covariance, status and words from a linear fit to motion; `bias` (n_params,) if it was predicted.

    A parameter is identified if its standard deviation is at most its size and its bias at most half of it. `n_samples`
    is the number of samples that were fitted.
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

    `n_rows` is the number of equations, `n_samples` that of instants.
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
    """Sentences on the predicted `bias` (n_params,) by noise of the motion; a general one if it is None.

    Parameters with a bias above half of their value are named.
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
    """Rank, condition and undetermined directions of relative parameter change of the linear fit."""
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
