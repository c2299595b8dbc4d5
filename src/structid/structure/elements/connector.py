"""Springs and dashpots between two degrees of freedom, or from one to the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray, locked
from structid.dof import Dof, parse_dofs
from structid.errors import InputError
from structid.structure.elements.element import Positions, Term, dof_code, property_values, set_fields

Ends = Sequence[str | Dof] | str | Dof


def connector_ends(name: str, first: Ends, second: Ends | None) -> tuple[tuple[Dof, ...], tuple[Dof, ...] | None]:
    """Both ends of every connector as degrees of freedom; the second is None for the ground."""
    start = parse_dofs([first] if isinstance(first, str | Dof) else first)
    if not start:
        raise InputError(f"`first` of {name!r} must name at least one degree of freedom")
    if second is None:
        return start, None
    end = parse_dofs([second] if isinstance(second, str | Dof) else second)
    if len(end) != len(start):
        raise InputError(f"`second` of {name!r} must have as many entries as `first` ({len(start)}), got {len(end)}")
    for a, b in zip(start, end, strict=True):
        if a.is_rotation != b.is_rotation:
            raise InputError(f"{name!r} connects a translation with a rotation: {a} and {b}")
        if a.unsigned == b.unsigned:
            raise InputError(f"{name!r} connects {a} with itself; leave `second` out for the ground")
    return start, end


def connector_matrices(first: tuple[Dof, ...], second: tuple[Dof, ...] | None) -> tuple[IntArray, FloatArray]:
    """Codes and matrices d d' with d = +1 at the first end and -1 at the second, each times the sense of its `Dof`."""
    columns = [first] if second is None else [first, second]
    codes = np.array([[dof_code(d.node, d.direction) for d in ends] for ends in columns]).T
    jump = np.array([[d.sign for d in ends] for ends in columns], dtype=np.float64).T
    if second is not None:
        jump[:, 1] *= -1
    return codes, jump[:, :, None] * jump[:, None, :]


def connector_nodes(first: tuple[Dof, ...], second: tuple[Dof, ...] | None) -> IntArray:
    """Node labels, (n, 2); -1 for the ground."""
    ends = [-1] * len(first) if second is None else [d.node for d in second]
    return locked(np.array([[d.node for d in first], ends]).T, np.int64)


def connector_unit(dofs: tuple[Dof, ...], translation: str, rotation: str) -> str:
    """The unit that fits all `dofs`; both where they mix."""
    units = {rotation if dof.is_rotation else translation for dof in dofs}
    return units.pop() if len(units) == 1 else f"{translation} or {rotation}"


@dataclass(frozen=True, eq=False)
class Spring:
    """Springs between pairs of degrees of freedom, or to the ground.

    Parameters
    ----------
    name : str
        Name of the set.
    first : degree of freedom or sequence of them
        One end of each spring, such as ``"1X"``.
    second : the same, optional
        The other end; the ground where left out.
    stiffness : float or (n_elements,)
        N/m, or N m/rad between rotations.
    loss_factor : float or (n_elements,)
        Structural damping: stiffness times (1 + i loss_factor).
    """

    name: str
    first: tuple[Dof, ...]
    second: tuple[Dof, ...] | None
    stiffness: FloatArray
    loss_factor: FloatArray
    nodes: IntArray

    def __init__(
        self, name: str, first: Ends, second: Ends | None = None, *, stiffness: ArrayLike, loss_factor: ArrayLike = 0.0
    ) -> None:
        start, end = connector_ends(name, first, second)
        values = property_values(name, "stiffness", stiffness, len(start))
        loss = property_values(name, "loss_factor", loss_factor, len(start))
        nodes = connector_nodes(start, end)
        set_fields(self, name=name, first=start, second=end, stiffness=values, loss_factor=loss, nodes=nodes)

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        codes, local = connector_matrices(self.first, self.second)
        unit = connector_unit(self.first, "N/m", "N m/rad")
        return (
            Term("stiffness", "stiffness", unit, self.stiffness, codes, local),
            Term("loss_factor", "loss_factor", "1", self.loss_factor),
        )


@dataclass(frozen=True, eq=False)
class Dashpot:
    """Viscous dashpots between pairs of degrees of freedom, or to the ground.

    Parameters
    ----------
    name : str
        Name of the set.
    first : degree of freedom or sequence of them
        One end of each dashpot.
    second : the same, optional
        The other end; the ground where left out.
    viscous_damping : float or (n_elements,)
        N s/m, or N m s/rad between rotations.
    """

    name: str
    first: tuple[Dof, ...]
    second: tuple[Dof, ...] | None
    viscous_damping: FloatArray
    nodes: IntArray

    def __init__(self, name: str, first: Ends, second: Ends | None = None, *, viscous_damping: ArrayLike) -> None:
        start, end = connector_ends(name, first, second)
        values = property_values(name, "viscous_damping", viscous_damping, len(start))
        set_fields(self, name=name, first=start, second=end, viscous_damping=values, nodes=connector_nodes(start, end))

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        codes, local = connector_matrices(self.first, self.second)
        unit = connector_unit(self.first, "N s/m", "N m s/rad")
        return (Term("viscous_damping", "viscous_damping", unit, self.viscous_damping, codes, local),)
