"""Quantities that can be predicted: FRFs, histories, spectra and modes, as functions of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.optimize import linear_sum_assignment

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray, require_finite, require_shape
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.core.units import FrfKind
from structid.dynamics import Modes, modes
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Base, Friction, Structure
from structid.forward.frf.response import Response, response
from structid.prediction.linear_response import Input, LinearResponse, input_words, linear_response, parse_inputs
from structid.prediction.loads import band_limited_loads
from structid.prediction.poles import simulate_history
from structid.prediction.recovery import (
    Output,
    OutputMap,
    distinct_channels,
    is_von_mises,
    output_map,
    output_unit,
    parse_outputs,
)
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES, FRF_UNITS, MOTION_DERIVATIVES, QUANTITY_UNITS
from structid.unknowns import Parameters

#: Modes beside the wanted ones among which these are looked for.
_MORE_MODES = 4
#: Levels, in root mean squares, at which the distribution of a maximum is computed, and how many.
_MOST_LEVEL, _LEVELS = 12.0, 2401

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
        """Meaning of each axis of the result by its name, in order: frequencies (Hz), times (s) or names of entries."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each output, or of each column where there are no outputs."""
        ...

    @property
    def unit(self) -> str:
        """The units, each once."""
        ...


@dataclass(frozen=True, eq=False)
class Frf:
    """Frequency response functions, (n_frequencies, n_outputs, n_inputs) complex.

    Parameters
    ----------
    outputs : sequence of Dof, ElementOutput or str
        Where motion is read, or internal forces and stresses of elements; see `parse_output`.
    inputs : sequence of Dof, Base or str
        Where unit forces act, or which supports move by unit acceleration.
    frequency : (n_frequencies,) float array
        Hz, increasing, greater than 0.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
        Of motions; motion per motion where supports are the inputs.

    Raises
    ------
    InputError
        If a channel is doubled, or the axis does not increase.
    """

    outputs: tuple[Output, ...]
    inputs: tuple[Input, ...]
    frequency: FloatArray = field(repr=False)
    kind: FrfKind = "accelerance"

    def __init__(
        self,
        outputs: Sequence[Output | str],
        inputs: Sequence[Input | str],
        frequency: Sequence[float] | FloatArray,
        kind: FrfKind = "accelerance",
    ) -> None:
        """Read names of sensors and loads; raise `InputError` unless frequencies increase from above 0 Hz and all fits.

        `outputs` and `inputs` are names such as "12Y+" or objects; `frequency` is (n_frequencies,) in Hz. Bases among
        the inputs need `kind` transmissibility, and must then be all of them.
        """
        lines = np.asarray(frequency, dtype=np.float64)
        require_shape("frequency", lines, (None,))
        if not (lines > 0).all():
            raise InputError(f"`frequency` must be greater than 0 Hz, got {lines.min():g}")
        for name, value in (
            ("outputs", distinct_channels("outputs", parse_outputs(outputs))),
            ("inputs", distinct_channels("inputs", parse_inputs(inputs))),
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
        """Record with the frequencies and channels, and zero values, for the response that is solved line by line.

        A base among `inputs` is replaced by its first support; without motions among the outputs, the loads stand for them.
        """
        loads = tuple(each.supports[0] if isinstance(each, Base) else each for each in inputs)
        sensors = tuple(each for each in self.outputs if isinstance(each, Dof)) or tuple(dict.fromkeys(loads))
        values = np.zeros((len(self.frequency), len(sensors), len(loads)), dtype=complex)
        return FrfRecord(self.frequency, values, sensors, loads, self.kind)

    @property
    def is_motion(self) -> bool:
        """True if the outputs are motions, not forces or stresses."""
        return all(isinstance(each, Dof) for each in self.outputs)

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """FRFs (n_frequencies, n_outputs, n_inputs) as a function of physical parameters (n_params,).

        They are solved line by line up to 64 degrees of freedom and with dry friction, else by poles. `points` are
        parameter values (n_params,) for which a reduction must serve, the identified ones first.

        Raises
        ------
        InputError
            If an output is a von Mises stress, which is no linear function of a load.
        """
        rows, frf = self.row_evaluator(structure, parameters, points)
        if not rows.is_linear:
            name = next(str(each) for each in self.outputs if is_von_mises(each))
            raise InputError(
                f"{name} has no FRF: it is not linear in the load; predict its spectrum or history, or stress_xx, stress_yy and"
                " stress_xy"
            )
        return frf

    def row_evaluator(
        self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]
    ) -> tuple[OutputMap, Evaluator]:
        """Map of the outputs, and the FRFs (n_frequencies, n_rows, n_inputs) of its rows as a function of physical parameters.

        A von Mises stress has three rows. `points` are parameter values (n_params,) for which a reduction must serve, the
        identified ones first.

        Raises
        ------
        InputError
            If an input is a support of a base and the kind is not transmissibility, or the structure does not allow its FRFs.
        """
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
        structure.require_masses("FRFs")
        exact = response(structure, parameters, self._record(inputs))
        rows = output_map(structure, self.outputs, order)
        solved = exact.values_at if self.is_motion else _frf_by_fields(exact, structure, parameters, rows, self)
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
    def units(self) -> tuple[str, ...]:
        """SI unit of each output: of a translation per force, or of what is read from an element per force or acceleration."""
        per = "m/s^2" if self.kind == "transmissibility" else "N"
        return tuple(f"({unit})/({per})" if unit else FRF_UNITS[self.kind] for unit in map(output_unit, self.outputs))

    @property
    def unit(self) -> str:
        """The units of the outputs, each once."""
        return _once(self.units)


