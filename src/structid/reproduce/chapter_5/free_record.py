"""Simulated free motion as a record of displacement, velocity and acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.dof import Dof
from structid.dynamics import FreeDecay
from structid.records import TimeRecord
from structid.records.record import Quantity

_QUANTITIES: tuple[Quantity, ...] = ("displacement", "velocity", "acceleration")


def free_record(motion: FreeDecay, step: float, dofs: Sequence[Dof], source: str) -> TimeRecord:
    """All three quantities of `motion` at `dofs`, sampled every `step` s."""
    quantities = tuple(quantity for quantity in _QUANTITIES for _ in dofs)
    return TimeRecord(1 / step, np.concatenate(motion, axis=1), tuple(dofs) * 3, quantities, source=source)
