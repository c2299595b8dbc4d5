"""All chapters in one run."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from types import ModuleType

from threadpoolctl import threadpool_limits

from structid.core.errors import InputError
from structid.reproduce.item import Progress, ReproducedItem

CHAPTERS = (3, 4, 5)


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
    found: list[ReproducedItem] = []
    with threadpool_limits(1, user_api="blas"):
        for i, module in enumerate(map(_module, wanted)):
            found += module.items(_part(progress, i, len(wanted)))
    return tuple(found)


def _module(chapter: int) -> ModuleType:
    """The module of one chapter."""
    return importlib.import_module(f"structid.reproduce.chapter_{chapter}.chapter")


def _part(progress: Progress | None, index: int, count: int) -> Progress | None:
    """Progress of one chapter as a part of all of them."""
    return progress and (lambda name, done: progress(name, (index + done) / count))
