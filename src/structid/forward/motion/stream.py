"""Identification from motion on disk: one pass over the record by chunks, of any length and for any number of elements.

The record is never in memory as a whole. Each degree of freedom keeps the triangle of its few parameters; parts of a
record, several records and the work of several processes merge; a checkpoint holds all that is needed to go on.
"""

from __future__ import annotations

import ctypes
import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked, require_finite
from structid.core.errors import FileError, InputError
from structid.fem import Structure
from structid.files import atomic_write, damage_told
from structid.files.npy import npz_arrays
from structid.forward.motion.equations import TimeEquations
from structid.forward.motion.fit import RecursiveMotionFit, motion_fit, reduced_state, solution_words
from structid.forward.motion.motion import MOTION_QUANTITIES, NO_FORCE, NO_MOTION, field_map
from structid.inversion import Status
from structid.inversion.regression.block_least_squares import BlockFit, block_solution
from structid.inversion.regression.local_reduction import FoldingKernels, RowMaker, only_operator, row_maker
from structid.records.on_disk import ChunkedRecord
from structid.unknowns import Parameters

_KEEPING = 0.1  # of the time may go into checkpoints

#: Called with the samples done and the number of samples.
Progress = Callable[[int, int], None]
_LAYOUT = "motion fit 1"


@dataclass(frozen=True, eq=False)
class MotionSolution:
    """Parameters from a record of any size, with what is needed to judge them.

    Attributes
    ----------
    unknown : Parameters
    fit : BlockFit
        Values, residual and factor; covariances of any parameters on demand.
    std : (n_params,) float array
        Standard deviations from the residual: right for errors of the force, blind to the bias that noise of the
        motion brings (see `identify_motion`). NaN where a value is.
    n_rows, n_samples : int
        Equations and instants.
    engine : str
        How the rows were reduced: numba and its threads, or NumPy.
    """

    unknown: Parameters
    fit: BlockFit
    std: FloatArray
    n_rows: int
    n_samples: int
    engine: str

    @property
    def names(self) -> tuple[str, ...]:
        return self.unknown.names

    @property
    def values(self) -> FloatArray:
        return self.fit.values

    @property
    def identified(self) -> np.ndarray:
        """True for each value that is known to better than its own size, (n_params,)."""
        return np.asarray(self.std <= np.abs(self.values))

    @property
    def status(self) -> Status:
        return Status.CONVERGED if self.identified.all() else Status.NOT_IDENTIFIABLE

    @property
    def message(self) -> str:
        """Words for the reader, the most important first."""
        words = solution_words(self.unknown, self.fit, self.n_rows, self.n_samples)
        return "; ".join([*words, f"rows reduced by {self.engine}, solved by {self.fit.method}"])

    def covariance(self, indices: IntArray) -> FloatArray:
        """Covariance of some parameters, (k, k)."""
        return self.fit.covariance(indices)


def identify_motion_by_chunks(
    structure: Structure,
    unknown: Parameters,
    record: ChunkedRecord,
    row_weights: ArrayLike | None = None,
    work: FoldingKernels | None = None,
    longest: int | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
) -> MotionSolution:
    """Masses, viscous dampings and stiffnesses from a record that may be far larger than memory, in one pass.

    The same equations and the same answer as `identify_motion`; the time grows with samples times degrees of freedom,
    and the memory with degrees of freedom only.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Masses, viscous dampings and stiffnesses; no loss factors, no friction, no priors. Bounds are not imposed.
    record : ChunkedRecord
        Acceleration, velocity and displacement, as far as the equations hold them, of every free degree of freedom,
        and the forces; see `open_record`.
    row_weights : (n_dofs,) array, optional
        Factor on the equation of each degree of freedom; 1 by default.
    work : FoldingKernels, optional
        Compiled or not, and on how many threads.
    longest : int, optional
        Samples a chunk; by default about a 64th of the record or 32 MB, whichever is less, and at least 24.
    checkpoint : Path, optional
        NPZ file that holds the state, written by renaming now and then and at any end. If it is there already, the
        pass goes on where it ended.
    progress : callable, optional
        Called with the samples done and those of the record.

    Returns
    -------
    MotionSolution
        Values with the fit, standard deviations (n_params,) from the residual, and the numbers of equations and
        samples.

    Raises
    ------
    InputError
        If degrees of freedom, forces or quantities are missing, or a sample is; the message names the sample.
    FileError
        If the record shrinks or cannot be read on, or the checkpoint is of another study.
    """
    fit = motion_fit(structure, unknown, row_weights)
    if checkpoint is not None and checkpoint.exists():
        fit = load_motion_fit(checkpoint, fit)
    fit = reduced_by_chunks(fit, structure, record, work, longest, checkpoint, progress, fit.n_samples)
    return motion_solution(fit, work)


