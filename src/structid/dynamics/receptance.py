"""The dynamic stiffness of a large structure: factorized line by line, or swept from few factorizations.

A sweep grows its basis where the error is largest, and verifies it there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy import linalg, sparse
from threadpoolctl import LibController, ThreadpoolController

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.core.errors import SingularModelError
from structid.dynamics.factorization import Analysis, Factor, SingularMatrixError, factorizer

#: Models of up to so many degrees of freedom are solved as dense matrices, all lines together.
DENSE_UP_TO = 64
#: Rows that differ from multiples of others by no more than this part of their largest entry are such multiples.
_SAME = 1e-14
#: Fewer lines than this are solved one by one.
FEWEST_LINES = 20
#: The basis may have so many vectors, or this many for each right-hand side.
_MOST_COLUMNS, _MOST_EACH = 600, 10
#: Other lines may be off by more than the one that is verified: it must be better than asked by this factor.
_SAFE = 0.3
#: A line is solved for in full where no more than this part is left of what the basis leaves of its equations; at most so many
#: rounds with the factorization of another line, each of which takes this part away at least, or it is factorized itself.
_SOLVED, _ROUNDS, _SLOW = 0.05, 8, 0.5
#: What is left of equations that are solved in full, in parts of the load, and most rounds to it.
_IN_FULL, _MOST_ROUNDS = 1e-10, 40

#: Line, fields solved for in full and fields of the basis there: the error in parts of what is allowed.
ErrorOf = Callable[[int, NumberArray, NumberArray], float]
#: Products with Z^-1 M that follow the solutions of one factorization into the basis: so many real fields in all, if few.
_FIELDS, _MOST_MOMENTS = 84, 8
#: Part of a new vector that must be new, or rounding fills the basis.
_NEW = 1e-9
#: Random sums of equations that tell the sizes of what is left of them.
_SUMS = 2000


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


class FieldSweep:
    """Fields Z^-1 B at every line by Galerkin projection on solutions at few lines.

    The basis holds, for each line that was factorized, Z^-1 B and further products with Z^-1 M there (rational Krylov).
    The next line is the one with the largest residual |B - Z x| / |B|; it is solved in full, which verifies the fields
    there, and serves the basis if they are off. The full solution takes the last factorization, of another line, to
    what is left of the equations, round after round, and the equations projected on all of that; only where this goes
    slowly it takes a factorization of its own. Z is symmetric: right-hand sides of loads and of sensors share one
    basis, so readings are off by the product of the errors of both fields, and derivatives by their sum.

    Parameters
    ----------
    stiffness : DynamicStiffness
    pattern : (indices, indptr)
        Sparsity pattern of the entries, in compressed columns.
    right : (n_dofs, n_columns) float array
        Right-hand sides B.

    Attributes
    ----------
    n_factorizations : int

    References
    ----------
    Grimme (1997), Krylov projection methods for model reduction, PhD thesis, University of Illinois, chapter 5;
    Feng, Antoulas and Benner (2017), ESAIM: M2AN 51, 2129, for the choice of points by the residual.
    """

    def __init__(self, stiffness: DynamicStiffness, pattern: tuple[IntArray, IntArray], right: FloatArray) -> None:
        """Sweep of the model `stiffness` with `pattern` (indices, indptr) and right sides `right` (n_dofs, n_columns).

        It begins at the middle line; nothing is solved yet.
        """
        self.stiffness, self.right = stiffness, right
        self.basis = FieldBasis(stiffness, pattern, right)
        self.n_factorizations = 0
        self._visited = np.zeros(len(stiffness.frequency), dtype=bool)
        self._line = len(self._visited) // 2
        self._last: LineFactor | None = None
        self._error: float | None = None

    @property
    def n_lines(self) -> int:
        return len(self._visited)

    @property
    def n_basis(self) -> int:
        return self.basis.size

    def verified(self, error_of: ErrorOf) -> float | None:
        """Error of fields at the line with the largest residual, after the basis has grown until it is small enough.

        `error_of` (line index, exact fields, projected fields) returns the error in parts of what is allowed; small
        enough is 0.3 of that. Later calls return the error that was found.

        Returns
        -------
        float or None
            The error there, in parts of what is allowed; None where there are fewer than 20 lines, or it takes more
            than a third of them (at least 3), or too large a basis: solve for each line then.

        Raises
        ------
        SingularModelError
            If Z cannot be factorized at a line that is chosen.
        """
        if self._error is not None:
            return self._error
        most = min(len(self.right), max(_MOST_COLUMNS, _MOST_EACH * self.right.shape[1]))
        while self.n_lines >= FEWEST_LINES:
            if self.n_factorizations >= max(3, self.n_lines // 3) or self.n_basis >= most:
                break
            self._add_undamped_line()
            self._next()
            projected = self.fields(self._line)
            error = error_of(self._line, self._converged_fields(), projected)
            if error <= _SAFE:
                self._error = error
                break
            self._next()
        self._last = None
        return self._error

    def in_full(self) -> Iterator[NumberArray]:
        """Fields Z^-1 B at each line in turn, (n_dofs, n_columns), with a relative residual of at most 1e-10.

        Z is the dynamic stiffness, B the right-hand sides. A single factorization serves all lines, in rounds; lines
        that do not converge get a separate factorization.
        """
        self._add_undamped_line()
        for _ in range(_MOST_ROUNDS):
            unsolved = [line for line in range(self.n_lines) if self.basis.left(line) > _IN_FULL]
            if not unsolved or self._last is None:
                break
            self.basis.improve(self._last, unsolved)
        for line in range(self.n_lines):
            self._line = line
            yield self.fields(line) if self.basis.left(line) <= _IN_FULL else self._factorize_line()

    def _converged_fields(self) -> NumberArray:
        """Fields (n_dofs, n_columns) at the current line, by corrections from the last factorization or a new one.

        Corrections end when they leave 5 % of the residual of the basis; where they are slow, the line is factorized.
        """
        if self._last is not None:
            first = last = self.basis.left(self._line)
            for _ in range(_ROUNDS):
                self.basis.improve(self._last, [self._line])
                residual = self.basis.left(self._line)
                if residual <= _SOLVED * first:
                    return self.fields(self._line)
                if residual > _SLOW * last:
                    break
                last = residual
        return self._factorize_line()

    def _add_undamped_line(self) -> None:
        """Take in the line without damping, a quarter of the products; with it if at an undamped resonance."""
        try:
            self._factorize_line(is_damped=False)
        except SingularModelError:
            self._factorize_line()

    def _factorize_line(self, is_damped: bool = True) -> NumberArray:
        """Fields Z^-1 B (n_dofs, n_columns) at the current line by factorization of the dynamic stiffness Z.

        They join the basis with their Krylov vectors. Without `is_damped`, the real part of Z is factorized, and the
        fields are those of it.
        """
        self._last = None
        self.n_factorizations += 1
        solver = self.stiffness.solver(self._line, is_damped)
        fields = solver.solve(self.right)
        self.basis.grow(solver, fields)
        self._last = solver
        return fields

    def _next(self) -> None:
        self._visited[self._line] = True
        self._line = int(np.argmax(np.where(self._visited, -1.0, self.basis.residuals)))

    def fields(self, line: int) -> NumberArray:
        """Fields of the basis at a line, (n_dofs, n_columns)."""
        return self.basis.fields(line)


@dataclass(frozen=True, eq=False)
class ReducedSweep:
    """Readings at all lines, and how they were found.

    Attributes
    ----------
    values : (n_frequencies, n_readings, n_loads) complex array
    n_factorizations : int
    n_basis : int
        Vectors of the basis; 0 where every line was solved for.
    error : float
        Largest relative difference to the full solution at the line that was verified last: the one with the largest
        residual of all. Relative to the largest reading of that line; NaN where every line was solved for.
    """

    values: ComplexArray
    n_factorizations: int
    n_basis: int
    error: float


def reduced_sweep(
    stiffness: DynamicStiffness,
    pattern: tuple[IntArray, IntArray],
    loads: FloatArray,
    sensors: sparse.sparray,
    tolerance: float = 1e-6,
) -> ReducedSweep:
    """Readings S' Z^-1 F at every line by Galerkin projection, to a verified relative `tolerance`.

    Where that takes more than a third of the lines, all are solved for.

    Parameters
    ----------
    stiffness : DynamicStiffness
    pattern : (indices, indptr)
        Sparsity pattern of the entries, in compressed columns.
    loads : (n_dofs, n_loads) float array
    sensors : (n_dofs, n_readings) sparse array
    tolerance : float
        Largest error in parts of the largest reading of a line.

    Returns
    -------
    ReducedSweep
        Readings (n_lines, n_readings, n_loads), numbers of factorizations and of basis vectors, and the relative error
        at the line verified last; 0 vectors and NaN where every line was solved for.

    Raises
    ------
    SingularModelError
        If Z cannot be factorized at a line that is chosen.
    """
    sweep = FieldSweep(stiffness, pattern, loads)
    error = sweep.verified(lambda _, exact, found: reading_error(sensors.T @ exact, sensors.T @ found) / tolerance)
    values = np.empty((sweep.n_lines, sensors.shape[1], loads.shape[1]), dtype=np.complex128)
    if error is not None:
        values[:] = sweep.basis.read(sensors)
        return ReducedSweep(values, sweep.n_factorizations, sweep.n_basis, error * tolerance)
    for line in range(sweep.n_lines):
        values[line] = sensors.T @ stiffness.solver(line).solve(loads)
    return ReducedSweep(values, sweep.n_factorizations + sweep.n_lines, 0, float("nan"))


def reading_error(exact: NumberArray, approximate: NumberArray) -> float:
    """Largest difference of `approximate` from `exact` readings, relative to the largest exact one."""
    return float(np.abs(approximate - exact).max() / np.abs(exact).max())


class FieldBasis:
    """A real orthonormal basis for Z^-1 B at all lines, and the equations projected on it.

    Attributes
    ----------
    right : (n_dofs, n_columns) float array
        The right-hand sides B.
    vectors : (n_dofs, n_vectors) float array
    """

    def __init__(self, stiffness: DynamicStiffness, pattern: tuple[IntArray, IntArray], right: FloatArray) -> None:
        """An empty basis for the model `stiffness` and the right-hand sides `right`, (n_dofs, n_columns).

        `pattern` is the sparsity pattern of the model's matrices as (indices, indptr).
        """
        shape = (len(right),) * 2
        self.right = right
        self.matrices = [sparse.csr_array((row, *pattern), shape) for row, _ in stiffness.merged]
        self.factors = [factor for _, factor in stiffness.merged]
        self.mass = sparse.csr_array((stiffness.data[0], *pattern), shape) if stiffness.data[0].any() else None
        self.vectors: FloatArray = np.zeros((len(right), 0))
        self._products = [self.vectors] * len(self.matrices)
        self._sketching_matrix = _sketching_matrix(len(right))
        self._sketched = [self._sketching_matrix @ self.vectors] * len(self.matrices)
        self._projected = [np.zeros((0, 0))] * len(self.matrices)
        self._loads: FloatArray = np.zeros((0, right.shape[1]))
        self._cache: dict[int, ComplexArray] = {}

    @property
    def size(self) -> int:
        return self.vectors.shape[1]

    def grow(self, solver: LineFactor, fields: NumberArray) -> None:
        """Add `fields`, the solution (n_dofs, n_columns) at one line, and Krylov vectors about it to the basis.

        `solver` is the dynamic stiffness factorized at that line.
        """
        krylov_vectors, n_real_columns = [fields], fields.shape[1] * (2 if np.iscomplexobj(fields) else 1)
        for _ in range(0 if self.mass is None else min(_MOST_MOMENTS, max(1, _FIELDS // n_real_columns - 1))):
            size = np.linalg.norm(krylov_vectors[-1], axis=0)
            if not size.all():  # at a resonance without damping a factor may give anything, nothing as well
                break
            krylov_vectors.append(solver.solve(self.mass @ (krylov_vectors[-1] / size)))
        self._extend(np.concatenate(krylov_vectors, axis=1))

    def improve(self, solver: LineFactor, lines: Sequence[int]) -> None:
        """Add corrections to the basis: the factorization `solver` of some line applied to residuals of other `lines`.

        `lines` are indices. Nothing is added if all residuals are 0.
        """
        residuals = np.concatenate([self.residual(line) for line in lines], axis=1)
        size = np.linalg.norm(residuals, axis=0)
        if not size.any():
            return
        self._extend(solver.solve(residuals[:, size > 0] / size[size > 0]))

    def residual(self, line: int) -> NumberArray:
        """Residual B - Z x at the line with index `line`, (n_dofs, n_columns); real if it has no imaginary part.

        Z is the dynamic stiffness, B the right-hand sides, and x the field projected on the basis.
        """
        x = self.coordinates(line)
        parts = [
            sum(
                (product @ factor for product, factor in zip(self._products, factors, strict=True)),
                np.zeros_like(self.right),
            )
            for factors in ([np.real(f[line] * x) for f in self.factors], [np.imag(f[line] * x) for f in self.factors])
        ]
        residual = self.right - parts[0]
        return residual - 1j * parts[1] if parts[1].any() else residual

    def left(self, line: int) -> float:
        """Largest relative residual |b - Z x| / |b| over the right-hand sides b at the line with index `line`."""
        size: FloatArray = np.linalg.norm(self.residual(line), axis=0) / np.linalg.norm(self.right, axis=0)
        return float(size.max(initial=0.0))

    @property
    def residuals(self) -> FloatArray:
        """Largest relative residual |B - Z x| / |B| over the right-hand sides B at every line, (n_lines,).

        Z is the dynamic stiffness, x the field projected on the basis. For more than 2000 degrees of freedom the
        residual is estimated from a random sketch, to about a tenth.
        """
        n_columns = self.right.shape[1]
        triangle = np.linalg.qr(
            np.concatenate([self._sketching_matrix @ self.right, *self._sketched], axis=1), mode="r"
        )
        norms: FloatArray = np.empty(len(self.factors[0]))
        for line in range(len(norms)):
            x = self.coordinates(line)
            residual = np.concatenate([np.eye(n_columns), *(-factor[line] * x for factor in self.factors)])
            size = np.linalg.norm(triangle @ residual, axis=0) / np.linalg.norm(self.right, axis=0)
            norms[line] = size.max(initial=0.0)
        return norms

    def coordinates(self, line: int) -> ComplexArray:
        """Coordinates of the fields in the basis at the line with index `line`, (n_vectors, n_columns); cached.

        They solve the equations of motion projected on the basis.
        """
        if line not in self._cache:
            small = sum(
                complex(factor[line]) * matrix for factor, matrix in zip(self.factors, self._projected, strict=True)
            )
            self._cache[line] = np.linalg.solve(np.asarray(small), self._loads.astype(np.complex128))
        return self._cache[line]

    def fields(self, line: int) -> NumberArray:
        """Fields by the basis at the line with index `line`, (n_dofs, n_columns); real if the model has no damping."""
        x = self.coordinates(line)
        if not x.imag.any():
            return np.asarray(self.vectors @ x.real)
        total = np.empty((len(self.vectors), x.shape[1]), dtype=np.complex128)
        total.real, total.imag = self.vectors @ x.real, self.vectors @ x.imag
        return total

    def all_coordinates(self) -> ComplexArray:
        """Coordinates of the fields at all lines, (n_lines, n_vectors, n_columns)."""
        return np.stack([self.coordinates(line) for line in range(len(self.factors[0]))])

    def read(self, sensors: sparse.sparray) -> ComplexArray:
        """S' times the fields at all lines, (n_lines, n_readings, n_columns)."""
        read: ComplexArray = np.asarray(sensors.T @ self.vectors) @ self.all_coordinates()
        return read

    def _extend(self, fields: NumberArray) -> None:
        """Extend the basis by the part of `fields`, (n_dofs, n_fields), that it does not span yet."""
        parts = np.concatenate([fields.real, fields.imag], axis=1) if np.iscomplexobj(fields) else fields.real
        new, before = _orthonormal_part(self.vectors, parts), self.vectors
        self.vectors = np.concatenate([before, new], axis=1)
        for k, matrix in enumerate(self.matrices):
            product = matrix @ new
            side, corner = before.T @ product, new.T @ product
            self._projected[k] = np.block([[self._projected[k], side], [side.T, corner]])
            self._products[k] = np.concatenate([self._products[k], product], axis=1)
            self._sketched[k] = np.concatenate([self._sketched[k], self._sketching_matrix @ product], axis=1)
        self._loads = self.vectors.T @ self.right
        self._cache = {}


