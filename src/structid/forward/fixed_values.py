"""The values that a model holds as unknowns of their own, so that residuals tell how they change with each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from scipy import sparse

from structid.core.arrays import locked
from structid.forward.channel_errors import ChannelErrors, ChannelsOfRecord, ChannelUnknown, channel_errors
from structid.forward.record_problem import RecordProblem
from structid.inversion.fixed_values import FIXED
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import N, NamedUnknowns, Transform, Transforms, join_unknowns
from structid.unknowns.priors import no_priors
from structid.unknowns.tolerances import FixedProperty, Tolerances, fixed_properties, relative_sensitivities


def with_fixed_values(
    problem: RecordProblem, tolerances: Tolerances, calibration: float | None = None, record: str = "record"
) -> RecordProblem:
    """Problem with a factor on every fixed model value as a further unknown, 1 within its tolerance.

    Names are such as ``fixed mass[deck]``, and ``fixed calibration[record 1]`` for the common gain of a record. The
    logarithm of a factor has a Gaussian prior with the tolerance as standard deviation. If the structure has no
    matrices only the gain is added; no gain is added for a tolerance of 0 or without measured responses.

    Parameters
    ----------
    problem : RecordProblem
        Left as it is.
    tolerances : Tolerances
        Relative standard deviation of the fixed values, by property.
    calibration : float, optional
        Relative standard deviation of the common gain of this record; that of `tolerances` by default.
    record : str
        Name of the record in the name of the gain.
    """
    if problem.structure.has_matrices:
        fixed = fixed_properties(problem.structure, problem.parameters, tolerances)
        problem = problem.with_parameters(append_fixed_factors(problem.parameters, fixed))
    gain = tolerances.calibration if calibration is None else calibration
    if gain == 0 or problem.measured_responses is None:
        return problem
    return problem.with_channels(_with_gain(problem, problem.measured_responses, gain, record))


def tolerances_of(freed: Sequence[RecordProblem]) -> dict[str, float]:
    """Tolerance of each fixed value among the unknowns of the problems `freed`, by the name of the unknown."""
    priors = [
        (part.names, part.free_prior[1].tolist())
        for problem in freed
        for part in problem.parts
        if part.free_prior is not None
    ]
    pairs = [pair for names, deviations in priors for pair in zip(names, deviations, strict=True)]
    return {name: float(std) for name, std in pairs if name.startswith(FIXED)}


def append_fixed_factors(parameters: Parameters, fixed: tuple[FixedProperty, ...]) -> Parameters:
    """Parameters followed by a factor on each of the properties `fixed`, with start 1; values at the start stay."""
    columns = relative_sensitivities(parameters.offset, fixed)
    factors = _unit_factors(*([getattr(item, name) for item in fixed] for name in ("label", "kind", "tolerance")))
    return replace(
        _append_unknowns(parameters, factors),
        elements=(*parameters.elements, *((item.element,) for item in fixed)),
        offset=locked(parameters.offset - columns.sum(axis=1)),  # so that factors of 1 leave every value as it is
        design=sparse.csc_array(sparse.hstack([parameters.design, sparse.csc_array(columns)])),
    )


def _with_gain(problem: RecordProblem, measured: ChannelsOfRecord, tolerance: float, record: str) -> ChannelErrors:
    """Channel errors of a problem followed by a common gain of all sensors, with `tolerance` as its deviation.

    `record` is the name of the record in that of the gain.
    """
    common = channel_errors(measured, [ChannelUnknown("gain", "all", name="all")])
    errors = channel_errors(measured, []) if problem.channels is None else problem.channels
    return replace(
        _append_unknowns(errors, _unit_factors([f"calibration[{record}]"], ["gain"], [tolerance])),
        of_outputs=locked(np.concatenate([errors.of_outputs, common.of_outputs]), bool),
        of_inputs=locked(np.concatenate([errors.of_inputs, common.of_inputs]), bool),
    )


def _unit_factors(names: Sequence[str], kinds: Sequence[str], tolerances: Sequence[float]) -> NamedUnknowns:
    """Positive unknown factors that start at 1, with Gaussian priors of mean 0 on their logarithms.

    `names` (without prefix), `kinds` and `tolerances`, the standard deviations, have one entry for each factor.
    """
    n = len(names)
    kept_positive: tuple[Transform, ...] = tuple("log" for _ in names)
    return NamedUnknowns(
        names=tuple(FIXED + name for name in names),
        kinds=tuple(kinds),
        units=("1",) * n,
        start=locked(np.ones(n)),
        transforms=Transforms(kept_positive, locked(np.zeros(n)), locked(np.full(n, np.inf))),
        priors=no_priors(n),
        scale=locked(np.zeros(n)),
        free_prior=(np.zeros(n), np.array(tolerances, dtype=np.float64)),
    )


def _append_unknowns(first: N, second: NamedUnknowns) -> N:
    """A copy of `first` with the unknowns of `second` appended; all its other fields stay."""
    both = join_unknowns(first, second)
    return replace(first, **{item.name: getattr(both, item.name) for item in fields(NamedUnknowns)})
