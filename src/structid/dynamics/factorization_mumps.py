"""MUMPS, its sequential library, through its C interface: symmetric matrices, real and complex."""

from __future__ import annotations

import ctypes
import ctypes.util
import re
import sys
import weakref
from collections.abc import Callable
from ctypes import c_char, c_double, c_int, c_int64, c_void_p
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import IntArray, NumberArray
from structid.dynamics.factorization import SingularMatrixError

_BEGIN, _ANALYSE, _FACTORIZE, _SOLVE, _END = -1, 1, 2, 3, -2
_SYMMETRIC, _WORLD = 2, -987654
#: Places (from 0) in the lists of controls and of answers, as the users' guide numbers them (from 1).
_MEMORY_MARGIN, _NULL_PIVOTS, _ERROR, _FOUND_NULL = 13, 23, 0, 27
_SILENT = [-1, -1, -1, 0]
_TOO_LITTLE_WORK = (-8, -9, -17, -20)
_ERRORS = {-5: "not enough memory", -7: "not enough memory", -10: "zero pivot", -13: "not enough memory"}


class _Arguments(ctypes.Structure):
    """What the library is called with, in both arithmetics: the layout of its versions 5.4 and 5.5 (``dmumps_c.h``)."""

    _fields_: ClassVar[list[tuple[str, type]]] = [
        *((name, c_int) for name in ("sym", "par", "job", "comm_fortran")),
        ("icntl", c_int * 60), ("keep", c_int * 500), ("cntl", c_double * 15), ("dkeep", c_double * 230),
        ("keep8", c_int64 * 150), ("n", c_int), ("nblk", c_int), ("nz_alloc", c_int), ("nz", c_int),
        ("nnz", c_int64), ("irn", c_void_p), ("jcn", c_void_p), ("a", c_void_p), ("nz_loc", c_int),
        ("nnz_loc", c_int64), ("distributed", c_void_p * 3), ("nelt", c_int), ("others", c_void_p * 3),
        ("blocks", c_void_p * 2), ("permutations", c_void_p * 3), ("scalings", c_void_p * 2),
        ("scaled", c_int * 2), ("rhs", c_void_p), ("more_rhs", c_void_p * 4), ("rhs_indices", c_void_p * 4),
        ("nrhs", c_int), ("lrhs", c_int), ("rhs_sizes", c_int * 5), ("schur_sizes", c_int * 7),
        ("info", c_int * 80), ("infog", c_int * 80), ("rinfo", c_double * 40), ("rinfog", c_double * 40),
        ("deficiency", c_int), ("null_space", c_void_p * 2), ("size_schur", c_int), ("schur", c_void_p * 2),
        ("instance_number", c_int), ("wk_user", c_void_p), ("version_number", c_char * 32), ("rest", c_char * 8192),
    ]  # fmt: skip


@cache
def _libraries() -> dict[bool, Callable[..., object]] | str:
    """The library's call for real and for complex matrices, or what is wrong with it."""
    calls: dict[bool, Callable[..., object]] = {}
    for is_complex, letter in ((False, "d"), (True, "z")):
        stem = f"{letter}mumps_seq"
        folder = Path(sys.prefix) / "lib"
        here = [str(path) for name in (f"lib{stem}*.so*", f"lib{stem}*.dylib") for path in sorted(folder.glob(name))]
        found = ctypes.util.find_library(stem)
        for candidate in (*here, *([found] if found else []), *(f"lib{stem}-5.{minor}.so" for minor in (5, 4))):
            try:
                calls[is_complex] = getattr(ctypes.CDLL(candidate), f"{letter}mumps_c")
            except (OSError, AttributeError):
                continue
            break
        if is_complex not in calls:
            return f"the sequential library {stem} was not found in {folder} nor on the system's path"
    return calls


@cache
def _version() -> str:
    """The library's version where its arguments are laid out as here; "" where they are not."""
    calls = _libraries()
    if isinstance(calls, str):
        return ""
    given = _Arguments(sym=_SYMMETRIC, par=1, job=_BEGIN, comm_fortran=_WORLD)
    calls[True](ctypes.byref(given))
    given.icntl[:4] = _SILENT
    words = bytes(given.version_number).split(b"\0")[0].decode("ascii", "replace").strip()
    if not re.fullmatch(r"5\.\d+\.\d+\S*", words):
        return ""
    given.job = _END
    calls[True](ctypes.byref(given))
    return words


def mumps_problem() -> str:
    """Why MUMPS cannot be used here; "" where it can."""
    calls = _libraries()
    if isinstance(calls, str):
        return calls
    return "" if _version() else "the library mumps_seq is of another version than 5.4 or 5.5"


