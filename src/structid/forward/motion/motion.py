"""The motion of every free degree of freedom and the forces on it, measured or completed by a stated rule."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import FloatArray, locked, require_finite, require_shape
from structid.core.errors import InputError
from structid.fem import Structure
from structid.records import TimeRecord
from structid.records.on_disk import ChunkedRecord

Rule = Literal["trapezoid", "difference"]
MOTION_QUANTITIES = ("acceleration", "velocity", "displacement")
NO_MOTION = "the record holds no motion; it needs displacement, velocity or acceleration channels"
NO_FORCE = "the record holds no force channel; the forces must be known: add the channels"
#: Smallest pivot of the sensor matrix, relative to the largest, for which degrees of freedom are determined.
_APART = 1e-10


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of all free degrees of freedom of a structure, and the forces on them.

    Parameters
    ----------
    time : (n_times,) float array
        Instants in s, increasing; evenly spaced or not, since the equations of motion hold at each by itself.
    force : (n_times, n_dofs) float array
        N at translations, N m at rotations, in the order of `Structure.dofs`.
    acceleration, velocity, displacement : (n_times, n_dofs) float arrays, optional
        SI units; None where not known.
    """

    time: FloatArray
    force: FloatArray
    acceleration: FloatArray | None = None
    velocity: FloatArray | None = None
    displacement: FloatArray | None = None

    def __post_init__(self) -> None:
        """Convert arrays to float; raise `InputError` on wrong shapes, values that are not finite, or falling time.

        Time must increase from sample to sample.
        """
        for item in fields(self):
            values = getattr(self, item.name)
            if values is not None:
                object.__setattr__(self, item.name, locked(values, np.float64))
        require_shape("time", self.time, (None,))
        require_shape("force", self.force, (len(self.time), None), "one row an instant, one column a degree of freedom")
        for name in ("force", *MOTION_QUANTITIES):
            values = getattr(self, name)
            if values is not None:
                require_shape(name, values, self.force.shape)
                require_finite(name, values, "remove or repair these samples")
        require_finite("time", self.time)
        if (np.diff(self.time) <= 0).any():
            raise InputError("`time` must increase from sample to sample; sort the samples and drop repeated ones")

    @property
    def n_times(self) -> int:
        return len(self.time)

    def at(self, rows: slice | ArrayLike) -> Motion:
        """Copy of the motion with only the instants `rows`: a slice, indices or a mask along time."""
        index = rows if isinstance(rows, slice) else np.asarray(rows)
        motions = (getattr(self, name) for name in MOTION_QUANTITIES)
        chosen = (None if part is None else part[index] for part in motions)
        return Motion(self.time[index], self.force[index], *chosen)


def recorded_motion(
    structure: Structure,
    record: TimeRecord,
    rule: Rule | None = None,
    force: ArrayLike | None = None,
    initial_displacement: ArrayLike | None = None,
    initial_velocity: ArrayLike | None = None,
) -> Motion:
    """Motion of all free degrees of freedom, from the measured channels of `record`.

    Parameters
    ----------
    structure : Structure
    record : TimeRecord
        A quantity that it measures anywhere must be measured at every free degree of freedom (signs and ties as
        given). Its force channels act at their own places, and nothing acts elsewhere.
    rule : {"trapezoid", "difference"}, optional
        How missing quantities are made: integrated from acceleration, or differentiated from displacement, which drops
        the first and last sample. None leaves them out.
    force : (n_times, n_dofs) array, optional
        Forces, instead of force channels.
    initial_displacement, initial_velocity : (n_dofs,) arrays, optional
        Values at the first sample, for ``trapezoid``; zero by default.

    Raises
    ------
    InputError
        If degrees of freedom are not measured (they are named), if there is no force, or if the rule lacks what it
        starts from.
    """
    structure.require_scaled_modes("motion in time")
    readers = {name: field_map(structure, record, name) for name in MOTION_QUANTITIES}
    if all(reader is None for reader in readers.values()):
        raise InputError(NO_MOTION)
    loads = _forces(structure, record, force)
    values = {name: None if reader is None else (reader @ record.values.T).T for name, reader in readers.items()}
    measured = Motion(record.time, loads, **values)
    return measured if rule is None else completed(measured, rule, initial_displacement, initial_velocity)


