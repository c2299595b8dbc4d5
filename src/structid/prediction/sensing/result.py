"""Sensed motion and forces with their standard deviations, and sensors that were left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import Overview, Shown, format_number, join_words
from structid.core.dof import Dof
from structid.core.quantities import number, unit_text
from structid.prediction.recovery import Output, output_unit
from structid.records.record import QUANTITY_UNITS

#: Error of a sensor that was left out, over its stated deviation, from which on the model or the forces are wrong there.
LARGEST_CHECK = 2.0


@dataclass(frozen=True, eq=False)
class LeftOutSensor:
    """A sensor that was not used, and the motion that is sensed there.

    Attributes
    ----------
    dof : Dof
    motion : {"displacement", "velocity", "acceleration"}
    measured, sensed : (n_times,) float arrays
        SI units.
    std : (n_times,) float array
        Stated deviation of measured less sensed: that of what is sensed, and the noise of the sensor.
    """

    dof: Dof
    motion: str
    measured: FloatArray
    sensed: FloatArray
    std: FloatArray

    @property
    def ratio(self) -> float:
        """Root mean square of measured less sensed over the stated deviation: 1 is right."""
        return float(np.sqrt(np.mean(((self.measured - self.sensed) / self.std) ** 2)))


@dataclass(frozen=True, eq=False, repr=False)
class SensedMotion(Shown):
    """Motion and forces during a record, each with its standard deviation.

    Attributes
    ----------
    time : (n_times,) float array
        s.
    outputs : tuple of Dof or ElementOutput
    motion : {"displacement", "velocity", "acceleration"}
    values, std : (n_times, n_outputs) float arrays
        SI units: of motions, or of what is read from elements.
    force_dofs : tuple of Dof
    forces, force_std : (n_times, n_forces) float arrays
        The unknown forces, N or N m.
    prior_std : float
        Standard deviation of the unknown forces before the record; NaN where there are none.
    correlation_time : float
        Of the unknown forces, s, as stated or as the record makes likeliest; NaN where there are none.
    left_out : tuple of LeftOutSensor
        Sensors that were not used, but compared.
    words : tuple of str
        What the record does not tell.
    contradiction : str
        A sentence on how the record contradicts the model; "" where it does not.
    force_frequency : float
        About which the spectrum of the unknown forces lies, Hz; 0 where it falls from 0 Hz on, NaN where there are none.
    force_order : int
        The spectrum of the unknown forces falls with the frequency to the power -2 `force_order`, 1 to 3.
    """

    time: FloatArray
    outputs: tuple[Output, ...]
    motion: str
    values: FloatArray
    std: FloatArray
    force_dofs: tuple[Dof, ...]
    forces: FloatArray
    force_std: FloatArray
    prior_std: float
    correlation_time: float
    left_out: tuple[LeftOutSensor, ...] = ()
    words: tuple[str, ...] = ()
    contradiction: str = ""
    force_frequency: float = float("nan")
    force_order: int = 1

    @property
    def checks(self) -> tuple[tuple[Dof, float], ...]:
        """Sensors that were left out, and the root mean square of measured less sensed over the stated deviation: 1 is right."""
        return tuple((sensor.dof, sensor.ratio) for sensor in self.left_out)

    @property
    def is_explained(self) -> bool:
        """True where the model explains the record, also at the sensors that were left out."""
        return not self.contradiction and all(z < LARGEST_CHECK for _, z in self.checks)

    def unit_of(self, output: Output) -> str:
        """SI unit of the values of `output`: that of the motion along or about it, or of what is read from an element."""
        return output_unit(output) or QUANTITY_UNITS[self.motion][isinstance(output, Dof) and output.is_rotation]

    def overview(self) -> Overview:
        """A table with the RMS over the record of each output and force and of its deviation, and checks of left-out sensors."""
        rows = [
            (
                name,
                number(float(np.sqrt(np.mean(value**2))), 3),
                number(float(np.sqrt(np.mean(std**2))), 2),
                unit_text(unit),
            )
            for name, unit, value, std in zip(
                (*map(str, self.outputs), *(f"force at {dof}" for dof in self.force_dofs)),
                (
                    *map(self.unit_of, self.outputs),
                    *(QUANTITY_UNITS["force"][dof.is_rotation] for dof in self.force_dofs),
                ),
                (*self.values.T, *self.forces.T),
                (*self.std.T, *self.force_std.T),
                strict=True,
            )
        ]
        told = "".join(f"; {dof}, left out: {format_number(z, 3)} times its stated deviation" for dof, z in self.checks)
        return Overview(
            f"{self.motion} at {join_words(self.outputs)} over {len(self.time)} samples{told}",
            ("where", "rms", "± rms", "unit"),
            rows,
        )
