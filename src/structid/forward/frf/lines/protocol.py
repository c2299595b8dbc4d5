"""How the equations of a model are solved at its lines: what small, medium and large models have in common."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray


class LineDerivatives(NamedTuple):
    """What sensors and contacts read at a stretch of lines, and how it changes with the parameters.

    Attributes
    ----------
    part : slice
        Which lines.
    values : (n_lines, n_sensors, n_inputs) complex array
        Under the loads.
    derivative : (n_lines, n_sensors, n_inputs, n_params) complex array
        Friction held as it is.
    reach : (n_lines, n_sensors, n_contacts) complex array
        Readings under unit forces at the contacts.
    """

    part: slice
    values: NumberArray
    derivative: ComplexArray
    reach: NumberArray


class Lines(Protocol):
    """How the equations of a model are solved at its lines, with given coefficients (n_lines, n_laws) of its laws."""

    @property
    def is_large(self) -> bool:
        """Whether lines are factorized one by one as sparse matrices, with one line's fields in memory at a time."""
        ...

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Fields (n, n_dofs, n_loads) for stretches of lines, under all columns where no other loads are given."""
        ...

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """What sensors and contacts read under some of the columns, (n_lines, n_sensors, n_columns)."""
        ...

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """See `LineDerivatives`; for stretches of lines, one after another."""
        ...
