"""Ratios of parameters, which modes and support motions determine without a force; the common scale stays free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.forward import FrfProblem
from structid.inversion import Estimate, Problem
from structid.inversion.uncertainty import relative_jacobian

_NULL = 1e-10
_SEEN = 1e-6
#: Relative change of FRFs, and part of it by which that of the parameters may differ from it.
_STEP, _ALIKE = 1e-6, 1e-4
_INERTIAS = ("mass", "rotary_inertia")
_SCALED = (*_INERTIAS, "stiffness", "axial_force", "viscous_damping")
#: What that the scale is the force's means.
ON_FORCE = (
    "no known mass, stiffness or prior fixes the scale of the values: an error of 1 % in the calibration of the force is one of"
    " 1 % in every mass, stiffness and damping"
)


@dataclass(frozen=True, eq=False)
class Ratios:
    """Parameters over one of them, with intervals that the free common scale does not widen.

    Attributes
    ----------
    names : tuple of str
        All parameters that share the free scale, the reference last left out.
    reference : str
        The parameter that they are divided by.
    values, std : (n_ratios,) float arrays
        Ratio in the units of both, and its standard deviation; NaN where the data do not determine it.
    ends : (n_ratios, 2) float array
        95 % intervals: of the logarithm, taken to the ratio.
    words : str
        A sentence for the reader.
    """

    names: tuple[str, ...]
    reference: str
    values: FloatArray
    std: FloatArray
    ends: FloatArray
    words: str


def ratios(problem: Problem, estimate: Estimate) -> Ratios | None:
    """Ratios of the parameters where data and priors leave their common scale free; None where they determine it.

    The scale is free if none of the masses, stiffnesses and dampings is identified and the data do not see a common
    relative change of all. The reference is the first mass or, without a mass, the first rotary inertia. Standard
    deviations and 95 % intervals are of the ratios, NaN where the data do not determine one.

    Parameters
    ----------
    problem : Problem
        The joint problem of all records.
    estimate : Estimate
        Estimate of that problem.
    """
    theta = np.asarray(estimate.theta)
    jacobian = relative_jacobian(problem, theta, problem.linearize(theta))
    scale = max(1.0, np.sqrt(estimate.chi_square_per_dof)) if estimate.covariance_basis == "model_error" else 1.0
    members = common_scale(jacobian, estimate.kinds, scale)
    if members is None or estimate.identified[members].any():
        return None
    reference = int(next(i for kind in _INERTIAS for i in members if estimate.kinds[i] == kind))
    others = np.array([i for i in members if i != reference])
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(rows) - len(singular))])
    relative = scale * np.array([_std(i, reference, singular, rows) for i in others])
    values = estimate.values[others] / estimate.values[reference]
    ends = values[:, None] * np.exp(1.959964 * relative[:, None] * np.array([-1.0, 1.0]))
    return Ratios(
        tuple(estimate.names[i] for i in others),
        estimate.names[reference],
        locked(values),
        locked(values * relative),
        locked(ends),
        scale_words([estimate.names[i] for i in members], estimate.names[reference]),
    )


def scale_from_force(problems: Sequence[Problem], estimate: Estimate) -> bool:
    """True if only measured forces determine the common scale of masses, stiffnesses and dampings, in all `problems`.

    An error of the load cell is then an error of all values. It is so where every problem is one of FRFs with measured
    forces (not of the residual ``equation``), these shrink in proportion to a common increase at `estimate`, and no
    prior of these parameters is stated. False without problems.
    """
    for problem in problems:
        if not isinstance(problem, FrfProblem) or problem.form == "equation" or not problem.facts.measures_force:
            return False
        theta = np.asarray(estimate.theta[[estimate.names.index(name) for name in problem.names]])
        members = _scaled(problem.unknowns.kinds)
        if problem.unknowns.priors.stated[members].any():
            return False
        frf = problem.predicted(theta)
        gained = (problem.data_rows((1 + _STEP) * frf) - problem.data_rows(frf)) / _STEP
        scaled = relative_jacobian(problem, theta, problem.linearize(theta))[:, members].sum(axis=1)
        if np.linalg.norm(scaled + gained) > _ALIKE * np.linalg.norm(gained):
            return False
    return bool(problems)


def common_scale(jacobian: FloatArray, kinds: Sequence[str], noise_scale: float = 1.0) -> np.ndarray | None:
    """Indices of masses, stiffnesses and dampings whose common scale the data do not see; None if they see it.

    The data do not see it if a common relative change, scaled to unit length over these parameters, changes the
    whitened data by no more than `noise_scale`. `jacobian` (n_data, n_params) is the whitened derivative by relative
    changes, `kinds` are those of the parameters. None also without a mass or rotary inertia, or without a stiffness or
    axial force, among them.
    """
    members = _scaled(kinds)
    scaled = {kinds[i] for i in members}
    if not scaled & {"stiffness", "axial_force"} or not scaled & set(_INERTIAS):
        return None
    change = np.linalg.norm(jacobian[:, members].sum(axis=1)) / np.sqrt(len(members))
    return members if change <= noise_scale else None


def _scaled(kinds: Sequence[str]) -> np.ndarray:
    """Indices (n,) of the parameters that a common scale of mass, damping and stiffness changes, from their `kinds`."""
    return np.flatnonzero(np.isin(kinds, _SCALED))


def scale_words(names: list[str], reference: str = "") -> str:
    """Sentence on what follows if the common scale of the parameters `names` is free.

    With `reference`, it says that ratios to this parameter are given.
    """
    stated = (
        f" Their ratios to {reference} are given with intervals that take fixed values as exact;" if reference else ""
    )
    return (
        "what is measured without a force gives ratios of stiffness to mass, not kilograms: one common scale of"
        f" {_listed(names)} is free.{stated or ' Ratios are determined as far as no other direction is free;'} a known"
        " mass, a prior or a record with a measured force fixes the scale"
    )


def _std(i: int, reference: int, singular: FloatArray, rows: FloatArray) -> float:
    """Standard deviation of log(p_i / p_reference) for unit noise; NaN if the data do not determine the ratio.

    `i` and `reference` are indices; `singular` and `rows` are the singular values and right singular vectors (as rows) of the
    Jacobian by relative changes.
    """
    contrast = np.zeros(len(rows))
    contrast[i], contrast[reference] = 1.0, -1.0
    parts = rows @ contrast
    seen = singular > _NULL * singular[0]
    if np.abs(parts[~seen]).max(initial=0.0) > _SEEN:
        return float("nan")
    return float(np.sqrt(np.sum((parts[seen] / singular[seen]) ** 2)))


def _listed(names: list[str]) -> str:
    """Names in a row with "and"; beyond six, the first five and the number of the others."""
    if len(names) > 6:
        return f"{', '.join(names[:5])} and {len(names) - 5} more"
    return ", ".join(names[:-1]) + " and " + names[-1]