def _sketching_matrix(n: int) -> sparse.csr_array:
    """Random sparse matrix, (2000, n), that adds n equations with random signs; it keeps norms to about a tenth.

    Up to 2000 equations are not added, and the matrix is the identity (n, n). The random numbers are always the same.

    References
    ----------
    Woodruff (2014), Foundations and Trends in Theoretical Computer Science 10(1-2), 1-157, section 2.1.
    """
    if n <= _SUMS:
        return sparse.eye_array(n, format="csr")
    rng = np.random.default_rng(0)
    coordinates = np.arange(n), rng.integers(_SUMS, size=n)
    return sparse.csr_array((rng.choice([-1.0, 1.0], size=n), coordinates), (n, _SUMS)).T.tocsr()


def _orthonormal_part(basis: FloatArray, vectors: FloatArray) -> FloatArray:
    """Orthonormal columns (n, n_new) that span the part of `vectors` (n, n_vectors) outside the orthonormal `basis`.

    Directions that are new by less than 1e-9 are left out.
    """
    size = np.linalg.norm(vectors, axis=0)
    residual = vectors[:, size > 0] / size[size > 0]
    for _ in range(2):
        residual = residual - basis @ (basis.T @ residual)
    _, singular, right = np.linalg.svd(np.linalg.qr(residual, mode="r"), full_matrices=False)
    kept = singular > _NEW * max(1.0, singular.max(initial=0.0))
    new = residual @ (right[kept].T / singular[kept])
    new = new - basis @ (basis.T @ new)
    triangle = linalg.cholesky(new.T @ new, lower=True)
    return np.asarray(linalg.solve_triangular(triangle, new.T, lower=True).T)
