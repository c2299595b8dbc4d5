"""What can be predicted: FRFs, histories, spectra and modes of a structure, as functions of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from structid.core.arrays import ComplexArray, FloatArray, NumberArray, require_finite, require_shape
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.core.units import FrfKind
from structid.dynamics import Modes, modes
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Base, Friction, Structure
from structid.forward.frf.response import Response, response
from structid.prediction.linear_response import Input, LinearResponse, input_words, linear_response, parse_inputs
from structid.prediction.poles import simulate_history
from structid.prediction.recovery import Output, OutputMap, output_map, output_unit, parse_outputs
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
    outputs : sequence of Dof, ElementOutput or str
        Where motion is read, or internal forces and stresses of elements, all in one unit; see `parse_output`.
    inputs : sequence of Dof, Base or str
        Where unit forces act, or which supports move by unit acceleration.
    frequency : (n_frequencies,) float array
        Hz, increasing, greater than 0.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
        Of motions; motion per motion where supports are the inputs.

    Raises
    ------
    InputError
        If a channel is doubled, the axis does not increase, or units of outputs differ.
    """

    outputs: tuple[Output, ...]
    inputs: tuple[Input, ...]
    frequency: FloatArray
    kind: FrfKind = "accelerance"

    def __init__(
        self,
        outputs: Sequence[Output | str],
        inputs: Sequence[Input | str],
        frequency: Sequence[float] | FloatArray,
        kind: FrfKind = "accelerance",
    ) -> None:
        """Read the names of sensors and loads, and require an increasing axis of frequencies above 0 Hz."""
        lines = np.asarray(frequency, dtype=np.float64)
        require_shape("frequency", lines, (None,))
        if not (lines > 0).all():
            raise InputError(f"`frequency` must be greater than 0 Hz, got {lines.min():g}")
        for name, value in (
            ("outputs", _distinct("outputs", parse_outputs(outputs))),
            ("inputs", _distinct("inputs", parse_inputs(inputs))),
            ("frequency", lines),
            ("kind", kind),
        ):
            object.__setattr__(self, name, value)
        moved = [each.name for each in self.inputs if isinstance(each, Base)]
        if moved and (len(moved) < len(self.inputs) or kind != "transmissibility"):
            raise InputError(
                f"{moved[0]!r} moves, so that FRFs are of kind transmissibility and all inputs bases, got {kind}; predict those of"
                " forces as a quantity of their own"
            )
        self._record(self.inputs)  # so that a wrong axis or kind is told here

    def _record(self, inputs: Sequence[Input]) -> FrfRecord:
        """A record with the lines and channels of the motions, for the response that is solved line by line."""
        loads = tuple(each.supports[0] if isinstance(each, Base) else each for each in inputs)
        sensors = tuple(each for each in self.outputs if isinstance(each, Dof)) or tuple(dict.fromkeys(loads))
        values = np.zeros((len(self.frequency), len(sensors), len(loads)), dtype=complex)
        return FrfRecord(self.frequency, values, sensors, loads, self.kind)

    @property
    def is_motion(self) -> bool:
        """Whether the outputs are motions, not forces or stresses."""
        return all(isinstance(each, Dof) for each in self.outputs)

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """FRFs as a function of physical parameters: solved line by line for small models, by poles for others.

        Raises
        ------
        InputError
            If an output is a von Mises stress, which is no linear function of a load.
        """
        rows, frf = self.row_evaluator(structure, parameters, points)
        if not rows.is_linear:
            name = next(str(each) for each in self.outputs if "von_mises" in str(each))
            raise InputError(
                f"{name} has no FRF: it is not linear in the load; predict its spectrum or history, or stress_xx, stress_yy and"
                " stress_xy"
            )
        return frf

    def row_evaluator(
        self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]
    ) -> tuple[OutputMap, Evaluator]:
        """What is read, and FRFs of its rows (a von Mises stress has three) as a function of physical parameters."""
        bases = structure.driven([each for each in self.inputs if isinstance(each, Dof)])
        if bases and self.kind != "transmissibility":
            raise InputError(
                f"{self.inputs[0]} is a support of base {bases[0].name!r}, so that FRFs are motion per motion, got"
                f" {self.kind}; ask for kind = 'transmissibility'"
            )
        inputs, band = bases or self.inputs, (self.frequency[0], self.frequency[-1])
        order = 2 if self.kind == "transmissibility" else DERIVATIVES[self.kind]
        if any(isinstance(each, Base) for each in inputs):
            _require_linear(structure, "FRFs of supports that move")
            response_of = linear_response(structure, parameters, points, self.outputs, inputs, order, band)
            return response_of.outputs, _by_poles(response_of, self.frequency)
        exact = response(structure, parameters, self._record(inputs))
        rows = output_map(structure, self.outputs, order)
        solved = exact.values_at if self.is_motion else _by_fields(exact, structure, parameters, rows, self)
        if structure.n_dofs <= DENSE_UP_TO or not _is_linear(structure):
            return rows, solved
        response_of = linear_response(structure, parameters, points, self.outputs, inputs, order, band)
        reduced = _by_poles(response_of, self.frequency)
        first = solved(points[0]) - reduced(points[0])
        return rows, lambda physical: np.asarray(first + reduced(physical))

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"frequency": self.frequency, "output": _words(self.outputs), "input": input_words(self.inputs)}

    @property
    def unit(self) -> str:
        """SI unit of a translation per force, or of what is read from elements per force or acceleration of supports."""
        if self.is_motion:
            return FRF_UNITS[self.kind]
        per = "m/s^2" if self.kind == "transmissibility" else "N"
        return f"({output_unit(self.outputs[0])})/({per})"