def reduced_by_chunks(
    fit: RecursiveMotionFit,
    structure: Structure,
    record: ChunkedRecord,
    work: FoldingKernels | None = None,
    longest: int | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    first: int = 0,
    last: int | None = None,
) -> RecursiveMotionFit:
    """Fit updated by samples `first` to `last` (not included; by default to the end) of a record, read in chunks.

    A chunk has at most `longest` samples; None lets the record choose. The state is saved at `checkpoint` now and then
    and at any end, exceptions included; `progress` is called with the samples in the fit and those of the record.
    `work` folds the rows.
    """
    rows = record_rows(fit.equations, structure, record)
    _give_back_memory()
    keeper = FitKeeper(checkpoint)
    try:
        for chunk in record.chunks(first, last, longest):
            fit = rows.reduced(fit, chunk, work)
            del chunk  # before the next one is read
            keeper.offer(fit)
            if progress is not None:
                progress(fit.n_samples, record.n_times)
    finally:
        keeper.close(fit)
    return fit


def _give_back_memory() -> None:
    """Return to the system what making the equations has freed, where the C library can (glibc)."""
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):  # another C library
        return


@dataclass(frozen=True, eq=False)
class RecordRows:
    """Operator from a record to the rows of the equations; made once for all chunks of the record.

    Attributes
    ----------
    rows : RowMaker
    gross : (4 n_dofs, n_channels) sparse array
        Sizes of the entries that make the fields from the channels.
    """

    rows: RowMaker
    gross: sparse.csr_array

    def reduced(
        self, fit: RecursiveMotionFit, chunk: FloatArray, work: FoldingKernels | None = None
    ) -> RecursiveMotionFit:
        """Fit updated by `chunk` (n_channels, n_times), samples of the record's channels.

        `work` forms and reduces the equation rows, with compiled kernels or threads; None takes the default
        `FoldingKernels()`.
        """
        state = reduced_state(fit.equations, fit.state, self.rows, chunk, work)
        channels = np.sqrt(np.einsum("ct,ct->c", chunk, chunk))
        energy = locked(fit.energy + (self.gross @ channels) ** 2)
        return replace(fit, state=state, energy=energy, n_samples=fit.n_samples + chunk.shape[1])


def record_rows(equations: TimeEquations, structure: Structure, record: ChunkedRecord) -> RecordRows:
    """The `RecordRows` of a record on a structure.

    Raises
    ------
    InputError
        If degrees of freedom, forces or quantities are missing.
    """
    mapping = channel_map(structure, record)
    equations.require(record.quantities)
    return RecordRows(channel_rows(equations, mapping), abs(mapping))


def channel_rows(equations: TimeEquations, mapping: sparse.csr_array) -> RowMaker:
    """Operator from the channels of a record directly to the rows of the equations of motion.

    `mapping` (4 n_dofs, n_channels) leads from channels to accelerations, velocities, displacements and forces. With a
    single block of equations only the sparse operator is stored, without the layout of blocks.
    """
    operator = equations.operator  # shared where the channels are the fields, one by one
    if not _is_identity(mapping):
        operator = sparse.csr_array(operator @ mapping)
    if len(equations.columns) == equations.n_dofs:
        return row_maker(operator, equations.columns)
    return only_operator(operator)


def _is_identity(matrix: sparse.csr_array) -> bool:
    """True if `matrix` is the identity, entry by entry."""
    n = matrix.shape[0]
    one_each = matrix.shape == (n, n) and matrix.nnz == n and bool((np.diff(matrix.indptr) == 1).all())
    return one_each and bool((matrix.indices == np.arange(n)).all() and (matrix.data == 1.0).all())


