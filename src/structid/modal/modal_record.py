"""Modal records: frequencies, damping ratios and mode shapes at sensors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray, locked, require_finite, require_shape
from structid.core.display import Overview, Shown, data_frame, format_number, join_words, plural
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

Scaling = Literal["unit_largest", "mass"]

_ROUNDING = 1e-9  # of a standard deviation, below which it is none


@dataclass(frozen=True, eq=False)
class ModalChanges:
    """A square root of the joint covariance of all numbers of a `ModalRecord`: sums over changes of their products.

    Parameters
    ----------
    frequency, damping_ratio : (n_changes, n_modes) float arrays
        Hz and 1.
    mode_shapes : (n_changes, n_channels, n_modes) complex array
        Changes of shapes whose largest entry is held.

    Raises
    ------
    InputError
        If shapes disagree or an entry is not finite.
    """

    frequency: FloatArray
    damping_ratio: FloatArray
    mode_shapes: ComplexArray

    def __post_init__(self) -> None:
        """Make arrays read-only and raise `InputError` on wrong shapes or values that are not finite.

        With n changes: `frequency` and `damping_ratio` (n, n_modes), `mode_shapes` (n, n_channels, n_modes).
        """
        object.__setattr__(self, "frequency", locked(self.frequency, np.float64))
        object.__setattr__(self, "damping_ratio", locked(self.damping_ratio, np.float64))
        object.__setattr__(self, "mode_shapes", locked(self.mode_shapes, np.complex128))
        require_shape("frequency", self.frequency, (None, None))
        require_shape("damping_ratio", self.damping_ratio, self.frequency.shape, "one for each frequency")
        require_shape("mode_shapes", self.mode_shapes, (len(self.frequency), None, self.frequency.shape[1]))
        for name in ("frequency", "damping_ratio", "mode_shapes"):
            require_finite(name, getattr(self, name))


def independent_errors(stds: FloatArray) -> FloatArray:
    """Covariance matrix (n, n) of independent errors with standard deviations `stds` (n,); NaN rows and columns where NaN."""
    known = ~np.isnan(stds)
    covariance = np.where(np.outer(known, known), 0.0, np.nan)
    np.fill_diagonal(covariance, stds**2)
    return covariance


@dataclass(frozen=True, eq=False, repr=False)
class ModalRecord(Shown):
    """Modes as measured, lowest first: a measurement like any other for what follows.

    Parameters
    ----------
    frequency : (n_modes,) float array
        Undamped natural frequency, Hz; 0 for rigid-body modes.
    damping_ratio : (n_modes,) float array
        Viscous damping ratio; NaN where the method gives none.
    mode_shapes : (n_channels, n_modes) array, real or complex
        One column a mode; the sense of each `Dof` included. NaN where an entry is unknown, as of a sensor that was dead
        in one mode; a whole column where a mode was published without its shape.
    channels : tuple of Dof
        Where the rows of `mode_shapes` were measured.
    covariance : (2 n_modes, 2 n_modes) float array, optional
        Covariance of all frequencies (Hz), then all damping ratios. None where the method gives none.
    shape_std : (n_channels, n_modes) float array, optional
        Standard deviation of every entry of `mode_shapes`, of its real part for complex ones; NaN where it is unknown.
    changes : ModalChanges, optional
        What `covariance` and `shape_std` come from, with all that they leave out: how shapes vary together, and with
        frequencies.
    warnings : tuple of str
        What the user should know before using the modes: causes and remedies.
    source : str
        Method and data that the modes come from.
    scaling : {"unit_largest", "mass"}
        Entry of largest magnitude 1; or a modal mass of 1, shapes in kg^-1/2 (translations), where a driving point
        or a model gives it.

    Raises
    ------
    InputError
        If shapes disagree, frequencies are negative, not finite or not in order, or a mode shape is infinite.
    """

    frequency: FloatArray
    damping_ratio: FloatArray
    mode_shapes: NumberArray
    channels: tuple[Dof, ...]
    covariance: FloatArray | None = None
    shape_std: FloatArray | None = None
    warnings: tuple[str, ...] = ()
    source: str = ""
    scaling: Scaling = "unit_largest"
    changes: ModalChanges | None = None

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(
            self,
            frequency: ArrayLike,
            damping_ratio: ArrayLike,
            mode_shapes: ArrayLike,
            channels: Iterable[str | Dof],
            covariance: ArrayLike | None = None,
            shape_std: ArrayLike | None = None,
            warnings: Iterable[str] = (),
            source: str = "",
            scaling: Scaling = "unit_largest",
            changes: ModalChanges | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Make arrays read-only; raise `InputError` on wrong shapes, an unknown scaling, or values out of range.

        Frequencies must be finite, not negative and sorted, shape entries not infinite. An entry of a shape with a NaN
        real or imaginary part becomes NaN in both, and so does its standard deviation.
        """
        object.__setattr__(self, "frequency", locked(self.frequency, np.float64))
        object.__setattr__(self, "damping_ratio", locked(self.damping_ratio, np.float64))
        is_complex = np.iscomplexobj(self.mode_shapes)
        shapes = np.array(self.mode_shapes, dtype=np.complex128 if is_complex else np.float64)
        shapes[np.isnan(shapes)] = complex(np.nan, np.nan) if is_complex else np.nan
        object.__setattr__(self, "mode_shapes", locked(shapes))
        object.__setattr__(self, "channels", parse_dofs(self.channels))
        object.__setattr__(self, "warnings", tuple(self.warnings))
        if self.scaling not in ("unit_largest", "mass"):
            raise InputError(f"`scaling` must be unit_largest or mass, got {self.scaling!r}")
        require_shape("frequency", self.frequency, (None,))
        require_finite("frequency", self.frequency)
        if (self.frequency < 0).any() or (np.diff(self.frequency) < 0).any():
            raise InputError("`frequency` must be at least 0 and increase from mode to mode; sort the modes")
        require_shape("damping_ratio", self.damping_ratio, self.frequency.shape, "NaN where it is not known")
        require_shape("mode_shapes", self.mode_shapes, (len(self.channels), self.n_modes), "one column a mode")
        require_finite("mode_shapes", np.where(self.known, self.mode_shapes, 0.0))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", locked(self.covariance, np.float64))
            require_shape("covariance", np.asarray(self.covariance), (2 * self.n_modes,) * 2)
        if self.shape_std is not None:
            std = np.asarray(self.shape_std, dtype=np.float64)
            require_shape("shape_std", std, self.mode_shapes.shape, "one for each entry")
            object.__setattr__(self, "shape_std", locked(np.where(self.known, std, np.nan)))
        if self.changes is not None:
            require_shape(
                "changes", self.changes.mode_shapes, (None, *self.mode_shapes.shape), "one for each entry of the shapes"
            )

    def overview(self) -> Overview:
        """Overview of the modal record: words on modes and channels, and a table with one row for each mode.

        A row has number (from 1), frequency (Hz), damping ratio, and the standard deviation behind either.
        """
        words = (
            f"{plural(self.n_modes, 'mode')} at {plural(len(self.channels), 'channel')} ({join_words(self.channels)})"
        )
        words += self.unknown_words
        rows = [
            (str(number + 1), *(format_number(value, digits) for value, digits in zip(row, (6, 2, 3, 2), strict=True)))
            for number, row in enumerate(_table(self).tolist())
        ]
        return Overview(words, ("mode", "frequency, Hz", "std", "damping ratio", "std"), rows)

    def to_dataframe(self) -> pd.DataFrame:
        """Data frame with one row per mode: frequency in Hz and damping ratio with their standard deviations.

        The index is the mode number from 1; columns are frequency, frequency_std, damping_ratio and damping_std.
        """
        columns = dict(zip(("frequency", "frequency_std", "damping_ratio", "damping_std"), _table(self).T, strict=True))
        return data_frame({"mode": range(1, self.n_modes + 1), **columns}, "mode")

    @property
    def n_modes(self) -> int:
        return len(self.frequency)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which entries of `mode_shapes` are known, (n_channels, n_modes)."""
        return np.asarray(~np.isnan(self.mode_shapes))

    @property
    def unknown_words(self) -> str:
        """Words to append to a sentence, such as ", 3 of 24 shape entries unknown"; "" if all shape entries are known."""
        known = self.known
        count, bare = int((~known).sum()), int((~known.any(axis=0)).sum()) if known.size else 0
        without = f", {plural(bare, 'mode')} without a shape" if bare else ""
        return f", {count} of {known.size} shape entries unknown{without}" if count else ""

    @property
    def omega(self) -> FloatArray:
        """Circular natural frequency in rad/s."""
        return 2 * np.pi * self.frequency

    @property
    def std(self) -> FloatArray:
        """Standard deviations of frequencies (Hz), then damping ratios, (2 n_modes,); NaN where there are none."""
        if self.covariance is None:
            return np.full(2 * self.n_modes, np.nan)
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def frequency_std(self) -> FloatArray:
        """Standard deviations of the frequencies, Hz, (n_modes,); NaN where there are none."""
        return self.std[: self.n_modes]

    @property
    def poles(self) -> ComplexArray:
        """Continuous-time poles -zeta omega + i omega sqrt(1 - zeta^2), (n_modes,), rad/s; unknown damping counts as 0."""
        ratio = np.clip(np.nan_to_num(self.damping_ratio), -1.0, 1.0)
        return np.asarray(self.omega * (-ratio + 1j * np.sqrt(1 - ratio**2)))

    def some_modes(self, indices: Sequence[int] | IntArray) -> ModalRecord:
        """Copy with the modes at `indices` (from 0, in any order) alone, in the record's order.

        Covariance, deviations and changes of these modes stay.
        """
        keep = np.sort(np.asarray(indices, dtype=int))
        both = np.concatenate([keep, keep + self.n_modes])
        own = self.changes
        return replace(
            self,
            frequency=self.frequency[keep],
            damping_ratio=self.damping_ratio[keep],
            mode_shapes=self.mode_shapes[:, keep],
            covariance=None if self.covariance is None else self.covariance[np.ix_(both, both)],
            shape_std=None if self.shape_std is None else self.shape_std[:, keep],
            changes=own
            and ModalChanges(own.frequency[:, keep], own.damping_ratio[:, keep], own.mode_shapes[:, :, keep]),
        )

    def some_channels(self, indices: Sequence[int] | IntArray) -> ModalRecord:
        """Copy of the modes at the channels `indices`, in that order."""
        rows, own = np.asarray(indices, dtype=int), self.changes
        return replace(
            self,
            mode_shapes=self.mode_shapes[rows],
            channels=tuple(self.channels[i] for i in rows.tolist()),
            shape_std=None if self.shape_std is None else self.shape_std[rows],
            changes=own and ModalChanges(own.frequency, own.damping_ratio, own.mode_shapes[:, rows]),
        )


def _table(modes: ModalRecord) -> FloatArray:
    """Frequency, its deviation, damping ratio, its deviation, (n_modes, 4)."""
    std = modes.std.reshape(2, modes.n_modes)
    return np.stack([modes.frequency, std[0], modes.damping_ratio, std[1]], axis=1)


class _Others(TypedDict, total=False):
    """Fields of a `ModalRecord` that the order of its modes does not touch."""

    warnings: Iterable[str]
    source: str
    scaling: Scaling


def by_frequency(
    frequency: FloatArray,
    damping_ratio: FloatArray,
    mode_shapes: NumberArray,
    channels: tuple[Dof, ...],
    covariance: FloatArray | None = None,
    shape_std: FloatArray | None = None,
    **others: Unpack[_Others],
) -> ModalRecord:
    """`ModalRecord` of modes in any order, sorted by frequency (Hz); covariance and shapes are reordered with them.

    Shapes of arguments are those of `ModalRecord`; `others` are its fields `warnings`, `source` and `scaling`.
    `covariance` (2 n_modes, 2 n_modes) is of frequencies, then damping ratios; None if unknown, as `shape_std`.
    """
    order = np.argsort(frequency, kind="stable")
    both = np.concatenate([order, order + len(order)])
    return ModalRecord(
        frequency[order], damping_ratio[order], mode_shapes[:, order], channels,
        None if covariance is None else covariance[np.ix_(both, both)],
        None if shape_std is None else shape_std[:, order], **others,
    )  # fmt: skip


def joined(parts: Sequence[ModalRecord], warnings: Sequence[str], source: str) -> ModalRecord:
    """`ModalRecord` of the modes of several records with the same channels, sorted by frequency.

    Covariances between modes of different `parts` are 0; the covariance is None if a part has none, and so is
    `shape_std`. `warnings` and `source` are those of the result; the scaling is that of the first part, and `changes`
    are dropped.
    """
    n = sum(part.n_modes for part in parts)
    covariance, before = np.zeros((2, n, 2, n)), 0
    for part in parts:
        own = slice(before, before + part.n_modes)
        if part.covariance is not None:
            covariance[:, own, :, own] = part.covariance.reshape(2, part.n_modes, 2, part.n_modes)
        before += part.n_modes
    return by_frequency(
        np.concatenate([part.frequency for part in parts]),
        np.concatenate([part.damping_ratio for part in parts]),
        np.concatenate([part.mode_shapes for part in parts], axis=1),
        parts[0].channels,
        None if any(part.covariance is None for part in parts) else covariance.reshape(2 * n, 2 * n),
        _side_by_side([part.shape_std for part in parts]),
        warnings=tuple(warnings), source=source, scaling=parts[0].scaling,
    )  # fmt: skip


def _side_by_side(parts: Sequence[FloatArray | None]) -> FloatArray | None:
    known = [part for part in parts if part is not None]
    return np.concatenate(known, axis=1) if len(known) == len(parts) else None


def unit_largest(shapes: NumberArray) -> NumberArray:
    """`shapes` (n_channels, n_modes) with each column divided by its entry of largest magnitude, which becomes 1.

    NaN entries are passed over; a column of NaN stays NaN.
    """
    known = ~np.isnan(shapes)
    largest = shapes[np.where(known, np.abs(shapes), 0.0).argmax(axis=0), np.arange(shapes.shape[1])]
    return shapes / np.where(np.isnan(largest), 1.0, largest)


def largest_entries(shapes: NumberArray, empty: float = 0.0) -> FloatArray:
    """Magnitude of the largest known (not NaN) entry of each column of `shapes`, (n_modes,); `empty` where all are NaN."""
    known = ~np.isnan(shapes)
    sizes = np.where(known, np.abs(shapes), 0.0).max(axis=0, initial=0.0)
    return np.asarray(np.where(known.any(axis=0), sizes, empty))


def unscaled_shape_std(shapes: NumberArray, std: FloatArray) -> FloatArray:
    """Standard deviations of shape entries with free scale, from those of shapes with one entry held at 1.

    A shape psi = phi / phi_t has no error at its entry t; the error of phi_t is in all other entries instead. To first order
    var(psi_i) = var(phi_i) + |psi_i|^2 var(phi_t), relative to phi_t. With errors taken as equal and independent this gives
    var(phi_i) = var(psi_i) / (1 + |psi_i|^2), and for t their mean. Without this, least squares with a free scale would take
    entry t as exact.

    Parameters
    ----------
    shapes : (n_channels, n_modes) array
        Largest entry of size 1.
    std : (n_channels, n_modes) float array
        0 (to rounding) at one entry of a column; columns without a 0, or with zeros only, stay as they are. NaN where an entry
        is unknown.

    Returns
    -------
    (n_channels, n_modes) float array
    """
    freed = np.array(std, dtype=np.float64)
    held = std <= _ROUNDING * np.nan_to_num(std).max(axis=0, initial=0.0)
    for m in np.flatnonzero(held.any(axis=0) & (std > 0).any(axis=0)):
        free = ~held[:, m]
        freed[free, m] = std[free, m] / np.sqrt(1 + np.abs(shapes[free, m]) ** 2)
        freed[~free, m] = np.sqrt(np.nanmean(freed[free, m] ** 2))
    return freed
