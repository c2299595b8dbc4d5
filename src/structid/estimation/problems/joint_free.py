"""Several linearizations without Jacobians as one, and priors that several problems state counted once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, IntArray
from structid.errors import InputError
from structid.estimation.search.free_linearization import FreeLinearization

_SAME = 1e-9


def joined_linearization(
    parts: Sequence[FreeLinearization], columns: Sequence[IntArray], kept: Sequence[IntArray], n_params: int
) -> FreeLinearization:
    """The data of all parts, then those rows of their priors that are kept.

    Parameters
    ----------
    parts : sequence of FreeLinearization
    columns : sequence of (n_own,) int arrays
        Positions of each part's parameters among all.
    kept : sequence of int arrays
        Rows of each part's residual, see `kept_prior_rows`.
    n_params : int
        Of all parameters together.
    """
    pairs = list(zip(parts, columns, strict=True))
    ends = np.cumsum([part.n_data for part in parts])[:-1]
    priors = [
        _widened(part.prior[rows - part.n_data], index, n_params)
        for part, index, rows in zip(parts, columns, kept, strict=True)
    ]
    known = [part.residual[rows] for part, rows in zip(parts, kept, strict=True)]

    def forward(v: FloatArray) -> FloatArray:
        return np.concatenate([part.forward(v[index]) for part, index in pairs])

    def adjoint(u: FloatArray) -> FloatArray:
        total = np.zeros(n_params)
        for own, (part, index) in zip(np.split(u, ends), pairs, strict=True):
            total[index] += part.adjoint(own)
        return total

    squares = np.zeros(n_params)
    for part, index in pairs:
        squares[index] += part.data_squares
    return FreeLinearization(
        residual=np.concatenate([*(part.residual[: part.n_data] for part in parts), *known]),
        forward=forward,
        adjoint=adjoint,
        data_squares=squares,
        prior=sparse.csr_array(sparse.vstack(priors)),
        words=parts[0].words,
        jacobian=_stored(pairs, n_params),
    )


def _stored(pairs: Sequence[tuple[FreeLinearization, IntArray]], n_params: int) -> FloatArray | None:
    """The Jacobian of all data where every part stores its own."""
    rows = []
    for part, index in pairs:
        if part.jacobian is None:
            return None
        wide = np.zeros((part.n_data, n_params))
        wide[:, index] = part.jacobian
        rows.append(wide)
    return np.concatenate(rows)


def _widened(rows: sparse.csr_array, index: IntArray, n_params: int) -> sparse.csr_array:
    return sparse.csr_array((rows.data, index[rows.indices], rows.indptr), (rows.shape[0], n_params))


def kept_prior_rows(
    priors: Sequence[tuple[FloatArray, sparse.csr_array]],
    columns: Sequence[IntArray],
    names: tuple[str, ...],
    first_counts: bool,
) -> tuple[IntArray, ...]:
    """Of each problem the rows of those priors that no earlier problem states: residual and derivative tell.

    Parameters
    ----------
    priors : sequence of (residual, sparse derivative)
        Rows of the priors of each problem at the start.
    columns : sequence of (n_own,) int arrays
        Positions of each problem's parameters among all.
    names : tuple of str
        All parameters.
    first_counts : bool
        Whether the first of several different priors of one parameter is taken instead of an error raised.

    Raises
    ------
    InputError
        If two problems state different priors of one parameter.
    """
    known: dict[tuple[int, ...], list[tuple[FloatArray, float]]] = {}
    found = []
    for number, ((residual, prior), index) in enumerate(zip(priors, columns, strict=True), 1):
        rows = _widened(sparse.csr_array(prior), index, len(names))
        rows.eliminate_zeros()
        rows.sort_indices()
        kept = []
        for k, value in enumerate(residual.tolist()):
            span = slice(rows.indptr[k], rows.indptr[k + 1])
            members, entries = tuple(rows.indices[span].tolist()), rows.data[span]
            stated = known.setdefault(members, [])
            if any(_is_same(other, (entries, value)) for other in stated):
                continue
            if stated and len(members) == 1:
                if first_counts:
                    continue
                raise InputError(
                    f"prior of {names[members[0]]} must be the same in all problems, got another in problem {number};"
                    " state it once, or alike"
                )
            stated.append((entries, value))
            kept.append(k)
        found.append(np.array(kept, dtype=int))
    return tuple(found)


def _is_same(first: tuple[FloatArray, float], second: tuple[FloatArray, float]) -> bool:
    return bool(
        np.allclose(first[0], second[0], rtol=_SAME, atol=0) and np.isclose(first[1], second[1], rtol=_SAME, atol=_SAME)
    )
