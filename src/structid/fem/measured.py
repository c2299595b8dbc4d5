"""Components that have no model: their measured FRFs at the degrees of freedom that they share with the structure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked, require_finite, require_shape
from structid.core.display import plural
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError

#: Part of the line spacing by which lines may be apart and count as equal.
_EQUAL = 1e-3
#: Difference of a line from what its neighbours say, beyond which nothing is read between lines.
_COARSE = 0.1
#: Condition number from which on the degrees of freedom of an interface do not move independently.
_SINGULAR = 1e8
#: Part of an FRF by which it may differ from the reciprocal one without a word.
_RECIPROCAL = 0.05
#: Part of its lines at which a component may give power without a word.
_GIVES_POWER = 0.5
#: Lines from which on half of them tell how well the others can be read between them.
_TOLD_BY_HALF = 6
#: Sets of lines for which Y is kept: those of records, of what judges, and of stages.
_KEPT = 16


@dataclass(frozen=True, eq=False)
class MeasuredComponent:
    """A part of a structure that has no model but measured FRFs: a machine, a mount, the soil under a foundation.

    It was measured by itself, free of the structure, at the degrees of freedom of its interface, and moves with the
    structure there. It adds Y^-1 to the dynamic stiffness of the structure; nothing of it is sought. Where the
    interface gives way, springs of the structure lead to nodes of their own, and these are the interface.

    Parameters
    ----------
    name : str
    interface : sequence of degrees of freedom
        Degrees of freedom of the structure at which it is joined.
    frequency : (n_lines,) float array
        Hz, increasing.
    receptance : (n_lines, n, n) complex array
        Y, motion of each of `interface` per force at each of them, m/N (rad for rotations, N m for moments), as
        measured. What is not reciprocal in it is averaged out where it serves.
    source : str
        File that it comes from.
    variance : (n_lines, n, n) float array, optional
        Variance of each value of `receptance`, half of it of the real part and half of the imaginary part, independent
        from entry to entry and line to line. It enters the intervals of what is identified with the component.

    Raises
    ------
    InputError
        If shapes disagree, lines do not increase, or an entry is NaN or infinite.

    References
    ----------
    Jetmundsen, Bielawa and Flannelly (1988), J. American Helicopter Society 33(1), 55-64; de Klerk, Rixen and
    Voormeeren (2008), AIAA Journal 46(5), 1169-1181.
    """

    name: str
    interface: tuple[Dof, ...]
    frequency: FloatArray
    receptance: ComplexArray
    source: str
    variance: FloatArray | None

    def __init__(
        self,
        name: str,
        interface: str | Dof | Iterable[str | Dof],
        frequency: ArrayLike,
        receptance: ArrayLike,
        source: str = "",
        variance: ArrayLike | None = None,
    ) -> None:
        """The component `name` known by its measured receptance (n_lines, n, n), m/N, at the lines `frequency`, Hz.

        `interface` are its n degrees of freedom in the order of rows and columns, `variance` is E|error|^2 of each
        value (same shape; None if unknown), and `source` names the file.

        Raises
        ------
        InputError
            If `interface` is empty or repeats, shapes disagree, `frequency` is empty or does not increase, values are
            not finite, or a variance is negative.
        """
        dofs = parse_dofs((interface,) if isinstance(interface, str | Dof) else tuple(interface))
        axis, values = locked(frequency, np.float64), np.asarray(receptance, dtype=np.complex128)
        if not dofs or len({dof.unsigned for dof in dofs}) < len(dofs):
            raise InputError(f"`interface` of {name!r} must name degrees of freedom, each once, got {dofs}")
        require_shape("receptance", values, (len(axis), len(dofs), len(dofs)), "one square matrix a line")
        require_finite("receptance", values, "remove these lines, or repair the file")
        if not len(axis) or (np.diff(axis) <= 0).any():
            raise InputError(f"`frequency` of {name!r} must increase, and hold at least one line")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "interface", dofs)
        object.__setattr__(self, "frequency", axis)
        object.__setattr__(self, "receptance", locked(values))
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "variance", None if variance is None else locked(variance, np.float64))
        if self.variance is not None:
            require_shape("variance", self.variance, values.shape, "one value for each of `receptance`")
            require_finite("variance", self.variance, "state the errors of every value")
            if (self.variance < 0).any():
                raise InputError(f"`variance` of {name!r} must not be negative, got {self.variance.min():g}")

    @property
    def words(self) -> str:
        """Name of the component in messages."""
        return f"measured component {self.name!r}" + (f" ({self.source})" if self.source else "")

    def receptance_at(self, frequency: FloatArray) -> ComplexArray:
        """Receptance Y at `frequency` (n_lines,) in Hz: mean of the measured matrix and its transpose, (n_lines, n, n).

        In m/N, read-only, on the n degrees of freedom of the interface. A line that was measured (within 1/1000 of the
        spacing) is taken as it is; others are interpolated by the cubic through four measured lines. The array is
        cached for the sets of lines last asked for.

        Raises
        ------
        InputError
            If a line lies outside its band, or between lines that are too far apart, or Y is singular there.
        """
        key = frequency.tobytes()
        receptance = self._known.get(key)
        if receptance is None:
            nearest, between = self._nearest_lines(frequency)
            values = np.array(self._reciprocal[nearest])
            if between.any():
                values[between] = _read_between(self.frequency, self._reciprocal, frequency[between])
            self._require_regular(frequency, values)
            receptance = locked(values)
            if len(self._known) >= _KEPT:
                self._known.clear()
            self._known[key] = receptance
        return receptance

    def weights_at(self, frequency: FloatArray) -> sparse.csr_array:
        """Weights of the measured lines in the interpolated receptance at each `frequency` (Hz), (n_measured, n_lines).

        A column has a single 1 where the line was measured, and four cubic weights where it is interpolated. Raises
        `InputError` if a line lies outside the measured band, or between measured lines that are too far apart.
        """
        nearest, between = self._nearest_lines(frequency)
        columns, rows, values = np.flatnonzero(~between), nearest[~between], np.ones((~between).sum())
        if between.any():
            neighbours, weights = _cubic_weights(self.frequency, frequency[between])
            columns = np.concatenate([columns, np.repeat(np.flatnonzero(between), neighbours.shape[1])])
            rows, values = np.concatenate([rows, neighbours.ravel()]), np.concatenate([values, weights.ravel()])
        return sparse.csr_array((values, (rows, columns)), (len(self.frequency), len(frequency)))

    @cached_property
    def _reciprocal(self) -> ComplexArray:
        """The mean of Y and its transpose."""
        return locked((self.receptance + np.swapaxes(self.receptance, 1, 2)) / 2)

    @cached_property
    def _known(self) -> dict[bytes, ComplexArray]:
        """Y at the lines last asked for."""
        return {}

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of warning that hold at all lines: unknown errors, sense of channels, lack of reciprocity.

        The first is always there: stated masses exclude the component, and its errors do not count if it has no
        variance. The sense of a channel is doubted where more than half of the lines give power, reciprocity where Y
        and its transpose differ by more than 5 % in norm.
        """
        unknown = ", and errors of its FRFs are not in the intervals; state their noise, or what they may come to as `model_error`"
        words = [f"{self.words}: masses told are without it{unknown if self.variance is None else ''}"]
        power = -np.diagonal(self.receptance.imag, axis1=1, axis2=2)
        for dof, gives in zip(self.interface, (power < 0).mean(axis=0), strict=True):
            if gives > _GIVES_POWER:
                words.append(
                    f"{self.words}: the real part of mobility of {dof.place} under its own force is negative at {100 * gives:.0f} %"
                    " of all its lines; check the sense of sensor and load and the sign convention"
                )
        size = np.linalg.norm(self.receptance)
        apart = np.linalg.norm(self.receptance - np.swapaxes(self.receptance, 1, 2))
        if apart > _RECIPROCAL * size:
            words.append(
                f"{self.words}: its FRFs differ by {100 * apart / size:.2g} % from the reciprocal ones, and their mean is"
                " taken; check senses and places of its sensors and loads"
            )
        return tuple(words)

    def line_warnings(self, frequency: FloatArray) -> tuple[str, ...]:
        """A tuple of one sentence if some of the lines `frequency` (Hz) lie between measured lines, else ().

        Such lines are interpolated. The sentence says how many, and how far a measured line would be off if left out.

        Raises
        ------
        InputError
            If a line lies outside the measured band, or the measured lines are too far apart to interpolate between
            them.
        """
        _, between = self._nearest_lines(frequency)
        if not between.any():
            return ()
        return (
            f"{self.words}: {between.sum()} of {plural(len(frequency), 'line')} lie between its own and are interpolated;"
            f" left out, one of its lines would be off by up to {100 * self._interpolation_errors(frequency).max():.2g} %",
        )

    def _nearest_lines(self, frequency: FloatArray) -> tuple[IntArray, np.ndarray]:
        """Index of the measured line nearest to each `frequency` (Hz), and True where interpolation is needed.

        Both are (n_lines,). A line within 1/1000 of the spacing of a measured one needs none. Raises `InputError` if a
        line lies outside the measured band, or the measured lines are too far apart to interpolate: one of them would
        be off by more than 10 % if left out.
        """
        measured = self.frequency
        nearest = np.searchsorted((measured[1:] + measured[:-1]) / 2, frequency)
        spacing = np.gradient(measured) if len(measured) > 1 else measured
        between = np.abs(measured[nearest] - frequency) > _EQUAL * spacing[nearest]
        outside = frequency[between & ((frequency < measured[0]) | (frequency > measured[-1]))]
        if len(outside):
            raise InputError(
                f"{self.words} was measured from {measured[0]:g} to {measured[-1]:g} Hz, and a line lies at {outside[0]:g} Hz;"
                " give `band` in [method] (and `evaluation_band`) inside"
            )
        if between.any() and (worst := self._interpolation_errors(frequency)).max() > _COARSE:
            worst_frequency = measured[int(worst.argmax())]
            raise InputError(
                f"{self.words} has no line at {frequency[between][0]:g} Hz, and its lines are too far apart to read between them:"
                f" near {worst_frequency:g} Hz a line differs by {100 * worst.max():.2g} % from what its neighbours say; measure it"
                " and the structure at the same lines"
            )
        return nearest, between

    def _interpolation_errors(self, frequency: FloatArray) -> FloatArray:
        """Relative error of each measured line when it is interpolated from every other line, (n_measured,).

        0 for lines outside the range of `frequency` (Hz, increasing); infinite at all lines if there are fewer than
        six. The first and last line are never left out, and have error 0.
        """
        measured, errors = self.frequency, np.zeros(len(self.frequency))
        if len(measured) < _TOLD_BY_HALF:
            return np.full(len(measured), np.inf)
        size = np.linalg.norm(self._reciprocal, axis=(1, 2))
        size = np.maximum(size, np.maximum(np.roll(size, 1), np.roll(size, -1)))
        for first in (0, 1):
            kept = np.unique([0, *range(first, len(measured), 2), len(measured) - 1])
            out = np.setdiff1d(np.arange(len(measured)), kept)
            difference = _read_between(measured[kept], self._reciprocal[kept], measured[out]) - self._reciprocal[out]
            errors[out] = np.linalg.norm(difference, axis=(1, 2)) / size[out]
        low, high = np.searchsorted(measured, [frequency[0], frequency[-1]])
        errors[: max(low - 1, 0)] = errors[high + 1 :] = 0.0
        return errors

    def _require_regular(self, frequency: FloatArray, receptance: ComplexArray) -> None:
        """Raise `InputError` if the `receptance` (n_lines, n_dofs, n_dofs) is singular at a line of `frequency`, Hz.

        `frequency` is (n_lines,). Singular is a matrix with a 0 on its diagonal, or with a condition number above 1e8
        once it is scaled to a unit diagonal.
        """
        size = np.sqrt(np.abs(np.diagonal(receptance, axis1=1, axis2=2)))
        if not size.all():
            line, dof = np.argwhere(size == 0)[0]
            raise InputError(
                f"{self.words}: {self.interface[dof]} does not move under its own force at {frequency[line]:g} Hz; leave it out"
                " of `interface`, or leave the line out"
            )
        condition = np.linalg.cond(receptance / (size[:, :, None] * size[:, None, :]))
        worst = int(condition.argmax())
        if condition[worst] > _SINGULAR:
            raise InputError(
                f"{self.words}: the condition number of its FRFs at {frequency[worst]:g} Hz is {condition[worst]:.1g}, so that some"
                " of its degrees of freedom move as others do; leave these out of `interface`, and join them by a rigid link"
                " where the component is rigid"
            )


