"""A model seen from its sensors: shapes of all degrees of freedom that belong to what sensors read, and the mass there."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from structid.arrays import FloatArray
from structid.errors import InputError, SingularModelError

Reduction: TypeAlias = Literal["guyan", "serep"]
#: Part of the largest singular value that counts as none.
_RANK = 1e-8


def constrained_shapes(dynamic_stiffness: sparse.csc_array, sensors: sparse.csc_array) -> FloatArray:
    """The motion without force elsewhere that each sensor at 1 and all others at 0 makes, (n_dofs, n_channels).

    The solution x of Z x = S f, S' x = e for every unit vector e: with Z = K it is Guyan's (1965) reduction, with
    Z = K - omega^2 M the dynamic expansion of Kidder (1973). Sensors may read sums of degrees of freedom.

    Parameters
    ----------
    dynamic_stiffness : (n_dofs, n_dofs) sparse array
        Z, symmetric; singular where the structure is free, as long as the sensors hold it.
    sensors : (n_dofs, n_channels) sparse array
        S, see `Structure.selection`.

    Raises
    ------
    InputError
        If sensors read the same.
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
        found = np.asarray(splu(whole).solve(right)[:n])
    except RuntimeError as error:
        raise SingularModelError(
            "the model can move without force while every sensor stands still; add supports or sensors"
        ) from error
    return found


def serep_basis(seen: FloatArray, mode_shapes: FloatArray) -> FloatArray:
    """The combination of modes that each sensor at 1 and all others at 0 makes, T = Phi (S' Phi)^+, (n_dofs, n_channels).

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
    """T' M T, (n_channels, n_channels), of a basis T of `constrained_shapes` or `serep_basis`."""
    return np.asarray(basis.T @ (mass @ basis))
