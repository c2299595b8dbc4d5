"""A cache of the results last asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

K = TypeVar("K")
T = TypeVar("T")


class LastResults(Generic[K, T]):
    """The results last asked for, by key; a pickled copy is empty, so that they go to no other process."""

    def __init__(self, most: int) -> None:
        """An empty cache that keeps at most `most` results."""
        self._most = most
        self._results: dict[K, T] = {}

    def __reduce__(self) -> tuple[type[LastResults[K, T]], tuple[int]]:
        return LastResults, (self._most,)

    def __len__(self) -> int:
        return len(self._results)

    @property
    def keys(self) -> tuple[K, ...]:
        """The keys of the results that are kept, that last asked for last."""
        return tuple(self._results)

    def get_or_make(self, key: K, make: Callable[[], T]) -> T:
        """The result that is kept for `key`, else that of `make` (not None), which is then kept.

        The result becomes the last one asked for; those not asked for longest are dropped beyond the largest number
        kept.
        """
        kept = self._results.pop(key, None)
        result = make() if kept is None else kept
        self._results[key] = result
        for oldest in list(self._results)[: -self._most]:
            self._results.pop(oldest, None)
        return result