def joined_receptance(components: Sequence[MeasuredComponent], frequency: FloatArray) -> ComplexArray:
    """Block-diagonal receptance of all `components`, (n_lines, n, n), m/N, at the lines `frequency`, Hz.

    Rows and columns are the interface degrees of freedom of the first component, then of the second, and so on. Raises
    `InputError` if a line lies outside the measured band of a component or cannot be interpolated, or its receptance is
    singular there.
    """
    receptances = [component.receptance_at(frequency) for component in components]
    ends = np.cumsum([0, *(y.shape[1] for y in receptances)])
    joined = np.zeros((len(frequency), ends[-1], ends[-1]), dtype=np.complex128)
    for y, (first, last) in zip(receptances, pairwise(ends.tolist()), strict=True):
        joined[:, first:last, first:last] = y
    return joined


def _read_between(axis: FloatArray, values: ComplexArray, frequency: FloatArray) -> ComplexArray:
    """Values (n_frequency, n, n) at `frequency`, each by the cubic through the four places of `axis` next to it.

    `values` (n_axis, n, n) belong to the increasing `axis` (n_axis,), which has four places or more.
    """
    near, weights = _cubic_weights(axis, frequency)
    interpolated: ComplexArray = np.einsum("lk,lkij->lij", weights, values[near])
    return interpolated


def _cubic_weights(axis: FloatArray, frequency: FloatArray) -> tuple[IntArray, FloatArray]:
    """Indices of the four measured lines next to each `frequency` and weights of the cubic through them.

    Both are (n_frequency, 4). `axis` are the measured lines, Hz, increasing, four or more. The weights are Lagrange's.
    """
    near = np.clip(np.searchsorted(axis, frequency) - 2, 0, len(axis) - 4)[:, None] + np.arange(4)
    nodes, weights = axis[near], np.ones(near.shape)
    for k, j in ((k, j) for k in range(4) for j in range(4) if j != k):
        weights[:, k] *= (frequency - nodes[:, j]) / (nodes[:, k] - nodes[:, j])
    return near, weights
