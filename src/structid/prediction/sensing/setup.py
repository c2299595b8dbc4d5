"""Channels of a record by role, and the outputs that are asked of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.prediction.recovery import OutputMap
from structid.prediction.sensing.innovations import ASSUMED_NOISE
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES


@dataclass(frozen=True, eq=False)
class Channels:
    """Channels of a record by role: known forces, sensors that are used, sensors that are left out.

    Attributes
    ----------
    loads, sensors, left : tuple of Dof
    known, measured, left_values : (n_times, n) float arrays
    derivatives, left_derivatives : tuple of int
        0 to 2 of displacement to acceleration.
    variance, left_variance : (n,) float arrays
        Of the noise of each sensor.
    has_stated_noise : bool
        False where the record states none, and a part of the size of each sensor is taken.
    """

    loads: tuple[Dof, ...]
    sensors: tuple[Dof, ...]
    left: tuple[Dof, ...]
    known: FloatArray
    measured: FloatArray
    left_values: FloatArray
    derivatives: tuple[int, ...]
    left_derivatives: tuple[int, ...]
    variance: FloatArray
    left_variance: FloatArray
    has_stated_noise: bool

    @property
    def readings(self) -> FloatArray:
        """Readings of the used sensors in standard deviations of their noise, (n_times, n_used)."""
        return self.measured / np.sqrt(self.variance)

    @classmethod
    def of_record(cls, record: TimeRecord, left_out: tuple[Dof, ...]) -> Channels:
        """Channels of a record by role: known forces, sensors that are used, and those in `left_out`, only compared.

        Where the record states no noise, 1 % of the standard deviation of each sensor is taken.

        `InputError` if `left_out` names a force or no channel, the record holds other quantities or no motion, or a
        sensor has no noise.
        """
        quantities = record.quantities
        pushed = [
            str(dof)
            for dof, what in zip(record.channels, quantities, strict=True)
            if what == "force" and dof in left_out
        ]
        if pushed:
            raise InputError(
                f"`leave_out` names {pushed[0]}, a force of the record; name sensors, whose motion is compared"
            )
        other = [str(quantity) for quantity in quantities if quantity not in (*MOTION_DERIVATIVES, "force")]
        if other:
            raise InputError(f"the record holds {other[0]}; motion at other places takes forces and motions alone")
        missing = [str(dof) for dof in left_out if dof not in record.channels]
        if missing:
            raise InputError(f"`leave_out` names {missing[0]}, which the record does not have")
        variance = record.variance
        if variance is None:
            variance = (ASSUMED_NOISE * record.values.std(axis=0)) ** 2
        rows = range(len(record.channels))
        loads = [i for i in rows if quantities[i] == "force"]
        used = [i for i in rows if quantities[i] != "force" and record.channels[i] not in left_out]
        out = [i for i in rows if quantities[i] != "force" and record.channels[i] in left_out]
        if not used:
            raise InputError(
                "the record has no motion to sense from; use one with displacements, velocities or accelerations"
            )
        silent = [i for i in (*used, *out) if not np.asarray(variance)[i] > 0]
        if silent:
            what = "states no noise and reads a constant" if record.variance is None else "has a noise of 0"
            raise InputError(
                f"sensor {record.channels[silent[0]]} {what}; take it out of the record, or state its noise"
            )

        def dofs(index: list[int]) -> tuple[Dof, ...]:
            return tuple(record.channels[i] for i in index)

        def order(index: list[int]) -> tuple[int, ...]:
            return tuple(MOTION_DERIVATIVES[quantities[i]] for i in index)

        return cls(
            dofs(loads), dofs(used), dofs(out),
            record.values[:, loads], record.values[:, used], record.values[:, out],
            order(used), order(out), np.asarray(variance)[used], np.asarray(variance)[out],
            record.variance is not None,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SensingSetup:
    """A record by channels, and the outputs that are asked of it.

    Attributes
    ----------
    channels : Channels
    driving : (n_times, n_known) float array
        The known forces between samples, see `band_limited_loads`.
    n_forces : int
        Unknown forces, the last inputs.
    is_filtered : bool
        Whether the record went through a filter against aliasing.
    rate : float
        Samples per second.
    read : OutputMap
        Outputs that are asked for, behind used and left-out sensors among those of the model.
    is_distributed : bool
        Whether more independent unknown forces act than sensors are used.
    """

    channels: Channels
    driving: FloatArray
    n_forces: int
    is_filtered: bool
    rate: float
    read: OutputMap
    is_distributed: bool
