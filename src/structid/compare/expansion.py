"""Between sensors and all degrees of freedom: the model seen from its sensors, and measured shapes carried on to the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from structid.core.arrays import FloatArray
from structid.core.errors import InputError, SingularModelError
from structid.dynamics import Modes

#: Part of the largest singular value that counts as none.
_RANK = 1e-8
#: Condition of the modes at the sensors beyond which they cannot be distinguished.
_WORST = 100.0


def constrained_shapes(dynamic_stiffness: sparse.csc_array, sensors: sparse.csc_array) -> FloatArray:
    """Shapes of a model with a unit motion at one sensor, 0 at the others and no other forces, (n_dofs, n_channels).

    Column c is for sensor c: the solution x of Z x = S f, S' x = e, with the forces f at the sensors and the unit
    vector e of c. With Z = K it is Guyan's (1965) reduction, with Z = K - omega^2 M the dynamic expansion of Kidder
    (1973). Sensors may read sums of degrees of freedom.

    Parameters
    ----------
    dynamic_stiffness : (n_dofs, n_dofs) sparse array
        Z, symmetric; singular where the structure is free, as long as the sensors hold it.
    sensors : (n_dofs, n_channels) sparse array
        S, see `Structure.selection`.

    Raises
    ------
    InputError
        If there is no sensor, or sensors read the same motion.
    SingularModelError
        If the sensors leave a motion without stiffness free.

    References
    ----------
    Guyan (1965), AIAA Journal 3(2), 380; Kidder (1973), AIAA Journal 11(6), 892-893.
    """
    n, count = sensors.shape
    values = np.linalg.eigvalsh((sensors.T @ sensors).toarray())
    if not count or values[0] <= _RANK * values[-1]:
        raise InputError("sensors read the same motion more than once; leave one of them out with `channels_used`")
    size = float(np.abs(dynamic_stiffness.diagonal()).mean()) or 1.0
    border = size * sensors
    whole = sparse.block_array([[dynamic_stiffness, border], [border.T, None]], format="csc")
    right = np.zeros((n + count, count))
    right[n:] = size * np.eye(count)
    try:
        solution = np.asarray(splu(whole).solve(right)[:n])
    except RuntimeError as error:
        raise SingularModelError(
            "the model can move without force while every sensor stands still; add supports or sensors"
        ) from error
    return solution


def serep_basis(seen: FloatArray, mode_shapes: FloatArray) -> FloatArray:
    """Sums of modes that are 1 at one sensor and 0 at the others, as closely as they can be, (n_dofs, n_channels).

    This is T = Phi (S' Phi)^+, exact where there are as many modes as sensors, else in the sense of least squares.

    Parameters
    ----------
    seen : (n_channels, n_modes) float array
        The modes at the sensors, S' Phi.
    mode_shapes : (n_dofs, n_modes) float array
        Phi.

    References
    ----------
    O'Callahan, Avitabile and Riemer (1989), System equivalent reduction expansion process (SEREP), Proc. 7th IMAC.
    """
    return np.asarray(mode_shapes @ np.linalg.pinv(seen, rcond=_RANK))


def reduced_mass(mass: sparse.csc_array, basis: FloatArray) -> FloatArray:
    """Reduced mass matrix T' M T, (n_channels, n_channels), for a basis T of `constrained_shapes` or `serep_basis`."""
    return np.asarray(basis.T @ (mass @ basis))


@dataclass(frozen=True, eq=False)
class ExpandedShapes:
    """Measured shapes on all degrees of freedom.

    Attributes
    ----------
    shapes : (n_dofs, n_modes) float array
        In the scale of the measured shapes; NaN of a mode without a known entry, as are all others of it.
    std : (n_dofs, n_modes) float array
        From noise of the shapes and, where stated, error of the model; NaN where neither is known.
    residual : (n_channels, n_modes) float array
        Expanded less measured, at the sensors; zero of a dynamic expansion, which keeps what was measured; NaN where an
        entry is unknown.
    noise : (n_channels, n_modes) float array
        Standard deviation of the measured entries that was counted on: stated, or from the residual.
    basis : tuple of tuple of int
        Modes of the model that each shape is made of; () of a dynamic expansion, and where no entry is known.
    """

    shapes: FloatArray
    std: FloatArray
    residual: FloatArray
    noise: FloatArray
    basis: tuple[tuple[int, ...], ...]


def expand(
    measured: FloatArray,
    frequency: FloatArray,
    sensors: sparse.csc_array,
    modes: Modes,
    basis: Sequence[Sequence[int]],
    *,
    shape_std: FloatArray | None = None,
    model_error: float = 0.0,
    dynamic: tuple[sparse.csc_array, sparse.csc_array] | None = None,
) -> ExpandedShapes:
    """Measured shapes psi = S' x + n, known at sensors, expanded to shapes x = G psi at all degrees of freedom.

    SEREP takes G = Phi_b (S' Phi_b)^+ with the modes b of `basis`: shapes are sums of those modes. The dynamic
    expansion takes the motion at the measured frequency without force where no sensor is, see `constrained_shapes`.

    The error of x is (I - G S') e - G n. Noise n has the covariance diag(`shape_std`)^2. An error of the model turns
    its mode r towards the others, e = q sum_j c_j phi_j; with a `model_error` of eps its stiffness errs between two
    modes by phi_j' dK phi_r = E_jr omega_j omega_r, E_jr of standard deviation eps, so that std(c_j) = eps omega_j
    omega_r / |omega_j^2 - omega_r^2|, and never above 1, to first order. Far above r it is c = -(I + E)^-1 E_r, whose
    variance n modes together raise by 1 + 3 n eps^2, to second order. q is the part of phi_r in x.

    Parameters
    ----------
    measured : (n_channels, n_modes) float array
        Real shapes psi, see `structid.similarity.most_real`; NaN where an entry is unknown: each shape is expanded from
        the sensors at which it is known.
    frequency : (n_modes,) float array
        Measured natural frequencies, Hz.
    sensors : (n_dofs, n_channels) sparse array
        S, see `Structure.selection`.
    modes : Modes
        Modes of the model: those of `basis`, and those that an error of the model may bring in.
    basis : sequence of sequence of int
        For each measured shape the model modes b, counted from 0, its partner first. Modes that the sensors cannot
        distinguish from earlier ones are not used.
    shape_std : (n_channels, n_modes) float array, optional
        Standard deviation of every entry; from the residual of SEREP where sensors are more than modes, else unknown.
    model_error : float
        eps, relative. Elements that are each off by 10 % independently make about 0.1 over the root of their number. It
        is taken to second order: n eps^2, the relative variance of a stiffness error, is to stay below 0.1.
    dynamic : (mass, stiffness), optional
        Matrices (n_dofs, n_dofs) for the dynamic expansion; without them it is SEREP.

    Returns
    -------
    ExpandedShapes
        Shapes and standard deviations (n_dofs, n_modes), residuals and noise at the sensors, and the modes used for
        each shape. What is unknown is NaN, as is a shape without a known entry.

    Raises
    ------
    InputError
        If sizes disagree, or no mode of the basis moves the sensors.

    References
    ----------
    O'Callahan, Avitabile and Riemer (1989), Proc. 7th IMAC; Kidder (1973), AIAA Journal 11(6), 892-893; Brincker,
    Skafte, Lopez-Aenlle, Sestieri, D'Ambrogio and Canteli (2014), Mech. Syst. Signal Process. 45, 91-104, for few modes
    near the measured one as the basis; Fox and Kapoor (1968), AIAA Journal 6(12), 2426-2429, Eq. (24) for the turning.
    """
    n_channels, n_modes = measured.shape
    if sensors.shape[1] != n_channels or len(frequency) != n_modes or len(basis) != n_modes or not all(map(len, basis)):
        raise InputError(
            f"`measured` is {measured.shape}, and `sensors` has {sensors.shape[1]} channels, `frequency` {len(frequency)} and"
            f" `basis` {len(basis)} modes; they must agree, and every shape needs a mode"
        )
    everywhere = np.asarray(sensors.T @ modes.mode_shapes)
    shapes, std = (np.full((sensors.shape[0], n_modes), np.nan) for _ in range(2))
    residual, noise = (np.full(measured.shape, np.nan) for _ in range(2))
    used: list[tuple[int, ...]] = []
    for r in range(n_modes):
        rows = np.flatnonzero(~np.isnan(measured[:, r]))
        if not len(rows):
            used.append(())
            continue
        seen, entries = everywhere[rows], measured[rows, r]
        if dynamic is None:
            chosen = _distinguishable(seen, basis[r])
            carry = modes.mode_shapes[:, chosen] @ np.linalg.pinv(seen[:, chosen])
        else:
            mass, stiffness = dynamic
            omega = 2 * np.pi * float(frequency[r])
            chosen, carry = (), constrained_shapes(sparse.csc_array(stiffness - omega**2 * mass), sensors[:, rows])
        shapes[:, r] = carry @ entries
        residual[rows, r] = (sensors.T @ shapes[:, r])[rows] - entries
        if shape_std is not None:
            noise[rows, r] = shape_std[rows, r]
        elif chosen and len(rows) > len(chosen):
            noise[rows, r] = np.sqrt((residual[rows, r] ** 2).sum() / (len(rows) - len(chosen)))
        variance = np.square(carry) @ np.square(noise[rows, r])
        if model_error > 0:
            left = modes.mode_shapes - carry @ seen
            near = chosen or _distinguishable(seen, basis[r])
            part = float((np.linalg.pinv(seen[:, near]) @ entries)[0])
            variance = variance + np.square(left) @ (part**2 * _mixing_variance(modes, near[0], model_error))
        std[:, r] = np.sqrt(variance)
        used.append(chosen)
    return ExpandedShapes(shapes, std, residual, noise, tuple(used))


def _distinguishable(seen: FloatArray, modes: Sequence[int]) -> tuple[int, ...]:
    """Indices from `modes`, in order, of those whose shapes at the sensors are distinguishable.

    Scaled to a largest entry of 1, they together have a condition number of at most 100; a mode that depends on earlier
    ones is left out. `seen` (n_channels, n_modes) are the shapes of all modes of the model at the sensors.

    Raises
    ------
    InputError
        If none of `modes` moves the sensors.
    """
    size = np.abs(seen).max(axis=0)
    chosen: list[int] = []
    for k in modes:
        candidates = [*chosen, k]
        values = np.linalg.svd(seen[:, candidates] / np.maximum(size[candidates], 1e-300), compute_uv=False)
        if size[k] > 0 and len(candidates) <= len(seen) and values[0] <= _WORST * values[-1]:
            chosen.append(k)
    if not chosen:
        raise InputError("no mode of the model that a shape could be made of moves the sensors; check the channels")
    return tuple(chosen)


def _mixing_variance(modes: Modes, index: int, model_error: float) -> FloatArray:
    """Variance of each model mode's part in a measured shape, (n_modes,), over the squared part of the mode `index`.

    A relative stiffness error `model_error` mixes modes the more, the closer their frequencies are. The variance is
    below 1, and set to 1 for `index` itself, which counts from 0.
    """
    squares = (2 * np.pi * modes.frequency) ** 2
    together = model_error**2 * (1 + 3 * len(squares) * model_error**2)
    between = together * squares[index] * squares
    variance = between / ((squares - squares[index]) ** 2 + between + np.finfo(float).tiny)
    variance[index] = 1.0
    return np.asarray(variance)
