"""Checks of records (warnings) and of models (errors) before anything is estimated."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray
from structid.core.errors import SingularModelError
from structid.fem import Structure
from structid.records import FrfRecord

_DENSE_UP_TO = 600
_NULL = 1e-12
#: Lines from which on the turning of phases is no chance, and the part of it the wrong way that is none either.
_ENOUGH_LINES, _WRONG_WAY = 100, 0.5


def record_warnings(record: FrfRecord) -> tuple[str, ...]:
    """Warnings about signs and coherence of an FRF record that do not look right.

    A driving point must have a real part of its mobility of at least 0 (it can only take power in); a record whose
    mobility there is negative at most lines has a sensor or load with the wrong sense or another sign convention.
    Phases of responses fall with frequency; where they rise, imaginary parts have the other sign. Coherence is warned
    about for a sensor with less than 0.8 at more than 20 % of its values.
    """
    warnings = []
    for i, load in enumerate(record.inputs):
        for o, sensor in enumerate(record.outputs):
            if sensor.unsigned == load.unsigned and record.frequency[-1] > 0:
                warnings.extend(_driving_point(record, o, i))
    warnings.extend(_phases_that_rise(record))
    if record.coherence is not None:
        low = (record.coherence < 0.8).mean(axis=(0, 2))
        for sensor, part in zip(record.outputs, low, strict=True):
            if part > 0.2:
                warnings.append(f"coherence of {sensor} is below 0.8 at {100 * part:.0f} % of the lines")
    return tuple(warnings)


def _phases_that_rise(record: FrfRecord) -> list[str]:
    """List with a warning if phases rise with frequency over all channels together; empty if not.

    At least 100 lines are needed. Phases rise if the imaginary parts of H(k+1) conj(H(k)) sum to more than half of
    their absolute sum.
    """
    turning = (record.values[1:] * record.values[:-1].conj()).imag
    total = float(np.abs(turning).sum())
    if len(record.frequency) < _ENOUGH_LINES or total == 0 or float(turning.sum()) <= _WRONG_WAY * total:
        return []
    return [
        "phases rise through the resonances, so that responses come before their forces: imaginary parts have the other sign, as of"
        " a time convention exp(-i omega t); conjugate the FRFs in the export"
    ]


def _driving_point(record: FrfRecord, o: int, i: int) -> list[str]:
    """List with a warning if the mobility of output `o` over load `i` has a negative real part at most lines.

    It is empty if not. `o` and `i` are indices of channels at the same degree of freedom, in either sense; 0 Hz is left
    out.
    """
    keep = record.frequency > 0
    mobility = record.lines(np.flatnonzero(keep)).as_kind("mobility").values[:, o, i]
    sense = record.outputs[o].sign * record.inputs[i].sign
    negative = float((sense * mobility.real < 0).mean())
    if negative <= 0.5:
        return []
    return [
        f"driving point {record.outputs[o]} / {record.inputs[i]}: the real part of mobility is negative at"
        f" {100 * negative:.0f} % of the lines; check the sense of the sensor, the load and the sign convention of the FRF"
    ]


def require_sound_model(structure: Structure, values: FloatArray, lowest: float) -> None:
    """Raise `SingularModelError` where the model's matrices are not finite, it has no mass, or it has a mechanism.

    Looked for, with the degrees of freedom that take part, are motion without mass, damping and stiffness; motion
    without mass and stiffness; and, where a line at 0 Hz is used, motion without stiffness (supports are missing).
    Models of more than 600 degrees of freedom are left to the factorization.

    Parameters
    ----------
    structure : Structure
        The model; not checked if it has no matrices.
    values : (n_values,) float array
        Property values.
    lowest : float
        Lowest line used, Hz.
    """
    if structure.n_dofs > _DENSE_UP_TO or not structure.has_matrices:
        return
    mass, stiffness, viscous, structural = (
        structure.matrix(matrix_kind, values).toarray()
        for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    if not all(np.isfinite(matrix).all() for matrix in (mass, stiffness, viscous, structural)):
        raise SingularModelError(
            "the model's matrices are not finite: a property is too large or too small; correct it"
        )
    if not mass.any() and structure.has_modes:
        raise SingularModelError("the structure has no mass; add point masses, or `mass` to its beams or bars")
    elastic = stiffness + structural
    every = _scaled(elastic) + _scaled(mass) + _scaled(viscous)
    loose = _null_words(structure, every)
    if loose:
        raise SingularModelError(
            f"the model is singular: {loose} can move with neither mass nor stiffness; fix it in `fixed`, leave its"
            " direction out of `active`, or give it stiffness or mass"
        )
    massless = np.diag(mass) <= 0
    loose = _null_words(structure, _scaled(elastic)[np.ix_(massless, massless)], np.flatnonzero(massless))
    if loose:
        raise SingularModelError(
            f"the model is singular: {loose} can move with no mass and no stiffness, so modes do not exist; fix it in"
            " `fixed` or give it stiffness"
        )
    if lowest == 0:
        loose = _null_words(structure, elastic)
        if loose:
            raise SingularModelError(
                f"the model is singular at 0 Hz: nothing holds {loose}; add supports in `fixed` or springs to the"
                " ground, or leave 0 Hz out with `band` in [method]"
            )


def _scaled(matrix: FloatArray) -> FloatArray:
    largest = np.abs(matrix).max(initial=0.0)
    return matrix / largest if largest > 0 else matrix


def _null_words(structure: Structure, matrix: FloatArray, members: np.ndarray | None = None) -> str:
    """Names of the degrees of freedom that move most in a null vector of `matrix`, at most six; "" if it is regular.

    `matrix` (n, n) is positive semidefinite; `members` (n,) are the indices of its rows among all degrees of
    freedom, all by default. If diagonal entries are 0, their rows alone are named; else those above a tenth of the
    largest.
    """
    if not len(matrix):
        return ""
    index = np.arange(len(matrix)) if members is None else members
    diagonal = np.sqrt(np.abs(np.diag(matrix)))
    empty = diagonal == 0
    if empty.any():
        return ", ".join(structure.words(structure.dofs[i]).rstrip("+") for i in index[empty][:6])
    values, vectors = linalg.eigh(matrix / np.outer(diagonal, diagonal))
    if values[0] > _NULL * len(matrix):
        return ""
    part = np.abs(vectors[:, 0] / diagonal)
    largest = np.argsort(-part, kind="stable")[:6]
    chosen = sorted(int(i) for i in largest if part[i] > 0.1 * part.max())
    return ", ".join(structure.words(structure.dofs[index[i]]).rstrip("+") for i in chosen)