def _by_poles(response_of: LinearResponse, frequency: FloatArray) -> Evaluator:
    """FRFs of the rows (n_frequencies, n_rows, n_inputs) as a function of physical parameters, by a sum over poles."""
    return lambda physical: response_of.poles_at(physical).combined_frf(frequency, response_of.outputs.orders)


def _by_fields(exact: Response, structure: Structure, parameters: Parameters, rows: OutputMap, frf: Frf) -> Evaluator:
    """FRFs of rows that elements are read by, from the motion of all degrees of freedom, line by line."""
    loads = structure.selection([each for each in frf.inputs if isinstance(each, Dof)])

    def evaluate(physical: FloatArray) -> ComplexArray:
        read = rows.rows(parameters.values(physical))
        values = np.empty((len(frf.frequency), rows.n_rows, loads.shape[1]), dtype=complex)
        for part, fields in exact.solved_at(physical, loads):
            s = (2j * np.pi * frf.frequency[part])[:, None, None]
            groups = [read[:, k * rows.n_rows : (k + 1) * rows.n_rows].T for k in range(len(rows.orders))]
            values[part] = sum(
                s**order * np.stack([group @ line for line in fields])
                for order, group in zip(rows.orders, groups, strict=True)
            )
        return values

    return evaluate


@dataclass(frozen=True, eq=False)
class History:
    """Motion, forces or stresses from rest under loads, (n_times, n_outputs); exact for loads in straight lines between samples.

    Loss factors act as viscous dampings that take as much energy at each resonance, since a loss factor has no motion in time.

    Parameters
    ----------
    outputs : sequence of Dof, ElementOutput or str
        Where motion is read, or internal forces and stresses of elements, all in one unit; see `parse_output`.
    inputs : sequence of Dof, Base or str
        Where forces act, or which supports move.
    loads : (n_times, n_inputs) float array
        N or N m, and m/s^2 of supports; the first sample at t = 0. See `support_acceleration` where their displacement is known.
    sampling_rate : float
        Samples per second.
    motion : {"displacement", "velocity", "acceleration"}
    relative : bool
        Whether motions are those beyond the quasi-static motion that moving supports force on the structure; where all supports
        move alike this is the motion against the ground. Forces and stresses are of the whole motion in any case.

    Raises
    ------
    InputError
        If shapes do not fit, or a value is not finite.
    """

    outputs: tuple[Output, ...]
    inputs: tuple[Input, ...]
    loads: FloatArray
    sampling_rate: float
    motion: str = "acceleration"
    relative: bool = False

    def __init__(
        self,
        outputs: Sequence[Output | str],
        inputs: Sequence[Input | str],
        loads: FloatArray,
        sampling_rate: float,
        motion: str = "acceleration",
        relative: bool = False,
    ) -> None:
        """Read the names of sensors and loads; require finite loads, a positive sampling rate and a known motion."""
        sensors, driven = _distinct("outputs", parse_outputs(outputs)), _distinct("inputs", parse_inputs(inputs))
        table = np.asarray(loads, dtype=np.float64)
        require_shape("loads", table, (None, len(driven)), "one column an input")
        require_finite("loads", table)
        if not np.isfinite(sampling_rate) or sampling_rate <= 0:
            raise InputError(f"`sampling_rate` must be greater than 0 Hz, got {sampling_rate}")
        if motion not in MOTION_DERIVATIVES:
            raise InputError(f"`motion` must be one of {', '.join(MOTION_DERIVATIVES)}, got {motion!r}")
        if relative and not any(isinstance(each, Base) for each in driven):
            raise InputError(
                "`relative` motion is that beyond the motion of supports, and no input is a base; leave it out"
            )
        pairs = ("outputs", sensors), ("inputs", driven), ("loads", table), ("relative", relative)
        for name, value in (*pairs, ("sampling_rate", float(sampling_rate)), ("motion", motion)):
            object.__setattr__(self, name, value)

    @property
    def time(self) -> FloatArray:
        """Instants, s, (n_times,)."""
        return np.arange(len(self.loads)) / self.sampling_rate

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """The outputs (n_times, n_outputs) as a function of physical parameters, by a sum over poles."""
        _require_linear(structure, "a history")
        band, order = (self.sampling_rate / len(self.loads), self.sampling_rate / 2), MOTION_DERIVATIVES[self.motion]
        system = linear_response(
            structure, parameters, points, self.outputs, self.inputs, order, band, True, self.relative
        )

        def evaluate(physical: FloatArray) -> FloatArray:
            poles = system.poles_at(physical).combined(system.outputs.orders)
            return system.outputs.joined(simulate_history(poles, self.loads, self.sampling_rate))

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"time": self.time, "output": _words(self.outputs)}

    @property
    def unit(self) -> str:
        """SI unit of a translation, or of what is read from elements."""
        return output_unit(self.outputs[0]) or QUANTITY_UNITS[self.motion][0]


