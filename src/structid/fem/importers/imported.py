"""Imported matrices: named sparse matrices with the node and component of each row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.core.errors import InputError

#: What a component number may be; scalar points (0) take the place of RX, so that they have no part in translations.
_COMPONENTS = {0: "RX", **{i + 1: direction for i, direction in enumerate(DIRECTIONS)}}
_LARGEST_LABEL = 2**50


@dataclass(frozen=True, eq=False)
class ElementEntries:
    """Entries of a matrix by the element that each comes from.

    Attributes
    ----------
    element : (n_entries,) int array
        Labels of the elements as the file has them.
    row, column : (n_entries,) int arrays
        Positions in the whole matrix.
    value : (n_entries,) float array
        Symmetric element matrices are complete: both triangles are there.
    """

    element: IntArray
    row: IntArray
    column: IntArray
    value: FloatArray


@dataclass(frozen=True, eq=False)
class ImportedMatrix:
    """A matrix from a file; symmetric ones have both triangles.

    Attributes
    ----------
    name : str
        Name in the file; the file's own name where the format has none.
    matrix : (n_rows, n_columns) sparse array
        Real or complex, in the units of the file.
    dofs : (n_rows, 2) int array, optional
        Node and component (1 to 6, 0 for a scalar point) of each row; None where the format does not say.
    columns : (n_columns, 2) int array, optional
        Node and component of each column of a rectangular matrix; by default those of the rows.
    elements : ElementEntries, optional
        Entries by element, if the file was written element by element.
    constrained : (n_constrained, 2) int array, optional
        Degrees of freedom that the file marks as constrained to zero; they are not in `matrix`.
    """

    name: str
    matrix: sparse.csc_array
    dofs: IntArray | None = None
    columns: IntArray | None = None
    elements: ElementEntries | None = None
    constrained: IntArray | None = None

    def __post_init__(self) -> None:
        """Convert the matrix to compressed columns without duplicates, and the tables to read-only arrays (n, 2).

        Raises `InputError` if a table has another number of rows than the matrix has rows or columns.
        """
        dtype = np.complex128 if np.iscomplexobj(self.matrix.data) else np.float64
        matrix = sparse.csc_array(self.matrix, dtype=dtype)
        matrix.sum_duplicates()
        object.__setattr__(self, "matrix", matrix)
        for key in ("dofs", "columns", "constrained"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, locked(np.reshape(getattr(self, key), (-1, 2)), np.int64))
        for key, size in (("dofs", matrix.shape[0]), ("columns", matrix.shape[1])):
            table = getattr(self, key)
            if table is not None and len(table) != size:
                raise InputError(f"`{key}` of {self.name!r} must have {size} rows like the matrix, got {len(table)}")

    @property
    def is_square(self) -> bool:
        return self.matrix.shape[0] == self.matrix.shape[1] and self.columns is None


def of_elements(imported: ImportedMatrix, elements: Iterable[int]) -> ImportedMatrix:
    """The matrix of some `elements` (labels) only, summed, on the degrees of freedom of the whole matrix `imported`.

    Repeated labels count once.

    Raises
    ------
    InputError
        If the file was not written element by element, or lacks one of `elements`.
    """
    parts = imported.elements
    if parts is None:
        raise InputError(
            f"{imported.name!r} is assembled; its elements cannot be separated, export it element by element"
        )
    wanted = np.unique(np.fromiter(elements, dtype=np.int64))
    missing = np.setdiff1d(wanted, parts.element)
    if missing.size:
        labels = np.unique(parts.element)
        raise InputError(
            f"{imported.name!r} has no element {missing[0]} ({missing.size} of {wanted.size} are missing); it has "
            f"{labels.size}, from {labels[0]} to {labels[-1]}"
        )
    keep = np.isin(parts.element, wanted)
    chosen = ElementEntries(parts.element[keep], parts.row[keep], parts.column[keep], parts.value[keep])
    total = sparse.coo_array((chosen.value, (chosen.row, chosen.column)), imported.matrix.shape)
    return ImportedMatrix(
        imported.name, total.tocsc(), imported.dofs, elements=chosen, constrained=imported.constrained
    )


def dofs_of(table: IntArray) -> tuple[Dof, ...]:
    """The degrees of freedom in a table of node and component, (n, 2).

    Components 1 to 6 are X Y Z RX RY RZ. A scalar point (component 0) is called RX of its number.

    Raises
    ------
    InputError
        If a node is negative (an internal node of the solver), a component is none of these, or one repeats.
    """
    dofs = []
    for node, component in np.asarray(table).tolist():
        if node < 0:
            raise InputError(
                f"degree of freedom {component} of node {node} is internal to the solver (a Lagrange multiplier or an "
                "internal node); export without hybrid elements and contact, or with the constraints eliminated"
            )
        if component not in _COMPONENTS:
            raise InputError(
                f"component {component} of node {node} is no translation (1 to 3) or rotation (4 to 6); export the "
                "displacement degrees of freedom only"
            )
        dofs.append(Dof(node, _COMPONENTS[component]))
    if len(set(dofs)) < len(dofs):
        ordered = sorted(dofs)
        again = next(dof for dof, following in pairwise(ordered) if dof == following)
        raise InputError(f"{again.unsigned} is named by two rows; each degree of freedom may appear once")
    return tuple(dofs)


def dof_table(dofs: Iterable[str | Dof]) -> IntArray:
    """Node and component (1 to 6) of `dofs`, (n, 2); the reverse of `dofs_of` but for scalar points and signs."""
    parsed = [parse_dof(dof) for dof in dofs]
    return np.array([(dof.node, dof.axis + 1) for dof in parsed], dtype=np.int64).reshape(-1, 2)


def codes_of(table: IntArray) -> IntArray:
    """One integer for node and component of each row of `table` (n, 2), in the order of nodes, then components; (n,).

    Raises `InputError` for a node label beyond the largest allowed.
    """
    if table.size and np.abs(table).max() >= _LARGEST_LABEL:
        raise InputError(f"node labels must be below 2^50, got {np.abs(table).max()}; the file is damaged")
    return table[:, 0] * 64 + table[:, 1]


def tables_of(codes: IntArray) -> IntArray:
    """The reverse of `codes_of`."""
    return np.stack([codes // 64, codes % 64], axis=1)


def on_dofs(imported: ImportedMatrix, table: IntArray) -> sparse.csc_array:
    """The matrix with rows and columns in the order of `table`, sparse (n, n), zero where it has no entries.

    `table` (n, 2) has node and component (1 to 6) of each row.

    Raises
    ------
    InputError
        If the matrix is not square, has no numbering, or has entries at degrees of freedom that are not in `table`.
    """
    if not imported.is_square:
        n_rows, n_columns = imported.matrix.shape
        raise InputError(
            f"{imported.name!r} has columns ({n_columns}) that are not its rows ({n_rows}); a square matrix is needed"
        )
    if imported.dofs is None:
        raise InputError(f"{imported.name!r} has no numbering of its own; give the degrees of freedom of its rows")
    order = np.argsort(codes_of(table), kind="stable")
    sorted_codes = codes_of(table)[order]
    codes = codes_of(imported.dofs)
    index = np.minimum(np.searchsorted(sorted_codes, codes), len(sorted_codes) - 1)
    absent = sorted_codes[index] != codes
    coordinates = imported.matrix.tocoo()
    outside = absent[coordinates.row] | absent[coordinates.col]
    if (outside & (coordinates.data != 0)).any():
        first = int(np.argmax(outside & (coordinates.data != 0)))
        row = coordinates.row[first] if absent[coordinates.row[first]] else coordinates.col[first]
        node, component = imported.dofs[row]
        raise InputError(
            f"{imported.name!r} has entries at component {component} of node {node}, which is not among the "
            f"{len(table)} degrees of freedom given ({int(absent.sum())} of its {len(codes)} rows are not); add them, or "
            "use the numbering of the file"
        )
    position = order[index]
    row, column, data = coordinates.row[~outside], coordinates.col[~outside], coordinates.data[~outside]
    return sparse.coo_array((data, (position[row], position[column])), (len(table), len(table))).tocsc()


def complete_triangles(matrix: sparse.sparray, name: str, symmetric: bool | None = None) -> sparse.csc_array:
    """`matrix` with its other triangle added, if no off-diagonal entry has its mirror image stored; else as it is.

    Parameters
    ----------
    matrix : (n, n) sparse array
    name : str
        Name of the matrix, for the error.
    symmetric : bool, optional
        True where the file declares symmetry, so that pairs must then agree; False: left as it is; None: not known.

    Raises
    ------
    InputError
        If declared symmetric, and entries of a pair differ by more than 1e-8 of the largest entry.
    """
    full = sparse.csc_array(matrix)
    full.sum_duplicates()
    if symmetric is False or full.shape[0] != full.shape[1] or full.nnz == 0:
        return full
    full.eliminate_zeros()
    if _is_one_triangle(full):
        return sparse.csc_array(full + full.T - sparse.diags_array(full.diagonal(), dtype=full.dtype))
    if not symmetric:
        return full
    difference = abs(full - full.T)
    if difference.nnz and difference.max() > 1e-8 * abs(full).max():
        worst = difference.tocoo()
        position = int(np.argmax(worst.data))
        i, j = int(worst.row[position]), int(worst.col[position])
        raise InputError(
            f"{name!r} is declared symmetric, but entries ({i + 1}, {j + 1}) and ({j + 1}, {i + 1}) are "
            f"{full[i, j]:.6g} and {full[j, i]:.6g}; write one triangle, or both alike"
        )
    return full


def _is_one_triangle(matrix: sparse.csc_array) -> bool:
    """True if no off-diagonal entry has its mirror image stored as well; also for a diagonal matrix."""
    column = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    below, above = matrix.indices > column, matrix.indices < column
    if not (below.any() and above.any()):
        return True
    mirrored = sparse.csc_array(matrix.T)
    if matrix.nnz == mirrored.nnz and np.array_equal(matrix.indptr, mirrored.indptr):
        matrix.sort_indices()
        mirrored.sort_indices()
        if np.array_equal(matrix.indices, mirrored.indices):
            return False
    n, off = np.int64(matrix.shape[0]), below | above
    row, column = matrix.indices[off].astype(np.int64), column[off].astype(np.int64)
    return not np.isin(row * n + column, column * n + row).any()


def matrix_from_entries(
    name: str, rows: IntArray, columns: IntArray, values: np.ndarray[Any, Any], symmetric: bool | None
) -> ImportedMatrix:
    """A square matrix called `name` from entries; its rows are all nodes and components in them, sorted.

    `rows` and `columns` (n_entries, 2) are node and component, `values` (n_entries,) real or complex; entries at the
    same place add up. A single stored triangle is completed unless `symmetric` is False; if it is True, `InputError` is
    raised where two stored triangles disagree.
    """
    codes, index = np.unique(np.concatenate([codes_of(rows), codes_of(columns)]), return_inverse=True)
    n = len(rows)
    matrix = sparse.coo_array((values, (index[:n], index[n:])), (len(codes), len(codes)))
    return ImportedMatrix(name, complete_triangles(matrix, name, symmetric), tables_of(codes))


def from_elements(name: str, parts: Sequence[tuple[int, IntArray, FloatArray]]) -> ImportedMatrix:
    """The assembled matrix called `name` of element matrices, with the entries of each element.

    `parts` are (label, node and component of the rows (n, 2), matrix (n, n)) of each element; rows of the result are
    sorted.
    """
    codes = [codes_of(dofs) for _, dofs, _ in parts]
    all_codes = np.unique(np.concatenate(codes))
    indices = [np.searchsorted(all_codes, element_codes) for element_codes in codes]
    element = np.repeat([label for label, _, _ in parts], [len(rows_of) ** 2 for rows_of in indices])
    row = np.concatenate([np.repeat(rows_of, len(rows_of)) for rows_of in indices])
    column = np.concatenate([np.tile(rows_of, len(rows_of)) for rows_of in indices])
    value = np.concatenate([square.ravel() for _, _, square in parts])
    matrix = sparse.coo_array((value, (row, column)), (len(all_codes), len(all_codes)))
    entries = ElementEntries(element, row, column, value)
    return ImportedMatrix(name, matrix.tocsc(), tables_of(all_codes), elements=entries)


def from_triangle(values: FloatArray, n: int) -> FloatArray | None:
    """Matrix (n, n) from `values`: n (n + 1) / 2 of the lower triangle by rows (symmetric), or n^2 column by column.

    None for any other number of values. `n` is the number of rows.
    """
    if len(values) == n * (n + 1) // 2:
        square = np.zeros((n, n))
        square[np.tril_indices(n)] = values
        return square + np.tril(square, -1).T
    return values.reshape(n, n).T if len(values) == n * n else None
