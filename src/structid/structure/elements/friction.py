"""Dry friction to the ground, linearized at the amplitude that was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray
from structid.dof import Dof, parse_dof, parse_dofs
from structid.structure.elements.connector import Ends, connector_ends, connector_matrices, connector_nodes
from structid.structure.elements.element import Positions, Term, property_values, set_fields


@dataclass(frozen=True, eq=False)
class Friction:
    """Dry (Coulomb) friction between one degree of freedom and another or the ground, by harmonic linearization.

    A friction force of constant amplitude, in phase with the sliding velocity, has the dynamic stiffness
    i r / \\|x\\|, where r is the amplitude of its first harmonic per unit of drive amplitude and \\|x\\| the sliding
    amplitude per unit drive: the model's own, by harmonic balance. It holds while the drive amplitude is the same at
    all frequencies and one load acts at a time. Where r exceeds the force that reaches the contact, it sticks.

    Parameters
    ----------
    name : str
        Name of the set.
    first, second : degree of freedom
        Where the friction acts; the ground where `second` is left out.
    friction_force : float
        r, N of friction (first harmonic) per N of drive: 4/pi times the sliding force over the drive amplitude.
    measured_by : sequence of degrees of freedom
        Sensors whose mean along their axes is the sliding motion. Searches from poor starts take the amplitude from
        them, which keeps the model linear; the last stage takes the model's own.
    smoothing : int
        Number of neighbouring lines over which a measured amplitude is averaged (geometric mean); 1 for none.

    References
    ----------
    Den Hartog (1931), Trans. ASME 53, APM-53-9; Magnus, Popp, Sextro (2016), Schwingungen, section 3.2.
    """

    name: str
    first: tuple[Dof, ...]
    second: tuple[Dof, ...] | None
    friction_force: FloatArray
    measured_by: tuple[Dof, ...]
    smoothing: int
    nodes: IntArray

    def __init__(
        self,
        name: str,
        first: str | Dof,
        second: str | Dof | None = None,
        *,
        friction_force: ArrayLike,
        measured_by: Ends = (),
        smoothing: int = 1,
    ) -> None:
        start, end = connector_ends(name, parse_dof(first), None if second is None else parse_dof(second))
        sensors = parse_dofs([measured_by] if isinstance(measured_by, str | Dof) else measured_by)
        values = property_values(name, "friction_force", friction_force, 1)
        set_fields(self, name=name, first=start, second=end, friction_force=values, measured_by=sensors)
        set_fields(self, smoothing=max(1, int(smoothing)), nodes=connector_nodes(start, end))

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices; see `ElementSet.terms`."""
        codes, local = connector_matrices(self.first, self.second)
        return (Term("friction_force", "friction", "N/N", self.friction_force, codes, local),)

    def sliding(self, receptance: np.ndarray) -> FloatArray:
        """Smoothed measured sliding amplitude, (n_frequencies,), from the receptance of the `measured_by` sensors.

        Parameters
        ----------
        receptance : (n_frequencies, n_sensors) complex array
            Signs of the sensors already removed.
        """
        size = np.log(np.maximum(np.abs(receptance.mean(axis=1)), np.finfo(float).tiny))
        window = np.ones(min(self.smoothing, len(size)))
        total = np.convolve(size, window, mode="same")
        return np.exp(total / np.convolve(np.ones(len(size)), window, mode="same"))
