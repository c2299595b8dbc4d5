"""Constraints of a structure: supports, rigid links and multi-point constraints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.core.errors import InputError
from structid.fem.elements.element import dof_code, dof_of_code

DofEquations = dict[int, dict[int, float]]


@dataclass(frozen=True, eq=False)
class FollowingDofs:
    """Very many degrees of freedom that follow the same others.

    Attributes
    ----------
    dependents, masters : (n_dependents,), (n_masters,) int arrays
        Codes.
    matrix : (n_dependents, n_masters) float array
        Motion of each dependent for a unit motion of each master.
    """

    dependents: IntArray
    masters: IntArray
    matrix: FloatArray


class Tie(Protocol):
    """Anything that makes degrees of freedom depend on others."""

    @property
    def name(self) -> str: ...

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Equations of the dependent degrees of freedom: {dependent code: {code that it follows: coefficient}}.

        `positions` of nodes in m; `active` are the directions in which nodes move.
        """
        ...


@dataclass(frozen=True)
class RigidLink:
    """Nodes that move with a main node as one rigid body: u = u_main + rotation x (position - position_main).

    Parameters
    ----------
    name : str
        Name of the link.
    main : int
        Node that carries the motion.
    dependents : tuple of int
        Nodes that follow it.
    directions : tuple of str, optional
        In which they follow it; in every active direction by default. X, Y and RZ make a floor that is rigid in its plane.
    """

    name: str
    main: int
    dependents: tuple[int, ...]
    directions: tuple[str, ...] | None = None

    def __init__(
        self,
        name: str,
        main: int,
        dependents: int | Iterable[int],
        directions: str | Iterable[str] | None = None,
    ) -> None:
        """A link called `name` by which the nodes `dependents` follow the node `main` rigidly.

        They do so in the given `directions`, or in every active direction if None.

        Raises
        ------
        InputError
            If there are no dependent nodes, `main` is among them, or a direction is unknown.
        """
        nodes = (dependents,) if isinstance(dependents, int) else tuple(int(n) for n in dependents)
        if not nodes or main in nodes:
            raise InputError(f"rigid link {name!r} needs dependent nodes other than its main node {main}, got {nodes}")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "main", int(main))
        object.__setattr__(self, "dependents", nodes)
        named = (directions,) if isinstance(directions, str) else directions
        chosen = None if named is None else tuple(d.upper() for d in named)
        if chosen is not None and not (chosen and set(chosen) <= set(DIRECTIONS)):
            raise InputError(f"`directions` of rigid link {name!r} must be among {' '.join(DIRECTIONS)}, got {chosen}")
        object.__setattr__(self, "directions", chosen)

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Equations of the dependent nodes: {dependent code: {code of the main node: coefficient}}.

        A code is 6 times the label of a node plus 0 to 5 for X to RZ. `positions` in m; `active` are the directions in
        which nodes move, of which those of the link, if it names some, count.
        """
        result: DofEquations = {}
        for node in self.dependents:
            arm = np.zeros(3)
            difference = positions[node] - positions[self.main]
            arm[: len(difference)] = difference
            motion = np.eye(6)
            motion[:3, 3:] = [[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]]
            for direction in (d for d in active if self.directions is None or d in self.directions):
                row = motion[DIRECTIONS.index(direction)]
                result[dof_code(node, direction)] = {
                    dof_code(self.main, d): float(row[DIRECTIONS.index(d)]) for d in active if row[DIRECTIONS.index(d)]
                }
        return result


@dataclass(frozen=True)
class Constraint:
    """One degree of freedom as a weighted sum of others (a multi-point constraint).

    Parameters
    ----------
    name : str
        Name of the constraint.
    dependent : Dof
        Degree of freedom that follows.
    depends_on : tuple of (Dof, float)
        Degrees of freedom that it follows, with their coefficients.
    """

    name: str
    dependent: Dof
    depends_on: tuple[tuple[Dof, float], ...]

    def __init__(self, name: str, dependent: str | Dof, depends_on: Iterable[tuple[str | Dof, float]]) -> None:
        """A constraint called `name`: `dependent` is a weighted sum of other degrees of freedom.

        `depends_on` are pairs of a degree of freedom and its coefficient; `InputError` unless all are finite.
        """
        pairs = tuple((parse_dof(d), float(c)) for d, c in depends_on)
        if not all(np.isfinite(c) for _, c in pairs):
            raise InputError(f"coefficients of constraint {name!r} must be finite, got {[c for _, c in pairs]}")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "dependent", parse_dof(dependent))
        object.__setattr__(self, "depends_on", pairs)

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Equation of the constraint with the signs of its dofs: {dependent code: {other code: coefficient}}.

        A code is 6 times the label of a node plus 0 to 5 for X to RZ. `positions` and `active` are not needed; repeated
        degrees of freedom are summed.
        """
        dependent = self.dependent
        others: dict[int, float] = {}
        for dof, coefficient in self.depends_on:
            code = dof_code(dof.node, dof.direction)
            others[code] = others.get(code, 0.0) + dependent.sign * dof.sign * coefficient
        return {dof_code(dependent.node, dependent.direction): others}


