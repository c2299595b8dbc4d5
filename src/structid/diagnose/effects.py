"""Effects of changes on frequency response functions, by the receptances of the unchanged model.

Z is complex symmetric; all products are with the transpose. x = Z^-1 f are the motions under the loads, y = Z^-1 s those
under unit forces at the sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.dof import Dof
from structid.diagnose.receptances import Receptances
from structid.fem.elements.element import dof_code

_STEPS = np.array([0.005, 0.02, 0.08, 0.25, 0.6, 1.0, 1.8, 4.0, 12.0, 60.0])


def strengths_about(scale: float, signs: tuple[int, ...] = (1,)) -> FloatArray:
    """Strengths from 0.005 to 60 times `scale`, ten for each of the `signs`, (10 n_signs,)."""
    return np.concatenate([sign * scale * _STEPS for sign in signs])


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions D in any model: degrees of freedom by their codes, (n_codes,), and their weights, (n_codes, m)."""

    codes: IntArray
    weights: FloatArray

    def rows(self, receptances: Receptances) -> tuple[IntArray, FloatArray]:
        """Positions of the free degrees of freedom that take part, (n_rows,), and D on them, (n_rows, m)."""
        return receptances.along(self.codes, self.weights)

    def projected(self, receptances: Receptances) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """D'x, (n_lines, m, n_inputs), D'y, (n_lines, m, n_outputs), and G = D' Z^-1 D, (n_lines, m, m), as a tuple.

        x is the motion under the loads of the record, y that under unit forces at its sensors.
        """
        rows, d = self.rows(receptances)
        flexibility: ComplexArray = d.T @ receptances.flexibility(rows) @ d
        return d.T @ receptances.under_loads[:, rows], d.T @ receptances.under_sensors[:, rows], flexibility


def direction_of(*ends: tuple[Dof, float]) -> Directions:
    """One direction as a `Directions` with m = 1: the weighted sum of the degrees of freedom in `ends` (dof, weight)."""
    codes = [dof_code(dof.node, dof.direction) for dof, _ in ends]
    return Directions(np.array(codes), np.array([[weight] for _, weight in ends]))


def all_directions(several: Sequence[Directions]) -> Directions:
    """The directions of all `several`, in order, as the columns of a single `Directions`."""
    return Directions(np.concatenate([one.codes for one in several]), block_diag(*(one.weights for one in several)))


def stiffness_scale(receptances: Receptances, directions: Directions, law: ComplexArray) -> float:
    """Strength at which an added part, q times the law a(s), is about as stiff as the structure in the first direction.

    `law` (n_lines,) is a(s). At this q the median over the lines of |q a g| is 1, with g the receptance in the direction.
    """
    rows, weights = directions.rows(receptances)
    d = weights[:, 0]
    return float(1 / np.median(np.abs(law * (d @ receptances.flexibility(rows) @ d))))


def effect_of_addition(
    receptances: Receptances, directions: Directions, law: ComplexArray, strengths: FloatArray
) -> ComplexArray:
    """Change of the FRF for a part q D a(s) D' added to the dynamic stiffness Z: dh = -(D'y)' q a (I + q G a)^-1 D'x.

    x and y are the motions under the loads and under unit forces at the sensors, and G = D' Z^-1 D.

    Parameters
    ----------
    receptances : Receptances
        Of one record.
    directions : Directions
        D, of m directions.
    law : (n_lines,), (n_lines, 1) or (n_lines, m) complex array
        a, one for all directions or, as the diagonal of a matrix, one for each.
    strengths : (n_strengths,) float array
        q.

    Returns
    -------
    (n_strengths, n_lines, n_outputs, n_inputs) complex array
        In the kind of the record.
    """
    m = directions.weights.shape[1]
    each = strengths[:, None, None] * law.reshape(len(law), -1)  # (n_strengths, n_lines, 1 or m)
    if m > 1:
        return effect_of_coupling(receptances, directions, each[..., None] * np.eye(m))
    response, g = _unit_response(receptances, directions)
    weight = each[..., 0]
    inner = (weight / (1 + weight * g))[:, :, None, None]
    change: ComplexArray = inner * response
    return change


def _unit_response(receptances: Receptances, directions: Directions) -> tuple[ComplexArray, ComplexArray]:
    """Response -(D'y)' D'x, (n_lines, n_outputs, n_inputs), and G = D' Z^-1 D, (n_lines,), for one direction D.

    x and y are the motions under the loads and under unit forces at the sensors, Z the dynamic stiffness; the response
    is in the kind of the record. Results for the directions last asked for are cached in `receptances`.
    """

    def respond() -> tuple[ComplexArray, ComplexArray]:
        x, y, g = directions.projected(receptances)
        return -np.swapaxes(y, 1, 2) * x * receptances.factor, g[:, 0, 0]

    key = directions.codes.tobytes(), directions.weights.tobytes()
    return receptances.unit_responses.get_or_make(key, respond)


