"""Models of medium size: dense matrices and poles where many lines are worth them, sparse matrices line by line else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.forward.frf.lines.large import LargeLines
from structid.forward.frf.lines.protocol import LineDerivatives
from structid.forward.frf.lines.small import SmallLines

#: Largest eigenvalue problem that is tried, in degrees of freedom.
MEDIUM_UP_TO = 256


@dataclass(frozen=True, eq=False)
class MediumLines:
    """The lines of a model of medium size, both ways; see `Response`."""

    small: SmallLines
    large: LargeLines

    @property
    def is_large(self) -> bool:
        return False

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        return self._serving(physical, coefficients, loads).fields(physical, coefficients, loads)

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        return self._serving(physical, coefficients).readings(physical, coefficients, columns)

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        return self._serving(physical, coefficients).derivatives(physical, coefficients)

    def _serving(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> SmallLines | LargeLines:
        has_poles = self.small.at(physical, coefficients, loads).modal is not None
        return self.small if has_poles else self.large
