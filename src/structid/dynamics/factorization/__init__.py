"""Factorizations of sparse symmetric matrices: the libraries that can be used, and the one that is used.

A factorizer looks at a sparsity pattern once (`analyse`); the analysis then factorizes matrix after matrix of that
pattern, as a sweep over frequencies and the iterations of a search need it. Real entries are factorized in real
arithmetic, complex ones as complex symmetric (not Hermitian).
"""

from __future__ import annotations

import os

from structid.core.errors import InputError
from structid.dynamics.factorization.base import (
    THREADS_VARIABLE,
    Analysis,
    Factor,
    Factorizer,
    SingularMatrixError,
    usable_threads,
)
from structid.dynamics.factorization.pardiso import Pardiso, mkl_problem
from structid.dynamics.factorization.superlu import SuperLu

__all__ = [
    "FACTORIZERS",
    "THREADS_VARIABLE",
    "VARIABLE",
    "Analysis",
    "Factor",
    "Factorizer",
    "SingularMatrixError",
    "factorizer",
    "installed_factorizers",
    "usable_threads",
]

#: Names of the factorizers; the first that is installed is used.
FACTORIZERS = ("pardiso", "superlu")
#: Environment variable that names another one than the first that is installed.
VARIABLE = "STRUCTID_FACTORIZER"


def factorizer(name: str | None = None) -> Factorizer:
    """The factorizer called `name`, or the one that is used by default.

    Parameters
    ----------
    name : {"pardiso", "superlu"}, optional
        By default the environment variable STRUCTID_FACTORIZER, or the first of `FACTORIZERS` that is installed.

    Raises
    ------
    InputError
        If there is no factorizer of that name, or its library is not installed; it says how to install it.
    """
    wanted = name if name is not None else os.environ.get(VARIABLE) or installed_factorizers()[0]
    source = "`factorizer`" if name is not None else f"environment variable {VARIABLE}"
    if wanted not in FACTORIZERS:
        raise InputError(f"{source} must be one of {', '.join(FACTORIZERS)}, got {wanted!r}")
    if wanted == "superlu":
        return SuperLu()
    if problem := mkl_problem():
        raise InputError(
            f"{source} must name an installed library, got {wanted!r}: {problem}; install it with"
            " `pip install structid[pardiso]`, or choose 'superlu'"
        )
    return Pardiso()


def installed_factorizers() -> tuple[str, ...]:
    """Names of the factorizers that are installed here, the default first."""
    return FACTORIZERS if not mkl_problem() else ("superlu",)
