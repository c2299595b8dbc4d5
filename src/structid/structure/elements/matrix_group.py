"""A group of a model from another finite element code: whole matrices that scale together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, IntArray, locked
from structid.dof import Dof, parse_dofs
from structid.errors import InputError
from structid.structure.elements.element import Kind, Positions, Term, dof_code, property_values, set_fields

_KINDS: tuple[tuple[str, Kind], ...] = (("mass", "mass"), ("stiffness", "stiffness"), ("damping", "viscous_damping"))


@dataclass(frozen=True, eq=False)
class MatrixGroup:
    """Sparse matrices of one part of a structure; each is multiplied by a factor of nominal value 1.

    Parameters
    ----------
    name : str
        Name of the group.
    dofs : sequence of degrees of freedom
        What the rows of the matrices stand for.
    mass, stiffness, damping : (n_dofs, n_dofs) sparse or dense array, optional
        Symmetric; SI units.
    loss_factor : float
        Structural damping of `stiffness`.
    """

    name: str
    dofs: tuple[Dof, ...]
    matrices: dict[str, sparse.csc_array]
    loss_factor: FloatArray
    nodes: IntArray

    def __init__(
        self,
        name: str,
        dofs: Sequence[str | Dof],
        mass: Any = None,
        stiffness: Any = None,
        damping: Any = None,
        loss_factor: float = 0.0,
    ) -> None:
        parsed = parse_dofs(dofs)
        matrices = {}
        for key, given in (("mass", mass), ("stiffness", stiffness), ("damping", damping)):
            if given is not None:
                matrices[key] = _symmetric(name, key, given, len(parsed))
        if not matrices:
            raise InputError(f"group {name!r} has no matrix; give `mass`, `stiffness` or `damping`")
        loss = property_values(name, "loss_factor", loss_factor, 1)
        nodes = locked(np.unique([d.node for d in parsed])[None, :], np.int64)
        set_fields(self, name=name, dofs=parsed, matrices=matrices, loss_factor=loss, nodes=nodes)

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        sign = sparse.diags_array([float(d.sign) for d in self.dofs])
        terms = []
        for key, kind in _KINDS:
            if key in self.matrices:
                matrix = sparse.csc_array(sign @ self.matrices[key] @ sign)
                terms.append(Term(key, kind, "1", np.ones(1), codes, matrices=(matrix,)))
        if "stiffness" in self.matrices:
            terms.append(Term("loss_factor", "loss_factor", "1", self.loss_factor))
        return tuple(terms)


def _symmetric(group: str, name: str, given: Any, size: int) -> sparse.csc_array:
    matrix = sparse.csc_array(given, dtype=np.float64)
    if matrix.shape != (size, size):
        raise InputError(f"`{name}` of group {group!r} must be ({size}, {size}) like its dofs, got {matrix.shape}")
    if not np.isfinite(matrix.data).all():
        raise InputError(f"`{name}` of group {group!r} must be finite; it holds NaN or infinite entries")
    asymmetry = abs(matrix - matrix.T).max() if matrix.nnz else 0.0
    if asymmetry > 1e-8 * max(abs(matrix).max(), np.finfo(float).tiny):
        raise InputError(
            f"`{name}` of group {group!r} must be symmetric, got entries that differ by {asymmetry:.3g};"
            " if only one triangle is stored, add the other"
        )
    return matrix