def completed(
    motion: Motion,
    rule: Rule,
    initial_displacement: ArrayLike | None = None,
    initial_velocity: ArrayLike | None = None,
) -> Motion:
    """Motion with missing quantities integrated (trapezoid) or differentiated (difference) from measured ones.

    ``trapezoid``: velocity from acceleration and displacement from velocity, by the cumulative trapezoidal rule from
    the initial values (n_dofs,), 0 by default. ``difference``: velocity and acceleration from displacement by central
    differences, without the first and the last sample.

    Raises
    ------
    InputError
        If the rule lacks the quantity that it starts from, or ``difference`` meets unequal or too few samples.

    Notes
    -----
    Integration turns white noise of standard deviation s into a random walk: after k steps of h that of the velocity
    is s h k^(1/2), that of the displacement s h^2 (k^3 / 3)^(1/2). A longer record is then worse, not better. The
    trapezoidal error of a motion of angular frequency omega is (omega h)^2 / 12 of it. Differences multiply noise by
    2^(-1/2) / h and 6^(1/2) / h^2.
    """
    if rule == "trapezoid":
        return _integrated(motion, initial_displacement, initial_velocity)
    if rule != "difference":
        raise InputError(f"`rule` must be 'trapezoid' or 'difference', got {rule!r}")
    if initial_displacement is not None or initial_velocity is not None:
        raise InputError("initial values belong to rule 'trapezoid'; leave them out, or integrate")
    return _differenced(motion)


def _integrated(motion: Motion, displacement_0: ArrayLike | None, velocity_0: ArrayLike | None) -> Motion:
    """Motion with missing velocity integrated from acceleration, and missing displacement from velocity, by trapezoids.

    Initial values are (n_dofs,), 0 if None. Raises `InputError` without acceleration, or if an initial value is given
    for a measured quantity.
    """
    if motion.acceleration is None:
        raise InputError(
            "rule 'trapezoid' starts from acceleration, which is missing; measure it, or take rule 'difference'"
        )
    velocity = motion.velocity
    if velocity is None:
        velocity = _from_start("initial_velocity", velocity_0, motion.acceleration, motion.time)
    elif velocity_0 is not None:
        raise InputError("`initial_velocity` is not used, since velocity is measured; leave it out")
    displacement = motion.displacement
    if displacement is None:
        displacement = _from_start("initial_displacement", displacement_0, velocity, motion.time)
    elif displacement_0 is not None:
        raise InputError("`initial_displacement` is not used, since displacement is measured; leave it out")
    return Motion(motion.time, motion.force, motion.acceleration, velocity, displacement)


def _from_start(name: str, start: ArrayLike | None, rate: FloatArray, time: FloatArray) -> FloatArray:
    """Cumulative trapezoidal integral (n_times, n_dofs) of `rate` (n_times, n_dofs) over `time` (s), from `start`.

    `start` (n_dofs,) is the value at the first sample, 0 if None; `name` is the argument named in errors.
    """
    from scipy.integrate import cumulative_trapezoid  # here, because it brings all of scipy.optimize

    first = np.zeros(rate.shape[1]) if start is None else np.asarray(start, dtype=np.float64)
    require_shape(name, first, (rate.shape[1],), "one value a free degree of freedom")
    return first + cumulative_trapezoid(rate, time, axis=0, initial=0.0)


def _differenced(motion: Motion) -> Motion:
    """Motion with missing velocity and acceleration by central differences; the first and the last sample are dropped.

    Raises `InputError` without displacement, with fewer than three samples, or if time steps differ by more than 1e-6
    of their mean.
    """
    if motion.displacement is None:
        raise InputError(
            "rule 'difference' starts from displacement, which is missing; measure it, or take rule 'trapezoid'"
        )
    if motion.n_times < 3:
        raise InputError(f"rule 'difference' needs at least 3 samples, got {motion.n_times}")
    steps = np.diff(motion.time)
    step = float(np.mean(steps))
    if np.abs(steps - step).max() > 1e-6 * step:
        raise InputError(
            f"rule 'difference' needs equal steps, got {steps.min():g} to {steps.max():g} s; resample the record evenly,"
            " or measure velocity and acceleration, which need no even steps"
        )
    w, inner = motion.displacement, motion.at(slice(1, -1))
    velocity = inner.velocity if inner.velocity is not None else (w[2:] - w[:-2]) / (2 * step)
    acceleration = inner.acceleration
    if acceleration is None:
        acceleration = (w[2:] - 2 * w[1:-1] + w[:-2]) / step**2
    return Motion(inner.time, inner.force, acceleration, velocity, inner.displacement)