def support_acceleration(displacement: FloatArray, sampling_rate: float) -> FloatArray:
    """Acceleration (n_times, n), m/s^2, of supports that move from rest as `displacement` (n_times, n), m, says.

    It is that of the cubic spline through the samples, which runs in straight lines between them as `History` takes it. The record
    must begin at 0, where the structure is at rest.

    Raises
    ------
    InputError
        If a displacement does not begin at 0, or there are fewer than four samples.
    """
    table = np.asarray(displacement, dtype=np.float64)
    require_shape("displacement", table, (None, None))
    require_finite("displacement", table)
    if len(table) < 4:
        raise InputError(f"`displacement` must have at least 4 samples, got {len(table)}")
    if np.abs(table[0]).max(initial=0.0) > 1e-9 * np.abs(table).max(initial=0.0):
        raise InputError(f"`displacement` must begin at 0, got {table[0].tolist()}; subtract the first sample")
    spline = CubicSpline(
        np.arange(len(table)) / sampling_rate, table, bc_type=((1, np.zeros(table.shape[1])), "not-a-knot")
    )
    return np.asarray(spline(np.arange(len(table)) / sampling_rate, 2))


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
        rows, frf = self.frf.row_evaluator(structure, parameters, points)
        return lambda physical: np.einsum("fio,fo->fi", rows.powers(frf(physical)), self.density)

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"frequency": self.frf.frequency, "output": _words(self.frf.outputs)}

    @property
    def unit(self) -> str:
        """Square of the motion, or of what is read from elements, per Hz."""
        if not self.frf.is_motion:
            return f"({output_unit(self.frf.outputs[0])})^2/Hz"
        if self.frf.kind == "transmissibility":
            return f"({QUANTITY_UNITS['acceleration'][0]})^2/Hz"
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


def _words(outputs: Sequence[Output]) -> tuple[str, ...]:
    return tuple(str(output) for output in outputs)


def _distinct(name: str, channels: tuple[Any, ...]) -> tuple[Any, ...]:
    """The same channels; `InputError` where there is none, or one stands twice."""
    if not channels:
        raise InputError(f"`{name}` must name at least one channel, got none")
    for number, channel in enumerate(channels):
        if channel in channels[:number]:
            raise InputError(f"`{name}` names {channel} twice; leave one out")
    return channels
