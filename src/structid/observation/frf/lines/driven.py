"""Fields of structures that the motion of their supports drives: from those of the same structure let go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.observation.frf.channels import Channels
from structid.observation.frf.lines.protocol import LineDerivatives, Lines
from structid.observation.frf.slopes import StiffnessSlopes


@dataclass(frozen=True, eq=False)
class DrivenLines:
    """The lines of a model some of whose degrees of freedom have a motion that is given; see `Response`.

    A load at such a degree of freedom is its motion, not a force: a forces column f and motions b give

        x = X_f - X_b H_bb^-1 (H_bf - b),     X = Z^-1 (columns),

    with the columns b of unit forces at the driven degrees of freedom, and H their readings there. The same holds for the
    adjoint fields of sensors, whose own motion is 0 there, so that derivatives are -y' (dZ/dp) x as ever.

    Attributes
    ----------
    let_go : Lines
        Those of the model with free supports.
    slopes : StiffnessSlopes
    channels : Channels
        No sensor of which reads a driven degree of freedom.
    driven : (n_driven,) int array
        Which degrees of freedom those are.
    """

    let_go: Lines
    slopes: StiffnessSlopes
    channels: Channels
    driven: IntArray

    @property
    def is_large(self) -> bool:
        return self.let_go.is_large

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, ComplexArray]]:
        """Fields (n, n_dofs, n_loads) for stretches of lines, under all columns where no other loads are given."""
        right = self.channels.columns if loads is None else loads
        given = right[self.driven, :].toarray()
        for part, fields in self.let_go.fields(physical, coefficients, self._beside(right)):
            unit, own = fields[:, :, : len(self.driven)], fields[:, :, len(self.driven) :]
            push = np.linalg.solve(unit[:, self.driven], own[:, self.driven] - given)
            yield part, own - unit @ push

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """What sensors read under some of the columns, (n_lines, n_sensors, n_columns)."""
        chosen = sparse.csc_array(self.channels.columns[:, columns])
        return np.concatenate([self.channels.read(x) for _, x in self.fields(physical, coefficients, chosen)])

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """See `LineDerivatives`; there are no contacts."""
        for part, fields in self.fields(physical, coefficients):
            x, y = self.channels.under_loads(fields), self.channels.under_sensors(fields)
            change = self.slopes.contracted(physical, -coefficients[part], x, y)
            yield LineDerivatives(part, self.channels.read(x), change, np.zeros((*y.shape[::2], 0)))

    def _beside(self, loads: sparse.csc_array) -> sparse.csc_array:
        """Unit forces at the driven degrees of freedom, then `loads`; the last ones are kept, so that theirs are known."""
        known = self._last.get("last")
        if known is None or known[0] is not loads:
            n = len(self.driven)
            units = sparse.csc_array((np.ones(n), (self.driven, np.arange(n))), (loads.shape[0], n))
            known = self._last["last"] = loads, sparse.csc_array(sparse.hstack([units, loads]))
        return known[1]

    @cached_property
    def _last(self) -> dict[str, tuple[sparse.csc_array, sparse.csc_array]]:
        return {}
