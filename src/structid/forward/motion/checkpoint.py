"""The state of a fit of measured motion in a file: written by renaming, so that it is whole at any instant."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.core.arrays import locked, require_finite
from structid.core.errors import FileError
from structid.files import atomic_write, damage_told
from structid.files.npy import npz_arrays
from structid.forward.motion.equations import TimeEquations
from structid.forward.motion.fit import RecursiveMotionFit

_LAYOUT = "motion fit 1"


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
    """Motion fit restored from the checkpoint at `path`; `start` is the fit before any sample, for comparison.

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
    """SHA-256 digest of equations and parameters, to recognize checkpoints that fit them."""
    found = hashlib.sha256()
    for array in (equations.columns, equations.operator.indptr, equations.operator.indices, equations.operator.data):
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()
