"""What was found at the last point, for whoever asks for it there again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from structid.core.arrays import FloatArray

T = TypeVar("T")


class Latest(Generic[T]):
    """Of the last point; a step is tried and made there, and tests and intervals follow. It goes to no other process."""

    def __init__(self) -> None:
        self._kept: tuple[bytes, T] | None = None

    def __reduce__(self) -> tuple[type[Latest[T]], tuple[()]]:
        return Latest, ()

    def at(self, theta: FloatArray, made: Callable[[FloatArray], T]) -> T:
        """What is kept of this point, or what `made` finds there, which is then kept."""
        found = self.known(theta)
        if found is None:
            found = made(theta)
            self.keep(theta, found)
        return found

    def known(self, theta: FloatArray) -> T | None:
        """What is kept of this point."""
        return self._kept[1] if self._kept is not None and self._kept[0] == theta.tobytes() else None

    def keep(self, theta: FloatArray, found: T) -> None:
        self._kept = theta.tobytes(), found

    def taken(self, theta: FloatArray) -> T | None:
        """What is kept of this point; it is let go, and so is what is kept of another."""
        found, self._kept = self.known(theta), None
        return found
