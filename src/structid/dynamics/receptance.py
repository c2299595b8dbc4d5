"""The dynamic stiffness of a large linear structure, factorized line by line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from threadpoolctl import LibController, ThreadpoolController

from structid.core.arrays import ComplexArray, FloatArray, NumberArray
from structid.core.errors import SingularModelError
from structid.dynamics.factorization import Analysis, Factor, SingularMatrixError, factorizer

#: Models of up to so many degrees of freedom are solved as dense matrices, all lines together.
DENSE_UP_TO = 64
#: Rows that differ from multiples of others by no more than this part of their largest entry are such multiples.
_SAME = 1e-14


def factorizer_words(n_dofs: int) -> str:
    """Words of reports for the factorization that a model of `n_dofs` degrees of freedom is solved by."""
    return "dense matrices (LAPACK)" if n_dofs <= DENSE_UP_TO else factorizer().words


@dataclass(frozen=True, eq=False)
class DynamicStiffness:
    """Z of a large model, line by line, in one sparsity pattern.

    Attributes
    ----------
    analysis : Analysis
        Of the pattern.
    data : (n_matrices, n_entries) float array
        Entries of each matrix.
    coefficients : (n_frequencies, n_matrices) complex array
        How each enters.
    frequency : (n_frequencies,) float array
        Hz; for messages.
    """

    analysis: Analysis
    data: FloatArray
    coefficients: ComplexArray
    frequency: FloatArray

    @cached_property
    def merged(self) -> tuple[tuple[FloatArray, ComplexArray], ...]:
        """Rows of matrix entries (n_entries,), none a multiple of another, each with its factor (n_frequencies,) in Z.

        Z is the dynamic stiffness, at each line the sum of rows times factors. Matrices of zeros are left out;
        stiffness and structural damping merge into one row where all elements have the same loss factor.
        """
        rows: list[tuple[FloatArray, ComplexArray]] = []
        for matrix_index, row in enumerate(self.data):
            largest = int(np.abs(row).argmax())
            if row[largest] == 0:
                continue
            for index, (other, factor) in enumerate(rows):
                scale = row[largest] / other[largest] if other[largest] else 0.0
                if scale and np.abs(row - scale * other).max() <= _SAME * abs(row[largest]):
                    rows[index] = other, factor + scale * self.coefficients[:, matrix_index]
                    break
            else:
                rows.append((row, self.coefficients[:, matrix_index].astype(np.complex128)))
        return tuple(rows)

    def entries(self, line: int, is_damped: bool = True) -> NumberArray:
        """Entries of the dynamic stiffness Z, (n_entries,), at the line with index `line`; real without damping.

        If not `is_damped`, the real part alone. Entries are in the order of the sparsity pattern.
        """
        real = self._weighted_sum([float(factor[line].real) for _, factor in self.merged])
        imaginary = [float(factor[line].imag) for _, factor in self.merged]
        if not is_damped or not any(imaginary):
            return real
        total = np.empty(len(real), dtype=np.complex128)
        total.real = real
        total.imag = self._weighted_sum(imaginary)
        return total

    def _weighted_sum(self, factors: list[float]) -> FloatArray:
        """Sum of the merged rows of matrix entries, (n_entries,), each times its entry of `factors`."""
        total = np.zeros(self.data.shape[1])
        for (row, _), factor in zip(self.merged, factors, strict=True):
            if factor:
                total += row if factor == 1.0 else factor * row
        return total

    def solver(self, line: int, is_damped: bool = True) -> LineFactor:
        """Factorization of the dynamic stiffness Z at the line with index `line`, of its real part if not `is_damped`.

        It may be used until the next call only.

        Raises
        ------
        SingularModelError
            If Z cannot be factorized there.
        """
        frequency = float(self.frequency[line])
        try:
            return LineFactor(self.analysis.factor(self.entries(line, is_damped)), frequency)
        except SingularMatrixError as error:
            raise singular_model(frequency, frequency) from error


@dataclass(frozen=True, eq=False)
class LineFactor:
    """A factorization that names its frequency where it turns out to be none."""

    factor: Factor
    frequency: float

    def solve(self, right: NumberArray) -> NumberArray:
        """X with Z X = `right` (n_dofs, n_right), real where all is."""
        try:
            return self.factor.solve(right)
        except SingularMatrixError as error:
            raise singular_model(self.frequency, self.frequency) from error


@contextmanager
def single_blas() -> Iterator[None]:
    """Context manager in which BLAS has one thread: more only slow the small factorizations and products of a line."""
    changed = [(library, count) for library in _blas_libraries() if (count := library.num_threads) != 1]
    try:
        for library, _ in changed:
            library.set_num_threads(1)
        yield
    finally:
        for library, count in changed:
            library.set_num_threads(count)


@cache
def _blas_libraries() -> tuple[LibController, ...]:
    """The loaded BLAS libraries, whose numbers of threads are asked for and set."""
    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)


def singular_model(low: float, high: float) -> SingularModelError:
    """The error of a dynamic stiffness that cannot be factorized somewhere from `low` to `high`, Hz."""
    where = f"{low:g} Hz" if low == high else f"{low:g} to {high:g} Hz"
    return SingularModelError(
        f"the dynamic stiffness is singular at {where}: the structure has a mechanism without mass, or no supports at 0 Hz;"
        " add the missing supports, springs or mass, or leave that line out"
    )
