"""The protocol of solvers of the equations of motion at the lines of a record."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray


class LineDerivatives(NamedTuple):
    """Readings of sensors and contacts at a block of lines, with their derivatives with respect to the parameters.

    Attributes
    ----------
    part : slice
        The lines.
    values : (n_lines, n_sensors, n_inputs) complex array
        Readings under the loads.
    derivative : (n_lines, n_sensors, n_inputs, n_params) complex array
        Their derivative with friction as it is.
    reach : (n_lines, n_sensors, n_contacts) complex array
        Readings under unit forces at the contacts.
    """

    part: slice
    values: NumberArray
    derivative: ComplexArray
    reach: NumberArray


class FrfSolver(Protocol):
    """Solver of the equations of motion at the lines of a record, for coefficients (n_lines, n_matrices) of the matrices."""

    @property
    def is_large(self) -> bool:
        """True where lines are factorized one by one as sparse matrices, with one line's fields in memory at a time."""
        ...

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Fields (n, n_dofs, n_loads) for blocks of lines, under all load columns where no other loads are given."""
        ...

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Readings of sensors and contacts under some of the load columns, (n_lines, n_sensors, n_columns)."""
        ...

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Readings and derivatives for blocks of lines, one after another."""
        ...
