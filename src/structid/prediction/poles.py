"""A structure as a sum over its poles, on a basis of few motions: what makes hundreds of predictions cheap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, signal, sparse

from structid.core.arrays import ComplexArray, FloatArray, NumberArray
from structid.core.errors import InputError, SingularModelError
from structid.dynamics import modes
from structid.dynamics.factorization import factorizer
from structid.fem import Structure
from structid.fem.modal_damping import ALL_MODES

#: Times the highest frequency up to which modes are in the basis.
_ABOVE = 2.0
#: Part of a vector's own size that the basis must lack for it to be added.
_NEW = 1e-8
#: omega^2 of a rigid body's motion, in parts of the largest, and its damping, in parts of 2 omega of that.
_RIGID = 1e-9
_MATRICES = ("mass", "damping", "stiffness", "structural_damping")


@dataclass(frozen=True, eq=False)
class ReducedMatrices:
    """Matrices of a structure on a basis whose motions are its undamped modes there: M = I, K = diag(omega^2).

    Attributes
    ----------
    omega : (n_modes,) float array
        rad/s; 0 of a rigid body's motion.
    damping, structural : (n_modes, n_modes) float arrays
        Viscous damping, and imaginary part of the complex stiffness.
    outputs : (n_outputs, n_modes) float array
        Motion of each sensor in each mode.
    inputs : (n_modes, n_inputs) float array
        Modal force of each unit load.
    """

    omega: FloatArray
    damping: FloatArray
    structural: FloatArray
    outputs: FloatArray
    inputs: FloatArray

    @property
    def is_rigid(self) -> np.ndarray:
        """A mask (n_modes,) of the free rigid motions that nothing damps."""
        largest = float(self.omega.max(initial=0.0))
        couples = np.abs(self.damping).sum(axis=0) > 2 * np.sqrt(_RIGID) * largest
        return np.asarray((self.omega**2 <= _RIGID * largest**2) & ~couples)

    def viscous_equivalent(self) -> FloatArray:
        """Viscous damping matrix (n_modes, n_modes) that takes as much energy at each resonance as all damping together.

        It is `damping` plus the diagonal of `structural` over omega.
        """
        lost = np.divide(np.diag(self.structural), self.omega, out=np.zeros_like(self.omega), where=self.omega > 0)
        return self.damping + np.diag(lost)


def reduce_structure(structure: Structure, values: FloatArray, basis: FloatArray, sides: Sides) -> ReducedMatrices:
    """Matrices of a structure with the property `values` (n_values,) on its undamped modes within the motions `basis`.

    The result has circular frequencies (rad/s), damping and imaginary stiffness (n_vectors, n_vectors), and the modal
    motions and forces of the outputs and inputs `sides`. `basis` is (n_dofs, n_vectors). Modal damping of the structure
    becomes viscous damping of these modes.

    Raises
    ------
    SingularModelError
        If a motion of the basis has no positive mass.
    """
    plain, ratio = _without_modal_damping(structure, values)
    mass, damping, stiffness, structural = (
        basis.T @ (plain.matrix(matrix_kind, values) @ basis) for matrix_kind in _MATRICES
    )
    try:
        eigenvalues, turn = linalg.eigh(stiffness, mass)
    except linalg.LinAlgError as error:
        raise SingularModelError("the mass of the model is not positive: a value has run away") from error
    omega = np.sqrt(np.maximum(eigenvalues, 0.0))
    motions = basis @ turn
    return ReducedMatrices(
        omega,
        turn.T @ damping @ turn + 2 * ratio * np.diag(omega),
        turn.T @ structural @ turn,
        sides.outputs.T @ motions,
        motions.T @ sides.inputs,
    )


@dataclass(frozen=True, eq=False)
class Sides:
    """Inputs and outputs of a structure: columns over its degrees of freedom.

    Attributes
    ----------
    outputs, inputs : (n_dofs, n_outputs) and (n_dofs, n_inputs) sparse arrays
    """

    outputs: sparse.csc_array
    inputs: sparse.csc_array


def reduction_basis(
    structure: Structure, values: Sequence[FloatArray], sides: Sides, lowest: float, highest: float
) -> FloatArray:
    """Mass-orthonormal motions that span the responses of a structure between two frequencies, (n_dofs, n_vectors).

    They are the modes up to twice `highest` for each of the property `values`, and, for the first of these, the undamped
    responses at `lowest` and `highest` to every load and at every sensor, which carry the flexibility of the modes that
    are left out. There are none without loads and sensors where no mode lies below twice `highest`.

    Parameters
    ----------
    structure : Structure
    values : sequence of (n_values,) float arrays
        The identified values, then others within their uncertainty.
    sides : Sides
        Loads and sensors.
    lowest, highest : float
        Hz, greater than 0.
    """
    columns = []
    both = sparse.hstack([sides.inputs, sides.outputs]).tocsc()
    for number, point in enumerate(values):
        plain, _ = _without_modal_damping(structure, point)
        mass, stiffness = plain.matrix("mass", point), plain.matrix("stiffness", point)
        n_modes = None if structure.n_dofs <= 600 else 20
        shapes = modes(mass, stiffness, n_modes=n_modes)
        while n_modes is not None and shapes.frequency[-1] < _ABOVE * highest and n_modes < structure.n_dofs - 2:
            n_modes = min(2 * n_modes, structure.n_dofs - 2)
            shapes = modes(mass, stiffness, n_modes=n_modes)
        columns.append(shapes.mode_shapes[:, shapes.frequency <= _ABOVE * highest])
        if number == 0 and both.shape[1]:
            for shift in (lowest, highest):
                shifted = sparse.csc_array(stiffness - (2 * np.pi * shift) ** 2 * mass)
                columns.append(_solve(shifted, both.toarray()))
    return _independent(np.hstack(columns), plain.matrix("mass", values[0]))


def extend_basis(basis: FloatArray, columns: FloatArray, mass: sparse.csc_array) -> FloatArray:
    """Mass-orthonormal motions that span `basis` (n_dofs, n_vectors) and further `columns` (n_dofs, n_columns)."""
    return _independent(np.hstack([basis, columns]), mass)


def _solve(matrix: sparse.csc_array, right: FloatArray) -> FloatArray:
    """The solution (n, n_right) of a sparse symmetric system with several right sides (n, n_right)."""
    matrix.sort_indices()
    if not matrix.diagonal().all():
        return np.asarray(sparse.linalg.spsolve(matrix, right)).reshape(right.shape)
    return np.asarray(factorizer().analyse(matrix.indices, matrix.indptr).factor(matrix.data).solve(right))


def _independent(columns: FloatArray, mass: sparse.csc_array) -> FloatArray:
    """Mass-orthonormal motions (n_dofs, n_kept) that span `columns` (n_dofs, n), without those that hardly add any.

    `columns` are scaled to unit mass; directions whose eigenvalue of the columns' mass products is below 1e-8 of the
    largest, and motions without mass, are left out.
    """
    if not columns.size:
        return columns
    energy = np.sqrt(np.maximum(np.einsum("ij,ij->j", columns, mass @ columns), 0.0))
    moving = energy > 0
    scaled = columns[:, moving] / energy[moving]
    values, turn = linalg.eigh(scaled.T @ (mass @ scaled))
    kept = values > _NEW * values[-1]
    return np.asarray(scaled @ (turn[:, kept] / np.sqrt(values[kept])))


def _without_modal_damping(structure: Structure, values: FloatArray) -> tuple[Structure, float]:
    """Structure without the damping ratio that all modes share, and that ratio; 0.0 if it has none.

    `values` (n_values,) are the property values.
    """
    if structure.damping_ratio is None:
        return structure, 0.0
    place = next(item.values for item in structure.properties if item.element == ALL_MODES)
    return replace(structure, damping_ratio=None), float(values[place][0])


@dataclass(frozen=True, eq=False)
class PoleSum:
    """Responses as a sum over poles: H(s) = sum of out_k in_k / (s - pole_k) + integrals.

    Attributes
    ----------
    poles : (n_poles,) complex array
        1/s; of a structure with loss factors they hold for positive frequencies alone.
    out : (n_outputs, n_poles) complex array
    into : (n_poles, n_inputs) complex array
    integrals : (3, n_outputs, n_inputs) array
        What is read of the input integrated twice over time, once, and of itself: coefficients of 1/s^2, 1/s and 1. Displacements
        have free rigid motions in the first.
    """

    poles: ComplexArray
    out: ComplexArray
    into: ComplexArray
    integrals: NumberArray

    def frf(self, frequency: FloatArray) -> ComplexArray:
        """Outputs per unit input at `frequency` in Hz, (n_frequencies, n_outputs, n_inputs)."""
        s = 2j * np.pi * frequency
        residues = self.out.T[:, :, None] * self.into[:, None, :]
        flat = (1 / (s[:, None] - self.poles)) @ residues.reshape(len(self.poles), int(np.prod(residues.shape[1:])))
        total = flat.reshape(len(s), *self.integrals.shape[1:])
        for power, part in zip((-2, -1, 0), self.integrals, strict=True):
            if part.any():
                total = total + part * (s**power)[:, None, None]
        return np.asarray(total)

    def combined_frf(self, frequency: FloatArray, orders: Sequence[int]) -> ComplexArray:
        """FRFs (n_frequencies, n_outputs, n_inputs) of the outputs of `combined`, at `frequency` (n_frequencies,) in Hz.

        Each derivative is taken by its power of i omega, which keeps digits at low frequencies. `orders` are those of
        `combined`.
        """
        s = (2j * np.pi * frequency)[:, None, None]
        groups = np.split(self.frf(frequency), len(orders), axis=1)
        return np.asarray(sum(s**order * group for order, group in zip(orders, groups, strict=True)))

    def combined(self, orders: Sequence[int]) -> PoleSum:
        """Pole sum of outputs that add derivatives, from displacements in one group of outputs for each of `orders`.

        `orders` are 0 to 2; groups of the outputs of `self` have equal size, and their derivatives are added up. First
        derivatives have the sum over residues as a direct part (0 under forces, which do not move a mass at once),
        second ones that of residues times poles.
        """
        out = np.zeros((len(self.out) // len(orders), len(self.poles)), dtype=complex)
        integrals = np.zeros((3, len(out), self.into.shape[1]), dtype=complex)
        groups = np.split(self.out, len(orders)), np.split(self.integrals, len(orders), axis=1)
        for order, shapes, parts in zip(orders, *groups, strict=True):
            out += self.poles**order * shapes
            integrals[order:] += parts[: 3 - order]
            if order:
                integrals[2] += (shapes * self.poles ** (order - 1)) @ self.into
        return PoleSum(self.poles, out, self.into, integrals)


def sum_over_poles(reduced: ReducedMatrices, damping: FloatArray | None = None) -> PoleSum:
    """Receptances of a reduced structure as a sum over its poles, with whatever damping it has.

    Parameters
    ----------
    reduced : ReducedMatrices
    damping : (n_modes, n_modes) float array, optional
        Viscous damping in place of `reduced.damping` and `reduced.structural`.

    Returns
    -------
    PoleSum
        Displacements of the outputs per unit input: two poles (1/s) for each elastic mode, and free rigid motions as
        the input integrated twice.

    Raises
    ------
    InputError
        If a mode is critically damped to all digits.

    References
    ----------
    Foss (1958), J. Appl. Mech. 25, 361-364: the symmetric form of first order, [C M; M 0] and [K 0; 0 -M].
    """
    rigid = reduced.is_rigid
    moving = np.ix_(~rigid, ~rigid)
    viscous = (reduced.damping if damping is None else damping)[moving]
    stiffness = np.diag(reduced.omega[~rigid] ** 2) + (0 if damping is not None else 1j * reduced.structural[moving])
    n, one = len(viscous), np.eye(len(viscous))
    rate = np.block([[np.zeros((n, n)), one], [-stiffness, -viscous]])
    poles, states = np.linalg.eig(rate)
    shapes, speeds = states[:n], states[n:]
    scale = np.einsum("ij,ij->j", shapes, viscous @ shapes) + 2 * np.einsum("ij,ij->j", shapes, speeds)
    if n and np.abs(scale).min() <= np.finfo(float).eps * np.abs(speeds).max():
        raise InputError(
            "a mode is critically damped to all digits, which a sum over poles cannot hold; change its damping"
        )
    out, into = reduced.outputs[:, ~rigid] @ shapes, (shapes.T @ reduced.inputs[~rigid]) / scale[:, None]
    double = reduced.outputs[:, rigid] @ reduced.inputs[rigid]
    return PoleSum(poles, out, into, np.stack([double, np.zeros_like(double), np.zeros_like(double)]))


def simulate_history(system: PoleSum, loads: FloatArray, sampling_rate: float, between: FloatArray) -> FloatArray:
    """Outputs (n_times, n_outputs) from rest under loads that are linear between samples, exact at the samples.

    Parameters
    ----------
    system : PoleSum
        Of viscous damping.
    loads : (n_times, n_inputs) float array
        N or N m, and m/s^2 of supports: what outputs follow at once, as the direct part of accelerations.
    sampling_rate : float
        Samples per second.
    between : (n_times, n_inputs) float array
        The loads as they run in straight lines between samples, which drive the poles: `loads` themselves, or for loads
        behind a filter against aliasing those of `band_limited_loads`.
    """
    step = 1 / sampling_rate
    upper = system.poles.imag >= 0
    poles, out = system.poles[upper], system.out[:, upper]
    weight = np.where(poles.imag > 0, 2.0, 1.0)
    driven = between @ system.into[upper].T
    total = np.zeros((len(loads), len(out)))
    for k, pole in enumerate(poles):
        before, after = _first_order_hold(pole, step)
        inputs = np.zeros(len(loads), dtype=complex)
        inputs[1:] = before * driven[:-1, k] + after * driven[1:, k]
        state = signal.lfilter([1.0], [1.0, -np.exp(pole * step)], inputs)
        total += weight[k] * (state[:, None] * out[:, k]).real
    for derivatives, part in enumerate(system.integrals):
        if part.any():
            total += _rigid_history(loads if derivatives == 2 else between, step, derivatives) @ part.real.T
    return total


def _first_order_hold(pole: complex, step: float) -> tuple[complex, complex]:
    """Weights of the load at start and end of a step (s) in x' = pole x + f, where f varies linearly; pole in 1/s."""
    z = pole * step
    if abs(z) < 1e-3:
        return step * (0.5 + z / 3 + z**2 / 8 + z**3 / 30), step * (0.5 + z / 6 + z**2 / 24 + z**3 / 120)
    first = (np.exp(z) - 1) / z
    second = (np.exp(z) - 1 - z) / z**2
    return step * (first - second), step * second


def _rigid_history(loads: FloatArray, step: float, derivatives: int) -> FloatArray:
    """Displacement, velocity or acceleration (`derivatives` 0, 1 or 2) of unit masses from rest under loads, (n_times, n).

    `loads` (n_times, n) are linear between samples, `step` is in s.
    """
    if derivatives == 2:
        return loads
    first, second = loads[:-1], loads[1:]
    speed = np.zeros_like(loads)
    np.cumsum(step * (first + second) / 2, axis=0, out=speed[1:])
    if derivatives == 1:
        return speed
    way = np.zeros_like(loads)
    np.cumsum(step * speed[:-1] + step**2 * (2 * first + second) / 6, axis=0, out=way[1:])
    return way
