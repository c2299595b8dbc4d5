"""Factorizations of sparse symmetric matrices: the libraries that can be used, and the one that is used.

A factorizer looks at a sparsity pattern once (`analyse`); the analysis then factorizes matrix after matrix of that
pattern, as a sweep over frequencies and the iterations of a search need it. Real entries are factorized in real
arithmetic, complex ones as complex symmetric (not Hermitian).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from structid.core.arrays import FloatArray, IntArray, NumberArray, with_entries
from structid.core.dof import is_whole_number
from structid.core.errors import InputError

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
#: Environment variable that caps the threads of a factorizer that has any.
THREADS_VARIABLE = "STRUCTID_THREADS"
#: Diagonal pivots are kept unless they are smaller than this part of the largest entry of their column.
_PIVOT = 0.01
_REAL, _COMPLEX = -2, 6
#: Option and its value by which right-hand sides have few entries, all of them eliminated last.
_SPARSE, _ORDERED = 30, 2
#: Loaded degrees of freedom that are more than this part of all are treated as the others.
_FEW = 0.1
_ANALYSE, _FACTORIZE, _SOLVE, _RELEASE = 11, 22, 33, -1
#: Where pivots had to be changed, a solution whose residual is larger than this part of the right-hand side is none.
_RESIDUAL = 1e-6
_ERRORS = {-1: "inconsistent input", -2: "not enough memory", -3: "reordering failed", -4: "zero pivot"}


def factorizer(name: str | None = None) -> Factorizer:
    """The factorizer called `name`, or the one that is used by default.

    Parameters
    ----------
    name : {"pardiso", "superlu"}, optional
        By default the environment variable STRUCTID_FACTORIZER, or else pardiso if it is installed, superlu if not.

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
    """Number of threads for `n` unknowns: STRUCTID_THREADS if set, else 1 below 20,000, else all processors.

    Raises
    ------
    InputError
        If the environment variable STRUCTID_THREADS is no positive whole number.
    """
    text = os.environ.get(THREADS_VARIABLE)
    if text is not None:
        if not is_whole_number(text) or int(text) < 1:
            raise InputError(f"environment variable {THREADS_VARIABLE} must be a positive whole number, got {text!r}")
        return int(text)
    if n < 20_000:
        return 1
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


