"""Fields of a linear structure under harmonic loads: solutions of Z(omega) X = loads, line by line."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dynamics.modal_fields import modal_fields
from structid.errors import SingularModelError

_DENSE_UP_TO = 64
_CHUNK_ENTRIES = 4_000_000
_LINES_A_DOF = 30


def harmonic_fields(
    indices: IntArray,
    indptr: IntArray,
    data: FloatArray,
    coefficients: ComplexArray,
    loads: sparse.csc_array,
    frequency: FloatArray,
) -> ComplexArray:
    """X with Z X = loads, Z = sum over laws of coefficient times matrix, at every frequency.

    Parameters
    ----------
    indices, indptr : int arrays
        Common sparsity pattern of the matrices in compressed columns.
    data : (n_laws, n_entries) float array
        Entries of each matrix: mass, viscous damping, stiffness, structural damping and so on.
    coefficients : (n_frequencies, n_laws) complex array
        How each enters: -omega^2, i omega, 1, i and so on.
    loads : (n_dofs, n_loads) sparse array
        Right-hand sides.
    frequency : (n_frequencies,) float array
        Hz; for messages.

    Returns
    -------
    (n_frequencies, n_dofs, n_loads) complex array

    Notes
    -----
    Small structures are solved line by line as dense matrices, large ones as sparse ones. A small one with very many
    lines and no friction is summed from its poles (`modal_fields`), unless that differs from the direct solution.

    Raises
    ------
    SingularModelError
        If Z cannot be factorized at one of the frequencies.
    """
    n = len(indptr) - 1
    right = loads.toarray().astype(np.complex128)
    fields = np.empty((len(frequency), n, right.shape[1]), dtype=np.complex128)
    with _thread_pools().limit(limits=1, user_api="blas"):
        modal = _modal(indices, indptr, data, coefficients, right) if n <= _DENSE_UP_TO else None
        if modal is not None:
            fields = modal
        elif n <= _DENSE_UP_TO:
            _solve_dense(indices, indptr, data, coefficients, right, fields, frequency)
        else:
            for line in range(len(frequency)):
                fields[line] = _solve_sparse(indices, indptr, coefficients[line] @ data, right, frequency[line])
    return fields


@cache
def _thread_pools() -> Any:
    """The controller of the loaded BLAS libraries: factorizations of this size lose time to more than one thread."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _modal(
    indices: IntArray, indptr: IntArray, data: FloatArray, coefficients: ComplexArray, right: ComplexArray
) -> ComplexArray | None:
    """The fields from poles and residues; None where lines are few, laws are others than s^2, s, 1 and i, or it fails."""
    n, laplace = len(indptr) - 1, coefficients[:, 1] if coefficients.shape[1] > 3 else None
    if laplace is None or len(laplace) < _LINES_A_DOF * n or data[4:].any():
        return None
    plain = np.stack([laplace**2, laplace, np.ones_like(laplace), np.full_like(laplace, 1j)], axis=1)
    if not np.array_equal(coefficients[:, :4], plain):
        return None
    matrices = np.zeros((4, n, n))
    matrices[:, indices, np.repeat(np.arange(n), np.diff(indptr))] = data[:4]
    return modal_fields(matrices[0], matrices[1], matrices[2] + 1j * matrices[3], right, laplace)


def _solve_dense(
    indices: IntArray,
    indptr: IntArray,
    data: FloatArray,
    coefficients: ComplexArray,
    right: ComplexArray,
    fields: ComplexArray,
    frequency: FloatArray,
) -> None:
    n = len(indptr) - 1
    columns = np.repeat(np.arange(n), np.diff(indptr))
    step = max(1, _CHUNK_ENTRIES // (n * n))
    for first in range(0, len(frequency), step):
        part = slice(first, first + step)
        matrices = np.zeros((len(frequency[part]), n, n), dtype=np.complex128)
        matrices[:, indices, columns] = coefficients[part] @ data
        try:
            fields[part] = np.linalg.solve(matrices, right)
        except np.linalg.LinAlgError as error:
            raise _singular(float(frequency[part][0]), float(frequency[part][-1])) from error


def _solve_sparse(
    indices: IntArray, indptr: IntArray, entries: ComplexArray, right: ComplexArray, frequency: float
) -> ComplexArray:
    n = len(indptr) - 1
    matrix = sparse.csc_matrix((entries, indices, indptr), (n, n))
    try:
        factor = splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True, "Equil": True}
        )
    except RuntimeError as error:
        raise _singular(frequency, frequency) from error
    return factor.solve(right)


def _singular(low: float, high: float) -> SingularModelError:
    where = f"{low:g} Hz" if low == high else f"{low:g} to {high:g} Hz"
    return SingularModelError(
        f"the dynamic stiffness is singular at {where}: the structure has a mechanism without mass, or no supports at 0 Hz;"
        " add the missing supports, springs or mass, or leave that line out"
    )
