"""Measured modes with the errors they are fitted to: which count, which are too close to tell apart, how they vary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray
from structid.core.constraints import NotNegative, Positive
from structid.core.display import plural
from structid.core.errors import InputError
from structid.modal import ModalRecord
from structid.modal.close_modes import NOT_TOLD_APART, neighbour_std
from structid.modal.modal_record import largest_entries, unscaled_shape_std
from structid.similarity import most_real, real_turn

Entry = TypeVar("Entry", bound=np.generic)
ModalForm = Literal["output", "dynamic"]
ShapeForm = Literal["entries", "mac"]
#: Least singular value of shapes of norm 1 that are not the same.
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class ModalSettings:
    """Quantities of measured modes that count in a fit, and their errors; see `ModalProblem` for forms of the residual.

    Parameters
    ----------
    form : ModalForm
        Of the residual: ``output``, by paired modes; ``dynamic``, which needs no pairing, for poor starts.
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
    frequency_guard : float
        A model mode is worth half as much to the pairing at this logarithmic distance in frequency.
    shape_form : ShapeForm
        How shapes count: ``entries``, by the standard deviation of each; ``mac``, as (1 - MAC) / ``shape_error**2`` of
        each mode, for comparison with work that minimizes such sums. MACs have no noise model: intervals are those of
        the weight.
    """

    form: ModalForm = "output"
    frequency_error: NotNegative = 0.0
    damping_error: NotNegative = 0.0
    shape_error: NotNegative = 0.0
    use_damping: bool = False
    closeness: NotNegative = 0.02
    frequency_guard: Positive = 0.3
    shape_form: ShapeForm = "entries"


class FewSensorsError(InputError):
    """There are more close modes than sensors that distinguish their shapes."""


@dataclass(frozen=True, eq=False)
class GroupData:
    """Measured modes that are close to each other, or one that stands alone.

    Attributes
    ----------
    members : (m,) int array
        Numbers of the modes in the record, from 0.
    channels : (n_own,) int array
        Indices of the channels that count, those known in all modes of the group; empty for a mode without a
        known shape entry.
    eigenvalues : (m,) float array
        Measured omega^2, (rad/s)^2.
    shapes : (n_own, m) float array
        Shape entries over the standard deviation of each channel.
    shape_std : (n_own,) float array
        Standard deviation of each channel.
    mixing_std : (m, m) float array
        Standard deviation of the off-diagonal entries of A^-1 Lambda A in parts of sqrt(lambda_r lambda_s): an error
        of a shape turns it towards the others, which shows as that part of their distance in eigenvalue; and never
        less than the eigenvalues' own errors, since what blurs those turns close shapes as well.
    """

    members: IntArray
    channels: IntArray
    eigenvalues: FloatArray
    shapes: FloatArray
    shape_std: FloatArray
    mixing_std: FloatArray


def by_mode(groups: Sequence[GroupData], parts: Sequence[NDArray[Entry]]) -> NDArray[Entry]:
    """Values of the members of each group, in `parts` (m, ...), joined in the order of the modes, (n_measured, ...)."""
    return np.concatenate(parts)[np.argsort(np.concatenate([group.members for group in groups]))]


@dataclass(frozen=True, eq=False)
class MeasuredModes:
    """A record of modes with errors stated beside its own; see `ModalSettings`."""

    record: ModalRecord
    settings: ModalSettings

    def __post_init__(self) -> None:
        _require_sound(self)

    @property
    def has_shapes(self) -> bool:
        """True where any entry of a shape is known; without, modes are paired by frequency alone."""
        return bool(self.record.known[:, self.measured].any())

    @cached_property
    def measured(self) -> IntArray:
        """Numbers of the modes that count."""
        return np.flatnonzero(self.record.frequency > 0)

    @cached_property
    def frequency(self) -> FloatArray:
        """Hz, of the modes that count."""
        return self.record.frequency[self.measured]

    @cached_property
    def shapes(self) -> FloatArray:
        """Measured shapes turned as real as can be, largest entry of size 1, (n_channels, n_modes); NaN: unknown."""
        real = most_real(self.record.mode_shapes)
        return real / largest_entries(real, empty=1.0)

    @cached_property
    def shape_std(self) -> FloatArray:
        """Standard deviation of every entry of `shapes` (largest of size 1), (n_channels, n_modes), of free scale.

        Recorded ones (with joint variations, their rms over a mode) and `shape_error` add in quadrature; 1 instead of 0
        or NaN in a mode with one known entry. In the form ``mac`` it is `shape_error` times the norm of the shape.
        """
        if self.settings.shape_form == "mac":
            size = np.sqrt(np.nansum(self.shapes**2, axis=0))
            return np.broadcast_to(self.settings.shape_error * size, self.shapes.shape)
        recorded = self.record.shape_std
        freed: FloatArray = np.zeros(self.shapes.shape)
        if recorded is not None:
            freed = unscaled_shape_std(self.shapes, recorded / largest_entries(self.record.mode_shapes, empty=1.0))
        if self.record.changes is not None:
            count = np.maximum(self.record.known.sum(axis=0), 1)
            freed = np.broadcast_to(
                np.sqrt(np.sum(np.where(self.record.known, freed, 0.0) ** 2, axis=0) / count), freed.shape
            )
        std = np.hypot(np.nan_to_num(freed) if self.settings.shape_error else freed, self.settings.shape_error)
        fits = self.record.known.sum(axis=0) == 1  # one entry always does
        return np.where(fits & ~(std > 0), 1.0, std)

    @cached_property
    def frequency_std(self) -> FloatArray:
        """Hz, of the modes that count."""
        return np.sqrt(np.diag(self.covariance)[: len(self.measured)])

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of frequencies (Hz) and then damping ratios of the modes that count, (2 n_measured, 2 n_measured).

        That of the record, only its diagonal if the record gives joint variations of its values, plus the squares of
        the errors that the settings state on the diagonal; unknown entries count as 0.
        """
        count, rows = self.record.n_modes, self.measured
        rows = np.concatenate([rows, rows + count])
        recorded = np.zeros((2 * count,) * 2) if self.record.covariance is None else self.record.covariance
        if self.record.changes is not None:
            recorded = np.diag(np.diag(recorded))
        return np.nan_to_num(recorded[np.ix_(rows, rows)]) + np.diag(np.concatenate(_stated(self)) ** 2)

    @cached_property
    def groups(self) -> tuple[GroupData, ...]:
        """Measured modes in groups of close frequencies, lowest first; a mode that stands alone is a group too.

        Neighbours are close if they differ by at most `closeness` times the higher frequency, or by 1.96 standard
        deviations of their difference. A mode without a known shape entry stands alone, and takes no part in the
        grouping of modes with shapes. A `GroupData` has the indices of its modes in the record, the channels at which
        the shapes of all of them are known, eigenvalues (rad/s)^2, shapes over their standard deviations, and the
        deviations of shapes and of mixing.
        """
        frequency, has_shape = self.frequency, self.record.known[:, self.measured].any(axis=0)
        shown = np.flatnonzero(has_shape)
        variance = self.covariance[np.ix_(shown, shown)]
        reach = np.maximum(self.settings.closeness * frequency[shown[1:]], NOT_TOLD_APART * neighbour_std(variance))
        breaks = np.flatnonzero(np.diff(frequency[shown]) > reach) + 1
        parts = [*np.split(shown, breaks), *np.flatnonzero(~has_shape)[:, None]]
        made = []
        for places in sorted((part for part in parts if part.size), key=lambda part: int(part[0])):
            members = self.measured[places]
            channels = np.flatnonzero(self.record.known[:, members].all(axis=1))
            std = np.sqrt((self.shape_std[np.ix_(channels, members)] ** 2).mean(axis=1))
            shapes = self.shapes[np.ix_(channels, members)] / std[:, None]
            value = (2 * np.pi * frequency[places]) ** 2
            enough = len(members) <= len(shapes)
            error = (np.linalg.pinv(shapes) ** 2).sum(axis=1) if enough else np.ones(len(members))
            gap = np.subtract.outer(value, value) / np.sqrt(np.outer(value, value))
            spread = 2 * self.frequency_std[places] / frequency[places]
            mixing = np.sqrt(gap**2 * error[:, None] + np.add.outer(spread**2, spread**2) / 2)
            made.append(GroupData(members, channels, value, shapes, std, mixing))
        return tuple(made)

    @cached_property
    def is_alone(self) -> NDArray[np.bool_]:
        """True for each mode that is a group of its own, among those that count, (n_measured,)."""
        return by_mode(self.groups, [np.full(len(group.members), len(group.members) == 1) for group in self.groups])

    def whitened(self, frequency: FloatArray, damping: FloatArray) -> FloatArray:
        """Rows of `frequency` (Hz) and `damping` (ratios), (n_measured, n) each, whitened by their covariance.

        Multiplied by the inverse Cholesky factor, n columns at once. The result is (n_measured, n) if damping ratios
        are not used, else (2 n_measured, n), where damping rows of modes in groups are 0.
        """
        count = len(self.measured)
        if not self.settings.use_damping:
            return np.asarray(np.linalg.solve(np.linalg.cholesky(self.covariance[:count, :count]), frequency))
        keep = np.concatenate([np.ones(count, bool), self.is_alone])
        rows = np.zeros((2 * count, frequency.shape[1]))
        factor = np.linalg.cholesky(self.covariance[np.ix_(keep, keep)])
        rows[keep] = np.linalg.solve(factor, np.concatenate([frequency, damping])[keep])
        return rows

    @cached_property
    def changes(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Joint variations of frequencies (Hz), damping ratios and shapes, whose products sum to the covariance.

        Shapes (n_changes, n_measured) twice and (n_changes, n_channels, n_modes). Errors that the settings state are
        added as further independent variations. None if the record has no variations, or in the form ``mac``. Values of
        unknown entries mean nothing.
        """
        recorded = self.record.changes
        if recorded is None or self.settings.shape_form == "mac":
            return None
        mode_shapes = np.asarray(self.record.mode_shapes)
        turn = real_turn(mode_shapes)
        shapes = (recorded.mode_shapes * turn).real / largest_entries((mode_shapes * turn).real, empty=1.0)
        frequency, ratio = recorded.frequency[:, self.measured], recorded.damping_ratio[:, self.measured]
        n_all, n = shapes.shape[1:], len(self.measured)
        if self.settings.frequency_error or self.settings.damping_error or self.settings.shape_error:
            more = np.eye(n_all[0] * n_all[1]) * self.settings.shape_error
            still, none = np.zeros((len(more), n)), np.zeros((n, n))
            shapes = np.concatenate([shapes, more.reshape(-1, *n_all), np.zeros((2 * n, *n_all))])
            frequency = np.concatenate([frequency, still, np.diag(_stated(self)[0]), none])
            ratio = np.concatenate([ratio, still, none, np.diag(_stated(self)[1])])
        return frequency, ratio, shapes


def _stated(modes: MeasuredModes) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of frequencies (Hz) and of damping ratios, (n_measured,) each, that the settings add."""
    damping = np.nan_to_num(modes.record.damping_ratio[modes.measured])
    return modes.settings.frequency_error * modes.frequency, modes.settings.damping_error * damping


def _require_sound(modes: MeasuredModes) -> None:
    """Raise `InputError` if the measured modes cannot be fitted.

    The reasons are: no mode above 0 Hz; no standard deviation of a frequency, shape or used damping ratio; form ``mac``
    without shapes or `shape_error`; a group with more close modes than sensors (`FewSensorsError`) or with dependent
    shapes.
    """
    if not modes.measured.size:
        raise InputError("the record has no mode above 0 Hz; there is nothing to fit")
    if modes.settings.shape_form == "mac" and not (modes.has_shapes and modes.settings.shape_error > 0):
        raise InputError(
            "MACs are of shapes, and weighed by `shape_error`, the standard deviation of sqrt(1 - MAC); give both, as in 0.05"
        )
    _require_errors(modes, "its frequencies", modes.frequency_std, "frequency", " in Hz", "such as 0.005")
    if modes.has_shapes:
        least = np.where(modes.record.known, modes.shape_std, np.inf)[:, modes.measured].min(axis=0)
        _require_errors(modes, "its shapes", least, "shape", "", "such as 0.02")
    if modes.settings.use_damping:
        if not (np.nan_to_num(modes.record.damping_ratio[modes.measured]) > 0).any():
            raise InputError("damping ratios need a value and a standard deviation each; the record has none")
        std = np.sqrt(np.diag(modes.covariance)[len(modes.measured) :])
        _require_errors(modes, "its damping ratios", std, "damping", "", "such as 0.1, and values")
    for group in modes.groups:
        _require_told_apart(modes, group)
    for group in modes.groups:
        _require_independent(modes, group)


def _require_errors(modes: MeasuredModes, what: str, std: FloatArray, key: str, unit: str, usual: str) -> None:
    """Raise `InputError` unless every standard deviation `std` (n_measured,) is greater than 0; it names the modes.

    `what`, `key`, `unit` and `usual` are words of the message: the quantity, its option, its unit and a usual value.
    """
    lost = modes.measured[~(std > 0)]
    if lost.size == modes.measured.size:
        raise InputError(
            f"the record has no uncertainty of {what}; give the scatter of the test by `{key}_std`{unit} in [record.modes], or"
            f" `{key}_error`, {usual}"
        )
    if lost.size:
        listed = ", ".join(str(mode + 1) for mode in lost.tolist())
        raise InputError(
            f"the record has no uncertainty of {what}, or one of zero, at mode {listed}: a value without error would"
            f" outweigh all others; correct it, or give `{key}_error`, {usual}, which is added to all"
        )


def _require_told_apart(modes: MeasuredModes, group: GroupData) -> None:
    """Raise `FewSensorsError` if a group has more close modes than sensors to separate their shapes.

    A mode that stands alone needs no sensor.
    """
    if len(group.members) <= max(len(group.channels), 1):
        return
    numbers, n_own = ", ".join(str(mode + 1) for mode in group.members.tolist()), len(group.channels)
    where = "" if n_own == len(modes.record.channels) else " at which the shapes of all are known"
    raise FewSensorsError(
        f"modes {numbers} cannot be distinguished (within {modes.settings.closeness:g} of each other, or their errors) and there"
        f" are {plural(n_own, 'sensor')}{where}; lower `closeness` or the errors, measure more places, or leave modes out"
    )


def _require_independent(modes: MeasuredModes, group: GroupData) -> None:
    """Raise `InputError`, which names the modes, if those of `group` have linearly dependent shapes at the sensors.

    They are if the least singular value of the shapes, scaled to length 1, is at most 1e-9. One mode alone passes.
    """
    size = np.linalg.norm(group.shapes, axis=0)
    if len(group.members) < 2 or not group.shapes.size:
        return
    if np.linalg.svd(group.shapes / size, compute_uv=False)[-1] <= _DEPENDENT:
        record = modes.record
        listed = ", ".join(f"{mode + 1} ({record.frequency[mode]:.6g} Hz)" for mode in group.members.tolist())
        raise InputError(
            f"modes {listed}{f' of {record.source}' if record.source else ''} cannot be distinguished by frequency, and"
            " their shapes are the same or sums of each other, as where a mode is listed twice; leave one out of the file or"
            " with `use`, or give the shapes at more sensors"
        )
