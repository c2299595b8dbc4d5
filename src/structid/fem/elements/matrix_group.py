"""A group of a model from another finite element code: whole matrices that scale together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, TypeAlias, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import IntArray, locked
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    Given,
    Kind,
    Matrices,
    NodeCoordinates,
    Nodes,
    PropertyMatrices,
    Values,
    declared,
    dof_code,
    element,
)

#: Sparse or dense.
AnyMatrix: TypeAlias = sparse.sparray | sparse.spmatrix | ArrayLike
Rows: TypeAlias = Annotated[Given[Iterable[str | Dof], tuple[Dof, ...]], "sequence of degrees of freedom"]
Matrix: TypeAlias = Annotated[
    Given[AnyMatrix, sparse.csc_array | None], "(n_dofs, n_dofs) sparse or dense array, optional"
]
_KINDS: dict[str, Kind] = {"mass": "mass", "stiffness": "stiffness", "damping": "viscous_damping"}


def _sparse(name: str, matrix: AnyMatrix) -> sparse.csc_array:
    return sparse.csc_array(matrix, dtype=np.float64)


class GroupMatrices(TypedDict, total=False):
    """Arguments of `MatrixGroup` beside its name and degrees of freedom."""

    mass: AnyMatrix
    stiffness: AnyMatrix
    damping: AnyMatrix
    loss_factor: ArrayLike


@element
class MatrixGroup(ElementSet):
    """Sparse matrices of one part of a structure; each is multiplied by a factor of nominal value 1."""

    nodes: Nodes = declared("Nodes of the rows, in order, as one element", init=False)
    dofs: Rows = declared("What the rows of the matrices stand for")
    mass: Matrix = declared("Symmetric, SI units", stored=_sparse, default=None)
    stiffness: Matrix = declared("Likewise", stored=_sparse, default=None)
    damping: Matrix = declared("Likewise", stored=_sparse, default=None)
    loss_factor: Values = declared("Structural damping of `stiffness`", "loss_factor", "1", default=0.0)

    def __post_init__(self) -> None:
        """Derive the nodes from the rows, and check that the matrices are finite, symmetric and of their size.

        Raises `InputError` otherwise, and if no matrix is stated.
        """
        dofs = parse_dofs(self.dofs)
        object.__setattr__(self, "dofs", dofs)
        object.__setattr__(self, "nodes", locked(np.unique([d.node for d in dofs])[None, :], np.int64))
        super().__post_init__()
        if not self.given:
            raise InputError(f"group {self.name!r} has no matrix; give `mass`, `stiffness` or `damping`")
        for key, matrix in self.given.items():
            _require_symmetric(self.name, key, matrix, len(dofs))

    @property
    def given(self) -> dict[str, sparse.csc_array]:
        """Matrices that are stated, by kind."""
        every = {"mass": self.mass, "stiffness": self.stiffness, "damping": self.damping}
        return {key: matrix for key, matrix in every.items() if matrix is not None}

    @property
    def property_names(self) -> tuple[str, ...]:
        return *self.given, "loss_factor"

    def property_matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> tuple[PropertyMatrices, ...]:
        """The group's factors as properties, nominally 1, with the matrices that they multiply; then its loss factor.

        Factors are of mass, stiffness and damping, as far as it has these matrices. A group without stiffness has no
        loss factor. The arguments have no influence.
        """
        matrix_terms_of, unit = self.matrices(positions, used_codes), np.ones(1)
        terms = [
            PropertyMatrices(key, _KINDS[key], "1", unit, matrix_terms) for key, matrix_terms in matrix_terms_of.items()
        ]
        loss = (
            [PropertyMatrices("loss_factor", "loss_factor", "1", self.loss_factor)]
            if "stiffness" in matrix_terms_of
            else []
        )
        return (*terms, *loss)

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """The group's matrices by "mass", "stiffness" and "damping", each as one element.

        Signs of the rows are taken out. The arguments have no influence.
        """
        codes = np.array([[dof_code(d.node, d.direction) for d in self.dofs]])
        sign = sparse.diags_array([float(d.sign) for d in self.dofs])
        signed = {key: sparse.csc_array(sign @ matrix @ sign) for key, matrix in self.given.items()}
        return {key: (ElementMatrixTerm(codes, np.zeros((1, 0, 0)), whole=matrix),) for key, matrix in signed.items()}


def _require_symmetric(group: str, name: str, matrix: sparse.csc_array, size: int) -> None:
    """Raise `InputError` unless the matrix is (size, size), finite and symmetric to 1e-8 of its largest entry.

    `group` and `name` are named in the message.
    """
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