def _by_poles(response_of: LinearResponse, frequency: FloatArray) -> Evaluator:
    """FRFs of the rows (n_frequencies, n_rows, n_inputs) as a function of physical parameters, by a sum over poles."""
    return lambda physical: response_of.poles_at(physical).combined_frf(frequency, response_of.outputs.orders)


def _frf_by_fields(
    exact: Response, structure: Structure, parameters: Parameters, rows: OutputMap, frf: Frf
) -> Evaluator:
    """FRFs of the rows of `rows` as a function of physical parameters, from the motion of all degrees of freedom.

    The function returns (n_frequencies, n_rows, n_inputs); the inputs of `frf` are forces. `exact` solves for the
    motion line by line.
    """
    loads = structure.selection([each for each in frf.inputs if isinstance(each, Dof)])
    read_dofs = np.unique(rows.columns.indices)

    def evaluate(physical: FloatArray) -> ComplexArray:
        """FRFs of the rows, (n_frequencies, n_rows, n_inputs), at the physical parameters (n_params,)."""
        by_order = (
            rows.rows(parameters.values(physical))[read_dofs, :].toarray().T.reshape(len(rows.orders), rows.n_rows, -1)
        )
        values = np.empty((len(frf.frequency), rows.n_rows, loads.shape[1]), dtype=complex)
        for part, fields in exact.solved_at(physical, loads):
            s = (2j * np.pi * frf.frequency[part])[:, None, None]
            motion = fields[:, read_dofs]
            values[part] = sum(s**order * (group @ motion) for order, group in zip(rows.orders, by_order, strict=True))
        return values

    return evaluate


