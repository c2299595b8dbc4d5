"""What can be predicted: FRFs, histories, spectra and modes of a structure, as functions of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, NumberArray, require_finite, require_shape
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.core.units import FrfKind
from structid.dynamics import Modes, modes
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Friction, Structure
from structid.forward.frf.response import response
from structid.prediction.poles import (
    PoleSum,
    Sides,
    reduce_structure,
    reduction_basis,
    simulate_history,
    sum_over_poles,
)
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES, FRF_UNITS, MOTION_DERIVATIVES, QUANTITY_UNITS
from structid.unknowns import Parameters

#: A quantity as a function of physical parameters.
Evaluator: TypeAlias = Callable[[FloatArray], NumberArray]


class Quantity(Protocol):
    """Something that a model predicts."""

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """The quantity as a function of the physical parameters.

        `points` are the identified parameters, then some within their uncertainty, for which it should be cheap and exact.
        """
        ...

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """What each axis of the result stands for, in order."""
        ...

    @property
    def unit(self) -> str: ...


@dataclass(frozen=True, eq=False)
class Frf:
    """Frequency response functions, (n_frequencies, n_outputs, n_inputs) complex.

    Parameters
    ----------
    outputs, inputs : sequence of Dof or str
        Where motion is read and unit loads act.
    frequency : (n_frequencies,) float array
        Hz, increasing, greater than 0.
    kind : {"receptance", "mobility", "accelerance"}

    Raises
    ------
    InputError
        If a channel is doubled, or the axis does not increase.
    """

    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    frequency: FloatArray
    kind: FrfKind = "accelerance"
    record: FrfRecord = field(init=False, repr=False)

    def __init__(
        self,
        outputs: Sequence[Dof | str],
        inputs: Sequence[Dof | str],
        frequency: Sequence[float] | FloatArray,
        kind: FrfKind = "accelerance",
    ) -> None:
        """Read the names of sensors and loads, and require an increasing axis of frequencies above 0 Hz."""
        lines = np.asarray(frequency, dtype=np.float64)
        require_shape("frequency", lines, (None,))
        if not (lines > 0).all():
            raise InputError(f"`frequency` must be greater than 0 Hz, got {lines.min():g}")
        sensors, loads = parse_dofs(outputs), parse_dofs(inputs)
        values = np.zeros((len(lines), len(sensors), len(loads)), dtype=complex)
        for name, value in (("outputs", sensors), ("inputs", loads), ("frequency", lines), ("kind", kind)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "record", FrfRecord(lines, values, sensors, loads, kind))

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """FRFs as a function of physical parameters: solved line by line for small models, by poles for others."""
        exact = response(structure, parameters, self.record)
        if structure.n_dofs <= DENSE_UP_TO or not _is_linear(structure):
            return exact.values_at
        system = _pole_function(structure, parameters, points, self, (self.frequency[0], self.frequency[-1]))
        factor = ((2j * np.pi * self.frequency) ** DERIVATIVES[self.kind])[:, None, None]
        first = exact.values_at(points[0]) - factor * system(points[0]).receptance(self.frequency)

        def evaluate(physical: FloatArray) -> ComplexArray:
            return np.asarray(first + factor * system(physical).receptance(self.frequency))

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"frequency": self.frequency, "output": _words(self.outputs), "input": _words(self.inputs)}

    @property
    def unit(self) -> str:
        """SI unit of a translation per force."""
        return FRF_UNITS[self.kind]


@dataclass(frozen=True, eq=False)
class History:
    """Motion from rest under loads, (n_times, n_outputs); exact for loads that run in straight lines between samples.

    Loss factors act as viscous dampings that take as much energy at each resonance, since a loss factor has no motion in time.

    Parameters
    ----------
    outputs, inputs : sequence of Dof or str
    loads : (n_times, n_inputs) float array
        N or N m, the first sample at t = 0.
    sampling_rate : float
        Samples per second.
    motion : {"displacement", "velocity", "acceleration"}

    Raises
    ------
    InputError
        If shapes do not fit, or a value is not finite.
    """

    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    loads: FloatArray
    sampling_rate: float
    motion: str = "acceleration"

    def __init__(
        self,
        outputs: Sequence[Dof | str],
        inputs: Sequence[Dof | str],
        loads: FloatArray,
        sampling_rate: float,
        motion: str = "acceleration",
    ) -> None:
        """Read the names of sensors and loads; require finite loads, a positive sampling rate and a known motion."""
        sensors, places = parse_dofs(outputs), parse_dofs(inputs)
        given = np.asarray(loads, dtype=np.float64)
        require_shape("loads", given, (None, len(places)), "one column an input")
        require_finite("loads", given)
        if not np.isfinite(sampling_rate) or sampling_rate <= 0:
            raise InputError(f"`sampling_rate` must be greater than 0 Hz, got {sampling_rate}")
        if motion not in MOTION_DERIVATIVES:
            raise InputError(f"`motion` must be one of {', '.join(MOTION_DERIVATIVES)}, got {motion!r}")
        pairs = ("outputs", sensors), ("inputs", places), ("loads", given)
        for name, value in (*pairs, ("sampling_rate", float(sampling_rate)), ("motion", motion)):
            object.__setattr__(self, name, value)

    @property
    def time(self) -> FloatArray:
        """Instants, s, (n_times,)."""
        return np.arange(len(self.loads)) / self.sampling_rate

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """The motion (n_times, n_outputs) as a function of physical parameters, by a sum over poles."""
        _require_linear(structure, "a history")
        lowest = self.sampling_rate / len(self.loads)
        system = _pole_function(structure, parameters, points, self, (lowest, self.sampling_rate / 2), True)

        def evaluate(physical: FloatArray) -> FloatArray:
            return simulate_history(system(physical), self.loads, self.sampling_rate, MOTION_DERIVATIVES[self.motion])

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"time": self.time, "output": _words(self.outputs)}

    @property
    def unit(self) -> str:
        """SI unit of a translation."""
        return QUANTITY_UNITS[self.motion][0]


@dataclass(frozen=True, eq=False)
class Maxima:
    """The largest absolute value of each output of a history, (n_outputs,)."""

    history: History

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """See `Quantity.evaluator`."""
        motion = self.history.evaluator(structure, parameters, points)
        return lambda physical: np.abs(motion(physical)).max(axis=0)

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"output": _words(self.history.outputs)}

    @property
    def unit(self) -> str:
        """That of the history."""
        return self.history.unit


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided spectral densities of motion under stationary random loads, (n_frequencies, n_outputs).

    Parameters
    ----------
    frf : Frf
        From the loads to the motion, in the kind of motion that is wanted.
    density : (n_frequencies, n_inputs) float array
        One-sided spectral density of each load, N^2/Hz; loads are independent of one another.
    """

    frf: Frf
    density: FloatArray

    def __post_init__(self) -> None:
        n_lines, n_inputs = len(self.frf.frequency), len(self.frf.inputs)
        require_shape("density", np.asarray(self.density), (n_lines, n_inputs), "one value a line and load")

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """See `Quantity.evaluator`."""
        frf = self.frf.evaluator(structure, parameters, points)
        return lambda physical: np.einsum("fio,fo->fi", np.abs(frf(physical)) ** 2, self.density)

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"frequency": self.frf.frequency, "output": _words(self.frf.outputs)}

    @property
    def unit(self) -> str:
        """Square of the motion per Hz."""
        motion = {"receptance": "displacement", "mobility": "velocity", "accelerance": "acceleration"}[self.frf.kind]
        return f"({QUANTITY_UNITS[motion][0]})^2/Hz"


