"""Modes as a least-squares problem: frequencies, damping ratios and shapes with the covariance they came with.

The form ``dynamic`` compares by the smallest force that makes a measured shape a motion of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward.channel_errors import ChannelErrors
from structid.forward.modal.measured import FewSensorsError, MeasuredModes, ModalForm, ModalSettings
from structid.forward.modal.model import ALL_MODES_UP_TO, MatrixSlopes, ModalModel
from structid.forward.modal.output import output_changes, output_rows, pairing
from structid.forward.record_problem import RecordFacts, RecordProblem, linearization_with_priors
from structid.inversion.linearization import LastEvaluation, Linearization
from structid.inversion.problem import DataRows, NoiseLaw, RowNoise, Schedule
from structid.modal import ModalRecord
from structid.unknowns import Parameters

_START_ERROR = 0.5
#: Errors of frequencies and shapes where modes are paired by their order: shapes hardly count.
_ORDER_ERRORS = 0.02, 1.0
_SINGULAR = 1e14


@dataclass(frozen=True, eq=False)
class ModalProblem(RecordProblem):
    """Parameters of a structure from measured modes.

    Forms of the residual:

    - ``output``: frequencies, damping ratios and shapes of paired modes over their standard deviations. Shapes have
      no scale: what counts is the distance of each measured shape from the span of the model's. Modes closer than
      `closeness` form a group, whose span is compared and whose shapes may turn, so that derivatives stay finite
      where modes meet or cross.
    - ``dynamic``: the smallest force that makes the measured shape a motion of the model at the measured frequency,
      with the unmeasured degrees of freedom eliminated. It needs no pairing and is smooth everywhere: for poor starts.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
    record : ModalRecord
        Modes at 0 Hz are left out. Shape entries that are unknown have no part in residual, scale and pairing; of close
        modes the channels count that are known in all of them. A mode without a known entry counts by its frequency
        (and damping ratio) alone, and is paired by it.
    settings : ModalSettings
        What counts of the modes, and how.
    channels : ChannelErrors, optional
        Gains of sensors, by which shapes are read wrongly; for the form ``output``. One sensor at least keeps
        its gain, as shapes have no scale.
    in_order : bool
        Whether the k-th measured mode is the k-th of the model that the sensors see, whatever its shape.

    Raises
    ------
    InputError
        If the record has no mode above 0 Hz, no shapes, or no uncertainty and none is given; if sensors are not
        part of the structure; or if channels have an error that shapes do not show.

    Notes
    -----
    Output-only modes carry no kilograms: masses and stiffnesses are determined up to one common factor unless one of
    them is known.

    References
    ----------
    Friswell and Mottershead (1995), Finite Element Model Updating in Structural Dynamics, chapters 5 and 8. Norris
    (1986), chapter 4, for the elimination of what is not measured.
    """

    structure: Structure
    parameters: Parameters
    record: ModalRecord
    settings: ModalSettings = field(default_factory=ModalSettings)
    channels: ChannelErrors | None = None
    in_order: bool = False

    compares_modes = True
    matrix_free_obstacle = "takes records of responses, got one of modes"

    def __new__(cls, *given: object, **named: object) -> Self:
        """New problem; raises `InputError` if a setting is given as an argument of its own instead of in `settings`.

        Any string among the unnamed arguments counts as such a setting.
        """
        moved = [item.name for item in fields(ModalSettings) if item.name in named]
        if moved or any(isinstance(item, str) for item in given):
            example = f"{moved[0]}={named[moved[0]]!r}" if moved else 'form="dynamic"'
            raise InputError(f"how modes are fitted is said in `settings`: write settings=ModalSettings({example})")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        """Raise `InputError` if structure, measured modes, form and channel errors do not fit together.

        The structure must have modes and all sensors; frequencies, shapes and used damping ratios need errors; form
        ``dynamic`` needs a known shape entry and no channel errors; these can be gains of sensors only.
        """
        self.structure.require_modes("modes")
        _ = self.data, self.model.sensors
        if self.settings.form == "dynamic" and not self.data.has_shapes:
            raise InputError("form 'dynamic' needs a known shape entry, of one mode at least; use form 'output'")
        if self.channels is not None:
            _require_sound_channels(self.settings.form, self.channels)

    @cached_property
    def data(self) -> MeasuredModes:
        return MeasuredModes(self.record, self.settings)

    @cached_property
    def model(self) -> ModalModel:
        """The structure's modes as the record's sensors see them."""
        return ModalModel(self.structure, self.parameters, self.record.channels, self.channels, self.record.n_modes)

    @property
    def frequency(self) -> FloatArray:
        return self.record.frequency

    @property
    def facts(self) -> RecordFacts:
        return replace(
            super().facts,
            noise="the deviations of the modes",
            measures_force=False,
            takes_clock_for_stiffness=True,
            leaves_damping_out=not self.settings.use_damping
            and bool((np.nan_to_num(self.record.damping_ratio) > 0).any()),
            record=self.record,
        )

    @cached_property
    def rows(self) -> DataRows:
        """Labels of data rows: mode, channel and quantity of each, in the order of the residual.

        Form ``output``: shape and mixing of one group after another, then frequencies and damping ratios of all modes;
        form ``dynamic``: a force for each known shape entry. Channels without a row, unknown in all modes or in one of
        every group, have no name.
        """
        n = len(self.record.channels)
        if self.settings.form == "dynamic":
            mode, channel = np.nonzero(self.record.known.T[self.data.measured])
            forces = tuple(f"force for the shape at {self.record.channels[c]}" for c in np.unique(channel))
            return DataRows(self.data.measured[mode], 2 * channel, forces, self.data.measured[mode])
        lines, series = [], []
        for group in self.data.groups:
            m = len(group.members)
            lines += [np.tile(group.members, len(group.channels)), np.repeat(group.members, m)]
            series += [np.repeat(2 * group.channels, m), np.full(m * m, 2 * n)]
        used = np.unique(np.concatenate([group.channels for group in self.data.groups]))
        shapes = [f"shape at {self.record.channels[c]}" for c in used]
        scalars = ("frequency", "damping ratio") if self.settings.use_damping else ("frequency",)
        lines.append(np.tile(self.data.measured, len(scalars)))
        series.append(np.repeat(2 * n + 2 * np.arange(1, len(scalars) + 1), len(self.data.measured)))
        modes, names = np.concatenate(lines), (*shapes, "mixing of close modes", *scalars)
        return DataRows(modes, np.concatenate(series), names, modes)

    @property
    def row_kinds(self) -> NDArray[np.str_]:
        """Kind of value of each data row, (n_data,): frequencies, damping ratios, shapes."""
        kinds = np.array([_kind_of(name) for name in self.rows.names])
        return kinds[np.unique(self.rows.series, return_inverse=True)[1]]

    def schedules(self) -> Sequence[Schedule]:
        """Sequences of search stages (name, problem) to be tried in turn: none, modes in order, dynamic residual.

        The latter two draw parameters to their start. Pairing by order of frequency, with shapes hardly counting, helps
        if two modes have yet to cross, but no mode may be missed; it is left out if the sensors cannot separate modes
        with such errors. The dynamic residual needs no pairing; it is left out above 600 degrees of freedom, without
        shapes and with channel errors.
        """
        near = replace(self, parameters=self.parameters.kept_near_start(_START_ERROR))
        frequency, shape = _ORDER_ERRORS
        schedules: list[Schedule] = [()]
        with suppress(FewSensorsError):  # errors so wide leave more modes together than the sensors tell
            errors = replace(self.settings, form="output", frequency_error=frequency, shape_error=shape)
            ordered = replace(near, settings=errors, in_order=True)
            schedules.append((("modes in their order", ordered),))
        if self.data.has_shapes and self.structure.n_dofs <= ALL_MODES_UP_TO and self.channels is None:
            schedules.append((("modal dynamic residual", of_form(near, "dynamic")),))
        return schedules

    def keeping_order(self, theta: FloatArray) -> ModalProblem:
        """Problem with modes paired in order of frequency, if no shape is known and that is the pairing at `theta`.

        Else, and in the form ``dynamic``, this problem itself. `theta` (n_params,) are the free variables.
        """
        if self.data.has_shapes or self.settings.form != "output":
            return self
        state = self.model.state(self.physical(theta))
        is_ordered = np.array_equal(pairing(self.data, state, False), pairing(self.data, state, True))
        return replace(self, in_order=True) if is_ordered else self

    def residual(self, theta: FloatArray) -> FloatArray:
        """Weighted data rows, then prior rows, (n_residuals,), at the free variables `theta` (n_params,)."""
        known = self.linearize(theta) if self.settings.form == "dynamic" else self._last.known(theta)
        if known is not None:
            return known.residual
        data, _, eliminated = output_rows(self.data, self.model, self.physical(theta), self.in_order, with_slopes=False)
        none = np.zeros((len(data), len(theta)))
        return linearization_with_priors(self.unknowns, theta, data, none, eliminated).residual

    @cached_property
    def _last(self) -> LastEvaluation[Linearization]:
        return LastEvaluation()

    def linearize(self, theta: FloatArray) -> Linearization:
        """Weighted residual at the free variables `theta` (n_params,) and its Jacobian by these, prior rows last.

        It is cached for the last `theta`.
        """

        def linearized(theta: FloatArray) -> Linearization:
            """Weighted residual at the free variables `theta` (n_params,) and its Jacobian by these, not cached.

            Prior rows are last. `self` is the problem, whose form decides which data rows there are.
            """
            physical = self.physical(theta)
            if self.settings.form == "dynamic":
                data, change, eliminated = *dynamic_rows(self.data, self.model, physical), 0
            else:
                data, change, eliminated = output_rows(self.data, self.model, physical, self.in_order)
            return linearization_with_priors(self.unknowns, theta, data, change * self.slope(theta), eliminated)

        return self._last.at(theta, linearized)

    def noise_law(self, theta: FloatArray) -> NoiseLaw:
        """Law of the noise of the data rows at `theta` (n_params,).

        Rows count as independent in the form ``dynamic``, and where the record does not say how its numbers vary
        together.
        """
        if self.settings.form == "dynamic":
            return RowNoise()
        return RowNoise(factor=output_changes(self.data, self.model, self.physical(theta), self.in_order))


def _kind_of(row: str) -> str:
    """Kind of value of the data rows of this name."""
    first = row.partition(" ")[0]
    return {"shape": "shapes", "mixing": row, "frequency": "frequencies", "force": "forces"}.get(
        first, "damping ratios"
    )


def of_form(problem: ModalProblem, form: ModalForm) -> ModalProblem:
    """A copy with a residual of another form."""
    return replace(problem, settings=replace(problem.settings, form=form))


def shape_residual(problem: ModalProblem, theta: FloatArray) -> FloatArray:
    """Residual rows (n,) of shape values in the form ``output``, in standard deviations, at `theta` (n_params,)."""
    of = problem if problem.settings.form == "output" else of_form(problem, "output")
    return of.residual(theta)[: of.n_data][of.rows.series < 2 * len(problem.record.channels)]


def influence_by_kind(problem: ModalProblem, theta: FloatArray) -> dict[str, tuple[int, float, float]]:
    """Number of values, of parameters that they determine, and fraction of the misfit, for each kind of value.

    Kinds are such as shapes or frequencies. The second is the trace of (J'J)^-1 J_k'J_k with J the whitened Jacobian,
    prior rows included, and J_k its rows of the kind; with that of the prior rows, which are no kind here, these add up
    to the number of parameters. The third is of the sum of squares of all data rows, or 0 where that sum is 0. Rows
    that are 0 with all their derivatives do not count. Empty if data and priors do not determine all parameters.
    `theta` (n_params,) are free variables.
    """
    linearization = problem.linearize(theta)
    information = linearization.jacobian.T @ linearization.jacobian
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all() or np.linalg.cond(information / np.outer(scale, scale)) > _SINGULAR:
        return {}
    covariance = np.linalg.inv(information)
    kinds = problem.row_kinds
    influence = {}
    residual, jacobian = linearization.residual[: problem.n_data], linearization.jacobian[: problem.n_data]
    filled = (residual != 0) | (jacobian != 0).any(axis=1)
    whole = float(residual @ residual)
    for kind in dict.fromkeys(kinds[filled].tolist()):
        rows = np.flatnonzero((kinds == kind) & filled)
        rows_of_kind, part = jacobian[rows], residual[rows]
        trace = float(np.einsum("ij,jk,ik->", rows_of_kind, covariance, rows_of_kind))
        influence[kind] = (len(rows), trace, float(part @ part) / whole if whole else 0.0)
    return influence


def _require_sound_channels(form: ModalForm, channels: ChannelErrors) -> None:
    """Raise `InputError` unless form is 'output' and all channel errors are gains of sensors."""
    if form == "dynamic":
        raise InputError("form 'dynamic' takes no errors of channels; use form 'output'")
    if set(channels.kinds) != {"gain"} or channels.polarity_names:
        raise InputError(
            "of errors of channels, modes show gains of sensors only; leave others out, and turn a sensor round by `relabel`"
        )


def dynamic_rows(data: MeasuredModes, model: ModalModel, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force residual of all modes with a shape, (n_rows,), and its derivative by the parameters, (n_rows, n_params).

    A mode has a row for each known shape entry; modes follow each other. Residuals are in parts of the inertia force,
    divided by twice the relative standard deviation of the frequency, or by 1e-3 if that is larger. `physical`
    (n_params,) are the parameters.
    """
    shown = data.record.known[:, data.measured].any(axis=0)
    residuals = [
        dynamic_residual(
            model.structure,
            model.slopes,
            physical,
            model.parameters.start,
            model.sensors[:, data.record.known[:, mode]],
            2 * np.pi * data.record.frequency[mode],
            data.shapes[data.record.known[:, mode], mode],
        )
        for mode in data.measured[shown]
    ]
    size = np.maximum(2 * data.frequency_std / data.frequency, 1e-3)[shown]
    error = np.concatenate([e / s for (e, _), s in zip(residuals, size, strict=True)])
    return error, np.concatenate([d / s for (_, d), s in zip(residuals, size, strict=True)])


def dynamic_residual(
    structure: Structure,
    slopes: MatrixSlopes,
    physical: FloatArray,
    start: FloatArray,
    sensors: FloatArray,
    omega: float,
    shape: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Smallest force residual of one measured mode over all unmeasured motions, and its derivative by the parameters.

    Among all fields phi with S' phi = psi it is the force Z phi, Z = K - omega^2 M, that is smallest in the norm of
    D^-1, with D^2 = diag(K) / omega^2 + diag(M) at the start. With Q R = D Z^-1 S the residual is R^-T psi and Q' D^-1
    dZ phi its derivative (variable projection, exact gradient). It stays smooth where modes meet.

    Parameters
    ----------
    structure : Structure
    slopes : MatrixSlopes
        Derivatives of its matrices.
    physical, start : (n_params,) float arrays
        Present parameters, and those at the start, which weigh the forces.
    sensors : (n_dofs, n_channels) float array
        S: columns that read the measured entries of the shape.
    omega : float
        Measured, rad/s.
    shape : (n_channels,) float array
        psi: measured.

    Returns
    -------
    (n_channels,) and (n_channels, n_params) float arrays
        In parts of the inertia force that the field of the model at the start has with the present masses, so that a
        common scale of masses and stiffnesses changes nothing.

    References
    ----------
    Norris (1986), Eqs. (4.20) to (4.26), for a free vibration; Kaufman (1975), BIT 15, 49-57.
    """
    turn = _independent(sensors)
    sensors, shape = sensors @ turn, turn.T @ shape
    values, first = slopes.parameters.values(physical), slopes.parameters.values(start)
    stiffness, mass = (structure.matrix(matrix_kind, values).toarray() for matrix_kind in ("stiffness", "mass"))
    stiffness_0, mass_0 = (structure.matrix(matrix_kind, first).toarray() for matrix_kind in ("stiffness", "mass"))
    weight = np.sqrt(np.abs(np.diag(stiffness_0)) / omega**2 + np.abs(np.diag(mass_0)))
    orthogonal, triangle, dynamic = _weighted_flexibility_factors(stiffness, mass, sensors, weight, omega)
    error = np.linalg.solve(triangle.T, shape)
    field = np.linalg.solve(dynamic, weight * (orthogonal @ error))
    forms = slopes.products(physical, ("stiffness", "mass"), (orthogonal / weight[:, None])[None], field[None, :, None])
    change = (forms["stiffness"] - omega**2 * forms["mass"])[0, :, 0]
    q_0, r_0, z_0 = _weighted_flexibility_factors(stiffness_0, mass_0, sensors, weight, omega)
    field_0 = np.linalg.solve(z_0, weight * (q_0 @ np.linalg.solve(r_0.T, shape)))
    inertia = omega**2 * (mass @ field_0) / weight
    size = float(np.linalg.norm(inertia))
    toward = (inertia / (size * weight))[None, :, None]
    growth = omega**2 * slopes.products(physical, ("mass",), toward, field_0[None, :, None])["mass"][0, 0, 0]
    return turn @ (error / size), turn @ (change / size - np.outer(error, growth) / size**2)


def _independent(sensors: FloatArray) -> FloatArray:
    """Orthonormal combinations of sensors that see different motions, (n_channels, rank); the unit matrix at full rank.

    `sensors` are (n_dofs, n_channels).
    """
    _, singular, rows = np.linalg.svd(sensors, full_matrices=False)
    rank = int(np.sum(singular > 1e-12 * singular.max(initial=0.0)))
    return np.eye(sensors.shape[1]) if rank == sensors.shape[1] else rows[:rank].T


def _weighted_flexibility_factors(
    stiffness: FloatArray, mass: FloatArray, sensors: FloatArray, weight: FloatArray, omega: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Factors Q and R of D Z^-1 S, and the dynamic stiffness Z = K - omega^2 M.

    `weight` (n_dofs,) is the diagonal of D, `sensors` (n_dofs, n_channels) is S, and `omega` is in rad/s. `stiffness` K
    and `mass` M are (n_dofs, n_dofs), Q (n_dofs, n_channels) and R (n_channels, n_channels).
    """
    dynamic = stiffness - omega**2 * mass
    orthogonal, triangle = np.linalg.qr(weight[:, None] * np.linalg.solve(dynamic, sensors))
    return orthogonal, triangle, dynamic
