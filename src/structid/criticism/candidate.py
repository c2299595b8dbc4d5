"""A candidate: one change of model or record, as its effect on an FRF for any strength."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.dof import Dof
from structid.criticism.fields import Fields
from structid.fem.elements.element import dof_code

#: Change of the FRF for some strengths, (n_strengths, n_lines, n_outputs, n_inputs).
Effect = Callable[[Fields, FloatArray], ComplexArray]

#: Kinds of change that only damp.
OF_DAMPING = ("dashpot", "friction")
_STEPS = np.array([0.005, 0.02, 0.08, 0.25, 0.6, 1.0, 1.8, 4.0, 12.0, 60.0])


def _unchanged(fields: Fields, strengths: FloatArray) -> ComplexArray:
    return np.zeros((len(strengths), *fields.frf.shape), dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One change that might explain a misfit.

    Attributes
    ----------
    kind : str
        Such as ``support``, ``mass`` or ``sensor_gain``.
    where : tuple of str
        Degrees of freedom, nodes, elements or channels.
    effect : Effect, optional
        Of record `record` alone where that is given, else of every record; none of a change that only a fit shows.
    strengths : (n,) float array
        Which are tried, in the unit of what changes; 0 is no change.
    bounds : (float, float)
        Between which a strength makes sense.
    record : int, optional
        Position of the only record that it changes.
    others : tuple of str
        Channels that stay, where some are left out; or the property that changes.
    driven : tuple of int
        Positions of the records whose input is at a support that gives way.
    alike : Candidate, optional
        What looks the same on smoothed data.
    detail : mapping of str to float
        What else it is made of.
    places : Places, optional
        Where it acts, if kind, detail and places are all that its effect depends on.
    """

    kind: str
    where: tuple[str, ...]
    effect: Effect = _unchanged
    strengths: FloatArray = field(default_factory=lambda: np.ones(1))
    bounds: tuple[float, float] = (-np.inf, np.inf)
    record: int | None = None
    others: tuple[str, ...] = ()
    driven: tuple[int, ...] = ()
    alike: Candidate | None = None
    detail: Mapping[str, float] = field(default_factory=dict)
    places: Places | None = None


def bare(candidate: Candidate) -> Candidate:
    """The same without its effect, which no other process can be sent."""
    return replace(candidate, effect=_unchanged, alike=None, places=None)


def steps(scale: float, signs: tuple[int, ...] = (1,)) -> FloatArray:
    """Strengths over five decades about `scale`."""
    return np.concatenate([sign * scale * _STEPS for sign in signs])


@dataclass(frozen=True, eq=False)
class Places:
    """Directions D in any model: degrees of freedom by their codes, (n_codes,), and what each has of them, (n_codes, m)."""

    codes: IntArray
    weights: FloatArray

    def rows(self, fields: Fields) -> tuple[IntArray, FloatArray]:
        """The degrees of freedom of `fields` that take part, and D on them, (n_rows, m)."""
        directions = fields.reached(self.codes).T @ self.weights
        rows = np.flatnonzero(directions.any(axis=1))
        return rows, directions[rows]

    def seen(self, fields: Fields) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """D'x of the loads, (n_lines, m, n_inputs), D'y of the sensors, (n_lines, m, n_outputs), and D' Z^-1 D, (n_lines, m, m)."""
        rows, d = self.rows(fields)
        flexibility: ComplexArray = d.T @ fields.flexibility[:, rows[:, None], rows] @ d
        return d.T @ fields.under_loads[:, rows], d.T @ fields.under_sensors[:, rows], flexibility


def place_of(*ends: tuple[Dof, float]) -> Places:
    """One direction of some degrees of freedom, each with its part."""
    codes = [dof_code(dof.node, dof.direction) for dof, _ in ends]
    return Places(np.array(codes), np.array([[part] for _, part in ends]))


def added(places: Places, law: Callable[[Fields], ComplexArray]) -> Effect:
    """Of a part D D' times q a(s) added to Z: dh = -(D'y)' q a (I + q a G)^-1 D'x with G = D' Z^-1 D.

    Parameters
    ----------
    places : Places
        D.
    law : callable
        a at the lines, (n_lines,).
    """

    if places.weights.shape[1] > 1:
        unit = np.eye(places.weights.shape[1])
        return rearranged(places, lambda fields, q: (q[:, None] * law(fields))[:, :, None, None] * unit)

    def effect(fields: Fields, strengths: FloatArray) -> ComplexArray:
        u, v, g = places.seen(fields)
        weight = strengths[:, None] * law(fields)
        inner = (weight / (1 + weight * g[:, 0, 0]))[:, :, None, None]
        found: ComplexArray = inner * (-np.swapaxes(v, 1, 2) * u * fields.factor)
        return found

    return effect


