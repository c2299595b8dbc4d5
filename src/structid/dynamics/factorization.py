"""Factorizations of sparse symmetric matrices: what every factorizer offers, and which one is used.

A factorizer looks at a sparsity pattern once (`analyse`); the analysis then factorizes matrix after matrix of that
pattern, as a sweep over frequencies and the iterations of a search need it. Real entries are factorized in real
arithmetic, complex ones as complex symmetric (not Hermitian).
"""

from __future__ import annotations

import os
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import IntArray, NumberArray
from structid.core.errors import InputError

#: Names of the factorizers; the first that is installed is used, MUMPS by name alone: its speed is that of its BLAS.
FACTORIZERS = ("pardiso", "superlu", "mumps")
#: Environment variable that names another one than the first that is installed.
VARIABLE = "STRUCTID_FACTORIZER"
_INSTALL = {
    "pardiso": "`pip install structid[pardiso]`",
    "mumps": "`apt install libmumps-seq-dev` or `conda install mumps-seq`",
}
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
        """Name and version, as reports say it."""
        ...

    def analyse(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> Analysis:
        """The analysis of a symmetric pattern in compressed columns, both triangles, rows sorted, diagonal included.

        `loaded` (n,) may say where most right-hand sides will have their few entries: a library may save work there.
        """
        ...


def factorizer(name: str | None = None) -> Factorizer:
    """The factorizer called `name`, or the one that is used by default.

    Parameters
    ----------
    name : {"pardiso", "superlu", "mumps"}, optional
        By default the environment variable STRUCTID_FACTORIZER, or the first of `FACTORIZERS` that is installed.

    Raises
    ------
    InputError
        If there is no factorizer of that name, or its library is not installed; it says how to install it.
    """
    from structid.dynamics.factorization_mumps import Mumps
    from structid.dynamics.factorization_pardiso import Pardiso
    from structid.dynamics.factorization_superlu import SuperLu

    makers: dict[str, type[Pardiso] | type[Mumps] | type[SuperLu]]
    makers = {"pardiso": Pardiso, "mumps": Mumps, "superlu": SuperLu}
    wanted = name if name is not None else os.environ.get(VARIABLE) or None
    source = "`factorizer`" if name is not None else f"environment variable {VARIABLE}"
    if wanted is None:
        return makers[installed_factorizers()[0]]()
    if wanted not in FACTORIZERS:
        raise InputError(f"{source} must be one of {', '.join(FACTORIZERS)}, got {wanted!r}")
    problem = _problem(wanted)
    if problem:
        raise InputError(
            f"{source} must name an installed library, got {wanted!r}: {problem}; install it with"
            f" {_INSTALL[wanted]}, or choose 'superlu'"
        )
    return makers[wanted]()


def installed_factorizers() -> tuple[str, ...]:
    """Names of those that can be used here, the default first."""
    return tuple(name for name in FACTORIZERS if not _problem(name))


def _problem(name: str) -> str:
    """Why a factorizer cannot be used here; "" where it can."""
    from structid.dynamics.factorization_mumps import mumps_problem
    from structid.dynamics.factorization_pardiso import mkl_problem

    return {"pardiso": mkl_problem, "mumps": mumps_problem}[name]() if name != "superlu" else ""


def usable_threads(n: int) -> int:
    """How many threads a factorization of n unknowns takes: one for small ones, at most the processors allowed.

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