@dataclass(frozen=True)
class MiddleNode:
    """A node that moves as the mean of the two corners beside it, so that its side stays straight.

    Parameters
    ----------
    name : str
    label : int
    ends : (int, int)
    directions : tuple of str
        Directions in which its elements move.
    """

    name: str
    label: int
    ends: tuple[int, int]
    directions: tuple[str, ...] = ("X", "Y", "Z")

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Own codes with those of the ends; see `Tie.equations`."""
        return {
            dof_code(self.label, d): {dof_code(end, d): 0.5 for end in self.ends}
            for d in self.directions
            if d in active
        }


@dataclass(frozen=True)
class Base:
    """Supports that drive the structure with one motion: a shaking table, the ground under a building.

    A record whose input is at one of them has the acceleration of that support in place of a force; all supports of the
    base then move alike, and all others stay at rest. For records without such an input, and for modes, they are held.
    What the ground holds without a node, such as a spring with one end, does not move.

    Parameters
    ----------
    name : str
        Name of the base.
    supports : tuple of Dof
        Held degrees of freedom, such as ``1X``; one that points the other way, ``2X-``, moves against the others.
    """

    name: str
    supports: tuple[Dof, ...]

    def __init__(self, name: str, supports: str | Dof | Iterable[str | Dof]) -> None:
        """A base called `name`: supported degrees of freedom that one measured motion drives.

        The structure fixes these `supports`; `InputError` if there are none.
        """
        named = (supports,) if isinstance(supports, str | Dof) else tuple(supports)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "supports", tuple(parse_dof(dof) for dof in named))
        if not self.supports:
            raise InputError(f'base {name!r} has no support; name what moves, as in `supports = ["1X", "2X"]`')

    def moves(self, dof: Dof) -> bool:
        """True if `dof` is one of its supports."""
        return any(support.unsigned == dof.unsigned for support in self.supports)

    @property
    def ties(self) -> tuple[Constraint, ...]:
        """Constraints by which all supports follow the first."""
        first, *others = self.supports
        return tuple(Constraint(f"base {self.name}", other, [(first, 1.0)]) for other in others)


def tie_equations(ties: Sequence[Tie], positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
    """All equations of `ties`: {dependent code: {code that it follows: coefficient}}.

    A code is 6 times the label of a node plus 0 to 5 for X, Y, Z, RX, RY, RZ. `positions` of nodes in m; `active` are
    the directions in which nodes move.

    Raises
    ------
    InputError
        If two ties claim the same degree of freedom.
    """
    equations: DofEquations = {}
    for tie in ties:
        for code, others in tie.equations(positions, active).items():
            if code in equations:
                raise InputError(
                    f"{dof_of_code(code).unsigned} depends twice, the second time by {tie.name!r}; drop one"
                )
            equations[code] = others
    return equations


def tied_codes(equations: DofEquations) -> IntArray:
    """Codes (n,) of all degrees of freedom that take part in the equations of ties, dependent or not."""
    codes = {code for dependent, others in equations.items() for code in (dependent, *others)}
    return np.array(sorted(codes), dtype=np.int64)
