"""Participation factors and effective masses: the part of the mass that each mode moves when the ground does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.fem import Base, Structure
from structid.prediction.linear_response import movable_supports
from structid.prediction.quantities import Evaluator, NaturalModes, ReferenceModes, followed_modes, require_mode_count
from structid.unknowns import Parameters

AXES = ("X", "Y", "Z")


@dataclass(frozen=True, eq=False)
class ModalParticipation:
    """Participation factors and effective masses of the lowest modes under ground that moves along one axis, (n_modes, 3).

    With phi the shape of modal mass 1 and r the unit motion along the axis, the factor is |phi' M r| in kg^(1/2), the effective
    mass its square in kg, the third column its part of r' M r, the mass that moves along. Where all of the mass moves with free
    degrees of freedom, parts of all modes add up to 1; mass that stands on the supports is in no mode.

    Close modes share their mass: a small change turns their shapes into each other, so that the mass of each has a wide band, and
    only the sum over them is told.

    Parameters
    ----------
    direction : {"X", "Y", "Z"}
    n_modes : int
        Modes are followed as `NaturalModes` are.
    reference : ReferenceModes, optional
        As of `NaturalModes`.

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
        """Function from physical parameters (n_params,) to factors, effective masses and parts, (n_modes, 3).

        Raises
        ------
        InputError
            If the structure has no modes; from the function, if no mass moves along the axis.
        """
        modes_at = followed_modes(structure, parameters, points, NaturalModes(self.n_modes, self.reference))
        plain = replace(structure, damping_ratio=None)
        held = [dof for dof in movable_supports(plain) if dof.direction == self.direction]
        released = plain.release_supports((Base("ground", held),)) if held else plain
        number_of = {code: index for index, code in enumerate(released.numbering.free)}
        free = np.array([number_of[code] for code in structure.numbering.free], dtype=np.int64)
        ground = np.array([float(dof.direction == self.direction) for dof in released.dofs])

        def evaluate(physical: FloatArray) -> FloatArray:
            """Factor, effective mass and part of the mass of each mode, (n_modes, 3), at the physical parameters (n_params,)."""
            pull = released.matrix("mass", parameters.values(physical)[: len(released.values)]) @ ground
            total = float(ground @ pull)
            if not total > 0:
                raise InputError(f"no mass moves along {self.direction}: ask for another direction")
            shapes = modes_at(physical).mode_shapes
            factor = np.abs(shapes.T @ pull[free])
            return np.stack([factor, factor**2, factor**2 / total], axis=1)

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {
            "mode": tuple(str(number + 1) for number in range(self.n_modes)),
            "value": ("participation factor", "effective mass", "part of the mass"),
        }

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the three columns."""
        return ("kg^0.5", "kg", "1")

    @property
    def unit(self) -> str:
        """Three units, one a column."""
        return ", ".join(self.units)