class FitKeeper:
    """Writes checkpoints, so seldom that they take a small part of the time, and the last one at any end."""

    def __init__(self, path: Path | None) -> None:
        self.path, self.kept = path, -1
        self.ended, self.taken = time.perf_counter(), 0.0

    def offer(self, fit: RecursiveMotionFit) -> None:
        if self.path is not None and time.perf_counter() - self.ended >= self.taken / _KEEPING:
            self._write(self.path, fit)

    def close(self, fit: RecursiveMotionFit) -> None:
        if self.path is not None and fit.n_samples not in (0, self.kept):
            self._write(self.path, fit)

    def _write(self, path: Path, fit: RecursiveMotionFit) -> None:
        """Save the fit at `path`, and note when and how long that took and the number of samples in the fit."""
        begun = time.perf_counter()
        save_motion_fit(path, fit)
        self.ended = time.perf_counter()
        self.taken, self.kept = self.ended - begun, fit.n_samples


def motion_solution(fit: RecursiveMotionFit, work: FoldingKernels | None = None) -> MotionSolution:
    """Solution of a motion fit with very many parameters by sparse factors, with standard deviations of the parameters.

    `work` are the kernels that formed the rows; only the name of their engine is used (None: the default kernels).

    Raises
    ------
    InputError
        If the fit has no samples, no motion, or no force and nothing known.
    """
    fit.require_content()
    _give_back_memory()
    chosen = work or FoldingKernels()
    solution = block_solution(fit.state, fit.equations.sizes(fit.energy))
    size = fit.n_samples * len(fit.state.columns)
    engine = chosen.words(size) if len(fit.state.columns) == fit.equations.n_dofs else "NumPy"
    std = locked(solution.standard_deviations())
    return MotionSolution(fit.equations.unknown, solution, std, fit.state.n_rows, fit.n_samples, engine)


def channel_map(structure: Structure, record: ChunkedRecord) -> sparse.csr_array:
    """Sparse matrix from the channels of one sample to accelerations, velocities, displacements and forces.

    Shape (4 n_dofs, n_channels), with zero rows for quantities that the record does not hold.

    Raises
    ------
    InputError
        If a quantity is measured at some degrees of freedom only, or there is no motion or no force.
    """
    fields = [field_map(structure, record, wanted) for wanted in (*MOTION_QUANTITIES, "force")]
    if all(field is None for field in fields[:3]):
        raise InputError(NO_MOTION)
    if fields[3] is None:
        raise InputError(NO_FORCE)
    nothing = sparse.csr_array((structure.n_dofs, len(record.channels)))
    return sparse.csr_array(sparse.vstack([nothing if field is None else field for field in fields]))


def save_motion_fit(path: str | Path, fit: RecursiveMotionFit) -> None:
    """Write triangles, energies and the number of samples done as NPZ.

    Raises
    ------
    FileError
        If the file cannot be written; a file already there stays as it was.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            layout=_LAYOUT,
            equations=equations_digest(fit.equations),
            triangles=fit.state.triangles,
            energy=fit.energy,
            error=fit.error,
            n_rows=fit.state.n_rows,
            n_samples=fit.n_samples,
        )


def load_motion_fit(path: str | Path, start: RecursiveMotionFit) -> RecursiveMotionFit:
    """Motion fit restored from the checkpoint at `path`; `start` is the fit of the same equations before any sample.

    Raises
    ------
    FileError
        If the file is damaged, or of another structure, other parameters or other weights.
    """
    path = Path(path)
    fields = npz_arrays(path, "a whole checkpoint", "delete it to begin anew")
    with damage_told(path, "a whole checkpoint", "delete it to begin anew"):
        layout, digest = str(fields["layout"]), str(fields["equations"])
        triangles, energy, error = (locked(fields[name], np.float64) for name in ("triangles", "energy", "error"))
        n_rows, n_samples = int(fields["n_rows"]), int(fields["n_samples"])
    if layout != _LAYOUT or digest != equations_digest(start.equations):
        raise FileError(
            f"{path}: is the checkpoint of another structure, other parameters or other weights; delete it to begin anew,"
            " or name another file"
        )
    if triangles.shape != start.state.triangles.shape or energy.shape != start.energy.shape:
        raise FileError(f"{path}: is not a whole checkpoint; delete it to begin anew")
    require_finite("triangles", triangles, f"{path} is damaged: delete it to begin anew")
    state = replace(start.state, triangles=triangles, n_rows=n_rows)
    return replace(start, state=state, energy=energy, error=error, n_samples=n_samples)


def equations_digest(equations: TimeEquations) -> str:
    """SHA-256 digest of the columns and the operator of the equations, to recognize checkpoints that fit them."""
    digest = hashlib.sha256()
    for array in (equations.columns, equations.operator.indptr, equations.operator.indices, equations.operator.data):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
