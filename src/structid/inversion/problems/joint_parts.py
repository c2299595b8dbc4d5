"""Unknowns, data rows and noise of several problems in one: unknowns of one name merged, data one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.problem import DataRows, NoiseLaw, Unknowns

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class JointUnknowns:
    """Unknowns of `parts` merged by name, in the order of their first appearance; the first part that has one defines it.

    Parameters
    ----------
    parts : tuple of Unknowns
    labels : tuple of tuples of str
        Names of the unknowns of each part among all.

    Raises
    ------
    InputError
        If an unknown that parts share differs among them in unit, transform or bounds.
    """

    parts: tuple[Unknowns, ...]
    labels: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for number in range(len(self.parts)):
            _require_same_declaration(self, number)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for labels in self.labels for name in labels))

    @cached_property
    def columns(self) -> tuple[IntArray, ...]:
        """Indices of the unknowns of each part among all."""
        index = {name: i for i, name in enumerate(self.names)}
        return tuple(np.array([index[name] for name in labels], dtype=int) for labels in self.labels)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        return _first_words(self.labels, [part.kinds for part in self.parts])

    @cached_property
    def units(self) -> tuple[str, ...]:
        return _first_words(self.labels, [part.units for part in self.parts])

    @cached_property
    def theta_start(self) -> FloatArray:
        return _first(self, [np.asarray(part.theta_start) for part in self.parts])

    def physical(self, theta: FloatArray) -> FloatArray:
        return _first(self, [part.physical(own) for part, own in zip(self.parts, self.split(theta), strict=True)])

    def slope(self, theta: FloatArray) -> FloatArray:
        return _first(self, [part.slope(own) for part, own in zip(self.parts, self.split(theta), strict=True)])

    def sizes(self, physical: FloatArray) -> FloatArray:
        """Size with which each standard deviation is compared, (n_params,): the largest of all problems."""
        sizes = np.zeros(len(self.names))
        for part, index in zip(self.parts, self.columns, strict=True):
            sizes[index] = np.maximum(sizes[index], part.sizes(physical[index]))
        return sizes

    @property
    def bounds(self) -> FloatArray:
        return _first(self, [part.bounds for part in self.parts])

    @property
    def reach(self) -> FloatArray:
        return _first(self, [part.reach for part in self.parts])

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Values of the unknowns of each part, from one value for each of all unknowns."""
        return [values[index] for index in self.columns]


def _first(unknowns: JointUnknowns, values: Sequence[FloatArray]) -> FloatArray:
    """Row for each joint unknown, (n_params, ...), taken from the first problem that has it."""
    rows = np.zeros((len(unknowns.names), *values[0].shape[1:]))
    for part_rows, index in reversed(list(zip(values, unknowns.columns, strict=True))):
        rows[index] = part_rows
    return rows


def _first_words(labels: Sequence[tuple[str, ...]], words: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Word for each joint unknown, taken from the first problem that has it."""
    word_of: dict[str, str] = {}
    for names, part_words in zip(labels, words, strict=True):
        for name, word in zip(names, part_words, strict=True):
            word_of.setdefault(name, word)
    return tuple(word_of.values())


def _require_same_declaration(unknowns: JointUnknowns, number: int) -> None:
    """Raise `InputError` if problem `number` declares a shared unknown with another unit or transform."""
    start, part = unknowns.theta_start, unknowns.parts[number]
    index, names = unknowns.columns[number], unknowns.labels[number]
    for name, unit, column in zip(names, part.units, index, strict=True):
        if unit != unknowns.units[column]:
            raise InputError(
                f"{name} must have one unit in all problems, got {unknowns.units[column]} and {unit} in problem"
                f" {number + 1}; give one of the two another name"
            )
    pairs = (
        (part.physical(start[index]), unknowns.physical(start)[index]),
        (part.slope(start[index]), unknowns.slope(start)[index]),
    )
    is_same = np.logical_and(*(np.isclose(a, b, rtol=_SAME, atol=0) for a, b in pairs))
    if not is_same.all():
        raise InputError(
            f"{names[int(np.argmin(is_same))]} must have the same bounds and transform in all problems,"
            f" got others in problem {number + 1}; declare it the same way"
        )


def joint_rows(parts: Sequence[DataRows]) -> DataRows:
    """Labels of the data rows of all `parts`, one after another; lines and channels of different parts are different."""
    return DataRows(
        _laid_out([np.asarray(part.lines) for part in parts]),
        _laid_out([np.asarray(part.series) for part in parts], 2),
        tuple(name for part in parts for name in part.names),
        _joint_quantities(parts),
        _joint_averages(parts),
    )


def _joint_quantities(parts: Sequence[DataRows]) -> IntArray | None:
    """Quantity number of each data row of all problems, (n_data,); None if the problems' quantities differ."""
    numbers = [set(part.quantities[part.quantities >= 0].tolist()) for part in parts if part.quantities is not None]
    if not numbers or any(other != numbers[0] for other in numbers):
        return None
    return np.concatenate([np.full(part.n_data, -1) if part.quantities is None else part.quantities for part in parts])


def _joint_averages(parts: Sequence[DataRows]) -> FloatArray | None:
    """Number of averages behind the variance of each data row; infinite in parts with known variances."""
    if all(part.averages is None for part in parts):
        return None
    return np.concatenate([np.full(part.n_data, np.inf) if part.averages is None else part.averages for part in parts])


@dataclass(frozen=True, eq=False)
class JointNoise:
    """Noise of several problems, independent of each other.

    Attributes
    ----------
    laws : tuple of NoiseLaw
    n_data : tuple of int
        Number of data rows of each.
    columns : tuple of (n_part_params,) int arrays
        Indices of the unknowns of each among all.
    """

    laws: tuple[NoiseLaw, ...]
    n_data: tuple[int, ...]
    columns: tuple[IntArray, ...]

    factor = None

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        """Sum of score covariances of all problems, (n_params, n_params); None if all rows are independent."""
        total, first, independent = np.zeros((jacobian.shape[1],) * 2), 0, True
        for law, n_data, index in zip(self.laws, self.n_data, self.columns, strict=True):
            rows = jacobian[first : first + n_data][:, index]
            covariance = law.score_covariance(rows)
            independent &= covariance is None
            total[np.ix_(index, index)] += rows.T @ rows if covariance is None else covariance
            first += n_data
        return None if independent else total


def _laid_out(parts: Sequence[IntArray], step: int = 1) -> IntArray:
    """Numbers of all parts in one array, each part's raised beyond those before it by a multiple of `step`."""
    raised, first = [], 0
    for part in parts:
        raised.append(part + first)
        first += step * (int(part.max(initial=-1)) // step + 1)
    return np.concatenate(raised)
