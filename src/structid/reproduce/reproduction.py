"""The dissertation's tables and figures beside what is printed: all chapters in one run, and an item with its verdict."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from types import ModuleType

import numpy as np
from threadpoolctl import threadpool_limits

from structid.core.arrays import FloatArray, locked, require_shape
from structid.core.errors import InputError

CHAPTERS = (3, 4, 5)


#: Called with the name of the item in work and the part of the chapter that is done, 0 to 1.
Progress = Callable[[str, float], None]


def reproduce(chapters: Iterable[int] = CHAPTERS, progress: Progress | None = None) -> tuple[ReproducedItem, ...]:
    """Tables and figures of `chapters`, in the order of the dissertation.

    Parameters
    ----------
    chapters : iterable of int
        Any of 3, 4 and 5; repeats are ignored.
    progress : callable, optional
        Called with the name of the item in work and the fraction of all chapters that is done, 0 to 1.

    Returns
    -------
    tuple of ReproducedItem
        Reproducible: random studies use fixed seeds, and linear algebra runs in one thread.

    Raises
    ------
    InputError
        If `chapters` is empty or holds another number.
    """
    known = ", ".join(map(str, CHAPTERS))
    wanted = sorted(set(chapters))
    for chapter in wanted:
        if chapter not in CHAPTERS:
            raise InputError(f"`chapter` must be one of {known}, got {chapter}")
    if not wanted:
        raise InputError(f"`chapters` must name at least one of {known}, got none")
    items: list[ReproducedItem] = []
    with threadpool_limits(1, user_api="blas"):
        for i, module in enumerate(map(_module, wanted)):
            items += module.items(_chapter_progress(progress, i, len(wanted)))
    return tuple(items)


def _module(chapter: int) -> ModuleType:
    """The module of `structid.reproduce` that computes the items of a chapter: 3, 4 or 5."""
    return importlib.import_module(f"structid.reproduce.chapter_{chapter}")


def _chapter_progress(progress: Progress | None, index: int, count: int) -> Progress | None:
    """Progress of one chapter, number `index` (from 0) of `count`, as a part of all of them; None without `progress`."""
    return progress and (lambda name, done: progress(name, (index + done) / count))


class Verdict(Enum):
    """Verdict on a printed table or figure; the value is what files and pages show."""

    AGREES = "agrees to the printed digits"
    MISPRINT = "misprint, with the correction"
    READING = "agrees under this reading"
    REFUTED = "does not hold, with the evidence"


@dataclass(frozen=True, eq=False)
class Table:
    """Printed beside computed numbers.

    Attributes
    ----------
    rows, columns : tuple of str
        Headings; units in brackets.
    printed : (n_rows, n_columns) float array
        NaN where the dissertation prints nothing.
    computed : (n_rows, n_columns) float array
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    printed: FloatArray
    computed: FloatArray

    def __post_init__(self) -> None:
        for name in ("printed", "computed"):
            object.__setattr__(self, name, locked(getattr(self, name), np.float64))
            require_shape(name, getattr(self, name), (len(self.rows), len(self.columns)))

    @property
    def difference(self) -> FloatArray:
        """Computed minus printed numbers, (n_rows, n_columns); NaN where nothing is printed."""
        return self.computed - self.printed


@dataclass(frozen=True, eq=False)
class Curve:
    """A line of a figure, with a 5-95 % band where it is a median over seeds.

    Attributes
    ----------
    label : str
    x, y : (n_points,) float arrays
    low, high : (n_points,) float arrays, optional
        Lower and upper edge of the band; None for a line without one.
    """

    label: str
    x: FloatArray
    y: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """A set of axes with its curves; the titles of axes are texts with the unit."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    log_y: bool = False


@dataclass(frozen=True, eq=False)
class ReproducedItem:
    """One table or figure.

    Attributes
    ----------
    name : str
        As the dissertation calls it, such as ``Table 3.4``.
    title : str
    verdict : Verdict
    note : str
        What agrees and what does not, the reading taken, the evidence, and the seeds of random studies.
    tables : tuple of Table
        The first one holds the printed numbers, others what supports the verdict.
    panels : tuple of Panel
        Of a figure.
    """

    name: str
    title: str
    verdict: Verdict
    note: str
    tables: tuple[Table, ...] = ()
    panels: tuple[Panel, ...] = ()

    @property
    def max_abs_difference(self) -> float | None:
        """Largest absolute difference between computed and printed numbers in the first table; None if nothing is printed."""
        if not self.tables or not np.isfinite(self.tables[0].difference).any():
            return None
        return float(np.nanmax(np.abs(self.tables[0].difference)))


def unprinted(rows: tuple[str, ...], columns: tuple[str, ...], computed: FloatArray) -> Table:
    """Table of computed numbers alone (n_rows, n_columns): all printed numbers are NaN."""
    return Table(rows, columns, np.full(np.shape(computed), np.nan), computed)


#: The part of a chapter that is done before a step, its name, and what makes its items, told how to report its own part.
Step = tuple[float, str, Callable[[Callable[[float], None]], Sequence[ReproducedItem]]]


def made(steps: Sequence[Step], progress: Progress | None) -> tuple[ReproducedItem, ...]:
    """Items that the steps make, in order.

    A step is (fraction done before it, name, function); the function takes a callable for its progress, 0 to 1, and returns
    items. `progress`, if not None, is called with the name and the fraction of all steps that is done.
    """
    items: list[ReproducedItem] = []
    report = progress or (lambda _name, _done: None)
    for (begin, name, make), end in zip(steps, [*(step[0] for step in steps[1:]), 1.0], strict=True):
        report(name, begin)
        items += make(partial(_part, report, name, begin, end))
    report(steps[-1][1], 1.0)
    return tuple(items)


def _part(report: Progress, name: str, begin: float, end: float, done: float) -> None:
    """Report the progress of a step as a fraction of all steps: `done`, 0 to 1, is mapped to `begin` to `end`."""
    report(name, begin + (end - begin) * done)
