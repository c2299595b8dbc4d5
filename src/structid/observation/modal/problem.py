"""Modes as a least-squares problem: frequencies, damping ratios and shapes with the covariance they came with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, cast

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.dynamics import Modes
from structid.dynamics.modes import modes
from structid.errors import InputError
from structid.estimation.linearization import Linearization
from structid.estimation.problem import Stages
from structid.modal import ModalRecord
from structid.modal.shape_errors import unscaled_shape_std
from structid.modal.subspace.close_modes import NOT_TOLD_APART, neighbour_std
from structid.observation.modal.dynamic import dynamic_residual
from structid.observation.modal.matrix_slopes import MatrixSlopes, matrix_slopes
from structid.observation.modal.output import GroupData, GroupFit, ModelState, group_changes, group_fit
from structid.observation.record_problem import DataRows, RecordProblem
from structid.similarity import mac
from structid.structure import Structure
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import NamedUnknowns

ModalForm = Literal["output", "dynamic"]

_START_ERROR = 0.5


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
        Modes at 0 Hz are left out.
    frequency_error, damping_error : float
        Standard deviation of each frequency and damping ratio as a part of its value, where the record has no
        covariance; added to it in quadrature where it has.
    shape_error : float
        Standard deviation of every shape entry in parts of the largest, where the record has none; added likewise.
    use_damping : bool
        Whether damping ratios count; those of modes in groups never do.
    closeness : float
        Relative distance of measured frequencies below which modes form a group; those that their standard deviations
        do not tell apart form one in any case.
    form : ModalForm
    frequency_guard : float
        A model mode is worth half as much to the pairing at this logarithmic distance in frequency.

    Raises
    ------
    InputError
        If the record has no mode above 0 Hz, no shapes, or no uncertainty and none is given; or if sensors are not
        part of the structure.

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
    frequency_error: float = 0.0
    damping_error: float = 0.0
    shape_error: float = 0.0
    use_damping: bool = False
    closeness: float = 0.02
    form: ModalForm = "output"
    frequency_guard: float = 0.3

    def __post_init__(self) -> None:
        if not self.measured.size:
            raise InputError("the record has no mode above 0 Hz; there is nothing to fit")
        if not self.record.channels:
            raise InputError("the record has no channels; mode shapes are needed to pair modes, at one sensor at least")
        if not (self.frequency_std > 0).all():
            raise InputError("the record has no uncertainty of its frequencies; give `frequency_error`, such as 0.005")
        if not (self.shape_std > 0).all():
            raise InputError("the record has no uncertainty of its shapes; give `shape_error`, such as 0.02")
        if self.use_damping and not (self.damping_std > 0).all():
            raise InputError("damping ratios need a value and a standard deviation each; give `damping_error`")
        short = [g for g in self.groups if len(g.members) > len(self.record.channels)]
        if short:
            raise InputError(
                f"{len(short[0].members)} modes lie within {self.closeness:g} of each other and there are"
                f" {len(self.record.channels)} sensors; lower `closeness`, or measure more places"
            )
        _ = self._sensors

    def with_parts(self, parts: Sequence[NamedUnknowns]) -> ModalProblem:
        return replace(self, parameters=cast(Parameters, parts[0]))

    @property
    def matrix_free_obstacle(self) -> str:
        return "takes records of responses, got one of modes"

    @property
    def sources(self) -> tuple[object, ...]:
        return self.structure, self.record

    @property
    def frequency(self) -> FloatArray:
        return self.record.frequency

    @property
    def measures_force(self) -> bool:
        return False

    @cached_property
    def measured(self) -> IntArray:
        """Numbers of the modes that count."""
        return np.flatnonzero(self.record.frequency > 0)

    @cached_property
    def shapes(self) -> FloatArray:
        """Measured shapes turned to be as real as can be, largest entry of size 1, (n_channels, n_modes)."""
        given = np.asarray(self.record.mode_shapes)
        turn = np.exp(-0.5j * np.angle((given**2).sum(axis=0)))
        real = (given * turn).real if np.iscomplexobj(given) else given
        return real / np.abs(real).max(axis=0)

    @cached_property
    def shape_std(self) -> FloatArray:
        """Of every entry of `shapes`, whose scale is free; see `unscaled_shape_std`."""
        own = self.record.shape_std
        if len(self.record.channels) == 1 and not (own is not None and own.all()):
            return np.full(self.shapes.shape, self.shape_error or 1.0)  # one entry always fits
        if own is None:
            return np.full(self.shapes.shape, self.shape_error)
        scale = np.abs(np.asarray(self.record.mode_shapes)).max(axis=0)
        freed = unscaled_shape_std(self.shapes, own / scale)
        if self.record.changes is not None:
            freed = np.broadcast_to(np.sqrt(np.mean(freed**2, axis=0)), freed.shape)
        return np.hypot(freed, self.shape_error)

    @cached_property
    def frequency_std(self) -> FloatArray:
        """Hz, of the modes that count."""
        return np.sqrt(np.diag(self._covariance)[: len(self.measured)])

    @cached_property
    def damping_std(self) -> FloatArray:
        """Of the modes that count."""
        return np.sqrt(np.diag(self._covariance)[len(self.measured) :])

    @cached_property
    def _covariance(self) -> FloatArray:
        """Of the frequencies (Hz), then of the damping ratios, of the modes that count."""
        count, rows = self.record.n_modes, self.measured
        rows = np.concatenate([rows, rows + count])
        own = np.zeros((2 * count,) * 2) if self.record.covariance is None else self.record.covariance
        damping = np.nan_to_num(self.record.damping_ratio[self.measured])
        extra = np.concatenate(
            [self.frequency_error * self.record.frequency[self.measured], self.damping_error * damping]
        )
        if self.record.changes is not None:
            own = np.diag(np.diag(own))
        return np.nan_to_num(own[np.ix_(rows, rows)]) + np.diag(extra**2)

    @cached_property
    def groups(self) -> tuple[GroupData, ...]:
        """Measured modes, those that are close together."""
        frequency = self.record.frequency[self.measured]
        variance = self._covariance[: len(frequency), : len(frequency)]
        reach = np.maximum(self.closeness * frequency[1:], NOT_TOLD_APART * neighbour_std(variance))
        breaks = np.flatnonzero(np.diff(frequency) > reach) + 1
        made = []
        for places in np.split(np.arange(len(frequency)), breaks):
            members = self.measured[places]
            std = np.sqrt((self.shape_std[:, members] ** 2).mean(axis=1))
            shapes = self.shapes[:, members] / std[:, None]
            value = (2 * np.pi * frequency[places]) ** 2
            error = (np.linalg.pinv(shapes) ** 2).sum(axis=1) if len(members) <= len(shapes) else np.ones(len(members))
            gap = np.subtract.outer(value, value) / np.sqrt(np.outer(value, value))
            spread = 2 * self.frequency_std[places] / frequency[places]
            mixing = np.sqrt(gap**2 * error[:, None] + np.add.outer(spread**2, spread**2) / 2)
            made.append(GroupData(members, value, shapes, mixing))
        return tuple(made)

    @cached_property
    def _sensors(self) -> FloatArray:
        return self.structure.selection(self.record.channels).toarray()

    @cached_property
    def slopes(self) -> MatrixSlopes:
        """Derivatives of the structure's matrices."""
        return matrix_slopes(self.structure, self.parameters)

    @cached_property
    def rows(self) -> DataRows:
        """Of each mode: channels; frequencies, damping ratios and mixing have channels of their own."""
        n = len(self.record.channels)
        channel, names = 2 * np.arange(n), [f"shape at {dof}" for dof in self.record.channels]
        if self.form == "dynamic":
            forces = tuple(f"force for the {name}" for name in names)
            return DataRows(np.repeat(self.measured, n), np.tile(channel, len(self.measured)), forces)
        lines, series = [], []
        for group in self.groups:
            m = len(group.members)
            lines += [np.tile(group.members, n), np.repeat(group.members, m)]
            series += [np.repeat(channel, m), np.full(m * m, 2 * n)]
        scalars = ("frequency", "damping ratio") if self.use_damping else ("frequency",)
        lines.append(np.tile(self.measured, len(scalars)))
        series.append(np.repeat(2 * n + 2 * np.arange(1, len(scalars) + 1), len(self.measured)))
        return DataRows(np.concatenate(lines), np.concatenate(series), (*names, "mixing of close modes", *scalars))

    def stage_plans(self) -> Sequence[Stages]:
        """Ways to the answer: by the dynamic residual, which needs no pairing, and straight."""
        near = replace(self, form="dynamic", parameters=self.parameters.kept_near_start(_START_ERROR))
        return ((("modal dynamic residual", near),), ())

    def model_state(self, physical: FloatArray) -> ModelState:
        """Matrices and modes of the model, with sensors in standard deviations of no group in particular."""
        values = self.parameters.values(physical)
        laws = ("inertia", "viscous", "elastic", "structural")
        mass, damping, stiffness, structural = (self.structure.matrix(law, values) for law in laws)
        count = None if self.structure.n_dofs <= 600 else 3 * self.record.n_modes + 10
        found = modes(mass, stiffness, n_modes=count)
        return ModelState(mass, damping, stiffness, structural, found, self._sensors, self.slopes, physical)

    def pairing(self, found: Modes) -> IntArray:
        """The model's mode for each measured one: by MAC, with a guard on the frequency, each used once.

        The sum of MAC / (1 + (log(f_model / f) / frequency_guard)^2) is made as large as it can be.
        """
        from scipy.optimize import linear_sum_assignment

        frequency = self.record.frequency[self.measured]
        seen = self._sensors.T @ found.mode_shapes
        use = np.flatnonzero((found.frequency > 1e-3 * frequency.min()) & (np.abs(seen).max(axis=0) > 0))
        if len(use) < len(self.measured):
            raise InputError(
                f"the model has {len(use)} modes that move the sensors and {len(self.measured)} are measured;"
                " refine the model, or leave modes out"
            )
        distance = np.log(found.frequency[use][None, :] / frequency[:, None]) / self.frequency_guard
        worth = mac(self.shapes[:, self.measured], seen[:, use]) / (1 + distance**2)
        return use[linear_sum_assignment(worth, maximize=True)[1]]

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.linearize(theta).residual

    def linearize(self, theta: FloatArray) -> Linearization:
        physical = self.physical(theta)
        if self.form == "dynamic":
            data, change, eliminated = *self._dynamic(physical), 0
        else:
            data, change, eliminated = self._output(physical)
        return self._linearized(theta, data, change * self.slope(theta), eliminated)

    def _dynamic(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Force residual of each mode in parts of its inertia force, over the error of the shapes."""
        found = [
            dynamic_residual(
                self.structure,
                self.slopes,
                physical,
                self.parameters.start,
                self._sensors,
                2 * np.pi * self.record.frequency[mode],
                self.shapes[:, mode],
            )
            for mode in self.measured
        ]
        size = np.array([max(2 * std / f, 1e-3) for std, f in self._relative()])
        data = np.concatenate([e / s for (e, _), s in zip(found, size, strict=True)])
        return data, np.concatenate([d / s for (_, d), s in zip(found, size, strict=True)])

    def _relative(self) -> list[tuple[float, float]]:
        return list(zip(self.frequency_std.tolist(), self.record.frequency[self.measured].tolist(), strict=True))

    def _groups_at(self, physical: FloatArray) -> list[tuple[ModelState, GroupData, IntArray]]:
        """Each group with the model, its sensors in the group's standard deviations, and the model's modes for it."""
        state = self.model_state(physical)
        pairs = dict(zip(self.measured.tolist(), self.pairing(state.modes).tolist(), strict=True))
        found = []
        for group in self.groups:
            sensors = self._sensors / self._group_std(group)
            chosen = np.array([pairs[r] for r in group.members.tolist()])
            found.append((replace(state, sensors=sensors), group, chosen))
        return found

    def _group_std(self, group: GroupData) -> FloatArray:
        """Of each channel, (n_channels,)."""
        return np.asarray(np.sqrt((self.shape_std[:, group.members] ** 2).mean(axis=1)))

    def _output(self, physical: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        fits: list[GroupFit] = []
        rows: list[FloatArray] = []
        slopes: list[FloatArray] = []
        eliminated = 0
        n_params = self.parameters.n_params
        for state, group, chosen in self._groups_at(physical):
            fit = group_fit(state, group, chosen)
            rows += [fit.shape_residual.ravel(), fit.mixing.ravel()]
            slopes += [fit.shape_slope.reshape(-1, n_params), fit.mixing_slope.reshape(-1, n_params)]
            eliminated += len(chosen) * (len(chosen) + 1)  # A, and the empty diagonal of the mixing
            fits.append(fit)
        scalar, change, unused = self._scalars(fits)
        return np.concatenate([*rows, scalar]), np.concatenate([*slopes, change]), eliminated + unused

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        """Changes of the data rows whose products sum to their covariance, (n_changes, n_data).

        None where the record does not say how its numbers vary together; the rows then count as independent.
        """
        own = self.record.changes
        if self.form == "dynamic" or own is None:
            return None
        given = np.asarray(self.record.mode_shapes)
        turn = np.exp(-0.5j * np.angle((given**2).sum(axis=0)))
        shapes = (own.mode_shapes * turn).real / np.abs((given * turn).real).max(axis=0)
        frequency, ratio = own.frequency[:, self.measured], own.damping_ratio[:, self.measured]
        n_all, n = shapes.shape[1:], len(self.measured)
        if self.frequency_error or self.damping_error or self.shape_error:  # errors stated beside the record's own
            more = np.eye(n_all[0] * n_all[1]) * self.shape_error
            still = np.zeros((len(more), n))
            shapes = np.concatenate([shapes, more.reshape(-1, *n_all), np.zeros((2 * n, *n_all))])
            stated = np.diag(self.frequency_error * self.record.frequency[self.measured]), np.zeros((n, n))
            frequency = np.concatenate([frequency, still, *stated])
            stated = (
                np.zeros((n, n)),
                np.diag(self.damping_error * np.nan_to_num(self.record.damping_ratio[self.measured])),
            )
            ratio = np.concatenate([ratio, still, *stated])
        rows, model = [], []
        for state, group, chosen in self._groups_at(self.physical(theta)):
            moved = np.moveaxis(shapes[:, :, group.members], 0, -1) / self._group_std(group)[:, None, None]
            d_frequency, d_shape, d_mixing = group_changes(state, group, chosen, moved)
            rows += [d_shape.reshape(-1, len(shapes)), d_mixing.reshape(-1, len(shapes))]
            model.append(d_frequency)
        scalar = self._scalar_changes(np.concatenate(model).T - frequency, ratio)
        return np.concatenate([np.concatenate(rows).T, scalar], axis=1)

    def _scalar_changes(self, frequency: FloatArray, ratio: FloatArray) -> FloatArray:
        """Rows of `_scalars` for changes of the frequencies' residual and of the measured damping ratios."""
        n = len(self.measured)
        if not self.use_damping:
            return np.linalg.solve(np.linalg.cholesky(self._covariance[:n, :n]), frequency.T).T
        single = np.concatenate([np.full(len(g.members), len(g.members) == 1) for g in self.groups])
        keep = np.concatenate([np.ones(n, bool), single])
        rows = np.zeros((len(frequency), 2 * n))
        both = np.concatenate([frequency, -ratio], axis=1)[:, keep]
        rows[:, keep] = np.linalg.solve(np.linalg.cholesky(self._covariance[np.ix_(keep, keep)]), both.T).T
        return rows

    def _scalars(self, fits: list[GroupFit]) -> tuple[FloatArray, FloatArray, int]:
        """Frequencies and damping ratios, whitened together, and how many of the rows are empty."""
        frequency = np.concatenate([fit.frequency for fit in fits])
        change = np.concatenate([fit.frequency_slope for fit in fits])
        difference = frequency - self.record.frequency[self.measured]
        count = len(difference)
        if not self.use_damping:
            factor = np.linalg.cholesky(self._covariance[:count, :count])
            return np.linalg.solve(factor, difference), np.linalg.solve(factor, change), 0
        ratio = np.concatenate([fit.damping for fit in fits]) - self.record.damping_ratio[self.measured]
        ratio_change = np.concatenate([fit.damping_slope for fit in fits])
        single = np.isfinite(ratio)
        keep = np.concatenate([np.ones(count, bool), single])
        factor = np.linalg.cholesky(self._covariance[np.ix_(keep, keep)])
        data = np.zeros(2 * count)
        slope = np.zeros((2 * count, change.shape[1]))
        data[keep] = np.linalg.solve(factor, np.concatenate([difference, ratio])[keep])
        slope[keep] = np.linalg.solve(factor, np.concatenate([change, ratio_change])[keep])
        return data, slope, int((~single).sum())