@dataclass(frozen=True)
class SuperLu:
    """Minimum degree ordering of A' + A and diagonal pivots: for symmetric matrices faster than SciPy's defaults."""

    name: str = "superlu"

    @property
    def words(self) -> str:
        return f"SuperLU (SciPy {scipy.__version__})"

    def analyse(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> SuperLuAnalysis:
        """The analysis of a symmetric pattern in compressed columns; `loaded` makes no difference."""
        return SuperLuAnalysis(np.asarray(indices), np.asarray(indptr))


@dataclass(frozen=True, eq=False)
class SuperLuAnalysis:
    """A pattern, its rows and columns put in the order of least fill, which is found once."""

    indices: IntArray
    indptr: IntArray

    @cached_property
    def _ordering(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Fill-reducing order (n,), source of each reordered entry (n_entries,), reordered pattern (indices, indptr).

        `right[order]` is in the new order; `entries[source]` are those of the new pattern in compressed columns.
        """
        n = len(self.indptr) - 1
        columns = np.repeat(np.arange(n), np.diff(self.indptr))
        dominant = np.where(self.indices == columns, 2.0 * np.diff(self.indptr)[columns], -1.0)
        trial = splu(
            sparse.csc_matrix((dominant, self.indices, self.indptr), (n, n)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        new_position = np.asarray(trial.perm_c)
        keys = new_position[columns].astype(np.int64) * n + new_position[self.indices]
        entry = np.argsort(keys, kind="stable")
        indptr = np.concatenate([[0], np.cumsum(np.bincount(new_position[columns], minlength=n))])
        return np.argsort(new_position), entry, (keys[entry] % n).astype(np.int32), indptr.astype(np.int32)

    @cached_property
    def _reordered(self) -> sparse.csc_matrix:
        """A matrix (n, n) of zeros with the reordered pattern; its checked indices serve for all factorizations."""
        _, entry, indices, indptr = self._ordering
        matrix = sparse.csc_matrix((np.zeros(len(entry)), indices, indptr), (len(indptr) - 1,) * 2)
        matrix.sum_duplicates()
        return matrix

    def factor(self, entries: NumberArray) -> SuperLuFactor:
        """Factorization of the matrix with `entries` (n_entries,), in the order of the pattern.

        Raises
        ------
        SingularMatrixError
            If an entry is not finite or the matrix is singular.
        """
        order, entry, _, _ = self._ordering
        if not np.isfinite(entries).all():
            raise SingularMatrixError("the matrix has entries that are not finite")
        try:
            factor = splu(
                with_entries(self._reordered, entries[entry]),
                permc_spec="NATURAL",
                diag_pivot_thresh=_PIVOT,
                options={"SymmetricMode": True, "Equil": True},
            )
        except RuntimeError as error:
            raise SingularMatrixError(str(error)) from error
        return SuperLuFactor(factor, order, bool(np.iscomplexobj(entries)))


@dataclass(frozen=True, eq=False)
class SuperLuFactor:
    """L and U of a reordered matrix."""

    factor: SuperLU
    order: IntArray
    is_complex: bool

    def solve(self, right: NumberArray) -> NumberArray:
        """Solution X, (n, n_right), of A X = `right` (n, n_right) for the factorized matrix A; complex if either is."""
        reordered = right[self.order]
        if self.is_complex:
            unordered = self.factor.solve(np.asarray(reordered, dtype=np.complex128))
        elif np.iscomplexobj(reordered):
            unordered = self.factor.solve(np.ascontiguousarray(reordered.real)) + 1j * self.factor.solve(
                np.ascontiguousarray(reordered.imag)
            )
        else:
            unordered = self.factor.solve(np.asarray(reordered, dtype=np.float64))
        solution = np.empty_like(unordered, order="C")
        solution[self.order] = unordered
        return solution


@cache
def _load_library() -> ctypes.CDLL | str:
    """MKL runtime library, or the reason, as words, why it cannot be loaded."""
    folders = [Path(sys.prefix) / "lib", Path(sys.prefix) / "Library" / "bin", Path(sys.base_prefix) / "lib"]
    names = ("libmkl_rt.so*", "libmkl_rt*.dylib", "mkl_rt*.dll")
    candidates = [str(path) for folder in folders for name in names for path in sorted(folder.glob(name))]
    on_path = ctypes.util.find_library("mkl_rt")
    for candidate in [*candidates, *([on_path] if on_path else [])]:
        try:
            library = ctypes.CDLL(candidate)
            _ = library.pardiso, library.MKL_Set_Num_Threads_Local
        except (OSError, AttributeError):
            continue
        return library
    return f"the library mkl_rt was not found in {folders[0]} nor on the system's path"


def mkl_problem() -> str:
    """Reason why PARDISO cannot be used here; "" if it can."""
    library = _load_library()
    return library if isinstance(library, str) else ""


@cache
def _mkl_version() -> str:
    """Version of the MKL library, such as ``2023.2``."""
    buffer = ctypes.create_string_buffer(198)
    library = _load_library()
    assert not isinstance(library, str)
    library.mkl_get_version_string(buffer, ctypes.c_int(198))
    words = buffer.value.decode("ascii", "replace").split()
    return next((word for word in words if word[:1].isdigit()), "unknown version")


@contextmanager
def _limit_threads(count: int) -> Iterator[None]:
    """Context manager: MKL uses `count` threads in calls of this thread; on leaving, as many as before."""
    library = _load_library()
    assert not isinstance(library, str)
    before = library.MKL_Set_Num_Threads_Local(ctypes.c_int(count))
    try:
        yield
    finally:
        library.MKL_Set_Num_Threads_Local(ctypes.c_int(before))


@dataclass(frozen=True)
class Pardiso:
    """Nested dissection, symmetric storage, Bunch and Kaufman's pivots within supernodes."""

    name: str = "pardiso"

    @property
    def words(self) -> str:
        return f"PARDISO (MKL {_mkl_version()})"

    def analyse(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> PardisoAnalysis:
        """The analysis of a symmetric pattern in compressed columns.

        Degrees of freedom that are `loaded` are eliminated last, so that right-hand sides with entries there alone
        are spared the forward substitution.
        """
        return PardisoAnalysis(np.asarray(indices), np.asarray(indptr), loaded)


@dataclass(frozen=True, eq=False)
class _PardisoMemory:
    """Memory, options and order that the library keeps for one pattern in one arithmetic, and writes to."""

    kind: int
    indices: IntArray
    indptr: IntArray
    order: IntArray | None
    memory: IntArray = field(default_factory=lambda: np.zeros(64, dtype=np.int64))
    options: IntArray = field(default_factory=lambda: np.zeros(64, dtype=np.int32))

    @property
    def n(self) -> int:
        return len(self.indptr) - 1

    def call(
        self,
        phase: int,
        entries: NumberArray | None = None,
        right: NumberArray | None = None,
        solution: NumberArray | None = None,
    ) -> int:
        """Run one `phase` of PARDISO and return its error number (0 for none); the solution is written to `solution`.

        Phases are 11 (analysis), 22 (factorization), 33 (solution) and -1 (memory released).
        `entries` are those of the upper triangle, `right` and `solution` are (n, n_right) in Fortran order. Entries and
        right-hand sides that a phase does not use are None.
        """
        library = _load_library()
        assert not isinstance(library, str)
        one, zero, phase_number, kind, n, error = (ctypes.c_int(k) for k in (1, 0, phase, self.kind, self.n, 0))
        n_right = ctypes.c_int(1 if right is None else right.shape[1])
        by = ctypes.byref
        library.pardiso(
            _address(self.memory), by(one), by(one), by(kind), by(phase_number), by(n), _address(entries),
            _address(self.indptr), _address(self.indices), _address(self.order), by(n_right), _address(self.options),
            by(zero), _address(right), _address(solution), by(error),
        )  # fmt: skip
        return error.value

    def release(self) -> None:
        if self.memory.any():
            self.call(_RELEASE)


def _address(values: NumberArray | IntArray | None) -> ctypes.c_void_p | None:
    return None if values is None else values.ctypes.data_as(ctypes.c_void_p)


class _Handle:
    """The library's memory of one pattern in one arithmetic; freed with this object."""

    def __init__(self, kind: int, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None) -> None:
        """Set PARDISO's options for one pattern; `kind` is its matrix type, `loaded` marks rows of right-hand sides.

        `indices` and `indptr` are the pattern of the upper triangle in compressed rows. `loaded` (n,) is None where
        right-hand sides are full.
        """
        order = None if loaded is None else loaded.astype(np.int32)  # the library writes its order there
        self.kind, self.held = kind, _PardisoMemory(kind, indices, indptr, order)
        self.options = self.held.options
        self.options[[0, 1, 9, 20, 34]] = 1, 2, 8, 1, 1  # own options, METIS, pivots 1e-8, Bunch-Kaufman, from 0
        self.options[17] = -1  # report the entries of the factor
        self.options[_SPARSE] = 0 if loaded is None else _ORDERED
        # with fewer than it analysed with, the library reads beyond its memory
        self.threads = usable_threads(self.held.n)
        self.analysed = False
        weakref.finalize(self, self.held.release)

    def run(self, phase: int, entries: NumberArray, right: NumberArray | None = None) -> NumberArray | None:
        """Solution (n, n_right) by one phase of PARDISO for right-hand sides `right` (n, n_right); None without them.

        `phase` is PARDISO's number of the phase; `entries` are those of the pattern, in its order. Raises
        `SingularMatrixError` if the library reports an error.
        """
        solution = None if right is None else np.empty_like(right, order="F")
        with _limit_threads(self.threads):
            error = self.held.call(phase, entries, right, solution)
        if error:
            raise SingularMatrixError(f"PARDISO stopped: {_ERRORS.get(error, f'error {error}')}")
        return solution


class PardisoAnalysis:
    """A pattern; the library's analysis of it is made when the first matrix comes, once for each arithmetic."""

    def __init__(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> None:
        """Keep the upper triangle of a symmetric pattern; `loaded` (n,) marks rows that loads use, None for all.

        `indices` and `indptr` are the whole pattern in compressed columns. Marks are ignored where more than a tenth of
        the rows have one.
        """
        n = len(indptr) - 1
        columns = np.repeat(np.arange(n, dtype=np.int32), np.diff(indptr))
        self.loaded = loaded if loaded is not None and loaded.sum() <= _FEW * n else None
        self.kept = np.flatnonzero(indices >= columns)  # lower triangle by columns: the upper one by rows
        self.indices = np.ascontiguousarray(indices[self.kept], dtype=np.int32)
        counts = np.bincount(columns[self.kept], minlength=n)
        self.indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self.handles: dict[int, _Handle] = {}
        self.count = 0

    def __getstate__(self) -> dict[str, object]:
        """Without the library's memory, which belongs to this process."""
        return {**self.__dict__, "handles": {}}

    def factor(self, entries: NumberArray) -> PardisoFactor:
        """Factorization of the matrix with `entries` (n_entries,), in pattern order; it invalidates the previous one.

        Raises
        ------
        SingularMatrixError
            If an entry is not finite, or PARDISO reports an error.
        """
        if not np.isfinite(entries).all():
            raise SingularMatrixError("the matrix has entries that are not finite")
        is_complex = bool(np.iscomplexobj(entries))
        kind = _COMPLEX if is_complex else _REAL
        if kind not in self.handles:
            self.handles[kind] = _Handle(kind, self.indices, self.indptr, self.loaded)
        handle = self.handles[kind]
        values = np.ascontiguousarray(entries[self.kept], dtype=np.complex128 if is_complex else np.float64)
        if not handle.analysed:
            handle.run(_ANALYSE, values)
            handle.analysed = True
        handle.run(_FACTORIZE, values)
        self.count += 1
        return PardisoFactor(self, handle, values, self.count, int(handle.options[13]))


@dataclass(frozen=True, eq=False)
class PardisoFactor:
    """The factorization that the library holds of an analysis."""

    analysis: PardisoAnalysis
    handle: _Handle
    values: NumberArray
    count: int
    n_changed: int

    def solve(self, right: NumberArray) -> NumberArray:
        """Solution X, (n, n_right), of A X = `right` (n, n_right) for the factorized matrix A; complex if either is.

        Raises
        ------
        SingularMatrixError
            If pivots are 0 to rounding.
        RuntimeError
            If a later factorization of the same analysis was made.
        """
        if self.count != self.analysis.count:
            raise RuntimeError("this factorization has ended: another one of the same analysis was made after it")
        is_complex = self.handle.kind == _COMPLEX
        if is_complex or not np.iscomplexobj(right):
            columns = np.asfortranarray(right, dtype=np.complex128 if is_complex else np.float64)
            self.handle.options[_SPARSE] = _ORDERED if self._is_sparse(right) else 0
            return self._check_solution(columns, self.handle.run(_SOLVE, self.values, columns))
        return self.solve(right.real) + 1j * self.solve(right.imag)

    def _is_sparse(self, right: NumberArray) -> bool:
        """True if `right` has entries only where the analysis expects them (`loaded`), and no pivot was changed."""
        loaded = self.analysis.loaded
        return loaded is not None and not self.n_changed and not right[~loaded].any()

    def _check_solution(self, right: NumberArray, solution: NumberArray | None) -> NumberArray:
        """`solution` unchanged; `SingularMatrixError` if pivots were changed and the relative residual exceeds 1e-6.

        `right` are the right-hand sides, `solution` the solutions, both (n, n_right); `solution` must not be None.
        """
        assert solution is not None
        if self.n_changed and _backward_error(self.handle, self.values, right, solution) > _RESIDUAL:
            raise SingularMatrixError(f"{self.n_changed} pivots are 0 to rounding")
        return solution


def _backward_error(handle: _Handle, values: NumberArray, right: NumberArray, solution: NumberArray) -> float:
    """Largest relative residual |b - A x| / |b| over the columns of `right` (n, n_right) and `solution`.

    `values` are the entries of the upper triangle. The common denominator |A| |x| + |b| would hide singular matrices.
    `handle` has the pattern of the matrix A.
    """
    held = handle.held
    upper = sparse.csr_array((values, held.indices, held.indptr), (held.n, held.n))
    product = upper @ solution + sparse.triu(upper, 1).T @ solution
    size: FloatArray = np.linalg.norm(right, axis=0)
    residual: FloatArray = np.linalg.norm(product - right, axis=0)
    return float((residual / np.where(size > 0, size, 1.0)).max(initial=0.0))