@dataclass(frozen=True, eq=False)
class History:
    """Motion, forces or stresses from rest under loads, (n_times, n_outputs).

    It is exact for loads that run in straight lines between samples, and takes those that are filtered as band-limited.

    Loss factors act as viscous dampings that take as much energy at each resonance, since a loss factor has no motion in time.

    Parameters
    ----------
    outputs : sequence of Dof, ElementOutput or str
        Where motion is read, or internal forces and stresses of elements; see `parse_output`.
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
    is_filtered : bool or sequence of bool
        Whether the loads, or each of them, were measured behind a filter against aliasing: they then hold all that they had
        below half the sampling rate, which straight lines would weaken by 3 % at a tenth of the rate and by a fifth at a quarter
        of it. The attribute has a value for each input.

    Raises
    ------
    InputError
        If shapes do not fit, or a value is not finite.
    """

    outputs: tuple[Output, ...]
    inputs: tuple[Input, ...]
    loads: FloatArray = field(repr=False)
    sampling_rate: float
    motion: str = "acceleration"
    relative: bool = False
    is_filtered: tuple[bool, ...] = ()

    def __init__(
        self,
        outputs: Sequence[Output | str],
        inputs: Sequence[Input | str],
        loads: FloatArray,
        sampling_rate: float,
        motion: str = "acceleration",
        relative: bool = False,
        is_filtered: bool | Sequence[bool] = False,
    ) -> None:
        """Read names of sensors and loads; raise `InputError` unless loads are finite and the rate positive.

        `loads` (n_times, n_inputs) are in N, N m or, of bases, m/s^2; `sampling_rate` is in Hz. `motion` is the
        quantity read at sensors. `relative` asks for motion beyond that of moving supports, and needs a base among the
        inputs. `is_filtered`, one value or one for each input, says that loads were measured behind a filter against
        aliasing.
        """
        sensors, driven = (
            distinct_channels("outputs", parse_outputs(outputs)),
            distinct_channels("inputs", parse_inputs(inputs)),
        )
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
        filtered = _one_an_input(is_filtered, len(driven))
        pairs = ("outputs", sensors), ("inputs", driven), ("loads", table), ("relative", relative)
        for name, value in (
            *pairs,
            ("is_filtered", filtered),
            ("sampling_rate", float(sampling_rate)),
            ("motion", motion),
        ):
            object.__setattr__(self, name, value)

    @property
    def time(self) -> FloatArray:
        """Instants, s, (n_times,)."""
        return np.arange(len(self.loads)) / self.sampling_rate

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """Outputs (n_times, n_outputs) as a function of physical parameters, by a sum over poles.

        `points` are parameter values (n_params,) for which a reduction must serve, the identified ones first. `InputError` if
        the structure has dry friction or no modes.
        """
        _require_linear(structure, "a history")
        band, order = (self.sampling_rate / len(self.loads), self.sampling_rate / 2), MOTION_DERIVATIVES[self.motion]
        system = linear_response(
            structure, parameters, points, self.outputs, self.inputs, order, band, True, self.relative
        )

        is_filtered = np.array(self.is_filtered, dtype=bool)
        between = self.loads.copy()
        between[:, is_filtered] = band_limited_loads(self.loads[:, is_filtered])

        def evaluate(physical: FloatArray) -> FloatArray:
            poles = system.poles_at(physical).combined(system.outputs.orders)
            return system.outputs.joined(simulate_history(poles, self.loads, self.sampling_rate, between))

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"time": self.time, "output": _words(self.outputs)}

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each output: of a translation, or of what is read from an element."""
        return tuple(output_unit(output) or QUANTITY_UNITS[self.motion][0] for output in self.outputs)

    @property
    def unit(self) -> str:
        """The units of the outputs, each once."""
        return _once(self.units)


def _one_an_input(is_filtered: object, n_inputs: int) -> tuple[bool, ...]:
    """`is_filtered` of each of `n_inputs` inputs, from one value or one for each; `InputError` for other than True and False."""
    if isinstance(is_filtered, bool | np.bool_):
        return (bool(is_filtered),) * n_inputs
    each = list(is_filtered) if isinstance(is_filtered, Iterable) else [is_filtered]
    if not all(isinstance(value, bool | np.bool_) for value in each):
        raise InputError(
            f"`is_filtered` must be True or False, or one of them for each of {n_inputs} inputs, got {is_filtered!r}"
        )
    if len(each) != n_inputs:
        raise InputError(f"`is_filtered` must be one value, or one for each of {n_inputs} inputs, got {len(each)}")
    return tuple(map(bool, each))


def support_acceleration(displacement: FloatArray, sampling_rate: float) -> FloatArray:
    """Acceleration (n_times, n), m/s^2, of supports that move from rest with `displacement` (n_times, n), m.

    It is that of the cubic spline through the samples, which is linear between them. The record
    must begin at 0, where the structure is at rest. `sampling_rate` is in Hz.

    Raises
    ------
    InputError
        If a displacement does not begin at 0 or is not finite, or there are fewer than four samples.
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


@runtime_checkable
class DerivedQuantity(Quantity, Protocol):
    """One number of each output of another quantity, `base`: both come from one computation for each random model."""

    @property
    def base(self) -> Quantity: ...

    def derived(self, values: NumberArray) -> NumberArray:
        """The quantity from `values` of its `base`, which have the axes of that."""
        ...

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """See `Quantity.evaluator`."""
        evaluate = self.base.evaluator(structure, parameters, points)
        return lambda physical: self.derived(evaluate(physical))

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"output": self.base.axes["output"]}

    @property
    def unit(self) -> str:
        """The units of the outputs, each once."""
        return _once(self.units)


