"""Forces that always act together, such as the parts along X and Y of one shaker on a diagonal, as one force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.structure.structure import Structure
from structid.structure.supports import Constraint

#: Part of a force that is rounding.
_NOTHING = 1e-12


def together(values: FloatArray, tolerance: float = 1e-8) -> FloatArray | None:
    """The least number of series of which others are made, as columns of their parts; None where all are needed.

    Parameters
    ----------
    values : (n_samples, n_series) float array
    tolerance : float
        Smallest eigenvalue of the correlation matrix in parts of the largest, below which it counts as 0.

    Returns
    -------
    (n_series, n_joint) float array or None
        Orthonormal columns W; the joint series are ``values @ W`` and ``values = joint @ W.T``.
    """
    size = np.sqrt((values**2).mean(axis=0))
    if values.shape[1] < 2 or not (size > 0).all():
        return None
    strength, ways = np.linalg.eigh((values / size).T @ (values / size) / len(values))
    kept = strength > tolerance * strength[-1]
    if kept.all():
        return None
    parts: FloatArray = np.linalg.qr(size[:, None] * ways[:, kept])[0]
    return parts * np.where(parts.sum(axis=0) < 0, -1.0, 1.0)


def with_joint_forces(structure: Structure, made: Sequence[Dof], loads: Sequence[Dof], parts: FloatArray) -> Structure:
    """The structure with degrees of freedom `made`, one for each column of `parts` (n_loads, n_joint), at nodes that it lacks.

    Each moves as those do that its force acts on, by their work (a `Constraint`), and stands where most of it acts.
    """
    nodes, ties = dict(structure.nodes), list(structure.ties)
    for dof, column in zip(made, parts.T, strict=True):
        nodes[dof.node] = structure.nodes[loads[int(np.abs(column).argmax())].node]
        acting = [(load, float(part)) for load, part in zip(loads, column, strict=True) if abs(part) > _NOTHING]
        ties.append(Constraint(f"joint force {dof.node}", dof, acting))
    return replace(structure, nodes=nodes, ties=tuple(ties))
