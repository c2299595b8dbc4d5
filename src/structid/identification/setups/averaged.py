"""Averaged FRFs of a record of histories, beside which the fit of the histories is shown."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.fem import Structure
from structid.fem.places import together, with_joint_forces
from structid.identification.setups.histories_as_frfs import frfs_of
from structid.records import FrfRecord, TimeRecord
from structid.records.record import Quantity

_FORCE: Quantity = "force"
#: Distance of the label of a joint force's node from those of the structure, which may get some more.
_FAR = 1000


@dataclass(frozen=True, eq=False)
class AveragedHistories:
    """FRFs of a record of histories; forces that are never apart are one there, at a node of its own.

    Parameters
    ----------
    structure : Structure
    record : TimeRecord
    given : FrfRecord, optional
        FRFs of the same test instead.
    """

    structure: Structure
    record: TimeRecord
    given: FrfRecord | None

    @cached_property
    def frfs(self) -> FrfRecord:
        return self.given or frfs_of(self.record if self._parts is None else self._with_joint_forces(self._parts))

    @property
    def drawn_on(self) -> Structure:
        """The structure, with nodes of their own for joint forces."""
        if self._parts is None:
            return self.structure
        return with_joint_forces(self.structure, self.frfs.inputs, self._loads, self._parts)

    @property
    def words(self) -> str:
        """A clause that names the joint forces; "" where there are none."""
        if self._parts is None:
            return ""
        forces, shown = (", ".join(map(str, dofs)) for dofs in (self._loads, self.frfs.inputs))
        return f"; forces at {forces} are never apart: responses are shown to what is independent of them, as {shown}"

    @cached_property
    def _parts(self) -> FloatArray | None:
        """Combination of forces that always act together; see `together`."""
        return together(self.record.values[:, self._is_force])

    @property
    def _is_force(self) -> np.ndarray:
        return np.array([quantity == _FORCE for quantity in self.record.quantities])

    @property
    def _loads(self) -> list[Dof]:
        return [dof for dof, is_force in zip(self.record.channels, self._is_force, strict=True) if is_force]

    def _with_joint_forces(self, parts: FloatArray) -> TimeRecord:
        """The record with joint forces, which the columns of `parts` make of its own forces."""
        record, still = self.record, ~self._is_force
        first = max(self.structure.nodes) + _FAR
        made = [Dof(first + k, (self.structure.active or ("X",))[0]) for k in range(parts.shape[1])]
        motions = [
            (dof, kind) for dof, kind, kept in zip(record.channels, record.quantities, still, strict=True) if kept
        ]
        values = np.hstack([record.values[:, ~still] @ parts, record.values[:, still]])
        noise = None
        if record.variance is not None:
            noise = np.concatenate([record.variance[~still] @ parts**2, record.variance[still]])
        return TimeRecord(
            record.sampling_rate,
            values,
            (*made, *(dof for dof, _ in motions)),
            (*(_FORCE for _ in made), *(kind for _, kind in motions)),
            variance=noise,
        )