@dataclass(frozen=True, eq=False)
class Maxima(DerivedQuantity):
    """The largest absolute value of each output of a history, (n_outputs,)."""

    history: History

    @property
    def base(self) -> History:
        """The history."""
        return self.history

    def derived(self, values: NumberArray) -> NumberArray:
        """Largest magnitudes (n_outputs,) of a history (n_times, n_outputs)."""
        return np.asarray(np.abs(values).max(axis=0))

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each output, that of the history."""
        return self.history.units


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided spectral densities of motion, forces or stresses under stationary random loads, (n_frequencies, n_outputs).

    Of a von Mises stress it is that of its mean square: a weighted sum of spectra of the components.

    Parameters
    ----------
    frf : Frf
        From the loads to the outputs, in the kind of motion that is wanted.
    density : (n_frequencies, n_inputs) float array
        One-sided spectral density of each load, N^2/Hz, or of each acceleration of supports, (m/s^2)^2/Hz; loads are independent of
        one another.
    """

    frf: Frf
    density: FloatArray = field(repr=False)

    def __post_init__(self) -> None:
        """Raise `InputError` unless `density` is (n_frequencies, n_inputs), finite and at least 0."""
        density = np.asarray(self.density, dtype=np.float64)
        n_lines, n_inputs = len(self.frf.frequency), len(self.frf.inputs)
        require_shape("density", density, (n_lines, n_inputs), "one value a line and load")
        if not (np.isfinite(density) & (density >= 0)).all():
            raise InputError("`density` must be finite and at least 0 everywhere: it is a mean square a hertz")
        object.__setattr__(self, "density", density)

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """See `Quantity.evaluator`."""
        rows, frf = self.frf.row_evaluator(structure, parameters, points)
        return lambda physical: np.einsum("fio,fo->fi", rows.powers(frf(physical)), self.density)

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return {"frequency": self.frf.frequency, "output": _words(self.frf.outputs)}

    @property
    def output_units(self) -> tuple[str, ...]:
        """SI unit of each output: of a translation, or of what is read from an element."""
        motion = {"receptance": "displacement", "mobility": "velocity"}.get(self.frf.kind, "acceleration")
        return tuple(output_unit(output) or QUANTITY_UNITS[motion][0] for output in self.frf.outputs)

    @property
    def units(self) -> tuple[str, ...]:
        """Square of the unit of each output per Hz."""
        return tuple(f"({unit})^2/Hz" for unit in self.output_units)

    @property
    def unit(self) -> str:
        """The units of the outputs, each once."""
        return _once(self.units)


