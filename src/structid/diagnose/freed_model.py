"""Sensitivity of an answer to the values that its model fixes, by the model with all of them free at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.core.errors import StructidError
from structid.diagnose.causes.fixed_value import FixedValue, fixed_values
from structid.diagnose.causes.places import MOST_DOFS
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, influences
from structid.diagnose.modified_model import prepared_problems, started_at, weighed_like
from structid.diagnose.tested_model import ModelDraft, TestedModel
from structid.diagnose.verdict import fits_noise
from structid.forward.scatter import scatter_problems
from structid.identification.identified import Identification
from structid.identification.joint_problem import joint_problem
from structid.inversion import Problem
from structid.inversion.uncertainty import relative_steps

#: All fixed stiffnesses by one factor, and the part of the clearness of another fixed value at which they are as clear.
_EVERY, _EQUAL = "every fixed stiffness", 1e-6


def fixed_value_sensitivities(model: TestedModel, identification: Identification) -> tuple[FixedValueSensitivity, ...]:
    """Sensitivity of an answer to every fixed mass and stiffness, by linearization with all of them free.

    Parameters
    ----------
    model : TestedModel
        Set-ups and options of the identification.
    identification : Identification
        The answer.

    Returns
    -------
    tuple of FixedValueSensitivity
        In the order of the properties. Empty for models of more than 1200 degrees of freedom or without matrices, for
        searches without a Jacobian, and if nothing is fixed. Values that cannot be freed, and those that the data do
        not see, are left out. The standard deviation of the change that the record asks for is NaN where the residual
        is not noise.
    """
    setup, estimate = model.setups[0], identification.estimate
    is_small = setup.structure.n_dofs <= MOST_DOFS and identification.target is not None
    if not is_small or not estimate.uncertainty.has_matrix or not setup.structure.has_matrices:
        return ()
    fixed = fixed_values(setup.structure, setup.parameters)
    known = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    target = _free_fixed_values(model, identification, fixed, known)
    if target is None:  # what can be freed, one by one
        fixed = tuple(one for one in fixed if _free_fixed_values(model, identification, (one,), known) is not None)
        target = _free_fixed_values(model, identification, fixed, known)
    if target is None or not fixed:
        return ()
    theta = target.theta_start
    at = target.linearize(theta)
    index = {name: i for i, name in enumerate(target.names)}
    free = [name for name, is_free in zip(estimate.names, estimate.spread.is_free, strict=True) if is_free]
    names = [name for name in target.names if name not in known]
    columns = [index[name] for name in (*free, *names)]
    scale = 1.0 if fits_noise(identification) else np.nan  # what a wrong model pulls at says nothing of a fixed value
    sizes = target.unknowns.sizes(target.physical(theta))[[index[name] for name in estimate.names]]
    tolerances = {} if estimate.fixed is None else dict(
        zip(estimate.fixed.names, estimate.fixed.tolerance.tolist(), strict=True)
    )  # fmt: skip
    rows = (at.jacobian * relative_steps(target, theta))[:, columns]
    std = (estimate.std / sizes)[estimate.spread.is_free]
    several = tuple(
        replace(one, tolerance=tolerances.get(one.name, 0.0))
        for one in influences(rows, at.residual, free, names, std, scale)
    )
    kinds = dict(zip(target.names, target.unknowns.kinds, strict=True))
    is_stiffness = np.array([kinds[name] == "stiffness" for name in (*free, *names)])
    is_held = np.arange(len(columns)) >= len(free)
    sought, held = is_stiffness & ~is_held, is_stiffness & is_held
    if not (
        sought.any() and held.any() and all(one.facts.takes_clock_for_stiffness for one in identification.problems)
    ):
        return several
    together = np.column_stack([rows[:, ~is_held], rows[:, held].sum(axis=1)])
    return _marked(
        several,
        influences(together, at.residual, free, [_EVERY], std, scale),
        [names[i] for i in np.flatnonzero(held[is_held])],
    )


def _marked(
    several: tuple[FixedValueSensitivity, ...], together: tuple[FixedValueSensitivity, ...], stiffnesses: Sequence[str]
) -> tuple[FixedValueSensitivity, ...]:
    """Copy of `several` in which the clearest of the fixed `stiffnesses` gets the pull at all of them as `clock_pull`.

    `together` has the sensitivity to one factor on all of them, or is empty. The copy is plain where a single fixed
    value explains more than all together do, or no fixed stiffness has a known pull. The clearest has the largest pull
    in its standard deviations.
    """
    clear = [abs(one.pull / one.pull_std) for one in (*several, *together)]
    seen = [i for i, one in enumerate(several) if one.name in stiffnesses and np.isfinite(clear[i])]
    if not together or not seen or not clear[-1] >= (1 - _EQUAL) * np.nanmax(clear):
        return several
    first = max(seen, key=lambda i: clear[i])
    return tuple(replace(one, clock_pull=together[0].pull) if i == first else one for i, one in enumerate(several))


def _free_fixed_values(
    model: TestedModel, identification: Identification, fixed: Sequence[FixedValue], known: dict[str, float]
) -> Problem | None:
    """Joint problem with the values `fixed` among its unknowns, started at the answer; None if that fails.

    `known` has the identified values by parameter name.
    """
    draft = ModelDraft(model)
    try:
        for value in fixed:
            for edit in value.edits(model, 1.0):
                edit.apply(draft)
        freed = draft.build()
        before = list(zip(model.setups, identification.problems, strict=True))
        problems = prepared_problems(freed, before, model.options)
        problems = weighed_like(problems, identification.problems, scatter_problems(identification.problems))
        return joint_problem([started_at(one, known) for one in problems])
    except (StructidError, np.linalg.LinAlgError):
        return None  # some property has no place among the unknowns
