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


def fixed_value_sensitivities(model: TestedModel, identification: Identification) -> tuple[FixedValueSensitivity, ...]:
    """Sensitivity of an answer to every fixed mass and stiffness, by linearization with all of them free.

    Parameters
    ----------
    model : TestedModel
        Set-ups and options of the identification.
    identification : Identification

    Returns
    -------
    tuple of FixedValueSensitivity
        Empty for models of more than `MOST_DOFS` degrees of freedom, for searches without a Jacobian, and if nothing is fixed.
        Values that cannot be freed are left out.
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
    several = influences(rows, at.residual, free, names, (estimate.std / sizes)[estimate.spread.is_free], scale)
    return tuple(replace(one, tolerance=tolerances.get(one.name, 0.0)) for one in several)


def _free_fixed_values(
    model: TestedModel, identification: Identification, fixed: Sequence[FixedValue], known: dict[str, float]
) -> Problem | None:
    """The joint problem with the fixed values `fixed` among its unknowns, started at the answer; None where that fails.

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