@dataclass(frozen=True, eq=False)
class RootMeanSquare(DerivedQuantity):
    """Root mean square of each output over the lines of a spectrum, (n_outputs,)."""

    spectrum: Spectrum

    @property
    def base(self) -> Spectrum:
        """The spectrum."""
        return self.spectrum

    def derived(self, values: NumberArray) -> NumberArray:
        """Root mean squares (n_outputs,) of spectral densities (n_frequencies, n_outputs)."""
        return np.asarray(np.sqrt(np.trapezoid(values.real, self.spectrum.frf.frequency, axis=0)))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the motions."""
        return self.spectrum.output_units


@dataclass(frozen=True, eq=False)
class Extremes(DerivedQuantity):
    """The largest magnitude of each output of a stationary Gaussian response within a duration, (n_outputs,).

    It is the mean of that maximum, or the value below which it stays with a stated probability.

    Parameters
    ----------
    spectrum : Spectrum
        Its lines must be close enough for resonances and reach as far as the response does.
    duration : float
        s.
    probability : float, optional
        That the maximum stays below; the mean of the maximum by default.

    Raises
    ------
    InputError
        If the duration is not positive, the probability not between 0 and 1, or an output is a von Mises stress, which is not
        Gaussian.

    References
    ----------
    Vanmarcke (1975), J. Appl. Mech. 42, 215-220, for |x| as in Der Kiureghian (1980), Earthq. Eng. Struct. Dyn. 8, 419-435,
    Eqs. 8 and 9. Mean over root mean square tends to Davenport (1964), Proc. Inst. Civ. Eng. 28, 187-196, in a wide band.
    """

    spectrum: Spectrum
    duration: float
    probability: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` on a `duration` not above 0, a `probability` outside 0 to 1, or a von Mises stress."""
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise InputError(f"`duration` must be greater than 0 s, got {self.duration:g}")
        if self.probability is not None and not 0 < self.probability < 1:
            raise InputError(f"`probability` must lie between 0 and 1, got {self.probability:g}")
        for output in self.spectrum.frf.outputs:
            if is_von_mises(output):
                raise InputError(
                    f"{output} is not Gaussian, so that its spectrum does not say its maximum; take its components"
                )

    @property
    def base(self) -> Spectrum:
        """The spectrum."""
        return self.spectrum

    def derived(self, values: NumberArray) -> NumberArray:
        """Mean or quantile of the largest magnitude, (n_outputs,), from spectral densities `values` (n_frequencies, n_outputs)."""
        w = 2 * np.pi * self.spectrum.frf.frequency
        moments = [np.trapezoid(w[:, None] ** k * values.real, w / (2 * np.pi), axis=0) for k in range(3)]
        return np.array([self._maximum(*each) for each in zip(*(m.tolist() for m in moments), strict=True)])

    def _maximum(self, m0: float, m1: float, m2: float) -> float:
        """Mean, or quantile with `probability`, of the largest magnitude within the duration; 0 where nothing moves.

        `m0`, `m1` and `m2` are the spectral moments of order 0 to 2 over circular frequency (rad/s).
        """
        if m0 <= 0 or m2 <= 0:
            return 0.0
        crossings = self.duration * np.sqrt(m2 / m0) / np.pi
        narrow = max(1 - m1**2 / (m0 * m2), 0.0) ** 0.6  # delta^1.2
        level = np.linspace(1e-6, _MOST_LEVEL, _LEVELS)
        clumped = -np.expm1(-np.sqrt(np.pi / 2) * narrow * level)
        below = -np.expm1(-(level**2) / 2) * np.exp(-crossings * clumped / np.expm1(level**2 / 2))
        if self.probability is None:
            return float(np.sqrt(m0) * np.trapezoid(1 - below, level))
        return float(np.sqrt(m0) * np.interp(self.probability, below, level))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the motions."""
        return self.spectrum.output_units


@dataclass(frozen=True, eq=False)
class ReferenceModes:
    """Mode shapes (n_dofs, n_modes) at degrees of freedom, by which modes of another structure are told.

    `mass` (n_dofs, n_dofs) weighs what they have in common, so that displacements and rotations count by their energy.
    """

    dofs: tuple[Dof, ...]
    mode_shapes: FloatArray
    mass: sparse.csc_array

    def order_in(self, structure: Structure, others: FloatArray) -> IntArray:
        """Columns of the mode shapes `others` (n_dofs, n) of `structure` that are most like these modes, in order.

        The sum of their mass-weighted MAC is the largest possible without a column taken twice; (n_modes,), or fewer if
        there are fewer columns. Shapes are compared at the degrees of freedom that both structures share.
        """
        index = {dof: row for row, dof in enumerate(structure.dofs)}
        shared = [(row, index[dof]) for row, dof in enumerate(self.dofs) if dof in index]
        own, their = np.array(shared, dtype=np.int64).reshape(-1, 2).T
        first, second = self.mode_shapes[own], others[their]
        mass = self.mass[own, :][:, own]
        energy, energy_of_others = (np.einsum("ij,ij->j", each, mass @ each) for each in (first, second))
        sizes = np.outer(energy, energy_of_others)  # 0 of a mode in which nothing shared moves
        alike = np.divide((first.T @ (mass @ second)) ** 2, sizes, out=np.zeros(sizes.shape), where=sizes > 0)
        return np.asarray(linear_sum_assignment(-alike)[1])


@dataclass(frozen=True, eq=False)
class NaturalModes:
    """Frequencies and damping ratios of the lowest modes, (n_modes, 2): Hz, then a number.

    Modes of a model within the uncertainty are those that are most like the identified ones, so that none is taken for another
    where two frequencies cross, and none is taken twice. With a `reference` the modes are those that are most like its own, in its
    order.
    """

    n_modes: int = 10
    reference: ReferenceModes | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` unless `n_modes` is a whole number of at least 1."""
        require_mode_count(self.n_modes)

    def evaluator(self, structure: Structure, parameters: Parameters, points: Sequence[FloatArray]) -> Evaluator:
        """Function from physical parameters (n_params,) to frequencies (Hz) and damping ratios, (n_modes, 2).

        Modes are matched to those at the first of `points` (n_params,), or to the reference if there is one.
        `InputError` if the structure has no modes.
        """
        modes_at = followed_modes(structure, parameters, points, self)

        def evaluate(physical: FloatArray) -> FloatArray:
            """Frequency (Hz) and damping ratio (n_modes, 2) of the modes most like the identified ones.

            `physical` (n_params,) are the parameters.
            """
            found = modes_at(physical)
            return np.stack([found.frequency, found.damping_ratio], axis=1)

        return evaluate

    @property
    def axes(self) -> dict[str, FloatArray | tuple[str, ...]]:
        """See `Quantity.axes`."""
        return mode_axes(self.n_modes, "frequency", "damping ratio")

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the two columns, frequencies and damping ratios."""
        return ("Hz", "1")

    @property
    def unit(self) -> str:
        """Two units, one a column."""
        return ", ".join(self.units)


def mode_axes(n_modes: int, *columns: str) -> dict[str, FloatArray | tuple[str, ...]]:
    """Axes of a table with a row for each of `n_modes` modes, counted from 1, and with the named `columns`; see `Quantity.axes`."""
    return {"mode": tuple(str(number + 1) for number in range(n_modes)), "value": columns}


def require_mode_count(n_modes: int) -> None:
    """Raise `InputError` unless the argument `n_modes` is a whole number of at least 1."""
    if not isinstance(n_modes, Integral) or n_modes < 1:
        raise InputError(f"`n_modes` must be a whole number of at least 1, got {n_modes!r}")


def followed_modes(
    structure: Structure, parameters: Parameters, points: Sequence[FloatArray], quantity: NaturalModes
) -> Callable[[FloatArray], Modes]:
    """Function from physical parameters (n_params,) to the modes that are most like certain ones, in their order.

    The certain ones are the lowest `quantity.n_modes` modes at the first of `points` (n_params,), the identified
    parameters, or those of the modes there that are most like `quantity.reference`. Likeness is by the mass; no mode is
    taken twice. `InputError` if the structure has no modes.
    """
    structure.require_modes("modes")
    n_modes = quantity.n_modes if quantity.reference is None else quantity.n_modes + _MORE_MODES
    first = structure_modes(structure, parameters.values(points[0]), n_modes).mode_shapes
    if quantity.reference is not None:
        first = first[:, quantity.reference.order_in(structure, first)]
    mass = structure.matrix("mass", parameters.values(points[0]))

    def modes_at(physical: FloatArray) -> Modes:
        """Modes of the structure at the physical parameters (n_params,), in the order of the first."""
        found = structure_modes(structure, parameters.values(physical), n_modes + _MORE_MODES)
        order = linear_sum_assignment(-((first.T @ (mass @ found.mode_shapes)) ** 2))[1]
        return Modes(
            found.frequency[order], found.damping_ratio[order], found.mode_shapes[:, order], found.rounding[order]
        )

    return modes_at


def comparable_modes(
    quantity: NaturalModes, before: tuple[Structure, FloatArray], after: tuple[Structure, FloatArray]
) -> tuple[NaturalModes, NaturalModes]:
    """Mode quantities of a structure before and after a change, with equal numbers of modes in matching order.

    Parameters
    ----------
    quantity : NaturalModes
        Its `n_modes` are wanted at most.
    before, after : (Structure, (n_values,) float array)
        With the property values.

    Returns
    -------
    NaturalModes
        Before the change.
    NaturalModes
        After it, with the modes before as reference.
    """
    for structure, _ in (before, after):
        structure.require_modes("modes")
    shapes = structure_modes(*before, quantity.n_modes).mode_shapes
    n_modes = min(shapes.shape[1], structure_modes(*after, quantity.n_modes).mode_shapes.shape[1])
    reference = ReferenceModes(before[0].dofs, shapes[:, :n_modes], before[0].matrix("mass", before[1]))
    return NaturalModes(n_modes), NaturalModes(n_modes, reference)


def structure_modes(structure: Structure, values: FloatArray, n_modes: int) -> Modes:
    """The `n_modes` lowest modes of a structure with the property values (n_values,)."""
    mass, stiffness, damping, loss = (
        structure.matrix(matrix_kind, values) for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    return modes(mass, stiffness, damping, loss, n_modes)


def _is_linear(structure: Structure) -> bool:
    """True if the matrices describe the structure completely, without friction or measured components."""
    return structure.has_modes and not any(isinstance(element, Friction) for element in structure.elements)


def _require_linear(structure: Structure, what: str) -> None:
    """Raise `InputError` if a structure has no modes, or has dry friction; `what` is the quantity in words."""
    structure.require_scaled_modes(what, "predict FRFs")
    rubbing = [element.name for element in structure.elements if isinstance(element, Friction)]
    if rubbing:
        raise InputError(
            f"{what} cannot be predicted with the dry friction of {rubbing[0]!r}, which is not linear; predict FRFs, or take the"
            " friction out of the structure"
        )


def _once(units: Sequence[str]) -> str:
    return "; ".join(dict.fromkeys(units))


def _words(outputs: Sequence[Output]) -> tuple[str, ...]:
    return tuple(str(output) for output in outputs)