@dataclass(frozen=True, eq=False)
class RootMeanSquare:
    """Root mean square of each output over the lines of a spectrum, (n_outputs,)."""

    spectrum: Spectrum

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """See `Quantity.evaluator`."""
        density, lines = self.spectrum.evaluator(structure, parameters, points), self.spectrum.frf.frequency
        return lambda physical: np.sqrt(np.trapezoid(density(physical).real, lines, axis=0))

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"output": _words(self.spectrum.frf.outputs)}

    @property
    def unit(self) -> str:
        """That of the motion."""
        return self.spectrum.unit.removesuffix("^2/Hz").strip("()")


@dataclass(frozen=True, eq=False)
class NaturalModes:
    """Frequencies and damping ratios of the lowest modes, (n_modes, 2): Hz, then a number.

    Modes of a model within the uncertainty are those that are most like the identified ones, so that none is taken for another
    where two frequencies cross.
    """

    n_modes: int = 10

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """Frequencies and damping ratios (n_modes, 2) as a function of physical parameters."""
        structure.require_modes("modes")
        first = _structure_modes(structure, parameters.values(points[0]), self.n_modes)
        mass = structure.matrix("inertia", parameters.values(points[0]))

        def evaluate(physical: FloatArray) -> FloatArray:
            """Frequency and damping ratio of the modes that are most like the identified ones, (n_modes, 2)."""
            found = _structure_modes(structure, parameters.values(physical), self.n_modes + 4)
            alike = np.abs(first.mode_shapes.T @ (mass @ found.mode_shapes))
            order = alike.argmax(axis=1)
            return np.stack([found.frequency[order], found.damping_ratio[order]], axis=1)

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {
            "mode": tuple(str(number + 1) for number in range(self.n_modes)),
            "value": ("frequency", "damping ratio"),
        }

    @property
    def unit(self) -> str:
        """Two units, one a column."""
        return "Hz, 1"


def _structure_modes(structure: Structure, values: FloatArray, n_modes: int) -> Modes:
    """The `n_modes` lowest modes of a structure with the property values (n_values,)."""
    mass, stiffness, damping, loss = (
        structure.matrix(law, values) for law in ("inertia", "elastic", "viscous", "structural")
    )
    return modes(mass, stiffness, damping, loss, n_modes)


def _pole_function(
    structure: Structure,
    parameters: Parameters,
    points: Sequence[FloatArray],
    channels: Frf | History,
    band: tuple[float, float],
    is_viscous: bool = False,
) -> Callable[[FloatArray], PoleSum]:
    """The sum over poles of a structure as a function of its physical parameters, on one basis of motions."""
    sides = Sides(structure.selection(channels.outputs), structure.selection(channels.inputs))
    basis = reduction_basis(structure, [parameters.values(point) for point in points], sides, *band)

    def evaluate(physical: FloatArray) -> PoleSum:
        reduced = reduce_structure(structure, parameters.values(physical), basis, sides)
        return sum_over_poles(reduced, reduced.viscous_equivalent() if is_viscous else None)

    return evaluate


def _is_linear(structure: Structure) -> bool:
    """Whether the matrices of a structure are all there is of it."""
    return structure.has_modes and not any(isinstance(element, Friction) for element in structure.elements)


def _require_linear(structure: Structure, what: str) -> None:
    """Raise `InputError` where a structure has no modes, or dry friction; `what` is the quantity in words."""
    structure.require_modes(what, "predict FRFs")
    rubbing = [element.name for element in structure.elements if isinstance(element, Friction)]
    if rubbing:
        raise InputError(
            f"{what} cannot be predicted with the dry friction of {rubbing[0]!r}, which is not linear; predict FRFs, or take the"
            " friction out of the structure"
        )


def _words(dofs: Sequence[Dof]) -> tuple[str, ...]:
    return tuple(str(dof) for dof in dofs)
