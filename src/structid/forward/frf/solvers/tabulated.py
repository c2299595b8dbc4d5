"""Lines of a structure of which a solver gives FRFs alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.core.errors import InputError
from structid.fem import Structure
from structid.fem.elements.matrix_group import SolverFrfs
from structid.forward.frf.solvers.solver import LineDerivatives
from structid.records import FrfRecord
from structid.unknowns import Parameters

#: What cannot be had of it, for messages; a sentence begins with what asks for it.
NO_MATRICES = (
    'needs masses and stiffnesses, and of this structure a solver gives FRFs alone (`gives = "frfs"`); take `gives = "matrices"`'
    ' or `"modes"` for it'
)


@dataclass(frozen=True, eq=False)
class TabulatedFrf:
    """FRFs that a solver gave, between and beside the values of its runs; see `FrfSolver`.

    Attributes
    ----------
    element : SolverFrfs
    structure : Structure
        Structure that consists of that element alone.
    parameters : Parameters
    record : FrfRecord
        Gives lines, sensors and loads.
    """

    element: SolverFrfs
    structure: Structure
    parameters: Parameters
    record: FrfRecord

    @property
    def is_large(self) -> bool:
        return False

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """There are none.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(f"the motion of all nodes {NO_MATRICES}")

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Tabulated receptances of sensors, (n_lines, n_outputs, n_columns), under load columns at indices `columns`.

        Columns are of unit loads along the axes; sensors have the signs of their directions. `physical` (n_params,) are
        the parameters; `coefficients` are not used.
        """
        values, _ = self._signed_receptances(physical)
        senses = np.array([dof.sign for dof in self.record.inputs])
        first = [list(self._columns).index(column) for column in columns.tolist()]
        return values[:, :, first] * senses[first]

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Yield `LineDerivatives` of all lines at once at the parameters `physical` (n_params,), without contacts.

        `coefficients` are not used.
        """
        values, change = self._signed_receptances(physical)
        yield LineDerivatives(slice(0, len(values)), values, change, np.zeros((*values.shape[:2], 0), np.complex128))

    def _signed_receptances(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Receptances (n_lines, n_outputs, n_inputs) with the signs of both channels, and derivatives (..., n_params).

        They are interpolated in the table of the solver, in the order of the record. `physical` (n_params,) are the
        parameters.
        """
        lines, (outputs, senses), (inputs, input_senses) = self._places
        values, change = self.element.table.evaluated(self.parameters.values(physical)[self._rows])
        chosen = np.ix_(lines, outputs, inputs)
        sign = senses[:, None] * input_senses
        inner = np.asarray(self.parameters.design[self._rows, :].toarray())
        return values[chosen] * sign, (change[chosen] @ inner) * sign[..., None]

    @cached_property
    def _rows(self) -> IntArray:
        """Indices (n,) of the property values that are the parameters of the deck, in its order."""
        row = {item.term.property: item.values.start for item in self.structure.properties}
        return np.array([row[name] for name in self.element.table.at], dtype=np.int64)

    @cached_property
    def _columns(self) -> tuple[int, ...]:
        """Number of the distinct degree of freedom of each load, from 0 in the order of first appearance."""
        known: dict[str, int] = {}
        return tuple(known.setdefault(str(dof.unsigned), len(known)) for dof in self.record.inputs)

    @cached_property
    def _places(self) -> tuple[IntArray, tuple[IntArray, FloatArray], tuple[IntArray, FloatArray]]:
        """Line indices of the table, then indices and signs of its outputs, and of its inputs, that the record has."""
        element = self.element
        lines = element.table.lines(self.record.frequency)
        return (
            lines,
            element.channel_indices(self.record.outputs, "output"),
            element.channel_indices(self.record.inputs, "input"),
        )
