"""Modes as a least-squares problem: frequencies, damping ratios and shapes with the covariance they came with."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from structid.arrays import FloatArray, IntArray
from structid.dynamics.modes import modes
from structid.errors import InputError
from structid.estimation.linearization import Linearization
from structid.estimation.problem import Stages
from structid.modal import ModalRecord
from structid.observation.channel_errors import ChannelErrors
from structid.observation.latest import Latest
from structid.observation.modal.dynamic import dynamic_residual
from structid.observation.modal.matrix_slopes import MatrixSlopes
from structid.observation.modal.measured import FewSensorsError, MeasuredModes
from structid.observation.modal.output import GroupData, GroupFit, ModelState, by_mode, group_changes, group_fit
from structid.observation.modal.settings import ModalForm, ModalSettings
from structid.observation.record_problem import DataRows, MeasuredProblem, RecordFacts
from structid.similarity.pairing import assigned, likenesses, pairing_worth
from structid.structure import Structure
from structid.unknowns import Parameters

_START_ERROR = 0.5
#: Errors of frequencies and shapes where modes are paired by their order: shapes hardly count.
_ORDER_ERRORS = 0.02, 1.0
#: Of the largest motion of the sensors in any mode, what the sensors see of a mode that counts in the order.
_SEEN = 0.01
_SINGULAR = 1e14
#: Degrees of freedom up to which all modes of the model are found, and dense matrices made.
_DENSE_UP_TO = 600


@dataclass(frozen=True, eq=False)
class ModalProblem(MeasuredProblem):
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
        Modes at 0 Hz are left out. Shape entries that are unknown have no part in residual, scale and pairing; of close modes
        the channels count that are known in all of them. A mode without a known entry counts by its frequency (and damping
        ratio) alone, and is paired by it.
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

    def __new__(cls, *given: object, **named: object) -> Self:
        moved = [one.name for one in fields(ModalSettings) if one.name in named]
        if moved or any(isinstance(one, str) for one in given):
            example = f"{moved[0]}={named[moved[0]]!r}" if moved else 'form="dynamic"'
            raise InputError(f"how modes are fitted is said in `settings`: write settings=ModalSettings({example})")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        self.structure.require_modes("modes")
        _ = self.data, self._sensors
        if self.settings.form == "dynamic" and not self.data.has_shapes:
            raise InputError("form 'dynamic' needs a known shape entry, of one mode at least; use form 'output'")
        if self.channels is not None:
            _require_sound_channels(self.settings.form, self.channels)

    @cached_property
    def data(self) -> MeasuredModes:
        return MeasuredModes(self.record, self.settings)

    def with_errors(self, channels: ChannelErrors | None, parameters: Parameters | None = None) -> ModalProblem:
        return replace(self, channels=channels, parameters=self.parameters if parameters is None else parameters)

    @property
    def matrix_free_obstacle(self) -> str:
        return "takes records of responses, got one of modes"

    @property
    def frequency(self) -> FloatArray:
        return self.record.frequency

    def of_form(self, form: ModalForm) -> ModalProblem:
        """The same with a residual of another form."""
        return replace(self, settings=replace(self.settings, form=form))

    @property
    def facts(self) -> RecordFacts:
        return replace(
            super().facts,
            noise="the deviations of the modes",
            measures_force=False,
            leaves_damping_out=not self.settings.use_damping
            and bool((np.nan_to_num(self.record.damping_ratio) > 0).any()),
            record=self.record,
        )

    @cached_property
    def _sensors(self) -> FloatArray:
        return self.structure.selection(self.record.channels).toarray()

    @cached_property
    def slopes(self) -> MatrixSlopes:
        """Derivatives of the structure's matrices."""
        return MatrixSlopes(self.structure, self.parameters)

    @cached_property
    def rows(self) -> DataRows:
        """Of each mode: its known channels; frequencies, damping ratios and mixing have channels of their own.

        Channels without a row have no name: those that are unknown in all modes, or in one of every group.
        """
        n = len(self.record.channels)
        if self.settings.form == "dynamic":
            mode, place = np.nonzero(self.record.known.T[self.data.measured])
            forces = tuple(f"force for the shape at {self.record.channels[c]}" for c in np.unique(place))
            return DataRows(self.data.measured[mode], 2 * place, forces)
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
        return DataRows(np.concatenate(lines), np.concatenate(series), (*shapes, "mixing of close modes", *scalars))

    def stage_plans(self) -> Sequence[Stages]:
        """Ways to the answer: straight, by modes in their order, and by the dynamic residual, which needs no pairing.

        Where the straight way misses the noise, the others are tried too. Shapes pair a mode with its neighbour where the two have
        yet to cross: frequencies in their order, shapes hardly counting, lead past that, if no mode was missed. Under noise on the
        shapes the dynamic residual alone is smallest where all stiffnesses vanish, so that it may end farther off than it began.
        Its matrices are dense: a large model does without it, and so does one whose sensors may read wrongly.
        """
        near = replace(self, parameters=self.parameters.kept_near_start(_START_ERROR))
        frequency, shape = _ORDER_ERRORS
        ways: list[Stages] = [()]
        with suppress(FewSensorsError):  # errors so wide leave more modes together than the sensors tell
            errors = replace(self.settings, form="output", frequency_error=frequency, shape_error=shape)
            ordered = replace(near, settings=errors, in_order=True)
            ways.append((("modes in their order", ordered),))
        if self.data.has_shapes and self.structure.n_dofs <= _DENSE_UP_TO and self.channels is None:
            ways.append((("modal dynamic residual", near.of_form("dynamic")),))
        return ways

    def model_state(self, physical: FloatArray) -> ModelState:
        """Matrices and modes of the model, with sensors in standard deviations of no group in particular."""
        return self._latest_state.at(physical, self._state_at)

    def _state_at(self, physical: FloatArray) -> ModelState:
        own, values = physical[: self.parameters.n_params], self.property_values(physical)
        laws = ("inertia", "viscous", "elastic", "structural")
        mass, damping, stiffness, structural = (self.structure.matrix(law, values) for law in laws)
        count = None if self.structure.n_dofs <= _DENSE_UP_TO else 3 * self.record.n_modes + 10
        found = modes(mass, stiffness, n_modes=count)
        gains, change = self.readings(physical)
        sensors = self._sensors * gains
        return ModelState(mass, damping, stiffness, structural, found, sensors, self.slopes, own, change)

    def readings(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What sensors read over the truth, (n_channels,), and its logarithm's slope, (n_channels, n_errors)."""
        if self.channels is None:
            return np.ones(self._sensors.shape[1]), np.zeros((self._sensors.shape[1], 0))
        errors, still = physical[self.parameters.n_params :], np.zeros(1, dtype=np.complex128)
        return self.channels.readings(errors, still)[0][0].real, self.channels.output_slopes(errors, still)[0].real

    def pairing(self, state: ModelState) -> IntArray:
        """The model's mode for each measured one: by MAC, with a guard on the frequency, each used once; or by their order.

        The sum of `pairing_worth` is made as large as it can be. Modes without a known shape entry are paired by frequency
        alone, also with modes that no sensor sees.
        """
        frequency, found, shapes = self.data.frequency, state.modes, self.data.shapes[:, self.data.measured]
        seen = state.sensors.T @ found.mode_shapes
        motion = np.abs(seen).max(axis=0, initial=0.0)
        counts = (motion > 0) | np.isnan(shapes).all(axis=0).any()
        use = np.flatnonzero((found.frequency > 1e-3 * frequency.min()) & counts)
        if len(use) < len(self.data.measured):
            raise InputError(
                f"the model has {len(use)} modes that move the sensors and {len(self.data.measured)} are measured;"
                " refine the model, or leave modes out"
            )
        if self.in_order:
            clear = use[motion[use] > _SEEN * motion[use].max(initial=0.0)]
            return (clear if len(clear) >= len(self.data.measured) else use)[np.argsort(np.argsort(frequency))]
        likeness = likenesses(shapes, seen[:, use], motion[use] > 0)
        worth = pairing_worth(likeness, frequency, found.frequency[use], self.settings.frequency_guard)
        return use[assigned(worth)[1]]

    def residual(self, theta: FloatArray) -> FloatArray:
        known = self.linearize(theta) if self.settings.form == "dynamic" else self._latest.known(theta)
        if known is not None:
            return known.residual
        data, _, eliminated = self._output(self.physical(theta), with_slopes=False)
        none = np.zeros((len(data), len(theta)))
        return self._linearized(theta, data, none, eliminated).residual

    def shape_residual(self, theta: FloatArray) -> FloatArray:
        """The rows of shape values in the residual of form ``output``, in standard deviations."""
        of = self if self.settings.form == "output" else self.of_form("output")
        return of.residual(theta)[: of.n_data][of.series < 2 * len(self.record.channels)]

    @cached_property
    def row_kinds(self) -> NDArray[np.str_]:
        """What kind of value each data row is of, (n_data,): frequencies, damping ratios, shapes."""
        return np.array([_kind_of(name) for name in self.rows.names])[np.unique(self.series, return_inverse=True)[1]]

    def pull(self, theta: FloatArray) -> dict[str, tuple[int, float, float]]:
        """Of each kind of value: how many, how many parameters they determine, and their part of the misfit.

        Parameters determined are the trace of (J'J)^-1 J_k'J_k, J_k being the rows of the kind: kinds and priors together
        give the number of parameters. Empty where the data do not determine all.
        """
        at = self.linearize(theta)
        information = at.jacobian.T @ at.jacobian
        scale = np.sqrt(np.diag(information))
        if not (scale > 0).all() or np.linalg.cond(information / np.outer(scale, scale)) > _SINGULAR:
            return {}
        covariance = np.linalg.inv(information)
        kinds = self.row_kinds
        whole = float(at.residual[: self.n_data] @ at.residual[: self.n_data])
        found = {}
        filled = (at.residual[: self.n_data] != 0) | (at.jacobian[: self.n_data] != 0).any(axis=1)
        for kind in dict.fromkeys(kinds[filled].tolist()):
            rows = np.flatnonzero((kinds == kind) & filled)
            own, part = at.jacobian[rows], at.residual[rows]
            trace = float(np.einsum("ij,jk,ik->", own, covariance, own))
            found[kind] = (len(rows), trace, float(part @ part) / whole if whole else 0.0)
        return found

    @cached_property
    def _latest(self) -> Latest[Linearization]:
        return Latest()

    @cached_property
    def _latest_state(self) -> Latest[ModelState]:
        return Latest()

    def linearize(self, theta: FloatArray) -> Linearization:
        return self._latest.at(theta, self._found)

    def _found(self, theta: FloatArray) -> Linearization:
        physical = self.physical(theta)
        if self.settings.form == "dynamic":
            data, change, eliminated = *self._dynamic(physical), 0
        else:
            data, change, eliminated = self._output(physical)
        return self._linearized(theta, data, change * self.slope(theta), eliminated)

    def _dynamic(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Force residual of each mode with a shape in parts of its inertia force, over the error of the shapes."""
        shown = self.record.known[:, self.data.measured].any(axis=0)
        found = [
            dynamic_residual(
                self.structure,
                self.slopes,
                physical,
                self.parameters.start,
                self._sensors[:, self.record.known[:, mode]],
                2 * np.pi * self.record.frequency[mode],
                self.data.shapes[self.record.known[:, mode], mode],
            )
            for mode in self.data.measured[shown]
        ]
        size = np.maximum(2 * self.data.frequency_std / self.data.frequency, 1e-3)[shown]
        data = np.concatenate([e / s for (e, _), s in zip(found, size, strict=True)])
        return data, np.concatenate([d / s for (_, d), s in zip(found, size, strict=True)])

    def _groups_at(self, physical: FloatArray) -> list[tuple[ModelState, GroupData, IntArray]]:
        """Each group with the model, its sensors in the group's standard deviations, and the model's modes for it."""
        state = self.model_state(physical)
        pairs = dict(zip(self.data.measured.tolist(), self.pairing(state).tolist(), strict=True))
        found = []
        for group in self.data.groups:
            own = group.channels
            seen = replace(state, sensors=state.sensors[:, own] / group.shape_std, readings=state.readings[own])
            found.append((seen, group, np.array([pairs[r] for r in group.members.tolist()])))
        return found

    def _output(self, physical: FloatArray, with_slopes: bool = True) -> tuple[FloatArray, FloatArray, int]:
        """Data rows of form ``output``, their slopes by physical values, and how many rows stand for what is eliminated."""
        fits: list[GroupFit] = []
        rows: list[FloatArray] = []
        slopes: list[FloatArray] = []
        eliminated = 0
        n_params = self.unknowns.n_params if with_slopes else 0
        for state, group, chosen in self._groups_at(physical):
            fit = group_fit(state, group, chosen, with_slopes)
            rows += [fit.shape_residual.ravel(), fit.mixing.ravel()]
            slopes += [fit.shape_slope.reshape(fit.shape_residual.size, n_params)]
            slopes += [fit.mixing_slope.reshape(fit.mixing.size, n_params)]
            n_mixing = len(chosen) ** 2 if len(group.channels) else 0
            eliminated += n_mixing + len(chosen)  # A, and the mixing's empty diagonal
            fits.append(fit)
        groups = self.data.groups
        frequency = by_mode(groups, [fit.frequency for fit in fits]) - self.data.frequency
        damping = by_mode(groups, [fit.damping for fit in fits]) - self.record.damping_ratio[self.data.measured]
        scalar = self.data.whitened(frequency[:, None], damping[:, None])[:, 0]
        change = (
            by_mode(groups, [fit.frequency_slope for fit in fits]),
            by_mode(groups, [fit.damping_slope for fit in fits]),
        )
        unused = int((~self.data.is_alone).sum()) if self.settings.use_damping else 0
        jacobian = np.concatenate([*slopes, self.data.whitened(*change)])
        return np.concatenate([*rows, scalar]), jacobian, eliminated + unused

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        """Changes of the data rows whose products sum to their covariance, (n_changes, n_data).

        None where the record does not say how its numbers vary together; the rows then count as independent.
        """
        changes = self.data.changes
        if self.settings.form == "dynamic" or changes is None:
            return None
        frequency, ratio, shapes = changes
        rows, model = [], []
        for state, group, chosen in self._groups_at(self.physical(theta)):
            own = np.moveaxis(shapes[:, group.channels][:, :, group.members], 0, -1)
            moved = own / group.shape_std[:, None, None]
            d_frequency, d_shape, d_mixing = group_changes(state, group, chosen, moved)
            rows += [d_shape.reshape(-1, len(shapes)), d_mixing.reshape(-1, len(shapes))]
            model.append(d_frequency)
        rows.append(self.data.whitened(by_mode(self.data.groups, model) - frequency.T, -ratio.T))
        return np.concatenate(rows).T


def _kind_of(row: str) -> str:
    """What kind of value the data rows of this name are."""
    first = row.partition(" ")[0]
    return {"shape": "shapes", "mixing": row, "frequency": "frequencies", "force": "forces"}.get(
        first, "damping ratios"
    )


def _require_sound_channels(form: ModalForm, channels: ChannelErrors) -> None:
    if form == "dynamic":
        raise InputError("form 'dynamic' takes no errors of channels; use form 'output'")
    if set(channels.kinds) != {"gain"} or channels.polarity_names:
        raise InputError(
            "of errors of channels, modes show gains of sensors only; leave others out, and turn a sensor round by `relabel`"
        )
