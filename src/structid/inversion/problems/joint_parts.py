"""The unknowns of several problems as one list, those of the same name as one; and their data, one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.problem import Data, Unknowns

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class JointUnknowns:
    """All unknowns of `parts`, in the order of their first appearance; each is as the first part that has it says.

    Parameters
    ----------
    parts : tuple of Unknowns

    Raises
    ------
    InputError
        If an unknown that parts share differs among them in unit, transform or bounds.
    """

    parts: tuple[Unknowns, ...]

    def __post_init__(self) -> None:
        for number, (part, index) in enumerate(zip(self.parts, self.columns, strict=True), 1):
            _require_alike(self, number, part, index)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for part in self.parts for name in part.names))

    @cached_property
    def columns(self) -> tuple[IntArray, ...]:
        """For each part the position of its unknowns among all."""
        place = {name: i for i, name in enumerate(self.names)}
        return tuple(np.array([place[name] for name in part.names], dtype=int) for part in self.parts)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        return _first_words(self.parts, [part.kinds for part in self.parts])

    @cached_property
    def units(self) -> tuple[str, ...]:
        return _first_words(self.parts, [part.units for part in self.parts])

    @cached_property
    def theta_start(self) -> FloatArray:
        return _first(self, [np.asarray(part.theta_start) for part in self.parts])

    def physical(self, theta: FloatArray) -> FloatArray:
        return _first(self, [part.physical(own) for part, own in zip(self.parts, self.split(theta), strict=True)])

    def slope(self, theta: FloatArray) -> FloatArray:
        return _first(self, [part.slope(own) for part, own in zip(self.parts, self.split(theta), strict=True)])

    def sizes(self, physical: FloatArray) -> FloatArray:
        """What each standard deviation is held against: the largest that a part names."""
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
        """Of one value an unknown those of each part."""
        return [values[index] for index in self.columns]


def _first(every: JointUnknowns, values: Sequence[FloatArray]) -> FloatArray:
    """Rows of all unknowns, each from the first part that has it."""
    found = np.zeros((len(every.names), *values[0].shape[1:]))
    for own, index in reversed(list(zip(values, every.columns, strict=True))):
        found[index] = own
    return found


def _first_words(parts: Sequence[Unknowns], words: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """A word of every unknown, each from the first part that has it."""
    found: dict[str, str] = {}
    for part, own in zip(parts, words, strict=True):
        for name, word in zip(part.names, own, strict=True):
            found.setdefault(name, word)
    return tuple(found.values())


def _require_alike(every: JointUnknowns, number: int, part: Unknowns, index: IntArray) -> None:
    start = every.theta_start
    for name, unit, column in zip(part.names, part.units, index, strict=True):
        if unit != every.units[column]:
            raise InputError(
                f"{name} must have one unit in all problems, got {every.units[column]} and {unit} in problem"
                f" {number}; give one of the two another name"
            )
    pairs = (
        (part.physical(start[index]), every.physical(start)[index]),
        (part.slope(start[index]), every.slope(start)[index]),
    )
    alike = np.logical_and(*(np.isclose(a, b, rtol=_SAME, atol=0) for a, b in pairs))
    if not alike.all():
        raise InputError(
            f"{part.names[int(np.argmin(alike))]} must have the same bounds and transform in all problems,"
            f" got others in problem {number}; declare it the same way"
        )


@dataclass(frozen=True, eq=False)
class JointData:
    """The data rows of `parts` one after another, whose errors are not correlated.

    Parameters
    ----------
    parts : tuple of Data
    columns : tuple of (n_own,) int arrays
        Positions of each part's unknowns among all; see `JointUnknowns`.
    """

    parts: tuple[Data, ...]
    columns: tuple[IntArray, ...]

    @property
    def n_data(self) -> int:
        return sum(part.n_data for part in self.parts)

    @cached_property
    def lines(self) -> IntArray:
        """Position of each data row along the axes laid end to end."""
        return _laid_out([np.asarray(part.lines) for part in self.parts])

    @cached_property
    def series(self) -> IntArray:
        """Channel of each data row; those of another part are other channels."""
        return _laid_out([np.asarray(part.series) for part in self.parts], 2)

    @cached_property
    def quantities(self) -> IntArray | None:
        """Of each data row; None where parts do not have the same ones, whose numbers may then mean others in each."""
        own = [part.quantities for part in self.parts]
        told = [set(one[one >= 0].tolist()) for one in own if one is not None]
        if not told or any(one != told[0] for one in told):
            return None
        pairs = zip(self.parts, own, strict=True)
        return np.concatenate([np.full(part.n_data, -1) if one is None else one for part, one in pairs])

    @property
    def averages(self) -> FloatArray | None:
        """Of each data row; infinite in parts with known variances."""
        own = [part.averages for part in self.parts]
        if all(one is None for one in own):
            return None
        pairs = zip(self.parts, own, strict=True)
        return np.concatenate([np.full(part.n_data, np.inf) if one is None else one for part, one in pairs])

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        return None

    def score_covariance(self, theta: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        """The sum of that of each part."""
        total, first, independent = np.zeros((jacobian.shape[1],) * 2), 0, True
        for part, index in zip(self.parts, self.columns, strict=True):
            rows = jacobian[first : first + part.n_data][:, index]
            own = part.score_covariance(theta[index], rows)
            independent &= own is None
            total[np.ix_(index, index)] += rows.T @ rows if own is None else own
            first += part.n_data
        return None if independent else total


def _laid_out(parts: Sequence[IntArray], step: int = 1) -> IntArray:
    """Numbers of each part moved beyond those of the parts before, to a multiple of `step`."""
    moved, first = [], 0
    for part in parts:
        moved.append(part + first)
        first += step * (int(part.max(initial=-1)) // step + 1)
    return np.concatenate(moved)
