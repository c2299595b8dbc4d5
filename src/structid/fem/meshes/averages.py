"""Mean motions of nodes: RBE3 of Nastran, distributing couplings of Abaqus and CalculiX."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.fem.meshes.deck_parts import weights_along
from structid.fem.supports import Constraint

#: Condition of the normal equations from which on nodes do not determine a rigid motion.
_WORST = 1e12
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Component:
    """A component of the motion of a node that is averaged.

    Attributes
    ----------
    node : int
    axis : (3,) float array
        Its direction in global axes.
    is_rotation : bool
    weight : float
    """

    node: int
    axis: FloatArray
    is_rotation: bool
    weight: float


def rigid_motion(arm: FloatArray) -> FloatArray:
    """Motion at the end of an arm by that at its beginning, (6, 6): u + rotation x arm, and the rotation."""
    motion = np.eye(6)
    motion[:3, 3:] = [[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]]
    return motion


def mean_motion(
    reference: FloatArray, components: Sequence[Component], positions: Mapping[int, FloatArray]
) -> FloatArray | None:
    """Map (6, n_components) from components to the rigid motion at `reference` (3,) that fits them best.

    The fit is by least squares. The motion is translations, then rotations. Weights of rotations are multiplied by the
    square of the mean distance of the nodes, as in Nastran, so that those of translations and rotations compare.
    `positions` (3,) are those of all nodes by label. None if the components do not determine the motion.
    """
    nodes = list(dict.fromkeys(component.node for component in components))
    distances = [float(np.linalg.norm(positions[node] - reference)) for node in nodes]
    length = float(np.mean(distances)) or 1.0
    size = max(distances) or 1.0
    scale = np.array([1, 1, 1, 1 / size, 1 / size, 1 / size])
    rows, weights = [], []
    for component in components:
        motion = rigid_motion(positions[component.node] - reference)
        rows.append(component.axis @ motion[3:] if component.is_rotation else component.axis @ motion[:3])
        weights.append(component.weight * (length**2 if component.is_rotation else 1.0))
    table = np.array(rows) * scale
    normal = table.T @ (np.array(weights)[:, None] * table)
    if not np.linalg.cond(normal) < _WORST:
        return None
    mean: FloatArray = scale[:, None] * np.linalg.solve(normal, table.T * np.array(weights))
    return mean


def global_directions(axes: FloatArray, components: Sequence[int]) -> list[str] | None:
    """Global directions, such as "X", that span the same motions as some of a node's own; None if no global ones do.

    `axes` (3, 3) are its own directions as rows; `components` are those motions, 0 to 2 translations along them and 3
    to 5 rotations about them.
    """
    directions: list[str] = []
    for start in (0, 3):
        chosen = axes[[component - start for component in components if start <= component < start + 3]]
        projector = chosen.T @ chosen
        along = np.diag(projector) > 0.5
        if np.abs(projector - np.diag(along)).max() > 1e-9:
            return None
        directions += [DIRECTIONS[start + k] for k in np.flatnonzero(along).tolist()]
    return directions


EquationRow = dict[tuple[int, str], float]


def mean_rows(
    reference: int, axes: FloatArray, chosen: Sequence[int], components: Sequence[Component], mean: FloatArray
) -> list[EquationRow]:
    """Equations, each a sum that is 0: a component of the reference node less that of the mean motion in its direction.

    A row maps (node, direction) to its factor. `axes` (3, 3) are the reference node's own directions in global axes, as
    rows, and `chosen` its components (0 to 5: translations along these directions, then rotations about them); `mean`
    (6, n_components) leads from `components` to the mean rigid motion, translations first, in global axes.
    """
    rows = []
    for component in chosen:
        axis, is_rotation = axes[component % 3], component > 2
        row: EquationRow = dict(weights_along(reference, axis, is_rotation))
        factors = axis @ (mean[3:] if is_rotation else mean[:3])
        for factor, averaged in zip(factors, components, strict=True):
            for key, part in weights_along(averaged.node, averaged.axis, averaged.is_rotation, -float(factor)).items():
                row[key] = row.get(key, 0.0) + part
        rows.append(row)
    return rows


def solved_constraints(
    name: str, rows: Sequence[EquationRow], dependents: Sequence[tuple[int, str]]
) -> list[Constraint] | None:
    """Equations, each a sum of `rows` that is 0, solved for `dependents` (node, direction): one constraint for each.

    A row maps (node, direction) to its factor; every constraint is called `name`. None if there are not as many
    equations as dependents, or these are not determined.
    """
    others = list(dict.fromkeys(key for row in rows for key in row if key not in set(dependents)))
    table = np.array([[row.get(key, 0.0) for key in (*dependents, *others)] for row in rows])
    square, rest = table[:, : len(dependents)], table[:, len(dependents) :]
    if square.shape[0] != square.shape[1] or not np.linalg.cond(square) < _WORST:
        return None
    solution = -np.linalg.solve(square, rest)
    least = _ROUNDING * np.abs(solution).max(initial=0.0)
    return [
        Constraint(name, Dof(*key), [(Dof(*o), float(c)) for o, c in zip(others, line, strict=True) if abs(c) > least])
        for key, line in zip(dependents, solution, strict=True)
    ]


def solved_for_first(name: str, terms: Sequence[tuple[Dof, float]]) -> Constraint | None:
    """The equation that `terms`, pairs of degree of freedom and factor, add up to 0, solved for the first of them.

    Factors of one degree of freedom add up; None if those of the first add up to 0. The constraint is called `name`.
    """
    factors: dict[Dof, float] = {}
    for dof, factor in terms:
        factors[dof] = factors.get(dof, 0.0) + factor
    dependent = terms[0][0]
    pivot = factors.pop(dependent)
    return Constraint(name, dependent, [(dof, -factor / pivot) for dof, factor in factors.items()]) if pivot else None


def rigid_constraints(
    name: str, main: int, dependent: int, arm: FloatArray, axes: FloatArray, components: Sequence[int]
) -> list[Constraint] | None:
    """Constraints of a node that follows a main node rigidly in some of its own directions; None if these are oblique.

    Parameters
    ----------
    name : str
        Name of the constraints.
    main, dependent : int
        Node labels.
    arm : (3,) float array
        From the main node to the dependent one, m.
    axes : (3, 3) float array
        Own directions of the dependent node as rows; those that are used must span global ones.
    components : sequence of int
        0 to 5, translations and rotations along `axes`.
    """
    directions = global_directions(axes, components)
    if directions is None:
        return None
    motion = rigid_motion(arm)
    constraints = []
    for direction in directions:
        row = motion[DIRECTIONS.index(direction)]
        pairs = [(Dof(main, d), float(part)) for d, part in zip(DIRECTIONS, row, strict=True) if abs(part) > 0]
        constraints.append(Constraint(name, Dof(dependent, direction), pairs))
    return constraints
