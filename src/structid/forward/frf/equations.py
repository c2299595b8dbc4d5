"""Every degree of freedom measured: the equations of motion as linear equations in the parameters."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, stack_real
from structid.core.errors import InputError
from structid.fem import Structure
from structid.fem.assembly import structure_matrix_kinds
from structid.forward.frf.friction import sliding_amplitudes
from structid.forward.frf.line_equations import matrix_coefficients, read
from structid.forward.sensitivity import weight_slope
from structid.records import FrfRecord
from structid.unknowns import Parameters

_MOST_ITERATIONS = 20


def measures_everything(structure: Structure, record: FrfRecord) -> bool:
    """True if the sensors of `record` determine the motion of every free degree of freedom of `structure`.

    They do if their rank is the number of these. False if the structure has no free degree of freedom, for responses
    per motion instead of force, and with measured components.
    """
    if record.is_per_motion or structure.measured:
        return False
    sensors = structure.selection(record.outputs)
    if sensors.shape[1] < structure.n_dofs or structure.n_dofs == 0:
        return False
    return int(np.linalg.matrix_rank(sensors.toarray())) == structure.n_dofs


def one_step_values(structure: Structure, unknown: Parameters, record: FrfRecord) -> FloatArray:
    """Physical parameters from one linear least-squares solve of Z(p) x = f with the measured motion x.

    With the motion of all degrees of freedom the equations are linear in masses, dampings and stiffnesses, so no start
    is needed. If a stiffness and its loss factor are both unknown the equations are bilinear: they are linearized at
    the start of the parameters, then at each answer, and the solve is repeated up to 20 times. Rows are not weighted.
    The classical iteration of Norris (1986), Eq. 4.15, uses the motion of the model instead.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    record : FrfRecord
        Every free degree of freedom among its outputs.

    Returns
    -------
    (n_params,) float array, physical units; not forced to be positive.

    Raises
    ------
    InputError
        If the sensors do not determine every degree of freedom.
    """
    if not measures_everything(structure, record):
        raise InputError(
            f"the one-step solve needs every one of the {structure.n_dofs} free degrees of freedom measured;"
            f" the record has {len(record.outputs)} outputs. Use `identify`, which needs only some"
        )
    motion = _motion(structure, record)
    coefficients = matrix_coefficients(
        structure_matrix_kinds(structure), record.laplace, sliding_amplitudes(structure, record)
    )
    loads = structure.selection(record.inputs).toarray()
    values = np.array(unknown.start)
    bilinear = any(part.is_product for part in structure.contributions)
    for _ in range(_MOST_ITERATIONS if bilinear else 1):
        residual, columns = _equations(structure, unknown, values, motion, coefficients)
        right = stack_real((np.broadcast_to(loads, residual.shape) - residual).reshape(-1))
        matrix = stack_real(columns.reshape(-1, unknown.n_params))
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0] = 1.0
        step = np.linalg.lstsq(matrix / scale, right, rcond=None)[0] / scale
        values = values + step
        if np.abs(step).max(initial=0.0) <= 1e-14 * np.abs(values).max(initial=0.0):
            break
    return values


def _motion(structure: Structure, record: FrfRecord) -> ComplexArray:
    """Measured receptance of every free degree of freedom, (n_frequencies, n_dofs, n_inputs), from all sensors."""
    receptance = record.as_kind("receptance").values
    sensors = structure.selection(record.outputs).toarray().T
    return np.linalg.pinv(sensors) @ receptance


def _equations(
    structure: Structure, unknown: Parameters, physical: FloatArray, motion: ComplexArray, coefficients: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Forces Z(p) x, (n_frequencies, n_dofs, n_inputs), and their derivative by p, (..., n_params), at fixed motion x.

    Z is the dynamic stiffness. `physical` (n_params,) are the parameters p, `motion` (n_frequencies, n_dofs, n_inputs)
    is x, and `coefficients` (n_frequencies, n_matrices) are those of the matrices in Z.
    """
    matrix_kinds = structure_matrix_kinds(structure)
    values = unknown.values(physical)
    forces = np.zeros(motion.shape, dtype=np.complex128)
    slopes = np.zeros((*motion.shape, unknown.n_params), dtype=np.complex128)
    for part in structure.contributions:
        weights, change = part.weights(values), weight_slope(part, unknown, values).tocsc()
        matrix_kind = coefficients[:, matrix_kinds.index(part.matrix_kind), None, None]
        forces += matrix_kind * read(sparse.csr_array(part.blocks.assemble(weights)), motion)
        for k in np.flatnonzero(np.diff(change.indptr)):
            slope = part.blocks.assemble(change[:, [k]].toarray()[:, 0])
            slopes[..., k] += matrix_kind * read(sparse.csr_array(slope), motion)
    return forces, slopes
