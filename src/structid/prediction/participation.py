"""Participation factors and effective masses: the part of the mass that each mode moves when the ground does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.fem import Base, Structure
from structid.prediction.linear_response import movable_supports
from structid.prediction.quantities import (
    Evaluator,
    NaturalModes,
    ReferenceModes,
    followed_modes,
    mode_axes,
    require_mode_count,
)
from structid.unknowns import Parameters

AXES = ("X", "Y", "Z")


@dataclass(frozen=True, eq=False)
class ModalParticipation:
    """Participation factors and effective masses of the lowest modes under ground that moves along one axis, (n_modes, 3).

    With phi the shape of modal mass 1 and r the unit motion along the axis, the factor is |phi' M r| in kg^(1/2), the effective
    mass its square in kg, the third column its part of r' M r, the mass that moves along. That includes mass on the supports, which
    is in no mode: the parts of all modes add up to 1 where there is none.

    Rows are modes in the order of the identified model, followed by their shapes as `NaturalModes` are. Close modes share their
    mass: a small change turns their shapes into each other, so that each has a wide 95 % band, and only their sum is well
    determined.

    Parameters
    ----------
    direction : {"X", "Y", "Z"}
    n_modes : int
    reference : ReferenceModes, optional
        Modes whose order the rows have, as of the structure before a change; by default those of the structure itself.

    Raises
    ------
    InputError
        If `direction` is no axis, or `n_modes` no whole number of at least 1.

    References
    ----------
    Clough and Penzien (1993), Dynamics of Structures, sections 26-2 and 26-3.
    """

    direction: str
    n_modes: int = 10
    reference: ReferenceModes | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` unless the direction is X, Y or Z, and the number of modes a whole one of at least 1."""
        require_mode_count(self.n_modes)
        if self.direction not in AXES:
            raise InputError(
                f"`direction` must be one of {', '.join(AXES)}, along which the ground moves, got {self.direction!r}"
            )

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """Function from parameters (n_params,) to participation, effective mass and part of the mass, (n_modes, 3).

        Participation factors are for mass-normalized modes (square root of kg), without sign; effective masses are in
        kg, and the part is of the mass that moves along the axis. Modes are matched to those at the first of `points`,
        physical parameters (n_params,) each.

        Raises
        ------
        InputError
            If the structure has no modes; from the function, if no mass moves along the axis.
        """
        structure.require_masses("effective masses")
        modes_at = followed_modes(structure, parameters, points, NaturalModes(self.n_modes, self.reference))
        released, rows, motion = _on_moving_ground(structure, self.direction)
        n_values = len(released.values)  # damping ratios, which stand last, are left out

        def evaluate(physical: FloatArray) -> FloatArray:
            """Participation (root of kg), effective mass (kg) and part of the mass, (n_modes, 3), at `physical`.

            `physical` (n_params,) are the parameters. `InputError` if no mass moves along the axis.
            """
            mass_times_motion = released.matrix("mass", parameters.values(physical)[:n_values]) @ motion
            total_mass = float(motion @ mass_times_motion)
            if not total_mass > 0:
                raise InputError(f"no mass moves along {self.direction}: ask for another direction")
            factor = np.abs(modes_at(physical).mode_shapes.T @ mass_times_motion[rows])
            return np.stack([factor, factor**2, factor**2 / total_mass], axis=1)

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return mode_axes(self.n_modes, "participation factor", "effective mass", "part of the mass")

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the three columns: participation, effective mass, and part of the mass."""
        return ("kg^0.5", "kg", "1")

    @property
    def unit(self) -> str:
        """Three units, one a column."""
        return ", ".join(self.units)


def _on_moving_ground(structure: Structure, direction: str) -> tuple[Structure, IntArray, FloatArray]:
    """Structure without damping ratios on ground that may move along `direction`, rows, and unit motion along it.

    The rows (n_dofs,) are the positions of the degrees of freedom of `structure` among the n of the first. The motion
    (n,) is 1 in the translations along `direction` ("X", "Y" or "Z") and 0 elsewhere.
    """
    undamped = replace(structure, damping_ratio=None)
    supports = [dof for dof in movable_supports(undamped) if dof.direction == direction]
    released = undamped.release_supports((Base("ground", supports),)) if supports else undamped
    position_of = {code: position for position, code in enumerate(released.numbering.free)}
    rows = np.array([position_of[code] for code in structure.numbering.free], dtype=np.int64)
    return released, rows, np.array([float(dof.direction == direction) for dof in released.dofs])