def effect_of_coupling(receptances: Receptances, directions: Directions, k: ComplexArray) -> ComplexArray:
    """Change of the FRF for a symmetric change D K D' of the dynamic stiffness Z: dh = -(D'y)' K (I + G K)^-1 D'x.

    x and y are the motions under the loads and under unit forces at the sensors, and G = D' Z^-1 D.

    Parameters
    ----------
    receptances : Receptances
        Of one record.
    directions : Directions
        D, of m directions.
    k : (n_strengths, n_lines, m, m) complex array
        K.

    Returns
    -------
    (n_strengths, n_lines, n_outputs, n_inputs) complex array
        In the kind of the record.
    """
    x, y, g = directions.projected(receptances)
    inner = k @ np.linalg.solve(np.eye(g.shape[-1]) + g @ k, np.broadcast_to(x, (len(k), *x.shape)))
    change: ComplexArray = -np.swapaxes(y, 1, 2) @ inner * receptances.factor
    return change


def effect_of_friction(receptances: Receptances, directions: Directions, strengths: FloatArray) -> ComplexArray:
    """Change of the FRF by dry friction r (force per unit load) in one direction, as a stiffness i r / |x|.

    |x| is the sliding amplitude with friction: |x|^2 - 2 r |x| Im g + r^2 |g|^2 = |x0|^2, where x0 is the motion
    without it and g = d' Z^-1 d, with d the direction and Z the dynamic stiffness. For the first load alone, by
    harmonic balance. `strengths` (n_strengths,) are the values of r; the result is (n_strengths, n_lines, n_outputs,
    1), in the kind of the record.
    """
    x, y, g = directions.projected(receptances)
    x, y, g = x[:, 0, 0], y[:, 0], g[:, 0, 0]
    r = strengths[:, None]
    inside = np.maximum((r * g.imag) ** 2 - (r * np.abs(g)) ** 2 + np.abs(x) ** 2, 0.0)
    sliding = np.maximum(r * g.imag + np.sqrt(inside), 1e-6 * np.abs(x))
    weight = 1j * r / sliding
    inner = weight / (1 + weight * g) * x
    change: ComplexArray = -(inner[:, :, None] * y)[..., None] * receptances.factor
    return change


def effect_of_release(
    receptances: Receptances, coupling: ComplexArray, own: ComplexArray, strengths: FloatArray
) -> ComplexArray:
    """Change of the FRF by a compliance q: dh = (R'y)' q / (1 + q zeta) R'x, zeta = Z_cc - R' Z^-1 R.

    Z is the dynamic stiffness, and x and y are the motions under the loads and under unit forces at the sensors.

    Parameters
    ----------
    receptances : Receptances
    coupling : (n_lines, n_dofs) complex array
        R: Z between the released part and the free degrees of freedom.
    own : (n_lines,) complex array
        Z_cc, of the part alone.
    strengths : (n_strengths,) float array
        q, the reciprocals of stiffnesses.

    Returns
    -------
    (n_strengths, n_lines, n_outputs, n_inputs) complex array
        In the kind of the record.
    """
    rows = np.flatnonzero(coupling.any(axis=0))
    r = coupling[:, None, rows]
    x, y = (r @ receptances.under_loads[:, rows])[:, 0], (r @ receptances.under_sensors[:, rows])[:, 0]
    zeta = own - (r @ receptances.flexibility(rows) @ np.swapaxes(r, 1, 2))[:, 0, 0]
    weight = strengths[:, None] / (1 + strengths[:, None] * zeta)
    change: ComplexArray = (weight[:, :, None, None] * y[:, :, None] * x[:, None, :]) * receptances.factor
    return change


def channel_reading(receptances: Receptances, axis: int, index: int, motions: FloatArray) -> ComplexArray:
    """FRFs of one channel if it read the `motions` (n, n_dofs) instead, (n, n_lines, n_others).

    They are in the kind of the record, with the errors of its channels. Each row of `motions` weighs the free degrees
    of freedom. The channel is the output of `index`, from 0, for `axis` 1, or the input for `axis` 2; n_others counts
    the channels of the other side.
    """
    under = receptances.under_loads if axis == 1 else receptances.under_sensors
    factor = np.broadcast_to(receptances.factor, receptances.frf.shape).take(index, axis)
    reading: ComplexArray = np.swapaxes(motions @ under, 0, 1) * factor
    return reading


def channel_change(receptances: Receptances, axis: int, i: int, change: ComplexArray) -> ComplexArray:
    """Changes of all FRFs, (n, n_lines, n_outputs, n_inputs), by the `change` of the i-th sensor (axis 1) or load (axis 2).

    `change` is (n, n_lines, n_others), as `channel_reading` returns it; all other channels change by 0.
    """
    of_all = np.zeros((len(change), *receptances.frf.shape), dtype=np.complex128)
    np.moveaxis(of_all, axis + 1, 0)[i] = change
    return of_all


def scaled_channel(receptances: Receptances, axis: int, i: int, factors: ComplexArray) -> ComplexArray:
    """Changes of all FRFs where the i-th sensor (axis 1) or load (axis 2) is multiplied by `factors`.

    `factors` is (n_strengths, n_lines or 1), the result (n_strengths, n_lines, n_outputs, n_inputs).
    """
    return channel_change(receptances, axis, i, (factors - 1)[:, :, None] * receptances.frf.take(i, axis))