def _forces(structure: Structure, record: TimeRecord, force: ArrayLike | None) -> FloatArray:
    """Forces (n_times, n_dofs) in N on the free degrees of freedom: `force`, or if that is None the record's channels.

    Force channels that act on one degree of freedom add up; moments are in N m. Raises `InputError` if there is neither
    `force` nor a force channel, or both, or `force` has another shape.
    """
    reader, size = field_map(structure, record, "force"), (len(record.values), structure.n_dofs)
    if force is None:
        if reader is None:
            raise InputError(f"{NO_FORCE}, or give `force` {size}")
        return (reader @ record.values.T).T
    if reader is not None:
        raise InputError("`force` is given although the record holds force channels; give one or the other")
    forces = np.asarray(force, dtype=np.float64)
    require_shape("force", forces, size, "one column a free degree of freedom")
    return forces


def field_map(structure: Structure, record: TimeRecord | ChunkedRecord, quantity: str) -> sparse.csr_array | None:
    """Sparse matrix (n_dofs, n_channels) from the channels at one sample to `quantity`; None if no channel measures it.

    A motion that is measured more than once is taken by least squares; forces add up.

    Parameters
    ----------
    structure : Structure
    record : TimeRecord or ChunkedRecord
    quantity : str
        "acceleration", "velocity", "displacement" or "force".

    Raises
    ------
    InputError
        If a motion is measured at some degrees of freedom only.
    """
    chosen = np.flatnonzero([name == quantity for name in record.quantities])
    if not len(chosen):
        return None
    sensors = sparse.csc_array(structure.selection([record.channels[i] for i in chosen]))
    table = sparse.coo_array(sensors if quantity == "force" else _motion_of(structure, sensors, quantity))
    indices = table.row, chosen[table.col]
    return sparse.csr_array(sparse.coo_array((table.data, indices), (structure.n_dofs, len(record.channels))))


def _motion_of(structure: Structure, sensors: sparse.csc_array, quantity: str) -> sparse.sparray:
    """Matrix (S S')^-1 S, (n_dofs, n_sensors), from sensor readings to the motion of free degrees of freedom.

    `sensors` (n_dofs, n_sensors) is S; `quantity` is the word in errors. Raises `InputError` if a degree of freedom is
    not measured, or several are measured only together.
    """
    from scipy.sparse.linalg import splu  # here, because it takes time to load

    gram = sparse.csc_array(sensors @ sensors.T)
    unseen = np.flatnonzero(gram.diagonal() <= 0)
    if len(unseen):
        missing = [structure.words(structure.dofs[i]) for i in unseen[:6]]
        more = f" and {len(unseen) - 6} more" if len(unseen) > 6 else ""
        raise InputError(
            f"{quantity} is not measured at {', '.join(missing)}{more}; identification from motion needs every one of"
            f" the {structure.n_dofs} free degrees of freedom. Add sensors there (a rotation from two translations close"
            " by), condense the model to what is measured, or use FRFs and `identify`, which need only some"
        )
    if gram.count_nonzero() == structure.n_dofs:
        return sparse.diags_array(1.0 / gram.diagonal()) @ sensors
    try:
        factor = splu(gram)
        pivots = np.abs(factor.U.diagonal())
        is_singular = bool(pivots.min() <= _APART * pivots.max())
    except RuntimeError:
        is_singular = True
    if is_singular:
        raise InputError(
            f"the {quantity} channels do not determine every degree of freedom: tied ones are measured only together;"
            " add sensors"
        )
    return sparse.csc_array(factor.solve(sensors.toarray()))
