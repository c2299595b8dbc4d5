"""The seam to libraries that factorize sparse symmetric matrices, and how many threads they take."""

from __future__ import annotations

import os
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import IntArray, NumberArray
from structid.core.errors import InputError

#: Environment variable that caps the threads of a factorizer that has any.
THREADS_VARIABLE = "STRUCTID_THREADS"


class SingularMatrixError(ArithmeticError):
    """A matrix has no usable factorization."""


class Factor(Protocol):
    """A factorized matrix."""

    def solve(self, right: NumberArray) -> NumberArray:
        """X with A X = `right` (n, n_right), all columns in one pass; real where matrix and right-hand sides are."""
        ...


class Analysis(Protocol):
    """A sparsity pattern that a factorizer has looked at."""

    def factor(self, entries: NumberArray) -> Factor:
        """The factorization of the matrix with these `entries` (n_entries,), in the order of the pattern.

        It holds until the next one of the same analysis.

        Raises
        ------
        SingularMatrixError
        """
        ...


class Factorizer(Protocol):
    """A library that factorizes."""

    @property
    def name(self) -> str: ...

    @property
    def words(self) -> str:
        """Name and version of the library for reports."""
        ...

    def analyse(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> Analysis:
        """The analysis of a symmetric pattern in compressed columns, both triangles, rows sorted, diagonal included.

        `loaded` (n,) may say where most right-hand sides will have their few entries: a library may save work there.
        """
        ...


def usable_threads(n: int) -> int:
    """Number of threads for a factorization of `n` unknowns: STRUCTID_THREADS if set, else 1 below 20,000, else all processors.

    Raises
    ------
    InputError
        If the environment variable STRUCTID_THREADS is no positive whole number.
    """
    text = os.environ.get(THREADS_VARIABLE)
    if text is not None:
        if not text.isdigit() or int(text) < 1:
            raise InputError(f"environment variable {THREADS_VARIABLE} must be a positive whole number, got {text!r}")
        return int(text)
    if n < 20_000:
        return 1
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1