@dataclass(frozen=True)
class Mumps:
    """Multifrontal, symmetric storage, pivots of one and two within fronts."""

    name: str = "mumps"

    @property
    def words(self) -> str:
        return f"MUMPS {_version()}"

    def analyse(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> MumpsAnalysis:
        """The analysis of a symmetric pattern in compressed columns; `loaded` makes no difference."""
        return MumpsAnalysis(np.asarray(indices), np.asarray(indptr))


class _Handle:
    """The library's memory of one pattern in one arithmetic; freed with this object."""

    def __init__(self, is_complex: bool, rows: IntArray, columns: IntArray, n: int) -> None:
        calls = _libraries()
        assert not isinstance(calls, str)
        self.call, self.kind = calls[is_complex], np.complex128 if is_complex else np.float64
        self.given = _Arguments(sym=_SYMMETRIC, par=1, job=_BEGIN, comm_fortran=_WORLD)
        self.call(ctypes.byref(self.given))
        self.given.icntl[:4] = _SILENT
        self.given.icntl[_NULL_PIVOTS] = 1
        self.given.n, self.given.nnz = n, len(rows)
        self.kept = rows, columns  # the library keeps their addresses
        self.given.irn, self.given.jcn = rows.ctypes.data, columns.ctypes.data
        self.run(_ANALYSE)
        weakref.finalize(self, _ended, self.call, self.given)

    def run(self, job: int) -> None:
        """One phase, with more room where the library's estimate was too small."""
        self.given.job = job
        self.call(ctypes.byref(self.given))
        error = self.given.infog[_ERROR]
        while error in _TOO_LITTLE_WORK and self.given.icntl[_MEMORY_MARGIN] < 1000:
            self.given.icntl[_MEMORY_MARGIN] *= 2
            self.call(ctypes.byref(self.given))
            error = self.given.infog[_ERROR]
        if error < 0:
            raise SingularMatrixError(f"MUMPS stopped: {_ERRORS.get(error, f'error {error}')}")


def _ended(call: Callable[..., object], given: _Arguments) -> None:
    given.job = _END
    call(ctypes.byref(given))


class MumpsAnalysis:
    """A pattern; the library's analysis of it is made when the first matrix comes, once for each arithmetic."""

    def __init__(self, indices: IntArray, indptr: IntArray) -> None:
        self.n = len(indptr) - 1
        columns = np.repeat(np.arange(self.n, dtype=np.int32), np.diff(indptr))
        self.kept = np.flatnonzero(indices >= columns)
        self.rows, self.columns = (np.add(a[self.kept], 1, dtype=np.int32) for a in (indices, columns))  # from 1
        self.handles: dict[bool, _Handle] = {}
        self.count = 0

    def __getstate__(self) -> dict[str, object]:
        """Without the library's memory, which belongs to this process."""
        return {**self.__dict__, "handles": {}}

    def factor(self, entries: NumberArray) -> MumpsFactor:
        """The factorization of the matrix with these `entries`; the one before it ends."""
        if not np.isfinite(entries).all():
            raise SingularMatrixError("the matrix has entries that are not finite")
        is_complex = bool(np.iscomplexobj(entries))
        if is_complex not in self.handles:
            self.handles[is_complex] = _Handle(is_complex, self.rows, self.columns, self.n)
        handle = self.handles[is_complex]
        values = np.ascontiguousarray(entries[self.kept], dtype=handle.kind)
        handle.given.a = values.ctypes.data
        handle.run(_FACTORIZE)
        self.count += 1
        if handle.given.infog[_FOUND_NULL] > 0:
            raise SingularMatrixError(f"{handle.given.infog[_FOUND_NULL]} pivots are 0 to rounding")
        return MumpsFactor(self, handle, self.count)


@dataclass(frozen=True, eq=False)
class MumpsFactor:
    """The factorization that the library holds of an analysis."""

    analysis: MumpsAnalysis
    handle: _Handle
    count: int

    def solve(self, right: NumberArray) -> NumberArray:
        """X with A X = `right`, (n, n_right)."""
        if self.count != self.analysis.count:
            raise RuntimeError("this factorization has ended: another one of the same analysis was made after it")
        if np.iscomplexobj(right) and self.handle.kind is np.float64:
            return self.solve(right.real) + 1j * self.solve(right.imag)
        solution = np.array(right, dtype=self.handle.kind, order="F", ndmin=2)
        given = self.handle.given
        given.rhs, given.nrhs, given.lrhs = solution.ctypes.data, solution.shape[1], solution.shape[0]
        self.handle.run(_SOLVE)
        return solution