def rearranged(places: Places, change: Callable[[Fields, FloatArray], ComplexArray]) -> Effect:
    """Of a symmetric change D K D' of Z: dh = -(D'y)' K (I + G K)^-1 D'x with G = D' Z^-1 D.

    Parameters
    ----------
    places : Places
        D.
    change : callable
        K of some strengths, (n_strengths, n_lines, m, m).
    """

    def effect(fields: Fields, strengths: FloatArray) -> ComplexArray:
        u, v, g = places.seen(fields)
        k = change(fields, strengths)
        inner = k @ np.linalg.solve(np.eye(g.shape[-1]) + g @ k, np.broadcast_to(u, (len(strengths), *u.shape)))
        found: ComplexArray = -np.swapaxes(v, 1, 2) @ inner * fields.factor
        return found

    return effect


def rubbing(places: Places) -> Effect:
    """Of dry friction r per unit of drive that acts along one direction, by harmonic balance: stiffness i r / |x|.

    |x| is the sliding amplitude with friction: |x|^2 - 2 r |x| Im g + r^2 |g|^2 = |x0|^2, where x0 is the motion without it
    and g = d' Z^-1 d. For one load.
    """

    def effect(fields: Fields, strengths: FloatArray) -> ComplexArray:
        u, v, g = places.seen(fields)
        u, v, g = u[:, 0, 0], v[:, 0], g[:, 0, 0]
        r = strengths[:, None]
        inside = np.maximum((r * g.imag) ** 2 - (r * np.abs(g)) ** 2 + np.abs(u) ** 2, 0.0)
        sliding = np.maximum(r * g.imag + np.sqrt(inside), 1e-6 * np.abs(u))
        weight = 1j * r / sliding
        inner = weight / (1 + weight * g) * u
        found: ComplexArray = -(inner[:, :, None] * v)[..., None] * fields.factor
        return found

    return effect


def released(coupling: Callable[[Fields], tuple[ComplexArray, ComplexArray]]) -> Effect:
    """Of a part that gives way with compliance q: dh = (R'y)' q / (1 + q zeta) R'x with zeta = Z_cc - R' Z^-1 R.

    Parameters
    ----------
    coupling : callable
        R (n_lines, n_dofs) and Z_cc (n_lines,): Z between what gives way and the free degrees of freedom, and of it alone.
    """

    def effect(fields: Fields, strengths: FloatArray) -> ComplexArray:
        whole, own = coupling(fields)
        rows = np.flatnonzero(whole.any(axis=0))
        r = whole[:, None, rows]
        u, v = (r @ fields.under_loads[:, rows])[:, 0], (r @ fields.under_sensors[:, rows])[:, 0]
        zeta = own - (r @ fields.flexibility[:, rows[:, None], rows] @ np.swapaxes(r, 1, 2))[:, 0, 0]
        weight = strengths[:, None] / (1 + strengths[:, None] * zeta)
        found: ComplexArray = (weight[:, :, None, None] * v[:, :, None] * u[:, None, :]) * fields.factor
        return found

    return effect


def replaced(make: Callable[[ComplexArray, float], ComplexArray]) -> Effect:
    """Of another reading: `make` gives the FRF as it would be read, of the model's own and a strength."""

    def effect(fields: Fields, strengths: FloatArray) -> ComplexArray:
        return np.stack([make(fields.frf, float(q)) for q in strengths]) - fields.frf

    return effect


def picked_by(fields: Fields, axis: int, i: int, ways: FloatArray) -> ComplexArray:
    """The FRFs of one channel if it picked the motion in other `ways` (n, n_dofs): (n, n_lines, channels of the other side).

    Parameters
    ----------
    fields : Fields
    axis, i : int
        The i-th output for 1, the i-th input for 2.
    ways : (n, n_dofs) float array
    """
    under = fields.under_loads if axis == 1 else fields.under_sensors
    found: ComplexArray = np.swapaxes(ways @ under, 0, 1) * np.broadcast_to(fields.factor, fields.frf.shape).take(
        i, axis
    )
    return found


def of_channel(fields: Fields, axis: int, i: int, change: ComplexArray) -> ComplexArray:
    """Changes of one channel as changes of all FRFs; see `picked_by`."""
    found = np.zeros((len(change), *fields.frf.shape), dtype=np.complex128)
    np.moveaxis(found, axis + 1, 0)[i] = change
    return found
